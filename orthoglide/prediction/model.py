"""Conditions and parameters -> poses and readings, with sensitivities to all parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import CATALOGUE, Catalogue, LegConditions
from orthoglide.errors import ClosureError
from orthoglide.geometry import Array, Geometry
from orthoglide.machine_file.model import Stiffness
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.engine import Engine, Outputs, PinocchioEngine, SixBars
from orthoglide.mechanism.rows import blocks
from orthoglide.mechanism.six_bars import OUTPUT_SIZE, VIRTUAL_PER_LEG
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.prediction.conditions import Conditions
from orthoglide.prediction.displacement import (
    COMMAND,
    CONDITION_COUNT,
    FORCE,
    Displacements,
    leg_conditions,
)
from orthoglide.prediction.load import (
    STRETCHES,
    drive_forces,
    drive_forces_by_command,
    tensions,
    tensions_tangent,
)
from orthoglide.prediction.measurement_model import Formulas, LinearRows, MeasurementModel

# Each round of stretching leaves of the last one's error the share of its length by which a bar
# gives, a hundred-thousandth as a rule: three rounds, and some more where bars are of rubber.
_MAX_ELASTIC_ROUNDS = 200
_ELASTIC_TOLERANCE = 1e-14  # metres by which bars still change: what is left is that share of it


class Model:
    """The general mechanism moved by the catalogue's effects.

    Args:
        geometry: nominal dimensions.
        pitch: of the drives' screws, metres; ``None`` where unknown.
        stiffness: of the bars, where known.
        catalogue: the effects that move it.
        urdf: folder of the machine's URDF; the one of ``geometry`` where absent.
        compile: see :class:`~orthoglide.mechanism.engine.SixBars`.
        engine: ``"pinocchio"`` closes every posture with Pinocchio's constraint Jacobian.
    """

    def __init__(
        self,
        geometry: Geometry | None = None,
        pitch: float | None = None,
        *,
        stiffness: Stiffness | None = None,
        catalogue: Catalogue = CATALOGUE,
        urdf: str = "",
        compile: bool | None = None,
        engine: Literal["six bars", "pinocchio"] = "six bars",
    ) -> None:
        self.catalogue = catalogue
        self.geometry = geometry or Geometry()
        self.pitch = pitch
        self.stiffness = stiffness or Stiffness()
        self.urdf = urdf
        self._compile, self._engine = compile, engine

    def __getstate__(self) -> dict[str, Any]:
        """What it was made with: CasADi functions do not travel and are built again."""
        built = {n for n, v in vars(type(self)).items() if isinstance(v, cached_property)}
        return {n: v for n, v in vars(self).items() if n not in built}

    def _copy_with(self, **changes: Any) -> Model:
        """Return a model made as this one, but for some arguments."""
        made: dict[str, Any] = {
            "geometry": self.geometry, "pitch": self.pitch, "stiffness": self.stiffness,
            "catalogue": self.catalogue, "urdf": self.urdf, "compile": self._compile,
            "engine": self._engine,
        }  # fmt: skip
        return Model(**{**made, **changes})

    def by_pinocchio(self) -> Model:
        """Return the same model, every posture closed by Pinocchio."""
        return self._copy_with(engine="pinocchio")

    def with_catalogue(self, catalogue: Catalogue) -> Model:
        """Return the same model moved by other effects, which shares the engine."""
        found = self._copy_with(catalogue=catalogue)
        found.__dict__.update(
            {n: vars(self)[n] for n in ("mechanism", "engine") if n in vars(self)}
        )
        return found

    @cached_property
    def mechanism(self) -> Mechanism:
        """The Pinocchio model with its constraints, without errors."""
        return Mechanism(self.geometry, urdf=self.urdf)

    @cached_property
    def engine(self) -> Engine:
        """The engine that closes postures."""
        if self._engine == "pinocchio":
            return PinocchioEngine(self.mechanism)
        return SixBars(self.mechanism, compile=self._compile)

    @property
    def _compliance(self) -> float:
        """Compliance of a bar, m/N."""
        return 0.0 if self.stiffness.bar is None else 1 / self.stiffness.bar

    def is_elastic(self, conditions: Conditions) -> bool:
        """Return whether the load deforms the bars in these postures."""
        return self.stiffness.bar is not None and bool(conditions.load.any())

    def _travel(self, conditions: Conditions) -> Array:
        return conditions.command - self.geometry.zero

    def loaded_displacements(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Displacements of the virtual joints ``(n, 30)``, elastic bars included."""
        return self._loaded_displacements(self.parameter_vector(values), conditions)

    def _loaded_displacements(self, theta: Array, conditions: Conditions) -> Array:
        moves = self.displacements_of_vector(theta, conditions)
        if not self.is_elastic(conditions):
            return moves
        travel, loaded = self._travel(conditions), moves.copy()
        for _ in range(_MAX_ELASTIC_ROUNDS):
            tension = tensions(self.engine.outputs(travel, loaded), conditions.load)
            stretched = moves[:, STRETCHES] + tension * self._compliance
            change = np.abs(stretched - loaded[:, STRETCHES]).max(axis=1)
            loaded[:, STRETCHES] = stretched
            if change.max() <= _ELASTIC_TOLERANCE * max(1.0, self.geometry.scale):
                return loaded
        worst, count = int(np.argmax(change)), len(moves)
        which = f"posture {worst + 1} of {count}: " if count > 1 else ""
        raise ClosureError(f"{which}the bars find no equilibrium under the load", index=(worst,))

    def tensions(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Pull in the bars ``(n, leg, bar)`` that holds the platform under the load, newtons."""
        return tensions(self.outputs(values, conditions), conditions.load).reshape(-1, 3, 2)

    def tangent(self, values: Mapping[str, float], conditions: Conditions) -> tuple[Outputs, Array]:
        """What postures show, and its derivative ``(n, 48, 33)`` by travel and displacements."""
        moves = self.loaded_displacements(values, conditions)
        shown, by_given = self.engine.tangent(self._travel(conditions), moves)
        if self.is_elastic(conditions):
            tension = tensions(shown, conditions.load)
            places = [3 + k for k in STRETCHES]
            stretched = tensions_tangent(shown, by_given, tension) * self._compliance
            # Stretches change the tensions too.
            settled = np.linalg.solve(np.eye(6) - stretched[:, :, places], stretched)
            by_given = by_given + by_given[:, :, places] @ settled
        return shown, by_given

    @cached_property
    def displacement_model(self) -> Displacements:
        """Map from parameters and conditions to displacements of the virtual joints."""
        return Displacements(self.catalogue, self.geometry, self.pitch, self._compile)

    @cached_property
    def formulas(self) -> Formulas:
        """Formulas of all kinds of readings."""
        return Formulas(self.catalogue)

    def parameter_vector(self, values: Mapping[str, float]) -> Array:
        """All parameters of the machine ``(P,)``, see :meth:`Displacements.vector`."""
        return self.displacement_model.parameter_vector(values)

    def condition_vectors(self, conditions: Conditions) -> Array:
        """Conditions as the displacement function takes them ``(n, 11)``."""
        seen = np.zeros((len(conditions), CONDITION_COUNT))
        seen[:, : FORCE.start] = conditions.table[:, : FORCE.start]
        if conditions.load.any():
            seen[:, FORCE] = drive_forces(self.engine, self._travel(conditions), conditions.load)
        return seen

    def displacements(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Displacements of the virtual joints ``(n, 30)`` by parameters, metres and radians."""
        return self.displacements_of_vector(self.parameter_vector(values), conditions)

    def displacements_of_vector(self, theta: Array, conditions: Conditions) -> Array:
        """Return displacements ``(n, 30)`` for all parameters ``(P,)`` of the machine."""
        if not len(conditions) or not theta.any():
            return np.zeros((len(conditions), 3 * VIRTUAL_PER_LEG))
        return self.displacement_model.evaluate(theta, self.condition_vectors(conditions))

    def jacobian(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """dp/drho ``(n, 3, 3)``; what rails and drives do moves along with the command."""
        _, by_given = self.tangent(values, conditions)
        by_seen = self.displacement_model.condition_jacobian(
            self.parameter_vector(values), self.condition_vectors(conditions)
        )
        moves = by_seen[:, :, COMMAND]
        if conditions.load.any():
            forces = drive_forces_by_command(self.engine, self._travel(conditions), conditions.load)
            moves = moves + by_seen[:, :, FORCE] @ forces
        return np.asarray(by_given[:, :3, :3] + by_given[:, :3, 3:] @ moves)

    def outputs(self, values: Mapping[str, float], conditions: Conditions) -> Outputs:
        """Poses and bars of closed postures.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        return self.outputs_of_vector(self.parameter_vector(values), conditions)

    def outputs_of_vector(self, theta: Array, conditions: Conditions) -> Outputs:
        """Return poses and bars of closed postures for all parameters ``(P,)`` of the machine."""
        return self.engine.outputs(
            self._travel(conditions), self._loaded_displacements(theta, conditions)
        )

    def sensitivities(
        self, values: Mapping[str, float], conditions: Conditions, names: Sequence[str]
    ) -> tuple[Outputs, Array]:
        """Poses and bars, and their derivative ``(n, 48, P)`` by parameters, loops closed; zero by
        those of dials.
        """
        n, theta = len(conditions), self.parameter_vector(values)
        machine = [k for k, name in enumerate(names) if not self.catalogue.effect_of(name).of_dial]
        places = [self.displacement_model.parameter_index[names[k]] for k in machine]
        outputs, by_name = np.empty((n, OUTPUT_SIZE)), np.zeros((n, OUTPUT_SIZE, len(names)))
        for part in blocks(n):  # small enough for the cache
            some = conditions.subset(part)
            shown, by_given = self.tangent(values, some)
            by_theta = self.displacement_model.parameter_jacobian(
                theta, self.condition_vectors(some)
            )
            outputs[part] = shown.values
            by_name[part][:, :, machine] = by_given[:, :, 3:] @ by_theta[:, :, places]
        return Outputs(outputs), by_name

    def merged(
        self, conditions: Conditions, names: Iterable[str]
    ) -> tuple[Conditions, np.ndarray[Any, Any]]:
        """Distinct ones of ``n`` conditions, as far as the effects of ``names``, parameters in
        play, tell them apart.

        Returns:
            The distinct ones, and the place among them of each ``(n,)``.
        """
        return conditions.merged(self._needed_conditions(names))

    def _needed_conditions(self, names: Iterable[str]) -> frozenset[str]:
        """What tells conditions apart besides the command."""
        used = {name: self.catalogue.effect_of(name) for name in names}
        needs = frozenset[str]().union(*(e.needs for e in used.values() if not e.of_dial))
        # Forces cost a closure of their own: no load where nothing gives way to it.
        soft = frozenset() if self.stiffness.bar is None else frozenset({"load"})
        return needs | soft

    @cached_property
    def _merged_cache(self) -> WeakKeyDictionary[Readings, dict[Any, Any]]:
        """What is the same for every set of parameters: merged conditions."""
        return WeakKeyDictionary()

    def merged_conditions(
        self, observed: MeasurementModel, names: Iterable[str]
    ) -> tuple[Conditions, NDArray[np.intp]]:
        """Return :meth:`merged` conditions of readings, kept for the next call."""
        kept, needs = (
            self._merged_cache.setdefault(observed.readings, {}),
            self._needed_conditions(names),
        )
        if needs not in kept:
            kept[needs] = observed.conditions().merged(needs)
        found: tuple[Conditions, NDArray[np.intp]] = kept[needs]
        return found

    def joint_jacobian(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Derivative of poses and bars by the virtual joints ``(n, 48, 30)``, loops closed."""
        return np.asarray(self.tangent(values, conditions)[1][:, :, 3:])

    def leg_conditions(
        self, values: Mapping[str, float], conditions: Conditions
    ) -> tuple[LegConditions, ...]:
        """What the effects of each leg see in ``n`` postures, as arrays."""
        seen = self.condition_vectors(conditions).T
        moves = self.displacements(values, conditions)
        size, drives = (
            self.displacement_model.dimensions,
            range(0, moves.shape[1], len(VIRTUAL_NAMES)),
        )
        return tuple(
            leg_conditions(size, seen, leg, moves[:, k], self.pitch is not None)
            for leg, k in enumerate(drives)
        )

    def readings(self, values: Mapping[str, float], readings: Readings) -> Array:
        """Return readings ``(n,)`` to expect of instruments in the base frame, nuisances apart."""
        return MeasurementModel(readings).predict(self, values)

    def linearised(
        self, values: Mapping[str, float], readings: Readings, names: Sequence[str]
    ) -> LinearRows:
        """Return the same with their derivative by parameters; arguments as of
        :meth:`Observed.linearise`.
        """
        return MeasurementModel(readings).linearise(self, values, names)
