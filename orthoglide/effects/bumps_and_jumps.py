"""Free-form errors at one travel or one moment alone, and free-form errors by name."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import product

from orthoglide.effects.catalogue import Catalogue
from orthoglide.effects.free_form import (
    FreeForm,
    Part,
    Range,
    Session,
    free_forms,
    scaled_to_machine,
)
from orthoglide.effects.kernels import Bump, Jump
from orthoglide.geometry import LEGS, Geometry
from orthoglide.layout import LegNames

_UM = 1e-6


def may_jump(form: FreeForm) -> bool:
    """Return whether a free-form error that changes with time may also jump.

    One bar snaps, or one drive loses steps; several parts do not jump at the same moment, and no
    scale does.
    """
    single_part = form.leg >= 0 and (form.part == "drive" or bool(form.direction))
    return form.against == "time" and single_part and not form.is_line


def with_jump(form: FreeForm, moment: float) -> FreeForm:
    """Return a free-form error that changes with time, with a jump instead of a slow change."""
    start, end = form.span or (0.0, 1.0)
    jump = Jump(2 * (moment - start) / (end - start) - 1)
    return replace(form, kernel=jump, jump=moment)


_BUMP_WIDTHS: dict[Part, tuple[float, ...]] = {"drive": (0.008,), "rail": (0.008, 0.016, 0.032)}
"""Standard deviations of a bump along the travel, metres: the first is typical of dirt, a dent or a
joint between two rails. Each is twice the one before: a bell of another width between them has a
correlation of at least 0.97 with the nearest. The last is as wide as smooth paths of a rail are
correlated; the smooth error of a drive is finer and contains wide bumps."""

_TRAVEL_BUMP_HEIGHT = 30 * _UM
"""Metres: prior standard deviation of the height; one millimetre would have been noticed."""


def travel_bumps(
    travel: Sequence[Collection[float]], names: LegNames, stroke: Range, scale: float = 1.0
) -> tuple[FreeForm, ...]:
    """Return the bumps of drives and rails at given travels.

    Args:
        travel: of the bumps of each leg, metres from mechanical zero.
        names: of the legs.
        stroke: first and last travel, metres.
        scale: size of the machine relative to a workshop's.
    """
    middle, half = (stroke[0] + stroke[1]) / 2, (stroke[1] - stroke[0]) / 2
    candidates: tuple[tuple[Part, str], ...] = (("drive", ""), ("rail", "b"), ("rail", "c"))
    forms: list[FreeForm] = []
    for leg, positions in enumerate(travel):
        for position, (part, axis) in product(positions, candidates):
            widths = _BUMP_WIDTHS[part]
            for width in (scale * width for width in widths):
                form = FreeForm(part, leg, axis, "travel",
                                Bump((position - middle) / half, width / half), _TRAVEL_BUMP_HEIGHT,
                                bump=position, wide=0.0 if width == scale * widths[0] else width,
                                names=names, chance=1 / len(positions) / len(widths))  # fmt: skip
                forms.append(scaled_to_machine(form, scale))
    return tuple(forms)


DIAL_BUMP_WIDTHS = (0.03e-3, 0.1e-3)
"""Metres: standard deviations of a bump over the readings of a dial: three graduations of a
hundredth (a tooth of its rack or dirt on it), and the shortest bend of its smooth curve."""

_DIAL_BUMP_HEIGHT = 10 * _UM
"""Metres: prior standard deviation of the height of such a bump. A dial's standard (DIN 878) allows
17 um over all of its range; a tenth of a millimetre would stop the hand and be noticed."""


def with_dial_bump(form: FreeForm, reading: float, width: float, count: int) -> FreeForm:
    """Return the error of a dial about one reading alone.

    Args:
        form: the dial's curve by its reading.
        reading: the reading, metres.
        width: standard deviation of the bump, metres.
        count: number of possible readings, among which the prior probability is divided.
    """
    low, high = form.span or (0.0, 1.0)
    half = (high - low) / 2
    bump = Bump((reading - low) / half - 1, width / half)
    return replace(form, kernel=bump, bump=reading, prior_sd=_DIAL_BUMP_HEIGHT, chance=1 / count)


def _bump_travel(effects: Iterable[str]) -> set[float]:
    """Return the travel of the bumps among names of effects, metres; see `FreeForm.name`."""
    positions = set()
    for name in effects:
        if match := re.fullmatch(r".*_travel_(_?)(\d+)(?:_(\d))?(?:w\d+)?", name):
            distance = float(f"{match[2]}.{match[3] or 0}") * 1e-3
            positions.add(-distance if match[1] else distance)
    return positions


def _jumps(effects: Iterable[str], names: LegNames) -> tuple[FreeForm, ...]:
    """Return the jumps at the moments among names of effects; see `FreeForm.name`."""
    matches = (re.fullmatch(r".*_time_(?:(\d+)s|order(\d+))", name) for name in effects)
    moments = {(m[1] is not None, float(m[1] or m[2])) for m in matches if m}
    return tuple(
        with_jump(form, moment)
        for timed, moment in sorted(moments)
        for form in free_forms(Session(0.0, 1.0, timed), names)  # a jump is the same in any session
        if may_jump(form)
    )


def with_free_forms(catalogue: Catalogue, names: Iterable[str], geometry: Geometry) -> Catalogue:
    """Return a catalogue with those free-form errors of a machine that parameters name."""
    wanted = {name.partition(".")[0] for name in names} - set(catalogue)
    if not wanted:
        return catalogue
    forms = free_forms(None, catalogue.legs, geometry.stroke, geometry.scale)
    forms += travel_bumps([_bump_travel(wanted)] * len(LEGS), catalogue.legs, geometry.stroke,
                   geometry.scale)  # fmt: skip
    forms += _jumps(wanted, catalogue.legs)
    return catalogue.with_effects(form.effect for form in forms if form.effect.name in wanted)
