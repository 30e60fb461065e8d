"""Search of the active groups of coefficients beyond a background.

Readings ``r = A z + noise``, whitened, with all coefficients z in their tolerances. The *spike* of
every coefficient is N(0, s^2), with one scale s for the effects of the catalogue and one for the
free functions, averaged over a grid that includes excess noise. An active group has a *slab*,
N(0, tau^2) more, tau averaged over a grid. Given a state (the active groups with their tau), all
is Gaussian:

    ln Z = -(r^T S^-1 r + ln det S) / 2,     S = 1 + A D A^T

Each step adds, removes or exchanges one or two groups. Two active causes may explain the readings
only together, and a third cause may resemble their sum. All pairs of causes and data faults with
one coefficient are therefore compared, and a sparse regression on all of them finds where several
explain the readings only together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.gains import explained_by_group
from orthoglide.explanation.linear_model import (
    EXPECTED_CAUSES,
    NEGLIGIBLE_LOG_WEIGHT,
    Basis,
    LinearModel,
    Scale,
    left_singular,
    scale_grid,
)
from orthoglide.explanation.pairs import NEGLIGIBLE_LOG_ODDS, PartialProducts, likely_pairs
from orthoglide.explanation.sparse import sparse_prior_sd
from orthoglide.fit.least_squares import rounding
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of, descending, largest

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
        ends = np.cumsum([0, *(d.shape[1] for d in linear.visible_directions)])
        self._first_column, self._column_count = ends[:-1], int(ends[-1])
        self._columns_of_group = [np.arange(a, b) for a, b in pairwise(ends)]
        self._by_size: dict[int, list[int]] = {}
        for k, span in enumerate(self._columns_of_group):
            self._by_size.setdefault(len(span), []).append(k)
        # Groups share the prior by their relative priors, and taus share it equally.
        shares = sum(g.relative_prior for g in linear.groups if g.expected is None)
        rate = EXPECTED_CAUSES / max(shares, EXPECTED_CAUSES)
        expected = [rate * g.relative_prior if g.expected is None else g.expected
                    for g in linear.groups]  # fmt: skip
        self.cost = np.log(len(linear.slab_scales) / np.array(expected))
        self.visited: dict[State, Array] = {(): np.array([s.log_z for s in self.scales])}
        self.children: dict[State, Array] = {}
        self._products: dict[int, Array] = {}
        self._products_of_group: dict[int, Array] = {}
        self._search(start)
        for products in (self._products, self._products_of_group):
            products.clear()  # large, and hardly needed again
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

    def _search(self, start: Iterable[tuple[str, float]]) -> None:
        state: State = ()
        for group in sorted(self._given_groups):
            state = self.child(state, group)
        index_of = {g.name: k for k, g in enumerate(self.linear.groups)}
        earlier = tuple(sorted((index_of[name], tau) for name, tau in start if name in index_of))
        if self._given_groups <= {g for g, _ in earlier}:
            self.child_log_weights(earlier)
            state = best_of((state, earlier), self.log_weight, LOG_ODDS_MARGIN)
        self._climb_from(state)
        sparse = self._sparse_state()
        if best_of((self.best, sparse), self.log_weight, LOG_ODDS_MARGIN) != self.best:
            self._climb_from(sparse)

    def _climb_from(self, state: State) -> None:
        """Climb from a state to better ones until there is none; the last one is the best state.

        The log weight of a visited state never falls, despite rounding, so the climb ends.
        """
        better: State | None = state
        while better is not None:
            self.best = better
            better = self._better_state(self.best)

    def _better_state(self, state: State) -> State | None:
        """Return a state of more weight from ever larger neighbourhoods, if there is one."""
        for neighbours in (self._one_changed, self._two_changed):
            best = best_of((state, *neighbours(state)), self.log_weight, LOG_ODDS_MARGIN)
            if best != state:
                return best
        return None

    def _sparse_state(self) -> State:
        """Return a state of groups with one coefficient that explain the readings together, at the
        declared noise and the smallest background, beside the given groups, without those that cost
        more than they explain. If several causes are active, each alone may explain little, and
        larger noise as much: a search that adds one or two groups at a time goes astray.
        """
        declared = next(k for k, scale in enumerate(self.scales) if scale.noise == 0)
        taus, singles = np.array(self.linear.slab_scales), self._single_groups
        products = self._residual_products[declared, self._first_column[singles]]
        sd = sparse_prior_sd(self._crossed[declared], products, taus.max())
        found = dict.fromkeys(self._given_groups, float(taus.max()))
        for k in descending(sd)[: self.linear.max_active - len(found)]:
            if sd[k] > taus.min() / 2:
                nearest = np.abs(np.log(taus / sd[k])).argmin()
                found.setdefault(int(singles[k]), float(taus[nearest]))
        state = tuple(sorted(found.items()))
        while True:
            fewer = [state, *self._with_fewer(state, 1)]
            for one in fewer:
                self._weights_by_scale(one, self._partial_products(one, slice(0)))
            if (best := best_of(fewer, self.log_weight, LOG_ODDS_MARGIN)) == state:
                return state
            state = best

    def _one_changed(self, state: State) -> Iterator[State]:
        """Yield states with one group added, removed or exchanged."""
        yield from self._with_one_more(state)
        for smaller in self._with_fewer(state, 1):
            yield from self._with_one_more(smaller)
            yield smaller

    def _two_changed(self, state: State) -> Iterator[State]:
        """Yield states with two groups added, or one or two exchanged for two."""
        yield from self._with_pair(state, ())
        for count in (1, 2):
            for smaller in self._with_fewer(state, count):
                yield from self._with_pair(smaller, [g for g, _ in state])

    def _with_fewer(self, state: State, count: int) -> list[State]:
        """Return the states with ``count`` groups removed, given ones excepted."""
        removable = [s for s in state if s[0] not in self._given_groups]
        return [tuple(s for s in state if s not in out) for out in combinations(removable, count)]

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

    def _with_pair(self, state: State, excluded: Sequence[int]) -> list[State]:
        """Return the best state with two more groups of one coefficient, none in ``excluded``."""
        if len(state) + 2 > self.linear.max_active:
            return []
        singles, states = self._single_groups, list[State]()
        partial = self._partial_products(state, self._first_column[singles])
        weights = self._weights_by_scale(state, partial)
        # Scales at which even a pair that explained all of the remaining chi2 would be negligible
        # beside the best state are skipped.
        limits = weights + (self._chi2 - partial.explained) / 2
        is_possible = limits > self.log_weight(self.best) - NEGLIGIBLE_LOG_ODDS
        is_excluded = np.isin(singles, [*excluded, *(g for g, _ in state)])
        cost = np.where(is_excluded, np.inf, self.cost[singles])
        for i, tau, j, other_tau, log_weights in likely_pairs(
            self.linear.slab_scales,
            self._crossed,
            partial,
            weights,
            cost,
            self._coarse_scales & is_possible,
        ):
            pair = (int(singles[i]), tau), (int(singles[j]), other_tau)
            states.append(tuple(sorted((*state, *pair))))
            self.visited.setdefault(states[-1], log_weights)
        return [best_of(states, self.log_weight, LOG_ODDS_MARGIN)] if states else []

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
        """Return an expanded state with one more group, at the tau of an index."""
        child = tuple(sorted((*state, (group, self.linear.slab_scales[tau]))))
        self.visited.setdefault(child, self.children[state][:, group, tau])
        return child

    def _expand(self, state: State) -> Array:
        partial = self._partial_products(state)
        weights = self._weights_by_scale(state, partial)
        # The odds of a sound machine, and those of a given group, need all scales.
        is_complete = not state or bool(self._given_groups)
        explained, occam = self._gains(partial, None if is_complete else weights)
        table = explained / 2 - occam
        table += weights[:, None, None] - self.cost[:, None]
        table[:, [k for k, _ in state]] = -np.inf
        return table

    def _weights_by_scale(self, state: State, partial: PartialProducts) -> Array:
        """Return the log weights of a state ``(scales,)``, finite at all scales, and keep them in
        ``visited``. A group that is added later may have weight at any scale.
        """
        weights = self.visited.get(state)
        if weights is None or not np.isfinite(weights).all():
            found = self._log_weights(state, partial)
            self.visited[state] = found if weights is None else np.maximum(weights, found)
        return self.visited[state]

    def _log_weights(self, state: State, partial: PartialProducts) -> Array:
        """Return the log weights of a state ``(scales,)``."""
        prior_cost = sum(self.cost[group] for group, _ in state)
        gain = (partial.explained - partial.log_det) / 2
        return np.array([s.log_z for s in self.scales]) + gain - prior_cost

    def _gains(self, partial: PartialProducts, weights: Array | None = None) -> tuple[Array, Array]:
        """Return what each group explains of chi2 beside the active ones, and its Occam factor.

        Both are ``(scales, groups, taus)``; the second is half the log determinant. If the log
        weights without the groups ``(scales,)`` are given, a group may explain minus infinity where
        its weight would be lost in rounding beside that of a group with fewer coefficients.
        """
        taus = self.linear.slab_scales
        explained, occam = np.zeros((2, len(self.scales), len(self.linear.groups), len(taus)))
        components, products, *_ = partial
        best = -np.inf
        for size, members in sorted(self._by_size.items()):
            index = np.array([self._columns_of_group[g] for g in members])
            gram, scales = self._gram_matrices(size, index), np.arange(len(self.scales))
            least = -np.inf * np.ones((len(scales), len(members)))
            if weights is not None:
                least = 2 * (best - NEGLIGIBLE_LOG_WEIGHT - weights[:, None] + self.cost[members])
                explained[:, members] = -np.inf
                scales = np.flatnonzero(least.min(axis=1) < self._chi2 - partial.explained)
            parts = components[scales[:, None, None], :, index].transpose(0, 1, 3, 2)
            # If active groups have an equal signature, rounding may make the difference negative.
            remaining = gram[scales] - parts.transpose(0, 1, 3, 2) @ parts + rounding(gram[scales])
            gains = explained_by_group(
                remaining, products[scales[:, None, None], index], self._chi2[scales, None], taus,
                least[scales],
            )  # fmt: skip
            at = scales[:, None], np.array(members)
            explained[at], occam[at] = gains
            if weights is not None:
                added = gains[0] / 2 - gains[1] - self.cost[members][:, None]
                best = max(best, float((weights[scales, None, None] + added).max(initial=-np.inf)))
        return explained, occam

    @cached_property
    def _coarse_scales(self) -> NDArray[np.bool_]:
        """Scales that represent the grid ``(scales,)``: fewer noises, least free functions."""
        least = min(s.free_form_scale for s in self.scales)
        noises = sorted({s.noise for s in self.scales})[::2]
        return np.array([s.free_form_scale == least and s.noise in noises for s in self.scales])

    @cached_property
    def _single_groups(self) -> NDArray[np.intp]:
        """Indices of the visible causes and data faults with one coefficient."""
        named = [not g.free_form for g in self.linear.groups]
        sizes = zip(self.linear.groups, map(len, self._columns_of_group), strict=True)
        single = [group.size == count == 1 for group, count in sizes]
        return np.flatnonzero(np.array(named, dtype=bool) & np.array(single, dtype=bool))

    @cached_property
    def _crossed(self) -> Array:
        """Inner products of the columns of one-coefficient causes ``(scales, ones, ones)``."""
        index = self._first_column[self._single_groups]
        return np.stack([c.T @ c for s in self.scales for c in [s.some_group_columns(index)]])

    def _partial_products(
        self, state: State, at: NDArray[np.intp] | slice = slice(None)
    ) -> PartialProducts:
        """Partial the active groups out of group columns: those of the indices ``at``, or all.

        With ``L L^T = 1 + B^T B`` of the columns B of the active groups, each times its tau, the
        partial inner product of columns is ``a^T b - (L^-1 B^T a)^T (L^-1 B^T b)``.
        """
        active, taus = self._active_columns(state)
        residual, no_rows = self._residual_products, (len(self.scales), 0, self._column_count)
        of_groups = [np.zeros(no_rows), *(self._products_with(group) for group, _ in state)]
        rows = np.concatenate(of_groups, axis=1)
        square = taus[:, None] * rows[:, :, active] * taus
        root = np.linalg.cholesky(square + np.eye(len(taus)) + rounding(square))
        inverse = np.linalg.solve(root, np.diag(taus))
        components, of_residual = inverse @ rows[:, :, at], inverse @ residual[:, active, None]
        products = residual[:, at] - (of_residual.transpose(0, 2, 1) @ components)[:, 0]
        log_det = 2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        return PartialProducts(components, products, (of_residual**2).sum(axis=(1, 2)), log_det)

    def _active_columns(self, state: State) -> tuple[NDArray[np.intp], Array]:
        """Return the indices of the columns of the active groups ``(q,)``, and the tau of each."""
        index = [k for group, _ in state for k in self._columns_of_group[group]]
        taus = np.array([tau for group, tau in state for _ in self._columns_of_group[group]])
        return np.array(index, dtype=np.intp), taus

    def _products_with(self, group: int) -> Array:
        """Return inner products of a group's columns and all group columns ``(scales, q, K)``."""
        if group not in self._products_of_group:
            at = self._columns_of_group[group]
            rows = np.stack([s.some_group_columns(at).T for s in self.scales])
            self._products_of_group[group] = self._products_with_groups(rows)
        return self._products_of_group[group]

    @cached_property
    def _residual_products(self) -> Array:
        """Inner products of the residual and the columns of all groups ``(scales, K)``."""
        return self._products_with_groups(np.stack([s.residual[None] for s in self.scales]))[:, 0]

    @cached_property
    def _chi2(self) -> Array:
        """Squares of the whitened residuals of all scales ``(scales,)``."""
        return np.array([s.residual @ s.residual for s in self.scales])

    def _products_with_groups(self, rows: Array) -> Array:
        """Return inner products of rows ``(scales, q, m)`` and all columns ``(scales, q, K)``."""
        products = np.empty((*rows.shape[:2], self._column_count))
        for basis, scales, weights in self._scales_by_basis:
            weighted = (rows[scales] * weights[:, None]).reshape(-1, rows.shape[2])
            found = weighted @ basis.group_columns
            products[scales] = found.reshape(len(scales), -1, self._column_count)
        return products

    @cached_property
    def _scales_by_basis(self) -> list[tuple[Basis, NDArray[np.intp], Array]]:
        """Each basis with the indices of its scales, and their weights ``(scales, m)``."""
        bases = [scale.basis for scale in self.scales]
        indices = {basis: np.flatnonzero([b is basis for b in bases]) for basis in bases}
        weights = (np.stack([self.scales[k].weight for k in own]) for own in indices.values())
        return list(zip(indices, indices.values(), weights, strict=True))

    def _gram_matrices(self, size: int, index: NDArray[np.intp]) -> Array:
        """Return Gram matrices of all groups of a size ``(scales, groups, size, size)``."""
        if size not in self._products:
            found = self._products[size] = np.empty((len(self.scales), len(index), size, size))
            for basis, scales, weights in self._scales_by_basis:
                # Scales differ only in the directions with background, which come first.
                count = np.count_nonzero(basis.background_variance)
                some, others = np.split(basis.group_columns[:, index], [count])
                outer, others = some[..., None] * some[:, :, None], others.transpose(1, 2, 0).copy()
                found[scales] = others @ others.swapaxes(1, 2)
                found[scales] += np.tensordot(weights[:, :count] ** 2, outer, 1)
        return self._products[size]

    def _active_directions(self, scale: Scale, state: State) -> tuple[Array, Array]:
        """Return left singular vectors ``(m, q)`` of the active columns and their shrinkage
        ``(q,)``; :func:`shrink_along` takes both.
        """
        active, taus = self._active_columns(state)
        columns = scale.some_group_columns(active) * taus
        if not state:
            return columns, taus
        left, singular = left_singular(columns)
        return left, 1 - 1 / np.sqrt(1 + singular**2)
