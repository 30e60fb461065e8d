"""What a rail does wrong: the path of its carriage, and how the carriage sits on it."""

from __future__ import annotations

from typing import Any

from orthoglide.effects.effect import Family, LegConditions, Motion, sideways
from orthoglide.units import MM, RAD


def _one(_: LegConditions) -> Any:
    return 1.0


def _travel(c: LegConditions) -> Any:
    return c.travel


def _bow(c: LegConditions) -> Any:
    return c.u * c.u - 1


def _turned(axis: str, sign: int) -> Motion:
    """The carriage turns with a rail that tips toward ``axis``: about a x axis."""
    about, way = ("turn_c", sign) if axis == "b" else ("turn_b", sign)
    return Motion(about, lambda _: float(way))


AXIS_OFFSET = Family(
    "axis_offset",
    MM,
    0.3,
    because="rails are aligned to a shoulder or a dowel, to a few tenths",
    sentence="the rail stands beside its place: the drive axes do not meet in one point",
    look_at="the rail's seat and shims, square to its travel",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", _one),)),
)

AXIS_TILT = Family(
    "axis_tilt",
    RAD,
    1e-3,
    because="a rail set by a square is true to a tenth over its travel",
    sentence="the carriage's path is not square to the other axes",
    look_at="the rail against a granite square, over the whole travel",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", _travel),)),
)

RAIL_TILT = Family(
    "rail_tilt",
    RAD,
    1e-3,
    because="as an axis tilt, but the carriage leans with its rail",
    sentence="the rail is out of square and the carriage leans with it",
    look_at="the rail's seat with a level: does the carriage lean with it?",
    members=sideways(lambda axis, sign: (Motion(f"lateral_{axis}", _travel), _turned(axis, sign))),
)

RAIL_BOW = Family(
    "rail_bow",
    MM,
    0.02,
    because="a ground rail bolted to a milled face is straight to two hundredths",
    sentence="the rail is bent: its middle stands off the line between its ends",
    look_at="the rail against a straight edge, its bolts and what lies under it",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", _bow),)),
)

MOUNT_TILT = Family(
    "mount_tilt",
    RAD,
    2e-3,
    because="a bracket milled and bolted is true to a tenth over 50 mm",
    sentence="the leg's first hinge is not square to its carriage",
    look_at="the bracket between carriage and leg, its seat and bolts",
    members=lambda leg: {
        "a": (Motion("turn_a", _one),),
        "b": (Motion("turn_b", _one),),
    },
)

FAMILIES = (AXIS_OFFSET, AXIS_TILT, RAIL_TILT, RAIL_BOW, MOUNT_TILT)
