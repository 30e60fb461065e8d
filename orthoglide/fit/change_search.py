"""Which parameters changed, all at once: a search over sets of them.

A change is a column in the readings after it, with a normal prior of one of a few widths, in
tolerances; everything else that the readings leave open has been marginalised before. With a set
and its widths all is Gaussian but for the size of the noise. Where several parameters changed, the
best single one is often none of them, so up to three members of a set are exchanged for the best
one or pair of all, as long as the set's weight grows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement

import numpy as np

from orthoglide.fit.least_squares import explained_by_two
from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL_ODDS, best_of, descending, largest

State = tuple[tuple[int, float], ...]
"""A set of changes: index of each hypothesis, with its prior width in tolerances."""

Weighed = tuple[float, State]
"""Log odds of a state against no change, and the state."""

WIDTHS = (1.0, 3.0, 10.0)
"""Tolerances by which something changes, each less likely by as much as it is wider."""

CLASS_WIDTH = 4.0
"""Rise of chi2 within which two causes cannot be told apart: two sigmas (Wilks)."""

_MOST = 12
_UNLIKELY = 7.0  # log odds against a set, beyond which it says nothing of sizes
_FEW = 6  # changes of which three may be exchanged for two others

_LIKELY = -np.log(np.array(WIDTHS) * np.sum(1 / np.array(WIDTHS)))


@dataclass(frozen=True)
class Found:
    """What changed, most decisive first."""

    places: tuple[int, ...]  # of the hypotheses
    evidence: Array  # log Bayes factor of each against the set without it (k,)
    sizes: Array  # of each, in units of its column (k,)
    sigmas: Array  # of these, the others of the set given only as they are known (k,)
    among: Array  # by how much more each is not known, as other sets could be right too (k,)
    # for each, it and the hypotheses that could stand in its place, with their sizes
    instead: tuple[dict[int, float], ...]
    weight: float  # log odds of the set against no change


@dataclass(frozen=True)
class Hypotheses:
    """Columns of what may have changed, past everything else that is open."""

    inner: Array  # their products, each at its tolerance (c, c)
    met: Array  # of these and the residual (c,)
    cost: Array  # log odds against each (c,)
    chi2: float  # square of the residual
    dof: float  # what noise alone makes of it
    floor: float = 1.0  # least chi2 a degree of freedom

    def found(self) -> Found | None:
        """The set of changes that the readings speak for most; ``None`` where for none."""
        state, weight = self._best()
        if not state:
            return None
        alone = np.array([weight - self._weight(_less(state, k)) for k in range(len(state))])
        order = descending(alone, EQUAL_ODDS)
        state = tuple(state[k] for k in order)
        sizes, sigmas = self._sizes(state)
        return Found(
            tuple(place for place, _ in state),
            alone[order],
            sizes,
            sigmas,
            self._among(state, weight, sizes, sigmas),
            tuple({place: sizes[k]} | self._rivals(state, k) for k, (place, _) in enumerate(state)),
            weight,
        )

    def _best(self) -> tuple[State, float]:
        """Return the best state and its log odds: greedy forward selection, then exchanges."""
        path: list[Weighed] = [(0.0, ())]
        while more := self._more(path[-1][1]):
            path += more
        weight, state = best_of(path, _log_odds, EQUAL_ODDS)
        while True:
            near = ((weight, state), *self._near(state))
            best, better = best_of(near, _log_odds, EQUAL_ODDS)
            if better == state:
                return state, weight
            state, weight = better, best

    def _near(self, state: State) -> Iterator[Weighed]:
        """Yield the states in which up to three changes are replaced by up to two others."""
        for count in range(4 if len(state) <= _FEW else 3):
            for gone in combinations(state, count):
                rest = tuple(s for s in state if s not in gone)
                yield self._weight(rest), rest
                yield from self._more(rest)
                yield from self._pair(rest)

    def _more(self, state: State) -> list[Weighed]:
        """The best state with one more change, if there may be one."""
        weights = self._weights(state)
        if len(state) >= _MOST or not np.isfinite(weights).any():
            return []
        place, width = np.unravel_index(largest(weights, EQUAL_ODDS), weights.shape)
        more = tuple(sorted((*state, (int(place), WIDTHS[width]))))
        return [(float(weights[place, width]), more)]

    def _pair(self, state: State) -> list[Weighed]:
        """The best state with two more: of two that resemble others neither alone need be good."""
        if len(state) + 2 > _MOST or len(self.met) < 2:
            return []
        gain, occam, left, met = self._past(state)
        square, out = np.diag(left), [place for place, _ in state]
        best: list[Weighed] = []
        for (a, likely), (b, other) in combinations_with_replacement(
            zip(WIDTHS, _LIKELY, strict=True), 2
        ):
            explained, spread = explained_by_two(
                1 + a * a * square[:, None], 1 + b * b * square, a * b * left,
                (a * met)[:, None], b * met,
            )  # fmt: skip
            weights = self.evidence(self.chi2 - gain - explained)
            weights += likely + other - self.cost[:, None] - self.cost
            weights -= (occam + np.log(spread)) / 2 + self._paid(state)
            weights[out], weights[:, out] = -np.inf, -np.inf
            np.fill_diagonal(weights, -np.inf)
            i, j = np.unravel_index(largest(weights, EQUAL_ODDS), weights.shape)
            if np.isfinite(weights[i, j]):
                two = tuple(sorted((*state, (int(i), a), (int(j), b))))
                best.append((float(weights[i, j]), two))
        return [best_of(best, _log_odds, EQUAL_ODDS)] if best else []

    def _weights(self, state: State) -> Array:
        """Return the log odds ``(c, widths)`` of a state with one more change."""
        gain, occam, left, met = self._past(state)
        square = np.square(WIDTHS)
        spread = 1 + square * np.diag(left)[:, None]
        found = self.evidence(self.chi2 - gain - square * met[:, None] ** 2 / spread)
        found += _LIKELY - self.cost[:, None] - (occam + np.log(spread)) / 2 - self._paid(state)
        found[[place for place, _ in state]] = -np.inf
        return found

    def _past(self, state: State) -> tuple[float, float, Array, Array]:
        """Past a state's changes: what they explain, the logarithm of their determinant, the
        products of all columns ``(c, c)``, and what these have of the residual ``(c,)``.
        """
        at, width = [place for place, _ in state], np.array([width for _, width in state])
        block = np.eye(len(at)) + width[:, None] * self.inner[np.ix_(at, at)] * width
        root = np.linalg.cholesky(block)
        across = np.linalg.solve(root, width[:, None] * self.inner[at])
        along = np.linalg.solve(root, width * self.met[at])
        left = self.inner - across.T @ across
        np.fill_diagonal(left, np.maximum(np.diag(left), 0.0))
        occam = 2 * float(np.log(np.diag(root)).sum())
        return float(along @ along), occam, left, self.met - across.T @ along

    def _weight(self, state: State) -> float:
        gain, occam, _, _ = self._past(state)
        return float(self.evidence(np.array(self.chi2 - gain)) - occam / 2 - self._paid(state))

    def _paid(self, state: State) -> float:
        return sum(float(self.cost[k] - _LIKELY[WIDTHS.index(w)]) for k, w in state)

    def evidence(self, left: Array) -> Array:
        """Log likelihood against no change where chi2 falls to ``left``.

        The noise is what is left says it is, but no less than is known of it.
        """
        each = np.append(np.asarray(left), self.chi2) / (self.dof * self.floor)
        shown = self.dof / 2 * np.where(each > 1, 1 + np.log(np.maximum(each, 1)), each)
        return np.asarray(shown[-1] - shown[:-1].reshape(np.shape(left)))

    def _sizes(self, state: State) -> tuple[Array, Array]:
        at, width = [place for place, _ in state], np.array([width for _, width in state])
        spread = np.linalg.inv(self.inner[np.ix_(at, at)] + np.diag(width**-2.0))
        left = self.chi2 - self._past(state)[0]
        scale = max(self.floor, left / self.dof)
        return np.asarray(spread @ self.met[at]), np.sqrt(scale * np.diag(spread))

    def _among(self, state: State, weight: float, sizes: Array, sigmas: Array) -> Array:
        """What the sets next to this one add to the sigma of each size ``(k,)``: those with one
        more, one less, or another in place of one, as likely as they are.
        """
        more, total = np.zeros(len(state)), np.ones(len(state))
        for near, other in self._next_to(state, weight):
            likely, at = np.exp(other - weight), [place for place, _ in near]
            each = dict(zip(at, zip(*self._sizes(near), strict=True), strict=True))
            for k, (place, _) in enumerate(state):
                if place in each:
                    size, sigma = each[place]
                    more[k] += likely * (sigma**2 - sigmas[k] ** 2 + (size - sizes[k]) ** 2)
                    total[k] += likely
        return np.sqrt(np.maximum(more / total, 0.0))

    def _next_to(self, state: State, weight: float) -> Iterator[tuple[State, float]]:
        for rest in (state, *(_less(state, k) for k in range(len(state)))):
            if rest != state:
                yield rest, self._weight(rest)
            weights = self._weights(rest)
            for place, width in np.argwhere(weights > weight - _UNLIKELY):
                near = (*rest, (int(place), WIDTHS[width]))
                if sorted(near) != sorted(state):
                    yield near, float(weights[place, width])

    def _rivals(self, state: State, k: int) -> dict[int, float]:
        """Return the alternatives to one change with their sizes, most probable first."""
        rest = _less(state, k)
        gain, _, left, met = self._past(rest)
        square = max(WIDTHS) ** 2
        left = np.diag(left)
        chi2 = self.chi2 - gain - square * met**2 / (1 + square * left)
        scale = max(self.floor, float(chi2[state[k][0]]) / self.dof)
        near = chi2 <= chi2[state[k][0]] + CLASS_WIDTH * scale
        near[[place for place, _ in state]] = False
        sizes = square * met / (1 + square * left)
        others = np.flatnonzero(near)
        return {
            int(j): float(sizes[j]) for j in others[descending(-chi2[others], EQUAL_ODDS * scale)]
        }


def _log_odds(weighed: Weighed) -> float:
    return weighed[0]


def _less(state: State, k: int) -> State:
    return state[:k] + state[k + 1 :]
