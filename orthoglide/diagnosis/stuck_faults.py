"""Dials that stuck: equal readings one after the other where all the rest says they should move."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Rows, in_order
from orthoglide.diagnosis.repeat_faults import Scatter, noise_scale
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Problem
from orthoglide.geometry import Array

_EQUAL = 4  # readings one after the other
_STEPS, _SIGMAS = 5.0, 6.0  # of the dial, and of the noise, that they must have missed
_MARGIN = 5.0  # log Bayes factor over the best effect of the catalogue


def stuck_faults(base: Signatures, means: StationMeans, setups: Sequence[Scatter]) -> list[Fault]:
    """Runs of equal readings that repeats contradict, or the fit more than any effect explains.

    Args:
        base: at the fit.
        means: the same as station means.
        setups: scatter of all of them.
    """
    problem = means.problem
    runs = [(s, run) for s in range(problem.setup_count) for run in _runs(problem, s)]
    scale = noise_scale(problem, setups)
    found = []
    residual = base.estimate.nuisance.weighing.metres(base.residual[: base.count])
    for setup, run in runs:
        step, sigma = problem.machine.spec.dial.resolution, float(problem.sigma[run].max())
        least = max(_STEPS * step, _SIGMAS * sigma)
        # What a fit without the run leaves of it is no longer than this, and most runs are short.
        share = float(np.sum(base.fitted[run] ** 2))
        if share < 1 and np.sqrt(2) * np.linalg.norm(residual[run]) < least * (1 - share):
            continue
        missed = float(np.ptp(_left_by_others(base, run)))
        if missed < least:
            continue
        repeats = _by_repeats(setups[setup], run, scale) - np.log(len(runs))
        fit = _by_fit(means, np.unique(problem.station[run])) - np.log(len(runs))
        needed = max(EVIDENCE, means.best_effect[0] + _MARGIN)
        if repeats >= EVIDENCE or fit + max(repeats, 0.0) >= needed:
            evidence = float(max(repeats, 0.0) + max(fit, 0.0))
            found.append(Fault("stuck", run, (setup,), missed, evidence))
    return found


def _runs(problem: Problem, setup: int) -> Iterator[Rows]:
    """Longest runs of equal readings over several postures."""
    rows = in_order(problem, setup)
    commands = np.concatenate([c.command for c in problem.campaigns])
    cuts = np.flatnonzero(np.diff(problem.measured[rows]) != 0) + 1
    for run in np.split(rows, cuts):
        if len(run) >= _EQUAL and len(np.unique(commands[run], axis=0)) > 1:
            yield run


def _left_by_others(base: Signatures, run: Rows) -> Array:
    """What a fit without a run's readings leaves of them, metres: how far the dial should move."""
    inside = base.fitted[run]
    values, vectors = np.linalg.eigh(np.eye(inside.shape[1]) - inside.T @ inside)
    kept = values > 1e-6
    along = vectors[:, kept].T @ (inside.T @ base.residual[run])
    fitted = base.fitted[: base.count] @ (vectors[:, kept] @ (along / values[kept]))
    weighing = base.estimate.nuisance.weighing
    return np.asarray(weighing.metres(base.residual[: base.count] + fitted)[run])


def _by_repeats(scatter: Scatter, run: Rows, scale: float) -> float:
    """Evidence of earlier visits to the same stations."""
    rest = scatter.only(~np.isin(scatter.rows, run))
    size = scatter.dof - rest.dof
    if not size:
        return 0.0
    return float(scatter.evidence(scatter.chi2 - rest.chi2, size, scale)) - size


def _by_fit(means: StationMeans, stations: NDArray[np.intp]) -> float:
    """Evidence of all other readings, through the fit."""
    gain, size = means.freed(stations)
    return float(means.evidence(np.array(means.chi2 - gain), size)) - size
