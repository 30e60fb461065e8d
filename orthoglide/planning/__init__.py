"""Which readings to take for an identification, and what they would tell: before any measurement,
and next.
"""

from orthoglide.planning.aliasing import aliasing as aliasing
from orthoglide.planning.designs import (
    Design as Design,
    Repeats as Repeats,
    design as design,
    index_table as index_table,
    observability as observability,
    repeats_needed as repeats_needed,
)
from orthoglide.planning.detectable import (
    Detectability as Detectability,
    SmallestEffect as SmallestEffect,
    detectable_rows as detectable_rows,
    smallest_effects as smallest_effects,
)
from orthoglide.planning.instruments import deciding_instruments as deciding_instruments
from orthoglide.planning.linear import foreseen as foreseen
from orthoglide.planning.pool import reading_pool as reading_pool
from orthoglide.planning.rivals import next_measurements as next_measurements, parting as parting
from orthoglide.planning.sheets import (
    TAKEN_BY as TAKEN_BY,
    sheets_of as sheets_of,
    to_fill_in as to_fill_in,
    tool_sheets as tool_sheets,
)
from orthoglide.planning.suggestions import (
    DECIDES as DECIDES,
    Suggestion as Suggestion,
    deciding_visits as deciding_visits,
    next_sheet as next_sheet,
    repeating as repeating,
    tracing as tracing,
)
