"""From parameters and conditions to displacements of the virtual joints, as CasADi functions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.effects import Catalogue, LegConditions
from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.mechanism.rows import CompilableFunctions, RowFunction
from orthoglide.mechanism.tree import VIRTUAL_NAMES

CONDITION_COUNT = 11
"""Length of a vector of conditions: command (3), approach (3), time, warming, force (3), in the
order rho_x, rho_y, rho_z, approach_x ... z, time, warming, force_x, force_y, force_z."""
COMMAND, FORCE = slice(0, 3), slice(8, 11)

DIMENSION_COUNT = 5
"""Length of a vector of dimensions: bar length, lower and upper end of the stroke, command at
mechanical zero, pitch of the screws; metres."""


def dimensions(geometry: Geometry, pitch: float | None) -> Array:
    """Return what the effects' bases need to know of a machine ``(5,)``, metres."""
    zero = geometry.layout.zero(geometry.L)
    return np.array([geometry.L, *geometry.stroke, zero, pitch or 0.0])


def displacement_function(catalogue: Catalogue, has_pitch: bool) -> Any:
    """CasADi function (dimensions ``(5,)``, parameters ``(P,)``, conditions ``(11,)``) ->
    displacements ``(30,)``.

    Drives are summed first: what the rail does follows the carriage's true travel.

    Args:
        catalogue: says the parameters and their order.
        has_pitch: whether the pitch of the screws is known.

    Raises:
        InputError: where an effect moves a joint that does not exist.
    """
    size = ca.SX.sym("dimensions", DIMENSION_COUNT)
    theta = ca.SX.sym("theta", len(catalogue.parameters))
    seen = ca.SX.sym("conditions", CONDITION_COUNT)
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
                    conditions = leg_conditions(size, seen, leg, driven, has_pitch)
                    place = (leg, motion.joint)
                    joints[place] = joints.get(place, 0) + motion.basis(conditions) * theta[k]
    moves = [
        joints.get((leg, name), ca.SX(1, 1)) for leg in range(len(LEGS)) for name in VIRTUAL_NAMES
    ]
    return ca.Function("displacement", [size, theta, seen], [ca.densify(ca.vertcat(*moves))])


def displacement_derivative(function: Any, by: int, name: str) -> Any:
    """CasADi function of the derivative of the displacements by one of their arguments.

    Args:
        function: as :func:`displacement_function` returns it.
        by: 1 for the parameters ``(30, P)``, 2 for the conditions ``(30, 11)``: what rails and
            drives do follows the command, and the give of drives the force on them.
        name: of the function.
    """
    arguments = [ca.SX.sym(f"a{k}", function.size1_in(k)) for k in range(3)]
    derivative = ca.jacobian(function(*arguments), arguments[by])
    return ca.Function(name, arguments, [ca.densify(derivative)])


def leg_conditions(size: Any, seen: Any, leg: int, driven: Any, has_pitch: bool) -> LegConditions:
    """Return what the effects of one leg see.

    Args:
        size: dimensions ``(5,)``.
        seen: conditions ``(11,)``, or ``(11, n)``.
        leg: 0, 1 or 2.
        driven: what the drive adds to the commanded travel; ``None`` for the drive's own effects.
        has_pitch: whether the pitch of the screws is known.
    """
    length, low, high, zero, pitch = (size[k] for k in range(DIMENSION_COUNT))
    command = seen[leg]
    return LegConditions(
        command=command,
        length=length,
        stroke=(low, high),
        pitch=pitch if has_pitch else None,
        approach=seen[3 + leg],
        time=seen[6],
        warming=seen[7],
        force=seen[8 + leg],
        travel=None if driven is None else command - zero + driven,
        zero=zero,
        commands=tuple(seen[k] for k in range(len(LEGS))),
    )


# Interpreted displacements that take as long as compiling them does.
_COMPILATION_THRESHOLD = 200_000


class Displacements:
    """Displacements of the virtual joints in numbers, for the effects of one catalogue.

    Args:
        catalogue: the effects.
        geometry: nominal dimensions.
        pitch: of the screws, metres; ``None`` where unknown.
        compile: see :class:`~orthoglide.mechanism.engine.SixBars`.

    Attributes:
        size: dimensions as the functions take them ``(5,)``.
        place: of each parameter in the vector of all.
    """

    def __init__(
        self, catalogue: Catalogue, geometry: Geometry, pitch: float | None, compile: bool | None
    ) -> None:
        self.catalogue, self.has_pitch = catalogue, pitch is not None
        self.dimensions, self._compile = dimensions(geometry, pitch), compile
        self.parameter_index: dict[str, int] = {
            name: k for k, name in enumerate(catalogue.parameters)
        }

    @cached_property
    def function(self) -> Any:
        """The CasADi function, see :func:`displacement_function`."""
        return displacement_function(self.catalogue, self.has_pitch)

    @cached_property
    def _compiled(self) -> CompilableFunctions:
        worth = -1 if self._compile is False else _COMPILATION_THRESHOLD
        key, build = self.function.serialize(), lambda: [self.function]
        found = CompilableFunctions(("displacement",), key, build, 2, worth)
        if self._compile:
            found.compile()
        return found

    @cached_property
    def _parameter_jacobian(self) -> RowFunction:
        return RowFunction(displacement_derivative(self.function, 1, "by_parameters"), 2)

    @cached_property
    def _condition_jacobian(self) -> RowFunction:
        return RowFunction(displacement_derivative(self.function, 2, "by_conditions"), 2)

    def parameter_vector(self, values: Mapping[str, float]) -> Array:
        """Return all parameters of the machine ``(P,)``, SI, zero where not named; dials are
        skipped.

        Raises:
            InputError: for a name that is no parameter.
        """
        theta = np.zeros(len(self.parameter_index))
        for name, value in values.items():
            if name in self.parameter_index:
                theta[self.parameter_index[name]] = value
            elif not (effect := self.catalogue.effect_of(name)).of_dial:
                raise InputError(
                    f"there is no parameter {name!r}: {effect.name} has {', '.join(effect.motions)}"
                )
        return theta

    def evaluate(self, theta: Array, seen: Array) -> Array:
        """Return displacements ``(n, 30)`` for parameters ``(P,)`` under conditions ``(n, 11)``."""
        return self._compiled("displacement", self.dimensions, theta, seen)[0]

    def parameter_jacobian(self, theta: Array, seen: Array) -> Array:
        """Return the derivative ``(n, 30, P)`` of the displacements by the parameters."""
        return self._parameter_jacobian(self.dimensions, theta, seen)[0]

    def condition_jacobian(self, theta: Array, seen: Array) -> Array:
        """Return the derivative ``(n, 30, 11)`` of the displacements by the conditions."""
        return self._condition_jacobian(self.dimensions, theta, seen)[0]
