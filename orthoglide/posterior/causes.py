"""What stands out of the background: causes with a name, places without, and their credible sets.

A credible set holds the truth with 95 % probability, something being there at all: the smallest set
of causes and places whose probabilities, all else that was found given, sum to that (Wang et al.
2020, section 3). What gives the same readings and the same tool is one cause with one name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.accuracy import workspace
from orthoglide.effects import Catalogue
from orthoglide.effects.places import Place
from orthoglide.effects.wording import cause_words
from orthoglide.fit.least_squares import Nuisances
from orthoglide.geometry import Array
from orthoglide.posterior.everything import FullPosterior
from orthoglide.posterior.mixture import Group, State
from orthoglide.prediction import Conditions

CREDIBLE = 0.95
"""Probability that a credible set holds the truth."""

NAMED = 0.9
"""Least probability of what is claimed: that something stands out, and of its kind."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """One cause of the catalogue, all else that was found given.

    Attributes:
        name: of the cause.
        parameters: that it consists of, as ``with_free`` takes them.
        probability: all else given.
        values: of its parameters, SI.
        sigmas: of these.
        machine: all parameters of the machine with this cause, SI.
        shown: its part of the readings, datums fitted ``(n,)``, metres.
        catalogue: that it belongs to.
    """

    name: str
    parameters: tuple[str, ...]
    probability: float
    values: Mapping[str, float]
    sigmas: Mapping[str, float]
    machine: Mapping[str, float]
    shown: Array
    catalogue: Catalogue

    @property
    def unit(self) -> str:
        """Of its parameters, as files name it."""
        return self.catalogue.effect_of(self.name).unit.name

    @property
    def words(self) -> str:
        """What is wrong, with size and sign, as a clause."""
        values = dict(self.values)
        if "@" not in self.name:  # of what campaigns have for themselves: the last one's
            values = {self.catalogue.parameter(n).plain: v for n, v in values.items()}
        return cause_words(self.catalogue, self.name, values)

    @property
    def look_at(self) -> str:
        """Where to look for it on the machine."""
        return self.catalogue.effect_of(self.name).look_at

    @property
    def in_unit(self) -> tuple[float, float] | None:
        """Value and sigma in its unit; ``None`` where it has several parameters.

        Of one that campaigns have for themselves: the last one's.
        """
        if len({self.catalogue.parameter(n).plain for n in self.parameters}) != 1:
            return None
        name, si = self.parameters[-1], self.catalogue.effect_of(self.name).unit.si
        return self.values[name] / si, self.sigmas[name] / si


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause that stands out, with its credible set.

    Attributes:
        chosen: the most probable of the set.
        rivals: the rest of the set that moves the tool otherwise, most probable first.
        same: what moves the tool alike too: the same cause under another name.
    """

    chosen: Explanation
    rivals: tuple[Explanation, ...]
    same: tuple[Explanation, ...]

    @property
    def name(self) -> str:
        """Of the cause."""
        return self.chosen.name

    @property
    def parameters(self) -> tuple[str, ...]:
        """That it consists of."""
        return self.chosen.parameters

    @property
    def probability(self) -> float:
        """All else that was found given."""
        return self.chosen.probability

    @property
    def explanations(self) -> tuple[Explanation, ...]:
        """The credible set."""
        return (self.chosen, *self.same, *self.rivals)

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """Names of the rest of the set."""
        return tuple(one.name for one in (*self.same, *self.rivals))


@dataclass(frozen=True, eq=False)
class Curve:
    """A place and the free function found there.

    Attributes:
        place: where and how.
        probability: all else that was found given.
        at: where the function is given: travel, command (metres) or time (seconds) ``(k,)``.
        value: SI ``(k,)``.
        sigma: SI ``(k,)``.
        shown: its part of the readings, datums fitted ``(n,)``, metres.
    """

    place: Place
    probability: float
    at: Array
    value: Array
    sigma: Array
    shown: Array

    @property
    def size(self) -> float:
        """Root mean square about its mean, SI."""
        return float(np.std(self.value))


@dataclass(frozen=True, eq=False)
class Located:
    """Something without a name: a class of places of which it is one.

    Attributes:
        members: most probable first.
        resembling: causes of the catalogue in the same credible set.
        probability: that it is one of the members, all else that was found given.
    """

    members: tuple[Curve, ...]
    resembling: tuple[str, ...]
    probability: float

    @property
    def name(self) -> str:
        """Of the most probable place."""
        return self.members[0].place.name


@dataclass(frozen=True)
class CandidateScore:
    """A cause or place that was weighed.

    Attributes:
        name: of the cause or place.
        parameters: that it consists of; none of a place.
        probability: that it stands out.
        evidence: log Bayes factor of its standing out against not, all else that was found given.
    """

    name: str
    parameters: tuple[str, ...]
    probability: float
    evidence: float


@dataclass(frozen=True, eq=False)
class Outstanding:
    """Everything that stands out of the background.

    Attributes:
        causes: with names.
        located: places without.
        weighed: all that came near, most probable first.
    """

    causes: tuple[Cause, ...]
    located: tuple[Located, ...]
    weighed: tuple[CandidateScore, ...]


def outstanding(posterior: FullPosterior, given: Sequence[str] = ()) -> Outstanding:
    """Read off what stands out of the background.

    Args:
        posterior: of everything.
        given: causes that were known to stand out.
    """
    reader = _Reader(posterior)
    found = [reader.set_of(member, given) for member, _ in posterior.mixture.best]
    return Outstanding(
        tuple(f for f in found if isinstance(f, Cause)),
        tuple(f for f in found if isinstance(f, Located)),
        reader.weighed(),
    )


@dataclass(frozen=True, eq=False)
class _Reader:
    posterior: FullPosterior

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        return self.posterior.mixture.linear.groups

    @cached_property
    def nuisance(self) -> Nuisances:
        return self.posterior.before.nuisance

    def set_of(self, member: int, given: Sequence[str]) -> Cause | Located | None:
        """The credible set in the place of one group of the best state; ``None``: no claim."""
        mixture, known = self.posterior.mixture, self.groups[member].name in given
        odds = mixture.alternatives(member)
        there = 1.0 - odds[-1]
        if known:
            odds, there = np.eye(len(odds))[member], 1.0
        if there < NAMED:
            return None
        odds = odds[:-1]
        order = np.argsort(-odds, kind="stable")
        count = int(np.searchsorted(np.cumsum(odds[order]), CREDIBLE * there)) + 1
        chosen = [int(k) for k in order[:count]]
        free = sum(float(odds[k]) for k in chosen if self.groups[k].free)
        if free < (1 - NAMED) * there or (not self.groups[chosen[0]].free and free < 0.5 * there):
            named = [k for k in chosen if not self.groups[k].free]
            return self._cause(member, [(k, float(odds[k])) for k in named])
        return self._located(member, [(k, float(odds[k])) for k in chosen], free)

    def _state(self, member: int, other: int) -> State:
        """The best state with another group in one place, at its likeliest tau."""
        mixture = self.posterior.mixture
        if other == member:
            return mixture.best
        rest = tuple(s for s in mixture.best if s[0] != member)
        return mixture.child(rest, other)

    def _cause(self, member: int, odds: Sequence[tuple[int, float]]) -> Cause:
        several = [one for k, p in odds for one in self._twins(self._explanation(member, k, p))]
        chosen, rest = several[0], several[1:]
        alike = [self._same_tool(chosen, other) for other in rest]
        return Cause(
            chosen,
            tuple(e for e, same in zip(rest, alike, strict=True) if not same),
            tuple(e for e, same in zip(rest, alike, strict=True) if same),
        )

    def _twins(self, one: Explanation) -> list[Explanation]:
        """An explanation with those under other names that show the same, readings and tool."""
        catalogue, about = one.catalogue, self.posterior.about
        setups = tuple(s for f in about.problem.factors for s in f.setup_names)
        parts = [dict(catalogue.elementary(n, setups)) for n in one.parameters]
        whole = {p for part in parts for p in part}
        twins = [dict(about.twins.get(p, ())) for p in whole]
        others = [{catalogue.effect_of(n).name for n in twin} for twin in twins]
        found = [one]
        for effect in sorted(set.intersection(*others)) if others else []:
            factor = {
                f
                for twin in twins
                for n, f in twin.items()
                if catalogue.effect_of(n).name == effect
            }
            if max(factor) - min(factor) > 1e-2 * abs(max(factor)):
                continue
            size, own = factor.pop(), catalogue.effect_of(one.name).name
            named = {n: catalogue.parameter(n.replace(own, effect, 1)) for n in one.parameters}
            found.append(
                replace(
                    one,
                    name=one.name.replace(own, effect, 1),
                    parameters=tuple(named.values()),
                    values={named[n]: v * size for n, v in one.values.items()},
                    sigmas={named[n]: v * abs(size) for n, v in one.sigmas.items()},
                )
            )
        return [replace(e, probability=one.probability / len(found)) for e in found]

    def _explanation(self, member: int, k: int, probability: float) -> Explanation:
        posterior, group = self.posterior, self.groups[k]
        mean, covariance = posterior.mixture.likeliest(self._state(member, k), group.places)
        about = posterior.about
        candidate = about.candidates[k]
        # Its own coefficients by those that it moves: the mean of a pattern is its projection.
        own = np.linalg.pinv(group.weights)
        value = own @ mean[group.places]
        spread = own @ covariance @ own.T
        unit = np.array([self._tolerance(group, c) for c in range(group.size)])
        names, values, _ = posterior.machine_with(mean)
        return Explanation(
            candidate.name,
            candidate.parameters,
            probability,
            dict(zip(candidate.parameters, (value * unit).tolist(), strict=True)),
            dict(
                zip(candidate.parameters, (np.sqrt(np.diag(spread)) * unit).tolist(), strict=True)
            ),
            dict(zip(names, values.tolist(), strict=True)),
            self._shown(about.rows[:, group.places] @ group.weights @ value),
            about.problem.machine.catalogue,
        )

    def _tolerance(self, group: Group, column: int) -> float:
        moved = group.places[np.flatnonzero(group.weights[:, column])]
        return float(self.posterior.about.scale[moved].max())

    def _shown(self, rows: Array) -> Array:
        return np.asarray(rows - self.nuisance.fitted(rows))

    def _same_tool(self, one: Explanation, other: Explanation) -> bool:
        """Whether two causes put the tool in the same places, over the workspace.

        What differs by less than half the noise of one reading, no reading would show.
        """
        apart = np.array([other.machine[n] - v for n, v in one.machine.items()])
        moved = self._slopes @ apart
        noise = self.posterior.before.problem.noise.typical
        return bool(np.sqrt(np.mean(np.sum(moved**2, axis=1))) < noise / 2)

    @cached_property
    def _slopes(self) -> Array:
        """TCP over the workspace by parameter of the machine ``(g, 3, P)``."""
        machine = self.posterior.machine
        names, _, _ = self.posterior.machine_with(self.posterior.mean)
        where = Conditions.at(workspace(machine.geometry))
        return machine.model.sensitivities(machine.values, where, names)[1][:, :3]

    def _located(
        self, member: int, odds: Sequence[tuple[int, float]], probability: float
    ) -> Located:
        by_name = {p.name: p for p in self.posterior.about.places}
        return Located(
            tuple(
                self._curve(member, k, p, by_name[self.groups[k].name])
                for k, p in odds
                if self.groups[k].free
            ),
            tuple(self.groups[k].name for k, _ in odds if not self.groups[k].free),
            probability,
        )

    def _curve(self, member: int, k: int, probability: float, place: Place) -> Curve:
        about, group = self.posterior.about, self.groups[k]
        mean, spread = self.posterior.mixture.likeliest(self._state(member, k), group.places)
        u = np.linspace(-1, 1, 41)
        functions = np.stack(place.kernel.functions(u), axis=1) * place.unit
        low, high = place.span or self.posterior.before.problem.machine.geometry.stroke
        return Curve(
            place,
            probability,
            low + (u + 1) / 2 * (high - low),
            functions @ mean[group.places],
            np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", functions, spread, functions), 0.0)),
            self._shown(about.rows[:, group.places] @ mean[group.places]),
        )

    def weighed(self, most: int = 24) -> tuple[CandidateScore, ...]:
        """What came nearest to standing out, most probable first."""
        mixture, found = self.posterior.mixture, dict[int, float]()
        for member, _ in mixture.best:
            odds = mixture.alternatives(member)
            for k, p in enumerate(odds[:-1]):
                if p > 0:
                    score = float(np.log(p) - np.log(max(odds[-1], 1e-300)) + mixture.cost)
                    found[k] = max(found.get(k, -np.inf), score)
        odds = mixture.next_odds()
        for k, p in enumerate(odds):
            found.setdefault(k, float(p))
        order = sorted(found, key=lambda k: (-round(found[k], 6), self.groups[k].name))[:most]
        named = len(self.posterior.about.candidates)
        return tuple(
            CandidateScore(
                self.groups[k].name,
                self.posterior.about.candidates[k].parameters if k < named else (),
                float(mixture.inclusion[k]),
                found[k],
            )
            for k in order
        )
