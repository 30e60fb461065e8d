"""Eq. (1a) to (1c) of the 2008 chapter: the TCP as each leg's chain has it, with the right sign.

The chapter prints ``p_x = rho_x + cos(theta_x) cos(beta_x) L_x + r``. With eq. (2) and (3), which
put the carriage on the far side of the TCP, the bar points from the carriage back to the TCP: the
terms with L have the opposite sign, and r is part of rho.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.geometry import Array, Geometry
from orthoglide.reduction.kinematics import NOMINAL, out_of_reach, vectors


def leg_points(
    rho: ArrayLike,
    theta: ArrayLike,
    beta: ArrayLike,
    offsets: ArrayLike = 0.0,
    lengths: ArrayLike = 0.0,
    *,
    geometry: Geometry = NOMINAL,
) -> Array:
    """Return the TCP by the chain of each leg ``(..., leg, 3)``, metres (2008, eq. (1a) to (1c)).

    For leg x: ``p = (rho_x + offset_x, 0, 0) - L_x (cos theta cos beta, sin theta cos beta,
    -sin beta)``; legs y and z by cyclic permutation. All three agree where the machine is closed.

    Args:
        rho: commands ``(..., 3)``, metres.
        theta: angle of each leg's first revolute ``(..., 3)``, radians.
        beta: angle of each parallelogram ``(..., 3)``, radians.
        offsets: joint offsets ``(..., 3)``, metres.
        lengths: leg lengths minus L ``(..., 3)``, metres.
        geometry: nominal dimensions.
    """
    carriage = vectors(rho, "rho") + vectors(offsets, "offsets")
    bars = geometry.L + vectors(lengths, "lengths")
    turn, tilt = vectors(theta, "theta"), vectors(beta, "beta")
    # By the leg's own axes a, b, c, which are base axes in cyclic order.
    a = carriage - bars * np.cos(turn) * np.cos(tilt)
    b = -bars * np.sin(turn) * np.cos(tilt)
    c = bars * np.sin(tilt)
    by_leg = np.stack(np.broadcast_arrays(a, b, c), axis=-1)
    return np.stack([np.roll(by_leg[..., k, :], k, axis=-1) for k in range(3)], axis=-2)


def leg_angles(
    p: ArrayLike, lengths: ArrayLike = 0.0, *, geometry: Geometry = NOMINAL
) -> tuple[Array, Array]:
    """Return the angles theta and beta ``(..., 3)`` of each leg, radians: eq. (1) solved for them.

    Args:
        p: TCP ``(..., 3)``, metres.
        lengths: leg lengths minus L ``(..., 3)``, metres.
        geometry: nominal dimensions.

    Raises:
        UnreachableError: where the TCP is further from a leg's axis than the leg is long.
    """
    tcp, bars = vectors(p, "p"), geometry.L + vectors(lengths, "lengths")
    b, c = tcp[..., [1, 2, 0]], tcp[..., [2, 0, 1]]
    excess = np.hypot(b, c) - bars
    if not (excess <= 0).all():
        raise out_of_reach(excess)
    beta = np.arcsin(c / bars)
    return np.arctan2(-b, np.sqrt(bars**2 - b**2 - c**2)), beta
