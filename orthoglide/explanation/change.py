"""A parameter that changed: between two campaigns, or since an earlier calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orthoglide.effects import Catalogue
from orthoglide.effects.wording import parameter_words, signed_size
from orthoglide.fit.estimate import Estimate
from orthoglide.numerals import compact, decimals_for, plain, signed
from orthoglide.parameters import Parameter
from orthoglide.units import Unit

SIGNIFICANT_SIGMAS = 3.0
"""Sigmas beyond which the error that remains after a change is significant."""


@dataclass(frozen=True, repr=False)
class Change:
    """A parameter of the machine that differs from its value in an earlier file."""

    parameter: Parameter  # the most probable one
    # all parameters whose change explains these readings equally well, the most probable first
    members: tuple[Parameter, ...]
    since: str  # name of the first campaign after the change; empty since an earlier calibration
    # files, or names, of the last one before and the first after the change
    between: tuple[str, str]
    evidence: float  # log Bayes factor in its favour, prior odds included
    catalogue: Catalogue  # catalogue of the parameters
    before: float = float("nan")  # value before the change, SI
    after: float = float("nan")  # value after the change, SI
    sigma: float = float("nan")  # standard deviation of the difference, SI
    sigma_after: float = float("nan")  # standard deviation of the value after the change, SI
    sizes: tuple[float, ...] = ()  # change of each of `members`, if it is the one that changed, SI
    size_sigma: float = float("nan")  # standard deviation of the first of `sizes`, SI
    sigma_between_sets: float = 0.0  # part of `size_sigma` from other sets of changes, SI
    vague: bool = False  # whether the value before is an average over ambiguous causes
    # standard deviation of an error that the readings before could not show, SI
    unseen_before: float = 0.0

    def __repr__(self) -> str:
        return f"<Change of {self.parameter}: {self.message}>"

    @property
    def unit(self) -> Unit:
        """Unit of the parameter in files."""
        return self.catalogue.effect_of(self.parameter).unit

    @property
    def files(self) -> tuple[str, str]:
        """The two file names in ``between``, without folders."""
        before, after = (path.rpartition("/")[2] for path in self.between)
        return before, after

    @property
    def change_by_member(self) -> dict[Parameter, float]:
        """Change of each member, if it is the one that changed, SI; nan if unknown."""
        change, effect_of = self.after - self.before, self.catalogue.effect_of
        units = (effect_of(name).unit for name in self.members)
        sizes = self.sizes or [change if unit == self.unit else math.nan for unit in units]
        return dict(zip(self.members, (change, *sizes[1:]), strict=True))

    @property
    def message(self) -> str:
        """One sentence: between which files, which parameter, from which value to which."""
        return f"{self.when} {self.what}"

    @property
    def when(self) -> str:
        """Between which files."""
        return f"between {self.files[0]} and {self.files[1]}"

    @property
    def what(self) -> str:
        """Clause with the parameter, both values, and the alternatives."""
        return self._clause(self.alternatives_clause)

    @property
    def member_clauses(self) -> tuple[str, ...]:
        """A clause for each member: the first as in the message, the others with their sizes."""
        return (f"{self.when} {self.what_without_alternatives}", *self._alternatives)

    @property
    def what_without_alternatives(self) -> str:
        """Clause with the parameter and both values, without the alternatives."""
        return self._clause("")

    def _parameter_words(self, parameter: Parameter) -> str:
        return parameter_words(parameter, self.catalogue.legs)

    def _clause(self, alternatives: str) -> str:
        unit = self.unit.spoken
        decimals = decimals_for(self.sigma / unit.si, most=9)
        before, after = (plain(v / unit.si, decimals) for v in (self.before, self.after))
        size = f"from {before} to {after}"
        if self.vague:
            size = f"by {signed((self.after - self.before) / unit.si, decimals)}"
        return (
            f"the {self._parameter_words(self.parameter)}{alternatives} changed {size} {unit.name} "
            f"(± {self.sigma / unit.si:.{decimals}f})"
        )

    @property
    def alternatives_clause(self) -> str:
        """The alternatives with their sizes, in brackets; empty if there are none."""
        return f" (or {', or '.join(self._alternatives)})" if self._alternatives else ""

    @property
    def _alternatives(self) -> tuple[str, ...]:
        clauses = []
        for name, change in list(self.change_by_member.items())[1:]:
            words = f"the {self._parameter_words(name)}"
            if math.isfinite(change):
                words += f" by {signed_size(self.catalogue.effect_of(name), change)}"
            clauses.append(words)
        return tuple(clauses)

    @property
    def summed_members(self) -> tuple[Parameter, ...]:
        """Members whose sum ``before`` and ``after`` describe."""
        return summed_members(self.members, self.catalogue)

    @property
    def campaign_parameters(self) -> tuple[str, ...]:
        """Members as per-campaign parameters from ``since`` on, for ``build_problem``."""
        return tuple(f"{name}@{self.since}" for name in self.members)

    @property
    def is_reported(self) -> bool:
        """True if the difference exceeds its sigma and what earlier readings could not show."""
        least = max(self.sigma, SIGNIFICANT_SIGMAS * self.unseen_before)
        return abs(self.after - self.before) > least

    @property
    def found_only_now(self) -> str:
        """Note in place of a change that is not reported; empty if it is insignificant."""
        significant = abs(self.after - self.before) >= SIGNIFICANT_SIGMAS * self.sigma_after
        if self.is_reported or not significant:
            return ""
        value, unit = compact(self.after / self.unit.spoken.si, 3), self.unit.spoken.name
        return (
            f"the {self._parameter_words(self.parameter)} is {value} {unit}: the readings of the "
            f"calibration before could not see it, so nothing shows that it changed since"
        )

    @property
    def is_cause(self) -> bool:
        """True if the error that remains after the change is significant."""
        return abs(self.after) > SIGNIFICANT_SIGMAS * self.sigma_after

    def with_later_fit(self, estimate: Estimate) -> Change:
        """Return the change with the value and the sigma of a later fit."""
        summed = self.summed_members
        places = [k for k, name in enumerate(estimate.names) if name in summed]
        if len(places) < len(summed):
            return self
        variance = estimate.covariance[np.ix_(places, places)].sum()
        after = float(estimate.x[places].sum())
        after += self.before if self.parameter.member else 0.0  # its unknown is the change
        before = after - (self.after - self.before) if self.vague else self.before
        return replace(self, before=before, after=after, sigma_after=float(np.sqrt(variance)))

    def with_separate_fit(self, estimate: Estimate) -> Change:
        """Return the change with the values of a fit in which one of its members is separate.

        The search estimates the change with all parameters free, the fit with all others as small
        as they were found. If the two sizes differ significantly, that of the search is kept.
        """
        names = estimate.problem.names
        for name in self.members:
            places = [k for k, n in enumerate(names) if n.plain == name]
            pair = [p for p in pairwise(places) if names[p[1]] == f"{name}@{self.since}"]
            if not pair:
                continue
            pair_columns = list(pair[0])  # before the change, and after
            (before, after), covariance = (
                estimate.x[pair_columns],
                estimate.covariance[np.ix_(pair_columns, pair_columns)],
            )
            chosen = self.members.index(name)
            size = self.sizes[chosen]
            ratio = abs(size / self.sizes[0])
            size_sigma, between_sets = self.size_sigma * ratio, self.sigma_between_sets * ratio
            sigma = math.sqrt(
                covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1] + between_sets**2
            )
            if abs(after - before - size) > SIGNIFICANT_SIGMAS * size_sigma:
                middle, sigma = (before + after) / 2, size_sigma
                before, after = middle - size / 2, middle + size / 2
            order = [chosen, *(k for k in range(len(self.members)) if k != chosen)]
            return replace(
                self,
                parameter=name,
                members=tuple(self.members[k] for k in order),
                sizes=tuple(self.sizes[k] for k in order),
                before=float(before),
                after=float(after),
                sigma=sigma,
                sigma_after=float(np.sqrt(covariance[1, 1])),
                size_sigma=size_sigma,
                sigma_between_sets=between_sets,
            )
        return self


def summed_members(members: tuple[Parameter, ...], catalogue: Catalogue) -> tuple[Parameter, ...]:
    """Return the members that the readings determine only by their sum: those of equal unit at one
    leg and direction, one plate, or one pattern of legs. Base parameters are not summed, because
    their tolerances separate them.
    """
    effect_of = catalogue.effect_of

    def place(name: Parameter) -> tuple[object, ...]:
        return name.leg, name.direction, name.setup, name.member, effect_of(name).unit

    equal_place = tuple(name for name in members if place(name) == place(members[0]))
    return members[:1] if effect_of(members[0]).name in catalogue.base else equal_place
