"""What a fit leaves, averaged over the visits to each station, past faults and effects at hand.

A systematic error repeats at every visit to a station, so hypotheses are compared on these means.
All vectors are whitened and free of what the fit explains. An effect that is taken into the model
widens the noise by ``S S^T``, S its signature at its tolerance: everything is whitened anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.evidence import Scoring, best_pairs
from orthoglide.diagnosis.faults import Fault, steps
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.errors import InputError, NumericsError
from orthoglide.fit import Problem, solve
from orthoglide.fit.least_squares import past
from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL_ODDS, best_of, largest

_NONE = 1e-9  # length of a direction, in that of the longest, below which it is rounding


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns ``(m, k)``."""
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, singular > _NONE * max(singular.max(initial=0.0), 1e-300)])


@dataclass(frozen=True)
class Explained:
    """A residual with the effects that explain it best."""

    score: float  # log evidence but for a constant
    left: float  # chi2 of the station means past the effects
    places: tuple[int, ...]  # of the effects among the candidates


@dataclass(frozen=True)
class StationMeans:
    """A residual and the signatures of all effects as station means.

    Vectors ``(g,)`` have a place for each of ``G`` stations and for what is known before. What the
    fit explains is projected out as ``x - left (right^T x)``, so that nothing of stations times
    readings is ever held.
    """

    signatures: Signatures  # with `columns` (g, E) and `residual` (g,) as station means
    seen: NDArray[np.bool_]  # stations with a reading that counts (G,)
    left: Array  # (g, q)
    right: Array  # (g, q)
    dof: float  # what noise alone makes of the residual's square

    @classmethod
    def of(cls, signatures: Signatures, known: Sequence[Fault] = ()) -> StationMeans:
        """Average over stations, the rows of known faults set free."""
        problem, n = signatures.estimate.problem, signatures.count
        weighing = problem.weighing
        counts = np.ones(n, dtype=bool)
        shown = [np.zeros((n, 0))]
        for fault in known:
            shown.append(steps(problem, fault))
            counts[fault.rows] &= not fault.sets_aside
        seen = np.bincount(weighing.station, counts) > 0

        def means(rows: Array) -> Array:
            stations = (weighing.along(rows[:n]).T * seen).T
            return np.concatenate([stations, rows[n:]])

        known_steps = signatures.whiten(np.hstack(shown))
        free = orthonormal(np.hstack([means(signatures.fitted), means(known_steps)]))
        averaged = replace(
            signatures,
            columns=past(free, means(signatures.columns)),
            residual=past(free, means(signatures.residual)),
        )
        dof = float(seen.sum() - np.sum(free[: len(seen)] ** 2))
        return cls(averaged, seen, free, free, dof)

    @classmethod
    def anew(
        cls, problem: Problem, known: Sequence[Fault] = (), *, widen: bool = False
    ) -> StationMeans | None:
        """Of a problem once all is identified anew; none where that does not end in a fit."""
        try:
            fit = solve(problem, method="nested", widen=widen)
            return cls.of(signatures(fit), known)
        except (InputError, NumericsError):
            return None

    def shown(self, readings: Array) -> Array:
        """Station means ``(g, ...)`` of what is added to the readings ``(n, ...)``, metres."""
        weighing = self.problem.weighing
        padded = np.zeros((len(self.residual), *readings.shape[1:]))
        stations = weighing.along(weighing.whiten(readings))
        padded[: len(self.seen)] = (stations.T * self.seen).T
        return np.asarray(padded - self.left @ (self.right.T @ padded))

    def together(self, values: Array, group: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Of a column for each group of stations, all at once.

        Args:
            values: whitened rows along their stations ``(G,)``.
            group: number of each station's group ``(G,)``.

        Returns:
            Of each, all ``(H,)``: its square past what is fitted, its product with the residual,
            and its square before.
        """
        n, shown = len(self.seen), self.seen * values
        count = int(group.max(initial=-1)) + 1
        by_left, by_right = np.zeros((2, count, self.left.shape[1]))
        np.add.at(by_left, group, self.left[:n] * shown[:, None])
        np.add.at(by_right, group, self.right[:n] * shown[:, None])
        whole = np.asarray(np.bincount(group, shown**2, minlength=count), dtype=float)
        across = by_right @ (self.left.T @ self.left) - 2 * by_left
        along = np.bincount(group, shown * self.residual[:n], minlength=count)
        square = whole + np.einsum("hq,hq->h", across, by_right)
        return square, along - by_right @ (self.left.T @ self.residual), whole

    @property
    def problem(self) -> Problem:
        """Of the fit."""
        return self.signatures.estimate.problem

    @property
    def residual(self) -> Array:
        """Station means of the residual ``(g,)``."""
        return self.signatures.residual

    @property
    def chi2(self) -> float:
        """Square of ``residual``."""
        return float(self.residual @ self.residual)

    @cached_property
    def floor(self) -> float:
        """Least chi2 a degree of freedom: the noise itself, or the rounding where it is unsure."""
        if self.problem.noise.source != "repeats":
            return 1.0
        noise = self.problem.noise
        return min(1.0, (noise.resolution / noise.typical) ** 2 / 12)

    def evidence(self, after: Array, size: int = 0) -> Array:
        """Log Bayes factor where chi2 falls to ``after``, with ``size`` readings' worth freed.

        Student's form, the noise known no better than what is left says of it.
        """
        dof = max(self.dof - size, 1e-9)
        least = dof * self.floor
        before = max(self.chi2, least)
        return np.asarray(dof / 2 * np.log(before / np.maximum(after, least)))

    @cached_property
    def scoring(self) -> Scoring:
        """All candidates of the catalogue."""
        return Scoring.of(self.signatures, self.signatures.candidates)

    @cached_property
    def best_effect(self) -> tuple[float, int]:
        """Evidence and place of the best effect of the catalogue."""
        if not self.signatures.candidates:
            return -np.inf, -1
        left = self.chi2 - self.scoring.gains(self.residual)
        evidence = self.evidence(left) - self.scoring.occam / 2
        return float(evidence.max()), largest(evidence, EQUAL_ODDS)

    def explained(self, residuals: Array, cost: float = 0.0) -> list[Explained]:
        """Residuals of station means ``(g, h)``, with what hypotheses change of them, each with its
        best one or two effects, or none; ``cost`` is the log odds against any single effect before
        the readings.
        """
        evidences = self.scoring.evidences(residuals)
        single = np.flatnonzero([c.size == 1 for c in self.scoring.candidates])
        pairs = best_pairs(self.scoring, residuals)
        found = []
        for k, residual in enumerate(residuals.T):
            one = int(single[largest(evidences[single, k], EQUAL_ODDS)])
            tried: list[tuple[float, tuple[int, ...]]] = [(float(evidences[one, k]) - cost, (one,))]
            tried += [(both - 2 * cost, members) for both, members in pairs[k : k + 1]]
            best, places = best_of([(0.0, ()), *tried], lambda weighed: weighed[0], EQUAL_ODDS)
            chi2 = float(residual @ residual)
            columns = [self.signatures.of(self.signatures.candidates[p]) for p in places]
            shape = np.hstack([np.zeros((len(residual), 0)), *columns])
            along = shape.T @ residual
            taken = along @ np.linalg.solve(shape.T @ shape + np.eye(len(along)), along)
            found.append(Explained(best - chi2 / 2, chi2 - float(taken), places))
        return found

    def beside(self, place: int) -> StationMeans:
        """The same with an effect of the catalogue in the model, its tolerance as a prior."""
        candidate = self.signatures.candidates[place]
        left, singular, _ = np.linalg.svd(self.signatures.of(candidate), full_matrices=False)
        left = left * np.sqrt(1 - 1 / np.sqrt(1 + singular**2))
        means = replace(
            self.signatures,
            columns=past(left, self.signatures.columns),
            residual=past(left, self.residual),
        )
        taken = float(np.sum(singular**2 / (1 + singular**2)))
        return replace(
            self,
            signatures=means,
            left=np.hstack([past(left, self.left), left]),
            right=np.hstack([self.right, left]),
            dof=self.dof - taken,
        )
