"""What a comparison finds: rows of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from orthoglide.geometry import LEGS
from orthoglide.units import Unit

TCP_LIMIT = 5e-6
"""Metres: the reduction is good enough where its fitted TCP is nowhere further off ..."""

READING_LIMIT = 5e-6
"""... and its fitted readings are no further off, rms: half the step of a workshop dial."""

EQUAL_WITHIN = 1e-9
"""Metres: differences that are closer together than this count as equal."""


@dataclass(frozen=True)
class Difference:
    """Distance of two TCPs over the workspace, metres."""

    mean: float  # over all points
    max: float  # the largest
    where: tuple[float, float, float]  # TCP (3,) at which it is the largest


@dataclass(frozen=True)
class Row:
    """Difference of reduction and mechanism with one effect, or with all errors of a machine."""

    name: str  # of the parameter, or `"machine"`
    effect: str  # of the parameter; empty for a machine
    unit: Unit  # in which files show the parameter
    value: float  # of the parameter, SI; nan for a machine
    nominal: Difference  # at the TCP, all six parameters of the reduction at zero
    translated: Difference  # that difference after the best translation
    fitted: Difference  # with the six parameters fitted to the TCP
    # with the six fitted to the readings, the machine's tolerances as priors, after the best
    # translation, which leg readings cannot see
    identified: Difference
    six: tuple[float, ...]  # joint offsets and leg lengths fitted to the TCP, metres
    rotation: float  # largest turn of the platform, radians; the reduction's never turns
    reading_change: float  # what the effect does to the readings, datums fitted, rms, metres
    reading_rms: float  # residual after the six parameters and the datums are fitted, metres
    reading_max: float  # largest residual; like the last two and `identified` nan without dials
    legs: tuple[str, str, str] = LEGS  # their names

    @property
    def read(self) -> bool:
        """Whether readings of dials were compared."""
        return not math.isnan(self.reading_rms)

    @property
    def good_enough(self) -> bool:
        """Whether ``TCP_LIMIT`` and ``READING_LIMIT`` hold after the fits."""
        return self.fitted.max <= TCP_LIMIT and not self.reading_rms > READING_LIMIT

    @property
    def good_up_to(self) -> float:
        """Size of the parameter, SI, up to which the reduction is sufficient, by proportion."""
        excess = self.fitted.max / TCP_LIMIT
        if self.read:
            excess = max(excess, self.reading_rms / READING_LIMIT)
        return float(abs(self.value) / excess) if excess > 1e-6 else float("inf")


def worst_by_effect(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return for every effect the row with the largest difference, in the order of the rows.

    Of equal rows it is the first, as for the legs of most effects.
    """
    worst_rows: dict[str, Row] = {}
    for row in rows:
        worst = worst_rows.setdefault(row.effect, row)
        difference = row.fitted.max - worst.fitted.max
        if difference > EQUAL_WITHIN or (
            abs(difference) <= EQUAL_WITHIN and row.reading_rms > worst.reading_rms + EQUAL_WITHIN
        ):
            worst_rows[row.effect] = row
    return tuple(worst_rows.values())
