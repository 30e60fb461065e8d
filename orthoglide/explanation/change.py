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
"""Sigmas beyond which what is left after a change is an error of its own."""


@dataclass(frozen=True, repr=False)
class Change:
    """A parameter of the machine that is not what it was in an earlier file."""

    parameter: Parameter  # the most probable one
    # all parameters whose change these readings cannot tell from its, itself first
    members: tuple[Parameter, ...]
    since: str  # name of the first campaign after the change; empty since an earlier calibration
    # files, or names, of the last one before and the first after the change
    between: tuple[str, str]
    evidence: float  # log Bayes factor in its favour, the number of its like discounted
    catalogue: Catalogue  # that the parameters belong to
    before: float = float("nan")  # value before the change, SI
    after: float = float("nan")  # value after the change, SI
    sigma: float = float("nan")  # standard deviation of the difference, SI
    sigma_after: float = float("nan")  # standard deviation of the value after the change, SI
    sizes: tuple[float, ...] = ()  # by how much each of `members` would have changed, SI
    size_sigma: float = float("nan")  # standard deviation of the first of `sizes`, SI
    sigma_between_sets: float = (
        0.0  # the part of `size_sigma` that other sets of changes contribute, SI
    )
    # whether the value before is an average over causes that could not be told apart
    vague: bool = False
    unseen_before: float = (
        0.0  # by how much it may have been off before unseen, a standard deviation, SI
    )

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
        """Change of each member, were it the one that changed, SI; nan if unknown."""
        by, of = self.after - self.before, self.catalogue.effect_of
        alike = [by if of(name).unit == self.unit else float("nan") for name in self.members]
        return dict(zip(self.members, (by, *(self.sizes or alike)[1:]), strict=True))

    @property
    def message(self) -> str:
        """One sentence: between which files, what, from what to what."""
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
        """Each member by itself: the first as in the message, the others by their own sizes."""
        return (f"{self.when} {self.what_without_alternatives}", *self._alternatives)

    @property
    def what_without_alternatives(self) -> str:
        """Clause with the parameter and both values, without the alternatives."""
        return self._clause("")

    def _parameter_words(self, parameter: Parameter) -> str:
        return parameter_words(parameter, self.catalogue.legs)

    def _clause(self, others: str) -> str:
        unit = self.unit.spoken
        decimals = decimals_for(self.sigma / unit.si, most=9)
        before, after = (plain(v / unit.si, decimals) for v in (self.before, self.after))
        size = f"from {before} to {after}"
        if self.vague:
            size = f"by {signed((self.after - self.before) / unit.si, decimals)}"
        return (
            f"the {self._parameter_words(self.parameter)}{others} changed {size} {unit.name} "
            f"(± {self.sigma / unit.si:.{decimals}f})"
        )

    @property
    def alternatives_clause(self) -> str:
        """The alternatives with their sizes, in brackets; empty if there are none."""
        return f" (or {', or '.join(self._alternatives)})" if self._alternatives else ""

    @property
    def _alternatives(self) -> tuple[str, ...]:
        named = []
        for name, by in list(self.change_by_member.items())[1:]:
            size = signed_size(self.catalogue.effect_of(name), by) if math.isfinite(by) else ""
            named.append(f"the {self._parameter_words(name)}{size and f' by {size}'}")
        return tuple(named)

    @property
    def summed_members(self) -> tuple[Parameter, ...]:
        """Members that share what ``before`` and ``after`` say."""
        return summed_members(self.members, self.catalogue)

    @property
    def campaign_parameters(self) -> tuple[str, ...]:
        """Members as per-campaign parameters from ``since`` on, for ``build_problem``."""
        return tuple(f"{name}@{self.since}" for name in self.members)

    @property
    def is_reported(self) -> bool:
        """Whether there is a difference to tell, once the evidence has decided for one: what the
        readings before did not see may have been as it is now.
        """
        return abs(self.after - self.before) > max(
            self.sigma, SIGNIFICANT_SIGMAS * self.unseen_before
        )

    @property
    def found_only_now(self) -> str:
        """What is told in place of a change that is none to tell; empty where there is nothing."""
        if (
            self.is_reported
            or abs(self.after - self.before) < SIGNIFICANT_SIGMAS * self.sigma_after
        ):
            return ""
        value, unit = compact(self.after / self.unit.spoken.si, 3), self.unit.spoken.name
        return (
            f"the {self._parameter_words(self.parameter)} is {value} {unit}: the readings of the "
            f"calibration before could not see it, so nothing shows that it changed since"
        )

    @property
    def is_cause(self) -> bool:
        """Whether the error that remains after the change is significant."""
        return abs(self.after) > SIGNIFICANT_SIGMAS * self.sigma_after

    def with_later_fit(self, estimate: Estimate) -> Change:
        """Return the change with the value and the sigma of a later fit."""
        summed = self.summed_members
        places = [k for k, name in enumerate(estimate.names) if name in summed]
        if len(places) < len(summed):
            return self
        spread = estimate.covariance[np.ix_(places, places)].sum()
        after = float(estimate.x[places].sum())
        after += self.before if self.parameter.member else 0.0  # its unknown is the change
        before = after - (self.after - self.before) if self.vague else self.before
        return replace(self, before=before, after=after, sigma_after=float(np.sqrt(spread)))

    def with_separate_fit(self, estimate: Estimate) -> Change:
        """With the values of a fit in which the parameter, or a member instead, is separate.

        The search knows by how much it changed with everything open, the fit with all else as
        small as it was found to be; where it says another size, it has that wrong.
        """
        names = estimate.problem.names
        for name in self.members:
            places = [k for k, n in enumerate(names) if n.plain == name]
            pair = [p for p in pairwise(places) if names[p[1]] == f"{name}@{self.since}"]
            if not pair:
                continue
            at = list(pair[0])  # before the change, and after
            (before, after), spread = estimate.x[at], estimate.covariance[np.ix_(at, at)]
            first = self.members.index(name)
            size = self.sizes[first]
            ratio = abs(size / self.sizes[0])
            widest, among = self.size_sigma * ratio, self.sigma_between_sets * ratio
            sigma = math.sqrt(spread[0, 0] + spread[1, 1] - 2 * spread[0, 1] + among**2)
            if abs(after - before - size) > SIGNIFICANT_SIGMAS * widest:
                about, sigma = (before + after) / 2, widest
                before, after = about - size / 2, about + size / 2
            order = [first, *(k for k in range(len(self.members)) if k != first)]
            return replace(
                self,
                parameter=name,
                members=tuple(self.members[k] for k in order),
                sizes=tuple(self.sizes[k] for k in order),
                before=float(before),
                after=float(after),
                sigma=sigma,
                sigma_after=float(np.sqrt(spread[1, 1])),
                size_sigma=widest,
                sigma_between_sets=among,
            )
        return self


def summed_members(members: tuple[Parameter, ...], catalogue: Catalogue) -> tuple[Parameter, ...]:
    """What the readings cannot tell apart counts as one, the sum of all of one unit that stand for
    it: of one leg and direction, one plate, or one pattern of legs. A zero is known apart from a
    length by the tolerances of both.
    """
    of = catalogue.effect_of

    def place(name: Parameter) -> tuple[object, ...]:
        return name.leg, name.direction, name.setup, name.member, of(name).unit

    alike = tuple(name for name in members if place(name) == place(members[0]))
    return members[:1] if of(members[0]).name in catalogue.base else alike
