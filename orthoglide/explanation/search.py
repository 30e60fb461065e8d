"""Search of the active groups of coefficients beyond a background.

Readings ``r = A z + noise``, whitened, with all coefficients z in their tolerances. The *spike* of
every coefficient is N(0, s^2), with one scale s for the effects of the catalogue and one for the
free functions, averaged over a grid that includes excess noise. An active group has a *slab*,
N(0, tau^2) more, tau averaged over a grid. Given a state (the active groups with their tau), all
is Gaussian:

    ln Z = -(r^T S^-1 r + ln det S) / 2,     S = 1 + A D A^T

The search adds one or two groups, and removes none, one or two. All pairs of causes with one
coefficient are tried: where two are active, neither alone need be better than a wide background,
and no other pair with equal signatures is nearer.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.linear_model import EXPECTED_CAUSES, LinearModel, Scale, scale_grid
from orthoglide.explanation.pairs import likely_pairs
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of, largest

_MOST_FOR_TRIPLES = 6  # active groups of which three may be exchanged for two others

State = tuple[tuple[int, float], ...]
"""Active groups by index, each with its tau."""


class Search:
    """States of active groups, with the log weight of each given the readings.

    Args:
        linear: the readings.
        given: names of groups that are active in every state.
        start: best state of nearly the same readings, as names with their taus.

    Attributes:
        scales: of the background.
        cost: prior log odds against each group being active, at one tau ``(groups,)``.
        visited: log weights of states by scale ``(scales,)``.
        children: log weights of states with one more group ``(scales, groups, taus)``.
        best: the state of largest weight.
    """

    def __init__(
        self,
        linear: LinearModel,
        given: Sequence[str] = (),
        start: Iterable[tuple[str, float]] = (),
    ) -> None:
        self.linear = linear
        self._given_names = frozenset(given)
        self.scales = scale_grid(linear)
        ends = np.cumsum([0, *(seen.shape[1] for seen in linear.visible_directions)])
        self._first_column = ends[:-1]
        self._columns_of_group = [np.arange(a, b) for a, b in pairwise(ends)]
        self._by_size: dict[int, list[int]] = {}
        for k, span in enumerate(self._columns_of_group):
            self._by_size.setdefault(len(span), []).append(k)
        # The prior is shared by all groups in their chances, and equally by the taus.
        often = EXPECTED_CAUSES / max(
            sum(g.relative_prior for g in linear.groups if g.expected is None), EXPECTED_CAUSES
        )
        expected = [
            often * g.relative_prior if g.expected is None else g.expected for g in linear.groups
        ]
        self.cost = np.log(len(linear.slab_scales) / np.array(expected))
        self.visited: dict[State, Array] = {(): np.array([s.log_z for s in self.scales])}
        self.children: dict[State, Array] = {}
        self._products: dict[int, Array] = {}
        self.best = self._search(start)
        self._products.clear()  # large, and hardly needed again
        self.__dict__.pop("_crossed", None)

    @cached_property
    def _given_groups(self) -> frozenset[int]:
        """Indices of the groups that are active in every state."""
        names = [g.name for g in self.linear.groups]
        return frozenset(names.index(n) for n in self._given_names if n in names)

    @cached_property
    def active_groups(self) -> tuple[tuple[str, float], ...]:
        """The best state as names of groups with their taus."""
        return tuple((self.linear.groups[k].name, tau) for k, tau in self.best)

    def _search(self, start: Iterable[tuple[str, float]]) -> State:
        state: State = ()
        for group in sorted(self._given_groups):
            state = self.child(state, group)
        place = {g.name: k for k, g in enumerate(self.linear.groups)}
        earlier = tuple(sorted((place[name], tau) for name, tau in start if name in place))
        if self._given_groups <= {g for g, _ in earlier}:
            self.child_log_weights(earlier)
            state = best_of((state, earlier), self.log_weight, LOG_ODDS_MARGIN)
        # A state keeps the weight of its first visit, despite rounding, so the loop terminates.
        while better := self._better_state(state):
            state = better
        return state

    def _better_state(self, state: State) -> State | None:
        """Return a state of more weight from ever larger neighbourhoods, if there is one."""
        for reach in (
            self._one_changed,
            self._two_changed,
            self._three_changed,
            self._best_children,
        ):
            best = best_of((state, *reach(state)), self.log_weight, LOG_ODDS_MARGIN)
            if best != state:
                return best
        return None

    def _one_changed(self, state: State) -> Iterator[State]:
        """Yield states with one group added, removed or exchanged."""
        yield from self._with_one_more(state)
        for rest in self._with_fewer(state, 1):
            yield from self._with_one_more(rest)
            yield rest

    def _two_changed(self, state: State) -> Iterator[State]:
        """Yield states with two or three groups added, or one or two exchanged for two.

        Where several groups are active, a wide background may fit as well as all but one of them:
        only the last one makes the background narrow.
        """
        further = [two for one in self._with_one_more(state) for two in self._with_one_more(one)]
        further += self._with_pair(state, ())
        yield from further
        for two in further:
            yield from self._with_one_more(two)
        for count in (1, 2):
            for rest in self._with_fewer(state, count):
                yield from self._with_pair(rest, [g for g, _ in state])

    def _three_changed(self, state: State) -> Iterator[State]:
        """Yield states with two or three groups removed, or exchanged for one or two others.

        Over a grid of backgrounds this would take half of the time and find nothing more.
        """
        few = len(state) <= _MOST_FOR_TRIPLES
        for count in range(2, 3 + few) if len(self.scales) == 1 else ():
            for rest in self._with_fewer(state, count):
                yield from self._with_one_more(rest)
                yield from self._with_pair(rest, ())
                yield rest

    def _best_children(self, _: State) -> Iterator[State]:
        """Yield the best child of every state that was expanded so far."""
        for state in list(self.children):
            if self._given_groups <= {g for g, _ in state}:
                yield from self._with_one_more(state)

    def _with_fewer(self, state: State, count: int) -> list[State]:
        """Return the states with ``count`` groups removed, given ones excepted."""
        own = [s for s in state if s[0] not in self._given_groups]
        return [tuple(s for s in state if s not in out) for out in combinations(own, count)]

    def _with_one_more(self, state: State) -> list[State]:
        """Return the best state with one more group, as a list; empty if there is none."""
        if len(state) >= self.linear.max_active:
            return []
        table = self.child_log_weights(state)
        if not np.isfinite(table).any():
            return []
        pooled = np.logaddexp.reduce(table, axis=0)
        group, tau = np.unravel_index(largest(pooled, LOG_ODDS_MARGIN), pooled.shape)
        return [self._with_group_at(state, int(group), int(tau))]

    def _with_pair(self, state: State, but: Sequence[int]) -> list[State]:
        """Return the best state with two more one-coefficient causes, those in ``but`` excluded."""
        if len(state) + 2 > self.linear.max_active:
            return []
        self.child_log_weights(state)
        left, shrink = self._active_directions(self.scales, state)
        inside, met = self._past_active(left, shrink, self._first_column[self._single_causes])
        seen = self._crossed - inside.transpose(0, 2, 1) @ inside
        out = np.isin(self._single_causes, [*but, *(g for g, _ in state)])
        cost = np.where(out, np.inf, self.cost[self._single_causes])
        found = []
        base = self.visited[state], self._explained(left, shrink)
        for i, tau, j, other, logs in likely_pairs(
            self.linear, seen, met, base, cost, self._coarse_scales
        ):
            pair = (int(self._single_causes[i]), tau), (int(self._single_causes[j]), other)
            found.append(tuple(sorted((*state, *pair))))
            self.visited.setdefault(found[-1], logs)
        return [best_of(found, self.log_weight, LOG_ODDS_MARGIN)] if found else []

    def log_weight(self, state: State) -> float:
        """Return the log weight of a visited state, summed over scales."""
        return float(np.logaddexp.reduce(self.visited[state]))

    def child_log_weights(self, state: State) -> Array:
        """Return log weights ``(scales, groups, taus)`` of a state with one more group."""
        if state not in self.children:
            self.children[state] = self._expand(state)
        return self.children[state]

    def child(self, state: State, group: int) -> State:
        """Return a state with one more group, at the likeliest tau."""
        pooled = np.logaddexp.reduce(self.child_log_weights(state)[:, group], axis=0)
        return self._with_group_at(state, group, largest(pooled, LOG_ODDS_MARGIN))

    def _with_group_at(self, state: State, group: int, tau: int) -> State:
        child = tuple(sorted((*state, (group, self.linear.slab_scales[tau]))))
        self.visited.setdefault(child, self.children[state][:, group, tau])
        return child

    def _expand(self, state: State) -> Array:
        left, shrink = self._active_directions(self.scales, state)
        if state not in self.visited:
            paid = sum(
                self.cost[g] - self.linear.log_odds_by_slab.get(tau, 0.0) for g, tau in state
            )
            self.visited[state] = self._log_z(self.scales, left, shrink) - paid
        explained, occam = self._gains(left, shrink)
        table = self.linear.log_likelihood_gain(explained, self._explained(left, shrink)) - occam
        table += list(self.linear.log_odds_by_slab.values()) - self.cost[:, None]
        table += self.visited[state][:, None, None]
        table[:, [k for k, _ in state]] = -np.inf
        return table

    def _gains(self, left: Array, shrink: Array) -> tuple[Array, Array]:
        """Return what each group explains of chi2 past the active ones, and its Occam factor.

        Both ``(scales, groups, taus)``; the second is half the log determinant.
        """
        shape = len(self.scales), len(self.linear.groups), len(self.linear.slab_scales)
        explained, occam = np.zeros(shape), np.zeros(shape)
        inside, met = self._past_active(left, shrink, np.arange(self._residual_products.shape[1]))
        square = np.array([[s.residual @ s.residual] for s in self.scales])
        for size, members in self._by_size.items():
            at = np.array([self._columns_of_group[g] for g in members])
            out = inside[:, :, at].transpose(0, 2, 3, 1)
            inner = self._gram_matrices(size, at)
            beside = inner - out @ out.transpose(0, 1, 3, 2)
            # Where active groups have an equal signature, rounding may make this negative.
            beside[..., range(size), range(size)] += (
                1e-13 * np.trace(inner, axis1=2, axis2=3)[..., None]
            )
            for t, tau in enumerate(self.linear.slab_scales):
                found = explained_by_group(beside, met[:, at], square, tau)
                explained[:, members, t], occam[:, members, t] = found
        return explained, occam

    @cached_property
    def _coarse_scales(self) -> list[int]:
        """Indices of scales that represent the grid: fewer noises, least free functions."""
        least = min(s.free_form_scale for s in self.scales)
        noise = sorted({s.noise for s in self.scales})[::2]
        return [
            k for k, s in enumerate(self.scales) if s.free_form_scale == least and s.noise in noise
        ]

    @cached_property
    def _single_causes(self) -> NDArray[np.intp]:
        """Indices of the visible causes with one coefficient."""
        each = zip(self.linear.groups, self._columns_of_group, strict=True)
        return np.flatnonzero(
            [g.size == len(span) == 1 and not g.free_form and not g.of_data for g, span in each]
        )

    @cached_property
    def _crossed(self) -> Array:
        """Inner products of the columns of one-coefficient causes ``(scales, ones, ones)``."""
        at = self._first_column[self._single_causes]
        each = (s.some_group_columns(at) for s in self.scales)
        return np.stack([columns.T @ columns for columns in each])

    def _past_active(self, left: Array, shrink: Array, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Project columns of the groups past the active ones.

        Returns:
            Their components along the active groups ``(scales, q, k)``, and their products with
            the residual past these ``(scales, k)``.
        """
        taken = np.sqrt(1 - (1 - shrink[..., None]) ** 2) * left.transpose(0, 2, 1)
        met = (taken @ self._residuals[..., None])[..., 0]
        along = self._products_with_groups(taken, at)
        return along, self._residual_products[:, at] - (met[:, None] @ along)[:, 0]

    @cached_property
    def _residual_products(self) -> Array:
        """Inner products of the residual and the columns of all groups ``(scales, K)``."""
        each = np.arange(sum(map(len, self._columns_of_group)))
        return self._products_with_groups(self._residuals[:, None], each)[:, 0]

    @cached_property
    def _residuals(self) -> Array:
        """Whitened residuals of all scales ``(scales, m)``."""
        return np.stack([s.residual for s in self.scales])

    def _products_with_groups(self, rows: Array, at: NDArray[np.intp]) -> Array:
        """Return inner products of rows ``(scales, q, m)`` and columns ``(scales, q, k)``.

        Scales of one basis are computed together, as its columns are large.
        """
        found = np.empty((*rows.shape[:2], len(at)))
        for basis in dict.fromkeys(s.basis for s in self.scales):
            own = [k for k, s in enumerate(self.scales) if s.basis is basis]
            every = len(at) == basis.group_columns.shape[1]
            columns = basis.group_columns if every else basis.group_columns[:, at]
            weighed = np.concatenate([rows[k] * self.scales[k].weight for k in own])
            found[own] = (weighed @ columns).reshape(len(own), *found.shape[1:])
        return found

    def _gram_matrices(self, size: int, at: NDArray[np.intp]) -> Array:
        """Return Gram matrices of all groups of a size ``(scales, groups, size, size)``."""
        if size not in self._products:
            each = (s.some_group_columns(at.ravel()).T.reshape(*at.shape, -1) for s in self.scales)
            self._products[size] = np.stack([b @ b.transpose(0, 2, 1) for b in each])
        return self._products[size]

    def _active_directions(self, scales: Sequence[Scale], state: State) -> tuple[Array, Array]:
        """Return left singular vectors of the active columns and their shrinkage.

        Shapes ``(scales, m, q)`` and ``(scales, q)``; :func:`shrink_along` takes both.
        """
        at = [k for group, _ in state for k in self._columns_of_group[group]]
        tau = np.array([tau for group, tau in state for _ in self._columns_of_group[group]])
        columns = (
            np.stack([s.some_group_columns(np.array(at, dtype=np.intp)) for s in scales]) * tau
        )
        if not at:
            return columns, np.zeros((len(scales), 0))
        left, singular = left_singular(columns)
        return left, 1 - 1 / np.sqrt(1 + singular**2)

    def _log_z(self, scales: Sequence[Scale], left: Array, shrink: Array) -> Array:
        """Return the log marginal likelihood with the active groups ``(scales,)``."""
        residuals = np.stack([s.residual for s in scales])
        gain = self._explained(left, shrink, residuals)
        plain = np.array([s.log_z for s in scales]) + np.log1p(-shrink).sum(axis=1)
        return np.asarray(plain + self.linear.log_likelihood_gain(gain, np.zeros(len(gain))))

    def _explained(self, left: Array, shrink: Array, residuals: Array | None = None) -> Array:
        """Return what the active groups explain of chi2 ``(scales,)``."""
        residuals = self._residuals if residuals is None else residuals
        along = (residuals[:, None] @ left)[:, 0]
        return np.asarray(((1 - (1 - shrink) ** 2) * along**2).sum(axis=1))


def left_singular(columns: Array) -> tuple[Array, Array]:
    """Return left singular vectors ``(..., m, q)`` and singular values ``(..., q)`` of columns.

    LAPACK's divide and conquer fails to converge for some regular matrices. Then eigenvectors of
    the Gram matrix are used, which are less exact for small singular values.
    """
    try:
        left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    except np.linalg.LinAlgError:
        square, turn = np.linalg.eigh(columns.swapaxes(-1, -2) @ columns)
        count = min(columns.shape[-2:])
        turn = turn[..., ::-1][..., :count]
        singular = np.sqrt(np.maximum(square[..., ::-1][..., :count], 0.0))
        least = 1e-7 * singular.max(axis=-1, initial=1e-300, keepdims=True)
        singular = np.where(singular > least, singular, 0.0)
        left = (columns @ turn) / np.maximum(singular, least)[..., None, :]
        left = np.where(singular[..., None, :] > 0, left, 0.0)
    return left, singular


def explained_by_group(inner: Array, met: Array, square: Array, tau: float) -> tuple[Array, Array]:
    """Return what each group explains of chi2, and half the log determinant, both ``(...)``.

    With noise as declared, half the first less the second is the log Bayes factor of the group.

    Args:
        inner: Gram matrices of their columns ``(..., k, k)``.
        met: inner products of columns and residual ``(..., k)``.
        square: upper bound of the squared residual, broadcast to ``(...)``.
        tau: scale of the slab.
    """
    count = met.shape[-1]
    if count == 1:
        wider = 1 + tau**2 * inner[..., 0, 0]
        return np.asarray((tau * met[..., 0]) ** 2 / wider), np.asarray(np.log(wider) / 2)
    bordered = np.zeros((*met.shape[:-1], count + 1, count + 1))
    bordered[..., :count, :count] = tau**2 * inner + np.eye(count)
    bordered[..., count, :count] = tau * met
    bordered[..., count, count] = edge = 2.0 * square + 1.0  # positive, whatever rounding does
    root = np.diagonal(np.linalg.cholesky(bordered), axis1=-2, axis2=-1)
    explained = edge - root[..., count] ** 2
    return np.asarray(explained), np.asarray(np.log(root[..., :count]).sum(axis=-1))


def shrink_along(rows: Array, left: Array, shrink: Array) -> Array:
    """Return rows ``(m, ...)`` shrunk along orthonormal directions ``(m, q)``."""
    return np.asarray(rows - (left * shrink) @ (left.T @ rows))
