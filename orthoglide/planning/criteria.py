"""What a reading is worth: four criteria, each told what would be added and what was.

All see a step as the scalar observation ``d x + e`` of variance ``s2`` (see ``linear``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from orthoglide.geometry import Array
from orthoglide.planning.linear import Steps

_WORST = 150  # pairs that a discriminating step looks at: those told apart least


class Criterion(ABC):
    """A criterion with what it knows so far; immutable."""

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
        """How much better each step would make it ``(k,)``."""

    @abstractmethod
    def after(self, steps: Steps, k: int) -> Self:
        """The criterion once step ``k`` has been taken."""


@dataclass(frozen=True)
class Determinant(Criterion):
    """D-optimality: log det(information), unknowns in tolerances.

    Attributes:
        covariance: of the unknowns ``(P, P)``.
        gained: log det so far.
    """

    covariance: Array
    gained: float = 0.0

    @property
    def value(self) -> float:
        """Log det so far."""
        return self.gained

    def gains(self, steps: Steps) -> Array:
        """``log(1 + d C d' / s2)``: matrix determinant lemma."""
        return np.asarray(np.log1p(_spread(steps.columns, self.covariance) / steps.variance))

    def after(self, steps: Steps, k: int) -> Self:
        """Sherman and Morrison."""
        gained = self.gained + float(self.gains(steps)[k])
        return replace(self, covariance=_less(self.covariance, steps, k), gained=gained)


@dataclass(frozen=True)
class LeastVariance(Criterion):
    """The variance along one direction, as small as can be.

    Attributes:
        covariance: of the unknowns ``(P, P)``.
        direction: ``(P,)``.
    """

    covariance: Array
    direction: Array

    @property
    def variance(self) -> float:
        """Along the direction."""
        return float(self.direction @ self.covariance @ self.direction)

    @property
    def value(self) -> float:
        """Minus the logarithm of the variance."""
        return -float(np.log(max(self.variance, 1e-300)))

    def gains(self, steps: Steps) -> Array:
        """``-log(1 - (d C w)^2 / (s2 + d C d') / (w C w'))``."""
        seen = steps.columns @ (self.covariance @ self.direction)
        share = seen**2 / (steps.variance + _spread(steps.columns, self.covariance))
        return np.asarray(-np.log1p(-np.clip(share / self.variance, 0.0, 1 - 1e-12)))

    def after(self, steps: Steps, k: int) -> Self:
        """Sherman and Morrison."""
        return replace(self, covariance=_less(self.covariance, steps, k))


@dataclass(frozen=True)
class RivalSeparation(Criterion):
    """Rival explanations, as far apart as can be once each has been fitted again.

    For an ordered pair (a, b), a true and b fitted, every step raises the expected chi2 of b by
    ``(d (x_a - x_b) expected)^2 / (s2 + d C_b d')``. The last columns of the steps hold the
    readings that each rival predicts.

    Attributes:
        covariance: of the unknowns under each rival ``(K, P, P)``.
        pairs: ordered pairs of rivals ``(q, 2)``.
        shift: of the unknowns of b, fitted to a's readings so far ``(q, P)``.
        chi2: expected so far ``(q,)``.
        enough: chi2 beyond which no more is wanted.
    """

    covariance: Array
    pairs: Array
    shift: Array
    chi2: Array
    enough: float = np.inf

    @property
    def value(self) -> float:
        """Minus the logarithm of the mean relative likelihood of the wrong one."""
        return -float(_log_mean_exp(-self.chi2 / 2))

    @property
    def reached(self) -> bool:
        """Whether the least separated pair is far enough apart."""
        return bool(self.chi2.min() >= self.enough)

    @property
    def sigmas(self) -> dict[tuple[int, int], float]:
        """Root of the chi2 of each pair, the smaller of the two ways round."""
        found: dict[tuple[int, int], float] = {}
        for (a, b), chi2 in zip(self.pairs.tolist(), self.chi2.tolist(), strict=True):
            pair = (min(a, b), max(a, b))
            found[pair] = min(found.get(pair, np.inf), float(np.sqrt(chi2)))
        return found

    def _increments(self, steps: Steps) -> tuple[Array, Array]:
        count = self.covariance.shape[1]
        unknowns, predicted = steps.columns[:, :count], steps.columns[:, count:]
        a, b = self.pairs.T
        left = predicted[:, a] - predicted[:, b] - unknowns @ self.shift.T
        spread = np.stack([_spread(unknowns, c) for c in self.covariance], axis=1)
        return left, spread[:, b] + steps.variance[:, None]

    def gains(self, steps: Steps) -> Array:
        """Rise of ``value``."""
        left, variance = self._increments(steps)
        after = _log_mean_exp(-(self.chi2 + left**2 / variance) / 2)
        return np.asarray(-after - self.value)

    def after(self, steps: Steps, k: int) -> Self:
        """Kalman's update of every rival."""
        one = steps.part([k])
        left, variance = self._increments(one)
        d = one.columns[0, : self.covariance.shape[1]]
        gain = (self.covariance @ d)[self.pairs[:, 1]] / variance[0][:, None]
        covariance = np.stack([_less(c, one, 0) for c in self.covariance])
        return replace(
            self,
            covariance=covariance,
            shift=self.shift + gain * left[0][:, None],
            chi2=self.chi2 + left[0] ** 2 / variance[0],
        )


@dataclass(frozen=True)
class EffectSeparation(Criterion):
    """Effects at their tolerance, each as far from every other (and from none) as can be.

    With the Gram matrix G of the signatures past the base, a pair is
    ``min(G_ii, G_jj) - G_ij^2 / max(G_ii, G_jj)`` apart: the chi2 of one at tolerance when the
    other is fitted to it.

    Attributes:
        information: in tolerances, the base's priors in it ``(P, P)``.
        base: how many of the unknowns, the first ones, are fitted anyway.
        pairs: of effects ``(q, 2)``, counted from the first beyond the base; equal: against none.
    """

    information: Array
    base: int
    pairs: Array

    @property
    def gram(self) -> Array:
        """Signatures past the base, multiplied ``(E, E)``."""
        return gram(self.information, self.base)

    @property
    def squares(self) -> Array:
        """Squared separation of each pair ``(q,)``, in sigmas squared."""
        return separations(self.gram, self.pairs)

    @property
    def value(self) -> float:
        """Minus a sum that the least separated pairs rule."""
        return -float(np.sum(1 / (1 + self.squares)))

    def gains(self, steps: Steps) -> Array:
        """Rise of ``value`` over the pairs that are told apart least."""
        before = self.squares
        worst = np.argsort(before, kind="stable")[:_WORST]
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

    def after(self, steps: Steps, k: int) -> Self:
        """One more row of information."""
        d = steps.columns[k]
        return replace(self, information=self.information + np.outer(d, d) / steps.variance[k])


def gram(information: Array, base: int) -> Array:
    """Information on the effects ``(E, E)`` with the base fitted again."""
    top, side = information[:base, :base], information[:base, base:]
    return np.asarray(information[base:, base:] - side.T @ np.linalg.solve(top, side))


def separations(G: Array, pairs: Array) -> Array:
    """Squared separation of pairs of effects ``(q,)``; see :class:`EffectSeparation`."""
    i, j = pairs.T
    return _apart(G[i, i], G[j, j], G[i, j], i == j)


def _apart(one: Array, other: Array, both: Array, alone: Array) -> Array:
    large = np.maximum(one, other)
    apart = np.minimum(one, other) - both**2 / np.where(large > 0, large, 1.0)
    return np.asarray(np.where(alone, one, np.maximum(apart, 0.0)))


def _spread(columns: Array, covariance: Array) -> Array:
    return np.asarray(np.sum((columns @ covariance) * columns, axis=1))


def _less(covariance: Array, steps: Steps, k: int) -> Array:
    d = steps.columns[k, : len(covariance)]
    seen = covariance @ d
    return np.asarray(covariance - np.outer(seen, seen) / (steps.variance[k] + d @ seen))


def _log_mean_exp(x: Array) -> Array:
    top = x.max(axis=-1, keepdims=True)
    return np.asarray(np.log(np.mean(np.exp(x - top), axis=-1)) + top[..., 0])
