"""Which readings to take: before any measurement, and next."""

from orthoglide.design.detectable import Detectability, Smallest, smallest_effects
from orthoglide.design.following import Suggestion, as_result, next_measurements, next_sheet
from orthoglide.design.observability import Observability, observability
from orthoglide.design.planning import Design, design, report_design
from orthoglide.design.pool import reading_pool
from orthoglide.design.precision import Repeats, repeats_needed

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
