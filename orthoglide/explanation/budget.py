"""The error budget: what each cause makes of the readings and of the tool, and what mending gains.

The error counted is the tool's over the workspace that the best zeros and bar lengths of a
controller leave, a shift of the whole removed: what a mechanic can still gain. It is drawn from the
posterior, one explanation or another, so that causes which these readings cannot part are counted
jointly, and one that is there in one case of ten is beyond its tolerance in no more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orthoglide.accuracy import tcp_slopes, without_translation, workspace_commands
from orthoglide.effects.wording import cause_short
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit.scores import rms_by_unit
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.numerals import ByUnit
from orthoglide.ordering import ranked
from orthoglide.result import BudgetItem

_DRAWS = 400
_NO_GAIN = 1e-9  # metres: differences of gain below are rounding, and below anything that matters
_STEPS = 2  # of Gauss-Newton, on a problem that is nearly linear


def budget(posterior: FullPosterior, causes: Mapping[str, Sequence[str]]) -> tuple[BudgetItem, ...]:
    """Rank what is wrong by what mending it gains, largest first: each cause found by itself, what
    is left of an effect together.
    """
    machine = posterior.machine
    known, catalogue, values = machine.posterior, machine.catalogue, machine.values
    base = np.array([catalogue.effect_of(n).name in catalogue.base for n in known.names])
    controller = _Controller.of(machine)
    slopes = without_translation(tcp_slopes(machine, known.names)).reshape(-1, len(known.names))
    slopes = controller.residual(slopes)
    # A translation of the whole makes no shape: what it leaves open is no cause's part.
    _, mean, weights = posterior.machine_parameters(posterior.mean)
    normal = np.random.default_rng(0).standard_normal((_DRAWS, len(known.names)))
    off, now = posterior.mixture.draws(weights, normal) - mean, controller.residual_of(values)
    drawn = now + off @ slopes.T
    total = _mean_length(drawn)
    found = []
    for cause, names, rest in _parameters_by_cause(posterior, causes, known.names, base):
        at = [known.names.index(n) for n in names]
        # Exact at the mean: a bar off by millimetres turns the platform by more than its slope.
        mended = controller.residual_of({n: v for n, v in values.items() if n not in names})
        known_part = now - mended
        part = known_part + off[:, at] @ slopes[:, at].T
        gain = total - _mean_length(drawn - part)
        compensated = total - _mean_length(drawn - known_part)
        tolerance = np.array([machine.tolerance(n) for n in names])
        size, single = np.abs(known.mean[at] + off[:, at]) / tolerance, len(at) == 1
        length, unit = _mean_length(part), catalogue.effect_of(cause).unit
        sigma = float(np.sqrt(known.covariance[at[0], at[0]])) / unit.si
        found.append(
            BudgetItem(
                cause,
                cause_short(catalogue, cause),
                tuple(t for n in names for t in (n, *dict(posterior.linearised.twins.get(n, ())))),
                float(known.mean[at[0]]) / unit.si if single else float("nan"),
                sigma if single else float("nan"),
                unit.name,
                float(np.max(np.abs(known.mean[at]) / tolerance)),
                float(np.mean((size > 1).any(axis=1))),
                _rms_of_readings(posterior, names),
                float(length.mean()),
                float(length.std()),
                float(gain.mean()),
                float(gain.std()),
                float(compensated.mean()),
                float(compensated.std()),
                float(gain.mean() / max(total.mean(), 1e-12)),
                rest,
            )
        )
    by_name = sorted(found, key=lambda item: item.cause)
    return tuple(ranked(by_name, lambda item: item.gain, _NO_GAIN))


def _parameters_by_cause(
    posterior: FullPosterior, causes: Mapping[str, Sequence[str]], names: Sequence[str], base: Array
) -> list[tuple[str, list[str], bool]]:
    """Causes with the machine's parameters that each is made of, none twice, zeros left out, and
    whether it is what is left of an effect: a cause that is a whole family has the effect's name.
    """
    catalogue = posterior.machine.catalogue
    twins = {t for others in posterior.linearised.twins.values() for t, _ in others}
    left = [n for n, b in zip(names, base, strict=True) if not b and n not in twins]
    found: list[tuple[str, list[str], bool]] = []
    for cause, parameters in causes.items():
        parts = set(map(str, catalogue.elementary_machine_values(dict.fromkeys(parameters, 1.0))))
        mine = [n for n in left if n in parts]
        if mine:
            found.append((cause, mine, False))
            left = [n for n in left if n not in parts]
    by_effect: dict[str, list[str]] = {}
    for n in left:
        by_effect.setdefault(catalogue.effect_of(n).name, []).append(n)
    return [*found, *((effect, mine, True) for effect, mine in by_effect.items())]


@dataclass(frozen=True, eq=False)
class _Controller:
    """A controller that takes the best zeros and bar lengths, and what it leaves."""

    machine: Machine  # whose workspace it is
    settings: Mapping[str, float]  # zeros and lengths to start from, SI
    slopes: Array  # TCP's shape over the workspace by these (3 g, B), metres

    @classmethod
    def of(cls, machine: Machine) -> _Controller:
        names = machine.catalogue.expand(machine.catalogue.base)
        held = {str(n): machine.values.get(n, 0.0) for n in names}
        slopes = without_translation(tcp_slopes(machine.with_only(held), names))
        return cls(machine, held, slopes.reshape(-1, len(names)))

    @cached_property
    def inverse(self) -> Array:
        """From errors ``(3 g,)`` to the settings that make up for them ``(B, 3 g)``."""
        sd = np.array([self.machine.tolerance(n) for n in self.settings])
        return np.asarray(sd[:, None] * np.linalg.pinv(self.slopes * sd, rcond=1e-6))

    def residual(self, errors: Array) -> Array:
        """Errors ``(3 g, ...)`` that no setting makes up for, to first order."""
        return np.asarray(errors - self.slopes @ (self.inverse @ errors))

    def residual_of(self, values: Mapping[str, float]) -> Array:
        """What the best settings leave of a machine's error over the workspace ``(3 g,)``."""
        where, settings = workspace_commands(self.machine), np.array([*self.settings.values()])
        goal = self.machine.with_only(values).forward(where)
        for _ in range(_STEPS):
            taken = self.machine.with_only(dict(zip(self.settings, settings.tolist(), strict=True)))
            apart = without_translation(goal - taken.forward(where)).ravel()
            settings = settings + self.inverse @ apart
        return self.residual(apart)


def _mean_length(errors: Array) -> Array:
    """Mean distance over the workspace ``(draws,)`` of errors ``(draws, 3 g)``."""
    return np.asarray(np.linalg.norm(errors.reshape(len(errors), -1, 3), axis=2).mean(axis=1))


def _rms_of_readings(posterior: FullPosterior, names: Sequence[str]) -> ByUnit:
    """Root mean square of a cause's part of the readings at the mean."""
    about, mean = posterior.linearised, posterior.mean
    at = [k for k, n in enumerate(about.problem.names) if n.plain in set(names)]
    for place in posterior.free_form_errors:
        if set(place.effect.motions) & set(names):
            at += about.coefficients(place).tolist()
    rows = about.rows[:, at] @ mean[at]
    rows = rows - posterior.linearised.nuisance.explained_residual(rows)
    return rms_by_unit(rows, about.problem.angular)
