"""Free-form errors at one travel or one moment alone, waves of one period, and errors by name."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, product

from orthoglide.effects.catalogue import Catalogue
from orthoglide.effects.free_form import FreeForm, Session, free_forms, scaled_to_machine
from orthoglide.effects.free_form_place import Part, Range
from orthoglide.effects.kernels import Bump, Step, Wave
from orthoglide.geometry import LEGS, Geometry
from orthoglide.layout import LegNames

_UM = 1e-6

_MIN_STEP_WIDTH = 12.0
"""Least width of a step of a calibrated machine, in prior standard deviations of its height. An
active step has 10 at most, so the carriage still moves on as the command does. A wider one would
contradict the readings at stations closer than that."""


def jumping(form: FreeForm) -> tuple[FreeForm, ...]:
    """Return the errors that jump, at a moment or at a place of the travel, if a free-form error
    may; a place where a drive steps may be passed in both directions or in one.

    One bar snaps, one drive loses steps, or its linear encoder is joined of two pieces; several
    parts do not jump at the same moment, and no screw changes its pitch at once.
    """
    if form.against == "time":
        single_part = form.leg >= 0 and (form.part == "drive" or bool(form.direction))
        return (form,) if single_part and not form.is_line else ()
    if form.part != "drive" or form.against not in ("travel", "approach") or form.short_waves:
        return ()
    if form.against == "travel":
        return (form,)
    # As high as a step that is passed in both directions, and a quarter as frequent each way.
    sd, chance = 2 * form.prior_sd, 0.25
    return tuple(replace(form, side=side, prior_sd=sd, chance=chance) for side in (1, -1))


def with_jump(form: FreeForm, jump: Range, stroke: Range) -> FreeForm:
    """Return a free-form error with a jump between two moments or travels in place of its curve.

    ``stroke``: first and last travel, metres.
    """
    start, end = form.interval(stroke)
    low, high = (2 * (at - start) / (end - start) - 1 for at in jump)
    least = None if form.against == "time" else 2 * _MIN_STEP_WIDTH * form.prior_sd / (end - start)
    return replace(form, kernel=Step(low, high, least), jump=jump)


def with_period(form: FreeForm, period: float, stroke: Range) -> FreeForm:
    """Return a free-form error with a wave of one period, metres, in place of its short waves."""
    period = round(period, 7)  # as its name has it
    return replace(form, kernel=Wave((stroke[1] - stroke[0]) / period), period=period)


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
    """Return the bumps of drives and rails at given travels of each leg, metres from mechanical
    zero; ``scale``: size of the machine relative to a workshop's.
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
    """Return a dial's curve as its error about one reading alone, metres, one of ``count`` possible
    ones, among which the prior probability is divided; ``width``: its standard deviation, metres.
    """
    low, high = form.span or (0.0, 1.0)
    half = (high - low) / 2
    bump = Bump((reading - low) / half - 1, width / half)
    return replace(form, kernel=bump, bump=reading, prior_sd=_DIAL_BUMP_HEIGHT, chance=1 / count)


_TRAVEL = r"_?\d+(?:_\d)?"  # millimetres, in the name of an effect


def _travel(text: str) -> float:
    """Return a travel in the name of an effect, metres."""
    return float(re.sub("^_", "-", text).replace("_", ".")) * 1e-3


def _bump_travel(effects: Iterable[str]) -> set[float]:
    """Return the travel of the bumps among names of effects, metres; see `FreeForm.name`."""
    matches = (re.fullmatch(rf".*_travel_({_TRAVEL})(?:w\d+)?", name) for name in effects)
    return {_travel(match[1]) for match in matches if match}


def _waves(effects: Iterable[str], forms: Iterable[FreeForm], stroke: Range) -> Iterator[FreeForm]:
    """Yield the waves of one period among names of effects; see `FreeForm.name`."""
    for form, name in product(forms, sorted(effects)):
        match = re.fullmatch(rf"{form.effect.name}_(\d+_\d{{4}})", name)
        if match and form.short_waves and (period := _travel(match[1])):
            yield with_period(form, period, stroke)


def _jumps(effects: Iterable[str], forms: Iterable[FreeForm], stroke: Range) -> Iterator[FreeForm]:
    """Yield the jumps of free-form errors among names of effects; see `FreeForm.name`."""
    for form, name in product(chain(*map(jumping, forms)), sorted(effects)):
        spot = name.removeprefix(f"{form.effect.name}_")
        if match := re.fullmatch(r"(\d+)s|order(\d+)", spot):
            moment = float(match[1] or match[2])
            yield with_jump(replace(form, timed=match[1] is not None), (moment, moment), stroke)
        elif match := re.fullmatch(f"({_TRAVEL})to({_TRAVEL})(?:up|down)?", spot):
            start, end = _travel(match[1]), _travel(match[2])
            if start < end and start < stroke[1] and end > stroke[0]:  # else no such name
                yield with_jump(form, (start, end), stroke)


def with_free_forms(catalogue: Catalogue, names: Iterable[str], geometry: Geometry) -> Catalogue:
    """Return a catalogue with those free-form errors of a machine that parameters name."""
    wanted = {name.partition(".")[0] for name in names} - set(catalogue)
    if not wanted:
        return catalogue
    machine = catalogue.legs, geometry.stroke, geometry.scale
    forms = free_forms(Session(0.0, 1.0), *machine)  # a jump is the same in any session
    jumps = _jumps(wanted, forms, geometry.stroke)
    waves = _waves(wanted, forms, geometry.stroke)
    bumps = travel_bumps([_bump_travel(wanted)] * len(LEGS), *machine)
    forms = (*forms, *bumps, *jumps, *waves)
    return catalogue.with_effects(form.effect for form in forms if form.effect.name in wanted)
