"""Velocity transmission factors: how fast the tool moves for drives of unit speed.

They are the singular values of dp/drho (Chablat and Wenger 2003; Pashkevich et al. 2008, 2.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.arguments import public
from orthoglide.errors import InputError, as_float_array, check_integer
from orthoglide.geometry import Array, vectors
from orthoglide.machine import Machine, MachineSource


@dataclass(frozen=True)
class CubeTransmission:
    """Transmission factors of a machine over a cube whose edges lie along the base axes.

    Attributes:
        side: of the cube, metres.
        centre: of the cube ``(3,)``, metres, base frame.
        smallest: transmission factor over the cube, dimensionless.
        largest: transmission factor over the cube, dimensionless.
        travel: lowest and highest travel of any drive from mechanical zero, metres.
        within_stroke: whether every drive stays within its stroke.
    """

    side: float
    centre: Array
    smallest: float
    largest: float
    travel: tuple[float, float]
    within_stroke: bool


@public
def transmission_factors(machine: MachineSource | None, p: ArrayLike) -> Array:
    """Return the velocity transmission factors at points, the largest first.

    Args:
        machine: nominal or calibrated, or the path of its file; the published one for ``None``.
        p: TCP ``(..., 3)``, metres.

    Returns:
        Singular values of dp/drho ``(..., 3)``, dimensionless: 1 at an isotropic point.

    Raises:
        UnreachableError: naming the leg that is too short.
    """
    machine = Machine.of(machine)
    return np.asarray(np.linalg.svd(machine.jacobian(machine.inverse(p)), compute_uv=False))


@public
def transmission_over_cube(
    machine: MachineSource | None, side: float, centre: ArrayLike = (0.0, 0.0, 0.0), count: int = 9
) -> CubeTransmission:
    """Return the extreme transmission factors over a cube, and the travel that it needs.

    Args:
        machine: as for :func:`transmission_factors`.
        side: of the cube, metres.
        centre: of the cube ``(3,)``, metres, base frame.
        count: points along each edge of the evaluated grid, at least 2.

    Raises:
        InputError: for a side that is not positive, or fewer than two points.
        UnreachableError: naming the leg that is too short.
    """
    cube_centre = vectors(centre, "centre")
    check_integer("count", count, 2)
    size = as_float_array("the side", side)
    if cube_centre.shape != (3,) or size.shape != () or not (np.isfinite(size) and size > 0):
        raise InputError("a cube has a centre (3,) and a positive side, both in metres")
    machine = Machine.of(machine)
    steps = cube_centre + np.linspace(-side / 2, side / 2, count)[:, None]
    # A drive travels furthest where the point is nearest to its leg's carriage, so the grid
    # contains these coordinates too.
    nearest = np.clip(machine.model.mechanism.spheres.centres, steps[0], steps[-1])
    p = np.stack(
        np.meshgrid(*(np.union1d(steps[:, k], nearest[:, k]) for k in range(3)), indexing="ij"),
        axis=-1,
    ).reshape(-1, 3)
    rho = machine.inverse(p)
    factors = np.linalg.svd(machine.jacobian(rho), compute_uv=False)
    travel = rho - machine.geometry.zero
    return CubeTransmission(
        float(side),
        cube_centre,
        float(factors.min()),
        float(factors.max()),
        (float(travel.min()), float(travel.max())),
        bool(machine.geometry.in_stroke(rho).all()),
    )
