"""Errors of dials. A dial moves no virtual joint: it changes the reading.

Its parameters carry the name of the setup in place of the leg. They act in the order of the
catalogue: the stem turns, the dial magnifies its displacement, the stand creeps.
"""

from __future__ import annotations

from orthoglide.effects.effect import Effect, cos, sin
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.free_form_place import Dependence, FreeFunctions, Range
from orthoglide.effects.kernels import Kernel, Level
from orthoglide.effects.words import Words
from orthoglide.units import ONE, RAD, Unit

GAUGE_DIRECTION = Effect(
    "gauge_direction",
    RAD,
    0.02,
    because="a stem set by eye is square to a degree",
    sentence="the dial's stem is not along the axis: it sees part of the other direction",
    look_at="the stem against a square, looking along the leg",
    words=Words(
        "the dial of {setup} is turned by {size} about the leg, {right-handed|left-handed}",
        "the dial of {setup} is turned about the leg",
        "the dials are turned about their legs",
        confirm="hold a square to the stem of {setup}, looking along the leg: expect the stem "
        "{size} off, {right-handed|left-handed} about the leg's axis",
        common="all dials are turned by {size} about their legs, {right-handed|left-handed}",
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
        "the dial of {setup} shows {size} {more|less} than it is moved",
        "the dial of {setup} shows more or less than it is moved",
        "the dials show more or less than they are moved",
        confirm="put gauge blocks 5 mm apart under the dial of {setup}: expect {mm:5e-3} "
        "{more|less} than 5 mm",
        common="all dials show {size} {more|less} than they are moved",
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
        "the stand of {setup} creeps: its reading {grows|falls} by {size}",
        "the stand of {setup} creeps",
        "the dials' stands creep",
        "{mm:3600} an hour",
        "leave the machine at rest for an hour with the dial of {setup} in place: expect its "
        "reading to {grow|fall} by {mm:3600}",
        common="the stands of all dials creep: their readings {grow|fall} by {size}",
    ),
    group="dial",
    dial=lambda reading, rate: reading.shown + rate * reading.time,
)

EFFECTS = (GAUGE_DIRECTION, GAUGE_SCALE, GAUGE_DRIFT)

_UM = 1e-6
_CREEP, _DIAL = Kernel(0.5, 8, rough=1.0, from_zero=True), Kernel(0.5, 6)


def dial_free_forms(
    setup: str, leg: int, time: Range | None, reading: Range, turns: bool, scale: float = 1.0
) -> tuple[FreeForm, ...]:
    """Return the free-form errors of one setup of a dial: creep, curve and reversal error.

    ``time``: first and last second, if recorded; ``reading``: smallest and largest predicted one,
    metres, as a curve over the measured readings would fit their noise; ``turns``: whether the
    plunger moved in both directions.
    """
    candidates: tuple[tuple[Dependence, FreeFunctions, float, Range | None], ...] = (
        ("time", _CREEP, 20 * _UM, time),
        ("reading", _DIAL, 20 * _UM, reading),
        ("approach", Level(), 10 * _UM, reading if turns else None),
    )
    return tuple(
        FreeForm("dial", leg, "", against, kernel, prior_sd * scale, span=span, setup=setup)
        for against, kernel, prior_sd, span in candidates
        if span is not None
    )


def common_dial_form(reading: Range, scale: float = 1.0) -> FreeForm:
    """Return the reversal error that all dials of one make share; ``reading``: range of the
    readings, metres.
    """
    return FreeForm("dial", -1, "", "approach", Level(), 10 * _UM * scale, span=reading)
