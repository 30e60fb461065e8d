"""Observability indices of a campaign: how well its readings see what is asked for.

With the singular values ``s_1 >= ... >= s_m`` of the identification Jacobian of ``n`` readings
(Y. Sun and J. M. Hollerbach, "Observability index selection for robot calibration", ICRA 2008):

    O1 = (s_1 ... s_m)^(1/m) / sqrt(n)      O2 = s_m / s_1      O3 = s_m
    O4 = s_m^2 / s_1                        O5 = 1 / (1/s_1 + ... + 1/s_m)

O1 is D-, O3 E- and O5 close to A-optimality. Unknowns are in tolerances and readings in sigmas,
datums and the dials' places taken out, so that the figures compare between campaigns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.planning.linear import LinearReadings

_NOTHING = 1e-9  # of the largest singular value: rounding


@dataclass(frozen=True)
class Observability:
    """Indices of one campaign for some unknowns."""

    readings: int  # how many
    # singular values (m,), largest first, sigmas a tolerance; 0 where a combination of the unknowns
    # is not seen at all
    singular: tuple[float, ...]

    @property
    def unknowns(self) -> int:
        """How many."""
        return len(self.singular)

    @property
    def rank(self) -> int:
        """Unknowns that the readings see at all, in combinations."""
        return int(np.count_nonzero(self.singular))

    @property
    def indices(self) -> dict[str, float]:
        """All five by name; 0 where a combination of unknowns is not seen."""
        s = np.array(self.singular)
        if self.rank < self.unknowns:
            return dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), 0.0)
        o1 = np.exp(np.mean(np.log(s))) / np.sqrt(self.readings)
        found = (o1, s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1 / np.sum(1 / s))
        return {f"O{k}": float(value) for k, value in enumerate(found, start=1)}


def of_jacobian(jacobian: Array, readings: int) -> Observability:
    """Observability indices of a Jacobian.

    Args:
        jacobian: ``(rows, m)``.
        readings: how many there are.
    """
    singular = np.zeros(jacobian.shape[1])
    values = np.linalg.svd(jacobian, compute_uv=False)
    singular[: len(values)] = values
    singular[singular < _NOTHING * singular.max(initial=0.0)] = 0.0
    return Observability(readings, tuple(singular.tolist()))


def observability(
    machine: Machine, campaign: Readings, free: Sequence[str], noise: float | None = None
) -> Observability:
    """Observability indices of a campaign or protocol.

    Args:
        machine: tolerances, dial, and where to linearise.
        campaign: with or without readings.
        free: effects, parameters or structured members to identify.
        noise: standard deviation of one reading, metres; as the machine's dial has it if absent.
    """
    names = machine.catalogue.expand(free, [s.name for s in campaign.setups])
    readings = LinearReadings.of(machine, campaign, names, noise)
    return of_jacobian(readings.whitened(), len(campaign))
