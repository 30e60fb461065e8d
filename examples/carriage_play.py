"""An effect of one's own: carriages with play beside their rails, by the side they come from.

orthoglide close-loop campaign.csv --effects-file examples/carriage_play.py --out DIR
"""

from orthoglide.effects import Effect, Motion
from orthoglide.units import MM


def play(c):
    """Half the play behind the last move; see ``LegConditions`` for what else a basis may use."""
    return -c.approach / 2


CARRIAGE_PLAY = Effect(
    "carriage_play",
    MM,
    0.05,  # standard deviation to expect, in the unit
    because="a worn carriage tips by a few hundredths",
    sentence="the carriage has play beside its rail",
    look_at="the carriage's bearings and their preload",
    members=lambda leg: {axis: (Motion(f"lateral_{axis}", play),) for axis in "bc"},
)
