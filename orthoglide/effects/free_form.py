"""Free-form errors: parts of the machine that move in a way that no effect describes.

A free-form error is a free function that moves virtual joints of one leg. Its level and slope are
kept, so the effects of the catalogue compete with them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np

from orthoglide.effects import free_form_words, kernels
from orthoglide.effects.effect import Effect, LegConditions, Members, Motion
from orthoglide.effects.free_form_place import FreeFormPlace, Part, Range
from orthoglide.effects.kernels import Kernel, Step
from orthoglide.geometry import LEGS, Array
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.units import MM, RAD

_UM = 1e-6


class FreeForm(FreeFormPlace):
    """A part of the machine, and the free function by which it moves."""

    @cached_property
    def sampled(self) -> tuple[Array, Array]:
        """Values of its variable, from -1 to 1 over its interval ``(n,)``, and its functions there
        for coefficients of unit variance ``(n, k)``, without a mean that zeros absorb.
        """
        u = kernels.sample_points(self.kernel, self.short_waves)
        functions = np.stack(self.kernel.functions(u), axis=1)
        return u, functions if self.has_level else functions - functions.mean(axis=0)

    def size(self, value: Array) -> float:
        """Return the size of its values at `sampled` ``(n,)``: the largest of a bump, jump or
        change with time, with its sign; the range after a reversal, the root mean square difference
        of both approaches, and else the root mean square about the mean, of a line with its sign.
        """
        if self.is_local or self.against == "time":
            return float(value[np.abs(value).argmax()])
        if self.against == "approach":
            return float(np.sqrt(np.mean(value**2)))
        slope = np.sign(value[-1] - value[0]) if self.is_line else 1.0
        return float(np.ptp(value) if self.against == "reversal" else slope * np.std(value))

    def size_sigma(self, value: Array, covariance: Array) -> float:
        """Return the root mean square error of `size` as that of uncertain values.

        Of a root mean square r over n points it is that of a length: with t the mean variance and v
        the variance of r to first order, the mean of r'^2 is r^2 + t, and that of r' the root of
        r^2 + t - v. So it contains the waves that readings do not show, and r lacks.

        ``value``: mean at `sampled` ``(n,)``; ``covariance``: of the values ``(n, n)``.
        """
        if self.is_local or self.against == "time":
            k = np.abs(value).argmax()
            return float(np.sqrt(covariance[k, k]))
        if self.against == "reversal":
            high, low = value.argmax(), value.argmin()
            variance = covariance[high, high] + covariance[low, low] - 2 * covariance[high, low]
            return float(np.sqrt(variance))
        square, count = float(np.mean(value**2)), len(value)
        both = square + float(np.trace(covariance)) / count
        along = float(value @ covariance @ value) / max(count**2 * square, 1e-300)
        return math.sqrt(square + both - 2 * math.sqrt(square * max(both - along, 0.0)))

    def size_of(self, values: Mapping[str, float]) -> float:
        """Return its size by the values of its effect's parameters, SI, by their numbers."""
        if "" in values:  # of `shape_effect`, whose parameter is its size
            return values[""]
        _, functions = self.sampled
        mean = [values.get(str(k + 1), 0.0) for k in range(functions.shape[1])]
        return self.size(functions @ mean)

    @cached_property
    def effect(self) -> Effect:
        """The effect with one parameter a coefficient, for a machine that has this error."""
        kernel = self.kernel.lasting if isinstance(self.kernel, Step) else self.kernel
        lasting = replace(self, kernel=kernel)
        coefficients = {str(k + 1): {k: 1.0} for k in range(kernel.count)}
        return lasting._effect(partial(_members, lasting, coefficients))

    def shape_effect(self, coefficients: Array) -> Effect:
        """Return the effect of the error with the shape that it was found with: its one parameter
        is its size. A jump in time recurs in every campaign.

        ``coefficients``: its mean ``(k,)``, in their prior standard deviations.
        """
        size = self.size(self.sampled[1] @ coefficients)
        shape = {"": dict(enumerate((coefficients / size).tolist()))}
        return self._effect(partial(_members, self, shape))

    def _effect(self, members: Members) -> Effect:
        unit = RAD if self.is_rotation else MM
        name = re.sub(r"\W", "_", self.name)  # a setup may be called anything
        because = "what no known shape explains is a few hundredths"
        return Effect(
            name, unit, self.prior_sd / unit.si, because, self.words, self.look_at, members,
            free_form_words.effect_words(self), paired=True, names=self.names, size_of=self.size_of,
        )  # fmt: skip

    @property
    def words(self) -> str:
        """Clause with the location and the kind of the error, without its size."""
        return free_form_words.clause(self)

    @property
    def look_at(self) -> str:
        """What to look at on the machine."""
        return free_form_words.look_at(self)

    def functions(self, conditions: LegConditions, which: slice = slice(None)) -> list[Any]:
        """The free functions at these conditions, for coefficients of unit variance."""
        if self.against == "reversal":
            return list(conditions.built_up[which])
        values = self.kernel.functions(self._variable(conditions), which)
        if self.against == "approach":
            share = (abs(self.side) + (self.side or 1) * conditions.approach) / 2
            return [value * share for value in values]
        if self.part == "screw":
            half = (conditions.stroke[1] - conditions.stroke[0]) / 2
            return [value * (conditions.nominal_travel / half) for value in values]
        return values

    def _variable(self, c: LegConditions) -> Any:
        """Return what it depends on, from -1 to 1 over the stroke or the session.

        It is the carriage's travel or, of a drive, a command; a time is constant outside of the
        session.
        """
        if self.against == "time":
            start, end = self.span or (0.0, 1.0)
            position = (c.time - start) / max((end - start) / 2, 1e-9) - 1
            return (abs(position + 1) - abs(position - 1)) / 2  # of symbols too
        if self.part != "drive":
            return c.u
        drive = self.command_drive if self.against == "command" else self.leg
        return c.over_stroke(c.commands[drive] - c.command + c.nominal_travel)


def _members(
    form: FreeForm, parameters: Mapping[str, Mapping[int, float]], leg: int
) -> Mapping[str, tuple[Motion, ...]]:
    """Return the members of the effect of an error: parameters with weights of its functions."""
    return {
        name: tuple(Motion(j, partial(_basis, form, weights, share)) for j, share in form.joints)
        for name, weights in parameters.items()
        if leg == form.leg
    }


def _basis(
    form: FreeForm, weights: Mapping[int, float], share: float, conditions: LegConditions
) -> Any:
    parts = (w * form.functions(conditions, slice(k, k + 1))[0] for k, w in weights.items())
    return share * sum(parts)


_SCREW_GROWTH = 10 * _UM  # half a stroke of steel, 80 mm, that warms by ten kelvin
# Linear warming of a drive is as frequent as that of bars, which is a cause of the catalogue: ten
# times as frequent as a free-form error.
_WARMTH_CHANCE = 10.0


@dataclass(frozen=True)
class Session:
    """The time interval of a measurement."""

    start: float  # first moment
    end: float  # last moment
    timed: bool = True  # whether moments are seconds; else they count the readings


def free_forms(
    session: Session | None = None,
    names: LegNames = Orthoglide.names,
    stroke: Range = (-kernels.LENGTH, kernels.LENGTH),
    scale: float = 1.0,
) -> tuple[FreeForm, ...]:
    """Return all free-form errors of a machine, of its size relative to a workshop's; without a
    session, nothing changes with time.
    """
    half = (stroke[1] - stroke[0]) / 2
    forms: list[FreeForm] = []
    for leg in range(len(LEGS)):
        for form in _leg_forms(leg):
            forms.append(form)
            if form.against == "travel" and form.part != "platform" and not form.is_line:
                of_drive = form.part == "drive"
                kernel = kernels.SCREW if of_drive else kernels.short_wave_kernel(half)
                forms.append(replace(form, kernel=kernel, short_waves=True))
    if session is not None:
        forms += _time_dependent_forms(session)
    return tuple(scaled_to_machine(replace(form, names=names), scale) for form in forms)


def _leg_forms(leg: int) -> Iterator[FreeForm]:
    """Yield the free-form errors of one leg that do not depend on time, without short waves."""
    yield FreeForm("drive", leg, "", "travel", kernels.DRIVE, 100 * _UM)
    yield FreeForm("drive", leg, "", "approach", kernels.LOST)
    yield FreeForm("drive", leg, "", "reversal", kernels.BUILD_UP)
    for other, kernel in product(range(len(LEGS)), (kernels.ACROSS, kernels.LINE)):
        if other != leg:
            yield FreeForm("drive", leg, "", "command", kernel, command_drive=other)
    # A straight line of the rail is a tilt of its axis, which has a name.
    kernels_of: dict[Part, Kernel] = {"rail": kernels.FINE, "platform": kernels.FINE_AND_LINE}
    for axis in "bc":
        for part, kernel in kernels_of.items():
            yield FreeForm(part, leg, axis, "travel", kernel)
            yield FreeForm(part, leg, axis, "approach", kernels.COARSE)
    for axis, kernel in product("abc", (kernels.ACROSS, kernels.LINE)):
        yield FreeForm("carriage", leg, axis, "travel", kernel, 1e-3)
    for bar in "12":
        yield FreeForm("bar", leg, bar, "approach", kernels.COARSE)


def _time_dependent_forms(session: Session) -> Iterator[FreeForm]:
    """Yield what changes in a session: one bar or both of a leg, one drive or all alike."""
    span = session.start, session.end
    form = partial(FreeForm, against="time", span=span, timed=session.timed)
    for leg in range(len(LEGS)):
        for bars in ("1", "2", ""):
            yield form("bar", leg, bars, kernel=kernels.DRIFT)
    for leg in (-1, *range(len(LEGS))):  # -1: all drives alike
        drift = form("drive", leg, "", kernel=kernels.DRIFT, prior_sd=100 * _UM)
        for warm in (drift, replace(drift, part="screw", prior_sd=_SCREW_GROWTH)):
            yield warm
            yield replace(warm, kernel=kernels.STEADY, chance=_WARMTH_CHANCE)


def scaled_to_machine(form: FreeForm, scale: float) -> FreeForm:
    """Return a free-form error with its prior scaled to a machine's size; angles do not scale."""
    return form if form.is_rotation else replace(form, prior_sd=form.prior_sd * scale)
