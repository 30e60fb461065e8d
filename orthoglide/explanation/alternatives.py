"""Alternatives to each active group: other groups, or those that another state has in its place."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.mixture import Mixture
from orthoglide.explanation.search import State
from orthoglide.geometry import Array
from orthoglide.ordering import RELATIVE_MARGIN, best_of, largest

_LEAST_STATE_WEIGHT = 1e-3  # of a state that is considered: a tenth of it changed no result
_LEAST_PROBABILITY = 0.01  # of an alternative: a credible set of 99 % may leave out less


class Alternatives:
    """The alternatives to each group of the best state, with their probabilities."""

    def __init__(self, mixture: Mixture) -> None:
        self.mixture = mixture

    def probabilities(self, member: int) -> Array:
        """Return the probability of each group ``(groups + 1,)`` in the place of an active one.

        Groups are compared with all other active groups given. States that differ by more
        contribute the group that matches ``member``. The last entry is the probability that no
        group is active there.
        """
        mixture, smaller = self.mixture, self.mixture.without(member)
        table, none_active = mixture.child_log_weights(smaller), mixture.log_weight(smaller)
        top = max(float(table.max()), none_active)
        by_group = np.exp(table - top).sum(axis=(0, 2))
        # The weight that a group has from its prior alone, without support by the readings, counts
        # as that of no group.
        slabs = len(mixture.linear.slab_scales)
        prior = np.exp(none_active - top - mixture.cost) * slabs
        single = np.append(np.maximum(by_group - prior, 0.0), 0.0)
        single[-1] = np.exp(none_active - top) + by_group.sum() - single.sum()
        single /= single.sum()
        joint = np.zeros(len(single))
        likely_alone = set(np.flatnonzero(single[:-1] > _LEAST_PROBABILITY))
        for state, weight in self.probable_states.items():
            added = {g for g, _ in state} - {g for g, _ in smaller}
            is_joint = len(added) > 1 and not added & likely_alone
            # A state that only adds causes to a likely alternative does not tell about ``member``.
            if is_joint or len(added) + len(smaller) > len(state):
                joint[self._matched_groups[state].get(member, -1)] += weight
        return np.asarray((1 - joint.sum()) * single + joint)

    def moments(self, member: int, other: int, index: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean ``(C,)`` and covariance ``(k, k)`` with ``other`` in place of ``member``."""
        return self.mixture.likeliest_moments(self.state(member, other), index)

    def state(self, member: int, other: int) -> State:
        """Return the likeliest state with ``other`` in place of ``member``."""
        if other == member:
            return self.mixture.best
        states = [s for s, matches in self._matched_groups.items() if matches.get(member) == other]
        if states:
            return best_of(states, lambda s: self.probable_states[s])
        return self.mixture.child(self.mixture.without(member), other)

    @cached_property
    def possible_commands(self) -> dict[int, int]:
        """The likeliest wrong command in place of each active group, by that group, which may be
        the command itself; no reading belongs to two of them.

        A large wrong command is far from linear: before it is ruled out it is corrected, and the
        readings are linearised again.
        """
        groups, possible = self.mixture.linear.groups, dict[int, int]()
        rows = {k: {*g.source.fault.rows.tolist()} for k, g in enumerate(groups)
                if g.of_data and g.source.fault.drive is not None}  # fmt: skip
        active = [member for member, _ in self.mixture.best]
        for member in sorted(active, key=lambda k: k not in rows) if rows else ():
            likeliest = member
            if member not in rows:
                probabilities = self.probabilities(member)[:-1]
                candidates = [*rows]
                likeliest = candidates[largest(probabilities[candidates])]
                if probabilities[likeliest] <= _LEAST_PROBABILITY:
                    continue
            if not any(rows[likeliest] & rows[k] for k in possible.values()):
                possible[member] = likeliest
        return possible

    @cached_property
    def probable_states(self) -> dict[State, float]:
        """Likely sets of active groups, each as its state at the likeliest scales, with its
        weight.
        """
        states_by_groups: dict[frozenset[int], dict[State, float]] = {}
        for state, weight in self.mixture.weights.items():
            groups = frozenset(g for g, _ in state)
            states_by_groups.setdefault(groups, {})[state] = float(weight.sum())
        pooled = {best_of(w, w.__getitem__): sum(w.values()) for w in states_by_groups.values()}
        return {state: weight for state, weight in pooled.items() if weight > _LEAST_STATE_WEIGHT}

    @cached_property
    def _matched_groups(self) -> dict[State, dict[int, int]]:
        """For each probable state: which of its groups replaces each group of the best state.

        A group is replaced by itself, or else by the group with the most similar signature. A
        whole effect may replace several groups.
        """
        return {state: self._match_groups(state) for state in self.probable_states}

    def _match_groups(self, state: State) -> dict[int, int]:
        best, groups = self.mixture.best, self.mixture.linear.groups
        best_groups, state_groups = [g for g, _ in best], [g for g, _ in state]
        matches = {g: g for g in best_groups if g in state_groups}
        missing = [g for g in best_groups if g not in state_groups]
        added = [g for g in state_groups if g not in best_groups]
        if missing and added:
            from scipy.optimize import linear_sum_assignment

            ours, theirs = self._unit_signatures(best, missing), self._unit_signatures(state, added)
            # Rounded, so that equally similar groups keep their order.
            similarity = np.round(np.abs(ours @ theirs.T) / RELATIVE_MARGIN)
            pairs = zip(*linear_sum_assignment(-similarity), strict=True)
            matches |= {missing[i]: added[j] for i, j in pairs}
            for i, group in enumerate(missing):
                nearest = added[largest(similarity[i])]
                if group not in matches and groups[nearest].size > 1:
                    matches[group] = nearest
        return matches

    @cached_property
    def _columns(self) -> Array:
        """Columns by coefficient ``(m, C)`` at the likeliest scale of the best state."""
        logs = self.mixture.weights[self.mixture.best]
        return self.mixture.scales[largest(logs)].columns

    def _unit_signatures(self, state: State, groups: list[int]) -> Array:
        """Return the signatures of groups in a state, whitened by the background, of unit length
        ``(groups, m)``.
        """
        mixture = self.mixture
        mean = mixture.likeliest_mean(state)
        coefficients = [mixture.linear.groups[g].coefficients for g in groups]
        signatures = np.stack([self._columns[:, index] @ mean[index] for index in coefficients])
        length = np.maximum(np.linalg.norm(signatures, axis=1, keepdims=True), 1e-300)
        return np.asarray(signatures / length)
