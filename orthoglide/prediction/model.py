"""Conditions and parameters -> poses with sensitivities to all parameters; tensions of bars."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from orthoglide.effects import CATALOGUE, Catalogue, Effect, LegConditions
from orthoglide.errors import ClosureError
from orthoglide.geometry import Array, Geometry
from orthoglide.instruments import Observation
from orthoglide.machine_file.model import Stiffness
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.compiled import blocks
from orthoglide.mechanism.engine import Engine, Outputs, PinocchioEngine, SixBars
from orthoglide.mechanism.six_bars import LINES, OUTPUT_SIZE, TCP, VIRTUAL_PER_LEG
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.prediction.conditions import Conditions
from orthoglide.prediction.functions import (
    COMMAND,
    CONDITION_COUNT,
    FORCE,
    Displacements,
    Formula,
    Values,
)

_STRETCH = VIRTUAL_NAMES.index("stretch1")
STRETCHES = [VIRTUAL_PER_LEG * leg + _STRETCH + bar for leg in range(3) for bar in range(2)]
"""Indices of the bars' stretches among displacements ``(30,)``."""
BARS = [3 + stretch for stretch in STRETCHES]
"""Columns of the bars' stretches in the derivative of the outputs ``(n, 48, 33)``."""

_MAX_ELASTIC_ROUNDS = 200
"""Rounds to the equilibrium of elastic bars. Each multiplies the error by the relative stretch of a
bar: a hundred-thousandth for steel, which needs three rounds. Bars that stretch by 85 % of their
length, which is no machine, would need all."""
_ELASTIC_TOLERANCE = 1e-14  # metres by which bars still change: the error left is far smaller


@dataclass(frozen=True, eq=False)
class Model:
    """The general mechanism moved by the catalogue's effects."""

    geometry: Geometry  # nominal dimensions
    pitch: float | None = None  # of the drives' screws, metres; `None` where unknown
    stiffness: Stiffness = field(default_factory=Stiffness)  # of the bars, where known
    catalogue: Catalogue = CATALOGUE  # the effects that move it
    urdf: str = ""  # folder of the machine's URDF; the one of `geometry` where absent
    compile: bool | None = None  # see :class:`~orthoglide.mechanism.engine.SixBars`
    pinocchio_only: bool = False  # whether Pinocchio closes every posture

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments alone: CasADi functions cannot be pickled and are built again."""
        return {argument.name: getattr(self, argument.name) for argument in fields(self)}

    def by_pinocchio(self) -> Self:
        """Return a model that closes every posture with Pinocchio."""
        return replace(self, pinocchio_only=True)

    def with_catalogue(self, catalogue: Catalogue) -> Self:
        """Return a model moved by other effects, which shares the engine."""
        model = replace(self, catalogue=catalogue)
        built = vars(self).keys() & {"mechanism", "engine"}
        vars(model).update({name: vars(self)[name] for name in built})
        return model

    @cached_property
    def mechanism(self) -> Mechanism:
        """The Pinocchio model with its constraints, without errors."""
        return Mechanism(self.geometry, urdf=self.urdf)

    @cached_property
    def engine(self) -> Engine:
        """The engine that closes postures."""
        if self.pinocchio_only:
            return PinocchioEngine(self.mechanism)
        return SixBars(self.mechanism, compile=self.compile)

    @property
    def _compliance(self) -> float:
        """Compliance of a bar, m/N."""
        return 0.0 if self.stiffness.bar is None else 1 / self.stiffness.bar

    def is_elastic(self, conditions: Conditions) -> bool:
        """Return whether the load deforms the bars in these postures."""
        return self.stiffness.bar is not None and bool(conditions.load.any())

    def _travel(self, conditions: Conditions) -> Array:
        return conditions.command - self.geometry.zero

    def loaded_displacements(self, values: Values, conditions: Conditions) -> Array:
        """Return the displacements of the virtual joints ``(n, 30)``, elastic bars included."""
        displacements = self.displacements(values, conditions)
        if not self.is_elastic(conditions):
            return displacements
        travel, loaded = self._travel(conditions), displacements.copy()
        for _ in range(_MAX_ELASTIC_ROUNDS):
            tangent = self.engine.tangent(travel, loaded)[1]
            tension = joint_forces(tangent, conditions.load)[:, BARS]
            stretched = displacements[:, STRETCHES] + tension * self._compliance
            change = np.abs(stretched - loaded[:, STRETCHES]).max(axis=1)
            loaded[:, STRETCHES] = stretched
            if change.max() <= _ELASTIC_TOLERANCE * max(1.0, self.geometry.scale):
                return loaded
        worst, count = int(np.argmax(change)), len(displacements)
        which = f"posture {worst + 1} of {count}: " if count > 1 else ""
        raise ClosureError(
            f"{which}the bars find no equilibrium under this load; check the load and the "
            f"stiffness of the bars",
            index=(worst,),
        )

    def tensions(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Return the tensions of the bars ``(n, leg, bar)`` under the load, newtons."""
        displacements = self.loaded_displacements(values, conditions)
        _, tangent = self.engine.tangent(self._travel(conditions), displacements)
        return joint_forces(tangent, conditions.load)[:, BARS].reshape(-1, 3, 2)

    def tangent(self, values: Mapping[str, float], conditions: Conditions) -> tuple[Outputs, Array]:
        """Return outputs, and their derivative ``(n, 48, 33)`` by travel and displacements."""
        displacements = self.loaded_displacements(values, conditions)
        outputs, tangent = self.engine.tangent(self._travel(conditions), displacements)
        if self.is_elastic(conditions):
            tension = joint_forces(tangent, conditions.load)[:, BARS]
            stretched = tensions_tangent(outputs, tangent, tension) * self._compliance
            # The stretch changes the tensions too.
            coupled = np.linalg.solve(np.eye(6) - stretched[:, :, BARS], stretched)
            tangent = tangent + tangent[:, :, BARS] @ coupled
        return outputs, tangent

    @cached_property
    def displacement_model(self) -> Displacements:
        """Map from parameters and conditions to displacements of the virtual joints."""
        return Displacements(self.catalogue, self.geometry, self.pitch, self.compile)

    @cached_property
    def _formulas(self) -> dict[tuple[str, int], Formula]:
        """Formulas that were needed so far, by kind and count of the numbers of a mounting."""
        return {}

    def instrument_effects(self, observation: Observation) -> tuple[Effect, ...]:
        """Return the effects of a kind's instrument, in the order of its formula."""
        return tuple(
            e for e in self.catalogue.effects if e.of_dial and observation.is_affected_by(e)
        )

    def instrument_parameters(self, observation: Observation, setup: str) -> tuple[str, ...]:
        """Return the names of the ``D`` parameters of a setup's instrument."""
        effects = self.instrument_effects(observation)
        return tuple(str(n) for e in effects for n in e.parameters((setup,)))

    def formula(self, observation: Observation, numbers: int) -> Formula:
        """Return the formula of a kind for mountings that ``numbers`` numbers describe."""
        key = observation.kind, numbers
        if key not in self._formulas:
            effects = self.instrument_effects(observation)
            self._formulas[key] = Formula(observation, effects, numbers)
        return self._formulas[key]

    def condition_vectors(self, conditions: Conditions) -> Array:
        """Return conditions as the displacement function takes them ``(n, 11)``."""
        vectors = np.zeros((len(conditions), CONDITION_COUNT))
        vectors[:, : FORCE.start] = conditions.table[:, : FORCE.start]
        if conditions.load.any():
            _, tangent = self._without_errors(conditions)
            vectors[:, FORCE] = joint_forces(tangent, conditions.load)[:, :3]
        return vectors

    def displacements(self, values: Values, conditions: Conditions) -> Array:
        """Return the displacements of the virtual joints ``(n, 30)``, metres and radians."""
        theta = self.displacement_model.parameter_vector(values)
        if not len(conditions) or not theta.any():
            return np.zeros((len(conditions), 3 * VIRTUAL_PER_LEG))
        return self.displacement_model.evaluate(theta, self.condition_vectors(conditions))

    def jacobian(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Return dp/drho ``(n, 3, 3)``, with errors of rails and drives that change with rho."""
        _, tangent = self.tangent(values, conditions)
        by_conditions = self.displacement_model.condition_jacobian(
            self.displacement_model.parameter_vector(values), self.condition_vectors(conditions)
        )
        by_command = by_conditions[:, :, COMMAND]
        if conditions.load.any():
            by_command = by_command + by_conditions[:, :, FORCE] @ self._forces_by_command(
                conditions
            )
        return np.asarray(tangent[:, :3, :3] + tangent[:, :3, 3:] @ by_command)

    def _without_errors(self, conditions: Conditions) -> tuple[Outputs, Array]:
        """Return outputs and :meth:`tangent` of the machine without errors."""
        moves = np.zeros((len(conditions), 3 * VIRTUAL_PER_LEG))
        return self.engine.tangent(self._travel(conditions), moves)

    def _forces_by_command(self, conditions: Conditions) -> Array:
        """Return the derivative of the load's forces on the drives by the command ``(n, 3, 3)``,
        newtons a metre.

        Without errors the two bars of a leg are parallel, so one, ``b_i``, is enough. Its constant
        length gives ``b_i . dp/drho_j = b_i . s_i`` if j = i, else 0, with the direction ``s_i`` of
        the slide. Differentiated by rho_k, with ``d_ij = db_i/drho_j``:
        ``b_i . d2p/(drho_j drho_k) = -d_ij . d_ik``. The force on drive j is ``-load dp_z/drho_j``,
        so its derivative is ``load * sum_i up_i (d_ij . d_ik)``, where ``up`` is the row of
        ``B^-1`` for z and ``B`` has the rows ``b_i``.
        """
        outputs, tangent = self._without_errors(conditions)
        bars = outputs.lines[:, :, 0, 1] - outputs.lines[:, :, 0, 0]
        by_command = np.swapaxes(tangent[:, :3, :3], 1, 2)
        derivative = np.repeat(by_command[:, None], 3, axis=1)  # of the bars (n, i, j, xyz)
        derivative[:, range(3), range(3)] -= self.engine.mechanism.spheres.slides
        up = np.linalg.inv(bars)[:, 2]
        return np.asarray(
            np.einsum("n,ni,nijx,nikx->njk", conditions.load, up, derivative, derivative)
        )

    def outputs(self, values: Values, conditions: Conditions) -> Outputs:
        """Return poses and bars of closed postures.

        Raises:
            ClosureError: naming the first posture that does not close, or the worst one if the bars
                find no equilibrium under the load.
        """
        displacements = self.loaded_displacements(values, conditions)
        return self.engine.outputs(self._travel(conditions), displacements)

    def sensitivities(
        self, values: Mapping[str, float], conditions: Conditions, names: Sequence[str]
    ) -> tuple[Outputs, Array]:
        """Return poses and bars, and their derivative ``(n, 48, P)`` by parameters, loops closed;
        zero by parameters of instruments.
        """
        columns = [k for k, name in enumerate(names) if not self.catalogue.effect_of(name).of_dial]
        machine_parameters = [names[k] for k in columns]
        outputs = np.empty((len(conditions), OUTPUT_SIZE))
        by_name = np.zeros((*outputs.shape, len(names)))
        for rows in blocks(len(conditions)):  # small enough for the cache
            postures = conditions.subset(rows)
            closed, tangent = self.tangent(values, postures)
            joints = self.joint_sensitivities(values, postures, machine_parameters)
            outputs[rows] = closed.values
            by_name[rows][:, :, columns] = tangent[:, :, 3:] @ joints
        return Outputs(outputs), by_name

    def joint_sensitivities(
        self, values: Mapping[str, float], conditions: Conditions, names: Sequence[str]
    ) -> Array:
        """Return the derivative ``(n, 30, P)`` of the virtual joints by machine parameters."""
        model, theta = self.displacement_model, self.displacement_model.parameter_vector(values)
        by_theta = model.parameter_jacobian(theta, self.condition_vectors(conditions))
        return by_theta[:, :, [model.parameter_index[name] for name in names]]

    def needed_conditions(self, names: Iterable[str]) -> frozenset[str]:
        """Return the conditions besides the command that matter to parameters ``names``."""
        effects = [self.catalogue.effect_of(name) for name in names]
        # Forces cost a further closure: a load counts only where something gives way to it.
        load = frozenset[str]() if self.stiffness.bar is None else frozenset({"load"})
        return load.union(*(effect.needs for effect in effects if not effect.of_dial))

    def leg_conditions(
        self, values: Mapping[str, float], conditions: Conditions
    ) -> tuple[LegConditions, ...]:
        """Return the conditions of each leg's effects in ``n`` postures, as arrays."""
        vectors, model = self.condition_vectors(conditions).T, self.displacement_model
        drives = self.displacements(values, conditions)[:, :: len(VIRTUAL_NAMES)].T
        return tuple(
            model.leg_conditions(model.dimensions, vectors, leg, drive_error)
            for leg, drive_error in enumerate(drives)
        )


def joint_forces(tangent: Array, load: Array) -> Array:
    """Return the force of a load along base -z, newtons, on the drives and virtual joints ``(n,
    33)``, N and N m.

    By virtual work it is the load times the distance by which the TCP sinks for a unit of travel or
    displacement: ``tangent`` ``(n, 48, 33)``. On a bar's stretch it is the tension of the bar.
    """
    return np.asarray(-load[:, None] * tangent[:, 2])


def tensions_tangent(outputs: Outputs, tangent: Array, tension: Array) -> Array:
    """Return the derivative of the tensions of the six bars ``(n, 6, k)``, from that of the outputs
    ``(n, 48, k)``.

    Equilibrium determines the tensions ``t_b``: ``sum_b t_b u_b = (0, 0, -load)`` and
    ``sum_b t_b (a_b x u_b) = 0``, with ``u_b`` the unit vector of bar b toward the platform and
    ``a_b`` the arm of its end about the TCP.
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
