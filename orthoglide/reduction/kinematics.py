"""Inverse and direct kinematics of the reduction, and its Jacobians (2008, section 2.4).

The carriage of leg i stands at ``R_i = rho_i + offset_i`` on base axis i and holds a bar of length
``L_i = L + length_i`` to the TCP: ``(p_i - R_i)^2 + p_j^2 + p_k^2 = L_i^2``, eq. (2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError, NumericsError, UnreachableError, check_choice
from orthoglide.geometry import LEGS, Array, Geometry, Mode
from orthoglide.reduction.spheres import (
    DEGENERATE,
    TOUCH_TOLERANCE,
    batch_position,
    unreachable_error,
)

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
    if not np.all(reach >= 0):
        raise out_of_reach(np.sqrt(across) - bars)
    own_axis = np.sqrt(reach)
    if np.any(np.abs(configuration := vectors(signs, "signs")) != 1):
        raise InputError("signs are +1 or -1, one a leg")
    return np.asarray(tcp + configuration * own_axis - vectors(offsets, "offsets"))


def out_of_reach(excess: Array) -> Exception:
    """Return the error of poses out of reach by ``excess`` ``(..., 3)``, metres, if positive."""
    failed = ~(excess <= 0).all(axis=-1)
    index = tuple(int(i) for i in np.argwhere(failed)[0])
    leg = int(np.argmax(excess[index]))
    amount = float(excess[index][leg])
    place = batch_position(index, int(failed.sum()))
    if not np.isfinite(excess[index]).all():
        return InputError(f"the pose{place} is not finite: give numbers in metres")
    return UnreachableError(
        f"the pose{place} is out of reach of leg {LEGS[leg]} by {amount * 1e3:.4g} mm; "
        "bring the TCP nearer to that leg's axis",
        leg=LEGS[leg],
        excess=amount,
        index=index,
    )


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
    commands, shifts = vectors(rho, "rho"), vectors(offsets, "offsets")
    return intersect_legs(commands, shifts, geometry.L + vectors(lengths, "lengths"), mode)


def intersect_legs(rho: Array, offsets: Array, bars: Array, mode: Mode = "machine") -> Array:
    """Return the TCP as :func:`forward`, from arrays ``(..., 3)`` with full bar lengths."""
    check_choice("assembly mode", mode, ("machine", "other"))
    shape = np.broadcast_shapes(rho.shape, offsets.shape, bars.shape)
    flat = [_rows(array, shape) for array in (rho, offsets, bars)]
    count = int(np.prod(shape[:-1], dtype=int))
    p = np.empty((count, 3))
    missed: list[int] = []
    for start in range(0, count, _BLOCK):
        block = slice(start, min(start + _BLOCK, count))
        a, b, c = (array.T if len(array) == 1 else array[block].T for array in flat)
        missed += [start + k for k in _solve_block(a, b, c, mode, p[block].T)]
    if missed:
        carriages, lengths = (np.broadcast_to(x, p.shape) for x in (flat[0] + flat[1], flat[2]))
        index = tuple(int(i) for i in np.unravel_index(missed[0], shape[:-1] or (1,)))
        place = index if shape[:-1] else ()
        raise _unreachable_error(carriages[missed[0]], lengths[missed[0]], place, len(missed))
    return p.reshape(shape)


def _rows(array: Array, shape: tuple[int, ...]) -> Array:
    """Return an array as ``(1, 3)`` where it is a single vector, else as ``(N, 3)``."""
    if array.size == 3:
        return array.reshape(1, 3)
    return np.broadcast_to(array, shape).reshape(-1, 3)


def _solve_block(rho: Array, offsets: Array, bars: Array, mode: Mode, p: Array) -> list[int]:
    """Fill p ``(3, n)`` and return the poses that do not meet. Rows are axes, for contiguity."""
    carriage = np.add(rho, offsets, order="C")
    with np.errstate(all="ignore"):
        inverse_r = np.divide(0.5, carriage)  # 1 / (2 R)
        share = np.subtract(carriage, bars, order="C")
        share *= carriage + bars  # 2 k, without cancellation near zero
        share *= inverse_r  # k / R
        inverse_r += inverse_r
        half_b = 1.0 - np.einsum("ij,ij->j", share, inverse_r)
        constant = np.einsum("ij,ij->j", share, share)
        leading = np.einsum("ij,ij->j", inverse_r, inverse_r)
        square = half_b * half_b
        root = square - leading * constant
        if not root.min(initial=0.0) >= 0:
            missed = np.flatnonzero(~(root >= -TOUCH_TOLERANCE * square))
            if missed.size:
                return missed.tolist()
            np.maximum(root, 0.0, out=root)
        np.sqrt(root, out=root)
        root += half_b
        t = np.divide(constant, root) if mode == "machine" else np.divide(root, leading)
    inverse_r *= t
    np.add(share, inverse_r, out=p)
    return []


def _unreachable_error(
    carriage: Array, bars: Array, index: tuple[int, ...], total: int
) -> InputError:
    """Return the error of the first pose that fails, one of ``total``."""
    place = batch_position(index, total)
    if not np.isfinite(carriage + bars).all():
        return InputError(f"the command{place} is not finite: give numbers in metres")
    if np.any(carriage == 0):
        leg = LEGS[int(np.argmax(carriage == 0))]
        return InputError(
            f"carriage {leg} stands at the origin{place}, where the quadratic has no "
            "coefficients: use intersect_spheres"
        )
    return unreachable_error(np.diag(carriage), bars, index, total)


def row_inverse(p: Array, carriage: Array) -> Array:
    """Return the inverse ``(..., 3, 3)`` of the matrix ``1 p^T - diag(R)`` of section 2.4.

    ``1 - sum p_i / R_i`` is a distance of the TCP from the plane of the carriages.
    """
    u = 1.0 / carriage
    scaled = p * u
    distance = 1.0 - scaled.sum(axis=-1)
    if np.any(np.abs(distance) < DEGENERATE):
        raise NumericsError(
            "the TCP lies in the plane of the carriages: stay off singular postures"
        )
    matrix = u[..., :, None] * (scaled / -distance[..., None])[..., None, :]
    diagonal = np.einsum("...ii->...i", matrix)
    diagonal -= u
    return np.asarray(matrix)


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
    tcp = vectors(p, "p")
    carriage = vectors(rho, "rho") + vectors(offsets, "offsets")
    bars = geometry.L + vectors(lengths, "lengths")
    matrix = row_inverse(tcp, carriage)
    return Jacobians(matrix * (tcp - carriage)[..., None, :], matrix * bars[..., None, :])
