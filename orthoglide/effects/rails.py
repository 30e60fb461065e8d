"""Errors of rails: the paths of the carriages, and how the carriages sit on them."""

from __future__ import annotations

from typing import Any

from orthoglide.effects.effect import Constant, Effect, LegConditions, Motion, once, sideways
from orthoglide.effects.words import Words
from orthoglide.units import MM, RAD


def _travel(c: LegConditions) -> Any:
    return c.travel


def _turned(axis: str, sign: int) -> Motion:
    """Return the rotation, about a x axis, of a carriage whose rail leans toward ``axis``."""
    return Motion("turn_c" if axis == "b" else "turn_b", Constant(float(sign)))


_SLOPE = "{mrad} ({mm:0.1} over 100 mm)"
"""A slope, also as the deviation over 100 mm that a mechanic measures."""

AXIS_OFFSET = Effect(
    "axis_offset",
    MM,
    0.3,
    because="rails are aligned to a shoulder or a dowel, to a few tenths",
    sentence="the rail stands beside its place: the drive axes do not meet in one point",
    look_at="the rail's seat and shims, square to its travel",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", Constant(1.0)),)),
    words=Words(
        "the {leg} rail stands {size} beside its place, toward {toward}",
        "the {leg} rail stands beside its place in {across}",
        "the rails stand beside their places",
        confirm="measure where the {leg} rail stands relative to the others in {across}: expect "
        "{size} toward {toward}",
    ),
    controller="place",  # of a tower; an Orthoglide's controller knows of none
    urdf=True,
)

AXIS_TILT = Effect(
    "axis_tilt",
    RAD,
    1e-3,
    because="a rail set by a square is true to a tenth over its travel",
    sentence="the carriage's path is not square to the other axes",
    look_at="the rail against a granite square, over the whole travel",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", _travel),)),
    words=Words(
        "the path of the {leg} carriage is out of square toward {toward} by {size}",
        "the path of the {leg} carriage is out of square in {across}",
        "the paths of the carriages are out of square",
        _SLOPE,
        "set a dial on carriage {leg} against a square that {along}: expect {mm:0.1} toward "
        "{toward} for 100 mm of travel",
    ),
    urdf=True,
)

RAIL_TILT = Effect(
    "rail_tilt",
    RAD,
    1e-3,
    because="as an axis tilt, but the carriage leans with its rail",
    sentence="the rail is out of square and the carriage leans with it",
    look_at="the rail's seat with a level: does the carriage lean with it?",
    members=sideways(lambda axis, sign: (Motion(f"lateral_{axis}", _travel), _turned(axis, sign))),
    words=Words(
        "the {leg} rail leans toward {toward} by {size} and its carriage with it",
        "the {leg} rail leans in {across} and its carriage with it",
        "the rails lean and their carriages with them",
        _SLOPE,
        "set a dial on carriage {leg} against a square that {along}: expect {mm:0.1} toward "
        "{toward} for 100 mm of travel, and a square held to the carriage {mrad} off",
    ),
)

RAIL_BOW = Effect(
    "rail_bow",
    MM,
    0.02,
    because="a ground rail bolted to a milled face is straight to two hundredths",
    sentence="the rail is bent: its middle stands off the line between its ends",
    points="with its ends toward",
    look_at="the rail against a straight edge, its bolts and what lies under it",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", lambda c: c.u * c.u - 1),)),
    words=Words(
        "the {leg} rail is bent: its middle stands {size} toward {away} off the line between its "
        "ends",
        "the {leg} rail is bent in {across}",
        "the rails are bent",
        confirm="lay a straight edge along the {leg} rail over its whole stroke: expect its middle "
        "{size} toward {away}",
    ),
)

MOUNT_TILT = Effect(
    "mount_tilt",
    RAD,
    2e-3,
    because="a bracket milled and bolted is true to a tenth over 50 mm",
    sentence="the leg's first hinge is not square to its carriage",
    look_at="the bracket between carriage and leg, its seat and bolts",
    members=lambda leg: {
        "a": (Motion("turn_a", Constant(1.0)),),
        "b": (Motion("turn_b", Constant(1.0)),),
    },
    words=Words(
        "the first hinge of leg {leg} is turned by {size} about {axis}, {sense}",
        "the first hinge of leg {leg} is turned about {axis}",
        "the first hinges of the legs are turned on their carriages",
        confirm="hold a square between carriage {leg} and the first hinge of its leg: expect the "
        "hinge {size} off about {axis}, {sense}",
    ),
)

RAIL_TORSION = Effect(
    "rail_torsion",
    RAD,
    2e-3,
    because="an extrusion is twisted by a quarter of a degree over its length",
    sentence="the rail is twisted: its carriage turns about it as it travels",
    look_at="the tower's extrusion, with a square against its face at both ends",
    members=once(Motion("turn_a", lambda c: c.u)),
    words=Words(
        "the {leg} rail is twisted: from one end of the stroke to the other its carriage turns by "
        "{size} about it, {counter-clockwise|clockwise} on the way up",
        "the {leg} rail is twisted along its length",
        "the rails are twisted along their lengths",
        "{mrad:2}",
        "hold a square to carriage {leg} at both ends of its stroke: expect it to turn by {size} "
        "about the rail",
    ),
)

EFFECTS = (AXIS_OFFSET, AXIS_TILT, RAIL_TILT, RAIL_BOW, MOUNT_TILT)
DELTA_EFFECTS = (RAIL_TORSION,)
"""Where rails stand free: those of an Orthoglide lie on their beds."""
