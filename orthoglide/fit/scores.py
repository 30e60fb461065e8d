"""How well a fit describes readings: residuals, the papers' deviations, stations left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.least_squares import Linearised, Nuisances
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array


@dataclass(frozen=True)
class Scores:
    """Figures of one fit; lengths in metres.

    Attributes:
        rms: of the residuals, datums fitted.
        deviation_rms: the papers' figure: residuals of the averaged deviations from each setup's
            first posture.
        max: largest residual.
        chi2: data, placements and priors.
        dof: degrees of freedom: rows less setups, less unknowns without prior.
        lack_of_fit_p: probability of a chi2 this large were the model complete.
        cv_rms: residuals of stations left out, datum refitted; nan where none can be.
    """

    rms: float
    deviation_rms: float
    max: float
    chi2: float
    dof: int
    lack_of_fit_p: float
    cv_rms: float


def score(problem: Problem, nuisance: Nuisances, at: Linearised, chi2: float, rank: int) -> Scores:
    """Score a fit.

    Args:
        problem: readings, noise, priors.
        nuisance: datums and placements.
        at: linearisation at the fit.
        chi2: the cost there.
        rank: unknowns that the readings determine.
    """
    from scipy.special import chdtrc

    rest = problem.measured - at.value
    residual = rest - nuisance.columns @ nuisance.solve(rest)
    free = 0 if problem.priors else rank
    dof = len(rest) - problem.setup_count - free
    return Scores(
        rms=float(np.sqrt(np.mean(residual**2))),
        deviation_rms=deviation_rms(problem, residual),
        max=float(np.max(np.abs(residual))),
        chi2=chi2,
        dof=dof,
        lack_of_fit_p=float(chdtrc(dof, chi2)) if dof > 0 else float("nan"),
        cv_rms=left_out_rms(problem, nuisance, at, residual),
    )


def stations(problem: Problem) -> NDArray[np.intp]:
    """Station of each reading ``(n,)``: one for each setup and command, whatever the approach."""
    commands = np.concatenate([c.command for c in problem.campaigns])
    table = np.column_stack([problem.setup_of_row, commands])
    return np.unique(table, axis=0, return_inverse=True)[1].reshape(-1)


def deviation_rms(problem: Problem, residual: Array) -> float:
    """Root mean square of averaged deviations from each setup's first posture, metres."""
    station = stations(problem)
    count = np.bincount(station)
    average = np.bincount(station, residual) / count
    squares: list[float] = []
    for setup in range(problem.setup_count):
        own = np.flatnonzero(problem.setup_of_row == setup)
        order = np.concatenate([c.order for c in problem.campaigns])[own]
        first = station[own[np.argmin(order)]]
        others = np.setdiff1d(station[own], [first])
        squares.extend(((average[others] - average[first]) ** 2).tolist())
    return float(np.sqrt(np.mean(squares))) if squares else float("nan")


def left_out_rms(problem: Problem, nuisance: Nuisances, at: Linearised, residual: Array) -> float:
    """Root mean square of readings predicted with every visit to their station left out, metres.

    With leverage ``H`` of the linear problem (unknowns, datums, placements, priors), the residual
    of a block g left out is ``(1 - H_gg)^-1 r_g``.
    """
    basis = leverage_basis(problem, nuisance, at)
    station = stations(problem)
    left_out = np.full(len(residual), np.nan)
    order, size = np.argsort(station, kind="stable"), np.bincount(station)
    first = np.cumsum(size) - size
    for visits in np.unique(size):  # stations alike in size are solved together
        rows = order[first[size == visits][:, None] + np.arange(visits)]
        near = basis[rows]
        block = np.eye(visits) - near @ near.swapaxes(1, 2)
        # A setup's datum is gone with its last other station: nothing predicts such a block.
        kept = np.linalg.eigvalsh(block)[:, 0] > 1e-6
        whitened = (residual * nuisance.weight)[rows[kept]]
        left_out[rows[kept]] = np.linalg.solve(block[kept], whitened[..., None])[..., 0]
    left_out /= nuisance.weight
    known = np.isfinite(left_out)
    return float(np.sqrt(np.mean(left_out[known] ** 2))) if known.any() else float("nan")


def leverage_basis(problem: Problem, nuisance: Nuisances, at: Linearised) -> Array:
    """Orthonormal columns of everything fitted, the rows of the readings ``(n, P + k)``."""
    n, weight = len(problem.measured), nuisance.weight[:, None]
    top = np.hstack([at.jacobian * weight, nuisance.columns * weight])
    prior = np.concatenate([1 / problem.prior_sd, np.sqrt(nuisance.precision)])
    augmented = np.vstack([top, np.diag(prior)])
    scale = np.linalg.norm(augmented, axis=0)
    left, singular, _ = np.linalg.svd(
        augmented / np.where(scale > 0, scale, 1), full_matrices=False
    )
    return left[:n, singular > 1e-10 * singular[0]]
