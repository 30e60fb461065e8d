"""From parameters and conditions to displacements of the virtual joints, as one CasADi function."""

from __future__ import annotations

from typing import Any

import casadi as ca

from orthoglide.effects import Catalogue, LegConditions
from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Geometry
from orthoglide.mechanism.tree import VIRTUAL_NAMES

CONDITIONS = 11
"""Length of a vector of conditions: command (3), approach (3), time, warming, force (3), ... in
the order rho_x, rho_y, rho_z, approach_x ... z, time, warming, force_x, force_y, force_z."""
COMMAND, FORCE = slice(0, 3), slice(8, 11)


def displacement_function(catalogue: Catalogue, geometry: Geometry, pitch: float | None) -> Any:
    """CasADi function (parameters ``(P,)``, conditions ``(11,)``) -> displacements ``(30,)``.

    Drives are summed first: what the rail does follows the carriage's true travel.

    Args:
        catalogue: whose machine parameters these are, in its order.
        geometry: nominal dimensions.
        pitch: of the screws, metres.

    Raises:
        InputError: where an effect moves a joint that does not exist.
    """
    theta = ca.SX.sym("theta", len(catalogue.parameters))
    seen = ca.SX.sym("conditions", CONDITIONS)
    joints: dict[tuple[int, str], Any] = {}
    for on_the_drive in (True, False):
        for k, (name, (leg, motions)) in enumerate(catalogue.motions.items()):
            for motion in motions:
                if motion.joint not in VIRTUAL_NAMES:
                    raise InputError(
                        f"{name} moves {motion.joint!r}, which is no virtual joint: they are "
                        f"{', '.join(VIRTUAL_NAMES)}"
                    )
                if (motion.joint == "travel") is on_the_drive:
                    driven = None if on_the_drive else joints[leg, "travel"]
                    conditions = leg_conditions(geometry, pitch, seen, leg, driven)
                    place = (leg, motion.joint)
                    joints[place] = joints.get(place, 0) + motion.basis(conditions) * theta[k]
    moves = [
        joints.get((leg, name), ca.SX(1, 1)) for leg in range(len(LEGS)) for name in VIRTUAL_NAMES
    ]
    return ca.Function("displacement", [theta, seen], [ca.densify(ca.vertcat(*moves))])


def displacement_tangent(function: Any) -> Any:
    """The same function with its derivative ``(30, P)`` by the parameters."""
    theta = ca.SX.sym("theta", function.size1_in(0))
    seen = ca.SX.sym("conditions", function.size1_in(1))
    moves = function(theta, seen)
    return ca.Function(
        "displacement_tangent", [theta, seen], [moves, ca.densify(ca.jacobian(moves, theta))]
    )


def displacement_by_conditions(function: Any) -> Any:
    """Derivative ``(30, 11)`` of the displacements by the conditions.

    What rails and drives do follows the command, and the give of drives the force on them.
    """
    theta = ca.SX.sym("theta", function.size1_in(0))
    seen = ca.SX.sym("conditions", function.size1_in(1))
    by_seen = ca.jacobian(function(theta, seen), seen)
    return ca.Function("displacement_by_conditions", [theta, seen], [ca.densify(by_seen)])


def leg_conditions(
    geometry: Geometry, pitch: float | None, seen: Any, leg: int, driven: Any
) -> LegConditions:
    """What the effects of one leg see, of a vector of conditions or ``(11, n)`` of them."""
    command, zero = seen[leg], geometry.layout.zero(geometry.L)
    return LegConditions(
        command=command,
        length=geometry.L,
        stroke=geometry.stroke,
        pitch=pitch,
        approach=seen[3 + leg],
        time=seen[6],
        warming=seen[7],
        force=seen[8 + leg],
        travel=None if driven is None else command - zero + driven,
        zero=zero,
        commands=tuple(seen[k] for k in range(len(LEGS))),
    )
