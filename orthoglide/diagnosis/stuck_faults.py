"""Dials that stuck: equal readings one after the other where all the rest says they should move."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Rows, in_order
from orthoglide.diagnosis.repeat_faults import noise_scale
from orthoglide.diagnosis.scatter import Scatter
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.diagnosis.station_means import Explained, StationMeans
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL_ODDS, best_of

_EQUAL = 4  # readings one after the other
_SIZES = (1.0, 10.0)  # tolerances that effects may have: what is far beyond them is no fault
_STEPS, _SIGMAS = 5.0, 6.0  # of the dial, and of the noise, that they must have missed


def stuck_faults(base: Signatures, means: StationMeans, setups: Sequence[Scatter]) -> list[Fault]:
    """Runs of equal readings that repeats contradict, or all other readings and the scatter."""
    problem = means.problem
    runs = [(s, run) for s in problem.leg_setups for run in _runs(problem, s)]
    scale = noise_scale(problem, setups)
    found = []
    residual = base.estimate.nuisance.weighing.metres(base.residual[: base.count])
    for setup, run in runs:
        step, sigma = float(problem.step[run].max()), float(problem.sigma[run].max())
        least = max(_STEPS * step, _SIGMAS * sigma)
        # What a fit without the run leaves of it is no longer than this, and most runs are short.
        share = float(np.sum(base.fitted[run] ** 2))
        if share < 1 and np.sqrt(2) * np.linalg.norm(residual[run]) < least * (1 - share):
            continue
        if np.ptp(left_by_others(base, run)) < least:
            continue
        # Earlier visits to the same stations.
        scatter, repeats = setups[setup], 0.0
        rest = scatter.only(~np.isin(scatter.rows, run))
        if size := scatter.dof - rest.dof:
            fall = scatter.chi2 - rest.chi2
            repeats = max(float(scatter.evidence(fall, size, scale)) - size, 0.0)
        fit, missed = _by_fit(base, means, run)
        fit = fit + _by_scatter(problem, setups, setup, run) if missed >= least else 0.0
        evidence = repeats + max(fit, 0.0) - float(np.log(len(runs)))
        if evidence >= EVIDENCE:
            found.append(Fault("stuck", run, (setup,), missed, evidence))
    return found


def _runs(problem: Problem, setup: int) -> Iterator[Rows]:
    """Longest runs of equal readings over several postures."""
    rows = in_order(problem, setup)
    commands = problem.of_dials("command")
    cuts = np.flatnonzero(np.diff(problem.measured[rows]) != 0) + 1
    for run in np.split(rows, cuts):
        if len(run) >= _EQUAL and len(np.unique(commands[run], axis=0)) > 1:
            yield run


def left_by_others(base: Signatures, run: Rows, effects: Sequence[int] = ()) -> Array:
    """What a fit without a run's readings leaves of them, metres: how far the dial should move. It
    has some effects besides, their tolerances as a prior.
    """
    beside = [base.of(base.candidates[k]) for k in effects]
    columns = np.hstack([base.fitted, *beside])
    known = np.repeat([0.0, 1.0], [base.fitted.shape[1], columns.shape[1] - base.fitted.shape[1]])
    inside, rest = columns[run], base.residual
    gram = columns.T @ columns - inside.T @ inside + np.diag(known)
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-6
    along = vectors[:, kept].T @ (columns.T @ rest - inside.T @ rest[run])
    fitted = columns[: base.count] @ (vectors[:, kept] @ (along / values[kept]))
    weighing = base.estimate.nuisance.weighing
    return np.asarray(weighing.metres(rest[: base.count] - fitted)[run])


def _by_fit(base: Signatures, means: StationMeans, run: Rows) -> tuple[float, float]:
    """Evidence of all other readings, and how far the dial should move by what explains these.

    A dial that stuck shows its one value for certain. One that works shows it only where effects
    undo what the others see at every station, and every effect is improbable.
    """
    if not any(c.size == 1 for c in base.candidates):
        return 0.0, float(np.ptp(left_by_others(base, run)))
    others = StationMeans.of(base, [Fault("stuck", run, (), 0.0)])
    cost = float(np.log(len(base.candidates)))
    tried = []
    for size in _SIZES:
        wide = replace(base, tolerance=size * base.tolerance)
        scored = (_explained(means, size, cost), _explained(others, size, cost))
        tried.append((*scored, float(np.ptp(left_by_others(wide, run, scored[1].places)))))
    works = max(one.score for one, _, _ in tried)
    _, stuck, missed = best_of(tried, lambda item: item[1].score, EQUAL_ODDS)
    # Where the others are not explained themselves, they are no better witnesses than that.
    scale = max(1.0, stuck.left / max(others.dof, 1.0))
    return (stuck.score - works) / scale, missed


def _explained(means: StationMeans, size: float, cost: float) -> Explained:
    """The few effects that explain a residual best, each within some tolerances."""
    signatures = replace(means.signatures, tolerance=size * means.signatures.tolerance)
    (best,) = replace(means, signatures=signatures).explained(means.residual[:, None], cost)
    return best


def _by_scatter(problem: Problem, setups: Sequence[Scatter], setup: int, run: Rows) -> float:
    """Evidence of repeats that are all the same where the other dials' are not."""
    from scipy.special import erf

    step, others = float(problem.step[run].max()), problem.noise.resolution
    able = [s for s in setups if s.dof >= 2 and s.setup != setup]
    again = len(run) - len(np.unique(problem.station[run]))
    if not able or step <= 0:
        return 0.0
    shown = np.median([s.chi2 / s.dof / np.mean(s.weight**2) for s in able])
    # At best every true value stands in the middle of its step.
    scatter = np.sqrt(max(float(shown) - others**2 / 12, 1e-6 * others**2))
    return float(-again * np.log(erf(step / (np.sqrt(8) * scatter))))
