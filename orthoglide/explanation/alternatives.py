"""What may be in the place of a cause: another group, or what a whole other state has there."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.mixture import Mixture
from orthoglide.explanation.search import State
from orthoglide.geometry import Array
from orthoglide.ordering import RELATIVE_MARGIN, best_of, largest

_LEAST_STATE_WEIGHT = 1e-3  # weight of a state that probabilities of causes are read from
_LEAST_SINGLE_PROBABILITY = 0.01  # probability of a group in a place by itself


class Alternatives:
    """What may be in each place of the best state, and how probably."""

    def __init__(self, mixture: Mixture) -> None:
        self.mixture = mixture

    def probabilities(self, member: int) -> Array:
        """Probability of each group ``(groups + 1,)`` in one place of the best state.

        With the rest of the best state given, one group against another; where a state that
        differs by more explains the readings, too, what it has in that place.

        The last entry, behind the groups, is that of nothing.
        """
        mixture, rest = self.mixture, self.mixture.without(member)
        table, nothing = mixture.child_log_weights(rest), mixture.log_weight(rest)
        top = max(float(table.max()), nothing)
        by_group = np.exp(table - top).sum(axis=(0, 2))
        # The weight that a group has from its prior alone, as the readings do not support it, is
        # no explanation and counts as that of nothing.
        slabs = len(mixture.linear.slab_scales)
        prior = np.exp(nothing - top - mixture.cost) * slabs
        found = np.append(np.maximum(by_group - prior, 0.0), 0.0)
        found[-1] = np.exp(nothing - top) + by_group.sum() - found.sum()
        found /= found.sum()
        others = np.zeros(len(found))
        alone = set(np.flatnonzero(found[:-1] > _LEAST_SINGLE_PROBABILITY))
        for state, weight in self.probable_states.items():
            more = {g for g, _ in state} - {g for g, _ in rest}
            # Further causes beside one that may be there by itself tell nothing of that place.
            if len(more) + len(rest) > len(state) or (len(more) > 1 and not more & alone):
                others[self._matched_groups[state].get(member, -1)] += weight
        return np.asarray((1 - others.sum()) * found + others)

    def moments(self, member: int, other: int, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Mean ``(C,)``, and covariance ``(k, k)`` of some coefficients, with a group in the place
        of one of the best state.
        """
        return self.mixture.likeliest_moments(self.state(member, other), at)

    def state(self, member: int, other: int) -> State:
        """The likeliest state with another group in the place of one of the best state."""
        if other == member:
            return self.mixture.best
        having = [s for s, found in self._matched_groups.items() if found.get(member) == other]
        if having:
            return best_of(having, lambda s: self.probable_states[s])
        return self.mixture.child(self.mixture.without(member), other)

    @cached_property
    def probable_states(self) -> dict[State, float]:
        """What stands out together that counts, at its likeliest scales, with its weight."""
        alike: dict[frozenset[int], dict[State, float]] = {}
        for state, weight in self.mixture.weights.items():
            groups = frozenset(g for g, _ in state)
            alike.setdefault(groups, {})[state] = float(weight.sum())
        pooled = {best_of(each, each.__getitem__): sum(each.values()) for each in alike.values()}
        return {state: weight for state, weight in pooled.items() if weight > _LEAST_STATE_WEIGHT}

    @cached_property
    def _matched_groups(self) -> dict[State, dict[int, int]]:
        """Which group of such a state is in the place of each of the best state.

        The same, or that which shows most like it; an effect whole may stand for several.
        """
        return {state: self._match_groups(state) for state in self.probable_states}

    def _match_groups(self, state: State) -> dict[int, int]:
        best, groups = self.mixture.best, self.mixture.linear.groups
        ours, theirs = [g for g, _ in best], [g for g, _ in state]
        found = {g: g for g in ours if g in theirs}
        lost = [g for g in ours if g not in theirs]
        gained = [g for g in theirs if g not in ours]
        if lost and gained:
            from scipy.optimize import linear_sum_assignment

            alike = np.abs(
                self._unit_signatures(best, lost) @ self._unit_signatures(state, gained).T
            )
            alike = np.round(
                alike / RELATIVE_MARGIN
            )  # what is as like as another comes in its order
            pairs = zip(*linear_sum_assignment(-alike), strict=True)
            found |= {lost[i]: gained[j] for i, j in pairs}
            for i, group in enumerate(lost):
                nearest = gained[largest(alike[i])]
                if group not in found and groups[nearest].size > 1:
                    found[group] = nearest
        return found

    @cached_property
    def _columns(self) -> Array:
        """By coefficient ``(m, C)``, at the likeliest scale of the best state."""
        logs = self.mixture.weights[self.mixture.best]
        return self.mixture.scales[largest(logs)].columns

    def _unit_signatures(self, state: State, groups: list[int]) -> Array:
        """What groups of a state show beside all that is off anyway, zeros and lengths first, of
        unit length ``(groups, m)``.
        """
        mixture = self.mixture
        mean = mixture.likeliest_mean(state)
        places = [mixture.linear.groups[g].coefficients for g in groups]
        shown = np.stack([self._columns[:, at] @ mean[at] for at in places])
        return np.asarray(shown / np.maximum(np.linalg.norm(shown, axis=1), 1e-300)[:, None])
