"""Readings of all kinds as a machine's model predicts them, with derivatives.

Each kind's formula becomes a CasADi function of the closed pose, the instrument's mounting, its
nuisances and its effects. Values, derivatives and the nonlinear programme use the same functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Catalogue, Effect
from orthoglide.geometry import Array
from orthoglide.instruments import (
    POSE_SIZE,
    InstrumentPose,
    MountingContext,
    Observation,
    ReadingVariables,
)
from orthoglide.mechanism.engine import Outputs
from orthoglide.mechanism.rows import RowFunction, blocks
from orthoglide.mechanism.six_bars import LINES
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.prediction.conditions import Conditions

if TYPE_CHECKING:
    from orthoglide.prediction.model import Model

_ROWS = 4096
"""Rows of a block, which bounds the memory for derivatives of their postures."""

JOINT_COUNT = len(VIRTUAL_NAMES) * 3
"""Virtual joints of the three legs."""

JointResponse = Callable[[Array, Array], Array]
"""From a direction of the virtual joints ``(30,)`` and functions of the conditions ``(N, K)`` to
the derivative of the readings by the coefficient of each function ``(n, K)``."""


@dataclass(frozen=True)
class ReadingPoses:
    """What instruments need to know of the poses in which they read."""

    nuisance_jacobian: Array  # derivative of the readings by the nuisances of their setups (n, K)
    p: Array  # where the tool, or the place beside it, is (n, 3), metres
    offset_from_tool: Array  # the place beside the tool, turned with the platform (n, 3), metres


@dataclass(frozen=True)
class LinearRows:
    """Predicted readings around one machine, nuisances apart."""

    value: Array  # (n,), metres or radians
    jacobian: Array  # by the parameters asked for (n, P), SI
    reading_poses: ReadingPoses


class Formula:
    """A kind's formula as CasADi functions of rows.

    Args:
        observation: the kind.
        effects: of its instrument, ``D`` parameters a setup.
        numbers: of a mounting, ``M``.

    Attributes:
        function: of pose ``(12,)``, other pose ``(12,)``, mounting ``(M,)``, nuisances ``(K,)`` and
            effects ``(max(D, 1),)``, the reading.
        value: the same for rows.
        tangent: the reading and its derivatives by pose, other pose, nuisances and effects.
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


@dataclass
class Formulas:
    """Formulas of all kinds for one catalogue, built when they are asked for."""

    catalogue: Catalogue
    _formulas: dict[tuple[str, int], Formula] = field(default_factory=dict)

    def effects(self, observation: Observation) -> tuple[Effect, ...]:
        """Return the effects of a kind's instrument, in the order of its formula."""
        return tuple(e for e in self.catalogue.instrument_effects if observation.is_affected_by(e))

    def parameter_names(self, observation: Observation, setup: str) -> list[str]:
        """Return names of the parameters of a setup's instrument ``D``."""
        return [str(n) for e in self.effects(observation) for n in e.parameters((setup,))]

    def formula(self, observation: Observation, numbers: int) -> Formula:
        """Return a kind's formula for mountings of ``numbers`` numbers."""
        key = observation.kind, numbers
        if key not in self._formulas:
            self._formulas[key] = Formula(observation, self.effects(observation), numbers)
        return self._formulas[key]


@dataclass(frozen=True)
class KindReadings:
    """Readings of one kind, ready for its formula."""

    formula: Formula
    rows: NDArray[np.intp]  # (m,)
    mounting_values: Array  # (m, M)
    effect_parameters: Array  # of the instruments' effects (m, max(D, 1))
    nuisance: Array  # (m, K)
    parameter_names: tuple[tuple[str, ...], ...]  # of the effects by setup of the table (setups, D)

    def tangent(self, pose: Array, other: Array, rows: NDArray[np.intp]) -> list[Array]:
        """Return some readings and their derivatives by both poses, nuisances and effects."""
        given = self.mounting_values[rows], self.nuisance[rows], self.effect_parameters[rows]
        return self.formula.tangent(pose, other, *given)


@dataclass(frozen=True)
class RowDerivatives:
    """Derivatives of some rows of a table."""

    rows: NDArray[np.intp]  # (m,)
    posture_index: NDArray[np.intp]  # place of each row's posture among those shown (m,)
    paired: NDArray[np.bool_]  # which rows have a second posture (m,)
    outputs: Outputs  # of the distinct postures
    # by kind: the part, its rows, and their readings with derivatives by nuisances and effects
    derivatives_by_kind: tuple[Any, ...]
    posture_jacobian: Array  # derivative by what moves the posture (m, P)
    second_posture_jacobian: Array  # the same for the second postures of paired rows (k, P)


class MeasurementModel:
    """Readings of one table with their instruments in place.

    Args:
        readings: of any kinds; their values do not count.
        stands: of every setup; in the base frame where absent.
        place: on the plates over the largest measured radius ``(n, 2)``; nothing where absent.
        nuisances: of every setup ``(setups, K)``; nothing where absent.
    """

    def __init__(
        self,
        readings: Readings,
        stands: Sequence[InstrumentPose] = (),
        place: Array | None = None,
        nuisances: Array | None = None,
    ) -> None:
        self.readings, self.nuisances = readings, nuisances
        self.instrument_poses = tuple(stands) or (InstrumentPose(),) * len(readings.setups)
        self.normalized_plate_xy = np.zeros((len(readings), 2)) if place is None else place
        self.paired = np.flatnonzero(readings.paired)
        on_leg = readings.leg >= 0
        self.first_output = np.where(on_leg, LINES.start + POSE_SIZE * readings.leg, 0)

    def conditions(self) -> Conditions:
        """Return the conditions of every reading, then those of the second commands ``(N,)``."""
        r, pairs = self.readings, self.paired
        one = Conditions.from_readings(r)
        if not len(pairs):
            return one
        other = one.table[pairs].copy()
        other[:, :3], other[:, 3:6] = r.second[pairs], 0.0
        return Conditions(np.concatenate([one.table, other]))

    def by_kind(self, model: Model, values: Mapping[str, float]) -> Iterator[KindReadings]:
        """Yield the readings of each kind, ready for their formulas."""
        r, formulas = self.readings, model.formulas
        for observation, rows in r.observations:
            effects = formulas.effects(observation)
            site = MountingContext(
                model.geometry, self.instrument_poses, self.normalized_plate_xy, effects
            )
            mounting = observation.mounting_values(r, rows, site)
            names = tuple(
                tuple(formulas.parameter_names(observation, s.name))
                if s.observation is observation
                else ()
                for s in r.setups
            )
            width = max(map(len, names))
            table = np.zeros((len(r.setups), max(width, 1)))
            for k, own in enumerate(names):
                table[k, : len(own)] = [values.get(name, 0.0) for name in own]
            formula, setup = formulas.formula(observation, mounting.shape[1]), r.setup[rows]
            nuisance = np.zeros((len(rows), observation.nuisance_count))
            if self.nuisances is not None:
                nuisance = self.nuisances[setup, : observation.nuisance_count]
            yield KindReadings(formula, rows, mounting, table[setup], nuisance, names)

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Return the predicted readings ``(n,)``, with the nuisances given to the constructor."""
        conditions, at = model.merged_conditions(self, values)
        rows, ends = np.arange(len(self.readings)), self._posture_indices(at)
        pose, other = self._poses(model.outputs(values, conditions).values, rows, *ends)
        found = np.empty(len(rows))
        for part in self.by_kind(model, values):
            k = part.rows
            given = pose[k], other[k], part.mounting_values, part.nuisance, part.effect_parameters
            found[k] = part.formula.value(*given)[0][:, 0]
        return found

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Return the readings with their derivative by parameters of machine and instruments.

        Args:
            model: of the machine.
            values: all parameters that are not zero, SI.
            names: the parameters to differentiate by ``P``.
        """
        conditions, at = model.merged_conditions(self, [*values, *names])
        n, parts = len(self.readings), list(self.by_kind(model, values))
        columns = np.array(
            [k for k, n in enumerate(names) if n in model.displacement_model.parameter_index],
            dtype=int,
        )
        machine = [names[k] for k in columns]
        value, jacobian = np.empty(n), np.zeros((n, len(names)))
        most = max((part.nuisance.shape[1] for part in parts), default=0)
        seen = ReadingPoses(np.zeros((n, most)), np.empty((n, 3)), np.empty((n, 3)))

        def moved(postures: NDArray[np.intp]) -> tuple[Outputs, Array]:
            return model.sensitivities(values, conditions.subset(postures), machine)

        for block in self._derivative_blocks(at, parts, moved):
            for part, rows, reading, by_nuisance, by_value in block.derivatives_by_kind:
                value[rows] = reading[:, 0]
                seen.nuisance_jacobian[rows, : by_nuisance.shape[1]] = by_nuisance
                self._fill_instrument_columns(part, by_value, rows, names, jacobian)
            along = block.posture_jacobian.copy()
            along[block.paired] += block.second_posture_jacobian
            jacobian[np.ix_(block.rows, columns)] = along
            p, R = block.outputs.p[block.posture_index], block.outputs.R[block.posture_index]
            swung = np.einsum("nij,nj->ni", R, self.readings.beside[block.rows])
            seen.offset_from_tool[block.rows], seen.p[block.rows] = swung, p + swung
        return LinearRows(value, jacobian, seen)

    def joint_response(self, model: Model, values: Mapping[str, float]) -> JointResponse:
        """Return how the readings follow virtual joints that move as functions of conditions."""
        conditions, at = model.merged_conditions(self, values)
        n, parts, pairs = len(self.readings), list(self.by_kind(model, values)), self.paired
        slopes, second = np.zeros((n, JOINT_COUNT)), np.zeros((n, JOINT_COUNT))

        def moved(postures: NDArray[np.intp]) -> tuple[Outputs, Array]:
            shown, by_given = model.tangent(values, conditions.subset(postures))
            return shown, by_given[:, :, by_given.shape[2] - JOINT_COUNT :]

        for block in self._derivative_blocks(at, parts, moved):
            slopes[block.rows] = block.posture_jacobian
            second[block.rows[block.paired]] = block.second_posture_jacobian

        def follow(joints: Array, functions: Array) -> Array:
            found = (slopes @ joints)[:, None] * functions[:n]
            found[pairs] += (second[pairs] @ joints)[:, None] * functions[n:]
            return np.asarray(found)

        return follow

    # Postures of the readings --------------------------------------------------------------

    def _posture_indices(self, at: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Posture of each reading, and of its second command, each ``(n,)``: the same where there
        is none.

        Args:
            at: posture of every condition ``(N,)``.
        """
        n = len(self.readings)
        second = at[:n].copy()
        second[self.paired] = at[n:]
        return at[:n], second

    def _derivative_blocks(
        self,
        at: NDArray[np.intp],
        parts: Sequence[KindReadings],
        moved: Callable[[NDArray[np.intp]], tuple[Outputs, Array]],
    ) -> Iterator[RowDerivatives]:
        """Yield the derivatives of the readings in blocks of rows.

        Args:
            at: posture of every condition ``(N,)``.
            parts: the readings by kind.
            moved: from numbers of distinct postures ``(k,)`` to their outputs and the derivative
                of these ``(k, 48, P)``.
        """
        firsts, seconds = self._posture_indices(at)
        order = np.argsort(firsts, kind="stable")
        for part in blocks(len(order), _ROWS):
            rows = order[part]
            both = np.concatenate([firsts[rows], seconds[rows]])
            postures, place = np.unique(both, return_inverse=True)
            first, second = np.split(place.reshape(-1), 2)
            shown, by = moved(postures)
            pose, other = self._poses(shown.values, rows, first, second)
            by_pose, by_other = np.zeros((2, len(rows), POSE_SIZE))
            found = []
            for one, k, here in _kinds_within(parts, rows):
                reading, by_pose[here], by_other[here], *more = one.tangent(
                    pose[here], other[here], k
                )
                found.append((one, rows[here], reading, *more))
            paired = np.isin(rows, self.paired)
            yield RowDerivatives(
                rows, first, paired, shown, tuple(found),
                self._chain_rule(by, by_pose, self.first_output[rows], first),
                self._chain_rule(by, by_other[paired], 0, second[paired]),
            )  # fmt: skip

    def _poses(
        self,
        outputs: Array,
        rows: NDArray[np.intp],
        first: NDArray[np.intp],
        second: NDArray[np.intp],
    ) -> tuple[Array, Array]:
        """Return what rows follow of their postures and of their second ones, each ``(m, 12)``."""
        columns = np.arange(POSE_SIZE)
        pose = outputs[first[:, None], self.first_output[rows, None] + columns]
        return pose, outputs[second[:, None], columns]

    @staticmethod
    def _chain_rule(
        outputs: Array, slopes: Array, start: NDArray[np.int64] | int, at: NDArray[np.intp]
    ) -> Array:
        """Derivative of rows ``(m, P)`` by what moves their postures.

        Args:
            outputs: derivative of the postures' outputs ``(k, 48, P)``.
            slopes: derivative of the rows by what they follow ``(m, 12)``.
            start: first of the outputs that each follows ``(m,)``.
            at: posture of each ``(m,)``.
        """
        start, found = np.broadcast_to(start, at.shape), np.empty((len(at), outputs.shape[2]))
        for k in np.unique(start):
            own = np.flatnonzero(start == k)
            found[own] = (slopes[own, None] @ outputs[at[own], k : k + POSE_SIZE])[:, 0]
        return found

    def _fill_instrument_columns(
        self,
        part: KindReadings,
        by_value: Array,
        rows: NDArray[np.intp],
        names: Sequence[str],
        jacobian: Array,
    ) -> None:
        """Fill the columns of the instruments' parameters with derivatives ``(m, D)``."""
        setup = self.readings.setup[rows]
        for k, own in enumerate(part.parameter_names):
            for column, name in enumerate(own):
                if name in names:
                    here = setup == k
                    jacobian[rows[here], list(names).index(name)] = by_value[here, column]


def _kinds_within(
    parts: Sequence[KindReadings], rows: NDArray[np.intp]
) -> Iterator[tuple[KindReadings, NDArray[np.intp], NDArray[np.intp]]]:
    """Yield the parts that have some of the rows, each with indices into the part and indices into
    ``rows``, both ``(k,)``.
    """
    for part in parts:
        _, here, k = np.intersect1d(rows, part.rows, assume_unique=True, return_indices=True)
        if len(k):
            yield part, k, here
