"""Choosing readings: the gain of a further reading, and the readings of the largest gain.

A step is the scalar observation ``d x + e`` of variance ``s2`` (see ``linear``): it adds
``d' d / s2`` to the information on the unknowns. Two criteria measure its gain: the precision of
some combinations of the unknowns, and the separation of rival explanations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Self, TypeVar

import numpy as np
from scipy.special import logsumexp

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.ordering import largest
from orthoglide.planning.linear import LinearReadings, Steps

_MAX_READINGS = 500  # readings of a sheet: a day's work, and some minutes to choose
_MIN_GAIN = 1e-9  # gain below which a step is not worth a reading


@dataclass(frozen=True)
class Criterion(ABC):
    """A figure of merit of the information gained so far."""

    information: Array  # on all columns of the readings (P, P), priors in it

    @property
    def reached(self) -> bool:
        """True if no further reading is wanted; the number of readings is the limit otherwise."""
        return False

    @abstractmethod
    def gains(self, steps: Steps) -> Array:
        """Return by how much each step would raise the figure of merit ``(k,)``."""

    def with_step(self, steps: Steps, k: int) -> Self:
        """Return the criterion once step ``k`` has been taken."""
        d = steps.columns[k]
        return replace(self, information=self.information + np.outer(d, d) / steps.variance[k])

    def with_rows(self, readings: LinearReadings, rows: Sequence[int]) -> Self:
        """Return the criterion once rows have been read, in mountings of their own."""
        return replace(self, information=self.information + readings.information(rows))


@dataclass(frozen=True)
class CombinationPrecision(Criterion):
    """Precision of combinations A of the unknowns: ``-log det(A' C A)`` with their covariance C.

    It is D-optimality where A is the identity, and the variance of one combination where A is a
    column.
    """

    combinations: Array  # A (P, m)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns ``(P, P)``."""
        return np.asarray(np.linalg.inv(self.information))

    @cached_property
    def combination_covariance(self) -> Array:
        """Covariance of the combinations ``(m, m)``."""
        return np.asarray(self.combinations.T @ self.covariance @ self.combinations)

    @property
    def value(self) -> float:
        """Minus the logarithm of the determinant of the combinations' covariance."""
        return -float(np.linalg.slogdet(self.combination_covariance)[1])

    def gains(self, steps: Steps) -> Array:
        """Return ``-log(1 - d C A (A' C A)^-1 A' C d' / (s2 + d C d'))`` (determinant lemma)."""
        dC = steps.columns @ self.covariance
        dCA = dC @ self.combinations
        variance = steps.variance + np.sum(dC * steps.columns, axis=1)
        explained = np.sum(dCA * np.linalg.solve(self.combination_covariance, dCA.T).T, axis=1)
        # Rounding must not let a step explain everything.
        return np.asarray(-np.log1p(-np.minimum(explained / variance, 1 - 1e-12)))


@dataclass(frozen=True)
class RivalSeparation(Criterion):
    """How far rival explanations are separated once the unknowns have been fitted again.

    The last columns of the readings are the predictions of each rival. With the covariance C of the
    refitted unknowns, a step raises the expected chi2 between rivals a and b by
    ``(d (x_a - x_b) expected)^2 / (s2 + d C d')``.
    """

    prior_covariance: Array  # of the unknowns before any step, the mean of all rivals' (P, P)
    pairs: Array  # of rivals (q, 2)
    required_chi2: float = np.inf  # chi2 beyond which no more is wanted

    @classmethod
    def before(
        cls,
        covariances: Sequence[Array],
        pairs: Sequence[tuple[int, int]],
        required_chi2: float = np.inf,
    ) -> Self:
        """Return the criterion before any step, by each rival's covariance of the unknowns."""
        prior = np.mean(covariances, axis=0)
        information = np.zeros((len(prior) + len(covariances),) * 2)
        return cls(information, prior, np.array(pairs), required_chi2)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns once fitted again ``(P, P)``."""
        size = len(self.prior_covariance)
        update = np.eye(size) + self.information[:size, :size] @ self.prior_covariance
        # (C^-1 + W)^-1 = C (1 + W C)^-1, whatever C's rank.
        return np.asarray(self.prior_covariance @ np.linalg.inv(update))

    @cached_property
    def chi2(self) -> Array:
        """Expected chi2 of one rival where the other is true ``(q,)``."""
        size, W = len(self.prior_covariance), self.information
        R = W[size:, size:] - W[size:, :size] @ self.covariance @ W[:size, size:]
        a, b = self.pairs.T
        return np.maximum(R[a, a] + R[b, b] - 2 * R[a, b], 0.0)

    @property
    def sigmas(self) -> dict[tuple[int, int], float]:
        """Separation of each pair, the root of its chi2."""
        pairs = map(tuple, self.pairs.tolist())
        return dict(zip(pairs, np.sqrt(self.chi2).tolist(), strict=True))

    @property
    def value(self) -> float:
        """Minus the logarithm of the mean relative likelihood of the wrong rivals."""
        return float(np.log(len(self.chi2)) - logsumexp(-self.chi2 / 2))

    @property
    def reached(self) -> bool:
        """True if even the least separated pair is separated enough."""
        return bool(self.chi2.min() >= self.required_chi2)

    def gains(self, steps: Steps) -> Array:
        """Return the rise of ``value``."""
        size, (a, b) = len(self.prior_covariance), self.pairs.T
        unknowns, predicted = steps.columns[:, :size], steps.columns[:, size:]
        fitted = unknowns @ self.covariance
        expected = predicted - fitted @ self.information[:size, size:]
        variance = np.sum(fitted * unknowns, axis=1) + steps.variance
        chi2 = self.chi2 + (expected[:, a] - expected[:, b]) ** 2 / variance[:, None]
        return np.asarray(np.log(len(self.chi2)) - logsumexp(-chi2 / 2, axis=1) - self.value)


C = TypeVar("C", bound=Criterion)


def choose(
    readings: LinearReadings, start: C, count: int, *, mounting_cost: float = 2.0
) -> tuple[tuple[int, ...], C]:
    """Return the readings that raise a criterion most, step by step by the gain for the cost.

    Args:
        readings: to choose from.
        start: the criterion before any is taken.
        count: how many readings at most.
        mounting_cost: what it costs to mount a dial and take its first two readings, in readings.

    Returns:
        Rows of the pool, with repetitions, and the criterion with them.

    Raises:
        InputError: for a number of readings that is not whole, below two, or more than anybody
            reads.
    """
    if not isinstance(count, Real) or not 2 <= count <= _MAX_READINGS or count % 1:
        raise InputError(
            f"ask for 2 readings, as the datum of a setup is free, to {_MAX_READINGS}, not {count}"
        )
    taken, criterion = list[int](), start
    while len(taken) < count and not (taken and criterion.reached):
        steps = readings.next_steps(taken, int(count) - len(taken))
        if not len(steps.rows):
            break
        gains = criterion.gains(steps)
        k = largest(gains / np.where(steps.opens_mounting, mounting_cost, 1.0))
        if not gains[k] > _MIN_GAIN:
            break
        criterion = criterion.with_step(steps, k)
        taken += [row for row in steps.rows[k].tolist() if row >= 0]
    return tuple(taken), criterion
