"""``Estimate``: identified values with their uncertainty, scores and checks."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.arguments import public
from orthoglide.errors import check_choice
from orthoglide.fit.least_squares import (
    Linearised,
    Nuisances,
    linearise_placed,
    normal_equations,
    nuisances,
)
from orthoglide.fit.problem import Problem
from orthoglide.fit.scores import FittedRows, Scores, score
from orthoglide.frames import Framed
from orthoglide.geometry import LEGS, Array
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit, with_sigma
from orthoglide.observations import Readings
from orthoglide.result import Mounting, ReadingsShown
from orthoglide.result.display import Numbers
from orthoglide.result.fits import CrossCheck, Verification, WeakDirection
from orthoglide.units import Unit

if TYPE_CHECKING:
    from orthoglide.figures.style import Drawing


_MIN_TRAVEL = 1e-3  # metres: setups with less travel are drawn in the order of the file


def fitted_readings(
    problem: Problem, nominal: Array, before: Array, after: Array,
    requested: tuple[Readings, ...] = (),
) -> ReadingsShown:  # fmt: skip
    """Return measured and predicted readings ``(n,)``, metres or radians, setup by setup: predicted
    by the uncalibrated machine, before by the base model, and after the last fit.

    The problem may use a part of the ``requested`` tables; without them it uses all.
    """
    tables = [factor.readings for factor in problem.factors]
    rows = [row_indices(*pair) for pair in zip(tables, requested or tables, strict=True)]
    return ReadingsShown(
        mountings=tuple(_mountings(problem)),
        file=np.repeat(np.arange(len(tables)), [len(part) for part in tables]),
        row=np.concatenate(rows),
        measured=problem.measured,
        sigma=problem.sigma,
        nominal=nominal,
        before=before,
        after=after,
    )


def row_indices(part: Readings, whole: Readings) -> Numbers:
    """Return the row of each reading of ``part`` within ``whole`` ``(n,)``, matched by line and
    order, and by axis where a line has several; both are in the order of the file.

    The axis of a dial does not identify its reading, because a wrong label may have been corrected.
    """

    def keys(table: Readings) -> Iterator[tuple[int, int, int]]:
        axis = table.axis if whole.by_point else np.zeros_like(table.line)
        return zip(table.line.tolist(), table.order.tolist(), axis.tolist(), strict=True)

    places: dict[tuple[int, int, int], deque[int]] = defaultdict(deque)
    for k, key in enumerate(keys(whole)):
        places[key].append(k)
    return np.array([places[key].popleft() for key in keys(part)], dtype=np.int64)


def _mountings(problem: Problem) -> Iterator[Mounting]:
    """Yield all setups of a problem, in their order; of TCP points their coordinates."""
    several_files = len(problem.campaigns) > 1
    for factor, factor_slice in zip(problem.factors, problem.factor_rows, strict=True):
        readings = factor.readings
        for k, setup in enumerate(readings.setups):
            chosen = np.flatnonzero(factor.setup == k)
            if not len(chosen):
                continue
            x: Array = np.arange(1.0, len(chosen) + 1)
            if setup.leg >= 0:
                leg = setup.leg
                travel = readings.command[chosen, leg] - problem.machine.geometry.zero[leg]
                moves = np.ptp(travel) > _MIN_TRAVEL
                name = _setup_label(readings.name, setup.name) if several_files else setup.name
                title = f"{name}: leg {LEGS[leg]}, read along {setup.direction}"
                label = f"travel of carriage {LEGS[leg]}, mm" if moves else "place in the file"
                x = travel * 1e3 if moves else readings.order[chosen].astype(float)
            else:
                name, label = _setup_label(readings.name, setup.name), "reading"
                title = f"{name}, {setup.kind}"
            rows = (factor_slice.start + chosen).astype(np.int64)
            unit = setup.observation.unit
            setup_name = "" if readings.by_point else setup.name
            yield Mounting(setup_name, name, title, label, rows, x, unit)


def _setup_label(file: str, setup: str) -> str:
    """Return the label of a setup: its file's name, and its own unless that contains it."""
    return file if setup in file else f"{file} · {setup}"


@public
@dataclass(frozen=True)
class Estimate(Framed):
    """Result of :func:`~orthoglide.identify`.

    Attributes:
        problem: that was solved.
        x: identified values ``(P,)``, SI, in the order of ``names``.
        covariance: ``(P, P)``, SI, the noise of the readings multiplied by ``sigma_scale``.
        sigma_scale: sqrt(chi2 / dof) where lack of fit remains, else 1.
        scores: of this fit.
        weak: directions that the readings hardly determine.
        check: against the reduction and system (11); ``None`` where they cannot represent it.
        method: ``nlp``, ``nested``, ``pinocchio`` or ``reduction``.
        iterations: of the solver.
        optimality: step that a Newton iteration would still make, in sigmas.
        warnings: notes for the user, in sentences.
        at: linearisation at the fit.
        nuisance: datums and placements of the fit.
        rows: predicted readings, and the influence of each on its prediction.
        changes: differences from an earlier calibration.
        verification: by Pinocchio, of a finished result.
    """

    problem: Problem
    x: Array
    covariance: Array
    sigma_scale: float
    scores: Scores
    weak: tuple[WeakDirection, ...]
    check: CrossCheck | None
    method: str
    iterations: int
    optimality: float
    warnings: tuple[Note, ...]
    at: Linearised = field(repr=False)
    nuisance: Nuisances = field(repr=False)
    rows: FittedRows = field(repr=False)
    changes: tuple[Any, ...] = ()
    verification: Verification | None = None
    _index = "parameter"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was identified."""
        return self.problem.names

    def unit(self, name: str) -> Unit:
        """Unit of a parameter in files."""
        return self.problem.machine.catalogue.effect_of(name).unit

    @property
    def values(self) -> dict[str, float]:
        """Identified values by name, SI."""
        return dict(zip(self.names, self.x.tolist(), strict=True))

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name, SI, scaled."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> Array:
        """Correlations of the identified values ``(P, P)``."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return np.asarray(self.covariance / sd / sd[:, None])

    @property
    def coverage_factor(self) -> float:
        """Half width of a 95 % interval in sigmas: normal, or Student's t where they are scaled."""
        from scipy.special import ndtri, stdtrit

        if self.sigma_scale == 1.0:
            return float(ndtri(0.975))
        return float(stdtrit(max(self.scores.dof, 1), 0.975))

    def interval(self, name: str) -> tuple[float, float]:
        """95 % interval of one identified value, SI.

        Raises:
            InputError: for a name that was not identified.
        """
        check_choice("identified parameter", name, self.names)
        half = self.coverage_factor * self.sigmas[name]
        return self.values[name] - half, self.values[name] + half

    @property
    def on_bound(self) -> tuple[str, ...]:
        """Names of values that ended on a bound."""
        return tuple(self.names[k] for k in np.flatnonzero(self.problem.on_bound(self.x)))

    @property
    def predicted(self) -> Array:
        """Fitted readings ``(n,)`` of all campaigns, datums and placements included, metres."""
        return self.rows.predicted

    @property
    def residuals(self) -> Array:
        """Readings less fitted ``(n,)``, metres."""
        return self.rows.residual

    @cached_property
    def _before_calibration(self) -> tuple[Linearised, FittedRows]:
        """Readings predicted by the uncalibrated machine, with balls and frames placed by it."""
        problem = replace(self.problem, unknowns=(), earlier_posterior=None)
        placed, linear = linearise_placed(problem, np.zeros(0))
        as_before = placed is problem
        nuisance = self.nuisance if as_before else nuisances(placed, linear.reading_poses)
        return linear, FittedRows.from_fit(placed, nuisance, linear)

    @cached_property
    def nominal(self) -> Scores:
        """Scores of the uncalibrated machine (the unknowns at zero)."""
        linear, rows = self._before_calibration
        return score(rows, normal_equations(rows.problem, linear, rows.nuisance))

    @property
    def predicted_before(self) -> Array:
        """Readings ``(n,)`` predicted by the uncalibrated machine, datums fitted, metres."""
        return self._before_calibration[1].predicted

    @property
    def machine(self) -> Machine:
        """The calibrated machine; of values specific to a campaign, those of the last one."""
        return self.machine_of(self.problem.last_factor_index)

    def machine_of(self, campaign: int) -> Machine:
        """Return the calibrated machine of one campaign, without parameters of dials."""
        posterior = Posterior(self.names, self.x, self.covariance)
        posterior = posterior.transformed(*self.problem.machine_parameters(campaign))
        initial = self.problem.machine
        values = {
            **initial.values,
            **dict(zip(posterior.names, posterior.mean.tolist(), strict=True)),
        }
        return initial.with_posterior(values, posterior.joined(initial.posterior))

    def __str__(self) -> str:
        lines = []
        for name, value in self.values.items():
            unit, sigma = self.unit(name), self.sigmas[name]
            size = with_sigma(value / unit.si, sigma / unit.si, most=9)
            text = f"{name:<24} {size} {unit.name}"
            lines.append(text + ("   (on its bound)" if name in self.on_bound else ""))
        s = self.scores
        has_deviations = np.isfinite(s.deviation_rms)
        deviations = f"deviations {s.deviation_rms * 1e3:.3f} mm, " if has_deviations else ""
        lines.append(
            f"residual rms {_residual_text(s.left)}, {deviations}chi2 {s.chi2:.1f} on {s.dof:.0f} "
            f"degrees of freedom"
        )
        lines.extend(str(weak) for weak in self.weak)
        lines.extend(self.warnings)
        return "\n".join(lines)

    def __repr__(self) -> str:
        readings = len(self.problem.measured)
        return (
            f"<Estimate of {len(self.names)} parameters from {readings} readings: residual rms "
            f"{_residual_text(self.scores.left)}>"
        )

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Table of the identified parameters in the units of files: value, sigma, the limits of the
        95 % interval, unit and tolerance.
        """
        units = [self.unit(name) for name in self.names]
        si = np.array([unit.si for unit in units])
        half = self.coverage_factor * np.sqrt(np.diag(self.covariance))
        return {
            "parameter": list(self.names),
            "value": (self.x / si).tolist(),
            "sigma": (np.sqrt(np.diag(self.covariance)) / si).tolist(),
            "lower": ((self.x - half) / si).tolist(),
            "upper": ((self.x + half) / si).tolist(),
            "unit": [unit.name for unit in units],
            "tolerance": (self.problem.tolerance / si).tolist(),
        }

    def plot(self, what: str = "residuals") -> Drawing:
        """A figure of the fit, which notebooks show and ``save`` writes.

        Args:
            what: ``"residuals"`` or ``"readings"``, by setup.

        Raises:
            InputError: for an unknown figure.
        """
        from orthoglide.figures.draw import draw_fit

        table = fitted_readings(self.problem, self.predicted_before, self.predicted, self.predicted)
        return draw_fit(table, self.problem.single_reading_sd, what)


def _residual_text(rms: ByUnit) -> str:
    """Return the residual rms as text, to 0.1 um and 0.1 urad."""
    return " and ".join(f"{value:.4f} {unit}" for unit, value in rms.shown.items())
