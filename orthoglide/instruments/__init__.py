"""Instruments that read where the tool is, each a file that owes all that the rest asks."""

from orthoglide.instruments.ball_bar import BallBar as BallBar
from orthoglide.instruments.distance import Distance as Distance
from orthoglide.instruments.instrument import (
    Instrument as Instrument,
    Mounting as Mounting,
    Pose as Pose,
    unit_vectors as unit_vectors,
)
from orthoglide.instruments.level import Level as Level
from orthoglide.instruments.probe import Probe as Probe
from orthoglide.instruments.tracker import Tracker as Tracker

INSTRUMENTS: dict[str, Instrument] = {
    own.kind: own for own in (Tracker(), Probe(), Distance(), BallBar(), Level())
}
"""By what files call their readings."""
