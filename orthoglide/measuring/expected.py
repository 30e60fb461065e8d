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
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import Readings
from orthoglide.observations.checks import DIAL_RANGE
from orthoglide.planning.designs import observable_names
from orthoglide.planning.linear import LinearReadings

_PRIOR_TOLERANCES = 3.0
"""Tolerances: the prior of everything; a machine this far off is one to be measured."""

_IMPLAUSIBLE_SIGMAS = 5.0
"""Standard deviations from which a reading is asked for again: one in a million by chance."""


@dataclass(frozen=True, eq=False)
class ExpectedReadings:
    """What the readings of a sheet are likely to be."""

    sheet: Readings  # the readings to take
    station: NDArray[np.intp]  # of each reading (n,)
    mean: Array  # of the machine as it is believed to be (n,), metres
    covariance: Array  # of all readings (n, n), square metres

    @classmethod
    def of(cls, sheet: Readings, machine: Machine) -> Self:
        """Return the readings of a machine within some tolerances of what its file states."""
        linear = LinearReadings.of(machine, sheet, observable_names(machine, sheet, ()))
        prior = _PRIOR_TOLERANCES**2 * linear.columns @ linear.columns.T
        rows = np.arange(len(sheet))
        in_mounting = np.equal.outer(sheet.setup, sheet.setup) * linear.covariance(rows, rows)
        noise = np.diag(linear.sigma**2 + machine.spec.dial.resolution**2)
        covariance = np.asarray(prior + in_mounting + noise)
        return cls(sheet, linear.station, machine.readings(sheet), covariance)

    def objection(self, row: int, reading: float, taken: Mapping[int, float]) -> tuple[str, bool]:
        """Return what speaks against a reading and whether it is possible all the same.

        Args:
            row: of the sheet.
            reading: metres.
            taken: readings so far by row, metres.

        Returns:
            A clause, empty where nothing speaks against it.
        """
        mounting = self.sheet.setup == self.sheet.setup[row]
        in_mounting = {k: value for k, value in taken.items() if mounting[k]}
        if not in_mounting:
            return "", True
        axis = self.sheet.setups[self.sheet.setup[row]].axis
        span = float(np.ptp([reading, *in_mounting.values()]))
        if span > DIAL_RANGE + np.ptp(self.sheet.command[mounting, axis]):
            clause = f"the dial would have moved {span * 1e3:.1f} mm in this mounting"
            return f"{clause}, which no leg does", False
        done = np.array(list(taken))
        across = self.covariance[row, done]
        weights = np.linalg.solve(self.covariance[np.ix_(done, done)], across)
        mean = self.mean[row] + weights @ (np.array([*taken.values()]) - self.mean[done])
        sd = float(np.sqrt(self.covariance[row, row] - weights @ across))
        if abs(reading - mean) <= _IMPLAUSIBLE_SIGMAS * sd:
            return "", True
        station = self.station[row]
        if repeats := [value for k, value in in_mounting.items() if self.station[k] == station]:
            listed = ", ".join(plain(value * 1e3, 3) for value in repeats)
            reason = f"it is out of step with its repeats: this dial showed {listed} here before"
            return reason, True
        low, high = ((mean + sign * _IMPLAUSIBLE_SIGMAS * sd) * 1e3 for sign in (-1, 1))
        return (
            f"after the readings before it, and with the tolerances of this machine, it should lie "
            f"between {plain(low, 2)} and {plain(high, 2)}"
        ), True
