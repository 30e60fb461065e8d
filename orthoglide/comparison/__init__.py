"""The general mechanism against the reduction: what three drives and three bars cannot say.

For an effect, or a whole machine, the mechanism says where the TCP and the dials really are. The
reduction has six parameters, three joint offsets and three leg lengths, to come near: they are
fitted to the TCP over the workspace, and separately to the readings of a campaign. What is left is
what a user of the simplified model cannot get rid of. Everything here is nonlinear.
"""

from orthoglide.comparison.bench import Circumstances, cube
from orthoglide.comparison.comparing import Slice, compare_effects, compare_machine, slices
from orthoglide.comparison.rows import (
    ALIKE,
    READING_LIMIT,
    TCP_LIMIT,
    Difference,
    Row,
    worst_of_families,
)
from orthoglide.comparison.tables import (
    LEGEND,
    comparison_page,
    csv_table,
    markdown_table,
    slice_figure,
    verdict_text,
)

__all__ = [
    "ALIKE",
    "LEGEND",
    "READING_LIMIT",
    "TCP_LIMIT",
    "Circumstances",
    "Difference",
    "Row",
    "Slice",
    "compare_effects",
    "compare_machine",
    "comparison_page",
    "csv_table",
    "cube",
    "markdown_table",
    "slice_figure",
    "slices",
    "verdict_text",
    "worst_of_families",
]
