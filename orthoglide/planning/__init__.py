"""Which readings to take for an identification: before any measurement, and next."""

from orthoglide.planning.aliasing import aliasing as aliasing
from orthoglide.planning.designs import Design as Design, design as design
from orthoglide.planning.linear import foreseen as foreseen
from orthoglide.planning.observability import observability as observability
from orthoglide.planning.pool import reading_pool as reading_pool
from orthoglide.planning.repeats import Repeats as Repeats, repeats_needed as repeats_needed
from orthoglide.planning.rivals import pairs_within as pairs_within
from orthoglide.planning.sheets import (
    sheets_of as sheets_of,
    to_fill_in as to_fill_in,
    tool_sheets as tool_sheets,
)
from orthoglide.planning.suggestions import (
    Suggestion as Suggestion,
    next_measurements as next_measurements,
    next_sheet as next_sheet,
)
