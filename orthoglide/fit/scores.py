"""Scores of a fit: on its readings, and on stations left out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orthoglide.fit.least_squares import (
    Linearised,
    NormalEquations,
    Nuisances,
    fitted_basis,
    project_out,
)
from orthoglide.fit.noise import rms_by_unit
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array
from orthoglide.result.fits import Scores

LACK_OF_FIT = 0.01
"""Significance level of the lack-of-fit test that widens the standard deviations."""

_MIN_DOF = 2.0  # degrees of freedom below which stations have no standard error


@dataclass(frozen=True, eq=False, repr=False)
class FittedRows:
    """Predictions of a fit, and the influence of each reading on them."""

    problem: Problem
    nuisance: Nuisances
    predicted: Array  # nuisances included (n,), metres or radians
    leverage: Array  # share of each reading in its own prediction (n,)
    residual_left_out: Array  # with the station left out (n,); nan where nothing predicts it
    # eigenvalues of the hat matrix of the station means and the nuisances' priors (r,)
    station_hat_eigenvalues: Array

    @classmethod
    def from_fit(cls, problem: Problem, nuisance: Nuisances, linear: Linearised) -> FittedRows:
        """Return the rows of a fit, from its linearisation."""
        predicted = linear.value + nuisance.explained_residual(problem.measured - linear.value)
        basis = fitted_basis(problem, nuisance, linear)
        fitted = basis[: len(predicted)]
        # At the optimum of the linear problem, where a posterior averaged over several priors is
        # not: divided by 1 - H where H is nearly 1, its residuals would exceed those of each prior.
        (matrix, target), whitened = problem.prior_rows, np.zeros(len(basis))
        whitened[: len(predicted)] = nuisance.weighing.whiten(problem.measured - linear.value)
        whitened[len(predicted) :][: len(target)] = target - matrix @ linear.x
        whitened = project_out(basis, whitened)[: len(predicted)]
        # Fitted columns may vary within a station: only their effect on its mean counts.
        means = nuisance.weighing.station_components(fitted)
        priors = basis[len(basis) - nuisance.count :]
        return cls(
            problem, nuisance, predicted, np.einsum("nr,nr->n", fitted, fitted),
            _left_out_residuals(problem, nuisance, fitted, whitened),
            np.asarray(np.linalg.eigvalsh(means.T @ means + priors.T @ priors), dtype=np.float64),
        )  # fmt: skip

    @cached_property
    def residual(self) -> Array:
        """Readings less predicted ``(n,)``, metres or radians."""
        return self.problem.measured - self.predicted

    def lack_of_fit(self, equations: NormalEquations) -> float:
        """Return the p-value of the complete model's chi2; nan without degrees of freedom.

        All readings are tested, and the station means, which show better what recurs at every
        visit; the smaller p-value is corrected for two tests (Sidak). Only the means are tested if
        each station was read once, if the noise was estimated from repeats (an F test), or if
        visits share a rounding error, as single readings are then not normal. Both tests include
        the nuisances: a printed part that must be 15 % too large is a lack of fit.
        """
        problem, weighing = self.problem, self.nuisance.weighing
        count = len(problem.measured)
        means = weighing.station_components(weighing.whiten(self.residual))
        of_nuisances = equations.residual[count:][self.nuisance.precision > 0]
        tested = np.concatenate([means, of_nuisances])
        p_of_means = chi2_p_value(
            float(tested @ tested), len(tested), self.station_hat_eigenvalues, problem.noise_dof
        )
        if (
            count == len(means)
            or np.isfinite(problem.noise_dof)
            or problem.shared_rounding_sd.any()
        ):
            return p_of_means
        count -= self.nuisance.unconstrained_count
        p_of_readings = chi2_p_value(equations.chi2, count, equations.hat_eigenvalues)
        return smaller_p_value(p_of_means, p_of_readings)


def score(rows: FittedRows, equations: NormalEquations) -> Scores:
    """Return the scores of a fit."""
    problem, residual = rows.problem, rows.residual
    # The trace of the hat matrix is the number of unknowns that the data determine.
    determined = rows.nuisance.unconstrained_count + float(np.sum(equations.hat_eigenvalues))
    dof = round(max(len(residual) - determined, 0.0), 6)  # further digits are rounding
    angular, magnitude = problem.angular, np.abs(residual)
    rms = rms_by_unit(residual, angular)
    left_out = rms_by_unit(rows.residual_left_out, angular)
    return Scores(
        rms=rms.length,
        deviation_rms=deviation_rms(problem, residual),
        max=float(magnitude[~angular].max()) if not angular.all() else float("nan"),
        chi2=equations.chi2,
        prior_chi2=equations.prior_chi2(equations.x),
        dof=dof,
        lack_of_fit_p=rows.lack_of_fit(equations),
        cv_rms=left_out.length,
        turn_rms=rms.turn,
        turn_max=float(magnitude[angular].max()) if angular.any() else float("nan"),
        turn_cv_rms=left_out.turn,
    )


def cross_validation_improvement(before: FittedRows, after: FittedRows) -> tuple[float, float]:
    """Return the decrease of the squared residuals of left-out stations between two fits of the
    same readings, in variances of a reading: the mean over the stations, and its standard error,
    infinite if the first fit has less than two degrees of freedom.
    """
    problem, stations = before.problem, len(before.nuisance.weighing.first_rows)
    first, second = ((f.residual_left_out / problem.sigma) ** 2 for f in (before, after))
    improvement = first - second
    predicted = np.isfinite(improvement)
    if not predicted.any():
        return float("nan"), float("nan")
    _, station = np.unique(problem.place_number[predicted], return_inverse=True)
    mean = np.bincount(station, improvement[predicted]) / np.bincount(station)
    # With one degree of freedom the residuals of all stations are multiples of one number.
    tested = stations + int(np.sum(before.nuisance.precision > 0))
    dof = tested - float(np.sum(before.station_hat_eigenvalues))
    error = float(np.std(mean, ddof=1)) if dof >= _MIN_DOF else float("inf")
    return float(mean.mean()), error / np.sqrt(len(mean))


def smaller_p_value(first: float, second: float) -> float:
    """Return the smaller p of two p-values, corrected for two tests: 1 - (1 - p)^2 (Sidak 1967); p
    itself where the other is nan.
    """
    p = float(np.fmin(first, second))
    return p if np.isnan([first, second]).any() else p * (2 - p)  # exact where p is tiny


def chi2_p_value(chi2: float, count: int, shares: Array, noise_dof: float = np.inf) -> float:
    """Return the p-value of a chi2 of ``count`` rows, of which unknowns with priors explain a part.

    With the eigenvalues h of the hat matrix (``shares``), chi2 is a sum of squares weighted 1 and
    1 - h. It is approximated by a multiple of a chi2 of the same mean and variance (Satterthwaite).
    ``noise_dof`` are the degrees of freedom behind the noise.
    """
    from scipy.special import chdtrc, fdtrc

    mean, square = count - np.sum(shares), count - 2 * np.sum(shares) + np.sum(shares**2)
    if mean <= 1e-6 or square <= 1e-12:
        return float("nan")
    scale, dof = square / mean, mean**2 / square
    if np.isfinite(noise_dof):
        return float(fdtrc(dof, noise_dof, chi2 / mean))
    return float(chdtrc(dof, chi2 / scale))


def deviation_rms(problem: Problem, residual: Array) -> float:
    """Return the root mean square of averaged deviations from each dial setup's first posture,
    metres.

    Readings without a datum are compared with zero.
    """
    dials = slice(0, problem.leg_rows[-1].stop) if problem.leg_rows else slice(0, 0)
    place, setup = problem.place_number[dials], problem.setup_of_row[dials]
    if not len(place):
        return float("nan")
    count = np.bincount(place)
    average = np.bincount(place, residual[dials]) / count
    order = np.lexsort((problem.dial_column("order"), setup))
    # Only setups with rows are present.
    present, first_row = np.unique(setup[order], return_index=True)
    first_place = place[order[first_row]]  # of each setup
    home = np.zeros(len(count), dtype=np.int64)
    home[place] = np.searchsorted(present, setup)
    datum = np.array([problem.setups[k].observation.from_datum for k in present])
    others = np.setdiff1d(np.arange(len(count)), first_place[datum])
    deviation = average[others] - np.where(datum, average[first_place], 0.0)[home[others]]
    return float(np.sqrt(np.mean(deviation**2))) if len(deviation) else float("nan")


def _left_out_residuals(
    problem: Problem, nuisance: Nuisances, fitted: Array, whitened: Array
) -> Array:
    """Return the residuals ``(n,)`` of readings predicted with every visit to their station left
    out; nan where nothing predicts them.

    With leverage ``H`` of the linear problem, the residual of a block g left out is
    ``(1 - H_gg)^-1 r_g``. ``fitted``: orthonormal columns of everything fitted ``(n, r)``;
    ``whitened``: residuals at the optimum ``(n,)``, in sigmas.
    """
    station = problem.place_number
    left_out = np.full(len(whitened), np.nan)
    order, size = np.argsort(station, kind="stable"), np.bincount(station)
    first = np.cumsum(size) - size
    for visits in np.unique(size):  # stations of equal size are solved together
        rows = order[first[size == visits][:, None] + np.arange(visits)]
        columns = fitted[rows]
        residual = whitened[rows, None]
        direct = visits <= columns.shape[-1]
        product = columns @ columns.swapaxes(1, 2) if direct else columns.swapaxes(1, 2) @ columns
        block = np.eye(product.shape[-1]) - product
        # Without any other station of its setup, the datum and so the block is unknown.
        predictable = np.linalg.eigvalsh(block).min(axis=-1, initial=1.0) > 1e-6
        columns, residual, block = columns[predictable], residual[predictable], block[predictable]
        if direct:
            solution = np.linalg.solve(block, residual)
        else:  # by Woodbury's identity
            inner = np.linalg.solve(block, columns.swapaxes(1, 2) @ residual)
            solution = residual + columns @ inner
        left_out[rows[predictable]] = solution[..., 0]
    return nuisance.weighing.metres(left_out)
