"""Layouts: the placement of three legs, and names of legs and directions.

A layout defines the start and direction of each leg's rail and the direction of its short links.
All differences between an Orthoglide and a linear delta are in here.
"""

from orthoglide.layout.free import FreeLeg as FreeLeg, FreeLegs as FreeLegs
from orthoglide.layout.leg import Layout as Layout, Leg as Leg, LegNames as LegNames
from orthoglide.layout.linear_delta import LinearDelta as LinearDelta
from orthoglide.layout.orthoglide import ORTHOGLIDE as ORTHOGLIDE, Orthoglide as Orthoglide

DIRECTIONS: frozenset[str] = frozenset(Orthoglide.names.directions | LinearDelta.names.directions)
"""All names of directions across a leg."""
