"""Spike and slab: a background of everything at a learned scale, and what stands out of it.

Readings ``r = A z + noise``, whitened, with all coefficients z in their tolerances. The *spike* of
every coefficient is N(0, s^2), with one scale s for the effects of the catalogue and one for the
free functions, averaged over a grid with one for errors that have no structure at all. A *slab*
lets one group of coefficients out, N(0, tau^2) more, tau averaged over a grid. With a
state (which groups are out, at which tau), all is Gaussian:

    ln Z = -(r^T S^-1 r + ln det S) / 2,     S = 1 + A D A^T

States are searched forward, the best group first, then each exchanged against all others; means
and covariances are averaged with the weights Z (Carvalho and Scott 2009; Wang et al. 2020, *A
simple new approach to variable selection in regression*, whose credible sets these are).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.posterior.linear import EXPECTED, SOUND, STRANGE, Linear, Scale, scales

_MOST = 6  # groups that stand out together
_FEW = 2  # coefficients of one cause: more are an effect whole
_NEARLY, _STARTS = 3.0, 2  # log odds of causes that may stand for one, and how many are tried
_NEGLIGIBLE = 1e-4  # weight of a state that means are not averaged over
_KEPT = 60  # of them at most

LEAST_SHARE = 0.05
"""Probability of a place from which it is part of the calibrated machine."""


State = tuple[tuple[int, float], ...]
"""Groups that stand out, by place, each with its tau."""


@dataclass(frozen=True, eq=False)
class Averaged:
    """Coefficients over all explanations.

    Attributes:
        mean: ``(C,)``.
        covariance: ``(C, C)``; zero for places that hardly stand out.
        prior: covariance before the readings, by the same weights ``(C, C)``; the same.
    """

    mean: Array
    covariance: Array
    prior: Array


class Mixture:
    """The states that explain the readings, with their weights."""

    def __init__(self, linear: Linear, given: Sequence[str] = ()) -> None:
        self.linear = linear
        self._given_names = frozenset(given)
        self.scales = scales(linear)
        ends = np.cumsum([0, *(g.size for g in linear.groups)])
        self._span = [np.arange(a, b) for a, b in pairwise(ends)]
        self._by_size: dict[int, list[int]] = {}
        for k, group in enumerate(linear.groups):
            self._by_size.setdefault(group.size, []).append(k)
        # Each slab is one of so many, at one of so many scales; strangers are rarer than what a
        # catalogue has.
        chance = np.array([STRANGE if g.free else 1.0 for g in linear.groups])
        self.cost = np.log(len(linear.slabs) * max(chance.sum() / EXPECTED, 1.0) / chance)
        self.visited: dict[State, Array] = {(): np.array([s.log_z for s in self.scales])}
        self.children: dict[State, Array] = {}
        self.best = self._search()

    # --- Search -----------------------------------------------------------------------------

    @cached_property
    def _known(self) -> frozenset[int]:
        """Groups that stand out whatever the readings say."""
        names = [g.name for g in self.linear.groups]
        return frozenset(names.index(n) for n in self._given_names if n in names)

    def _search(self) -> State:
        state: State = ()
        for group in sorted(self._known):
            state = self.child(state, group)
        while len(state) < _MOST:
            child = self._best_child(state)
            if child is None or self._total(child) < self._total(state):
                break
            state = self._split(self._exchanged(child))
        return state

    def _split(self, state: State) -> State:
        """Two lesser causes in place of one, where that is better.

        One may draw what two make, an effect whole most of all, and be better than either of them
        alone: then no exchange of one against another finds the two.
        """
        found = state
        for out in state:
            if out[0] in self._known or self.linear.groups[out[0]].free:
                continue
            for one in self._instead(tuple(s for s in state if s is not out), out[0]):
                if two := self._best_child(one, small=True):
                    found = max(found, self._exchanged(two), key=self._total)
        return found

    def _instead(self, rest: State, out: int) -> list[State]:
        """A state with the causes that are nearly as likely as one that it had besides; of an
        effect whole with the likeliest, however much less likely.
        """
        self._best_child(rest)
        table = self.children[rest]
        pooled = np.logaddexp.reduce(table, axis=(0, 2))
        whole = self.linear.groups[out].size > _FEW
        least = -np.inf if whole else pooled[out] - _NEARLY
        likely = [
            k
            for k in np.argsort(-pooled, kind="stable").tolist()
            if k != out and pooled[k] > least and self._small(k)
        ]
        return [self.child(rest, k) for k in likely[: 1 if whole else _STARTS]]

    def _small(self, group: int) -> bool:
        """Whether it is a cause of few coefficients, and no free function."""
        return not self.linear.groups[group].free and self.linear.groups[group].size <= _FEW

    def _exchanged(self, state: State) -> State:
        """Each group exchanged against the best of all others, as long as that is better."""
        for _ in range(4):
            own = [s for s in state if s[0] not in self._known]
            if not own:
                break
            rivals = [self._best_child(tuple(s for s in state if s is not out)) for out in own]
            better = max((r for r in rivals if r), key=self._total, default=state)
            fewer = max((tuple(s for s in state if s is not out) for out in own), key=self._total)
            better = max(better, fewer, key=self._total)
            if self._total(better) <= self._total(state) + 1e-9:
                break
            state = better
        return state

    def _total(self, state: State) -> float:
        weights = self.visited[state]
        top = weights.max()
        return float(top + np.log(np.exp(weights - top).sum()))

    def _best_child(self, state: State, *, small: bool = False) -> State | None:
        """Let one more group out: all of them at all scales, the best returned.

        Args:
            state: what is out already.
            small: whether only causes of few coefficients may be added.
        """
        if state not in self.children:
            self.children[state] = self._expand(state)
        table = self.children[state]  # (scales, groups, taus)
        if not np.isfinite(table).any():
            return None
        top = table.max()
        pooled = np.exp(table - top).sum(axis=0)
        if small:
            pooled[[not self._small(k) for k in range(len(pooled))]] = 0.0
        group, tau = np.unravel_index(int(np.argmax(pooled)), pooled.shape)
        return self._child(state, int(group), int(tau))

    def child(self, state: State, group: int) -> State:
        """The state with one more group out, at its likeliest scale."""
        self._best_child(state)
        table = self.children[state][:, group]
        return self._child(state, group, int(np.argmax(np.exp(table - table.max()).sum(axis=0))))

    @property
    def _sound(self) -> list[int]:
        """Scales of a machine that is sound but for what stands out."""
        return [k for k, s in enumerate(self.scales) if s.share <= SOUND and s.rough == 0]

    def over_sound_machine(self) -> Array:
        """Log Bayes factor of each group alone, on a sound machine, by tau ``(groups, taus)``."""
        self._best_child(())
        return np.asarray(
            self.children[()][self._sound].max(axis=0) - self.visited[()][self._sound].max()
        )

    def over_sound(self, state: State, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """As `likeliest`, on a sound machine."""
        logs = {k: self._log_z(self.scales[k], state) for k in self._sound}
        return self.moments(state, self.scales[max(logs, key=lambda k: logs[k])], at)

    def next_odds(self) -> Array:
        """Log Bayes factor of each group's standing out besides the best state ``(groups,)``."""
        self._best_child(self.best)
        table = self.children[self.best]
        top = self._total(self.best)
        with np.errstate(divide="ignore"):
            pooled = np.log(np.exp(table - top).sum(axis=(0, 2)))
        return np.asarray(pooled + self.cost)

    def _child(self, state: State, group: int, tau: int) -> State:
        child = tuple(sorted((*state, (group, self.linear.slabs[tau]))))
        self.visited[child] = self.children[state][:, group, tau]
        return child

    def _expand(self, state: State) -> Array:
        """Log weights ``(scales, groups, taus)`` of the state with one more group out."""
        if state not in self.visited:
            self.visited[state] = np.array(
                [self._log_z(s, state) - sum(self.cost[g] for g, _ in state) for s in self.scales]
            )
        taken = {k for k, _ in state}
        groups = self.linear.groups
        table = np.full((len(self.scales), len(groups), len(self.linear.slabs)), -np.inf)
        for k, scale in enumerate(self.scales):
            columns, along = self._given(scale, state)
            for members in self._by_size.values():
                span = np.array([self._span[g] for g in members])
                blocks = columns[:, span].transpose(1, 0, 2)
                gram = blocks.transpose(0, 2, 1) @ blocks
                values, vectors = np.linalg.eigh(gram)
                square = (vectors.transpose(0, 2, 1) @ along[span][:, :, None])[:, :, 0] ** 2
                values = np.maximum(values, 0.0)
                for t, tau in enumerate(self.linear.slabs):
                    grown = 1 + tau**2 * values
                    gain = (tau**2 * square / grown - np.log(grown)).sum(axis=1) / 2
                    table[k, members, t] = gain
            table[k] += self.visited[state][k] - self.cost[:, None]
        table[:, sorted(taken)] = -np.inf
        return table

    def _out(self, scale: Scale, state: State) -> tuple[Array, Array]:
        """What is out: left singular vectors ``(m, q)`` of its columns and what they shrink.

        :func:`_whitened` whitens what is out as well.
        """
        if not state:
            return np.zeros((len(scale.residual), 0)), np.zeros(0)
        by_group = scale.by_group
        columns = np.hstack([by_group[:, self._span[g]] * tau for g, tau in state])
        left, singular, _ = np.linalg.svd(columns, full_matrices=False)
        return left, 1 - 1 / np.sqrt(1 + singular**2)

    def _given(self, scale: Scale, state: State) -> tuple[Array, Array]:
        """All groups' columns with what is out whitened, and the residual along them."""
        columns, residual = scale.by_group, scale.residual
        if state:
            left, shrink = self._out(scale, state)
            columns = _whitened(columns, left, shrink)
            residual = _whitened(residual, left, shrink)
        return columns, np.asarray(columns.T @ residual)

    def _log_z(self, scale: Scale, state: State) -> float:
        left, shrink = self._out(scale, state)
        along = left.T @ scale.residual
        gain = along @ ((1 - (1 - shrink) ** 2) * along)
        return scale.log_z + 0.5 * float(gain) + float(np.log1p(-shrink).sum())

    # --- What follows -----------------------------------------------------------------------

    @cached_property
    def weights(self) -> dict[State, Array]:
        """Weights ``(scales,)`` of all states seen, summing to one over all."""
        logs: dict[State, Array] = dict(self.visited)
        for state, table in self.children.items():
            pooled = table.max(axis=0)
            for group, tau in zip(*np.nonzero(pooled > self._total(self.best) - 12), strict=True):
                child = tuple(sorted((*state, (int(group), self.linear.slabs[tau]))))
                logs.setdefault(child, table[:, group, tau])
        logs = {s: v for s, v in logs.items() if self._known <= {g for g, _ in s}}
        top = max(float(v.max()) for v in logs.values())
        raw = {s: np.exp(v - top) for s, v in logs.items()}
        total = sum(float(v.sum()) for v in raw.values())
        return {s: v / total for s, v in raw.items()}

    @cached_property
    def inclusion(self) -> Array:
        """Probability that each group stands out ``(groups,)``."""
        found = np.zeros(len(self.linear.groups))
        for state, weight in self.weights.items():
            for group in {g for g, _ in state}:
                found[group] += float(weight.sum())
        return found

    def without(self, member: int) -> State:
        """The best state without one of its groups."""
        return tuple(s for s in self.best if s[0] != member)

    @cached_property
    def strongest(self) -> tuple[int, ...]:
        """Groups of the best state, that first without which readings are explained worst."""
        left = {}
        for member, _ in self.best:
            self._best_child(rest := self.without(member))
            left[member] = self._total(rest)
        return tuple(sorted(left, key=lambda member: left[member]))

    def alternatives(self, member: int) -> Array:
        """Probability of each group ``(groups,)`` in one place of the best state, the rest given.

        The last entry, behind the groups, is that of nothing.
        """
        rest = self.without(member)
        self._best_child(rest)
        table = self.children[rest]
        nothing = self._total(rest)
        top = max(float(table.max()), nothing)
        by_group = np.exp(table - top).sum(axis=(0, 2))
        found = np.append(by_group, np.exp(nothing - top))
        return np.asarray(found / found.sum())

    @cached_property
    def shares(self) -> tuple[float, float, float]:
        """Mean scales: of the catalogue, of free functions, of errors of single stations."""
        by_scale = np.sum(list(self.weights.values()), axis=0)
        each = np.array([(s.share, s.free_share, s.rough) for s in self.scales])
        named, free, rough = (by_scale @ each).tolist()
        return named, free, rough

    @cached_property
    def named(self) -> tuple[State, Scale]:
        """The likeliest explanation without small errors that have no name: without those of
        single stations, and without free functions but those that stand out.
        """
        least = min(s.free_share for s in self.scales)
        plain = np.array([s.rough == 0 and s.free_share == least for s in self.scales])
        state = max(self.weights, key=lambda s: self.weights[s][plain].sum())
        return state, self.scales[int(np.argmax(np.where(plain, self.weights[state], -1.0)))]

    @cached_property
    def rare(self) -> float:
        """Probability of a machine beyond its tolerances altogether, or of errors of single
        stations that have no structure.
        """
        rare = np.array([s.rare > 0 for s in self.scales])
        return float(sum(weight[rare].sum() for weight in self.weights.values()))

    def precision(self, state: State, scale: Scale, *, unnamed: bool = False) -> Array:
        """Inverse covariance of the readings in a state ``(m, m)``; what has neither name nor
        place explains nothing there unless asked.
        """
        columns = self.linear.columns
        out = columns @ self._spread(state)
        spike = scale.spike if unnamed else np.where(self.linear.unnamed, 0.0, scale.spike)
        cov = (columns * spike) @ columns.T + out @ out.T
        return np.asarray(np.linalg.inv(cov + np.eye(len(cov))), dtype=np.float64)

    def _spread(self, state: State) -> Array:
        """What is out by coefficient ``(C, q)``, each times its tau."""
        count = len(self.linear.fixed)
        spread = np.zeros((count, 0))
        for group, tau in state:
            g = self.linear.groups[group]
            part = np.zeros((count, g.size))
            part[g.places] = g.weights * tau
            spread = np.hstack([spread, part])
        return spread

    def likeliest(self, state: State, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Mean ``(C,)``, and covariance ``(k, k)`` of some, in a state at its likeliest scales."""
        return self.moments(state, self.scales[int(np.argmax(self.visited[state]))], at)

    def moments(self, state: State, scale: Scale, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Mean ``(C,)`` of all coefficients in a state, and covariance ``(k, k)`` of some."""
        left, shrink = self._out(scale, state)
        residual = _whitened(scale.residual, left, shrink)
        columns = _whitened(scale.columns, left, shrink)
        spread = self._spread(state)
        # Prior covariance: the spike's diagonal and what is out.
        seen = columns * scale.spike + (columns @ spread) @ spread.T
        prior = np.diag(scale.spike[at]) + spread[at] @ spread[at].T
        return seen.T @ residual, prior - seen[:, at].T @ seen[:, at]

    def averaged(self, known: int) -> Averaged:
        """Everything over all states and scales that count.

        Args:
            known: the first so many coefficients have their covariance in any case, others where
                their group stands out with some probability.
        """
        likely = [g.places for g, p in zip(self.linear.groups, self.inclusion, strict=True)
                  if p > LEAST_SHARE]  # fmt: skip
        at = np.unique(np.concatenate([np.arange(known), *likely]).astype(int))
        flat = [
            (float(w), state, self.scales[k])
            for state, weights in self.weights.items()
            for k, w in enumerate(weights)
            if w > _NEGLIGIBLE
        ]
        flat.sort(key=lambda entry: -entry[0])
        flat = flat[:_KEPT]
        total = sum(w for w, _, _ in flat)
        size = len(self.linear.fixed)
        mean, second, prior = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
        block = np.ix_(at, at)
        for weight, state, scale in flat:
            m, cov = self.moments(state, scale, at)
            mean += weight / total * m
            second[block] += weight / total * (cov + np.outer(m[at], m[at]))
            spread = self._spread(state)[at]
            prior[block] += weight / total * (np.diag(scale.spike[at]) + spread @ spread.T)
        second[block] -= np.outer(mean[at], mean[at])
        return Averaged(mean, second, prior)


def _whitened(rows: Array, left: Array, shrink: Array) -> Array:
    """Rows ``(m, ...)`` shrunk along orthonormal directions ``(m, q)``."""
    return np.asarray(rows - (left * shrink) @ (left.T @ rows))
