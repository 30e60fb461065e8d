"""One parameter of a machine in two states, and whether it changed."""

from __future__ import annotations

from dataclasses import dataclass

from orthoglide.effects.wording import parameter_words
from orthoglide.numerals import decimals_for, plain, signed
from orthoglide.parameters import Parameter
from orthoglide.units import Unit

CHANGED = 3.0
"""Sigmas of a difference that count as a change where changes cannot be searched for; among some
ten parameters, one false in forty."""


@dataclass(frozen=True)
class Difference:
    """One parameter in both states, each from its own readings, SI."""

    parameter: Parameter  # its name
    before: float  # value in the old state
    after: float  # value in the new one
    sigma: float  # standard deviation of the difference
    unit: Unit  # of files
    changed: bool  # whether the difference is beyond what the readings leave open
    others: str = ""  # what else may have changed instead, in brackets, or empty

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
        unit, words = self.unit.spoken, parameter_words(self.parameter)
        before, after, apart, sigma = self._figures(unit)
        if self.changed:
            size = f"from {before} to {after} {unit.name}: by {apart} ± {sigma}"
            return f"{words}{self.others} changed {size}"
        return f"{words} did not change by more than its uncertainty: {apart} ± {sigma} {unit.name}"

    @property
    def far(self) -> bool:
        """Whether both values differ by more than their sigma leaves open."""
        return abs(self.after - self.before) > CHANGED * self.sigma

    @property
    def still(self) -> str:
        """By how much it did not change, in a list."""
        _, _, apart, sigma = self._figures(self.unit.spoken)
        return f"{parameter_words(self.parameter)} {apart} ± {sigma} {self.unit.spoken.name}"


COLUMNS = ("old", "new", "difference", "sigma", "unit", "changed")
"""What `Difference.cells` holds."""
