"""Readings to take for an identification, before any measurement and next, and what they show."""

from orthoglide.planning.designs import (
    aliasing as aliasing,
    design as design,
    index_table as index_table,
    observability as observability,
    repeats_needed as repeats_needed,
)
from orthoglide.planning.detectable import (
    detectable_rows as detectable_rows,
    smallest_effects as smallest_effects,
)
from orthoglide.planning.instrument_choice import (
    suggest_instruments_for_causes as suggest_instruments_for_causes,
)
from orthoglide.planning.rivals import (
    next_measurements as next_measurements,
    suggest_separating_located_errors as suggest_separating_located_errors,
)
from orthoglide.planning.sheets import sheets_by_kind as sheets_by_kind, tool_sheets as tool_sheets
from orthoglide.planning.suggestions import (
    Suggestion as Suggestion,
    next_sheet as next_sheet,
    suggest_deciding_visits as suggest_deciding_visits,
    suggest_repeating as suggest_repeating,
    suggest_tracing as suggest_tracing,
)
