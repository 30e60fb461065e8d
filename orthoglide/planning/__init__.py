"""Which readings to take: before any measurement, and next."""

from orthoglide.planning.designs import Design, design
from orthoglide.planning.detectable import Detectability, SmallestEffect, smallest_effects
from orthoglide.planning.linear import expected_noise
from orthoglide.planning.observability import Observability, observability
from orthoglide.planning.owning import INSTRUMENTS, Owned, owned_instruments
from orthoglide.planning.pool import reading_pool
from orthoglide.planning.repeats import Repeats, repeats_needed
from orthoglide.planning.suggestions import (
    Suggestion,
    deciding_instruments,
    next_measurements,
    next_sheet,
)
from orthoglide.planning.tolerances import NeededTolerances, needed_tolerances
from orthoglide.planning.tracing import tracing
