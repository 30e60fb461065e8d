"""Comparison of the general mechanism with the reduction to three drives and three bars.

For an effect, or a whole machine, the mechanism predicts the TCP and the readings of dials. The six
parameters of the reduction, three joint offsets and three leg lengths, are fitted to the TCP over
the workspace, and separately to the readings of a campaign. The residuals are the errors that a
user of the simplified model cannot remove. All computations are nonlinear.
"""

from orthoglide.comparison.comparing import (
    Row as Row,
    compare_effects as compare_effects,
    compare_machine as compare_machine,
    worst_by_effect as worst_by_effect,
)
