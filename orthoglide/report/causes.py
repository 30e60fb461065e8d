"""Causes in a mechanic's words: what is wrong, by how much, toward where."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from orthoglide.effects import family_of
from orthoglide.geometry import LEGS
from orthoglide.numerals import MINUS, compact

Said = Callable[[str, str, float], str]


@dataclass(frozen=True)
class Words:
    """How to speak of a family.

    Attributes:
        one: clause for a single parameter, from leg (or setup), what stands behind it, and value.
        short: the same cause without its size, from leg and what stands behind it.
        many: clause for all legs together, without its size.
        size: how a size is said.
    """

    one: Said
    short: Callable[[str, str], str]
    many: str
    size: Callable[[float], str]


def mm(value: float) -> str:
    """A length, SI, as ``0.123 mm``."""
    return f"{compact(abs(value) * 1e3, 2)} mm"


def mrad(value: float) -> str:
    """An angle, SI, as ``2.5 mrad``."""
    return f"{compact(abs(value) * 1e3, 2)} mrad"


def slope(value: float) -> str:
    """A slope, SI, as a mechanic measures it: ``2.5 mrad (0.25 mm over 100 mm)``."""
    return f"{mrad(value)} ({compact(abs(value) * 100, 2)} mm over 100 mm)"


def percent(value: float) -> str:
    """A ratio as ``0.3 %``."""
    return f"{compact(abs(value) * 100, 2)} %"


def _toward(axis: str, value: float) -> str:
    return axis if value >= 0 else f"{MINUS}{axis}"


def _more(value: float, more: str = "more", less: str = "less") -> str:
    return more if value >= 0 else less


_ABOUT = {"a": "the leg's own axis", "b": "its pivots"}

FAMILIES: Mapping[str, Words] = {
    "joint_offset": Words(
        lambda leg, _, v: f"the zero of drive {leg} is {mm(v)} off",
        lambda leg, _: f"the zero of drive {leg} is off",
        "the zeros of the drives are off",
        mm,
    ),
    "leg_length": Words(
        lambda leg, _, v: (
            f"the bars of leg {leg} are {mm(v)} {_more(v, 'longer', 'shorter')} than nominal"
        ),
        lambda leg, _: f"the bars of leg {leg} are not of nominal length",
        "the bars of the legs are not of nominal length",
        mm,
    ),
    "axis_offset": Words(
        lambda leg, j, v: f"the {leg} rail stands {mm(v)} beside its place, toward {_toward(j, v)}",
        lambda leg, j: f"the {leg} rail stands beside its place toward {j}",
        "the rails stand beside their places",
        mm,
    ),
    "axis_tilt": Words(
        lambda leg, j, v: (
            f"the path of the {leg} carriage is out of square toward {_toward(j, v)} by {slope(v)}"
        ),
        lambda leg, j: f"the path of the {leg} carriage is out of square toward {j}",
        "the paths of the carriages are out of square",
        slope,
    ),
    "rail_tilt": Words(
        lambda leg, j, v: (
            f"the {leg} rail leans toward {_toward(j, v)} by {slope(v)} and its carriage with it"
        ),
        lambda leg, j: f"the {leg} rail leans toward {j} and its carriage with it",
        "the rails lean and their carriages with them",
        slope,
    ),
    "rail_bow": Words(
        lambda leg, j, v: (
            f"the {leg} rail is bent: its middle stands {mm(v)} toward {_toward(j, -v)} "
            f"off the line between its ends"
        ),
        lambda leg, j: f"the {leg} rail is bent in the direction of {j}",
        "the rails are bent",
        mm,
    ),
    "mount_tilt": Words(
        lambda leg, about, v: (
            f"the first hinge of leg {leg} is turned by {mrad(v)} about {_ABOUT[about]}"
        ),
        lambda leg, about: f"the first hinge of leg {leg} is turned about {_ABOUT[about]}",
        "the first hinges of the legs are turned on their carriages",
        mrad,
    ),
    "bar_mismatch": Words(
        lambda leg, _, v: (
            f"bar 1 of leg {leg} is {mm(v)} {_more(v, 'longer', 'shorter')} than bar 2"
        ),
        lambda leg, _: f"the two bars of leg {leg} differ in length",
        "the two bars of each leg differ in length",
        mm,
    ),
    "parallelogram_width": Words(
        lambda leg, _, v: (
            f"the short link of leg {leg} at the platform is {mm(v)} "
            f"{_more(v, 'wider', 'narrower')} than the one at the carriage"
        ),
        lambda leg, _: f"the two short links of leg {leg} differ",
        "the short links at the platform differ from those at the carriages",
        mm,
    ),
    "encoder_scale": Words(
        lambda leg, _, v: f"drive {leg} moves {percent(v)} {_more(v)} than it is told",
        lambda leg, _: f"drive {leg} moves more or less than it is told",
        "the drives move more or less than they are told",
        percent,
    ),
    "screw_error": Words(
        lambda leg, _, v: f"drive {leg} runs {mm(v)} ahead and behind once a turn of its screw",
        lambda leg, _: f"drive {leg} runs ahead and behind once a turn of its screw",
        "the drives run ahead and behind once a turn of their screws",
        mm,
    ),
    "backlash": Words(
        lambda leg, _, v: (
            f"drive {leg} has {mm(v)} of lost motion"
            + ("" if v >= 0 else " with the wrong sign: look at the order of the readings")
        ),
        lambda leg, _: f"drive {leg} has lost motion",
        "the drives have lost motion",
        mm,
    ),
    "drive_compliance": Words(
        lambda leg, _, v: f"drive {leg} gives way by {compact(abs(v) * 1e6, 2)} µm a newton",
        lambda leg, _: f"drive {leg} gives way under the load",
        "the drives give way under the load",
        lambda v: f"{compact(abs(v) * 1e6, 2)} µm a newton",
    ),
    "thermal_growth": Words(
        lambda leg, _, v: (
            f"the bars of leg {leg} {_more(v, 'grow', 'shrink')} by "
            f"{compact(abs(v) * 1e6, 2)} µm a metre and kelvin"
        ),
        lambda leg, _: f"the bars of leg {leg} grow with temperature",
        "the bars grow with temperature",
        lambda v: f"{compact(abs(v) * 1e6, 2)} µm a metre and kelvin",
    ),
    "thermal_drift": Words(
        lambda leg, _, v: (
            f"the bars of leg {leg} {_more(v, 'grow', 'shrink')} by "
            f"{compact(abs(v) * 3600e6, 2)} µm a metre and hour"
        ),
        lambda leg, _: f"the bars of leg {leg} grow as time goes on",
        "the bars grow as time goes on",
        lambda v: f"{compact(abs(v) * 3600e6, 2)} µm a metre and hour",
    ),
    "gauge_scale": Words(
        lambda setup, _, v: f"the dial of {setup} shows {percent(v)} {_more(v)} than it is moved",
        lambda setup, _: f"the dial of {setup} shows more or less than it is moved",
        "the dials show more or less than they are moved",
        percent,
    ),
    "gauge_direction": Words(
        lambda setup, _, v: f"the dial of {setup} is turned by {mrad(v)} about the leg",
        lambda setup, _: f"the dial of {setup} is turned about the leg",
        "the dials are turned about their legs",
        mrad,
    ),
    "gauge_drift": Words(
        lambda setup, _, v: f"the stand of {setup} creeps by {mm(v * 3600)} an hour",
        lambda setup, _: f"the stand of {setup} creeps",
        "the dials' stands creep",
        lambda v: f"{mm(v * 3600)} an hour",
    ),
}
"""How to speak of every family of the catalogue."""


def cause(name: str, values: Mapping[str, float]) -> str:
    """What is wrong, as a clause.

    Args:
        name: of a candidate: a parameter, a structured member, or a family.
        values: of what was identified with it, SI.
    """
    plain, at, stem = name.partition("@")
    where = f" ({stem})" if at else ""
    words = FAMILIES[family_of(name).name]
    if name in values and _single(plain):
        return words.one(*_parts(plain), values[name]) + where
    if name in values:
        return f"{words.many}, {_pattern(plain, values[name], words)}{where}"
    own = {n: v for n, v in values.items() if n.startswith(f"{plain}.")}
    if plain.startswith("screw_error.") and own:  # sine and cosine of one drive
        return words.one(plain.partition(".")[2], "", math.hypot(*own.values())) + where
    sizes = [words.size(v) for v in (min(own.values(), key=abs), max(own.values(), key=abs))]
    return f"{words.many}, from {sizes[0]} to {sizes[1]}{where}" if own else words.many + where


def short(name: str, like: str = "") -> str:
    """The same without its size.

    Args:
        name: of a candidate.
        like: another that was named before: where both follow the same pattern, the pattern is
            not said again.
    """
    plain, at, stem = name.partition("@")
    where = f" ({stem})" if at else ""
    words = FAMILIES[family_of(name).name]
    if plain.startswith("screw_error.") and plain.count(".") == 1 and plain[-1] in LEGS:
        return words.short(plain.partition(".")[2], "") + where
    if _single(plain):
        return words.short(*_parts(plain)) + where
    member = plain.partition(".")[2]
    if member and member == like.partition("@")[0].partition(".")[2]:
        return f"{words.many} in the same way{where}"
    return f"{words.many}{_short_pattern(member)}{where}"


def _short_pattern(member: str) -> str:
    first, _, rest = member.partition(".")
    if first in ("xy", "yz", "zx"):
        alike = "alike" if rest == "symmetric" else "opposite ways"
        return f" ({first[0]} and {first[1]}, {alike})"
    if member.endswith("common"):
        return ", all alike"
    return ", each toward its two neighbours in turn" if member == "cyclic" else ""


def _single(plain: str) -> bool:
    if family_of(plain).group == "dial":
        return "." in plain and not plain.endswith(".common")
    return plain in family_of(plain).parameters()


def _parts(plain: str) -> tuple[str, str]:
    family, _, rest = plain.partition(".")
    if family_of(family).group == "dial":
        return rest, ""
    leg, _, behind = rest.partition(".")
    return leg, behind


def _pattern(plain: str, value: float, words: Words) -> str:
    size = words.size(value)
    member = plain.partition(".")[2].split(".")
    if member[-1] == "cyclic":
        pair = f"{_toward('y', value)} and {_toward('z', -value)}"
        return f"each toward its two neighbours in turn (x toward {pair}), by {size}"
    if member[0] in ("xy", "yz", "zx"):
        one, other = member[0][0], member[0][1]
        back = value if member[1] == "symmetric" else -value
        return f"{one} toward {_toward(other, value)} and {other} toward {_toward(one, back)} " + (
            f"by {size}"
        )
    about = f" about {_ABOUT[member[0]]}" if member[0] in _ABOUT else ""
    sign = "" if value >= 0 else MINUS
    return f"all alike{about}, by {sign}{size}"
