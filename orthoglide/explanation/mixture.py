"""Spike-and-slab posterior: a background of learned scale and the groups active beyond it.

Means and covariances are averaged over the states that were searched, with their weights Z
(Carvalho and Scott 2009; Wang et al. 2020, *A simple new approach to variable selection in
regression*, whose credible sets these are).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.linear_model import (
    SOUND_BACKGROUND,
    Group,
    Scale,
    marginal_covariances,
    shrink_along,
)
from orthoglide.explanation.search import Search, State
from orthoglide.geometry import Array
from orthoglide.machine_file import symmetric_root
from orthoglide.ordering import LOG_ODDS_MARGIN, descending, largest, ranked

_NEGLIGIBLE = 1e-4  # weight below which a state is left out of averages
_MOST_TERMS = 60  # states and scales in an average: 240 changed no result
_LEAST_RELATIVE_WEIGHT = 0.05  # of a likely explanation, over that of the likeliest
_MOST_LIKELY_STATES = 8  # explanations that are tested: 16 changed no result
_CHILD_LOG_WEIGHT_RANGE = 12  # below the best log weight: a child of less weighs under 1e-5 of it

LEAST_PROBABILITY = 0.05
"""Least probability of a free-form error that enters the calibrated machine."""


class Mixture(Search):
    """Posterior over the states that were searched."""

    @cached_property
    def weights(self) -> dict[State, Array]:
        """Posterior probabilities ``(scales,)`` of the visited states that contain the given
        groups, and of their children near the best log weight; they sum to one.
        """
        logs: dict[State, Array] = dict(self.visited)
        least = self.log_weight(self.best) - _CHILD_LOG_WEIGHT_RANGE
        for state, table in self.children.items():
            for group, tau in np.argwhere(table.max(axis=0) > least).tolist():
                child = tuple(sorted((*state, (group, self.linear.slab_scales[tau]))))
                logs.setdefault(child, table[:, group, tau])
        logs = {s: v for s, v in logs.items() if self._given_groups <= {g for g, _ in s}}
        log_weights = np.stack(list(logs.values()))
        weights = np.exp(log_weights - log_weights.max())
        return dict(zip(logs, weights / weights.sum(), strict=True))

    @cached_property
    def inclusion(self) -> Array:
        """Probability that each group is active ``(groups,)``."""
        probabilities = np.zeros(len(self.linear.groups))
        for state, weight in self.weights.items():
            for group in {g for g, _ in state}:
                probabilities[group] += float(weight.sum())
        return probabilities

    @cached_property
    def likely_groups(self) -> tuple[Group, ...]:
        """Groups of the best state, and those more probable than ``LEAST_PROBABILITY``."""
        best = {group for group, _ in self.best}
        likely = [k in best or p > LEAST_PROBABILITY for k, p in enumerate(self.inclusion)]
        return tuple(compress(self.linear.groups, likely))

    def without(self, group: int) -> State:
        """Return the best state without one of its groups."""
        return tuple(s for s in self.best if s[0] != group)

    @cached_property
    def groups_by_importance(self) -> tuple[int, ...]:
        """Groups of the best state, ordered by the log weight lost when the group is removed."""
        loss = {}
        for group, _ in self.best:
            self.child_log_weights(smaller := self.without(group))
            loss[group] = -self.log_weight(smaller)
        return tuple(ranked(loss, lambda group: loss[group], LOG_ODDS_MARGIN))

    @cached_property
    def by_scale(self) -> Array:
        """Probability of each scale ``(scales,)``."""
        return np.asarray(np.sum(list(self.weights.values()), axis=0))

    @property
    def _least_flexible_scales(self) -> NDArray[np.bool_]:
        """Mask of the scales with declared noise and the least free-form scale ``(scales,)``."""
        least = min(s.free_form_scale for s in self.scales)
        return np.array([s.noise == 0 and s.free_form_scale == least for s in self.scales])

    @cached_property
    def likely_explanations(self) -> tuple[tuple[State, Scale], ...]:
        """Likely states, each with a scale without station errors, most probable first."""
        allowed = self._least_flexible_scales
        weight = {s: float(by_scale[allowed].sum()) for s, by_scale in self.weights.items()}
        order = ranked(weight, lambda state: weight[state])[:_MOST_LIKELY_STATES]
        likely = [s for s in order if weight[s] >= _LEAST_RELATIVE_WEIGHT * weight[order[0]]]
        best_scales = [largest(np.where(allowed, self.weights[s], -np.inf)) for s in likely]
        return tuple((s, self.scales[k]) for s, k in zip(likely, best_scales, strict=True))

    def likeliest_background(self) -> Scale:
        """Return the likeliest scale within tolerances, at the declared noise, no group active."""
        within = np.array([s.background_scale <= 1 for s in self.scales])
        allowed = self._least_flexible_scales & within
        return self.scales[largest(np.where(allowed, self.visited[()], -np.inf), LOG_ODDS_MARGIN)]

    def restricted_to(self, names: Collection[str]) -> tuple[tuple[State, Scale], ...]:
        """Return the likely explanations whose active groups are all in ``names``.

        If there is none, return the best state restricted to ``names`` over the likeliest
        background.
        """
        allowed = {k for k, group in enumerate(self.linear.groups) if group.name in names}
        matching = [e for e in self.likely_explanations if allowed.issuperset(g for g, _ in e[0])]
        if matching:
            return tuple(matching)
        state = tuple((group, tau) for group, tau in self.best if group in allowed)
        likeliest = largest(np.where(self._least_flexible_scales, self.by_scale, -np.inf))
        return ((state, self.scales[likeliest]),)

    @property
    def probability_rare(self) -> float:
        """Probability of a background beyond all tolerances, or of noise larger than declared.

        Larger noise counts only if repeats determine the noise.
        """
        return float(self.by_scale[[s.rare > 0 for s in self.scales]].sum())

    @property
    def probability_beyond_tolerance(self) -> float:
        """Probability of a background beyond all tolerances."""
        return float(self.by_scale[[s.background_scale > 1 for s in self.scales]].sum())

    @property
    def _sound_scales(self) -> NDArray[np.intp]:
        """Indices of the scales of a machine that is sound apart from its active groups."""
        sound = [s.background_scale <= SOUND_BACKGROUND and s.noise == 0 for s in self.scales]
        return np.flatnonzero(sound)

    def log_posterior_odds_if_sound(self) -> Array:
        """Return the log posterior odds of each single group at each tau against no active group,
        maximised over sound scales ``(groups, taus)``.
        """
        sound, table = self._sound_scales, self.child_log_weights(())
        return np.asarray(table[sound].max(axis=0) - self.visited[()][sound].max())

    def moments_if_sound(self, state: State, index: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` in a state on a sound machine."""
        sound = self._sound_scales
        logs = self._log_weights(state, self._partial_products(state))[sound]
        return self.moments(state, self.scales[sound[largest(logs, LOG_ODDS_MARGIN)]], index)

    @property
    def prior_log_odds_against(self) -> Array:
        """Prior log odds against each group, at whichever slab scale ``(groups,)``."""
        return self.cost - np.log(len(self.linear.slab_scales))

    @property
    def cause_cost(self) -> float:
        """Prior log odds against a single cause of the catalogue, at one slab scale."""
        costs = zip(self.cost, self.linear.groups, strict=True)
        # Groups share the prior in proportion to their relative priors.
        return next((c + np.log(g.relative_prior) for c, g in costs if g.expected is None), 0.0)

    def next_log_bayes_factors(self) -> Array:
        """Return the log Bayes factor of each group added to the best state ``(groups,)``."""
        table = self.child_log_weights(self.best)
        log_weight = self.log_weight(self.best)
        with np.errstate(divide="ignore"):
            pooled = np.log(np.exp(table - log_weight).sum(axis=(0, 2)))
        return np.asarray(pooled + self.prior_log_odds_against)

    def inverse_reading_covariance(
        self, state: State, scale: Scale, *, plate_shapes: bool = False
    ) -> Array:
        """Return the inverse marginal covariance of the readings in a state ``(m, m)``, declared
        noise included. The scale must have no station errors.

        Residual shapes of plates are included only if ``plate_shapes`` is true.
        """
        columns = self.linear.columns
        slabs = columns @ self.slab_root(state)
        excluded = self.linear.plate_shapes & (not plate_shapes)
        cov = (columns * np.where(excluded, 0.0, scale.spike)) @ columns.T + slabs @ slabs.T
        return np.asarray(np.linalg.inv(cov + np.eye(len(cov))), dtype=np.float64)

    def slab_root(self, state: State) -> Array:
        """Return a root of the slab covariance of a state's active groups ``(C, q)``."""
        count = len(self.linear.fixed_sd)
        blocks = [np.zeros((count, 0))]
        for group, tau in ((self.linear.groups[k], tau) for k, tau in state):
            blocks.append(np.zeros((count, group.size)))
            blocks[-1][group.coefficients] = group.weights * tau * group.unit
        return np.hstack(blocks)

    @property
    def machine_slab_root(self) -> Array:
        """That of the groups of the machine in the best state ``(C, q)``."""
        groups = self.linear.groups
        return self.slab_root(tuple((k, tau) for k, tau in self.best if not groups[k].of_data))

    def likeliest_moments(self, state: State, index: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` in a state at its likeliest scales."""
        return self.moments(state, self._likeliest_scale(state), index)

    def likeliest_mean(self, state: State) -> Array:
        """Return the mean of all coefficients ``(C,)`` in a state at its likeliest scales."""
        return self._mean(state, self._likeliest_scale(state))

    def likeliest_variance(self, index: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return posterior and prior variance of coefficients in the best state ``(k,)``."""
        scale = self._likeliest_scale(self.best)
        prior = scale.spike[index] + np.sum(self.slab_root(self.best)[index] ** 2, axis=1)
        return np.diag(self._covariances(index)(self.best, scale)), prior

    def _likeliest_scale(self, state: State) -> Scale:
        """Return the scale of largest weight in a state."""
        if len(self.scales) == 1:
            return self.scales[0]
        if state in self.visited:
            return self.scales[largest(self.visited[state], LOG_ODDS_MARGIN)]
        return self.scales[largest(self.weights[state])]

    @cached_property
    def _chi2_of_best(self) -> float:
        """Chi2 of the best state at its likeliest scale, its priors counted."""
        scale = self._likeliest_scale(self.best)
        left, shrink = self._active_directions(scale, self.best)
        residual = shrink_along(scale.residual, left, shrink)
        return float(residual @ residual)

    @property
    def chi2_per_dof(self) -> float:
        """Chi2 per degree of freedom of the best state, its priors counted."""
        dof = len(self.linear.residual) + self.linear.station_remainder.dof
        return self.chi2_with_remainder / max(dof, 1)

    @property
    def chi2_with_remainder(self) -> float:
        """Chi2 of the best state, with that of station means that no column moves."""
        variance = self._likeliest_scale(self.best).basis.station_variance
        return self._chi2_of_best + self.linear.station_remainder.chi2 / variance

    def alternatives_to(self, group: int, rise: float) -> dict[int, float]:
        """Return the groups that could be active in place of one, with the size of each.

        All have one coefficient. They are judged at the widest slab, over the likeliest background.

        Args:
            group: index of a group of the best state.
            rise: by how much chi2 may be larger than with ``group``.

        Returns:
            Size by group; the group that explains most comes first.
        """
        smaller = self.without(group)
        scale = self.scales.index(self._likeliest_scale(self.best))
        explained = self._gains(self._partial_products(smaller))[0][scale, :, -1]
        fits_nearly_as_well = explained >= explained[group] - rise
        fits_nearly_as_well[[g for g, _ in self.best]] = False
        others, sizes = np.flatnonzero(fits_nearly_as_well), dict[int, float]()
        order = descending(explained[others], LOG_ODDS_MARGIN)
        for other in others[order].tolist():
            state = tuple(sorted((*smaller, (other, self.linear.slab_scales[-1]))))
            coefficient = self.linear.groups[other].coefficients[0]
            sizes[other] = float(self.likeliest_mean(state)[coefficient])
        return sizes

    def size_and_spread(self, group: int) -> tuple[float, float, float]:
        """Return the size of a group of one coefficient, its standard deviation within the best
        state, and the additional standard deviation from other states that contain the group.
        """
        index = self.linear.groups[group].coefficients
        covariance, best_scale = self._covariances(index), self._likeliest_scale(self.best)
        size = float(self._mean(self.best, best_scale)[index[0]])
        variance, added, total = float(covariance(self.best, best_scale)[0, 0]), 0.0, 0.0
        for (weight, state, scale), other_mean in zip(self._terms, self._means, strict=True):
            if any(g == group for g, _ in state):
                other_variance = float(covariance(state, scale)[0, 0])
                shift = float(other_mean[index[0]]) - size
                added += weight * (other_variance - variance + shift**2)
                total += weight
        spread = max(added / max(total, 1e-300), 0.0)
        return size, float(np.sqrt(variance)), float(np.sqrt(spread))

    def moments(self, state: State, scale: Scale, index: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` of some coefficients in a state."""
        return self._mean(state, scale), self._covariances(index)(state, scale)

    def _mean(self, state: State, scale: Scale) -> Array:
        """Return the mean of all coefficients in a state at a scale ``(C,)``."""
        left, shrink = self._active_directions(scale, state)
        slab_root = self.slab_root(state)
        shrunk_once = shrink_along(scale.residual, left, shrink)
        products = scale.products_with_columns(shrink_along(shrunk_once, left, shrink))
        return np.asarray(scale.spike * products + slab_root @ (slab_root.T @ products))

    def _covariances(self, index: NDArray[np.intp]) -> Callable[[State, Scale], Array]:
        """Return a function of state and scale: the covariance of some coefficients ``(k, k)``."""
        covariance = marginal_covariances(self.linear, index)
        return lambda state, scale: covariance(scale, self.slab_root(state))

    @cached_property
    def _terms(self) -> tuple[tuple[float, State, Scale], ...]:
        """Weight, state and scale of every term of the averages."""
        # Scales of equal noise and prior variances, such as those without a free function, are one.
        keys = [(s.spike.tobytes(), s.noise) for s in self.scales]
        first = [keys.index(key) for key in keys]
        states, weights = list(self.weights), np.zeros((len(self.weights), len(first)))
        np.add.at(weights.T, first, np.stack(list(self.weights.values())).T)
        likely = np.flatnonzero(weights > _NEGLIGIBLE)
        order = likely[descending(weights.flat[likely])[:_MOST_TERMS]]
        index = [divmod(int(k), len(self.scales)) for k in order]
        total = sum(float(weights[k]) for k in index)
        return tuple((float(weights[k]) / total, states[k[0]], self.scales[k[1]]) for k in index)

    @cached_property
    def _means(self) -> list[Array]:
        """Means of all coefficients ``(C,)`` in each term of the averages."""
        return [self._mean(state, scale) for _, state, scale in self._terms]

    @cached_property
    def mean(self) -> Array:
        """Mean of all coefficients, averaged over states and scales ``(C,)``."""
        weighted = (w * m for (w, _, _), m in zip(self._terms, self._means, strict=True))
        return np.asarray(sum(weighted))

    def draws(self, weights: Array, normal: Array) -> Array:
        """Draw linear combinations of the coefficients from the posterior, stratified by term.

        Args:
            weights: of the combinations, by coefficient ``(k, C)``.
            normal: draws of the standard normal distribution ``(n, k)``.

        Returns:
            As many draws ``(n, k)``.
        """
        index = np.flatnonzero(weights.any(axis=0))
        cumulated = np.cumsum([weight for weight, _, _ in self._terms])
        term = np.searchsorted(cumulated[:-1], (np.arange(len(normal)) + 0.5) / len(normal))
        drawn, covariance = np.empty(normal.shape), self._covariances(index)
        for k in np.unique(term):
            _, state, scale = self._terms[k]
            combinations = weights[:, index]
            root = symmetric_root(combinations @ covariance(state, scale) @ combinations.T)
            in_term = term == k
            drawn[in_term] = weights @ self._means[k] + normal[in_term] @ root.T
        return drawn

    def averaged_covariances(self, count: int) -> tuple[Array, Array]:
        """Return the posterior and the prior covariance of the coefficients ``(C, C)``, averaged
        over states and scales.

        They cover the first ``count`` coefficients, and those of `likely_groups`; other entries are
        zero.
        """
        spans = [group.coefficients for group in self.likely_groups]
        index = np.unique(np.concatenate([np.arange(count), *spans]).astype(int))
        size = len(self.linear.fixed_sd)
        second_moment, prior = np.zeros((size, size)), np.zeros((size, size))
        block, covariance_of = np.ix_(index, index), self._covariances(index)
        for (weight, state, scale), mean in zip(self._terms, self._means, strict=True):
            covariance = covariance_of(state, scale)
            second_moment[block] += weight * (covariance + np.outer(mean[index], mean[index]))
            slab_root = self.slab_root(state)[index]
            prior[block] += weight * (np.diag(scale.spike[index]) + slab_root @ slab_root.T)
        second_moment[block] -= np.outer(self.mean[index], self.mean[index])
        return second_moment, prior
