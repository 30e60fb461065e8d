"""Spike-and-slab posterior: a background of learned scale and the groups active beyond it.

Means and covariances are averaged over the states that were searched, with their weights Z
(Carvalho and Scott 2009; Wang et al. 2020, *A simple new approach to variable selection in
regression*, whose credible sets these are).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from orthoglide.explanation.linear_model import SOUND_BACKGROUND, Scale
from orthoglide.explanation.search import Search, State, shrink_along
from orthoglide.geometry import Array
from orthoglide.machine_file import symmetric_root
from orthoglide.ordering import LOG_ODDS_MARGIN, descending, largest, ranked

_NEGLIGIBLE = 1e-4  # weight below which a state is left out of averages
_MOST_TERMS = 60  # most states and scales in an average
_LEAST_RELATIVE_WEIGHT, _MOST_LIKELY_STATES = (
    0.05,
    8,
)  # weight of explanations over that of the likeliest, and their number

LEAST_PROBABILITY = 0.05
"""Least probability of a free-form error that enters the calibrated machine."""


@dataclass(frozen=True, eq=False)
class AveragedMoments:
    """Moments of the coefficients, averaged over all explanations."""

    mean: Array  # (C,)
    covariance: Array  # (C, C); zero for free-form errors that are improbable
    prior: Array  # prior covariance, averaged with equal weights and equally zero (C, C)


class Mixture(Search):
    """Posterior over the states that were searched."""

    @cached_property
    def weights(self) -> dict[State, Array]:
        """Posterior probabilities ``(scales,)`` of all visited states, with sum one."""
        logs: dict[State, Array] = dict(self.visited)
        for state, table in self.children.items():
            pooled = table.max(axis=0)
            for group, tau in zip(
                *np.nonzero(pooled > self.log_weight(self.best) - 12), strict=True
            ):
                child = tuple(sorted((*state, (int(group), self.linear.slab_scales[tau]))))
                logs.setdefault(child, table[:, group, tau])
        logs = {s: v for s, v in logs.items() if self._given_groups <= {g for g, _ in s}}
        every = np.stack(list(logs.values()))
        raw = np.exp(every - every.max())
        return dict(zip(logs, raw / raw.sum(), strict=True))

    @cached_property
    def inclusion(self) -> Array:
        """Probability that each group is active ``(groups,)``."""
        found = np.zeros(len(self.linear.groups))
        for state, weight in self.weights.items():
            for group in {g for g, _ in state}:
                found[group] += float(weight.sum())
        return found

    def without(self, member: int) -> State:
        """Return the best state without one of its groups."""
        return tuple(s for s in self.best if s[0] != member)

    @cached_property
    def strongest(self) -> tuple[int, ...]:
        """Groups of the best state, in the order of how much the fit needs them."""
        left = {}
        for member, _ in self.best:
            self.child_log_weights(rest := self.without(member))
            left[member] = self.log_weight(rest)
        return tuple(ranked(left, lambda member: -left[member], LOG_ODDS_MARGIN))

    @cached_property
    def mean_scales(self) -> tuple[float, float, float]:
        """Posterior mean scales of the catalogue, the free functions and the excess noise."""
        by_scale = np.sum(list(self.weights.values()), axis=0)
        each = np.array([(s.background_scale, s.free_form_scale, s.noise) for s in self.scales])
        named, free, noise = (by_scale @ each).tolist()
        return named, free, noise

    @property
    def _declared_noise_scales(self) -> NDArray[np.bool_]:
        """Mask of the scales without station errors and with least free functions ``(scales,)``."""
        least = min(s.free_form_scale for s in self.scales)
        return np.array([s.noise == 0 and s.free_form_scale == least for s in self.scales])

    @cached_property
    def likely_explanations(self) -> tuple[tuple[State, Scale], ...]:
        """Likely states, each with a scale without station errors, most probable first."""
        plain = self._declared_noise_scales
        weight = {state: float(found[plain].sum()) for state, found in self.weights.items()}
        order = ranked(weight, lambda state: weight[state])[:_MOST_LIKELY_STATES]
        likely = [
            state for state in order if weight[state] >= _LEAST_RELATIVE_WEIGHT * weight[order[0]]
        ]
        at = [largest(np.where(plain, self.weights[s], -np.inf)) for s in likely]
        return tuple((s, self.scales[k]) for s, k in zip(likely, at, strict=True))

    def likeliest_background(self) -> Scale:
        """Return the likeliest scale within tolerances, at the declared noise, no group active."""
        within = self._declared_noise_scales & np.array(
            [s.background_scale <= 1 for s in self.scales]
        )
        return self.scales[largest(np.where(within, self.visited[()], -np.inf), LOG_ODDS_MARGIN)]

    def restricted_to(self, names: Collection[str]) -> tuple[tuple[State, Scale], ...]:
        """Return the likely explanations whose active groups are all in ``names``.

        If there is none, return the best state restricted to ``names`` over the likeliest
        background.
        """
        groups = self.linear.groups
        found = [
            one
            for one in self.likely_explanations
            if all(groups[g].name in names for g, _ in one[0])
        ]
        if found:
            return tuple(found)
        state = tuple(one for one in self.best if groups[one[0]].name in names)
        by_scale = np.sum(list(self.weights.values()), axis=0)
        return (
            (state, self.scales[largest(np.where(self._declared_noise_scales, by_scale, -np.inf))]),
        )

    @cached_property
    def probability_rare(self) -> float:
        """Probability of a background beyond all tolerances, or of noise larger than declared."""
        return self._probability_of_scales([s.rare > 0 for s in self.scales])

    @cached_property
    def probability_beyond_tolerance(self) -> float:
        """Probability of a background beyond all tolerances."""
        return self._probability_of_scales([s.background_scale > 1 for s in self.scales])

    def _probability_of_scales(self, scales: list[bool]) -> float:
        """Return the total probability of the scales in a mask."""
        return float(sum(weight[np.array(scales)].sum() for weight in self.weights.values()))

    @property
    def _sound_scales(self) -> list[int]:
        """Indices of the scales of a machine that is sound apart from its active groups."""
        return [
            k
            for k, s in enumerate(self.scales)
            if s.background_scale <= SOUND_BACKGROUND and s.noise == 0
        ]

    def log_bayes_factors_if_sound(self) -> Array:
        """Return log Bayes factors of single groups on a sound machine ``(groups, taus)``."""
        return np.asarray(
            self.child_log_weights(())[self._sound_scales].max(axis=0)
            - self.visited[()][self._sound_scales].max()
        )

    def moments_if_sound(self, state: State, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` in a state on a sound machine."""
        sound = [self.scales[k] for k in self._sound_scales]
        logs = self._log_z(sound, *self._active_directions(sound, state))
        return self.moments(state, sound[largest(logs, LOG_ODDS_MARGIN)], at)

    def next_log_bayes_factors(self) -> Array:
        """Return log Bayes factors of each group added to the best state ``(groups,)``."""
        table = self.child_log_weights(self.best)
        top = self.log_weight(self.best)
        with np.errstate(divide="ignore"):
            pooled = np.log(np.exp(table - top).sum(axis=(0, 2)))
        return np.asarray(pooled + self.cost)

    def precision(self, state: State, scale: Scale, *, plate_shapes: bool = False) -> Array:
        """Return the inverse prior covariance of the readings in a state ``(m, m)``.

        Plate shapes that no effect names are included only if ``plate_shapes`` is true.
        """
        columns = self.linear.columns
        out = columns @ self._slab_root(state)
        spike = (
            scale.spike if plate_shapes else np.where(self.linear.plate_shapes, 0.0, scale.spike)
        )
        cov = (columns * spike) @ columns.T + out @ out.T
        return np.asarray(np.linalg.inv(cov + np.eye(len(cov))), dtype=np.float64)

    def _slab_root(self, state: State) -> Array:
        """Return a root of the slab covariance of a state's active groups ``(C, q)``."""
        count = len(self.linear.fixed_sd)
        spread = np.zeros((count, 0))
        for group, tau in state:
            g = self.linear.groups[group]
            part = np.zeros((count, g.size))
            part[g.coefficients] = g.weights * tau * g.unit
            spread = np.hstack([spread, part])
        return spread

    def likeliest_moments(self, state: State, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` in a state at its likeliest scales."""
        return self.moments(state, self._likeliest_scale(state), at)

    def likeliest_mean(self, state: State) -> Array:
        """Mean ``(C,)`` of the same."""
        return self._mean(state, self._likeliest_scale(state))

    def likeliest_variance(self, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return posterior and prior variance of coefficients in the best state ``(k,)``."""
        scale = self._likeliest_scale(self.best)
        prior = scale.spike[at] + np.sum(self._slab_root(self.best)[at] ** 2, axis=1)
        return np.diag(self._covariance(self.best, scale, at)), prior

    def _likeliest_scale(self, state: State) -> Scale:
        if len(self.scales) == 1:
            return self.scales[0]
        if state in self.visited:
            return self.scales[largest(self.visited[state], LOG_ODDS_MARGIN)]
        return self.scales[largest(self.weights[state])]

    @cached_property
    def chi2(self) -> float:
        """Chi2 of the readings in the best state; its expectation is their number."""
        scale = self._likeliest_scale(self.best)
        (left,), (shrink,) = self._active_directions([scale], self.best)
        return float(np.sum(shrink_along(scale.residual, left, shrink) ** 2))

    def alternatives_to(self, member: int, rise: float) -> dict[int, float]:
        """Return the groups that could be active in place of one, with the size of each.

        All have one coefficient. They are judged at the widest slab, over the first background.

        Args:
            member: a group of the best state.
            rise: of chi2, by which they may fit worse than ``member``.

        Returns:
            From group to its coefficient; the one that explains most first.
        """
        rest = self.without(member)
        left, shrink = self._active_directions(self.scales, rest)
        explained = self._gains(left, shrink)[0][0, :, -1]
        free, noise = self.linear.unknown_noise, 1.0
        if free is not None:
            noise = free.variance(float(self._explained(left, shrink)[0] + explained[member]))
        near = explained >= explained[member] - rise * noise
        near[[g for g, _ in self.best]] = False
        others = np.flatnonzero(near)
        found = {}
        for other in others[descending(explained[others], LOG_ODDS_MARGIN * noise)].tolist():
            state = tuple(sorted((*rest, (other, self.linear.slab_scales[-1]))))
            found[other] = float(
                self.likeliest_mean(state)[self.linear.groups[other].coefficients[0]]
            )
        return found

    def size_and_spread(self, member: int) -> tuple[float, float, float]:
        """Return mean and standard deviation of a group of one coefficient in the best state, and
        the standard deviation that is added by the other states that contain it.
        """
        at = self.linear.groups[member].coefficients
        mean, cov = self.likeliest_moments(self.best, at)
        size, variance = float(mean[at[0]]), float(cov[0, 0])
        more = total = 0.0
        for (weight, state, scale), m in zip(self._terms, self._means, strict=True):
            if any(g == member for g, _ in state):
                spread = float(self._covariance(state, scale, at)[0, 0])
                more += weight * (spread - variance + (float(m[at[0]]) - size) ** 2)
                total += weight
        return size, float(np.sqrt(variance)), float(np.sqrt(max(more / max(total, 1e-300), 0.0)))

    def moments(self, state: State, scale: Scale, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` of some coefficients in a state."""
        return self._mean(state, scale), self._covariance(state, scale, at)

    def _mean(self, state: State, scale: Scale) -> Array:
        """Return the mean of all coefficients in a state at a scale ``(C,)``."""
        (left,), (shrink,) = self._active_directions([scale], state)
        spread = self._slab_root(state)
        once = shrink_along(scale.residual, left, shrink)
        along = scale.products_with_columns(shrink_along(once, left, shrink))
        return np.asarray(scale.spike * along + spread @ (spread.T @ along))

    def _covariance(self, state: State, scale: Scale, at: NDArray[np.intp]) -> Array:
        """Return the covariance of some coefficients in a state at a scale ``(k, k)``."""
        (left,), (shrink,) = self._active_directions([scale], state)
        columns = shrink_along(scale.columns, left, shrink)
        spread = self._slab_root(state)
        # Prior covariance: diagonal of the spike, plus the slabs of the active groups.
        seen = columns * scale.spike + (columns @ spread) @ spread.T
        prior = np.diag(scale.spike[at]) + spread[at] @ spread[at].T
        noise, free = 1.0, self.linear.unknown_noise
        if free is not None:
            noise = free.variance(float(self._explained(left[None], shrink[None])[0]))
        return np.asarray(noise * (prior - seen[:, at].T @ seen[:, at]))

    def _covariances(self, at: NDArray[np.intp]) -> Callable[[State, Scale], Array]:
        """Return a function of state and scale: the covariance of some coefficients ``(k, k)``.

        Prior less gain cancels to rounding errors where the readings determine a direction a
        million times better than the prior. Here the other coefficients are marginalised as
        noise, and precisions are added.
        """
        linear, others = self.linear, np.ones(len(self.linear.fixed_sd), dtype=bool)
        others[at] = False
        fixed = np.isfinite(linear.fixed_sd)
        kinds = (fixed, linear.free_form & ~fixed, ~linear.free_form & ~fixed)
        size = np.where(fixed, linear.fixed_sd, 1.0)
        rows = (linear.columns[:, others & kind] * size[others & kind] for kind in kinds)
        known, free, background = (part @ part.T for part in rows)

        def covariance(state: State, scale: Scale) -> Array:
            spread = self._slab_root(state)
            noise = known + scale.free_form_scale**2 * free + scale.background_scale**2 * background
            noise += scale.noise**2 * linear.prior_covariances[3] + np.eye(len(noise))
            sd = np.sqrt(scale.spike[at])
            shown = np.hstack([linear.columns[:, at] * sd, linear.columns @ spread])
            shown = solve_triangular(np.linalg.cholesky(noise), shown, lower=True)
            precision = np.eye(shown.shape[1]) + shown.T @ shown
            units = np.hstack([np.diag(sd), spread[at]])
            half = solve_triangular(np.linalg.cholesky(precision), units.T, lower=True)
            return np.asarray(half.T @ half)

        return covariance

    @cached_property
    def _terms(self) -> tuple[tuple[float, State, Scale], ...]:
        """Weight, state and scale of every term of the averages."""
        states, every = list(self.weights), np.stack(list(self.weights.values()))
        likely = np.flatnonzero(every > _NEGLIGIBLE)
        order = likely[descending(every.flat[likely])[:_MOST_TERMS]]
        at = [divmod(int(k), len(self.scales)) for k in order]
        total = sum(float(every[k]) for k in at)
        return tuple((float(every[k]) / total, states[k[0]], self.scales[k[1]]) for k in at)

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
        at = np.flatnonzero(weights.any(axis=0))
        upto = np.cumsum([weight for weight, _, _ in self._terms])
        term = np.searchsorted(upto[:-1], (np.arange(len(normal)) + 0.5) / len(normal))
        drawn, covariance = np.empty(normal.shape), self._covariances(at)
        for k in np.unique(term):
            _, state, scale = self._terms[k]
            root = symmetric_root(weights[:, at] @ covariance(state, scale) @ weights[:, at].T)
            some = term == k
            drawn[some] = weights @ self._means[k] + normal[some] @ root.T
        return drawn

    def averaged_moments(self, known: int) -> AveragedMoments:
        """Return the moments of the coefficients, averaged over states and scales.

        The covariance covers the first ``known`` coefficients, and others whose group is active
        with a probability above ``LEAST_SHARE``.
        """
        best = {g for g, _ in self.best}
        likely = [
            g.coefficients
            for k, (g, p) in enumerate(zip(self.linear.groups, self.inclusion, strict=True))
            if p > LEAST_PROBABILITY or k in best
        ]
        at = np.unique(np.concatenate([np.arange(known), *likely]).astype(int))
        size = len(self.linear.fixed_sd)
        second, prior = np.zeros((size, size)), np.zeros((size, size))
        block, covariance = np.ix_(at, at), self._covariances(at)
        for (weight, state, scale), m in zip(self._terms, self._means, strict=True):
            cov = covariance(state, scale)
            second[block] += weight * (cov + np.outer(m[at], m[at]))
            spread = self._slab_root(state)[at]
            prior[block] += weight * (np.diag(scale.spike[at]) + spread @ spread.T)
        second[block] -= np.outer(self.mean[at], self.mean[at])
        return AveragedMoments(self.mean, second, prior)
