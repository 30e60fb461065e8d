"""The error budget: the effect of each cause on readings and tool, and the gain of mending it.

The error counted is the tool's over the workspace after the best zeros and bar lengths of a
controller, without its mean. It is drawn from the posterior over all explanations. Causes that the
readings cannot distinguish are thereby counted jointly, and a cause that is active in one case of
ten exceeds its tolerance in no more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orthoglide.accuracy import tcp_slopes, without_translation, workspace_commands
from orthoglide.effects.wording import cause_short
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit.noise import rms_by_unit
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.numerals import ByUnit
from orthoglide.ordering import ranked
from orthoglide.result import BudgetItem

_DRAWS = 400  # the mean over them is good to a twentieth of their standard deviation
_NO_GAIN = 1e-9  # metres: smaller differences of gain are rounding
_STEPS = 2  # of Gauss-Newton, on a problem that is nearly linear


def budget(posterior: FullPosterior, causes: Mapping[str, Sequence[str]]) -> tuple[BudgetItem, ...]:
    """Return the causes ranked by the gain of mending them, largest first.

    Each cause found counts by itself; the remaining parameters of an effect count together.
    """
    machine = posterior.machine
    parameters, catalogue, values = machine.posterior, machine.catalogue, machine.values
    controller = _Controller.of(machine)
    # Without translations of the whole machine, whose uncertainty belongs to no cause.
    slopes = without_translation(tcp_slopes(machine, parameters.names))
    slopes = controller.residual(slopes.reshape(-1, len(parameters.names)))
    _, weights = posterior.machine_weights
    normal = np.random.default_rng(0).standard_normal((_DRAWS, len(parameters.names)))
    deviations = posterior.mixture.draws(weights, normal) - weights @ posterior.mean
    residual_error = controller.residual_of(values)
    drawn_errors = residual_error + deviations @ slopes.T
    drawn_length = _mean_length(drawn_errors)
    items = []
    for cause, names, is_remainder in _parameters_by_cause(posterior, causes):
        index = [parameters.names.index(n) for n in names]
        # Exact at the mean: a bar off by millimetres turns the platform by more than its slope.
        mended = {n: v for n, v in values.items() if n not in names}
        mean_part = residual_error - controller.residual_of(mended)
        part = mean_part + deviations[:, index] @ slopes[:, index].T
        gain = drawn_length - _mean_length(drawn_errors - part)
        compensated = drawn_length - _mean_length(drawn_errors - mean_part)
        tolerance = np.array([machine.tolerance(n) for n in names])
        in_tolerances = np.abs(parameters.mean[index] + deviations[:, index]) / tolerance
        part_length, unit = _mean_length(part), catalogue.effect_of(cause).unit
        single, first = len(index) == 1, index[0]
        sigma = float(np.sqrt(parameters.covariance[first, first])) / unit.si
        items.append(
            BudgetItem(
                cause,
                cause_short(catalogue, cause),
                tuple(t for n in names for t in (n, *dict(posterior.linearised.twins.get(n, ())))),
                float(parameters.mean[first]) / unit.si if single else float("nan"),
                sigma if single else float("nan"),
                unit.name,
                float(np.max(np.abs(parameters.mean[index]) / tolerance)),
                float(np.mean((in_tolerances > 1).any(axis=1))),
                _rms_of_readings(posterior, names),
                float(part_length.mean()),
                float(part_length.std()),
                float(gain.mean()),
                float(gain.std()),
                float(compensated.mean()),
                float(compensated.std()),
                float(gain.mean() / max(drawn_length.mean(), 1e-12)),
                is_remainder,
            )
        )
    by_name = sorted(items, key=lambda item: item.cause)
    return tuple(ranked(by_name, lambda item: item.gain, _NO_GAIN))


def _parameters_by_cause(
    posterior: FullPosterior, causes: Mapping[str, Sequence[str]]
) -> list[tuple[str, list[str], bool]]:
    """Return each cause with its parameters of the machine, and whether it is a remainder.

    No parameter is counted twice, and those of the base are left out. The parameters of an effect
    that belong to no cause are its remainder, under the effect's name.
    """
    catalogue = posterior.machine.catalogue
    twins = {t for others in posterior.linearised.twins.values() for t, _ in others}
    unassigned = [n for n in posterior.machine.posterior.names
                  if n not in twins and catalogue.effect_of(n).name not in catalogue.base
                  ]  # fmt: skip
    parts: list[tuple[str, list[str], bool]] = []
    for cause, parameters in causes.items():
        weights = catalogue.elementary_machine_values(dict.fromkeys(parameters, 1.0))
        elementary = set(map(str, weights))
        own_names = [n for n in unassigned if n in elementary]
        if own_names:
            parts.append((cause, own_names, False))
            unassigned = [n for n in unassigned if n not in elementary]
    by_effect: dict[str, list[str]] = {}
    for n in unassigned:
        by_effect.setdefault(catalogue.effect_of(n).name, []).append(n)
    return [*parts, *((effect, own_names, True) for effect, own_names in by_effect.items())]


@dataclass(frozen=True, eq=False)
class _Controller:
    """A controller that corrects zeros and bar lengths, and the error that remains.

    `accuracy.best_zeros` takes bar lengths as identified. Here they are fitted too, because a cause
    counts only for what neither zeros nor lengths correct.
    """

    machine: Machine
    settings: Mapping[str, float]  # initial zeros and lengths, SI
    slopes: Array  # shape error of the TCP over the workspace by setting (3 g, B), metres

    @classmethod
    def of(cls, machine: Machine) -> _Controller:
        """Return the controller of a machine, with the machine's values as settings."""
        names = machine.catalogue.expand(machine.catalogue.base)
        settings = {str(n): machine.values.get(n, 0.0) for n in names}
        slopes = without_translation(tcp_slopes(machine.with_only(settings), names))
        return cls(machine, settings, slopes.reshape(-1, len(names)))

    @cached_property
    def inverse(self) -> Array:
        """Matrix from errors ``(3 g,)`` to the settings that correct them ``(B, 3 g)``."""
        sd = np.array([self.machine.tolerance(n) for n in self.settings])
        return np.asarray(sd[:, None] * np.linalg.pinv(self.slopes * sd, rcond=1e-6))

    def residual(self, errors: Array) -> Array:
        """Return the errors ``(3 g, ...)`` that no setting corrects, to first order."""
        return np.asarray(errors - self.slopes @ (self.inverse @ errors))

    def residual_of(self, values: Mapping[str, float]) -> Array:
        """Return the error of a machine over the workspace ``(3 g,)`` with the best settings."""
        commands, settings = workspace_commands(self.machine), np.array([*self.settings.values()])
        goal = self.machine.with_only(values).forward(commands)
        for _ in range(_STEPS):
            values_set = dict(zip(self.settings, settings.tolist(), strict=True))
            compensated = self.machine.with_only(values_set)
            difference = without_translation(goal - compensated.forward(commands)).ravel()
            settings = settings + self.inverse @ difference
        return self.residual(difference)


def _mean_length(errors: Array) -> Array:
    """Return the mean length over the workspace ``(draws,)`` of errors ``(draws, 3 g)``."""
    return np.asarray(np.linalg.norm(errors.reshape(len(errors), -1, 3), axis=2).mean(axis=1))


def _rms_of_readings(posterior: FullPosterior, names: Sequence[str]) -> ByUnit:
    """Return the root mean square of a cause's part of the readings at the mean."""
    linearised, mean = posterior.linearised, posterior.mean
    coefficients = [k for k, n in enumerate(linearised.problem.names) if n.plain in set(names)]
    for group in posterior.free_form_groups:
        if set(group.source.effect.motions) & set(names):
            coefficients += group.coefficients.tolist()
    readings = linearised.visible_part(coefficients, mean[coefficients])
    return rms_by_unit(readings, linearised.problem.angular)
