"""What a reading is worth: four criteria, each by what is known so far.

All see a step as the scalar observation ``d x + e`` of variance ``s2`` (see ``linear``), which adds
``d' d / s2`` to the information.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL_ODDS, descending
from orthoglide.planning.linear import LinearReadings, Steps

_NONE = 1e-6  # sigmas squared: effects that nothing separates yet
_WORST = 150  # pairs that a discriminating step looks at: those told apart least


@dataclass(frozen=True)
class Criterion(ABC):
    """A criterion with what is known so far."""

    information: Array  # on all columns of the readings (P, P), priors in it

    @property
    @abstractmethod
    def value(self) -> float:
        """The larger the better."""

    @property
    def reached(self) -> bool:
        """Whether no more is wanted: never, as a rule; the readings asked for are the limit."""
        return False

    @abstractmethod
    def gains(self, steps: Steps) -> Array:
        """How much better each step would make the value ``(k,)``."""

    def after(self, steps: Steps, k: int) -> Self:
        """The criterion once step ``k`` has been taken."""
        d = steps.columns[k]
        return replace(self, information=self.information + np.outer(d, d) / steps.variance[k])

    def with_rows(self, readings: LinearReadings, rows: list[int]) -> Self:
        """The criterion once rows have been read, in mountings of their own."""
        return replace(self, information=self.information + readings.information(rows))


@dataclass(frozen=True)
class Determinant(Criterion):
    """D-optimality: log det(information), unknowns in tolerances."""

    @property
    def value(self) -> float:
        """Log det."""
        return float(np.linalg.slogdet(self.information)[1])

    def gains(self, steps: Steps) -> Array:
        """``log(1 + d C d' / s2)``: matrix determinant lemma."""
        covariance = np.asarray(np.linalg.inv(self.information))
        return np.asarray(np.log1p(_spread(steps.columns, covariance) / steps.variance))


@dataclass(frozen=True)
class LeastVariance(Criterion):
    """The variance along one direction, as small as can be."""

    direction: Array  # (P,)

    @property
    def variance(self) -> float:
        """Along the direction."""
        return float(self.direction @ np.linalg.solve(self.information, self.direction))

    @property
    def value(self) -> float:
        """Minus the logarithm of the variance."""
        return -float(np.log(max(self.variance, 1e-300)))

    def gains(self, steps: Steps) -> Array:
        """``-log(1 - (d C w)^2 / (s2 + d C d') / (w C w'))``."""
        covariance = np.asarray(np.linalg.inv(self.information))
        seen = steps.columns @ (covariance @ self.direction)
        share = seen**2 / (steps.variance + _spread(steps.columns, covariance))
        return np.asarray(-np.log1p(-np.clip(share / self.variance, 0.0, 1 - 1e-12)))


@dataclass(frozen=True)
class RivalSeparation(Criterion):
    """Rival explanations, as far apart as can be once each has been fitted again.

    The last columns of the readings are what each rival predicts of them. For an ordered pair
    (a, b), a true and b fitted, a step raises the expected chi2 of b by
    ``(d (x_a - x_b) expected)^2 / (s2 + d C_b d')``.
    """

    spread: Array  # covariance of the unknowns under each rival before any step (K, P, P)
    pairs: Array  # of rivals (q, 2); both ways round count
    enough: float = np.inf  # chi2 beyond which no more is wanted

    @classmethod
    def between(cls, spread: Array, pairs: Array, enough: float = np.inf) -> Self:
        """Rivals before any step."""
        return cls(np.zeros((sum(spread.shape[:2]),) * 2), spread, np.asarray(pairs), enough)

    @cached_property
    def _ordered(self) -> Array:
        return np.concatenate([self.pairs, self.pairs[:, ::-1]])

    @cached_property
    def _refitted(self) -> Array:
        """Covariance of the unknowns under each rival once fitted again ``(K, P, P)``."""
        size = self.spread.shape[1]
        known = np.eye(size) + self.information[:size, :size] @ self.spread
        # (C^-1 + W)^-1 = C (1 + W C)^-1, whatever C's rank.
        return np.asarray(self.spread @ np.linalg.inv(known))

    @cached_property
    def chi2(self) -> Array:
        """Expected of the wrong rival of each pair so far, then the other way round ``(2 q,)``."""
        size, W = self.spread.shape[1], self.information
        left = W[size:, size:] - W[size:, :size] @ self._refitted @ W[:size, size:]
        a, b = self._ordered.T
        return np.maximum(left[b, a, a] + left[b, b, b] - left[b, a, b] - left[b, b, a], 0.0)

    @property
    def sigmas(self) -> dict[tuple[int, int], float]:
        """Root of the chi2 of each pair, the smaller of the two ways round."""
        least = np.sqrt(self.chi2.reshape(2, -1).min(axis=0))
        return {(a, b): s for (a, b), s in zip(self.pairs.tolist(), least.tolist(), strict=True)}

    @property
    def value(self) -> float:
        """Minus the logarithm of the mean relative likelihood of the wrong one."""
        return -float(_log_mean_exp(-self.chi2 / 2))

    @property
    def reached(self) -> bool:
        """Whether the least separated pair is far enough apart."""
        return bool(self.chi2.min() >= self.enough)

    def gains(self, steps: Steps) -> Array:
        """Rise of ``value``."""
        size = self.spread.shape[1]
        unknowns, predicted = steps.columns[:, :size], steps.columns[:, size:]
        raised = np.empty((len(unknowns), len(self._ordered)))
        for rival, covariance in enumerate(self._refitted):
            mine = self._ordered[:, 1] == rival
            fitted = unknowns @ covariance
            expected = predicted - fitted @ self.information[:size, size:]
            left = expected[:, self._ordered[mine, 0]] - expected[:, [rival]]
            variance = np.sum(fitted * unknowns, axis=1) + steps.variance
            raised[:, mine] = left**2 / variance[:, None]
        return np.asarray(-_log_mean_exp(-(self.chi2 + raised) / 2) - self.value)


@dataclass(frozen=True)
class EffectSeparation(Criterion):
    """Effects at their tolerance, each as far from every other (and from none) as can be.

    With the Gram matrix G of the signatures past the base, a pair is
    ``min(G_ii, G_jj) - G_ij^2 / max(G_ii, G_jj)`` apart: the chi2 of one at tolerance when the
    other is fitted to it.
    """

    base: int  # how many of the unknowns, the first ones, are fitted anyway
    pairs: Array  # of effects (q, 2), counted from the first beyond the base; equal: against none

    @property
    def gram(self) -> Array:
        """Information on the effects ``(E, E)`` with the base fitted again."""
        b, M = self.base, self.information
        return np.asarray(M[b:, b:] - M[b:, :b] @ np.linalg.solve(M[:b, :b], M[:b, b:]))

    @property
    def squares(self) -> Array:
        """Squared separation of each pair ``(q,)``, in sigmas squared."""
        i, j = self.pairs.T
        G = self.gram
        return _apart(G[i, i], G[j, j], G[i, j], i == j)

    @property
    def value(self) -> float:
        """Minus a sum that the least separated pairs rule."""
        return -float(np.sum(1 / (1 + self.squares)))

    def gains(self, steps: Steps) -> Array:
        """Rise of ``value`` over the pairs that are told apart least."""
        before = self.squares
        worst = descending(-np.log(np.maximum(before, _NONE)), EQUAL_ODDS)[:_WORST]
        b, M = self.base, self.information
        regress = np.linalg.solve(M[:b, :b], M[:b, b:])
        left = steps.columns[:, b:] - steps.columns[:, :b] @ regress
        spread = _spread(steps.columns[:, :b], np.asarray(np.linalg.inv(M[:b, :b])))
        u = left / np.sqrt(steps.variance + spread)[:, None]
        i, j = self.pairs[worst].T
        G = self.gram
        after = _apart(
            G[i, i] + u[:, i] ** 2, G[j, j] + u[:, j] ** 2, G[i, j] + u[:, i] * u[:, j], i == j
        )
        return np.asarray(np.sum(1 / (1 + before[worst]) - 1 / (1 + after), axis=1))


def _apart(one: Array, other: Array, both: Array, alone: Array) -> Array:
    large = np.maximum(one, other)
    apart = np.minimum(one, other) - both**2 / np.where(large > 0, large, 1.0)
    return np.asarray(np.where(alone, one, np.maximum(apart, 0.0)))


def _spread(columns: Array, covariance: Array) -> Array:
    return np.asarray(np.sum((columns @ covariance) * columns, axis=1))


def _log_mean_exp(x: Array) -> Array:
    top = x.max(axis=-1, keepdims=True)
    return np.asarray(np.log(np.mean(np.exp(x - top), axis=-1)) + top[..., 0])
