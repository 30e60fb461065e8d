"""Whether a reading can be: against what was read before and what the tolerances allow.

With everything in the catalogue within a few tolerances, the readings of a sheet are jointly
normal: ``y = y0 + J x + datum + placement + rounding + noise``. Given those taken so far the next
one has a mean and a standard deviation; that repeats agree is part of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.observations.checks import DIAL_RANGE
from orthoglide.planning.designs import shown_names
from orthoglide.planning.linear import LinearReadings

_WIDE = 3.0
"""Tolerances: the prior of everything; a machine this far off is one to be measured."""

_BEYOND = 5.0
"""Standard deviations from which a reading is asked for again: one in a million by chance."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What the readings of a sheet are likely to be."""

    sheet: Readings  # the readings to take
    linear: LinearReadings  # by everything in the catalogue, in tolerances
    nominal: Array  # of the machine as it is believed to be (n,), metres
    covariance: Array  # of all readings (n, n), square metres

    @classmethod
    def of(cls, sheet: Readings, machine: Machine) -> Self:
        """Readings of a machine within some tolerances of what its file says."""
        linear = LinearReadings.of(machine, sheet, shown_names(machine, sheet, ()))
        noise = np.diag(machine.spec.dial.resolution**2 * np.ones(len(sheet)))
        spread = _WIDE**2 * linear.columns @ linear.columns.T + linear.scatter() + noise
        return cls(sheet, linear, machine.readings(sheet), np.asarray(spread))

    def doubt(self, row: int, reading: float, taken: Mapping[int, float]) -> str:
        """Return what speaks against a reading, a clause; empty where nothing does.

        Args:
            row: of the sheet.
            reading: metres.
            taken: readings so far by row, metres.
        """
        own = [k for k in taken if self.sheet.setup[k] == self.sheet.setup[row]]
        if not own:
            return ""
        done = np.array(list(taken))
        across = self.covariance[row, done]
        weights = np.linalg.solve(self.covariance[np.ix_(done, done)], across)
        mean = self.nominal[row] + weights @ (np.array([*taken.values()]) - self.nominal[done])
        sd = float(np.sqrt(self.covariance[row, row] - weights @ across))
        if abs(reading - mean) <= _BEYOND * sd:
            return ""
        station = self.linear.station
        if before := [taken[k] for k in own if station[k] == station[row]]:
            listed = ", ".join(f"{value * 1e3:.3f}" for value in before)
            return f"it is out of step with its repeats: this dial showed {listed} here before"
        low, high = ((mean + side * _BEYOND * sd) * 1e3 for side in (-1, 1))
        return (
            f"after the readings before it, and with the tolerances of this machine, it should lie "
            f"between {low:.2f} and {high:.2f}"
        )

    def impossible(self, row: int, reading: float, taken: Mapping[int, float]) -> str:
        """Return why a reading cannot be, a clause; empty where it can."""
        rows = self.sheet.setup == self.sheet.setup[row]
        along = self.sheet.command[rows, self.sheet.setups[self.sheet.setup[row]].axis]
        span = float(np.ptp([reading, *(value for k, value in taken.items() if rows[k])]))
        if span <= DIAL_RANGE + np.ptp(along):
            return ""
        return f"the dial would have moved {span * 1e3:.1f} mm in this mounting, which no leg does"
