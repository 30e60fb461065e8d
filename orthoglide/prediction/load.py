"""What a load at the TCP does to the drives: forces by virtual work, by command."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.batch import Outputs
from orthoglide.prediction.conditions import Conditions


def force(mechanism: Mechanism, conditions: Conditions) -> Array:
    """Force on each carriage along its axis under the load ``(n, 3)``, newtons.

    By virtual work on the nominal machine: ``f = (dp/drho)^T (0, 0, -load)``.
    """
    if not conditions.load.any():
        return np.zeros_like(conditions.command)
    _, by_command = _nominal(mechanism, conditions)
    return -conditions.load[:, None] * by_command[:, 2]


def force_by_command(mechanism: Mechanism, conditions: Conditions) -> Array:
    """Derivative of :func:`force` by the command ``(n, 3, 3)``, newtons a metre.

    The bars ``b_i`` keep their length: ``b_i . dp/drho_j = b_i . s_i`` for j = i, else 0, along the
    slides ``s_i``. Once more by rho_k: ``b_i . d2p/drho_j drho_k = -d_ij . d_ik``, where
    ``d_ij = db_i/drho_j``.
    """
    shown, by_command = _nominal(mechanism, conditions)
    bars = shown.lines[:, :, 0, 1] - shown.lines[:, :, 0, 0]
    moved = np.repeat(np.swapaxes(by_command, 1, 2)[:, None], 3, axis=1)  # (n, i, j, xyz)
    moved[:, range(3), range(3)] -= mechanism.geometry.slides
    up = np.linalg.inv(bars)[:, 2]
    return np.asarray(np.einsum("n,ni,nijx,nikx->njk", conditions.load, up, moved, moved))


def _nominal(mechanism: Mechanism, conditions: Conditions) -> tuple[Outputs, Array]:
    """Postures of the nominal machine, and dp/drho ``(n, 3, 3)``."""
    batch, given = mechanism.nominal_batch, mechanism.given(conditions.command)[:, :3]
    shown, by_given = batch.tangent(batch.close(given), given)
    return shown, by_given[:, :3]
