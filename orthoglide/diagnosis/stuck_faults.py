"""Dials that stuck: equal readings one after the other where all the rest says they should move."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.diagnosis.fault_view import View
from orthoglide.diagnosis.faults import Fault, Rows, in_order
from orthoglide.diagnosis.fit_faults import MARGIN
from orthoglide.diagnosis.repeat_faults import EVIDENCE, Within, scatter, span
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.fit import Problem

_EQUAL = 4  # readings one after the other
_MOVES, _SIGMAS = 5.0, 6.0  # steps of the dial and sigmas that they must have missed


def stuck_faults(seen: Signatures) -> list[Fault]:
    """Runs of equal readings that repeats contradict, or the fit more than any effect explains."""
    problem = seen.estimate.problem
    runs = [(s, run) for s in range(problem.setup_count) for run in _runs(problem, s)]
    if not runs:
        return []
    view = View.of(seen)
    setups = [Within.of(seen.estimate, s, ()) for s in range(problem.setup_count)]
    scale = scatter(problem, setups)
    found = []
    for setup, run in runs:
        missed = _missed(view, run)
        least = max(
            _MOVES * problem.machine.spec.dial.resolution,
            _SIGMAS * float(problem.sigma[run].max()),
        )
        if missed < least:
            continue
        repeats = _by_repeats(setups[setup], run, scale) - np.log(len(runs))
        fit = _by_fit(view, run) - np.log(len(runs))
        if repeats >= EVIDENCE or fit + max(repeats, 0.0) >= max(EVIDENCE, view.rival[0] + MARGIN):
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


def _missed(view: View, run: Rows) -> float:
    """How far the dial should have moved over the run, says a fit without it; metres."""
    shown = view.seen.whiten(np.eye(view.seen.count)[:, run])
    off = np.linalg.lstsq(shown, view.seen.residual, rcond=1e-6)[0]
    return float(np.ptp(off))


def _by_repeats(own: Within, run: Rows, scale: float) -> float:
    """Evidence of earlier visits to the same stations."""
    inside = own.outliers[:, np.isin(own.rows, run)]
    basis = span(inside) if np.abs(inside).max(initial=0.0) > 1e-6 else inside[:, :0]
    size = basis.shape[1]
    if not size:
        return 0.0
    gain = np.sum((basis.T @ own.rest) ** 2)
    return float(own.evidence(gain, size, scale)) - size


def _by_fit(view: View, run: Rows) -> float:
    """Evidence of all other readings, through the fit."""
    basis = span(view.shown(np.eye(view.seen.count)[:, run]))
    after = view.chi2 - float(np.sum((basis.T @ view.residual) ** 2))
    return float(view.evidence(np.array(after), basis.shape[1])) - basis.shape[1]
