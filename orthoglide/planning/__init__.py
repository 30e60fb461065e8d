"""Which readings to take: before any measurement, and next."""

from orthoglide.planning.designs import Design, design, report_design
from orthoglide.planning.detectable import Detectability, Smallest, smallest_effects
from orthoglide.planning.following import Suggestion, as_result, next_measurements, next_sheet
from orthoglide.planning.observability import Observability, observability
from orthoglide.planning.pool import reading_pool
from orthoglide.planning.precision import Repeats, repeats_needed

__all__ = [
    "Design",
    "Detectability",
    "Observability",
    "Repeats",
    "Smallest",
    "Suggestion",
    "as_result",
    "design",
    "next_measurements",
    "next_sheet",
    "observability",
    "reading_pool",
    "repeats_needed",
    "report_design",
    "smallest_effects",
]
