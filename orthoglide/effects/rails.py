"""Errors of rails: the paths of the carriages, and how the carriages sit on them."""

from __future__ import annotations

from typing import Any

from orthoglide.effects.effect import Effect
from orthoglide.effects.motions import Constant, LegConditions, Motion, once, sideways
from orthoglide.effects.words import (
    Words,
    across,
    along,
    mm,
    mrad,
    rotation_sense,
    sign_word,
    slope,
    toward,
)
from orthoglide.layout import LinearDelta, Orthoglide
from orthoglide.parameters import Parameter
from orthoglide.units import MM, RAD


def _travel(c: LegConditions) -> Any:
    return c.travel


def _turned(axis: str, sign: int) -> Motion:
    """Return the rotation, about a x axis, of a carriage whose rail leans toward ``axis``."""
    return Motion("turn_c" if axis == "b" else "turn_b", Constant(float(sign)))


def _bracket_axis(p: Parameter) -> str:
    """Return words for the axis about which a bracket is turned."""
    names = Orthoglide.names
    along_base_axes = p.leg in names.legs  # whose legs lie along base axes
    if p.direction == "a":
        return f"{p.leg}, the leg's own axis" if along_base_axes else "the leg's own axis"
    return (
        f"{names.across[names.index(p.leg)][0]}, the axis of its pivots"
        if along_base_axes
        else "the axis of its pivots"
    )


def _bracket_sense(p: Parameter, value: float) -> str:
    """Return the sense in which a bracket is turned, as seen by a viewer of the machine."""
    return rotation_sense(p.direction, value, p.leg in LinearDelta.names.legs)


AXIS_OFFSET = Effect(
    "axis_offset",
    MM,
    0.3,
    because="rails are aligned to a shoulder or a dowel, to a few tenths",
    sentence="the rail stands beside its place: the drive axes do not meet in one point",
    look_at="the rail's seat and shims, square to its travel",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", Constant(1.0)),)),
    words=Words(
        lambda p, v: (
            f"the {p.leg} rail stands {mm(v)} beside its place, toward {toward(p.direction, v)}"
        ),
        lambda p: f"the {p.leg} rail stands beside its place in {across(p.direction)}",
        "the rails stand beside their places",
        confirm=lambda p, v: (
            f"measure where the {p.leg} rail stands relative to the others in "
            f"{across(p.direction)}: expect {mm(v)} toward {toward(p.direction, v)}"
        ),
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
        lambda p, v: (
            f"the path of the {p.leg} carriage is out of square toward "
            f"{toward(p.direction, v)} by {slope(v)}"
        ),
        lambda p: f"the path of the {p.leg} carriage is out of square in {across(p.direction)}",
        "the paths of the carriages are out of square",
        slope,
        lambda p, v: (
            f"set a dial on carriage {p.leg} against a square that {along(p.leg, p.direction)}: "
            f"expect {mm(0.1 * v)} toward {toward(p.direction, v)}"
        ),
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
        lambda p, v: (
            f"the {p.leg} rail leans toward {toward(p.direction, v)} by {slope(v)} and its "
            f"carriage with it"
        ),
        lambda p: f"the {p.leg} rail leans in {across(p.direction)} and its carriage with it",
        "the rails lean and their carriages with them",
        slope,
        lambda p, v: (
            f"set a dial on carriage {p.leg} against a square that {along(p.leg, p.direction)}: "
            f"expect {mm(0.1 * v)} toward {toward(p.direction, v)}, and a square "
            f"held to the carriage {mrad(v)} off"
        ),
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
        lambda p, v: (
            f"the {p.leg} rail is bent: its middle stands {mm(v)} toward {toward(p.direction, -v)} "
            f"off the line between its ends"
        ),
        lambda p: f"the {p.leg} rail is bent in {across(p.direction)}",
        "the rails are bent",
        confirm=lambda p, v: (
            f"lay a straight edge along the {p.leg} rail over its whole stroke: expect its middle "
            f"{mm(v)} toward {toward(p.direction, -v)}"
        ),
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
        lambda p, v: (
            f"the first hinge of leg {p.leg} is turned by {mrad(v)} about {_bracket_axis(p)}, "
            f"{_bracket_sense(p, v)}"
        ),
        lambda p: f"the first hinge of leg {p.leg} is turned about {_bracket_axis(p)}",
        "the first hinges of the legs are turned on their carriages",
        confirm=lambda p, v: (
            f"hold a square between carriage {p.leg} and the first hinge of its leg: expect the "
            f"hinge {mrad(v)} off about {_bracket_axis(p)}, {_bracket_sense(p, v)}"
        ),
    ),
)

RAIL_TORSION = Effect(
    "rail_torsion",
    RAD,
    2e-3,
    because="an extrusion is twisted by a tenth of a degree over its length",
    sentence="the rail is twisted: its carriage turns about it as it travels",
    look_at="the tower's extrusion, with a square against its face at both ends",
    members=once(Motion("turn_a", lambda c: c.u)),
    words=Words(
        lambda p, v: (
            f"the {p.leg} rail is twisted: from one end of the stroke to the other its carriage "
            f"turns by {mrad(2 * v)} about it, "
            f"{sign_word(v, 'counter-clockwise', 'clockwise')} on the way up"
        ),
        lambda p: f"the {p.leg} rail is twisted along its length",
        "the rails are twisted along their lengths",
        lambda v: mrad(2 * v),
        lambda p, v: (
            f"hold a square to carriage {p.leg} at both ends of its stroke: expect it to turn by "
            f"{mrad(2 * v)} about the rail"
        ),
    ),
)

EFFECTS = (AXIS_OFFSET, AXIS_TILT, RAIL_TILT, RAIL_BOW, MOUNT_TILT)
DELTA_EFFECTS = (RAIL_TORSION,)
"""Where rails stand free: those of an Orthoglide lie on their beds."""
