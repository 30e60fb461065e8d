"""Inverse and direct kinematics of the reduction, and its Jacobians (2008, section 2.4).

The carriage of leg i stands at ``R_i = rho_i + offset_i`` on base axis i and holds a bar of length
``L_i = L + length_i`` to the TCP: ``(p_i - R_i)^2 + p_j^2 + p_k^2 = L_i^2``, eq. (2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError, NumericsError, check_choice
from orthoglide.geometry import Array, Geometry, Mode
from orthoglide.reduction.spheres import DEGENERATE, TOUCH_TOLERANCE, unreachable_error

NOMINAL = Geometry()
"""The prototype's dimensions, the default of every function here."""

_BLOCK = 4096  # poses a pass, so that some twenty rows of doubles fit in the cache


class Jacobians(NamedTuple):
    """Eq. (5): how the TCP moves with the parameters."""

    rho: Array  # dp/drho and dp/doffset (..., 3, 3), dimensionless
    lengths: Array  # dp/dL (..., 3, 3), dimensionless


def vectors(value: ArrayLike, name: str) -> Array:
    """Return ``value`` as floats ``(..., 3)``; a scalar stands for three equal ones."""
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return np.full(3, float(array))
    if array.shape[-1] != 3:
        raise InputError(f"{name} has the shape (..., 3), x, y, z last, not {array.shape}")
    return array


def inverse(
    p: ArrayLike,
    offsets: ArrayLike = 0.0,
    lengths: ArrayLike = 0.0,
    *,
    signs: ArrayLike = (1, 1, 1),
    geometry: Geometry = NOMINAL,
) -> Array:
    """``rho_i = p_i + s_i sqrt(L_i^2 - p_j^2 - p_k^2) - offset_i`` (2008, eq. (3)).

    Args:
        p: TCP ``(..., 3)``, metres.
        offsets: joint offsets ``(..., 3)``, metres.
        lengths: leg lengths minus L ``(..., 3)``, metres.
        signs: configuration, +1 or -1 a leg, ``(..., 3)``; the machine's is (1, 1, 1).
        geometry: nominal dimensions.

    Returns:
        Commands rho ``(..., 3)``, metres.

    Raises:
        UnreachableError: where the TCP is further from a leg's axis than the leg is long.
    """
    tcp, bars = vectors(p, "p"), geometry.L + vectors(lengths, "lengths")
    squares = tcp * tcp
    across = squares[..., [1, 2, 0]] + squares[..., [2, 0, 1]]
    reach = bars * bars - across
    if not np.isfinite(reach).all():
        raise InputError("the poses and lengths are not finite: give numbers in metres")
    if (missed := np.asarray(reach.min(axis=-1) < 0)).any():
        raise unreachable_error(missed)
    own_axis = np.sqrt(reach)
    if np.any(np.abs(configuration := vectors(signs, "signs")) != 1):
        raise InputError("signs are +1 or -1, one a leg")
    return np.asarray(tcp + configuration * own_axis - vectors(offsets, "offsets"))


def forward(
    rho: ArrayLike,
    offsets: ArrayLike = 0.0,
    lengths: ArrayLike = 0.0,
    *,
    mode: Mode = "machine",
    geometry: Geometry = NOMINAL,
) -> Array:
    """Return the TCP of a command, by ``A t^2 + B t + C = 0`` in t = |p|^2 / 2 (2008, (4)).

    ``p_i = (k_i + t) / R_i`` with ``k_i = (R_i^2 - L_i^2) / 2``. The machine's assembly mode is the
    *minus* root, the intersection nearer the origin; it is taken as C over the larger root's
    numerator, since -B + sqrt(B^2 - 4AC) never cancels (t cannot be negative, so neither can -B).

    Args:
        rho: commands ``(..., 3)``, metres.
        offsets: joint offsets ``(..., 3)``, metres.
        lengths: leg lengths minus L ``(..., 3)``, metres.
        mode: assembly mode, ``"machine"`` or ``"other"``.
        geometry: nominal dimensions.

    Returns:
        TCP ``(..., 3)``, metres.

    Raises:
        UnreachableError: where the legs do not meet.
        InputError: for a carriage at the origin (``intersect_spheres`` can do that), or for
            values that are not finite.
    """
    check_choice("assembly mode", mode, ("machine", "other"))
    arrays = vectors(rho, "rho"), vectors(offsets, "offsets"), vectors(lengths, "lengths")
    shape = np.broadcast_shapes(*(array.shape for array in arrays))
    p = np.empty(shape).reshape(-1, 3)
    # A single vector stays one; others are rows.
    rows = [a if a.ndim == 1 else np.broadcast_to(a, shape).reshape(-1, 3) for a in arrays]
    by_axis = [np.broadcast_to(array, p.shape).T for array in rows]
    for start in range(0, len(p), _BLOCK):
        block = slice(start, start + _BLOCK)
        commands, shifts, changes = (array[:, block] for array in by_axis)
        carriage = np.add(commands, shifts, order="C")
        p[block] = _intersection(carriage, geometry.L + changes, mode).T
    if np.isnan(p).any():
        carriages = arrays[0] + arrays[1]
        if not np.isfinite(carriages + arrays[2]).all():
            raise InputError("the commands and lengths are not finite: give numbers in metres")
        if (carriages == 0).any():
            raise InputError(
                "a carriage stands at the origin, where the quadratic has no coefficients: use "
                "intersect_spheres"
            )
        raise unreachable_error(np.isnan(p[:, 0]).reshape(shape[:-1]))
    return p.reshape(shape)


def _intersection(carriage: Array, bars: Array, mode: Mode) -> Array:
    """Return the TCP ``(3, n)`` for carriages and bar lengths ``(3, n)``; nan where the legs do not
    meet. Rows are axes, for contiguity.
    """
    with np.errstate(all="ignore"):
        inverse_r = 1.0 / carriage
        share = (carriage - bars) * (carriage + bars) * inverse_r / 2  # k / R, without cancellation
        half_b = 1.0 - np.einsum("ij,ij->j", share, inverse_r)
        constant = np.einsum("ij,ij->j", share, share)
        leading = np.einsum("ij,ij->j", inverse_r, inverse_r)
        square = half_b * half_b
        root = square - leading * constant
        root[np.abs(root) <= TOUCH_TOLERANCE * square] = 0.0
        root = half_b + np.sqrt(root)
        t = constant / root if mode == "machine" else root / leading
        return np.asarray(share + t * inverse_r)


def jacobians(
    p: ArrayLike,
    rho: ArrayLike,
    offsets: ArrayLike = 0.0,
    lengths: ArrayLike = 0.0,
    *,
    geometry: Geometry = NOMINAL,
) -> Jacobians:
    """``M dp/drho = diag(p_i - R_i)`` and ``M dp/dL = diag(L_i)``, M = 1 p^T - diag(R) (2008, (5)).

    Takes the TCP ``(..., 3)`` of the command; the other arguments are as for :func:`forward`.

    Returns:
        J_rho and J_L, ``(..., 3, 3)`` each.

    Raises:
        NumericsError: at a singular posture, where the TCP lies in the plane of the carriages.
    """
    tcp, bars = vectors(p, "p"), geometry.L + vectors(lengths, "lengths")
    carriage = vectors(rho, "rho") + vectors(offsets, "offsets")
    inverse_r = 1.0 / carriage
    scaled = tcp * inverse_r
    distance = 1.0 - scaled.sum(axis=-1)  # of the TCP from the plane of the carriages
    if np.any(np.abs(distance) < DEGENERATE):
        raise NumericsError(
            "the TCP lies in the plane of the carriages: stay off singular postures"
        )
    # The inverse of M is a matrix of rank one less 1 / R on its diagonal.
    inverse = inverse_r[..., :, None] * (scaled / -distance[..., None])[..., None, :]
    np.einsum("...ii->...i", inverse)[...] -= inverse_r
    return Jacobians(inverse * (tcp - carriage)[..., None, :], inverse * bars[..., None, :])
