"""Forces on the drives and tensions of the bars under a load at the TCP."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array
from orthoglide.mechanism.engine import Engine, Outputs
from orthoglide.mechanism.six_bars import LINES, TCP, VIRTUAL_PER_LEG
from orthoglide.mechanism.tree import VIRTUAL_NAMES

_STRETCH = VIRTUAL_NAMES.index("stretch1")
STRETCHES = [VIRTUAL_PER_LEG * leg + _STRETCH + bar for leg in range(3) for bar in range(2)]
"""Indices of the bars' stretches among displacements ``(30,)``."""
BARS = [3 + stretch for stretch in STRETCHES]
"""Columns of the bars' stretches in the derivative of the outputs ``(n, 48, 33)``."""


def joint_forces(tangent: Array, load: Array) -> Array:
    """Return the force of a load on the drives and virtual joints ``(n, 33)``, N and N m.

    By virtual work it is the load times the distance by which the TCP sinks for a unit of travel
    or displacement. On a bar's stretch it is the pull in the bar.

    Args:
        tangent: derivative of the outputs by travel and displacements ``(n, 48, 33)``.
        load: at the TCP along base -z ``(n,)``, newtons.
    """
    return np.asarray(-load[:, None] * tangent[:, 2])


def drive_forces(engine: Engine, travel: Array, load: Array) -> Array:
    """Return the force on each carriage of a machine without errors ``(n, 3)``, newtons.

    Args:
        engine: closes postures.
        travel: of the drives ``(n, 3)``, metres.
        load: at the TCP along base -z ``(n,)``, newtons.
    """
    _, tangent = engine.tangent(travel, np.zeros((len(travel), 3 * VIRTUAL_PER_LEG)))
    return joint_forces(tangent, load)[:, :3]


def drive_forces_by_command(engine: Engine, travel: Array, load: Array) -> Array:
    """Return the derivative of :func:`drive_forces` by the command ``(n, 3, 3)``, newtons a metre.

    The bars ``b_i`` keep their length: ``b_i . dp/drho_j = b_i . s_i`` for j = i, else 0, along the
    slides ``s_i``. Once more by rho_k: ``b_i . d2p/drho_j drho_k = -d_ij . d_ik``, where
    ``d_ij = db_i/drho_j``.
    """
    outputs, tangent = engine.tangent(travel, np.zeros((len(travel), 3 * VIRTUAL_PER_LEG)))
    bars = outputs.lines[:, :, 0, 1] - outputs.lines[:, :, 0, 0]
    by_command = tangent[:, :3, :3]
    bar_derivative = np.repeat(np.swapaxes(by_command, 1, 2)[:, None], 3, axis=1)  # (n, i, j, xyz)
    bar_derivative[:, range(3), range(3)] -= engine.mechanism.spheres.slides
    up = np.linalg.inv(bars)[:, 2]
    return np.asarray(np.einsum("n,ni,nijx,nikx->njk", load, up, bar_derivative, bar_derivative))


def tensions_tangent(outputs: Outputs, tangent: Array, tension: Array) -> Array:
    """Return the derivative of the pull in the six bars ``(n, 6, k)``, from that of the outputs.

    Six bars are statically determinate: ``sum_k t_k u_k = (0, 0, -load)`` and, about the TCP,
    ``sum_k t_k (arm_k x u_k) = 0``.

    Args:
        outputs: closed postures.
        tangent: derivative of the outputs ``(n, 48, k)``.
        tension: pull in the bars ``(n, 6)``, newtons.
    """
    n, k = len(tension), tangent.shape[2]
    start, end = np.moveaxis(outputs.lines.reshape(n, 6, 2, 3), 2, 0)
    span = end - start
    length = np.linalg.norm(span, axis=2)[..., None]
    unit = span / length
    by_end = tangent[:, LINES].reshape(n, 6, 2, 3, k)
    by_span = by_end[:, :, 1] - by_end[:, :, 0]
    along = unit[..., None] * np.einsum("nbx,nbxk->nbk", unit, by_span)[:, :, None]
    by_unit = (by_span - along) / length[..., None]
    by_arm = by_end[:, :, 1] - tangent[:, None, TCP]
    arm = end - outputs.p[:, None]
    turning = np.cross(by_arm, unit[..., None], axis=2) + np.cross(arm[..., None], by_unit, axis=2)
    change = np.einsum("nb,nbxk->nxk", tension, np.concatenate([by_unit, turning], axis=2))
    wrenches = np.concatenate([unit, np.cross(arm, unit)], axis=2)
    return np.asarray(-np.linalg.solve(np.swapaxes(wrenches, 1, 2), change))
