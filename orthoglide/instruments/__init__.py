"""Kinds of readings, each a file that owes all that the rest asks, and mountings of instruments."""

# Imported in the order in which kinds are listed for people.
# isort: off
from orthoglide.instruments.leg_dial import LegDial as LegDial
from orthoglide.instruments.tcp import Coordinate as Coordinate
from orthoglide.instruments.plate import PlateTouch as PlateTouch
from orthoglide.instruments.distance import PRINTED as PRINTED, SIZES as SIZES, Distance as Distance
from orthoglide.instruments.ball_bar import BallBar as BallBar
from orthoglide.instruments.inclination import Inclination as Inclination
from orthoglide.instruments.parallelism import Parallelism as Parallelism

# isort: on
from orthoglide.instruments.observation import (
    BESIDE as BESIDE,
    MATERIAL as MATERIAL,
    OBSERVATIONS as OBSERVATIONS,
    POSE as POSE,
    TURNED as TURNED,
    Beliefs as Beliefs,
    Frame as Frame,
    Observation as Observation,
    Row as Row,
    Setup as Setup,
    Site as Site,
    Stand as Stand,
    Taken as Taken,
)

AT_TOOL: dict[str, Observation] = {k: one for k, one in OBSERVATIONS.items() if not one.on_leg}
"""Kinds of readings of the tool, by what files call them."""
