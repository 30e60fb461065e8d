"""Places that are wrong at one travel or one moment alone, and places by the names of effects."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from orthoglide.effects.catalogue import Catalogue
from orthoglide.effects.free_form import (
    FreeForm,
    Joints,
    Part,
    Range,
    command_variable,
    free_forms,
    scaled_to_machine,
    travel_variable,
)
from orthoglide.effects.kernels import Bump, Jump
from orthoglide.geometry import LEGS, Geometry
from orthoglide.layout import LegNames

_UM = 1e-6


def may_jump(place: FreeForm) -> bool:
    """Whether a place that changes with time may also jump.

    One bar snaps, or one drive loses steps; several parts do not jump at the same moment.
    """
    one = place.leg >= 0 and (place.part != "bar" or bool(place.direction))
    return place.against == "time" and one


def with_jump(place: FreeForm, at: float, among: int) -> FreeForm:
    """Return a place with a jump instead of a slow change.

    Args:
        place: that changes with time.
        at: moment of the jump, seconds.
        among: number of moments at which the jump could be; each is that much less probable.
    """
    start, end = place.span or (0.0, 1.0)
    jump = Jump(2 * (at - start) / (end - start) - 1)
    return replace(place, kernel=jump, jump=at, chance=1 / among)


_BUMP_WIDTH = 0.008
"""Standard deviation of a bump along the travel, metres: typical of dirt, a dent or a joint between
two rails. Its height is expected to be a few hundredths of a millimetre, because a bump of one
millimetre would have been noticed."""


def travel_bumps(
    travel: Sequence[Collection[float]],
    names: LegNames,
    stroke: Range,
    scale: float = 1.0,
) -> tuple[FreeForm, ...]:
    """Places that are wrong at one travel alone.

    Args:
        travel: where each leg may have a bump, metres from mechanical zero.
        names: of legs and directions.
        stroke: travel limits of the machine, metres.
        scale: of its size, that of a workshop being 1.
    """
    middle, half = (stroke[0] + stroke[1]) / 2, (stroke[1] - stroke[0]) / 2
    found: list[FreeForm] = []
    for leg, several in enumerate(travel):
        across = dict(zip("bc", names.across[leg], strict=True))
        for at in several:
            bump = Bump((at - middle) / half, _BUMP_WIDTH * scale / half)
            moved: list[tuple[Part, Joints, str, Any]] = [
                ("drive", (("travel", 1.0),), "", partial(command_variable, leg)),
                *(
                    ("rail", ((f"lateral_{a}", 1.0),), way, travel_variable)
                    for a, way in across.items()
                ),
            ]
            for part, joints, way, variable in moved:
                place = FreeForm(part, leg, joints, way, "travel", 0, variable, bump, 30 * _UM,
                              bump=at, names=names, chance=1 / len(several))  # fmt: skip
                found.append(scaled_to_machine(place, scale))
    return tuple(found)


DIAL_BUMP_WIDTHS = (0.03e-3, 0.1e-3)
"""Metres: standard deviations of a bump over the readings of a dial: three graduations of a
hundredth, a tooth of its rack or dirt on it, and as far as its smooth curve does not bend."""

_DIAL_BUMP_HEIGHT = 10 * _UM
"""Metres: height of such a bump. A dial's standard (DIN 878) allows 17 um over all of its range; a
tenth of a millimetre, which ten times this allows, stops the hand and is seen."""


def with_dial_bump(place: FreeForm, at: float, width: float, among: int) -> FreeForm:
    """Return a dial's place that is wrong about one reading alone.

    Args:
        place: the dial's curve by its reading.
        at: the reading, metres.
        width: standard deviation of the bump, metres.
        among: number of readings at which it could be; each is that much less probable.
    """
    low, high = place.span or (0.0, 1.0)
    half = (high - low) / 2
    bump = Bump((at - low) / half - 1, width / half)
    return replace(place, kernel=bump, bump=at, prior_sd=_DIAL_BUMP_HEIGHT, chance=1 / among)


def _bump_travel(effects: Iterable[str]) -> set[float]:
    """Travel of the bumps among names of effects, metres; see :attr:`Place.name`."""
    found = set()
    for name in effects:
        if match := re.fullmatch(r".*_travel_(_?)(\d+)(?:_(\d))?", name):
            size = float(f"{match[2]}.{match[3] or 0}") * 1e-3
            found.add(-size if match[1] else size)
    return found


def with_free_forms(catalogue: Catalogue, names: Iterable[str], geometry: Geometry) -> Catalogue:
    """A catalogue with the places of a machine to which some of the parameters belong."""
    wanted = {name.partition(".")[0] for name in names} - set(catalogue)
    if not wanted:
        return catalogue
    every = free_forms((), catalogue.legs, geometry.stroke, geometry.scale)
    every += travel_bumps([_bump_travel(wanted)] * len(LEGS), catalogue.legs, geometry.stroke,
                   geometry.scale)  # fmt: skip
    return catalogue.with_effects(p.effect for p in every if p.effect.name in wanted)
