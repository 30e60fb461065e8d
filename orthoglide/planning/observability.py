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

from orthoglide.fit import Noise
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.planning.expected import expected

_NOTHING = 1e-9  # of the largest singular value: rounding


@dataclass(frozen=True)
class Observability:
    """Indices of one campaign for some unknowns.

    Attributes:
        readings: how many.
        unknowns: how many.
        rank: unknowns that the readings see at all, in combinations.
        singular: singular values ``(m,)``, largest first, sigmas a tolerance.
        o1: geometric mean of the singular values, over the root of the readings.
        o2: inverse condition number.
        o3: least singular value.
        o4: noise amplification index.
        o5: harmonic.
    """

    readings: int
    unknowns: int
    rank: int
    singular: tuple[float, ...]
    o1: float
    o2: float
    o3: float
    o4: float
    o5: float

    @property
    def indices(self) -> dict[str, float]:
        """All five by name."""
        return {f"O{k}": getattr(self, f"o{k}") for k in range(1, 6)}


def indices(jacobian: Array, readings: int) -> Observability:
    """Observability indices of a Jacobian.

    Args:
        jacobian: ``(rows, m)``.
        readings: how many there are.
    """
    m = jacobian.shape[1]
    singular = np.zeros(m)
    values = np.linalg.svd(jacobian, compute_uv=False)
    singular[: len(values)] = values
    singular[singular < _NOTHING * singular.max(initial=0.0)] = 0.0
    largest, least = float(singular[0]), float(singular[-1])
    seen = least > 0
    return Observability(
        readings,
        m,
        int(np.sum(singular > 0)),
        tuple(singular.tolist()),
        float(np.exp(np.mean(np.log(singular))) / np.sqrt(readings)) if seen else 0.0,
        least / largest if seen else 0.0,
        least,
        least**2 / largest if seen else 0.0,
        float(1 / np.sum(1 / singular)) if seen else 0.0,
    )


def observability(
    machine: Machine, campaign: Campaign, families: Sequence[str], noise: Noise | None = None
) -> Observability:
    """Observability indices of a campaign or protocol.

    Args:
        machine: tolerances, dial, and where to linearise.
        campaign: with or without readings.
        families: families, parameters or structured members to identify.
        noise: of the readings; as the machine's dial has it where absent.
    """
    return indices(expected(machine, campaign, families, noise).jacobian, len(campaign))
