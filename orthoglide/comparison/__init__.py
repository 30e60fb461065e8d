"""The general mechanism against the reduction: what three drives and three bars cannot say.

For an effect, or a whole machine, the mechanism says where the TCP and the dials really are. The
reduction has six parameters, three joint offsets and three leg lengths, to come near: they are
fitted to the TCP over the workspace, and separately to the readings of a campaign. What is left is
what a user of the simplified model cannot get rid of. Everything here is nonlinear.
"""

from orthoglide.comparison.comparing import (
    Circumstances as Circumstances,
    compare_effects as compare_effects,
    compare_machine as compare_machine,
    slices as slices,
)
from orthoglide.comparison.rows import Row as Row, worst_by_effect as worst_by_effect
