"""Dial readings of the reduction, of any leg at any command, with derivatives.

Leg i is the line from the TCP p to its carriage at ``R_i`` on base axis i, so a dial at own-axis
coordinate g reads ``y = p_j (R_i - g) / (R_i - p_i)`` along direction j (2008, section 3.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.reduction.kinematics import NOMINAL, intersect_legs, row_inverse, vectors

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Dials:
    """Commands, legs, directions and places of N readings."""

    commands: Array  # (N, 3), metres
    legs: Indices  # (N,), 0, 1 or 2
    axes: Indices  # (N,), the base axis each dial reads along
    gauges: Array  # (N,), place along the leg's own axis, metres

    @classmethod
    def checked(
        cls, commands: ArrayLike, legs: ArrayLike, axes: ArrayLike, gauges: ArrayLike
    ) -> Dials:
        """Return the dials of four columns, broadcast and checked.

        Raises:
            InputError: for incompatible shapes, or an impossible leg or axis.
        """
        rho = np.atleast_2d(vectors(commands, "commands"))
        try:
            columns = [np.broadcast_to(np.asarray(x), rho.shape[:1]) for x in (legs, axes, gauges)]
        except ValueError:
            raise InputError("legs, axes and gauges need one value for every command") from None
        dial_legs, dial_axes = (np.asarray(x, dtype=np.intp) for x in columns[:2])
        if np.any(
            (dial_legs < 0)
            | (dial_legs > 2)
            | (dial_axes < 0)
            | (dial_axes > 2)
            | (dial_legs == dial_axes)
        ):
            raise InputError("legs and axes are 0, 1 or 2, and a dial reads across its leg")
        return cls(rho, dial_legs, dial_axes, np.asarray(columns[2], dtype=float))


@dataclass(frozen=True)
class PredictedReadings:
    """Readings of one machine, with intermediate values of their derivatives."""

    values: Array  # (N,), metres
    gradient: Array  # by offsets and lengths (N, 6), dimensionless
    _inverse: Array
    _tcp: Array
    _state: tuple[Indices, Indices, Array, Array, Array, Array]

    def curvature(self, weights: Array) -> Array:
        """Return weighted second derivatives ``w_n d2y_n`` by offsets and lengths, ``(N, 6, 6)``.

        From eq. (2) twice differentiated: ``(p - c_i) . p_ab = [a = b = L_i] - n_ia . n_ib`` with
        ``n_ia`` the derivative of ``p - c_i``.
        """
        i, j, reach, ahead, across, by_tcp = self._state
        rows = np.arange(len(i))
        inner = np.stack([self._tcp[rows, i], self._tcp[rows, j], np.eye(3, 6)[i]], axis=1)
        hessian = np.empty((len(i), 3, 3))
        hessian[:, 0, 0] = 2 * across * ahead / reach**3
        hessian[:, 1, 1] = 0.0
        hessian[:, 2, 2] = -2 * across * (reach - ahead) / reach**3
        hessian[:, 0, 1] = hessian[:, 1, 0] = ahead / reach**2
        hessian[:, 1, 2] = hessian[:, 2, 1] = (reach - ahead) / reach**2
        hessian[:, 0, 2] = hessian[:, 2, 0] = across * (reach - 2 * ahead) / reach**3
        total = inner.transpose(0, 2, 1) @ (hessian * weights[:, None, None]) @ inner
        weighted_gradient = (self._inverse.transpose(0, 2, 1) @ by_tcp[:, :, None])[
            :, :, 0
        ] * weights[:, None]
        second_order = self._tcp.transpose(0, 2, 1) @ self._tcp
        total -= weighted_gradient.sum(axis=1)[:, None, None] * second_order
        mixed = weighted_gradient[:, :, None] * self._tcp
        total[:, :3, :] += mixed
        total[:, :, :3] += mixed.transpose(0, 2, 1)
        diagonal = np.einsum("nii->ni", total)
        diagonal += np.concatenate([-weighted_gradient, weighted_gradient], axis=1)
        return np.asarray(total)


def predicted(dials: Dials, six: Array, length: float) -> PredictedReadings:
    """Return readings and gradient of a machine.

    Args:
        dials: of the readings.
        six: three joint offsets and three leg lengths minus L, ``(6,)`` or ``(N, 6)``, metres.
        length: nominal length L of the bars, metres.
    """
    carriage = dials.commands + six[..., :3]
    bars = np.broadcast_to(length + six[..., 3:], carriage.shape)
    p = intersect_legs(carriage, np.zeros(3), bars)
    inverse = row_inverse(p, carriage)
    tcp = np.concatenate([inverse * (p - carriage)[:, None, :], inverse * bars[:, None, :]], axis=2)
    rows, i, j = np.arange(len(p)), dials.legs, dials.axes
    reach = carriage[rows, i] - p[rows, i]
    ahead = carriage[rows, i] - dials.gauges
    across = p[rows, j]
    values = across * ahead / reach
    by_tcp = np.zeros_like(p)
    by_tcp[rows, i] = values / reach
    by_tcp[rows, j] = ahead / reach
    gradient = (by_tcp[:, None, :] @ tcp)[:, 0, :]
    gradient[rows, i] += (across - values) / reach
    return PredictedReadings(values, gradient, inverse, tcp, (i, j, reach, ahead, across, by_tcp))


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

    Returns:
        Readings ``(N,)``, metres, datum zero, with their derivatives.

    Raises:
        UnreachableError: where the legs do not meet.
        InputError: for columns that do not fit together.
    """
    parameters = np.broadcast_arrays(vectors(offsets, "offsets"), vectors(lengths, "lengths"))
    dials = Dials.checked(commands, legs, axes, gauges)
    return predicted(dials, np.concatenate(parameters, axis=-1), geometry.L)
