"""Lengths that were given in another unit by mistake.

A usable machine is within millimetres of its nominal: readings that are further from it, but agree
in another unit or frame, are refused before any fit, which would bend the machine to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orthoglide.geometry import Array
from orthoglide.numerals import compact
from orthoglide.ordering import LOG_ODDS_MARGIN, largest
from orthoglide.units import UNIT_MISTAKES

MIN_MISFIT = 3e-3
"""Metres, rms: zeros off by centimetres strain the tool's path by less."""

MAX_RESIDUAL_RATIO = 0.2
"""Misfit after a mistake is corrected, over that before."""

MIN_READINGS = 4
"""Readings that a setup needs to be tested."""

FACTORS = np.array([1.0, *UNIT_MISTAKES])
"""Factors on readings: none, and those that correct a unit."""


def wrong_unit(value: Array, residual: Callable[[Array], Array]) -> str:
    """Return a clause on the unit of lengths ``(m,)`` that fit only in another one, by their
    residuals ``(m,)``, metres; empty if they fit.

    Readings that are made smaller must fit better than they are smaller: lengths that are nearly
    equal, as those of a ball bar, leave less in any smaller unit.
    """
    if len(value) < MIN_READINGS:
        return ""
    misfit = np.array([np.sqrt(np.mean(residual(f * value) ** 2)) for f in FACTORS])
    return unit_error(misfit / np.minimum(FACTORS, 1.0))


def unit_error(misfit: Array) -> str:
    """Return a clause on a mistaken unit, from the misfit by factor ``(factors,)``, metres; empty
    if the misfit is small, or no factor makes it small.
    """
    best = index_of_smallest(misfit)
    if misfit[0] < MIN_MISFIT or misfit[best] > MAX_RESIDUAL_RATIO * misfit[0]:
        return ""
    factor, size = float(FACTORS[best]), compact(misfit[0] * 1e3, 2)
    return (
        f"the readings differ by {size} mm rms from those that this machine can give, and fit once "
        f"they are multiplied by {factor:.4g}, so they seem to be {UNIT_MISTAKES[factor]}: give "
        f"millimetres"
    )


def index_of_smallest(values: Array) -> int:
    """Return the index of the smallest misfit in the flattened array, metres."""
    return largest(-np.log(np.maximum(values, 1e-12)), LOG_ODDS_MARGIN)
