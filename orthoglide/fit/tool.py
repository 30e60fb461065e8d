"""Readings of the tool as a factor: each instrument predicts from the closed pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Catalogue, Effect
from orthoglide.fit.factors import SILENT, Block, ByJoints, OfFile, heard
from orthoglide.fit.instrument_frame import SMALL, centre_moves, centre_of, frame_of
from orthoglide.fit.noise import FEWEST_REPEATS, NoiseSource, repeat_variance
from orthoglide.fit.tool_noise import LOUD, shown_sigma, usual_sigma
from orthoglide.geometry import Array
from orthoglide.instruments import INSTRUMENTS, Instrument, Mounting, Pose, unit_vectors
from orthoglide.machine import Machine
from orthoglide.observations import ToolCampaign, source
from orthoglide.observations.approach import Ints
from orthoglide.prediction import Conditions, LinearRows, Model


@dataclass(frozen=True)
class ToolReadings(OfFile):
    """Readings of the tool's instruments."""

    points: ToolCampaign
    sigma: Array  # standard deviation of each (n,), metres or radians
    usual: Array  # the same as declared, or as is usual of such instruments (n,)
    # on the plates over their largest measured radius (n, 2), along their own axes, which turn with
    # them; of the nominal machine, which is near enough
    place: Array
    ball: Array  # from the middle of each setup's places to about its ball (setups, 3), metres
    # by how much single touches of a plate are above the surface of all others (n,), metres; 0 of
    # those that are not
    stray: Array
    turn: Array  # axes of each setup's frame, in the base (setups, 3, 3)
    left_out: tuple[str, ...] = ()  # strays that are none of these readings, each in a sentence

    @classmethod
    def of(
        cls, campaign: ToolCampaign, machine: Machine, noise: float | None = None
    ) -> ToolReadings:
        """Readings with their noise.

        Args:
            campaign: the readings.
            machine: its instruments say the noise, its nominal poses about where plates and balls
                are.
            noise: standard deviation of one reading; replaces all others.
        """
        p = machine.forward(campaign.command) + campaign.beside
        place, ball = p[:, :2].copy(), np.zeros((len(campaign.setups), 3))
        for k, setup in enumerate(campaign.setups):
            rows = campaign.setup == k
            place[rows] /= np.hypot(*p[rows, :2].T).max(initial=1e-3)
            place[rows] = place[rows] @ _turn(np.deg2rad(setup.turned))
            if setup.instrument.about_ball:
                ball[k] = centre_of(p[rows], campaign.reading[rows]) - p[rows].mean(axis=0)
        usual = usual_sigma(campaign, machine.spec.instruments, noise)
        sigma, stray = usual, np.zeros(len(campaign))
        if not noise:
            height = p[:, 2] - campaign.reading
            sigma, stray = shown_sigma(campaign, machine.spec.instruments, usual, place, height)
        turn = np.tile(np.eye(3), (len(campaign.setups), 1, 1))
        return cls(campaign, sigma, usual, place, ball, stray, turn)

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
        return bool((self.points.touching & (self.sigma == LOUD * self.usual)).any())

    def sided(self, setup: int) -> bool:
        """Whether it is known from which side a setup's places were come to, on every axis; of
        distances, which have two ends, it never is, and is not asked.
        """
        approach = self.points.approach[self.setup == setup]
        return self.points.setups[setup].instrument.paired or bool(approach.all())

    def setups_of(self, effect: Effect) -> tuple[str, ...]:
        """Setups of which an instrument's effect has parameters: plates."""
        return tuple(s.name for s in self.points.setups if s.instrument.touches and effect.plate)

    @property
    def point(self) -> Ints:
        """The row itself: each reading stands alone."""
        return np.arange(len(self.points))

    def silenced(self, rows: NDArray[np.bool_]) -> ToolReadings:
        """The same with some rows ``(n,)`` without weight."""
        return replace(self, sigma=np.where(rows, SILENT * self.sigma, self.sigma))

    def about(self, slopes: Array, start: bool = False) -> ToolReadings:
        """The same with instruments' frames turned to where a machine has them.

        Args:
            slopes: where it takes the readings, first ``(n, 3 or more)``, metres.
            start: whether nothing is known of the frames yet; else they are near.
        """
        turn, known, c = self.turn.copy(), heard(self.sigma), self.points
        for k, setup in enumerate(c.setups):
            rows = np.flatnonzero((self.setup == k) & known)
            sd = setup.instrument.turn_sd(c.axis[rows])
            if sd == 0 or not len(rows):
                continue
            found = frame_of(
                slopes[rows, :3], c.axis[rows], c.sign[rows] * c.reading[rows],
                self.sigma[rows], sd, None if start else turn[k],
            )  # fmt: skip
            if np.abs(found - turn[k]).max() > SMALL:
                turn[k] = found
        return self if (turn == self.turn).all() else replace(self, turn=turn)

    @cached_property
    def twice(self) -> NDArray[np.bool_]:
        """Which readings have a second command ``(n,)``."""
        return np.asarray(np.isfinite(self.points.second).all(axis=1))

    def conditions(self) -> Conditions:
        """Of every reading, then of the second commands."""
        c, both = self.points, self.twice

        def seen(values: Array, second: Array | None = None) -> Array:
            return np.concatenate([values, values[both] if second is None else second[both]])

        return Conditions.of_parts(
            seen(c.command, c.second),
            seen(c.approach, np.zeros_like(c.approach)),
            seen(np.nan_to_num(c.time)),
            seen(c.temperature_rise),
            seen(c.load),
        )

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Readings, nuisances apart."""
        out = model.outputs(values, self.conditions())
        pose = self._pose(out.p, out.R)
        return self._value(pose, self.mounting_at(pose.p), self._shape(model.catalogue, values))

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Readings; the slopes are the place that is read and the reading itself ``(n, 4)``."""
        catalogue = model.catalogue
        out, by_name = model.sensitivities(values, self.conditions(), names)
        pose = self._pose(out.p, out.R)
        mounting = self.mounting_at(pose.p)
        jacobian = self._derivative(pose, mounting, by_name[:, :12])
        for k, name in enumerate(names):
            if catalogue.effect_of(name).of_dial:
                jacobian[:, k] = self._shape(catalogue, {name: 1.0})
        value = self._value(pose, mounting, self._shape(catalogue, values))
        return LinearRows(value, jacobian, np.column_stack([pose.p, value]))

    def by_joints(self, model: Model, values: Mapping[str, float]) -> ByJoints:
        """How the rows follow virtual joints that move as functions of the conditions."""
        where = self.conditions()
        slopes, out = model.by_joints(values, where)[:, :12], model.outputs(values, where)
        pose = self._pose(out.p, out.R)
        mounting = self.mounting_at(pose.p)

        def moved(joints: Array, functions: Array) -> Array:
            moves = (slopes @ joints)[:, :, None] * functions[:, None]
            return self._derivative(pose, mounting, moves)

        return moved

    def nuisances(self, slopes: Array) -> Block:
        """What each instrument brings: plane, datum, scale and offset, centre and length."""
        columns, sd = [], []
        mounting = self.mounting_at(slopes[:, :3])
        for k, setup in enumerate(self.points.setups):
            rows = np.flatnonzero(self.setup == k)
            p, value = slopes[rows, :3], slopes[rows, 3]
            for column, size in setup.instrument.nuisances(p, value, mounting.at(rows)):
                full = np.zeros(len(self.points))
                full[rows] = column
                if np.abs(full).max(initial=0.0) > 0:  # what no row shows is no nuisance
                    columns.append(full)
                    sd.append(size)
        matrix = np.array(columns).reshape(-1, len(self.points)).T
        return Block(matrix, np.array(sd), np.zeros(len(sd), dtype=bool))

    # What each instrument reads -----------------------------------------------------------

    def mounting_at(self, p: Array) -> Mounting:
        """How the instruments stand, row by row, if the places that are read are ``(n, 3)``.

        A ball stands where its readings put it for just these places: about one that is held, a
        machine that moves as a whole, which nothing shows, would fit otherwise by the square of it.
        """
        ball = np.zeros_like(self.ball)
        for k, rows in self._about_balls():
            near = p[rows].mean(axis=0) + self.ball[k]
            ball[k] = centre_of(p[rows], self.points.reading[rows], near)
        axis, sign = self.points.axis, self.points.sign
        return Mounting(axis, sign, ball[self.setup], self.turn[self.setup])

    def _about_balls(self) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """Setups that read about a ball, each with the rows that say where it is."""
        known = heard(self.sigma)
        for k, setup in enumerate(self.points.setups):
            rows = np.flatnonzero((self.setup == k) & known)
            if setup.instrument.about_ball and len(rows):
                yield k, rows

    @cached_property
    def _instruments(self) -> list[tuple[Instrument, NDArray[np.intp]]]:
        """Those that read, each with its rows."""
        kinds = dict.fromkeys(self.points.kind)
        return [(INSTRUMENTS[k], np.flatnonzero(self.points.of_kind(k))) for k in kinds]

    def _pose(self, p: Array, R: Array) -> Pose:
        """Row by row, of the machine's places and rotations ``(N, ...)``."""
        taken, n = self._taken(p, R), len(self.points)
        return Pose(taken[:n], R[:n], self._apart(taken))

    def _apart(self, p: Array) -> Array:
        """From each row's second place ``(n, 3, ...)``, by places or their derivatives
        ``(N, 3, ...)``; nan where there is none.
        """
        n = len(self.points)
        found = np.full((n, *p.shape[1:]), np.nan)
        found[self.twice] = p[:n][self.twice] - p[n:]
        return found

    def _value(self, pose: Pose, mounting: Mounting, shape: Array) -> Array:
        found = np.empty(len(self.points))
        for instrument, rows in self._instruments:
            found[rows] = instrument.value(pose.at(rows), mounting.at(rows))
        return found + shape

    def _derivative(self, pose: Pose, mounting: Mounting, by_name: Array) -> Array:
        """Of the readings ``(n, P)``, by that of places and rotations ``(N, 12, P)``."""
        n, by_R = len(self.points), by_name[:, 3:].reshape(len(by_name), 3, 3, -1)
        by_p = self._taken(by_name[:, :3], by_R)
        by_pose = {"p": by_p[:n], "R": by_name[:n, 3:], "apart": self._apart(by_p)}
        found = np.zeros((n, by_name.shape[-1]))
        for instrument, rows in self._instruments:
            gradient = instrument.gradient(pose.at(rows), mounting.at(rows))
            for varied, slope in gradient.items():
                flat = slope.reshape(len(rows), -1)
                found[rows] += np.einsum("ni,nip->np", flat, by_pose[varied][rows])
        for k, known in self._about_balls():
            own, ball = self.setup == k, mounting.ball[known[0]]
            given = pose.p[known], self.points.reading[known], ball, by_p[known]
            found[own] -= unit_vectors(pose.p[own] - ball) @ centre_moves(*given)
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
        for k in np.unique(self.setup[self.points.touching]):
            rows = np.flatnonzero(self.setup == k)
            swung[rows, 2] -= swung[rows, 2].mean(axis=0)
        return np.asarray(p + swung)

    def _shape(self, catalogue: Catalogue, values: Mapping[str, float]) -> Array:
        """What the plates' own shapes take from the readings ``(n,)``, metres."""
        found = np.zeros(len(self.points))
        for name, value in values.items():
            parameter = catalogue.parameter(name, self.setup_names) if value else None
            if parameter is None or not parameter.setup:
                continue
            effect = catalogue.effect_of(parameter)
            if effect.plate and parameter.setup in self.setup_names:
                own = self.setup == self.setup_names.index(parameter.setup)
                rows = own & self.points.touching
                x, y = self.place[rows].T
                found[rows] -= value * effect.shape(parameter)(x, y)
        return found


def _turn(angle: float) -> Array:
    """By which rows of places ``(n, 2)`` are seen from axes turned counter-clockwise ``(2, 2)``."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
