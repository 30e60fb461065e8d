"""One parameter of a machine in two states, and whether it changed."""

from __future__ import annotations

from dataclasses import dataclass

from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import parameter_words
from orthoglide.layout import LegNames
from orthoglide.numerals import decimals_for, plain, signed
from orthoglide.parameters import Parameter
from orthoglide.units import Unit

CHANGED_SIGMAS = 3.0
"""Sigmas beyond which a difference is a change if changes cannot be searched: one false change in
forty comparisons of ten parameters."""

COLUMNS = ("old", "new", "difference", "sigma", "unit", "changed")
"""Titles of `Difference.cells`."""


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
