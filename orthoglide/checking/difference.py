"""One parameter of a machine in two states, whether it changed, and how zeros were entered."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from orthoglide.accuracy import best_zeros
from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import parameter_words
from orthoglide.layout import LegNames
from orthoglide.machine import Machine
from orthoglide.numerals import decimals_for, plain, signed
from orthoglide.parameters import Parameter
from orthoglide.units import Unit

CHANGED_SIGMAS = 3.0
"""Sigmas beyond which a difference is a change if changes cannot be searched: one false change in
forty comparisons of ten parameters."""

COLUMNS = ("old", "new", "difference", "sigma", "unit", "changed")
"""Titles of `Difference.cells`."""

_MATCHING_SHARE = 0.05  # relative deviation of an entry: people enter two digits
_DISTINCT_RATIO = 3.0  # least ratio of the advised change to the margin, to tell entries apart
_ADVICE_NAMES = "as much as the readings before ask for"
_ENTRY_CLAUSES = {
    1.0: f"{_ADVICE_NAMES}: {{}} entered",
    2.0: f"twice {_ADVICE_NAMES}: {{}} entered twice, or added to what had been entered before",
    -1.0: (
        f"{_ADVICE_NAMES}, but the other way: {{}} entered with the other sign. If that is how the "
        f"controller counts, enter new zeros with the other sign too; if it was a slip, as told"
    ),
}


@dataclass(frozen=True)
class Difference:
    """One parameter in both states, SI."""

    parameter: Parameter  # its name
    before: float  # value in the old state
    after: float  # value in the new state
    sigma: float  # standard deviation of the difference
    unit: Unit  # of files
    changed: bool  # whether the difference exceeds its uncertainty
    alternatives_clause: str = ""  # alternatives, in brackets, or empty
    legs: LegNames = CATALOGUE.legs  # names of the machine's legs and parts

    @property
    def words(self) -> str:
        """The parameter in words."""
        return parameter_words(self.parameter, self.legs)

    @property
    def cells(self) -> tuple[str, ...]:
        """Old and new value, difference and sigma in the unit of files, and whether it changed."""
        return (*self._figures(self.unit), self.unit.name, "yes" if self.changed else "no")

    def _figures(self, unit: Unit) -> tuple[str, str, str, str]:
        """Return the old and the new value, the difference and its sigma."""
        si, places = unit.si, decimals_for(self.sigma / unit.si, most=9)
        before, after = (plain(v / si, places) for v in (self.before, self.after))
        difference = signed((self.after - self.before) / si, places)
        return before, after, difference, f"{self.sigma / si:.{places}f}"

    def __str__(self) -> str:
        unit, words = self.unit.spoken, self.words
        before, after, difference, sigma = self._figures(unit)
        if self.changed:
            size = f"from {before} to {after} {unit.name}: by {difference} ± {sigma}"
            return f"{words}{self.alternatives_clause} changed {size}"
        size = f"{difference} ± {sigma} {unit.name}"
        return f"{words} did not change by more than its uncertainty: {size}"

    @property
    def is_significant(self) -> bool:
        """True if both values differ by more than three sigmas."""
        return abs(self.after - self.before) > CHANGED_SIGMAS * self.sigma

    @property
    def unchanged_clause(self) -> str:
        """The difference of an unchanged parameter, for a list."""
        _, _, difference, sigma = self._figures(self.unit.spoken)
        return f"{self.words} {difference} ± {sigma} {self.unit.spoken.name}"


def zero_entry_clauses(old_machine: Machine, differences: Iterable[Difference]) -> Iterator[str]:
    """Yield a clause for each way in which advised zeros of drives were entered.

    Args:
        old_machine: the machine identified from the readings of the old state.
        differences: differences between both states.
    """
    advised, drives = best_zeros(old_machine), dict[float, list[str]]()
    for difference in differences:
        intended = -advised.get(str(difference.parameter), 0.0)
        margin = max(CHANGED_SIGMAS * difference.sigma, _MATCHING_SHARE * abs(intended))
        if not difference.changed or abs(intended) < _DISTINCT_RATIO * margin:
            continue
        for ratio in _ENTRY_CLAUSES:
            if abs(difference.after - difference.before - ratio * intended) < margin:
                drives.setdefault(ratio, []).append(difference.parameter.leg)
    for ratio, legs in drives.items():
        first, *others = legs
        which = f"zeros of drives {', '.join(legs)}" if others else f"zero of drive {first}"
        clause = _ENTRY_CLAUSES[ratio].format("they were" if others else "it was")
        yield f"the {which} changed by {clause}"
