"""Credible sets of causes and free-form errors, from the posterior.

A credible set contains the true cause with 95 % probability, if there is one: it is the smallest
set of causes and free-form errors whose probabilities, conditional on the other active groups, sum
to that (Wang et al. 2020, section 3). Parameters with equal effects on readings and tool count as
one cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.accuracy import tcp_slopes
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.kernels import Bump
from orthoglide.errors import InputError
from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.base_causes import far_base_causes
from orthoglide.explanation.causes import (
    CandidateScore,
    Cause,
    CredibleSets,
    Curve,
    Explanation,
    Located,
)
from orthoglide.explanation.faults import factors_and_rows, fault_message
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.explanation.linear_model import Group
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, RELATIVE_MARGIN, descending, largest, ranked
from orthoglide.result import DataRival

_LEAST_BACKGROUND = 0.1  # tolerances: scale of a background that is worth reporting

_MOST_POSSIBLE, _LEAST_POSSIBLE = 6, 0.02  # causes reported where none is active; least probability
_MOST_SCORES = 24  # causes and free-form errors listed with their scores

_BUMP_WIDTHS = 3.0  # widths of a bump beyond which it has vanished

CREDIBLE = 0.95
"""Probability that a credible set contains the true cause."""

CREDIBLE_WITH_DATA_FAULT = 0.99
"""Probability of a credible set with a data fault in it, for which readings are discarded."""

LARGEST_CREDIBLE_SET = 20
"""Largest credible set that is reported: a larger one excludes too little to be of use."""

LEAST_CLAIMED_PROBABILITY = 0.9
"""Least probability of a claim: that a cause is active, and that it is of the stated kind."""


def credible_sets(posterior: FullPosterior, given: Sequence[str] = ()) -> CredibleSets:
    """Return the credible sets of all active causes, those declared in ``given`` included."""
    reader = _CredibleSetReader(posterior)
    found = [reader.credible_set(member, given) for member in posterior.mixture.strongest]
    found += far_base_causes(posterior)
    return CredibleSets(
        tuple(f for f in found if isinstance(f, Cause)),
        tuple(f for f in found if isinstance(f, Located)),
        reader.candidate_scores(),
        () if found else reader.single_causes(),
        () if found else reader.possible_causes(),
    )


def smallest_count(odds: Array, probability: float) -> int:
    """Return the smallest count of ``odds`` (sorted, largest first) that sum to ``probability``."""
    return int(np.searchsorted(np.cumsum(odds), probability * (1 - RELATIVE_MARGIN))) + 1


@dataclass(frozen=True, eq=False)
class _CredibleSetReader:
    posterior: FullPosterior

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        return self.posterior.mixture.linear.groups

    @cached_property
    def alternatives(self) -> Alternatives:
        return Alternatives(self.posterior.mixture)

    def credible_set(self, member: int, given: Sequence[str]) -> Cause | Located | None:
        """Return the credible set for one active group; ``None`` if nothing is claimed."""
        known = self.groups[member].name in given
        odds = self.alternatives.probabilities(member)
        if known:
            odds = np.eye(len(odds))[member]
        odds = odds[:-1]
        if odds.sum() < LEAST_CLAIMED_PROBABILITY:
            return None
        order = descending(odds)
        mixed = any(
            self.groups[k].of_data
            for k in order
            if odds[k] > (1 - CREDIBLE_WITH_DATA_FAULT) * odds.max()
        )
        share = CREDIBLE_WITH_DATA_FAULT if mixed else CREDIBLE
        count = smallest_count(odds[order], share * float(odds.sum()))
        if count > LARGEST_CREDIBLE_SET and not known:
            return None
        chosen = [k for k in order[:count] if not self.groups[k].of_data]
        if not chosen:  # a data fault, which is no statement about the machine
            return None
        each = [(k, float(odds[k])) for k in chosen]
        there = sum(p for _, p in each)
        data = self._data_rivals(member, [k for k in order[:count] if self.groups[k].of_data], odds)
        free = sum(p for k, p in each if self.groups[k].free_form)
        if free < (1 - LEAST_CLAIMED_PROBABILITY) * there or (
            not self.groups[chosen[0]].free_form and free < 0.5 * there
        ):
            cause = self._cause(member, each)
            return replace(cause, data=data) if data else cause
        located = self._located(member, each, free)
        return replace(located, data=data) if data else located

    def _data_rivals(
        self, member: int, groups: Sequence[int], odds: Array
    ) -> tuple[DataRival, ...]:
        """Return the data faults of a credible set, which rival its causes."""
        found = list[DataRival]()
        if not groups:
            return ()
        by_name = {s.name: s for s in self.posterior.linearised.suspects}
        problem = self.posterior.linearised.problem
        for k in groups:
            mean, _ = self.alternatives.moments(member, k, at := self.groups[k].coefficients)
            fault = by_name[self.groups[k].name].with_sizes(mean[at])
            rows = tuple(int(problem.factors[t].readings.line[row])
                         for t, row in factors_and_rows(problem, fault.rows))  # fmt: skip
            found.append(DataRival(fault.kind, rows, float(odds[k]), fault_message(problem, fault)))
        return tuple(found)

    def single_causes(self) -> tuple[Explanation, ...]:
        """Return the 95 % credible set of single causes on an otherwise sound machine."""
        mixture = self.posterior.mixture
        table = mixture.log_bayes_factors_if_sound()
        if self.posterior.background_scale < _LEAST_BACKGROUND or table.max(initial=0.0) <= 0:
            return ()
        named = [k for k, g in enumerate(self.groups) if not g.free_form and not g.of_data]
        weight = np.exp(table[named] - table[named].max()).sum(axis=1)
        weight /= weight.sum()
        order = descending(weight)
        found = []
        for k in order[: smallest_count(weight[order], CREDIBLE)]:
            group = named[k]
            state = ((group, mixture.linear.slab_scales[largest(table[group], LOG_ODDS_MARGIN)]),)
            at = self.groups[group].coefficients
            found.append(
                self._explain(group, float(weight[k]), *mixture.moments_if_sound(state, at))
            )
        return tuple(one for explanation in found for one in self._twins(explanation))

    def possible_causes(self) -> tuple[Explanation, ...]:
        """Return the most probable causes where none is active, each estimated as the only one."""
        mixture, groups = self.posterior.mixture, self.groups
        named = [k for k, g in enumerate(groups) if not g.free_form and not g.of_data]
        odds = mixture.inclusion[named]
        found = []
        for k in (named[i] for i in descending(odds)[:_MOST_POSSIBLE]):
            if mixture.inclusion[k] < _LEAST_POSSIBLE:
                break
            moments = mixture.likeliest_moments(mixture.child((), k), groups[k].coefficients)
            found.append(self._explain(k, float(mixture.inclusion[k]), *moments))
        return tuple(found)

    def _cause(self, member: int, odds: Sequence[tuple[int, float]]) -> Cause:
        named = self._merge_by_cause([o for o in odds if not self.groups[o[0]].free_form])
        moments = [
            self.alternatives.moments(member, k, self.groups[k].coefficients) for k, _ in named
        ]
        told = [self._explain(*own, *found) for own, found in zip(named, moments, strict=True)]
        # Beyond the widest slab the linearisation fails, and no machine is that far off.
        units = [self.groups[k].unit for k, _ in named]
        told = [
            one for one, unit in zip(told, units, strict=True) if self._is_possible(one, unit)
        ] or told
        several = [one for explanation in told for one in self._twins(explanation)]
        chosen, rest = several[0], [one for one in several[1:] if one.exceeds_uncertainty]
        alike = [self._same_tool(chosen, other) for other in rest]
        return Cause(
            chosen,
            tuple(e for e, same in zip(rest, alike, strict=True) if not same),
            tuple(e for e, same in zip(rest, alike, strict=True) if same),
            self._curves(member, odds),
        )

    def _merge_by_cause(self, odds: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
        """Merge the groups of one cause on one leg (a wave at any phase); most probable first."""
        found: dict[tuple[str, ...], tuple[int, float]] = {}
        for k, p in odds:
            candidate = self.posterior.linearised.candidates[k]
            effect = self.posterior.machine.catalogue.effect_of(candidate.name)
            of = {(n.leg, n.campaign) for n in candidate.parameters}
            leg = of.pop() if effect.paired and len(of) == 1 else ("", "")
            one = (effect.name, *leg) if leg[0] else (candidate.name,)
            first, chance = found.get(one, (k, 0.0))
            found[one] = first, chance + p
        return ranked(found.values(), lambda one: one[1])

    def _twins(self, one: Explanation) -> list[Explanation]:
        """Return an explanation and its twins, which have equal effects on readings and tool."""
        catalogue, about = one.catalogue, self.posterior.linearised
        setups = tuple(s for f in about.problem.factors for s in f.setup_names)
        parts = {n: tuple(catalogue.elementary_weights(n, setups)) for n in one.parameters}
        known = [dict(about.twins.get(p, ())) for own in parts.values() for p in own]
        effects = [{catalogue.effect_of(n).name for n in twin} for twin in known]
        found, own = [one], catalogue.effect_of(one.name).name
        for effect in sorted(set.intersection(*effects)) if effects else []:
            stands = [
                next((t, f) for t, f in twin.items() if catalogue.effect_of(t).name == effect)
                for twin in known
            ]
            size = stands[0][1]
            if any(abs(f - size) > 1e-2 * abs(size) for _, f in stands):
                continue
            if len(stands) == len(parts):  # single parameters: each has its twin
                named = dict(zip(parts, (t for t, _ in stands), strict=True))
            else:
                named = {n: n.replace(own, effect, 1) for n in parts}
            if not all(self._is_parameter(n, setups) for n in named.values()):
                continue
            found.append(
                replace(
                    one,
                    name=named[one.name] if one.name in named else one.name.replace(own, effect, 1),
                    parameters=tuple(named.values()),
                    values={named[n]: v * size for n, v in one.values.items()},
                    sigmas={named[n]: v * abs(size) for n, v in one.sigmas.items()},
                )
            )
        return [replace(e, probability=one.probability / len(found)) for e in found]

    def _explain(self, k: int, probability: float, mean: Array, covariance: Array) -> Explanation:
        """Return one group as explanation, with the covariance of the coefficients it moves."""
        posterior, group = self.posterior, self.groups[k]
        about = posterior.linearised
        candidate = about.candidates[k]
        # Project the coefficients it moves on its pattern.
        own = np.linalg.pinv(group.weights)
        value = own @ mean[group.coefficients]
        spread = own @ covariance @ own.T
        machine = about.problem.machine
        unit = np.array([machine.tolerance(name) for name in candidate.parameters])
        names, values, _ = posterior.machine_parameters(mean)
        shown = about.rows[:, group.coefficients] @ group.weights @ value
        return Explanation(
            candidate.name,
            candidate.parameters,
            probability,
            dict(zip(candidate.parameters, (value * unit).tolist(), strict=True)),
            dict(
                zip(candidate.parameters, (np.sqrt(np.diag(spread)) * unit).tolist(), strict=True)
            ),
            dict(zip(names, values.tolist(), strict=True)),
            shown - posterior.linearised.nuisance.explained_residual(shown),
            posterior.machine.catalogue,  # which includes free-form errors
        )

    def _is_possible(self, one: Explanation, unit: float) -> bool:
        """True if all parameters lie within twice the widest slab, at least that of a part."""
        of = self.posterior.linearised.problem.machine.tolerance
        most = 2 * max(self.posterior.mixture.linear.slab_scales) * max(unit, 1.0)
        return all(abs(value) <= most * of(name) for name, value in one.values.items())

    def _is_parameter(self, name: str, setups: Sequence[str]) -> bool:
        try:
            self.posterior.linearised.problem.machine.catalogue.parameter(name, setups)
        except InputError:
            return False
        return True

    def _same_tool(self, one: Explanation, other: Explanation) -> bool:
        """True if two causes move the tool equally over the workspace.

        The limit is half the noise of one reading, rms: a smaller difference shows in no reading. A
        fault of an instrument never equals a fault of the machine.
        """
        of = self.posterior.machine.catalogue.effect_of
        if of(one.name).of_dial != of(other.name).of_dial:
            return False
        apart = np.array([other.machine[n] - v for n, v in one.machine.items()])
        moved = self._slopes @ apart
        noise = self.posterior.before.problem.noise.typical
        return bool(np.sqrt(np.mean(np.sum(moved**2, axis=1))) < noise / 2)

    @cached_property
    def _slopes(self) -> Array:
        """Jacobian of the TCP over the workspace by machine parameter ``(g, 3, P)``, SI."""
        machine = self.posterior.machine
        names, _, _ = self.posterior.machine_parameters(self.posterior.mean)
        return tcp_slopes(machine, names)

    def _located(
        self, member: int, odds: Sequence[tuple[int, float]], probability: float
    ) -> Located:
        members = self._curves(member, odds)
        resembling = tuple(self.groups[k].name for k, _ in odds if not self.groups[k].free_form)
        known = self._causes_moving(members[0].place)
        ruled_out = tuple(name for name in known if name not in resembling)
        return Located(members, resembling, probability, member, ruled_out)

    def _curves(self, member: int, odds: Sequence[tuple[int, float]]) -> tuple[Curve, ...]:
        """Return the curves of the free-form errors in a credible set."""
        by_name = {p.name: p for p in self.posterior.linearised.free_form_errors}
        return tuple(
            self._curve(member, k, p, by_name[self.groups[k].name])
            for k, p in odds
            if self.groups[k].free_form
        )

    def _causes_moving(self, place: FreeForm) -> Iterator[str]:
        """Yield the candidate causes that move the joints, or change the dial, of a place."""
        about = self.posterior.linearised
        motions, joints = about.problem.machine.catalogue.motions, {j for j, _ in place.joints}
        for cause in about.candidates:
            names = [p.plain for p in cause.parameters]
            if place.of_dial:
                same = all(p.setup and p.setup == place.setup for p in names)
            else:
                moved = [motions[p] for p in names if p in motions]
                same = len(moved) == len(names) and not place.moves_bar_ends and all(
                    leg == place.leg and joints & {m.joint for m in own} for leg, own in moved
                )  # fmt: skip
            if same:
                yield cause.name

    def _curve(self, member: int, k: int, probability: float, place: FreeForm) -> Curve:
        group = self.groups[k]
        mean, spread = self.alternatives.moments(member, k, group.coefficients)
        u = np.linspace(-1, 1, 2 * place.kernel.count + 1 if place.short_waves else 41)
        if isinstance(bump := place.kernel, Bump):
            u = bump.centre + bump.width * np.linspace(-_BUMP_WIDTHS, _BUMP_WIDTHS, 41)
        functions = np.stack(place.kernel.functions(u), axis=1) * place.prior_sd
        # The mean of a curve cannot be separated from the zeros.
        if not place.depends_on_approach and not place.is_local:
            functions -= functions.mean(axis=0)
        low, high = place.interval(self.posterior.before.problem.machine.geometry.stroke)
        return Curve(
            place,
            probability,
            low + (u + 1) / 2 * (high - low),
            functions @ mean[group.coefficients],
            np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", functions, spread, functions), 0.0)),
        )

    def candidate_scores(self) -> tuple[CandidateScore, ...]:
        """Return the scores of the groups nearest to being active, most probable first."""
        mixture, found = self.posterior.mixture, dict[int, float]()
        for member, _ in mixture.best:
            odds = self.alternatives.probabilities(member)
            for k, p in enumerate(odds[:-1]):
                if p > 0:
                    score = float(np.log(p) - np.log(max(odds[-1], 1e-300)) + mixture.cost[k])
                    found[k] = max(found.get(k, -np.inf), score)
        odds = mixture.next_log_bayes_factors()
        for k, p in enumerate(odds):
            found.setdefault(k, float(p))
        found = {k: score for k, score in found.items() if not self.groups[k].of_data}
        by_name = sorted(found, key=lambda k: self.groups[k].name)
        order = ranked(by_name, lambda k: found[k], LOG_ODDS_MARGIN)[:_MOST_SCORES]
        named = len(self.posterior.linearised.candidates)
        return tuple(
            CandidateScore(
                self.groups[k].name,
                self.posterior.linearised.candidates[k].parameters if k < named else (),
                float(mixture.inclusion[k]),
                found[k],
            )
            for k in order
        )
