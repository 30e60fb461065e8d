"""The papers' linear calibration: deviations, system (11), its reductions, and its accuracy.

A row ``x_y+`` is the deviation along x of leg y at its Max posture against Zero; ``-`` is Min, and
no sign the difference Max - Min.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.reduction.kinematics import NOMINAL

COLUMNS: tuple[str, ...] = tuple(f"{kind}.{leg}" for kind in ("offset", "length") for leg in LEGS)
"""Names of the six parameters, in the order of every vector of six here."""

G: Array = np.array([[2.0, 0, 1, 0], [0, 2.0, 0, 1], [1, 0, 2.0, 0], [0, 1, 0, 2.0]])
"""Eq. (14): covariance of four deviations that share two Zero readings, in units of sigma^2."""
G.flags.writeable = False

_BLOCKS = ((0, 1), (1, 2), (0, 2))  # pairs of axes, as (11) stacks them: xy, yz, xz


@dataclass(frozen=True)
class LinearSystem:
    """Deviations = matrix @ parameters."""

    matrix: Array  # (rows, columns), dimensionless
    rows: tuple[str, ...]  # names of the deviations
    columns: tuple[str, ...]  # names of the parameters
    noise: Array  # covariance of the deviations for readings of unit variance (rows, rows)

    def select(self, free: str | Sequence[str]) -> LinearSystem:
        """Return the system of some of the parameters.

        Args:
            free: ``"offsets"``, ``"lengths"``, ``"all"``, or names of columns.

        Raises:
            InputError: for a name that is no column.
        """
        selected: list[str] = []
        for name in [free] if isinstance(free, str) else free:
            matching = [c for c in self.columns if name in (c, f"{c[:-2]}s", "all")]
            if not matching:
                raise InputError(f"no such parameter: {name}; there are {', '.join(self.columns)}")
            selected += matching
        places = [self.columns.index(name) for name in selected]
        return replace(self, matrix=self.matrix[:, places], columns=tuple(selected))

    def ordered(self, deviations: dict[str, float]) -> Array:
        """Return deviations by row name as a vector in the system's order.

        Raises:
            InputError: where a row is missing.
        """
        missing = [row for row in self.rows if row not in deviations]
        if missing:
            raise InputError(f"deviations are missing for the rows {', '.join(missing)}")
        return np.array([deviations[row] for row in self.rows], dtype=float)


@dataclass(frozen=True)
class LinearFit:
    """Least squares on a linear system."""

    values: Array  # parameters (columns,), in the unit of the deviations
    fitted: Array  # J x (rows,): the papers' "expected improvement" of Table 2
    residuals: Array  # deviations minus fitted (rows,)
    rms: float  # root mean square of the residuals


def stroke_angles(geometry: Geometry = NOMINAL) -> tuple[float, float]:
    """``alpha = arcsin(travel / L)`` at Max and Min, radians (2008, section 2.4)."""
    low, high = geometry.stroke
    return float(np.arcsin(high / geometry.L)), float(np.arcsin(low / geometry.L))


def coefficients(angle: ArrayLike) -> tuple[Array, Array, Array]:
    """``a = sin``, ``b = (1/2 + sin) tan``, ``c = (1/2 + sin) / cos - 1/2`` (2008, (11)).

    Args:
        angle: alpha ``(...)``, radians; negative at Min.

    Returns:
        a, b, c, each ``(...)``, dimensionless, for gauges at the middle of the leg at Zero.
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    return sine, (0.5 + sine) * sine / cosine, (0.5 + sine) / cosine - 0.5


def system11(
    geometry: Geometry = NOMINAL, *, angles: tuple[float, float] | None = None
) -> LinearSystem:
    """System (11) of 2008: twelve deviations, six parameters, in the printed order of rows.

    Leg i deviates along j by ``b (offset_i - length_i) + a offset_j - c length_j`` (section 3.2).

    Args:
        geometry: nominal dimensions; the stroke gives the angles.
        angles: alpha at Max and at Min, radians, in place of the stroke's.

    Returns:
        The 12 x 6 system with the noise of eq. (14), gauges at the middle of the legs.
    """
    matrix, rows = [], []
    for pair in _BLOCKS:
        for angle, sign in zip(angles or stroke_angles(geometry), "+-", strict=True):
            a, b, c = coefficients(angle)
            for j, i in (pair, pair[::-1]):
                row = np.zeros(6)
                row[[i, 3 + i, j, 3 + j]] = b, -b, a, -c
                matrix.append(row)
                rows.append(f"{LEGS[j]}_{LEGS[i]}{sign}")
    noise = np.asarray(np.kron(np.eye(3), G), dtype=np.float64)
    return LinearSystem(np.array(matrix), tuple(rows), COLUMNS, noise)


def reduced_system(geometry: Geometry = NOMINAL) -> LinearSystem:
    """Return the differences Max - Min of system (11) (2006, end of 3.2; 2008, Table 1).

    The rows' noise is 2 sigma^2 each, independent.
    """
    full = system11(geometry)
    difference = np.kron(np.eye(3), np.array([[1.0, 0, -1, 0], [0, 1.0, 0, -1]]))
    rows = tuple(row[:-1] for row in full.rows if row.endswith("+"))
    noise = difference @ full.noise @ difference.T
    return LinearSystem(difference @ full.matrix, rows, COLUMNS, np.asarray(noise))


def system8(geometry: Geometry = NOMINAL) -> LinearSystem:
    """Return system (8) of 2006, corrected: the offset columns of :func:`system11`, 12 x 3."""
    return system11(geometry).select("offsets")


def covariance(system: LinearSystem, sigma: float) -> Array:
    """``V = J^+ E(ds ds^T) J^+^T``: covariance of the pseudoinverse's estimate (2008, (12), (14)).

    Args:
        system: the linear system, with the noise of its rows.
        sigma: standard deviation of one reading.

    Returns:
        ``(columns, columns)``, in the square of sigma's unit.
    """
    pseudoinverse = np.linalg.pinv(system.matrix)
    return np.asarray(sigma**2 * (pseudoinverse @ system.noise @ pseudoinverse.T))


def solve(system: LinearSystem, measured: ArrayLike) -> LinearFit:
    """Moore-Penrose pseudoinverse of a linear system, as in 2008, section 3.2.

    Args:
        system: the linear system.
        measured: deviations ``(rows,)`` in the system's order (``system.ordered`` sorts a dict).

    Returns:
        The fit, in the unit of the deviations.

    Raises:
        InputError: where the number of deviations is not that of the rows.
    """
    data = np.asarray(measured, dtype=float)
    if data.shape != (len(system.rows),):
        raise InputError(
            f"the system has {len(system.rows)} rows, but {data.shape} deviations came"
        )
    values = np.linalg.lstsq(system.matrix, data, rcond=1e-12)[0]
    fitted = system.matrix @ values
    residuals = data - fitted
    rms = float(np.sqrt(np.mean(residuals**2)))
    return LinearFit(values, fitted, residuals, rms)
