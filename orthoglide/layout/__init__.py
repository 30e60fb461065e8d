"""Where three legs stand, how they and their directions are called: all that tells machines apart.

A layout says for each leg where its rail starts, which way it slides and where its short links
point. Nothing else knows whether a machine is an Orthoglide or a linear delta.
"""

from orthoglide.layout.free import FreeLeg as FreeLeg, FreeLegs as FreeLegs
from orthoglide.layout.leg import Layout as Layout, Leg as Leg, LegNames as LegNames
from orthoglide.layout.linear_delta import LinearDelta as LinearDelta
from orthoglide.layout.orthoglide import ORTHOGLIDE as ORTHOGLIDE, Orthoglide as Orthoglide

DIRECTIONS: frozenset[str] = frozenset(Orthoglide.names.directions | LinearDelta.names.directions)
"""All words for directions across a leg."""
