"""Dial readings of the reduction, of any leg at any command, with derivatives.

Leg i is the line from the TCP p to its carriage at ``R_i`` on base axis i, so a dial at own-axis
coordinate g reads ``y = p_j (R_i - g) / (R_i - p_i)`` along direction j (2008, section 3.2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.reduction.kinematics import NOMINAL, forward, jacobians, vectors


class PredictedReadings(NamedTuple):
    """Readings of one machine, datum zero, with their derivatives."""

    values: Array  # (N,), metres
    gradient: Array  # by offsets and lengths (N, 6), dimensionless


def predict_readings(
    commands: ArrayLike,
    legs: ArrayLike,
    axes: ArrayLike,
    gauges: ArrayLike,
    offsets: ArrayLike = 0.0,
    lengths: ArrayLike = 0.0,
    *,
    geometry: Geometry = NOMINAL,
) -> PredictedReadings:
    """Return the readings ``y = p_j (R_i - g) / (R_i - p_i)`` of dials (2008, section 3.2).

    The gradient generalises system (11) to any list of readings: at the nominal machine the rows of
    (11) are differences of its rows at two postures.

    Args:
        commands: ``(N, 3)``, metres.
        legs: legs touched ``(N,)``: 0, 1 or 2.
        axes: base axes the dials read along ``(N,)``.
        gauges: places along the legs' own axes ``(N,)``, metres.
        offsets: joint offsets ``(3,)`` or ``(N, 3)``, metres.
        lengths: leg lengths minus L ``(3,)`` or ``(N, 3)``, metres.
        geometry: nominal dimensions.

    Raises:
        UnreachableError: where the legs do not meet.
        InputError: for columns that do not fit together.
    """
    rho = np.atleast_2d(vectors(commands, "commands"))
    try:
        i, j, gauge = (np.broadcast_to(column, rho.shape[:1]) for column in (legs, axes, gauges))
    except ValueError:
        raise InputError("legs, axes and gauges need one value for every command") from None
    if ((i < 0) | (i > 2) | (j < 0) | (j > 2) | (i == j)).any():
        raise InputError("legs and axes are 0, 1 or 2, and a dial reads across its leg")
    p, rows = forward(rho, offsets, lengths, geometry=geometry), np.arange(len(rho))
    tcp = np.concatenate(jacobians(p, rho, offsets, lengths, geometry=geometry), axis=-1)
    carriage = (rho + vectors(offsets, "offsets"))[rows, i]
    reach, ahead, across = carriage - p[rows, i], carriage - gauge, p[rows, j]
    values = across * ahead / reach
    by_tcp = np.zeros_like(p)
    by_tcp[rows, i] = values / reach
    by_tcp[rows, j] = ahead / reach
    gradient = (by_tcp[:, None, :] @ tcp)[:, 0, :]
    gradient[rows, i] += (across - values) / reach
    return PredictedReadings(values, gradient)
