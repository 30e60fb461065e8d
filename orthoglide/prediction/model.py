"""Conditions and parameters -> poses and readings, with sensitivities to all parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import CATALOGUE, Catalogue, LegConditions
from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.machine_file.model import Stiffness
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.batch import BatchClosure, Outputs
from orthoglide.mechanism.elastic import Deformation, ElasticClosure
from orthoglide.mechanism.functions import LINES, OUTPUTS
from orthoglide.mechanism.mapped import Mapped, blocks
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Campaign
from orthoglide.prediction.conditions import Conditions
from orthoglide.prediction.dial import (
    BY_GAUGE,
    dial_values,
    mountings,
    reading_function,
    reading_tangent,
)
from orthoglide.prediction.displacement import (
    COMMAND,
    FORCE,
    displacement_by_conditions,
    displacement_function,
    displacement_tangent,
    leg_conditions,
)
from orthoglide.prediction.load import force, force_by_command

_POSTURES = 4096
"""Whose derivatives by all parameters are held at once."""

_ALL = slice(None)


def _parts(place: NDArray[np.intp]) -> Iterator[tuple[slice, NDArray[np.intp], NDArray[np.intp]]]:
    """Postures in pieces, with the rows ``(n,)`` that show them and their posture within it."""
    order = np.argsort(place, kind="stable")
    for part in blocks(int(place.max(initial=-1)) + 1, _POSTURES):
        rows = order[slice(*np.searchsorted(place[order], [part.start, part.stop]))]
        yield part, rows, place[rows] - part.start


@dataclass(frozen=True)
class LinearRows:
    """Predicted readings around one machine, datums apart."""

    value: Array  # (n,), metres (radians of a level)
    jacobian: Array  # by the parameters asked for (n, P), SI
    # what their nuisances need to know of the pose (n, k); of dials the derivative by the dial's
    # place along the leg
    slopes: Array


class Model:
    """The general mechanism moved by the catalogue's effects.

    Args:
        geometry: nominal dimensions.
        pitch: of the drives' screws, metres; ``None`` where unknown.
        stiffness: of bars and legs, where known.
        catalogue: the effects that move it.
        compile: see :class:`~orthoglide.mechanism.batch.BatchClosure`.
    """

    def __init__(
        self,
        geometry: Geometry | None = None,
        pitch: float | None = None,
        *,
        stiffness: Stiffness | None = None,
        catalogue: Catalogue = CATALOGUE,
        compile: bool | None = None,
    ) -> None:
        self.catalogue = catalogue
        self._place: dict[str, int] = {name: k for k, name in enumerate(catalogue.parameters)}
        self.geometry = geometry or Geometry()
        self.pitch = pitch
        self.stiffness = stiffness or Stiffness()
        self.mechanism = Mechanism(self.geometry, compile=compile)
        self._compile = compile

    def __getstate__(self) -> dict[str, Any]:
        """What it was made with: CasADi functions do not travel and are built again."""
        built = {n for n, v in vars(type(self)).items() if isinstance(v, cached_property)}
        return {n: v for n, v in vars(self).items() if n not in built}

    @cached_property
    def elastic(self) -> ElasticClosure:
        """Elastic equilibrium of the mechanism with this machine's stiffness."""
        bar, torsion = self.stiffness.bar, self.stiffness.torsion
        tree = self.mechanism.tree
        return ElasticClosure(tree, bar=bar, torsion=torsion, compile=self._compile)

    def is_elastic(self, conditions: Conditions) -> bool:
        """Whether stiffness moves these postures: rigid bars leave it no say."""
        strained = bool(self.stiffness.torsion) or bool(conditions.load.any())
        return self.stiffness.bar is not None and strained

    def closing(
        self, values: Mapping[str, float], conditions: Conditions
    ) -> tuple[BatchClosure, Array]:
        """How these postures close, elastic or not, and what is given of them ``(n, 33 or 34)``."""
        given = self.mechanism.given(conditions.command, self.displacements(values, conditions))
        if self.is_elastic(conditions):
            return self.elastic, np.column_stack([given, conditions.load])
        return self.mechanism.batch, given

    def deformation(self, values: Mapping[str, float], conditions: Conditions) -> Deformation:
        """What the machine fights against in closed postures: deformation, forces, energy."""
        given = self.mechanism.given(conditions.command, self.displacements(values, conditions))
        loaded = np.column_stack([given, conditions.load])
        return self.elastic.deformation(self.elastic.close(loaded), loaded)

    @cached_property
    def displacement(self) -> Any:
        """CasADi function of the virtual joints' displacements, for the NLP."""
        return displacement_function(self.catalogue, self.geometry, self.pitch)

    @cached_property
    def _displacement(self) -> Mapped:
        return Mapped(self.displacement)

    @cached_property
    def _displacement_tangent(self) -> Mapped:
        return Mapped(displacement_tangent(self.displacement))

    @cached_property
    def _displacement_by_conditions(self) -> Mapped:
        return Mapped(displacement_by_conditions(self.displacement))

    @cached_property
    def reading(self) -> Any:
        """CasADi function of one dial's reading, for the NLP."""
        return reading_function(self.catalogue.of_dials)

    @cached_property
    def _reading(self) -> Mapped:
        return Mapped(self.reading)

    @cached_property
    def _reading_tangent(self) -> Mapped:
        return Mapped(reading_tangent(self.reading))

    def vector(self, values: Mapping[str, float]) -> Array:
        """All parameters of the machine ``(P,)``, SI, zero where not named; dials are skipped.

        Raises:
            InputError: for a name that is no parameter.
        """
        theta = np.zeros(len(self._place))
        for name, value in values.items():
            if name in self._place:
                theta[self._place[name]] = value
            elif not (effect := self.catalogue.effect_of(name)).of_dial:
                raise InputError(
                    f"there is no parameter {name!r}: {effect.name} has {', '.join(effect.motions)}"
                )
        return theta

    def seen(self, conditions: Conditions) -> Array:
        """Conditions as the displacement function takes them ``(n, 11)``."""
        return np.column_stack(
            [
                conditions.command,
                conditions.approach,
                conditions.time,
                conditions.warming,
                force(self.mechanism, conditions),
            ]
        )

    def displacements(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Displacements of the virtual joints ``(n, 30)``, metres and radians."""
        theta = self.vector(values)
        if not len(conditions) or not theta.any():
            return np.zeros((len(conditions), self.displacement.size1_out(0)))
        return self._displacement(theta, self.seen(conditions))[0]

    def jacobian(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """dp/drho ``(n, 3, 3)``; what rails and drives do moves along with the command."""
        batch, given = self.closing(values, conditions)
        _, by_given = batch.tangent(batch.close(given), given)
        (by_seen,) = self._displacement_by_conditions(self.vector(values), self.seen(conditions))
        moves = by_seen[:, :, COMMAND]
        if conditions.load.any():
            moves = moves + by_seen[:, :, FORCE] @ force_by_command(self.mechanism, conditions)
        by_virtual = by_given[:, :3, 3 : 3 + moves.shape[1]]
        return np.asarray(by_given[:, :3, :3] + by_virtual @ moves)

    def outputs(self, values: Mapping[str, float], conditions: Conditions) -> Outputs:
        """Poses and bars of closed postures.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        batch, given = self.closing(values, conditions)
        return batch.outputs(batch.close(given), given)

    def sensitivities(
        self, values: Mapping[str, float], conditions: Conditions, names: Sequence[str]
    ) -> tuple[Outputs, Array]:
        """Poses and bars, and their derivative ``(n, 48, P)`` by parameters, loops closed; zero by
        those of dials.
        """
        batch, given = self.closing(values, conditions)
        x, n, theta = batch.close(given), len(conditions), self.vector(values)
        machine = [k for k, name in enumerate(names) if not self.catalogue.effect_of(name).of_dial]
        places = [self._place[names[k]] for k in machine]
        outputs, by_name = np.empty((n, OUTPUTS)), np.zeros((n, OUTPUTS, len(names)))
        for part in blocks(n):  # small enough for the cache
            shown, by_given = batch.tangent(x[part], given[part])
            _, by_theta = self._displacement_tangent(theta, self.seen(conditions.part(part)))
            by_virtual = by_given[:, :, 3 : 3 + by_theta.shape[1]]
            outputs[part] = shown.values
            by_name[part][:, :, machine] = by_virtual @ by_theta[:, :, places]
        return Outputs(outputs), by_name

    def merged(
        self, conditions: Conditions, names: Iterable[str]
    ) -> tuple[Conditions, np.ndarray[Any, Any]]:
        """Distinct ones of ``n`` conditions, as far as the effects of ``names``, parameters in
        play, tell them apart.

        Returns:
            The distinct ones, and the place among them of each ``(n,)``.
        """
        return conditions.merged(self._needs(names))

    def _needs(self, names: Iterable[str]) -> frozenset[str]:
        """What tells conditions apart besides the command."""
        used = {name: self.catalogue.effect_of(name) for name in names}
        needs = frozenset[str]().union(*(e.needs for e in used.values() if not e.of_dial))
        # Forces cost a closure of their own: no load where nothing gives way to it.
        soft = frozenset() if self.stiffness.bar is None else frozenset({"load"})
        return needs | soft

    @cached_property
    def _prepared(self) -> WeakKeyDictionary[Campaign, dict[Any, Any]]:
        """What is the same for every set of parameters: merged conditions, mountings."""
        return WeakKeyDictionary()

    def _merged(
        self, campaign: Campaign, names: Iterable[str]
    ) -> tuple[Conditions, np.ndarray[Any, Any]]:
        kept, needs = self._prepared.setdefault(campaign, {}), self._needs(names)
        if needs not in kept:
            kept[needs] = Conditions.of(campaign).merged(needs)
        found: tuple[Conditions, np.ndarray[Any, Any]] = kept[needs]
        return found

    def readings(self, values: Mapping[str, float], campaign: Campaign) -> Array:
        """Readings ``(n,)``, datums apart, metres."""
        conditions, place = self._merged(campaign, values)
        lines = self.outputs(values, conditions).lines
        return self._reading(*self._dial_arguments(values, campaign, lines[place]))[0][:, 0]

    def _dial_arguments(
        self,
        values: Mapping[str, float],
        campaign: Campaign,
        lines: Array,
        rows: slice | NDArray[np.intp] = _ALL,
    ) -> tuple[Array, Array, Array]:
        leg = campaign.leg[rows]
        touched = lines[np.arange(len(leg)), leg].reshape(len(leg), 12)
        dials = dial_values(campaign, values, self.catalogue.of_dials)
        kept = self._prepared.setdefault(campaign, {})
        if "mountings" not in kept:
            kept["mountings"] = mountings(campaign, self.geometry)
        return touched, kept["mountings"][rows], dials[rows]

    def by_joints(self, values: Mapping[str, float], conditions: Conditions) -> Array:
        """Derivative of poses and bars by the virtual joints ``(n, 48, 30)``, loops closed."""
        batch, given = self.closing(values, conditions)
        _, by_given = batch.tangent(batch.close(given), given)
        return np.asarray(by_given[:, :, 3 : 3 + self.displacement.size1_out(0)])

    def readings_by_joints(self, values: Mapping[str, float], campaign: Campaign) -> Array:
        """Derivative of the readings by the virtual joints ``(n, 30)``, loops closed."""
        conditions, place = self._merged(campaign, values)
        lines = self.outputs(values, conditions).lines
        _, by_ends, _, _ = self._reading_tangent(
            *self._dial_arguments(values, campaign, lines[place])
        )
        found = np.empty((len(campaign), self.displacement.size1_out(0)))
        for part, rows, at in _parts(place):
            moved = self.by_joints(values, conditions.part(part))[:, LINES]
            ends = moved.reshape(len(moved), 3, 12, moved.shape[2])
            found[rows] = (by_ends[rows, None] @ ends[at, campaign.leg[rows]])[:, 0]
        return found

    def leg_conditions(
        self, values: Mapping[str, float], conditions: Conditions
    ) -> tuple[LegConditions, ...]:
        """What the effects of each leg see in ``n`` postures, as arrays."""
        seen = self.seen(conditions).T
        moves = self.displacements(values, conditions)
        drives = range(0, moves.shape[1], len(VIRTUAL_NAMES))
        return tuple(
            leg_conditions(self.geometry, self.pitch, seen, leg, moves[:, k])
            for leg, k in enumerate(drives)
        )

    def linearised(
        self, values: Mapping[str, float], campaign: Campaign, names: Sequence[str]
    ) -> LinearRows:
        """Readings with their derivative by parameters of the machine and of the dials.

        Args:
            values: all parameters that are not zero, SI.
            campaign: says conditions and setups.
            names: the parameters to differentiate by.
        """
        dials: dict[str, tuple[int, int]] = {
            name: (row, k)
            for k, effect in enumerate(self.catalogue.of_dials)
            for row, setup in enumerate(campaign.setups)
            for name in effect.parameters((setup.name,))
        }
        machine = [name for name in names if name in self._place]
        conditions, place = self._merged(campaign, [*values, *names])
        n = len(campaign)
        shown, by_gauge = np.empty(n), np.empty(n)
        by_dial = np.empty((n, len(self.catalogue.of_dials)))
        of_machine, jacobian = np.empty((n, len(machine))), np.zeros((n, len(names)))
        for part, rows, at in _parts(place):
            outputs, by_name = self.sensitivities(values, conditions.part(part), machine)
            value, by_ends, by_mounting, dial = self._reading_tangent(
                *self._dial_arguments(values, campaign, outputs.lines[at], rows)
            )
            ends = by_name[:, LINES].reshape(len(outputs.values), 3, 12, len(machine))
            of_machine[rows] = (by_ends[:, None] @ ends[at, campaign.leg[rows]])[:, 0]
            shown[rows], by_gauge[rows], by_dial[rows] = value[:, 0], by_mounting[:, BY_GAUGE], dial
        jacobian[:, [k for k, name in enumerate(names) if name in self._place]] = of_machine
        for column, name in zip(jacobian.T, names, strict=True):
            if name in dials:
                row, k = dials[name]
                column[:] = np.where(campaign.setup == row, by_dial[:, k], 0.0)
        return LinearRows(shown, jacobian, by_gauge[:, None])
