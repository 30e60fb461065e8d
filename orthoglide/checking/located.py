"""Errors that are located in one of two states of a machine, or in both."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from orthoglide.closing import RunOutcome
from orthoglide.effects import Effect
from orthoglide.explanation.change import SIGNIFICANT_SIGMAS, Change
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter, effect_name
from orthoglide.result import Curve, Located


class SizedError(NamedTuple):
    """An error that was located in either state and has a size in both."""

    shape: Effect  # with the shape of the old state, or of the new one if it is located there alone
    curve: Curve  # with that shape
    posterior: Posterior  # of the machine in that state
    old: Located | None  # as located in the old state
    new: Located | None  # as located in the new state
    rivals: tuple[str, ...]  # the other places where it may be, a clause each


def errors_with_size(before: RunOutcome, now: RunOutcome) -> Iterator[SizedError]:
    """Yield the errors located in either state that one parameter represents, each once."""
    matched = set[int]()
    for old in filter(_has_one_shape, before.located):
        curves = _curves_of_one_shape(old)
        curve, new = curves[0], None
        for member, (k, other) in product(curves, enumerate(now.located)):
            if k not in matched and any(_resemble(member, one) for one in other.members):
                curve, new = member, other
                matched.add(k)
                break
        yield _sized(curve, before, old, new)
    for k, new in enumerate(now.located):
        if k not in matched and _has_one_shape(new):
            yield _sized(_curves_of_one_shape(new)[0], now, None, new)


def _sized(curve: Curve, state: RunOutcome, old: Located | None, new: Located | None) -> SizedError:
    shape = curve.place.shape_effect(curve.coefficients)
    located = new or old
    members = () if located is None else located.members
    rivals = tuple(m.place.words for m in members if m.place.words != curve.place.words)
    return SizedError(shape, curve, state.machine.posterior, old, new, rivals)


def with_uncertain_shapes(
    differences: Sequence[Change], errors: Iterable[SizedError]
) -> Iterator[Change]:
    """Yield the differences of a fit of all readings with the uncertainty of the shapes that errors
    have in it. Those of parameters that it may account for are no changes.

    Readings do not show a curve between their stations, nor tell its level from a zero of the same
    drive. A curve c + e that was found as c, and whose size changed by a share of c, leaves that
    share of e in the other parameters.
    """
    difference_of = {d.parameter.effect: d.difference for d in differences}
    sized = [
        (one, difference_of[one.shape.name] / one.curve.size)
        for one in errors if one.shape.name in difference_of
    ]  # fmt: skip
    names = {one.shape.name for one, _ in sized}
    changed = {d.parameter for d in differences if d.changed}
    for one in differences:
        free = {one.parameter, *changed}
        added = math.hypot(*(s * _shape_sigma(e, one.parameter, free) for e, s in sized))
        # A size is certain to have changed by a share of itself, whatever that size is.
        is_size = one.parameter.effect in names
        exceeds = is_size or abs(one.difference) > SIGNIFICANT_SIGMAS * added
        changed_too = one.changed and exceeds
        yield replace(one, sigma=math.hypot(one.sigma, added), changed=changed_too)


def _shape_sigma(error: SizedError, parameter: Parameter, free: Collection[Parameter]) -> float:
    """Return the standard deviation, SI, that the shape of an error adds to its size, or to a
    parameter that is estimated beside it while all others but the ``free`` ones are known.
    """
    posterior, effect = error.posterior, error.shape.name
    if parameter.effect == effect:
        return error.curve.size_sigma
    if parameter not in posterior.names:
        return 0.0
    coefficients = [name for name in posterior.names if effect_name(name) == effect]
    others = [name for name in posterior.names if name not in (*coefficients, *free)]
    variances = (
        float(posterior.regression([parameter], given)[1][0, 0])
        for given in (others, [*others, *coefficients])
    )
    return math.sqrt(max(next(variances) - next(variances), 0.0))


def gone_and_come(
    errors: Iterable[SizedError], changed: Iterable[Change]
) -> tuple[tuple[Located, ...], tuple[Located, ...], set[str]]:
    """Return the errors whose size changed to zero, those whose size was zero before, and the names
    of the effects of both.
    """
    change_of = {change.parameter.effect: change for change in changed}
    gone, come, names = list[Located](), list[Located](), set[str]()
    for shape, _, _, old, new, _ in errors:
        if (change := change_of.get(shape.name)) is None:
            continue
        if old is not None and change.is_zero(change.after):
            gone.append(old)
        elif new is not None and change.is_zero(change.before):
            come.append(new)
        else:
            continue
        names.add(shape.name)
    return tuple(gone), tuple(come), names


def _curves_of_one_shape(located: Located) -> list[Curve]:
    return [member for member in located.members if member.place.has_one_shape]


def _has_one_shape(located: Located) -> bool:
    return bool(_curves_of_one_shape(located))


def located_only_in_first(first: RunOutcome, second: RunOutcome) -> tuple[Located, ...]:
    """Return the errors located in the first state, of those that no size represents, that no
    located error and no cause at the same leg explains in the second; none unless dials read both
    states at the same places.
    """
    if not _places_read(first) or _places_read(first) != _places_read(second):
        return ()
    curves = [curve for located in second.located for curve in located.members]
    legs = {
        second.catalogue.parameter(n).leg for cause in second.effects for n in cause.all_parameters
    }
    return tuple(
        located
        for located in first.located
        if not _has_one_shape(located)
        and not any(_resemble(one, other) for one, other in product(located.members, curves))
        and legs.isdisjoint(curve.leg for curve in located.members)
    )


def resized(before: RunOutcome, now: RunOutcome) -> Iterator[tuple[Curve, Curve]]:
    """Yield a curve of either state for errors that no size represents and that are located in
    both, where their sizes differ significantly.
    """
    for old, new in product(before.located, now.located):
        pairs = product(old.members, new.members)
        if not _has_one_shape(old) and (pair := next((p for p in pairs if _resemble(*p)), None)):
            first, second = pair
            sigma = math.hypot(first.size_sigma, second.size_sigma)
            if abs(second.size - first.size) > SIGNIFICANT_SIGMAS * sigma:
                yield pair


def _resemble(one: Curve, other: Curve) -> bool:
    """Return whether both have one name, or move one part alike: with a squared correlation above
    one half, of either sign.
    """
    if one.name == other.name:
        return True
    if one.place.location_key != other.place.location_key:
        return False
    at = np.union1d(one.at, other.at)
    first, second = (np.interp(at, curve.at, curve.value) for curve in (one, other))
    return bool((first @ second) ** 2 > (first @ first) * (second @ second) / 2)


def _places_read(closed: RunOutcome) -> set[tuple[float, ...]]:
    """Return the setups and commands of all dials; gauges are rounded to a millimetre, commands to
    a tenth of one.
    """
    return {
        (s.leg, s.axis, s.bar, round(s.gauge, 3), *command)
        for campaign in closed.request.campaigns
        for k, command in zip(campaign.setup, np.round(campaign.command, 4).tolist(), strict=True)
        for s in (campaign.setups[k],)
    }


def located_words(located: Located) -> str:
    """Return the likeliest place of a located error, and its alternatives."""
    first, *others = located.members
    alternatives = [f"{len(others)} other place{'s' * (len(others) > 1)}"] if others else []
    alternatives += ["a fault of the readings"] if located.data else []
    rivals = f" (or {', or '.join(alternatives)})" if alternatives else ""
    return f"{first.words}{rivals}"
