"""Kinds of readings, one module each, and mountings of instruments."""

# The order of these imports is the order in which kinds are listed for people.
# isort: off
from orthoglide.instruments.leg_dial import LegDial as LegDial, Parallelism as Parallelism
from orthoglide.instruments.tcp import Coordinate as Coordinate
from orthoglide.instruments.plate import PlateTouch as PlateTouch
from orthoglide.instruments.distance import (
    PRINTED as PRINTED,
    SHRINKAGE_BY_MATERIAL as SHRINKAGE_BY_MATERIAL,
    Distance as Distance,
)
from orthoglide.instruments.ball_bar import BallBar as BallBar
from orthoglide.instruments.inclination import Inclination as Inclination

# isort: on
from orthoglide.instruments.observation import (
    OBSERVATIONS as OBSERVATIONS,
    POSE_SIZE as POSE_SIZE,
    TOOL_OFFSET_COLUMNS as TOOL_OFFSET_COLUMNS,
    Frame as Frame,
    InstrumentPose as InstrumentPose,
    InstrumentPriors as InstrumentPriors,
    Mounted as Mounted,
    Observation as Observation,
    ReadingVariables as ReadingVariables,
    Setup as Setup,
    SetupReadings as SetupReadings,
)

TOOL_OBSERVATIONS: dict[str, Observation] = {
    kind: observation for kind, observation in OBSERVATIONS.items() if not observation.on_leg
}
"""Kinds of readings of the tool, by their name in files."""
