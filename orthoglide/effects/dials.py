"""What a dial does wrong. A dial moves no virtual joint: it is part of the observation.

Its parameters carry the setup's name where those of a machine carry the leg's.
"""

from __future__ import annotations

from collections.abc import Mapping

from orthoglide.effects.effect import Family, Motion
from orthoglide.units import ONE, RAD, Unit


def _nothing(_: int) -> Mapping[str, tuple[Motion, ...]]:
    return {}


GAUGE_SCALE = Family(
    "gauge_scale",
    ONE,
    0.01,
    because="a workshop dial is true to a hundredth of what it shows",
    sentence="the dial shows more or less than it is moved",
    look_at="the dial against gauge blocks",
    members=_nothing,
    group="dial",
)

GAUGE_DIRECTION = Family(
    "gauge_direction",
    RAD,
    0.02,
    because="a stem set by eye is square to a degree",
    sentence="the dial's stem is not along the axis: it sees part of the other direction",
    look_at="the stem against a square, looking along the leg",
    members=_nothing,
    group="dial",
)

GAUGE_DRIFT = Family(
    "gauge_drift",
    Unit("mm/s", 1e-3),
    2e-5,
    because="a magnetic stand creeps by a few hundredths in half an hour",
    sentence="the dial's stand creeps",
    look_at="the stand's clamps and its foot; let it settle, then read zero again at the end",
    members=_nothing,
    group="dial",
)

FAMILIES = (GAUGE_SCALE, GAUGE_DIRECTION, GAUGE_DRIFT)
