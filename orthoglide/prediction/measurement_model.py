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
    """Poses in which instruments take their readings."""

    nuisance_jacobian: Array  # derivative of the readings by the nuisances of their setups (n, K)
    p: Array  # position of the tool, or of the place beside it that is read (n, 3), metres
    offset_from_tool: Array  # of the place that is read, in the base frame (n, 3), metres


@dataclass(frozen=True)
class LinearRows:
    """Predicted readings around one machine, without nuisances."""

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


@dataclass
class Formulas:
    """Formulas of all kinds for one catalogue, built when they are needed."""

    catalogue: Catalogue
    _formulas: dict[tuple[str, int], Formula] = field(default_factory=dict)

    def effects(self, observation: Observation) -> tuple[Effect, ...]:
        """Return the effects of a kind's instrument, in the order of its formula."""
        return tuple(
            e for e in self.catalogue.instrument_effects if observation.kind_is_affected_by(e)
        )

    def parameter_names(self, observation: Observation, setup: str) -> tuple[str, ...]:
        """Return the names of the ``D`` parameters of a setup's instrument."""
        return tuple(str(n) for e in self.effects(observation) for n in e.parameters((setup,)))

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
        row_values = self.mounting_values[rows], self.nuisance[rows], self.effect_parameters[rows]
        return self.formula.tangent(pose, other, *row_values)


@dataclass(frozen=True)
class RowDerivatives:
    """Derivatives of some rows of a table."""

    rows: NDArray[np.intp]  # (m,)
    posture_index: NDArray[np.intp]  # of each row's posture within `outputs` (m,)
    paired: NDArray[np.bool_]  # which rows have a second posture (m,)
    outputs: Outputs  # of the distinct postures
    # by kind: itself, its rows, and their readings with derivatives by nuisances and effects
    derivatives_by_kind: tuple[Any, ...]
    posture_jacobian: Array  # derivative by the quantities that move the posture (m, P)
    second_posture_jacobian: Array  # derivative by way of the second postures of paired rows (k, P)


class MeasurementModel:
    """Readings of one table with their instruments in place.

    Args:
        readings: of any kinds; their values do not count.
        poses: of every setup's instrument; in the base frame where absent.
        plate_xy: places on plates over their largest measured radius ``(n, 2)``; zero where absent.
        nuisances: of every setup ``(setups, K)``; zero where absent.
    """

    def __init__(
        self,
        readings: Readings,
        poses: Sequence[InstrumentPose] = (),
        plate_xy: Array | None = None,
        nuisances: Array | None = None,
    ) -> None:
        self.readings, self.nuisances = readings, nuisances
        self.instrument_poses = tuple(poses) or (InstrumentPose(),) * len(readings.setups)
        self.normalized_plate_xy = np.zeros((len(readings), 2)) if plate_xy is None else plate_xy
        self.paired = np.flatnonzero(readings.paired)
        on_leg = readings.leg >= 0
        self.first_output = np.where(on_leg, LINES.start + POSE_SIZE * readings.leg, 0)

    def conditions(self) -> Conditions:
        """Return the conditions of every reading, then those of the second commands ``(N,)``."""
        first = Conditions.from_readings(self.readings).table
        second = first[self.paired]
        second[:, :3], second[:, 3:6] = self.readings.second[self.paired], 0.0
        return Conditions(np.concatenate([first, second]))

    def by_kind(self, model: Model, values: Mapping[str, float]) -> Iterator[KindReadings]:
        """Yield the readings of each kind, ready for their formulas."""
        r, formulas = self.readings, model.formulas
        for observation, rows in r.observations:
            effects = formulas.effects(observation)
            context = MountingContext(
                model.geometry, self.instrument_poses, self.normalized_plate_xy, effects
            )
            mounting = observation.mounting_values(r, rows, context)
            names = tuple(
                formulas.parameter_names(observation, s.name)
                if s.observation is observation
                else ()
                for s in r.setups
            )
            table = np.zeros((len(r.setups), max(1, *map(len, names))))
            for row, of_setup in zip(table, names, strict=True):
                row[: len(of_setup)] = [values.get(name, 0.0) for name in of_setup]
            formula, setup = formulas.formula(observation, mounting.shape[1]), r.setup[rows]
            nuisance = np.zeros((len(rows), observation.nuisance_count))
            if self.nuisances is not None:
                nuisance = self.nuisances[setup, : observation.nuisance_count]
            yield KindReadings(formula, rows, mounting, table[setup], nuisance, names)

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Return the predicted readings ``(n,)``, with the nuisances given to the constructor."""
        conditions, posture = model.merged_conditions(self, values)
        predicted = np.empty(len(self.readings))
        rows, postures = np.arange(len(predicted)), self._posture_indices(posture)
        pose, other = self._poses(model.outputs(values, conditions).values, rows, *postures)
        for kind in self.by_kind(model, values):
            k, instrument = kind.rows, (kind.mounting_values, kind.nuisance, kind.effect_parameters)
            predicted[k] = kind.formula.value(pose[k], other[k], *instrument)[0][:, 0]
        return predicted

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Return the readings with their derivative by parameters of machine and instruments.

        Args:
            model: of the machine.
            values: all parameters that are not zero, SI.
            names: the parameters to differentiate by ``P``.
        """
        conditions, posture = model.merged_conditions(self, [*values, *names])
        n, kinds = len(self.readings), list(self.by_kind(model, values))
        machine_parameters = model.displacement_model.parameter_index
        columns = np.flatnonzero([name in machine_parameters for name in names])
        value, jacobian = np.empty(n), np.zeros((n, len(names)))
        width = max((kind.nuisance.shape[1] for kind in kinds), default=0)
        poses = ReadingPoses(np.zeros((n, width)), np.empty((n, 3)), np.empty((n, 3)))

        def differentiate(postures: NDArray[np.intp]) -> tuple[Outputs, Array]:
            machine_names = [names[k] for k in columns.tolist()]
            return model.sensitivities(values, conditions.subset(postures), machine_names)

        for block in self._derivative_blocks(posture, kinds, differentiate):
            for kind, rows, reading, by_nuisance, by_value in block.derivatives_by_kind:
                value[rows] = reading[:, 0]
                poses.nuisance_jacobian[rows, : by_nuisance.shape[1]] = by_nuisance
                self._fill_instrument_columns(kind, by_value, rows, names, jacobian)
            block.posture_jacobian[block.paired] += block.second_posture_jacobian
            rows, outputs, place = block.rows, block.outputs, block.posture_index
            jacobian[np.ix_(rows, columns)] = block.posture_jacobian
            offset = np.einsum("nij,nj->ni", outputs.R[place], self.readings.beside[rows])
            poses.offset_from_tool[rows], poses.p[rows] = offset, outputs.p[place] + offset
        return LinearRows(value, jacobian, poses)

    def joint_response(self, model: Model, values: Mapping[str, float]) -> JointResponse:
        """Return the response of the readings to virtual joints that move with the conditions."""
        conditions, posture = model.merged_conditions(self, values)
        n, kinds, pairs = len(self.readings), list(self.by_kind(model, values)), self.paired
        slopes, second = np.zeros((n, JOINT_COUNT)), np.zeros((n, JOINT_COUNT))

        def differentiate(postures: NDArray[np.intp]) -> tuple[Outputs, Array]:
            outputs, tangent = model.tangent(values, conditions.subset(postures))
            return outputs, tangent[:, :, tangent.shape[2] - JOINT_COUNT :]

        for block in self._derivative_blocks(posture, kinds, differentiate):
            slopes[block.rows] = block.posture_jacobian
            second[block.rows[block.paired]] = block.second_posture_jacobian

        def follow(joints: Array, functions: Array) -> Array:
            response = (slopes @ joints)[:, None] * functions[:n]
            response[pairs] += (second[pairs] @ joints)[:, None] * functions[n:]
            return np.asarray(response)

        return follow

    # Postures of the readings --------------------------------------------------------------

    def _posture_indices(self, posture: NDArray[np.intp]) -> tuple[NDArray[np.intp], ...]:
        """Return the posture of each reading, and that of its second command where it has one, each
        ``(n,)``, from the posture of every condition ``(N,)``.
        """
        n = len(self.readings)
        second = posture[:n].copy()
        second[self.paired] = posture[n:]
        return posture[:n], second

    def _derivative_blocks(
        self,
        posture: NDArray[np.intp],
        kinds: Sequence[KindReadings],
        differentiate: Callable[[NDArray[np.intp]], tuple[Outputs, Array]],
    ) -> Iterator[RowDerivatives]:
        """Yield the derivatives of the readings in blocks of rows.

        Args:
            posture: of every condition ``(N,)``.
            kinds: the readings by kind.
            differentiate: from numbers of distinct postures ``(k,)`` to their outputs and the
                derivative of these ``(k, 48, P)``.
        """
        both = np.stack(self._posture_indices(posture))
        order = np.argsort(both[0], kind="stable")
        for part in blocks(len(order), _ROWS):
            rows = order[part]
            postures, index = np.unique(both[:, rows], return_inverse=True)
            first, second = index.reshape(2, -1)
            outputs, jacobian = differentiate(postures)
            pose, other = self._poses(outputs.values, rows, first, second)
            by_pose, by_other = np.zeros((2, len(rows), POSE_SIZE))
            by_kind = []
            for kind, kind_rows, k in _kinds_within(kinds, rows):
                reading, by_pose[k], by_other[k], *derivatives = kind.tangent(
                    pose[k], other[k], kind_rows
                )
                by_kind.append((kind, rows[k], reading, *derivatives))
            paired = np.isin(rows, self.paired)
            yield RowDerivatives(
                rows, first, paired, outputs, tuple(by_kind),
                self._chain_rule(jacobian, by_pose, self.first_output[rows], first),
                self._chain_rule(jacobian, by_other[paired], 0, second[paired]),
            )  # fmt: skip

    def _poses(
        self,
        outputs: Array,
        rows: NDArray[np.intp],
        first: NDArray[np.intp],
        second: NDArray[np.intp],
    ) -> tuple[Array, Array]:
        """Return the outputs of their postures, and of their second ones, that rows follow, each
        ``(m, 12)``.
        """
        columns = np.arange(POSE_SIZE)
        pose = outputs[first[:, None], self.first_output[rows, None] + columns]
        return pose, outputs[second[:, None], columns]

    @staticmethod
    def _chain_rule(
        by_given: Array, by_output: Array, start: NDArray[np.int64] | int, posture: NDArray[np.intp]
    ) -> Array:
        """Return the derivative of rows ``(m, P)`` by the quantities that move their postures.

        Args:
            by_given: derivative of the postures' outputs ``(k, 48, P)``.
            by_output: derivative of the rows by the outputs that they follow ``(m, 12)``.
            start: first of these outputs ``(m,)``.
            posture: of each row ``(m,)``.
        """
        start = np.broadcast_to(start, posture.shape)
        jacobian = np.empty((len(posture), by_given.shape[2]))
        for k in np.unique(start):
            rows = np.flatnonzero(start == k)
            outputs = by_given[posture[rows], k : k + POSE_SIZE]
            jacobian[rows] = (by_output[rows, None] @ outputs)[:, 0]
        return jacobian

    def _fill_instrument_columns(
        self,
        kind: KindReadings,
        by_value: Array,
        rows: NDArray[np.intp],
        names: Sequence[str],
        jacobian: Array,
    ) -> None:
        """Fill the columns of the instruments' parameters with derivatives ``(m, D)``."""
        setup = self.readings.setup[rows]
        for number, parameter_names in enumerate(kind.parameter_names):
            for column, name in enumerate(parameter_names):
                if name in names:
                    k = setup == number
                    jacobian[rows[k], list(names).index(name)] = by_value[k, column]


def _kinds_within(
    kinds: Sequence[KindReadings], rows: NDArray[np.intp]
) -> Iterator[tuple[KindReadings, NDArray[np.intp], NDArray[np.intp]]]:
    """Yield the kinds that contain some of the rows, with indices into the kind's rows and into
    ``rows``, both ``(k,)``.
    """
    for kind in kinds:
        _, k, kind_rows = np.intersect1d(rows, kind.rows, assume_unique=True, return_indices=True)
        if len(k):
            yield kind, kind_rows, k
