"""An effect of one's own: carriages with play beside their rails, by the side they come from.

orthoglide close-loop campaign.csv --effects-file examples/carriage_play.py --out DIR
"""

from orthoglide.effects import Effect, Motion
from orthoglide.units import MM


def play(c):  # half of it behind the last move; what else a basis may use: LegConditions
    return -c.approach / 2


def across(leg):  # functions with names pickle, lambdas do not
    return {axis: (Motion(f"lateral_{axis}", play),) for axis in "bc"}


CARRIAGE_PLAY = Effect(
    "carriage_play",
    MM,
    0.05,  # standard deviation to expect, in the unit
    because="a worn carriage tips by a few hundredths",
    sentence="the carriage has play beside its rail",
    look_at="the carriage's bearings and their preload",
    members=across,
)
