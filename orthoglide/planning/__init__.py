"""Which readings to take: before any measurement, and next."""

from orthoglide.planning.designs import Design as Design, design as design
from orthoglide.planning.detectable import (
    SmallestEffect as SmallestEffect,
    smallest_effects as smallest_effects,
)
from orthoglide.planning.instruments import deciding_instruments as deciding_instruments
from orthoglide.planning.linear import foreseen as foreseen
from orthoglide.planning.observability import observability as observability
from orthoglide.planning.owning import (
    TAKEN_BY as TAKEN_BY,
    Owned as Owned,
    owned_instruments as owned_instruments,
    sheets_of as sheets_of,
)
from orthoglide.planning.parting import parting as parting
from orthoglide.planning.pool import reading_pool as reading_pool
from orthoglide.planning.repeats import Repeats as Repeats, repeats_needed as repeats_needed
from orthoglide.planning.rivals import pairs_within as pairs_within
from orthoglide.planning.suggestions import (
    Suggestion as Suggestion,
    next_measurements as next_measurements,
    next_sheet as next_sheet,
    repeating as repeating,
    tracing as tracing,
)
from orthoglide.planning.tolerances import needed_tolerances as needed_tolerances
