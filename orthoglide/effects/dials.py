"""Errors of dials. A dial moves no virtual joint: it changes the reading.

Its parameters carry the name of the setup in place of the leg. They act in the order of the
catalogue: the stem turns, the dial magnifies its displacement, the stand creeps.
"""

from __future__ import annotations

from orthoglide.effects.effect import Effect
from orthoglide.effects.motions import cos, sin
from orthoglide.effects.words import Words, mm, mrad, percent, sign_word
from orthoglide.units import ONE, RAD, Unit

GAUGE_DIRECTION = Effect(
    "gauge_direction",
    RAD,
    0.02,
    because="a stem set by eye is square to a degree",
    sentence="the dial's stem is not along the axis: it sees part of the other direction",
    look_at="the stem against a square, looking along the leg",
    words=Words(
        lambda p, v: (
            f"the dial of {p.setup} is turned by {mrad(v)} about the leg, "
            f"{sign_word(v, 'right-handed', 'left-handed')}"
        ),
        lambda p: f"the dial of {p.setup} is turned about the leg",
        "the dials are turned about their legs",
        confirm=lambda p, v: (
            f"hold a square to the stem of {p.setup}, looking along the leg: expect the stem "
            f"{mrad(v)} off, {sign_word(v, 'right-handed', 'left-handed')} about the leg's axis"
        ),
    ),
    group="dial",
    dial=lambda reading, angle: cos(angle) * reading.shown + sin(angle) * reading.across,
)

GAUGE_SCALE = Effect(
    "gauge_scale",
    ONE,
    0.01,
    because="a workshop dial is true to a hundredth of what it shows",
    sentence="the dial shows more or less than it is moved",
    look_at="the dial against gauge blocks",
    words=Words(
        lambda p, v: f"the dial of {p.setup} shows {percent(v)} {sign_word(v)} than it is moved",
        lambda p: f"the dial of {p.setup} shows more or less than it is moved",
        "the dials show more or less than they are moved",
        confirm=lambda p, v: (
            f"put gauge blocks 5 mm apart under the dial of {p.setup}: expect {mm(5e-3 * v)} "
            f"{sign_word(v)} than 5 mm"
        ),
    ),
    group="dial",
    dial=lambda reading, scale: (1 + scale) * reading.shown,
)

GAUGE_DRIFT = Effect(
    "gauge_drift",
    Unit("mm/s", 1e-3),
    2e-5,
    because="a magnetic stand creeps by a few hundredths in half an hour",
    sentence="the dial's stand creeps",
    look_at="the stand's clamps and its foot; let it settle, then read zero again at the end",
    words=Words(
        lambda p, v: (
            f"the stand of {p.setup} creeps: its reading {sign_word(v, 'grows', 'falls')} by "
            f"{mm(v * 3600)} an hour"
        ),
        lambda p: f"the stand of {p.setup} creeps",
        "the dials' stands creep",
        lambda v: f"{mm(v * 3600)} an hour",
        lambda p, v: (
            f"leave the machine at rest for an hour with the dial of {p.setup} in place: expect "
            f"its reading to {sign_word(v, 'grow', 'fall')} by {mm(v * 3600)}"
        ),
    ),
    group="dial",
    dial=lambda reading, rate: reading.shown + rate * reading.time,
)

EFFECTS = (GAUGE_DIRECTION, GAUGE_SCALE, GAUGE_DRIFT)
