"""Readings of all kinds as a machine's model predicts them, with derivatives.

Each kind's formula becomes a CasADi function of the closed pose, the instrument's mounting, its
nuisances and its effects. Values, derivatives and the nonlinear programme use the same functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.instruments import POSE_SIZE, InstrumentPose, Mounted
from orthoglide.mechanism.compiled import blocks
from orthoglide.mechanism.six_bars import LINES
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.prediction.conditions import Conditions
from orthoglide.prediction.functions import Formula
from orthoglide.prediction.model import Model

_ROWS = 4096
"""Rows of a block, which bounds the memory for derivatives of their postures."""

JOINT_COUNT = len(VIRTUAL_NAMES) * 3
"""Virtual joints of the three legs."""

_POSE = np.arange(POSE_SIZE)  # the numbers of one pose, counted from its first

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


@dataclass(frozen=True)
class KindReadings:
    """Readings of one kind, ready for its formula."""

    formula: Formula
    rows: NDArray[np.intp]  # (m,)
    mounting_values: Array  # (m, M)
    effect_parameters: Array  # of the instruments' effects (m, max(D, 1))
    nuisance: Array  # (m, K)
    parameter_names: tuple[tuple[str, ...], ...]  # of the effects by setup of the table (setups, D)


@dataclass(frozen=True, eq=False)
class MeasurementModel:
    """Readings of one table with their instruments in place."""

    readings: Readings  # of any kinds; the measured values are not used
    # of every setup's instrument; in the base frame where absent
    instrument_poses: tuple[InstrumentPose, ...] = ()
    # places on plates over their largest measured radius (n, 2), along axes that turn with the
    # plate; zero where absent
    normalized_plate_xy: Array = field(default_factory=lambda: np.zeros((0, 2)))
    nuisance_values: Array | None = None  # of every setup (setups, K); zero where absent

    def __post_init__(self) -> None:
        if not self.instrument_poses:
            poses = (InstrumentPose(),) * len(self.readings.setups)
            object.__setattr__(self, "instrument_poses", poses)
        if not len(self.normalized_plate_xy):
            object.__setattr__(self, "normalized_plate_xy", np.zeros((len(self.readings), 2)))

    @cached_property
    def paired(self) -> NDArray[np.intp]:
        """Rows with a second command ``(k,)``."""
        return np.flatnonzero(self.readings.paired)

    @cached_property
    def first_output(self) -> NDArray[np.int64]:
        """Index in a posture's outputs of the first number that each reading needs ``(n,)``."""
        leg = self.readings.leg
        return np.where(leg >= 0, LINES.start + POSE_SIZE * leg, 0)

    @cached_property
    def _merged(self) -> dict[frozenset[str], tuple[Conditions, NDArray[np.intp]]]:
        """What :meth:`postures` returned, by the conditions that matter."""
        return {}

    def conditions(self) -> Conditions:
        """Return the conditions of every reading, then those of the second commands ``(N,)``."""
        first = Conditions.from_readings(self.readings).table
        second = first[self.paired]
        second[:, :3], second[:, 3:6] = self.readings.second[self.paired], 0.0
        return Conditions(np.concatenate([first, second]))

    def by_kind(self, model: Model, values: Mapping[str, float]) -> Iterator[KindReadings]:
        """Yield the readings of each kind, ready for their formulas."""
        r = self.readings
        for observation, rows in r.observations:
            effects = model.instrument_effects(observation)
            mounted = Mounted(
                r, rows, model.geometry, self.instrument_poses, self.normalized_plate_xy, effects
            )
            mounting = observation.mounting_values(mounted)
            names = tuple(
                model.instrument_parameters(observation, s.name)
                if s.observation is observation
                else ()
                for s in r.setups
            )
            table = np.zeros((len(r.setups), max(1, *map(len, names))))
            for row, of_setup in zip(table, names, strict=True):
                row[: len(of_setup)] = [values.get(name, 0.0) for name in of_setup]
            formula, setup = model.formula(observation, mounting.shape[1]), r.setup[rows]
            nuisance = np.zeros((len(rows), observation.nuisance_count))
            if self.nuisance_values is not None:
                nuisance = self.nuisance_values[setup, : observation.nuisance_count]
            yield KindReadings(formula, rows, mounting, table[setup], nuisance, names)

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Return the predicted readings ``(n,)``, with :attr:`nuisance_values`."""
        conditions, postures = self.postures(model, values)
        predicted, outputs = np.empty(len(self.readings)), model.outputs(values, conditions).values
        first, second = postures[..., None]
        pose = outputs[first, self.first_output[:, None] + _POSE]
        other = outputs[second, _POSE]
        for kind in self.by_kind(model, values):
            k, instrument = kind.rows, (kind.mounting_values, kind.nuisance, kind.effect_parameters)
            predicted[k] = kind.formula.value(pose[k], other[k], *instrument)[0][:, 0]
        return predicted

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Return the readings with their derivative by ``P`` parameters of machine and instruments,
        at the values of all that are not zero, SI.
        """
        column = {name: k for k, name in enumerate(names)}
        of_machine = [n for n in names if n in model.displacement_model.parameter_index]

        merged = self.postures(model, [*values, *names])
        found = self._derivatives(model, values, merged, of_machine)
        found.by_first[self.paired] += found.by_second
        jacobian, setup = np.zeros((len(self.readings), len(names))), self.readings.setup
        jacobian[:, [column[name] for name in of_machine]] = found.by_first
        for kind in found.kinds:
            for number, parameter_names in enumerate(kind.parameter_names):
                rows = kind.rows[setup[kind.rows] == number]
                for k, name in enumerate(parameter_names):
                    if name in column:
                        jacobian[rows, column[name]] = found.by_effect[rows, k]
        return LinearRows(found.value, jacobian, found.poses)

    def joint_response(self, model: Model, values: Mapping[str, float]) -> JointResponse:
        """Return the response of the readings to virtual joints that move with the conditions."""
        merged, n = self.postures(model, values), len(self.readings)
        found = self._derivatives(model, values, merged, None)

        def follow(joints: Array, functions: Array) -> Array:
            response = (found.by_first @ joints)[:, None] * functions[:n]
            response[self.paired] += (found.by_second @ joints)[:, None] * functions[n:]
            return np.asarray(response)

        return follow

    def postures(self, model: Model, names: Iterable[str]) -> tuple[Conditions, NDArray[np.intp]]:
        """Return the distinct conditions for the effects of the parameters ``names``, and for each
        reading the index among them of its command and of its second one ``(2, n)``; of the command
        again where there is no second.
        """
        needs = model.needed_conditions(names)
        if needs not in self._merged:
            conditions, index = self.conditions().merged(needs)
            first, second = np.split(index, [len(self.readings)])
            postures = np.stack([first, first])
            postures[1, self.paired] = second
            self._merged[needs] = conditions, postures
        return self._merged[needs]

    def _derivatives(
        self,
        model: Model,
        values: Mapping[str, float],
        merged: tuple[Conditions, NDArray[np.intp]],
        names: Sequence[str] | None,
    ) -> _Derivatives:
        """Return the readings and their derivatives by parameters of the machine, or without names
        by the virtual joints, computed in blocks of rows.

        The derivative of a reading is multiplied by that of its posture first, one row by a matrix.
        """
        (conditions, postures), kinds = merged, list(self.by_kind(model, values))
        count = JOINT_COUNT if names is None else len(names)
        found = _Derivatives.empty(kinds, len(self.readings), len(self.paired), count)
        order = np.argsort(postures[0], kind="stable")  # a block has few distinct postures
        for part in blocks(len(order), _ROWS):
            rows = order[part]
            distinct, index = np.unique(postures[:, rows], return_inverse=True)
            some = conditions.subset(distinct)
            outputs, tangent = model.tangent(values, some)
            by_names = None if names is None else model.joint_sensitivities(values, some, names)
            first, second = index.reshape(2, -1)
            followed = first[:, None], self.first_output[rows, None] + _POSE
            pose, other = outputs.values[followed], outputs.values[second[:, None], _POSE]
            by_pose, by_other = np.zeros((2, len(rows), POSE_SIZE))
            for kind in kinds:
                _, k, m = np.intersect1d(rows, kind.rows, True, return_indices=True)
                reading, by_pose[k], by_other[k], by_nuisance, by_effect = kind.formula.tangent(
                    pose[k], other[k],
                    kind.mounting_values[m], kind.nuisance[m], kind.effect_parameters[m],
                )  # fmt: skip
                found.value[rows[k]] = reading[:, 0]
                found.poses.nuisance_jacobian[rows[k], : by_nuisance.shape[1]] = by_nuisance
                found.by_effect[rows[k], : by_effect.shape[1]] = by_effect
            found.by_first[rows] = _chained(by_pose, tangent, followed, by_names)
            _, pair, k = np.intersect1d(self.paired, rows, True, return_indices=True)
            of_pair = second[k, None], _POSE
            found.by_second[pair] = _chained(by_other[k], tangent, of_pair, by_names)
            offset = np.einsum("nij,nj->ni", outputs.R[first], self.readings.beside[rows])
            found.poses.offset_from_tool[rows] = offset
            found.poses.p[rows] = outputs.p[first] + offset
        return found


def _chained(
    by_pose: Array, tangent: Array, followed: tuple[Any, Any], by_names: Array | None
) -> Array:
    """Return derivatives of readings by the quantities that move the postures ``(n, P)``.

    Args:
        by_pose: derivatives by the pose that each reads ``(n, 12)``.
        tangent: of the postures by travel and virtual joints ``(k, 48, 33)``.
        followed: posture ``(n, 1)`` and outputs of each pose, which index ``tangent``.
        by_names: of the virtual joints by parameters ``(k, 30, P)``; ``None``: by virtual joints.
    """
    posture, outputs = np.broadcast_arrays(*followed)
    count = JOINT_COUNT if by_names is None else by_names.shape[2]
    derivative = np.empty((len(by_pose), 1, count))
    for part in blocks(len(by_pose)):  # small enough for the cache
        by_joints = by_pose[part, None] @ tangent[posture[part], outputs[part], -JOINT_COUNT:]
        derivative[part] = by_joints if by_names is None else by_joints @ by_names[posture[part, 0]]
    return derivative[:, 0]


@dataclass(frozen=True)
class _Derivatives:
    """Readings of a table, and their derivatives by instruments and by ``P`` quantities that move
    the postures.
    """

    kinds: Sequence[KindReadings]  # the readings by kind
    value: Array  # (n,), metres or radians
    poses: ReadingPoses  # in which they are taken
    by_effect: Array  # by the effects of each reading's instrument (n, D)
    by_first: Array  # by way of the first, or the only, posture (n, P)
    by_second: Array  # by way of the second posture of readings that have one (k, P)

    @classmethod
    def empty(cls, kinds: Sequence[KindReadings], n: int, k: int, count: int) -> _Derivatives:
        """Return arrays to be filled, for ``n`` readings of which ``k`` have a second posture."""
        nuisance_count = max((kind.nuisance.shape[1] for kind in kinds), default=0)
        effect_count = max((kind.effect_parameters.shape[1] for kind in kinds), default=0)
        poses = ReadingPoses(np.zeros((n, nuisance_count)), np.empty((n, 3)), np.empty((n, 3)))
        by_effect, by_first = np.zeros((n, effect_count)), np.empty((n, count))
        return cls(kinds, np.empty(n), poses, by_effect, by_first, np.empty((k, count)))
