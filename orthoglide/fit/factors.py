"""What was read, as factors: each predicts its rows, differentiates them, and has its nuisances.

A *nuisance* is a number that the rows contain besides the machine: a dial's datum, where it stands,
the frame of a tracker. Nuisances enter linearly and are fitted
with everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.fit.instrument_frame import SMALL
from orthoglide.fit.noise import NoiseSource
from orthoglide.geometry import Array, moved_onto, small_turns
from orthoglide.observations import Campaign, Recorded, TcpPoints
from orthoglide.observations.approach import Ints
from orthoglide.prediction import Conditions, LinearRows, Model

Frame = Literal["none", "translation", "rigid"]

SILENT = 1e6
"""Times its sigma: a reading of no weight."""


def heard(sigma: Array) -> NDArray[np.bool_]:
    """Which of some readings have any weight ``(n,)``, by their sigmas."""
    return np.asarray(sigma < SILENT / 2 * np.min(sigma, initial=np.inf))


TCP_SIGMA = 1e-5
"""Metres: of a coordinate of a TCP point where its file declares none."""


ByJoints = Callable[[Array, Array], Array]
"""From a motion of the virtual joints ``(30,)`` and functions of the conditions ``(N, K)`` that it
follows, to the rows ``(n, K)`` by each."""


@dataclass(frozen=True)
class Block:
    """Nuisances of one factor."""

    columns: Array  # derivative of its rows by them (n, k)
    sd: Array  # standard deviation about zero (k,); infinite where nothing is known
    placement: NDArray[np.bool_]  # which of them are where a dial stands (k,)


@dataclass(frozen=True)
class OfFile:
    """Readings of one file, a row each."""

    points: Recorded  # the readings

    @property
    def name(self) -> str:
        """Of the file, without its ending."""
        return self.points.name

    @property
    def setup_names(self) -> tuple[str, ...]:
        """The mountings."""
        return tuple(s.name for s in self.points.setups)

    @property
    def measured(self) -> Array:
        """The readings."""
        return self.points.reading

    @property
    def turned(self) -> NDArray[np.bool_]:
        """Which are inclinations, radians ``(n,)``; all others are lengths, metres."""
        return self.points.angular

    @property
    def setup(self) -> Ints:
        """The mounting of each."""
        return self.points.setup

    @property
    def places(self) -> Array:
        """What is read where ``(n, k)``."""
        return self.points.places

    @property
    def stations(self) -> Array:
        """What makes visits the same ``(n, k)``."""
        return self.points.stations


@dataclass(frozen=True)
class DialReadings(OfFile):
    """Readings of dials on the legs: one campaign."""

    points: Campaign
    placement: float = 0.0  # standard deviation of a dial's place along its leg, metres; 0: exact

    def setups_of(self, effect: Effect) -> tuple[str, ...]:
        """Mountings of which an instrument's effect has parameters."""
        return self.setup_names if effect.dial is not None else ()

    def conditions(self) -> Conditions:
        """Of every reading."""
        return Conditions.of(self.points)

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Readings, datums apart."""
        return model.readings(values, self.points)

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Readings; the slope is by the dial's place along the leg."""
        return model.linearised(values, self.points, names)

    def by_joints(self, model: Model, values: Mapping[str, float]) -> ByJoints:
        """How the rows follow virtual joints that move as functions of the conditions."""
        slopes = model.readings_by_joints(values, self.points)
        return lambda joints, functions: (slopes @ joints)[:, None] * functions

    def nuisances(self, slopes: Array) -> Block:
        """A datum and a placement for each setup."""
        setups = len(self.points.setups)
        datum = np.eye(setups)[self.setup]
        columns, sd = [datum], [np.full(setups, np.inf)]
        if self.placement > 0:
            columns.append(datum * slopes)
            sd.append(np.full(setups, self.placement))
        placed = np.arange(setups * len(columns)) >= setups
        return Block(np.hstack(columns), np.concatenate(sd), placed)


@dataclass(frozen=True)
class TcpReadings:
    """Coordinates of the TCP by a tracker or a measuring machine, in its own frame."""

    points: TcpPoints  # the points; coordinates that are missing are no rows
    # how the instrument's frame may differ from the machine's: not at all, by a translation, or by
    # a translation and a small turn
    frame: Frame = "rigid"

    @property
    def name(self) -> str:
        """Of the file, without its ending."""
        return self.points.name

    @property
    def setup_names(self) -> tuple[str, ...]:
        """No dial has parameters here."""
        return ()

    def setups_of(self, effect: Effect) -> tuple[str, ...]:
        """No instrument's effect has parameters here."""
        return ()

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Which coordinates were measured ``(n, 3)``."""
        return np.isfinite(self.points.p)

    @property
    def measured(self) -> Array:
        """The coordinates, point by point."""
        return np.asarray(self.points.p[self.known])

    @property
    def turned(self) -> NDArray[np.bool_]:
        """None is an inclination ``(n,)``."""
        return np.zeros(len(self.measured), dtype=bool)

    @property
    def declared(self) -> Array:
        """Standard deviation of the coordinates of each point ``(m,)``, metres."""
        return np.nan_to_num(self.points.sigma, nan=TCP_SIGMA)

    @property
    def sigma(self) -> Array:
        """Standard deviation of each row, metres."""
        return np.asarray(self.declared[self.point])

    def rated(self) -> Iterator[tuple[str, Array, NoiseSource]]:
        """``points``, the standard deviations of its rows ``(n,)``, and where they come from."""
        own = self.sigma[heard(self.sigma)]
        yield "points", own, "declared" if (own != TCP_SIGMA).any() else "machine"

    @property
    def setup(self) -> Ints:
        """The coordinate of each row: 0, 1 or 2."""
        return np.nonzero(self.known)[1]

    @property
    def point(self) -> Ints:
        """The point of each row."""
        return np.nonzero(self.known)[0]

    def silenced(self, rows: NDArray[np.bool_]) -> TcpReadings:
        """The same with the points of some rows ``(n,)`` without weight."""
        silent = np.isin(np.arange(len(self.points)), self.point[rows])
        sigma = np.where(silent, SILENT * self.declared, self.declared)
        return replace(self, points=replace(self.points, sigma=sigma))

    def about(self, slopes: Array) -> TcpReadings:
        """The same with the frame turned to where a machine has each row's point ``(n, 3)``."""
        if self.frame != "rigid" or not self.known.all():
            return self
        measured, known = self.points.p, heard(self.declared)
        near = moved_onto(measured, measured[known], slopes[::3][known])
        centred = measured - measured.mean(axis=0)
        turned = np.linalg.norm(near - near.mean(axis=0) - centred)
        if turned <= SMALL * np.linalg.norm(centred):
            return self
        return replace(self, points=replace(self.points, p=near))

    @property
    def stations(self) -> Array:
        """Coordinate, command, approach of all axes ``(n, 7)``."""
        rows = np.column_stack([self.points.command, self.points.approach])[self.point]
        return np.column_stack([self.setup, rows])

    @property
    def places(self) -> Array:
        """Coordinate and command ``(n, 4)``."""
        return np.column_stack([self.setup, self.points.command[self.point]])

    def conditions(self) -> Conditions:
        """Of every point, machine unloaded."""
        return Conditions.at(self.points.command, approach=self.points.approach)

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Coordinates in the machine's frame."""
        return np.asarray(model.outputs(values, self.conditions()).p[self.known])

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Coordinates; the slopes are the point itself ``(n, 3)``."""
        out, by_name = model.sensitivities(values, self.conditions(), names)
        jacobian = np.asarray(by_name[:, :3][self.known])
        return LinearRows(np.asarray(out.p[self.known]), jacobian, out.p[self.point])

    def by_joints(self, model: Model, values: Mapping[str, float]) -> ByJoints:
        """How the rows follow virtual joints that move as functions of the conditions."""
        slopes = model.by_joints(values, self.conditions())[:, :3]

        def moved(joints: Array, functions: Array) -> Array:
            return np.asarray(((slopes @ joints)[:, :, None] * functions[:, None])[self.known])

        return moved

    def nuisances(self, slopes: Array) -> Block:
        """A datum a coordinate, and three turns, as far as the frame is free."""
        datum = np.eye(3)[self.setup]
        rigid = np.hstack([datum, small_turns(slopes, self.setup)])
        columns = {"none": datum[:, :0], "translation": datum, "rigid": rigid}[self.frame]
        # What no row shows (a coordinate that was never measured) is no nuisance.
        kept = np.abs(columns).max(axis=0, initial=0.0) > 0
        count = int(kept.sum())
        return Block(columns[:, kept], np.full(count, np.inf), np.zeros(count, dtype=bool))
