"""Readings of the tool as a factor: each kind predicts from the closed pose, with its nuisances.

The pose is the tool's place p and the platform's rotation R. A distance has two.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Catalogue, Effect
from orthoglide.fit.factors import SILENT, Block, ByJoints, OfFile, heard
from orthoglide.fit.instrument_frame import centre_of, turned_back
from orthoglide.fit.noise import FEWEST_REPEATS, NoiseSource, repeat_variance
from orthoglide.fit.tool_noise import LOUD, shown_sigma, usual_sigma
from orthoglide.geometry import Array, axial
from orthoglide.machine import Machine
from orthoglide.observations import ToolCampaign, source
from orthoglide.prediction import Conditions, LinearRows, Model

Ints = NDArray[np.int64]

SCALE_SD, OFFSET_SD = 0.01, 2e-4
"""What is known of a setup of distances: a printed part's shrinkage, the width of its pillars."""

_MOVED = 1e-4  # metres: the square of a smaller shift of a ball is less than a micrometre


@dataclass(frozen=True)
class ToolReadings(OfFile):
    """Readings of the tool's instruments."""

    points: ToolCampaign
    sigma: Array  # standard deviation of each (n,), metres or radians
    usual: Array  # the same as declared, or as is usual of such instruments (n,)
    # on the plates over their largest measured radius (n, 2), along their own axes, which turn with
    # them; of the nominal machine, which is near enough
    place: Array
    ball: Array  # centre of each setup's ball (setups, 3), metres, about which it is fitted
    # by how much single touches of a plate are above the surface of all others (n,), metres; 0 of
    # those that are not
    stray: Array
    left_out: tuple[str, ...] = ()  # strays that are none of these readings, each in a sentence

    @classmethod
    def of(
        cls, campaign: ToolCampaign, machine: Machine, noise: float | None = None
    ) -> ToolReadings:
        """Readings with their noise.

        Args:
            campaign: the readings.
            machine: its instruments say the noise, its nominal poses where plates and balls are.
            noise: standard deviation of one reading; replaces all others.
        """
        p = machine.forward(campaign.command) + campaign.beside
        place, ball = p[:, :2].copy(), []
        for k, setup in enumerate(campaign.setups):
            rows = campaign.setup == k
            place[rows] /= np.hypot(*p[rows, :2].T).max(initial=1e-3)
            place[rows] = place[rows] @ _turn(np.deg2rad(setup.turned))
            found = centre_of(p[rows], campaign.reading[rows]) if setup.kind == "ballbar" else None
            ball.append(np.zeros(3) if found is None else found)
        usual = usual_sigma(campaign, machine.spec.instruments, noise)
        sigma, stray = usual, np.zeros(len(campaign))
        if not noise:
            height = p[:, 2] - campaign.reading
            sigma, stray = shown_sigma(campaign, machine.spec.instruments, usual, place, height)
        return cls(campaign, sigma, usual, place, np.array(ball), stray)

    def without_strays(self, machine: Machine) -> ToolReadings:
        """The same without touches that are none of their surface, which it tells."""
        if not self.stray.any():
            return self
        kept, c = self.stray == 0, self.points
        p = machine.forward(c.command) + c.beside
        told = (
            f"{source(c)}, line {c.line[k]}, setup {c.setups[c.setup[k]].name!r}: the touch at x "
            f"{p[k, 0] * 1e3:.0f}, y {p[k, 1] * 1e3:.0f} mm is {abs(self.stray[k]) * 1e3:.2f} mm "
            f"{'above' if self.stray[k] > 0 else 'below'} the surface of all others, as a speck on "
            f"the plate or a bad touch is: it does not count; clean the plate and probe again"
            for k in np.flatnonzero(~kept)
        )
        return replace(
            self, points=c.subset(kept), sigma=self.sigma[kept], usual=self.usual[kept],
            place=self.place[kept], stray=self.stray[kept], left_out=tuple(told),
        )  # fmt: skip

    def loudness(self, setup: int) -> tuple[float, float]:
        """Noise of a setup's readings, and what is usual of them: root mean squares."""
        rows = self.setup == setup
        own, usual = (float(np.sqrt(np.mean(s[rows] ** 2))) for s in (self.sigma, self.usual))
        return own, usual

    def rated(self) -> Iterator[tuple[str, Array, NoiseSource]]:
        """Each kind of readings with the standard deviations of its rows ``(n,)``, and where they
        come from: repeats, or a plate's roughness, where they are not as expected beforehand.
        """
        for kind in dict.fromkeys(self.points.kind):
            rows = self.points.of_kind(kind) & heard(self.sigma)
            told = np.isfinite(self.points.sigma[rows]).all()
            expected = (self.sigma[rows] == self.usual[rows]).all()
            source: NoiseSource = "declared" if told else "machine" if expected else "repeats"
            yield kind, self.sigma[rows], source

    @cached_property
    def repeated(self) -> tuple[tuple[int, int], ...]:
        """How many readings have their noise from repeats, by kind, and the degrees of freedom
        behind it.
        """
        kinds = [(kind, len(own)) for kind, own, told in self.rated() if told == "repeats"]
        each = (repeat_variance([self.points.subset(self.points.of_kind(k))]) for k, _ in kinds)
        found = zip(kinds, each, strict=True)
        return tuple((n, dof) for (_, n), (_, dof) in found if dof >= FEWEST_REPEATS)

    @property
    def jumps(self) -> bool:
        """Whether heights of a plate jump from place to place by more than plates are rough."""
        return bool((self._on_plate & (self.sigma == LOUD * self.usual)).any())

    def sided(self, setup: int) -> bool:
        """Whether it is known from which side a setup's places were come to, on every axis; of
        distances, which have two ends, it never is, and is not asked.
        """
        approach = self.points.approach[self.setup == setup]
        return self.points.setups[setup].kind == "distance" or bool(approach.all())

    def setups_of(self, effect: Effect) -> tuple[str, ...]:
        """Setups of which an instrument's effect has parameters: plates."""
        return tuple(s.name for s in self.points.setups if s.kind == "plate" and effect.plate)

    @property
    def point(self) -> Ints:
        """The row itself: each reading stands alone."""
        return np.arange(len(self.points))

    def silenced(self, rows: NDArray[np.bool_]) -> ToolReadings:
        """The same with some rows ``(n,)`` without weight."""
        return replace(self, sigma=np.where(rows, SILENT * self.sigma, self.sigma))

    def about(self, value: Array, slopes: Array) -> ToolReadings:
        """The same with instruments' frames and balls brought to where a machine has them.

        Args:
            value: its rows ``(n,)``.
            slopes: its places ``(n, 4)``.
        """
        known = heard(self.sigma)
        points, ball = turned_back(self.points, value, known), self.ball.copy()
        for k, setup in enumerate(points.setups):
            if setup.kind == "ballbar":
                rows = (points.setup == k) & known
                ball[k] = centre_of(slopes[rows, :3], points.reading[rows])
        if points is self.points and np.abs(ball - self.ball).max(initial=0.0) < _MOVED:
            return self
        return replace(self, points=points, ball=ball)

    @cached_property
    def twice(self) -> NDArray[np.bool_]:
        """Which readings have a second command ``(n,)``."""
        return np.asarray(np.isfinite(self.points.second).all(axis=1))

    def conditions(self) -> Conditions:
        """Of every reading, then of the second commands."""
        c, both = self.points, self.twice

        def seen(values: Array, second: Array | None = None) -> Array:
            return np.concatenate([values, values[both] if second is None else second[both]])

        return Conditions(
            seen(c.command, c.second),
            seen(c.approach, np.zeros_like(c.approach)),
            seen(np.nan_to_num(c.time)),
            seen(c.temperature_rise),
            seen(c.load),
        )

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Readings, nuisances apart."""
        out = model.outputs(values, self.conditions())
        shape = self._shape(model.catalogue, values)
        return self._value(self._taken(out.p, out.R), out.R, shape)

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Readings; the slopes are the place that is read and the reading itself ``(n, 4)``."""
        catalogue = model.catalogue
        machine = [n for n in names if not catalogue.effect_of(n).of_dial]
        out, by_name = model.sensitivities(values, self.conditions(), machine)
        n = len(self.points)
        jacobian = np.zeros((n, len(names)))
        of_machine = [k for k, name in enumerate(names) if name in set(machine)]
        p = self._taken(out.p, out.R)
        jacobian[:, of_machine] = self._derivative(p, by_name[:, :12])
        for k, name in enumerate(names):
            if k not in of_machine:
                jacobian[:, k] = self._shape(catalogue, {name: 1.0})
        value = self._value(p, out.R, self._shape(catalogue, values))
        return LinearRows(value, jacobian, np.column_stack([p[:n], value]))

    def by_joints(self, model: Model, values: Mapping[str, float]) -> ByJoints:
        """How the rows follow virtual joints that move as functions of the conditions."""
        where = self.conditions()
        slopes, out = model.by_joints(values, where)[:, :12], model.outputs(values, where)
        p = self._taken(out.p, out.R)

        def moved(joints: Array, functions: Array) -> Array:
            return self._derivative(p, (slopes @ joints)[:, :, None] * functions[:, None])

        return moved

    def nuisances(self, slopes: Array) -> Block:
        """What each kind brings: plane, datum, scale and offset, centre and length."""
        columns, sd = [], []
        for k, setup in enumerate(self.points.setups):
            rows = np.flatnonzero(self.setup == k)
            for column, size in self._of_setup(k, setup.kind, rows, slopes[rows]):
                full = np.zeros(len(self.points))
                full[rows] = column
                if np.abs(full).max(initial=0.0) > 0:  # what no row shows is no nuisance
                    columns.append(full)
                    sd.append(size)
        matrix = np.array(columns).reshape(-1, len(self.points)).T
        return Block(matrix, np.array(sd), np.zeros(len(sd), dtype=bool))

    # What each kind reads -----------------------------------------------------------------

    def _of_setup(self, k: int, kind: str, rows: Ints, slopes: Array) -> list[tuple[Array, float]]:
        p, value, one, free = slopes[:, :3], slopes[:, 3], np.ones(len(rows)), np.inf
        axis, sign = self.points.axis[rows], self.points.sign[rows]
        if kind == "plate":
            return [(one, free), (p[:, 0], free), (p[:, 1], free)]
        if kind == "distance":
            return [(value, SCALE_SD), (one, OFFSET_SD)]
        if kind == "ballbar":
            toward = p - self.ball[k]
            toward = toward / np.maximum(np.linalg.norm(toward, axis=1), 1e-9)[:, None]
            return [*((toward[:, j], free) for j in range(3)), (one, free)]
        datums = [(sign * (axis == j), free) for j in range(3)]
        if kind == "incline" or len(np.unique(axis)) < 2:
            return datums
        turns = np.stack([np.cross(e, p) for e in np.eye(3)], axis=2)  # (n, xyz, about)
        own = sign[:, None] * turns[np.arange(len(rows)), axis]
        return [*datums, *((own[:, j], free) for j in range(3))]

    def _value(self, p: Array, R: Array, shape: Array) -> Array:
        n, rows = len(self.points), np.arange(len(self.points))
        axis, sign = self.points.axis, self.points.sign
        found = sign * p[rows, axis]
        of = self.points.of_kind
        found = np.where(of("plate"), p[:n, 2], found)
        found[self.twice] = np.linalg.norm(p[:n][self.twice] - p[n:], axis=1)
        found = np.where(of("ballbar"), np.linalg.norm(p[:n] - self._ball, axis=1), found)
        turn = axial(R[:n])
        return np.asarray(np.where(of("incline"), sign * turn[rows, axis], found) + shape)

    def _derivative(self, p: Array, by_name: Array) -> Array:
        """Of the readings ``(n, P)``, by that of places and rotations ``(N, 12, P)``."""
        n, rows = len(self.points), np.arange(len(self.points))
        axis, sign = self.points.axis, self.points.sign
        of, by_R = self.points.of_kind, by_name[:, 3:].reshape(len(by_name), 3, 3, -1)
        by_p = self._taken(by_name[:, :3], by_R)
        found = sign[:, None] * by_p[rows, axis]
        plate, ball, level = of("plate"), of("ballbar"), of("incline")
        found[plate] = by_p[:n, 2][plate]
        apart = p[:n][self.twice] - p[n:]
        apart /= np.maximum(np.linalg.norm(apart, axis=1), 1e-9)[:, None]
        found[self.twice] = np.einsum("ni,nip->np", apart, by_p[:n][self.twice] - by_p[n:])
        toward = p[:n] - self._ball
        toward /= np.maximum(np.linalg.norm(toward, axis=1), 1e-9)[:, None]
        found[ball] = np.einsum("ni,nip->np", toward, by_p[:n])[ball]
        found[level] = (sign[:, None] * axial(by_R[:n])[rows, axis])[level]
        return found

    def _taken(self, p: Array, R: Array) -> Array:
        """Where readings are taken, beside or below the tool, by its places ``(N, 3, ...)`` and
        rotations ``(N, 3, 3, ...)`` or derivatives of both. Plates' heights are about the mean, as
        a probe is set against the nozzle there, and no length is known as well as a touch.
        """
        beside = self.points.beside
        if not beside.any():
            return p
        swung = np.einsum("nij...,nj->ni...", R, np.concatenate([beside, beside[self.twice]]))
        for k in np.unique(self.setup[self._on_plate]):
            rows = np.flatnonzero(self.setup == k)
            swung[rows, 2] -= swung[rows, 2].mean(axis=0)
        return np.asarray(p + swung)

    @property
    def _ball(self) -> Array:
        return np.asarray(self.ball[self.setup])

    @cached_property
    def _on_plate(self) -> NDArray[np.bool_]:
        return self.points.of_kind("plate")

    def _shape(self, catalogue: Catalogue, values: Mapping[str, float]) -> Array:
        """What the plates' own shapes take from the readings ``(n,)``, metres."""
        found = np.zeros(len(self.points))
        for name, value in values.items():
            parameter = catalogue.parameter(name, self.setup_names) if value else None
            if parameter is None or not parameter.setup:
                continue
            effect = catalogue.effect_of(parameter)
            if effect.plate and parameter.setup in self.setup_names:
                rows = (self.setup == self.setup_names.index(parameter.setup)) & self._on_plate
                x, y = self.place[rows].T
                found[rows] -= value * effect.shape(parameter)(x, y)
        return found


def _turn(angle: float) -> Array:
    """By which rows of places ``(n, 2)`` are seen from axes turned counter-clockwise ``(2, 2)``."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
