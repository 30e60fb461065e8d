"""Credible sets of causes and free-form errors, from the posterior.

A credible set contains the true cause with 95 % probability, if there is one: it is the smallest
set of causes and free-form errors whose probabilities, conditional on the other active groups, sum
to that (Wang et al. 2020, section 3). Parameters with equal effects on readings and tool count as
one cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.accuracy import tcp_slopes
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_short
from orthoglide.errors import InputError
from orthoglide.explanation.candidates import Candidate
from orthoglide.explanation.causes import (
    CREDIBLE,
    CredibleSets,
    averaged_over_periods,
    curve_of,
    far_base_causes,
    pool_variants,
    smallest_count,
)
from orthoglide.explanation.faults import STARTING_KINDS, Fault, fault_message, lines_of, setups_of
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.explanation.linear_model import Group
from orthoglide.fit.problem import CERTAIN_SIGMAS
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending, largest, ranked
from orthoglide.result import CandidateScore, Cause, Curve, DataRival, Explanation, Located

_LEAST_BACKGROUND = 0.1  # tolerances: scale of a background that is worth reporting

_MOST_POSSIBLE, _LEAST_POSSIBLE = 6, 0.02  # causes reported where none is active; least probability
_MOST_SCORES = 24  # causes and free-form errors listed with their scores

CREDIBLE_WITH_DATA_FAULT = 0.99
"""Probability of a credible set with a data fault in it, for which readings are discarded."""

LARGEST_CREDIBLE_SET = 20
"""Largest credible set that is reported: a larger one excludes too little to be of use."""

LEAST_CLAIMED_PROBABILITY = 0.9
"""Least probability of a claim: that a cause is active, and that it is of the stated kind."""


def credible_sets(posterior: FullPosterior, given: Sequence[str] = ()) -> CredibleSets:
    """Return the credible sets of all active causes, those declared in ``given`` included."""
    reader = _CredibleSetReader(posterior)
    active = [reader.credible_set(k, given) for k in posterior.mixture.groups_by_importance]
    # An active group without a claim is as uncertain as an inactive one.
    sets = [found for found in (*active, *far_base_causes(posterior)) if found is not None]
    return CredibleSets(
        tuple(item for item in sets if isinstance(item, Cause)),
        tuple(item for item in sets if isinstance(item, Located)),
        reader.candidate_scores(),
        () if sets else reader.single_causes(),
        () if sets else reader.possible_causes(),
    )


def merge_families(explanations: Sequence[Explanation]) -> list[Explanation]:
    """Merge each explanation into the most probable one that has only some of its parameters, if
    the others do not differ from zero; most probable first.
    """
    merged = dict[str, Explanation]()
    for family in sorted(explanations, key=lambda e: len(e.parameters)):
        nonzero = {
            n for n, v in family.values.items() if abs(v) > CERTAIN_SIGMAS * family.sigmas[n]
        }
        parts = [e for e in merged.values() if nonzero <= {*e.parameters} < {*family.parameters}]
        if nonzero and parts:
            part = max(parts, key=lambda e: e.probability)
            merged[part.name] = replace(
                part,
                probability=part.probability + family.probability,
                families=(*part.families, family.name),
            )
        else:
            merged[family.name] = family
    return ranked(merged.values(), lambda explanation: explanation.probability)


@dataclass(frozen=True, eq=False)
class _CredibleSetReader:
    """Reads credible sets from a posterior."""

    posterior: FullPosterior

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        return self.posterior.mixture.linear.groups

    @cached_property
    def _cause_groups(self) -> list[int]:
        """Indices of the groups that are causes of the catalogue."""
        return [k for k, g in enumerate(self.groups) if not g.free_form and not g.of_data]

    @cached_property
    def _pair_of(self) -> NDArray[np.intp]:
        """Index of the pair to which each group belongs, or else its own: a sine and a cosine are
        one cause at any phase ``(groups,)``.
        """
        index, pair_of = {g.name: k for k, g in enumerate(self.groups)}, np.arange(len(self.groups))
        for k in self._cause_groups:
            pair_of[k] = index.get(self.groups[k].source.name.undirected, k)
        return pair_of

    def _pool_pairs(self, probabilities: Array) -> Array:
        """Return probabilities by group, those of the parts of a pair added to that of the pair."""
        return np.bincount(self._pair_of, probabilities, len(self.groups)).astype(float)

    @cached_property
    def _inclusion(self) -> Array:
        """Probability that each cause is active, a pair as a whole or in part ``(groups,)``."""
        probabilities = np.zeros(len(self.groups))
        for state, weight in self.posterior.mixture.weights.items():
            probabilities[list({self._pair_of[k] for k, _ in state})] += float(weight.sum())
        return probabilities

    def credible_set(self, member: int, given: Sequence[str]) -> Cause | Located | None:
        """Return the credible set for one active group; ``None`` if nothing is claimed."""
        declared = self.groups[member].name in given
        errors = {k: group.source for k, group in enumerate(self.groups) if group.free_form}
        odds = self.posterior.alternatives.probabilities(member)[:-1]
        odds, ranges = pool_variants(self._pool_pairs(odds), errors)
        if declared:
            odds = np.eye(len(odds))[member]
        if odds.sum() < LEAST_CLAIMED_PROBABILITY:
            return None
        order = descending(odds)
        likely = odds > (1 - CREDIBLE_WITH_DATA_FAULT) * odds.max()
        with_data_faults = any(self.groups[k].of_data for k in np.flatnonzero(likely))
        target = CREDIBLE_WITH_DATA_FAULT if with_data_faults else CREDIBLE
        count = smallest_count(odds[order], target * float(odds.sum()))
        if count > LARGEST_CREDIBLE_SET and not declared:
            return None
        chosen = [(k, float(odds[k])) for k in order[:count] if not self.groups[k].of_data]
        if not chosen:  # a data fault, which is no statement about the machine
            return None
        faults = [(k, float(odds[k])) for k in order[:count] if self.groups[k].of_data]
        total = sum(p for _, p in chosen)
        free_form = sum(p for k, p in chosen if self.groups[k].free_form)
        found: Cause | Located
        if free_form < (1 - LEAST_CLAIMED_PROBABILITY) * total or (
            not self.groups[chosen[0][0]].free_form and free_form < 0.5 * total
        ):
            found = self._cause(member, chosen, ranges)
        else:
            found = self._located(member, chosen, ranges, free_form)
        return replace(found, data=tuple(self._data_rivals(member, faults))) if faults else found

    def _data_rivals(self, member: int, odds: Sequence[tuple[int, float]]) -> Iterator[DataRival]:
        """Yield the data faults of a credible set, which rival its causes; those of one setup that
        begin at different rows are one.
        """
        problem = self.posterior.linearised.problem
        alike = dict[tuple[object, ...], list[tuple[Fault, float]]]()
        for k, probability in odds:
            fault = self.posterior.data_fault(member, k)
            moment = k if fault.kind not in STARTING_KINDS else -1
            key = (fault.kind, moment, *setups_of(problem, fault))
            alike.setdefault(key, []).append((fault, probability))
        for faults in alike.values():
            fault, rows = faults[0][0], [[n for _, n in lines_of(problem, f)] for f, _ in faults]
            starts = sorted(lines[0] for lines in rows)
            may_begin = f"; it may begin at any line from {starts[0]} to {starts[-1]}"
            message = fault_message(problem, fault) + may_begin * (len(starts) > 1)
            yield DataRival(fault.kind, tuple(rows[0]), sum(p for _, p in faults), message)

    def single_causes(self) -> tuple[Explanation, ...]:
        """Return the 95 % credible set of single causes on an otherwise sound machine."""
        mixture = self.posterior.mixture
        table = mixture.log_posterior_odds_if_sound()
        if self.posterior.background_scale < _LEAST_BACKGROUND or table.max(initial=0.0) <= 0:
            return ()
        log_weights = table[self._cause_groups]
        probabilities = np.zeros(len(self.groups))
        weights = np.exp(log_weights - log_weights.max()).sum(axis=1)
        probabilities[self._cause_groups] = weights / weights.sum()
        probabilities = self._pool_pairs(probabilities)[self._cause_groups]
        order = descending(probabilities)
        explanations = []
        for k in order[: smallest_count(probabilities[order], CREDIBLE)]:
            group = self._cause_groups[k]
            tau = mixture.linear.slab_scales[largest(table[group], LOG_ODDS_MARGIN)]
            moments = mixture.moments_if_sound(((group, tau),), self.groups[group].coefficients)
            explanations.append(self._explain(group, float(probabilities[k]), *moments))
        return tuple(twin for e in merge_families(explanations) for twin in self._twins(e))

    def possible_causes(self) -> tuple[Explanation, ...]:
        """Return the most probable causes where none is active, each estimated as the only one."""
        mixture, explanations = self.posterior.mixture, list[Explanation]()
        inclusion = self._inclusion
        order = descending(inclusion[self._cause_groups])[:_MOST_POSSIBLE]
        for k in (self._cause_groups[i] for i in order):
            if inclusion[k] < _LEAST_POSSIBLE:
                break
            moments = mixture.likeliest_moments(mixture.child((), k), self.groups[k].coefficients)
            explanations.append(self._explain(k, float(inclusion[k]), *moments))
        return tuple(e for e in explanations if e.exceeds_uncertainty)

    def _cause(
        self, member: int, odds: Sequence[tuple[int, float]], ranges: Mapping[int, str]
    ) -> Cause:
        """Return the credible set of a cause with a name, from its groups and probabilities."""
        explanations = list[Explanation]()
        for k, p in odds:
            if self.groups[k].free_form:
                continue
            moments = self.posterior.alternatives.moments(member, k, self.groups[k].coefficients)
            explanations.append(self._explain(k, p, *moments))
        merged = merge_families(explanations)
        first, *others = [twin for e in merged for twin in self._twins(e)]
        same, rivals = list[Explanation](), list[Explanation]()
        for other in others:
            if other.exceeds_uncertainty:
                (same if self._same_tool(first, other) else rivals).append(other)
        return Cause(first, tuple(rivals), tuple(same), self._curves(member, odds, ranges))

    def _twins(self, explanation: Explanation) -> list[Explanation]:
        """Return an explanation and its twins, which have equal effects on readings and tool."""
        catalogue, linearised = explanation.catalogue, self.posterior.linearised
        setups = tuple(s for f in linearised.problem.factors for s in f.setup_names)
        parts = {n: tuple(catalogue.elementary_weights(n, setups)) for n in explanation.parameters}
        # For each elementary parameter: its twins by effect, each with its factor.
        by_effect = [
            {
                catalogue.effect_of(twin[0]).name: twin
                for twin in reversed(linearised.twins.get(p, ()))
            }
            for elementary in parts.values()
            for p in elementary
        ]
        explanations, own_effect = [explanation], catalogue.effect_of(explanation.name).name
        for effect in sorted(set.intersection(*map(set, by_effect))) if by_effect else []:
            twins = [twin_of[effect] for twin_of in by_effect]
            factor = twins[0][1]
            if any(abs(other - factor) > 1e-2 * abs(factor) for _, other in twins):
                continue
            if len(twins) == len(parts):  # single parameters: each has its twin
                new = dict(zip(parts, (name for name, _ in twins), strict=True))
            else:
                new = {n: n.replace(own_effect, effect, 1) for n in parts}
            if not all(self._is_parameter(n, setups) for n in new.values()):
                continue
            name = explanation.name
            twin = replace(
                explanation,
                name=new[name] if name in new else name.replace(own_effect, effect, 1),
                parameters=tuple(new.values()),
                values={new[n]: v * factor for n, v in explanation.values.items()},
                sigmas={new[n]: v * abs(factor) for n, v in explanation.sigmas.items()},
            )
            explanations.append(twin)
        share = explanation.probability / len(explanations)
        return [replace(e, probability=share) for e in explanations]

    def _explain(
        self, group_index: int, probability: float, mean: Array, covariance: Array
    ) -> Explanation:
        """Return one group as explanation, given the covariance of the coefficients it moves."""
        linearised, group = self.posterior.linearised, self.groups[group_index]
        candidate: Candidate = group.source
        # Project the coefficients that it moves on its pattern.
        to_parameters = np.linalg.pinv(group.weights)
        value = to_parameters @ mean[group.coefficients]
        sigma = np.sqrt(np.diag(to_parameters @ covariance @ to_parameters.T))
        machine = linearised.problem.machine
        tolerances = np.array([machine.tolerance(name) for name in candidate.parameters])
        return Explanation(
            candidate.name,
            candidate.parameters,
            probability,
            dict(zip(candidate.parameters, (value * tolerances).tolist(), strict=True)),
            dict(zip(candidate.parameters, (sigma * tolerances).tolist(), strict=True)),
            self.posterior.machine.catalogue,  # which includes free-form errors
            self.posterior.machine_values(mean),
        )

    def _is_parameter(self, name: str, setups: Sequence[str]) -> bool:
        try:
            self.posterior.linearised.problem.machine.catalogue.parameter(name, setups)
        except InputError:
            return False
        return True

    def _same_tool(self, first: Explanation, second: Explanation) -> bool:
        """True if two causes move the tool equally over the workspace.

        The limit is half the noise of one reading, rms: a smaller difference shows in no reading. A
        fault of an instrument never equals a fault of the machine.
        """
        effect_of = self.posterior.machine.catalogue.effect_of
        if effect_of(first.name).of_dial != effect_of(second.name).of_dial:
            return False
        difference = np.array([second.machine[n] - v for n, v in first.machine.items()])
        displacement = self._slopes @ difference
        noise = self.posterior.before.problem.noise.typical
        return bool(np.sqrt(np.mean(np.sum(displacement**2, axis=1))) < noise / 2)

    @cached_property
    def _slopes(self) -> Array:
        """Jacobian of the TCP over the workspace by machine parameter ``(g, 3, P)``, SI."""
        machine = self.posterior.machine
        return tcp_slopes(machine, self.posterior.machine_weights[0])

    def _located(
        self, member: int, odds: Sequence[tuple[int, float]], ranges: Mapping[int, str],
        probability: float,
    ) -> Located:  # fmt: skip
        members, catalogue = self._curves(member, odds, ranges), self.posterior.machine.catalogue
        resembling = tuple(self.groups[k].name for k, _ in odds if not self.groups[k].free_form)
        moving_causes = self._causes_moving(members[0].place)
        # Those of dials, lost motion and improbable ones are not in the calibrated machine.
        effects = [curve.place.effect for curve in members]
        in_machine = [effect for effect in effects if effect.name in catalogue]
        return Located(
            members, probability, resembling,
            resembling_words=tuple(cause_short(catalogue, name) for name in resembling),
            ruled_out=tuple(dict.fromkeys(  # a sine and its cosine have one clause
                cause_short(catalogue, name) for name in moving_causes if name not in resembling
            )),
            in_budget=(in_machine or effects)[0].name,
            parameters=tuple(str(part) for effect in in_machine for part in effect.motions),
            group=member,
        )  # fmt: skip

    def _causes_moving(self, error: FreeForm) -> Iterator[str]:
        """Yield the causes that move the same joints, or change the same dial, as an error."""
        motions = self.posterior.linearised.problem.machine.catalogue.motions
        joints = {joint for joint, _ in error.joints}
        for k in self._cause_groups:
            names = [p.plain for p in self.groups[k].source.parameters]
            if error.of_dial:
                moves_it = all(p.setup and p.setup == error.setup for p in names)
            else:
                moved = [motions[p] for p in names if p in motions]
                moves_it = len(moved) == len(names) and not error.moves_bar_ends and all(
                    leg == error.leg and joints & {m.joint for m in leg_motions}
                    for leg, leg_motions in moved
                )  # fmt: skip
            if moves_it:
                yield self.groups[k].name

    def _curves(
        self, member: int, odds: Sequence[tuple[int, float]], ranges: Mapping[int, str]
    ) -> tuple[Curve, ...]:
        """Return the curves of the free-form errors in a credible set."""
        stroke, curves = self.posterior.before.problem.machine.geometry.stroke, list[Curve]()
        for k, probability in odds:
            if self.groups[k].free_form:
                index = self.groups[k].coefficients
                mean, covariance = self.posterior.alternatives.moments(member, k, index)
                error = self.groups[k].source
                curve = curve_of(error, probability, stroke, mean[index], covariance)
                curve = averaged_over_periods(curve, self.posterior, member)
                curves.append(replace(curve, description=curve.description + ranges.get(k, "")))
        return tuple(curves)

    def candidate_scores(self) -> tuple[CandidateScore, ...]:
        """Return the scores of the groups nearest to being active, most probable first."""
        mixture, scores = self.posterior.mixture, dict[int, float]()
        for member, _ in mixture.best:
            probabilities = self.posterior.alternatives.probabilities(member)
            for k, probability in enumerate(probabilities[:-1]):
                if probability > 0:
                    log_odds = np.log(probability) - np.log(max(probabilities[-1], 1e-300))
                    score = float(log_odds + mixture.prior_log_odds_against[k])
                    pair = int(self._pair_of[k])
                    scores[pair] = max(scores.get(pair, -np.inf), score)
        for k, score in enumerate(mixture.next_log_bayes_factors().tolist()):
            scores.setdefault(int(self._pair_of[k]), score)
        scores = {k: score for k, score in scores.items() if not self.groups[k].of_data}
        by_name = sorted(scores, key=lambda k: self.groups[k].name)
        order = ranked(by_name, lambda k: scores[k], LOG_ODDS_MARGIN)[:_MOST_SCORES]
        return tuple(self._candidate_score(k, scores[k]) for k in order)

    def _candidate_score(self, k: int, score: float) -> CandidateScore:
        name, source, parameters = self.groups[k].name, self.groups[k].source, tuple[str, ...]()
        if self.groups[k].free_form:
            words = source.words
        else:
            words = cause_short(self.posterior.machine.catalogue, name)
            parameters = source.parameters
        return CandidateScore(name, parameters, float(self._inclusion[k]), score, words)
