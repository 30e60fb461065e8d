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
"""Sigmas of a difference that count as a change where changes cannot be searched for; among some
ten parameters, one false in forty."""

COLUMNS = ("old", "new", "difference", "sigma", "unit", "changed")
"""What `Difference.cells` holds."""

_MATCHING_SHARE = 0.05  # of what was asked for: people enter two digits
_DISTINCT_RATIO = 3.0  # times that what was asked for must be, for the ways to look different
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
    """One parameter in both states, each from its own readings, SI."""

    parameter: Parameter  # its name
    before: float  # value in the old state
    after: float  # value in the new one
    sigma: float  # standard deviation of the difference
    unit: Unit  # of files
    changed: bool  # whether the difference is beyond what the readings leave open
    alternatives_clause: str = ""  # what else may have changed instead, in brackets, or empty
    legs: LegNames = CATALOGUE.legs  # names of the machine's legs and parts

    @property
    def words(self) -> str:
        """The parameter in words."""
        return parameter_words(self.parameter, self.legs)

    @property
    def cells(self) -> tuple[str, ...]:
        """Old, new, difference and its sigma in the unit of files, and whether it changed."""
        return (*self._figures(self.unit), self.unit.name, "yes" if self.changed else "no")

    def _figures(self, unit: Unit) -> tuple[str, str, str, str]:
        """Old, new, difference and its sigma."""
        si, places = unit.si, decimals_for(self.sigma / unit.si, most=9)
        before, after = (plain(v / si, places) for v in (self.before, self.after))
        apart = signed((self.after - self.before) / si, places)
        return before, after, apart, f"{self.sigma / si:.{places}f}"

    def __str__(self) -> str:
        unit, words = self.unit.spoken, self.words
        before, after, apart, sigma = self._figures(unit)
        if self.changed:
            size = f"from {before} to {after} {unit.name}: by {apart} ± {sigma}"
            return f"{words}{self.alternatives_clause} changed {size}"
        return f"{words} did not change by more than its uncertainty: {apart} ± {sigma} {unit.name}"

    @property
    def is_significant(self) -> bool:
        """Whether both values differ by more than their sigma leaves open."""
        return abs(self.after - self.before) > CHANGED_SIGMAS * self.sigma

    @property
    def unchanged_clause(self) -> str:
        """By how much it did not change, in a list."""
        _, _, apart, sigma = self._figures(self.unit.spoken)
        return f"{self.words} {apart} ± {sigma} {self.unit.spoken.name}"


def zero_entry_clauses(was: Machine, differences: Iterable[Difference]) -> Iterator[str]:
    """A clause for each way in which drives' zeros changed as they should have, or should not.

    Args:
        was: the machine as the old state's readings have it.
        differences: of both states.
    """
    advised, drives = best_zeros(was), dict[float, list[str]]()
    for one in differences:
        told = -advised.get(str(one.parameter), 0.0)
        near = max(CHANGED_SIGMAS * one.sigma, _MATCHING_SHARE * abs(told))
        if not one.changed or abs(told) < _DISTINCT_RATIO * near:
            continue
        for times in _ENTRY_CLAUSES:
            if abs(one.after - one.before - times * told) < near:
                drives.setdefault(times, []).append(one.parameter.leg)
    for times, legs in drives.items():
        first, *others = legs
        which = f"zeros of drives {', '.join(legs)}" if others else f"zero of drive {first}"
        yield f"the {which} changed by {_ENTRY_CLAUSES[times].format('they were' if others else 'it was')}"
