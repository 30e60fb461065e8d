"""How well a fit does: on the readings that it saw, and on stations left out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.least_squares import (
    Linearised,
    NormalEquations,
    Nuisances,
    fitted_basis,
    normal_equations,
    project_out,
)
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit
from orthoglide.result.fits import Scores

LACK_OF_FIT = 0.01
"""Significance level of the lack-of-fit test that widens the standard deviations."""

_MIN_DOF = 2.0  # degrees of freedom below which stations have no standard error


@dataclass(frozen=True, eq=False, repr=False)
class FittedRows:
    """The rows of a fit: what it predicts, and how much each reading decides of that."""

    problem: Problem
    nuisance: Nuisances
    predicted: Array  # nuisances included (n,), metres or radians
    leverage: Array  # share of each reading in its own prediction (n,)
    residual_left_out: Array  # of readings whose station is left out (n,); nan where none predicts
    station_hat_eigenvalues: Array  # eigenvalues of the hat matrix of the station means (r,)

    @classmethod
    def from_fit(cls, problem: Problem, nuisance: Nuisances, at: Linearised) -> FittedRows:
        """Return the rows of a fit, by the linearisation there."""
        predicted = at.value + nuisance.explained_residual(problem.measured - at.value)
        basis = fitted_basis(problem, nuisance, at)
        fitted = basis[: len(predicted)]
        # Fitted columns may vary within a station: only what they do to its mean counts.
        means = nuisance.weighing.station_components(fitted)
        return cls(
            problem, nuisance, predicted, np.einsum("nr,nr->n", fitted, fitted),
            _left_out_residuals(problem, nuisance, fitted, _residuals_at_optimum(problem, nuisance, at, basis)),
            np.asarray(np.linalg.eigvalsh(means.T @ means), dtype=np.float64),
        )  # fmt: skip

    @cached_property
    def residual(self) -> Array:
        """Readings less predicted ``(n,)``, metres or radians."""
        return self.problem.measured - self.predicted

    def lack_of_fit(self, here: NormalEquations) -> float:
        """Probability of a chi2 this large were the model complete; nan without degrees of freedom.

        Two tests are made, of all readings and of the station means, which show better what comes
        again at every visit; the smaller p-value is corrected for two tests (Sidak). Only the means
        are tested if each station was read once, if the noise was estimated from repeats (an F
        test), or if visits share a rounding error, as single readings are then not normal.
        """
        problem, weighing = self.problem, self.nuisance.weighing
        known, rows, stations = problem.noise_dof, len(problem.measured), len(weighing.first_rows)
        rest = weighing.station_components(weighing.whiten(self.residual))
        means = chi2_p_value(float(rest @ rest), stations, self.station_hat_eigenvalues, known)
        if rows == stations or np.isfinite(known) or problem.common.any():
            return means
        return smaller_p_value(
            means,
            chi2_p_value(here.chi2, rows - self.nuisance.unconstrained_count, here.hat_eigenvalues),
        )


def score(rows: FittedRows, at: Linearised) -> Scores:
    """Score a fit, by the linearisation there."""
    problem, residual = rows.problem, rows.residual
    here = normal_equations(problem, at, rows.nuisance)
    # The trace of the hat matrix is how many unknowns the data determine.
    dof = max(
        len(residual) - rows.nuisance.unconstrained_count - float(np.sum(here.hat_eigenvalues)), 0.0
    )
    dof = round(dof, 6)  # what is left behind is rounding
    turned, largest = problem.angular, np.abs(residual)
    left = rms_by_unit(residual, turned)
    left_out = rms_by_unit(rows.residual_left_out, turned)
    return Scores(
        rms=left.length,
        deviation_rms=deviation_rms(problem, residual),
        max=float(largest[~turned].max()) if not turned.all() else float("nan"),
        chi2=here.chi2,
        prior_chi2=here.prior_chi2(at.x),
        dof=dof,
        lack_of_fit_p=rows.lack_of_fit(here),
        cv_rms=left_out.length,
        turn_rms=left.turn,
        turn_max=float(largest[turned].max()) if turned.any() else float("nan"),
        turn_cv_rms=left_out.turn,
    )


def cross_validation_improvement(before: FittedRows, after: FittedRows) -> tuple[float, float]:
    """Return by how much the squared residuals of stations that are left out fall from one fit to
    another of the same readings, in variances of a reading: the mean over the stations, and its
    standard error, infinite where the first fit leaves less than two degrees of freedom.
    """
    problem = before.problem
    one, other = ((f.residual_left_out / problem.sigma) ** 2 for f in (before, after))
    fall = one - other
    known = np.isfinite(fall)
    if not known.any():
        return float("nan"), float("nan")
    _, station = np.unique(problem.place_number[known], return_inverse=True)
    mean = np.bincount(station, fall[known]) / np.bincount(station)
    # With one degree of freedom the residuals of all stations are one number.
    independent = len(before.nuisance.weighing.first_rows) - float(
        np.sum(before.station_hat_eigenvalues)
    )
    error = float(np.std(mean, ddof=1)) if independent >= _MIN_DOF else float("inf")
    return float(mean.mean()), error / np.sqrt(len(mean))


def rms_by_unit(rows: Array, turned: NDArray[np.bool_]) -> ByUnit:
    """Root mean square of what is known of rows.

    Args:
        rows: ``(n,)``, metres or radians; nan where nothing is known.
        turned: which are radians ``(n,)``.
    """
    known = np.isfinite(rows)
    parts = (rows[known & ~turned], rows[known & turned])
    return ByUnit(*(float(np.sqrt(np.mean(p**2))) if len(p) else float("nan") for p in parts))


def smaller_p_value(one: float, other: float) -> float:
    """Probability 1 - (1 - p)^2 that the smaller of two p-values is no larger than it is (Sidak
    1967); p itself where the other is nan.
    """
    p = float(np.fmin(one, other))
    return p if np.isnan([one, other]).any() else p * (2 - p)  # exact where p is tiny


def chi2_p_value(chi2: float, count: int, shares: Array, known: float = np.inf) -> float:
    """Probability of a chi2 this large of ``count`` rows, of which unknowns took their shares.

    What a prior holds back is left in part: with the eigenvalues h of the hat matrix chi2 is a sum
    of squares weighed 1 and 1 - h, taken for a multiple of a chi2 of the same mean and variance
    (Satterthwaite). ``known`` are the degrees of freedom behind the noise.
    """
    from scipy.special import chdtrc, fdtrc

    mean, square = count - np.sum(shares), count - 2 * np.sum(shares) + np.sum(shares**2)
    if mean <= 1e-6 or square <= 1e-12:
        return float("nan")
    scale, dof = square / mean, mean**2 / square
    if np.isfinite(known):
        return float(fdtrc(dof, known, chi2 / mean))
    return float(chdtrc(dof, chi2 / scale))


def deviation_rms(problem: Problem, residual: Array) -> float:
    """Root mean square of averaged deviations from each dial setup's first posture, metres.

    Readings without a datum are compared with zero.
    """
    dials = slice(0, problem.leg_rows[-1].stop) if problem.leg_rows else slice(0, 0)
    place, setup = problem.place_number[dials], problem.setup_of_row[dials]
    if not len(place):
        return float("nan")
    count = np.bincount(place)
    average = np.bincount(place, residual[dials]) / count
    row = np.lexsort((problem.dial_column("order"), setup))
    present, index = np.unique(setup[row], return_index=True)  # a setup may have lost all rows
    first = place[row[index]]  # of each setup
    home = np.zeros(len(count), dtype=np.int64)
    home[place] = np.searchsorted(present, setup)
    datum = np.array([problem.setups[k].observation.from_datum for k in present])
    others = np.setdiff1d(np.arange(len(count)), first[datum])
    apart = average[others] - np.where(datum, average[first], 0.0)[home[others]]
    return float(np.sqrt(np.mean(apart**2))) if len(apart) else float("nan")


def _residuals_at_optimum(
    problem: Problem, nuisance: Nuisances, at: Linearised, basis: Array
) -> Array:
    """Return the whitened residuals ``(n,)`` at the optimum of the linear problem.

    A posterior averaged over several priors is not at the optimum of their average. Its own
    residual, divided by 1 - H where H is nearly 1, would be far beyond all of them.
    """
    matrix, target = problem.prior_rows
    rest = np.zeros(len(basis))
    count = len(problem.measured)
    rest[:count] = nuisance.weighing.whiten(problem.measured - at.value)
    rest[count:][: len(target)] = target - matrix @ at.x
    return project_out(basis, rest)[:count]


def _left_out_residuals(
    problem: Problem, nuisance: Nuisances, fitted: Array, whitened: Array
) -> Array:
    """Residuals ``(n,)`` of readings predicted with every visit to their station left out; nan
    where nothing predicts them.

    With leverage ``H`` of the linear problem (unknowns, nuisances, priors), the residual of a
    block g left out is ``(1 - H_gg)^-1 r_g``.

    Args:
        problem: gives the stations.
        nuisance: of the fit.
        fitted: orthonormal columns of everything fitted, the rows of the readings ``(n, r)``.
        whitened: residuals at the optimum ``(n,)``, in sigmas.
    """
    station = problem.place_number
    left_out = np.full(len(whitened), np.nan)
    order, size = np.argsort(station, kind="stable"), np.bincount(station)
    first = np.cumsum(size) - size
    for visits in np.unique(size):  # stations alike in size are solved together
        rows = order[first[size == visits][:, None] + np.arange(visits)]
        near = fitted[rows]
        white = whitened[rows, None]
        few = visits <= near.shape[-1]
        square = near @ near.swapaxes(1, 2) if few else near.swapaxes(1, 2) @ near
        block = np.eye(square.shape[-1]) - square
        # A setup's datum is gone with its last other station: nothing predicts such a block.
        kept = np.linalg.eigvalsh(block)[:, 0] > 1e-6
        near, white, block = near[kept], white[kept], block[kept]
        if few:
            found = np.linalg.solve(block, white)
        else:  # by Woodbury's identity
            found = white + near @ np.linalg.solve(block, near.swapaxes(1, 2) @ white)
        left_out[rows[kept]] = found[..., 0]
    return nuisance.weighing.metres(left_out)
