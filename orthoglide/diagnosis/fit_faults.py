"""Faults that only the fit betrays: a sign, a unit, two labels, a dial that stuck, no repeats.

Each is a hypothesis about the readings that competes with the best effect of the catalogue on the
same residual, seen through station means, as systematic errors repeat. Both are scored alike, the
noise known no better than what is left says: Student's form of the evidence,
``dof / 2 log(chi2 before / chi2 after)`` with chi2 never taken below the noise itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.faults import UNITS, Fault, Rows, in_order
from orthoglide.diagnosis.repeat_faults import EVIDENCE, FEWEST, span
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.geometry import Array
from orthoglide.identification import Problem
from orthoglide.identification.least_squares import linearise

MARGIN = 5.0
"""Log Bayes factor by which a fault must beat the best effect of the catalogue."""

_EFFECTS = 2  # of the catalogue that may be in the model beside a fault
_LACK = 1.5  # chi2 a degree of freedom below which nothing is worth looking for
_HALVED = 0.6  # share of the rms of its own setups that a fault may leave
_STUCK = 4  # equal readings one after the other
_MOVES, _SIGMAS = 5.0, 6.0  # steps of the dial and sigmas that a stuck dial must have missed
_SPOILT = 3.0  # resolutions that an outlier or a knock must reach


@dataclass(frozen=True)
class View:
    """A residual past everything known, and its station means.

    Attributes:
        seen: signatures, columns and residual past what is free ``(m, ...)``.
        averaging: orthonormal columns ``(m, g)``.
    """

    seen: Signatures
    averaging: Array

    @classmethod
    def of(cls, seen: Signatures) -> View:
        """Prepare the station means."""
        groups = seen.groups
        indicator = np.eye(int(groups.max()) + 1)[groups]
        shown = seen.whiten(indicator)
        left, singular, _ = np.linalg.svd(shown, full_matrices=False)
        kept = singular > 1e-6 * max(float(singular.max(initial=0.0)), 1e-300)
        return cls(seen, left[:, kept])

    @cached_property
    def residual(self) -> Array:
        """Station means of the residual ``(g,)``."""
        return np.asarray(self.averaging.T @ self.seen.residual)

    @cached_property
    def dof(self) -> float:
        """What noise alone makes of the square of ``residual``."""
        return float(np.sum(self.averaging[: self.seen.count] ** 2))

    @property
    def chi2(self) -> float:
        """Square of ``residual``."""
        return float(self.residual @ self.residual)

    def shown(self, readings: Array) -> Array:
        """Readings ``(n, ...)`` in metres as station means ``(g, ...)``."""
        return np.asarray(self.averaging.T @ self.seen.whiten(readings))

    def evidence(self, after: Array, size: int = 0) -> Array:
        """Log Bayes factor where chi2 falls to ``after``, with ``size`` readings' worth freed."""
        dof = max(self.dof - size, 1e-9)
        floor = dof * self._floor
        before = max(self.chi2, floor)
        return np.asarray(dof / 2 * np.log(before / np.maximum(after, floor)))

    @cached_property
    def _floor(self) -> float:
        problem = self.seen.estimate.problem
        if problem.noise.source != "repeats":
            return 1.0
        return min(1.0, (problem.machine.spec.dial.resolution / problem.noise.typical) ** 2 / 12)

    @cached_property
    def scoring(self) -> Scoring:
        """Candidates on station means."""
        return Scoring.of(self.seen, self.seen.candidates, self.averaging)

    @cached_property
    def rival(self) -> tuple[float, int]:
        """Evidence and place of the best effect of the catalogue."""
        if not self.seen.candidates:
            return -np.inf, -1
        gain = self.scoring.gains(self.residual)
        evidence = self.evidence(self.chi2 - gain) - self.scoring.occam / 2
        return float(evidence.max()), int(evidence.argmax())


def set_free(seen: Signatures, columns: Array) -> Signatures:
    """Signatures and residual past more columns of readings ``(n, k)``."""
    basis = span(seen.whiten(columns))
    return replace(
        seen,
        fitted=np.hstack([seen.fitted, basis]),
        columns=seen.columns - basis @ (basis.T @ seen.columns),
        residual=seen.residual - basis @ (basis.T @ seen.residual),
    )


def with_effect(seen: Signatures, place: int) -> Signatures:
    """Signatures and residual past an effect of the catalogue, its tolerance as a prior."""
    shape = seen.of(seen.candidates[place])
    size = shape.shape[1]
    basis = span(np.vstack([shape, np.eye(size)]))

    def longer(rows: Array) -> Array:
        return np.vstack([rows, np.zeros((size, rows.shape[1]))])

    columns, residual = longer(seen.columns), longer(seen.residual[:, None])
    return replace(
        seen,
        fitted=np.hstack([longer(seen.fitted), basis]),
        columns=columns - basis @ (basis.T @ columns),
        residual=(residual - basis @ (basis.T @ residual))[:, 0],
    )


def fit_fault(seen: Signatures, known: Sequence[Fault]) -> Fault | None:
    """The fault that explains most of what a fit leaves, if any does better than all effects.

    Args:
        seen: signatures at the fit of the readings without the known faults.
        known: faults found before; their rows take no part.
    """
    problem = seen.estimate.problem
    for fault in known:
        seen = set_free(seen, fault.columns(problem))
    for _ in range(_EFFECTS + 1):
        view = View.of(seen)
        if view.chi2 < _LACK * view.dof * view._floor:
            return None
        best = max(_hypotheses(view, known), key=lambda f: f.evidence, default=None)
        rival, place = view.rival
        if best is not None and best.evidence >= max(EVIDENCE, rival + MARGIN):
            return best
        if place < 0 or rival < EVIDENCE:
            return None
        seen = with_effect(seen, place)
    return None


def _hypotheses(view: View, known: Sequence[Fault]) -> Iterator[Fault]:
    touched = {s for f in known for s in f.setups}
    problem = view.seen.estimate.problem
    setups = [s for s in range(problem.setup_count) if s not in touched]
    yield from _changed(view, setups)
    yield from _relabelled(view, setups)
    yield from _single(view, setups)


# -- readings that mean something else ------------------------------------------------------------


def _changed(view: View, setups: list[int]) -> Iterator[Fault]:
    """A sign, a unit, or two columns exchanged: readings that fit once they are changed back."""
    problem = view.seen.estimate.problem
    measured, found = problem.measured, []
    for s in setups:
        rows = in_order(problem, s)
        found.append(("sign", (s,), rows, -measured[rows], -1.0))
        found += [("unit", (s,), rows, f * measured[rows], f) for f in UNITS]
    for one, other in _pairs(problem, setups):
        a, b = in_order(problem, one), in_order(problem, other)
        if len(a) == len(b):
            rows = np.concatenate([a, b])
            found.append(
                ("exchanged_labels", (one, other), rows, measured[np.concatenate([b, a])], 0.0)
            )
    if not found:
        return
    change = np.zeros((len(measured), len(found)))
    for k, (_, _, rows, values, _) in enumerate(found):
        change[rows, k] = values - measured[rows]
    after = np.sum((view.residual[:, None] + view.shown(change)) ** 2, axis=0)
    evidence = view.evidence(after) - np.log(len(found))
    for k in np.flatnonzero(evidence >= EVIDENCE):
        kind, own, rows, _, size = found[k]
        if _mended(view, own, change[:, k]):
            yield Fault(kind, rows, own, size, float(evidence[k]))  # type: ignore[arg-type]


def _mended(view: View, setups: tuple[int, ...], change: Array) -> bool:
    """Whether the setups' own residuals shrink: a fault that mends others is none."""
    rows = np.isin(view.seen.estimate.problem.setup_of_row, setups)
    before = view.seen.residual[: view.seen.count]
    after = before + view.seen.whiten(change)[: view.seen.count]
    noise = np.sqrt(rows.sum()) * 2
    size = float(np.linalg.norm(after[rows]))
    return size <= max(_HALVED * float(np.linalg.norm(before[rows])), noise)


def _pairs(problem: Problem, setups: list[int]) -> Iterator[tuple[int, int]]:
    """Two setups of one campaign."""
    ends = np.cumsum([len(c.setups) for c in problem.campaigns])
    home = np.searchsorted(ends, np.arange(problem.setup_count), side="right")
    for k, one in enumerate(setups):
        yield from ((one, other) for other in setups[k + 1 :] if home[one] == home[other])


def _relabelled(view: View, setups: list[int]) -> Iterator[Fault]:
    """Two setups that carry each other's leg, direction and place while the commands stay."""
    problem = view.seen.estimate.problem
    value = view.seen.estimate.at.value
    pairs = [p for p in _pairs(problem, setups) if not _same_commands(problem, *p)]
    if not pairs:
        return
    said = _under_each_label(problem, view.seen.estimate.x)
    for one, other in pairs:
        a, b = in_order(problem, one), in_order(problem, other)
        change = np.zeros(len(value))
        change[a] = value[a] - said[a, other]
        change[b] = value[b] - said[b, one]
        after = float(np.sum((view.residual + view.shown(change)) ** 2))
        evidence = float(view.evidence(np.array(after))) - float(np.log(len(pairs)))
        if evidence >= EVIDENCE and _mended(view, (one, other), change):
            yield Fault("exchanged_labels", np.concatenate([a, b]), (one, other), 1.0, evidence)


def _same_commands(problem: Problem, one: int, other: int) -> bool:
    commands = np.concatenate([c.command for c in problem.campaigns])
    a, b = in_order(problem, one), in_order(problem, other)
    return len(a) == len(b) and np.allclose(commands[a], commands[b], atol=1e-6)


def _under_each_label(problem: Problem, x: Array) -> Array:
    """What every row would read, datums apart, were it of each setup ``(n, setups)``, metres."""
    said = np.full((len(problem.measured), problem.setup_count), np.nan)
    first = 0
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.rows, strict=True)):
        count, n = len(campaign.setups), len(campaign)
        every = campaign.subset(np.tile(np.arange(n), count))
        every = replace(every, setup=np.repeat(np.arange(count), n))
        values = problem.machine.model.readings(problem.values(k, x), every)
        said[rows, first : first + count] = values.reshape(count, n).T
        first += count
    return said


# -- rows that contradict the rest ----------------------------------------------------------------


def _single(view: View, setups: list[int]) -> Iterator[Fault]:
    """Outliers and knocks where no repeat can show them."""
    problem = view.seen.estimate.problem
    visits = np.bincount(problem.station)[problem.station]
    found: list[tuple[str, Rows, int]] = []
    for s in setups:
        rows = in_order(problem, s)
        found += [("outlier", rows[[k]], s) for k in range(len(rows)) if visits[rows[k]] == 1]
        if (visits[rows] == 1).all():
            cuts = range(FEWEST, len(rows) - FEWEST + 1)
            found += [("knocked_stand", rows[k:], s) for k in cuts]
    if not found:
        return
    columns = np.zeros((len(problem.measured), len(found)))
    for k, (_, rows, _) in enumerate(found):
        columns[rows, k] = 1.0
    shown = view.shown(columns)
    square = np.sum(shown**2, axis=0)
    along = shown.T @ view.residual
    # What the fit can imitate almost wholly is no fault that it could show.
    seen = square > 0.2 * np.sum((columns.T * view.seen.weight) ** 2, axis=1) / columns.sum(axis=0)
    size = along / np.maximum(square, 1e-300)
    after = view.chi2 - along * size
    evidence = view.evidence(after, 1) - np.log(len(found))
    least = _SPOILT * problem.machine.spec.dial.resolution
    for k in np.flatnonzero(seen & (np.abs(size) >= least) & (evidence >= EVIDENCE)):
        kind, rows, s = found[k]
        yield Fault(kind, rows, (s,), float(size[k]), float(evidence[k]))  # type: ignore[arg-type]
