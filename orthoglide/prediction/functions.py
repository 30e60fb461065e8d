"""CasADi functions: displacements of the virtual joints, and the formula of a kind of reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.effects import Catalogue, Effect, LegConditions
from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.instruments import POSE_SIZE, Observation, ReadingVariables
from orthoglide.mechanism.compiled import CompilableFunctions, RowFunction
from orthoglide.mechanism.tree import VIRTUAL_NAMES

CONDITION_COUNT = 11
"""Length of a vector of conditions: command (3), approach (3), time, warming, force (3), in the
order rho_x, rho_y, rho_z, approach_x ... z, time, warming, force_x, force_y, force_z."""
COMMAND, FORCE = slice(0, 3), slice(8, 11)

DIMENSION_COUNT = 5
"""Length of a vector of dimensions: bar length, lower and upper end of the stroke, command at
mechanical zero, pitch of the screws (0 where unknown); metres."""


Values = Mapping[str, float] | Array
"""Parameters by name, SI, zero where not named; or all parameters of a machine ``(P,)``."""

_COMPILATION_THRESHOLD = 200_000  # interpreting so many displacements takes as long as compiling


class Displacements:
    """Numerical displacements of the virtual joints, for the effects of one catalogue.

    Args:
        catalogue: the effects.
        geometry: nominal dimensions.
        pitch: of the screws, metres; ``None`` where unknown.
        compile: see :class:`~orthoglide.mechanism.engine.SixBars`.

    Attributes:
        dimensions: as the functions take them ``(5,)``.
        parameter_index: of each parameter in the vector of all.
    """

    def __init__(
        self, catalogue: Catalogue, geometry: Geometry, pitch: float | None, compile: bool | None
    ) -> None:
        self.catalogue, self.has_pitch, self._compile = catalogue, pitch is not None, compile
        zero = geometry.layout.zero(geometry.L)
        self.dimensions = np.array([geometry.L, *geometry.stroke, zero, pitch or 0.0])
        self.parameter_index: dict[str, int] = {n: k for k, n in enumerate(catalogue.parameters)}

    @cached_property
    def function(self) -> Any:
        """The CasADi function (dimensions ``(5,)``, parameters ``(P,)``, conditions ``(11,)``) ->
        displacements ``(30,)``.

        Drives are summed first, as errors of the rails depend on the carriage's true travel.

        Raises:
            InputError: where an effect moves a joint that does not exist.
        """
        sizes = ca.SX.sym("dimensions", DIMENSION_COUNT)
        theta = ca.SX.sym("theta", len(self.parameter_index))
        vector = ca.SX.sym("conditions", CONDITION_COUNT)
        moved = [
            (leg, motion, theta[k], name)
            for k, (name, (leg, motions)) in enumerate(self.catalogue.motions.items())
            for motion in motions
        ]
        joints: dict[tuple[int, str], Any] = {}
        for leg, motion, size, name in sorted(moved, key=lambda one: one[1].joint != "travel"):
            joint = motion.joint
            if joint not in VIRTUAL_NAMES:
                raise InputError(
                    f"{name} must move a virtual joint ({', '.join(VIRTUAL_NAMES)}), not {joint!r}"
                )
            drive_error = None if joint == "travel" else joints.get((leg, "travel"), 0)
            conditions = self.leg_conditions(sizes, vector, leg, drive_error)
            joints[leg, joint] = joints.get((leg, joint), 0) + motion.basis(conditions) * size
        pairs = ((leg, name) for leg in range(len(LEGS)) for name in VIRTUAL_NAMES)
        displacements = ca.vertcat(*[joints.get(pair, ca.SX(1, 1)) for pair in pairs])
        return ca.Function("displacement", [sizes, theta, vector], [ca.densify(displacements)])

    def leg_conditions(self, sizes: Any, vector: Any, leg: int, drive_error: Any) -> LegConditions:
        """Return the conditions on which the effects of one leg depend, from dimensions ``(5,)``
        and conditions ``(11,)`` or ``(11, n)``, numbers or symbols. ``drive_error``: travel beyond
        the commanded one; ``None`` for the effects of drives.
        """
        length, low, high, zero, pitch = (sizes[k] for k in range(DIMENSION_COUNT))
        command = vector[leg]
        return LegConditions(
            command=command,
            length=length,
            stroke=(low, high),
            pitch=pitch if self.has_pitch else None,
            approach=vector[3 + leg],
            time=vector[6],
            warming=vector[7],
            force=vector[8 + leg],
            travel=None if drive_error is None else command - zero + drive_error,
            zero=zero,
            commands=tuple(vector[k] for k in range(len(LEGS))),
        )

    @cached_property
    def _compiled(self) -> CompilableFunctions:
        key, build = self.function.serialize(), lambda: [self.function]
        return CompilableFunctions(
            ("displacement",), key, build, 2, _COMPILATION_THRESHOLD, self._compile
        )

    @cached_property
    def _jacobians(self) -> tuple[RowFunction, RowFunction]:
        """Derivatives of :attr:`function` by the parameters ``(30, P)``, and by the conditions
        ``(30, 11)``: errors of rails and drives depend on the command, the compliance of drives on
        the force.
        """
        arguments = [ca.SX.sym(f"a{k}", self.function.size1_in(k)) for k in range(3)]
        displacements = self.function(*arguments)
        by_parameters, by_conditions = (
            ca.Function("derivative", arguments, [ca.densify(ca.jacobian(displacements, by))])
            for by in arguments[1:]
        )
        return RowFunction(by_parameters, 2), RowFunction(by_conditions, 2)

    def parameter_vector(self, values: Values) -> Array:
        """Return all parameters of the machine ``(P,)``, SI, zero where not named, without those of
        instruments.

        Raises:
            InputError: for a name that is no parameter.
        """
        if isinstance(values, np.ndarray):
            return values
        theta = np.zeros(len(self.parameter_index))
        for name, value in values.items():
            if name in self.parameter_index:
                theta[self.parameter_index[name]] = value
            elif not (effect := self.catalogue.effect_of(name)).of_dial:
                raise InputError(
                    f"there is no parameter {name!r}: {effect.name} has {', '.join(effect.motions)}"
                )
        return theta

    def evaluate(self, theta: Array, conditions: Array) -> Array:
        """Return displacements ``(n, 30)`` for parameters ``(P,)`` under conditions ``(n, 11)``."""
        return self._compiled("displacement", self.dimensions, theta, conditions)[0]

    def parameter_jacobian(self, theta: Array, conditions: Array) -> Array:
        """Return the derivative ``(n, 30, P)`` of the displacements by the parameters."""
        return self._jacobians[0](self.dimensions, theta, conditions)[0]

    def condition_jacobian(self, theta: Array, conditions: Array) -> Array:
        """Return the derivative ``(n, 30, 11)`` of the displacements by the conditions."""
        return self._jacobians[1](self.dimensions, theta, conditions)[0]


class Formula:
    """The formula of a kind of reading, as CasADi functions of rows.

    Args:
        observation: the kind of reading.
        effects: effects of its instrument, with ``D`` parameters for a setup.
        numbers: count ``M`` of the numbers that describe a mounting.

    Attributes:
        function: (pose ``(12,)``, other pose ``(12,)``, mounting ``(M,)``, nuisances ``(K,)``,
            effects ``(max(D, 1),)``) -> reading.
        value: :attr:`function` for rows.
        tangent: readings and their derivatives by pose, other pose, nuisances and effects.
    """

    def __init__(self, observation: Observation, effects: Sequence[Effect], numbers: int) -> None:
        count = sum(len(e.parameters(("",))) for e in effects)
        sizes = (POSE_SIZE, POSE_SIZE, numbers, observation.nuisance_count, max(count, 1))
        symbols = [ca.SX.sym(name, n) for name, n in zip("pomzv", sizes, strict=True)]
        pose, other, mounting, nuisance, values = (ca.vertsplit(s) for s in symbols)
        row = ReadingVariables(pose, other, mounting, nuisance, values[:count])
        reading = ca.SX(observation.formula(row, effects))
        self.function = ca.Function(observation.kind, symbols, [reading])
        by = [ca.densify(ca.gradient(reading, symbols[k])) for k in (0, 1, 3, 4)]
        self.value = RowFunction(self.function)
        self.tangent = RowFunction(
            ca.Function(f"{observation.kind}_tangent", symbols, [reading, *by])
        )
