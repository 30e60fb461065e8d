"""One parameter of a machine in two states: at two visits, or at a visit and a calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orthoglide.effects import Catalogue
from orthoglide.effects.wording import difference_words, signed_size
from orthoglide.fit.estimate import Estimate
from orthoglide.numerals import compact, decimals_for, plain, signed
from orthoglide.parameters import Parameter
from orthoglide.units import Unit

SIGNIFICANT_SIGMAS = 3.0
"""Sigmas beyond which a difference, or the error that remains after a change, is significant: one
false change in forty comparisons of ten parameters."""

COLUMNS = ("old", "new", "difference", "sigma", "unit", "changed")
"""Titles of `Change.cells`."""


@dataclass(frozen=True, repr=False)
class Change:
    """A parameter of the machine before and after, with all others that may have changed instead.

    The search estimates the sizes; a fit with the parameter separate gives both values.
    """

    # change of each parameter that explains these readings equally well, if it is the one that
    # changed, SI; the most probable first
    sizes: Mapping[Parameter, float]
    catalogue: Catalogue  # catalogue of the parameters
    since: str = ""  # name of the first campaign after it; empty since an earlier calibration
    # the last file, or campaign, before it and the first one after it
    files: tuple[str, str] = ("", "")
    before: float = math.nan  # value before the change, SI
    after: float = math.nan  # value after the change, SI
    sigma: float = math.nan  # standard deviation of the difference, SI
    sigma_after: float = math.nan  # standard deviation of the value after the change, SI
    evidence: float = math.nan  # log Bayes factor in its favour, given the other changes
    log_odds_against: float = 0.0  # log prior odds against it
    size_sigma: float = math.nan  # standard deviation of the first of `sizes`, SI
    sigma_between_sets: float = 0.0  # part of `size_sigma` from other sets of changes, SI
    vague: bool = False  # whether the value before is an average over ambiguous causes
    # standard deviation of an error that the readings before could not show, SI
    unseen_before: float = 0.0
    changed: bool = True  # whether the difference exceeds its uncertainty
    rivals: tuple[str, ...] = ()  # causes that explain the values equally well, a clause each

    def __repr__(self) -> str:
        return f"<Change of {self.parameter}: {self.message}>"

    @property
    def members(self) -> tuple[Parameter, ...]:
        """All parameters whose change explains these readings equally well."""
        return tuple(self.sizes)

    @property
    def parameter(self) -> Parameter:
        """The most probable one of them."""
        return self.members[0]

    @property
    def unit(self) -> Unit:
        """Unit of the parameter in files."""
        return self.catalogue.effect_of(self.parameter).unit

    @property
    def difference(self) -> float:
        """Value after the change less that before, SI."""
        return self.after - self.before

    @property
    def change_by_member(self) -> dict[Parameter, float]:
        """Change of each member, if it is the one that changed, SI."""
        return {**self.sizes, self.parameter: self.difference}

    @property
    def summed_members(self) -> tuple[Parameter, ...]:
        """Members that the readings determine only by their sum, which ``before`` and ``after``
        are: those of equal unit at one leg and direction, one plate, or one pattern of legs. Base
        parameters are not summed, because their tolerances separate them.
        """
        effect_of = self.catalogue.effect_of

        def place(name: Parameter) -> tuple[object, ...]:
            return name.leg, name.direction, name.setup, name.member, effect_of(name).unit

        equal_place = tuple(n for n in self.members if place(n) == place(self.parameter))
        is_base = effect_of(self.parameter).name in self.catalogue.base
        return self.members[:1] if is_base else equal_place

    @property
    def campaign_parameters(self) -> tuple[str, ...]:
        """Members as per-campaign parameters from ``since`` on, for ``build_problem``."""
        return tuple(f"{name}@{self.since}" for name in self.members)

    # Whether it is one ----------------------------------------------------------------------

    @property
    def is_significant(self) -> bool:
        """True if both values differ by more than three sigmas."""
        return abs(self.difference) > SIGNIFICANT_SIGMAS * self.sigma

    def is_zero(self, value: float) -> bool:
        """Return whether a value, before or after, is within the uncertainty of the difference."""
        return abs(value) <= SIGNIFICANT_SIGMAS * self.sigma

    @property
    def is_reported(self) -> bool:
        """True if the difference exceeds its sigma and what earlier readings could not show."""
        return abs(self.difference) > max(self.sigma, SIGNIFICANT_SIGMAS * self.unseen_before)

    @property
    def is_cause(self) -> bool:
        """True if the error that remains after the change is significant."""
        return abs(self.after) > SIGNIFICANT_SIGMAS * self.sigma_after

    @property
    def loses(self) -> bool:
        """True if it may be lost motion, which the expected errors of the tool exclude."""
        return any("approach" in self.catalogue.effect_of(name).needs for name in self.members)

    # In words -------------------------------------------------------------------------------

    @property
    def words(self) -> str:
        """The parameter in words."""
        return self._words_of(self.parameter)

    def _words_of(self, parameter: Parameter) -> str:
        return difference_words(self.catalogue, parameter)

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
        return self._clause(*self._other_members, *self.rivals)

    @property
    def member_clauses(self) -> tuple[str, ...]:
        """A clause for each member: the first as in the message, the others with their sizes."""
        return f"{self.when} {self._clause()}", *self._other_members

    @property
    def _other_members(self) -> tuple[str, ...]:
        """A clause for each member but the first, with its size."""
        effect_of = self.catalogue.effect_of
        return tuple(
            f"the {self._words_of(name)} by {signed_size(effect_of(name), self.sizes[name])}"
            for name in self.members[1:]
        )

    def _clause(self, *alternatives: str) -> str:
        """Return the parameter, alternatives in brackets, and its change."""
        before, after, difference, sigma = self._figures(self.unit.spoken)
        others = f" (or {', or '.join(alternatives)})" if alternatives else ""
        unit = self.unit.spoken.name
        if self.vague:
            return f"the {self.words}{others} changed by {difference} {unit} (± {sigma})"
        values = f"from {before} to {after} {unit}"
        return f"the {self.words}{others} changed {values}, by {difference} ± {sigma}"

    @property
    def found_only_now(self) -> str:
        """Note in place of a change that is not reported; empty if it is insignificant."""
        significant = abs(self.difference) >= SIGNIFICANT_SIGMAS * self.sigma_after
        if self.is_reported or not significant:
            return ""
        value, unit = compact(self.after / self.unit.spoken.si, 3), self.unit.spoken.name
        return (
            f"the {self.words} is {value} {unit}: the readings of the calibration before could not "
            f"see it, so nothing shows that it changed since"
        )

    # In a comparison ------------------------------------------------------------------------

    @property
    def cells(self) -> tuple[str, ...]:
        """Old and new value, difference and sigma in the unit of files, and whether it changed."""
        return (*self._figures(self.unit), self.unit.name, "yes" if self.changed else "no")

    def _figures(self, unit: Unit) -> tuple[str, str, str, str]:
        """Return the value before and after, the difference and its sigma."""
        si, places = unit.si, decimals_for(self.sigma / unit.si, most=9)
        before, after = (plain(v / si, places) for v in (self.before, self.after))
        return before, after, signed(self.difference / si, places), f"{self.sigma / si:.{places}f}"

    @property
    def unchanged_clause(self) -> str:
        """The difference of an unchanged parameter, for a list."""
        _, _, difference, sigma = self._figures(self.unit.spoken)
        return f"{self.words} {difference} ± {sigma} {self.unit.spoken.name}"

    # With the values of a fit ---------------------------------------------------------------

    def with_later_fit(self, estimate: Estimate) -> Change:
        """Return the change with the value and the sigma of a later fit."""
        summed = self.summed_members
        places = [k for k, name in enumerate(estimate.names) if name in summed]
        if len(places) < len(summed):
            return self
        after, sigma_after = combination(estimate, places)
        after += self.before if self.parameter.member else 0.0  # its unknown is the change
        before = after - self.difference if self.vague else self.before
        return replace(self, before=before, after=after, sigma_after=sigma_after)

    def with_separate_fit(self, estimate: Estimate) -> Change:
        """Return the change with the values of a fit in which one of its members is separate.

        The search estimates the change with all parameters free, the fit with all others as small
        as they were found. If the two sizes differ significantly, that of the search is kept.
        """
        names = estimate.problem.names
        for name in self.members:
            places = [k for k, n in enumerate(names) if n.plain == name]
            pair = next((p for p in pairwise(places) if names[p[1]] == name.at(self.since)), None)
            if pair is None:
                continue
            before, after = estimate.x[[*pair]].tolist()
            _, sigma_of_fit = combination(estimate, pair, (-1.0, 1.0))
            _, sigma_after = combination(estimate, pair[1:])
            size, ratio = self.sizes[name], abs(self.sizes[name] / self.sizes[self.parameter])
            size_sigma, between_sets = self.size_sigma * ratio, self.sigma_between_sets * ratio
            sigma = math.hypot(sigma_of_fit, between_sets)
            if abs(after - before - size) > SIGNIFICANT_SIGMAS * size_sigma:
                middle, sigma = (before + after) / 2, size_sigma
                before, after = middle - size / 2, middle + size / 2
            return replace(
                self,
                sizes={name: size, **self.sizes},
                before=before,
                after=after,
                sigma=sigma,
                sigma_after=sigma_after,
                size_sigma=size_sigma,
                sigma_between_sets=between_sets,
            )
        return self


def combination(
    estimate: Estimate, places: Sequence[int], weights: Sequence[float] | None = None
) -> tuple[float, float]:
    """Return a weighted sum of some unknowns, given by their indices, and its standard deviation;
    without weights their sum.
    """
    weight = np.ones(len(places)) if weights is None else np.array(weights)
    variance = weight @ estimate.covariance[np.ix_(places, places)] @ weight
    return float(weight @ estimate.x[[*places]]), float(np.sqrt(variance))
