"""Readings with their noise and their instruments in place: what a problem is the sum of.

A factor predicts its rows, differentiates them, and has nuisances: numbers that the rows contain
besides the machine, such as a dial's datum, where it stands, or the frame of a tracker. Nuisances
are fitted with everything else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.fit.noise import NoiseSource, RowNoise, expected_sigma
from orthoglide.fit.repeats import MIN_REPEAT_DOF, repeat_variance
from orthoglide.fit.roughness import MAX_NOISE_RATIO, roughness
from orthoglide.geometry import Array
from orthoglide.instruments import Frame, InstrumentPose, InstrumentPriors, SetupReadings
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import Readings, source
from orthoglide.observations.approach import Ints
from orthoglide.observations.arrays import group_ids
from orthoglide.prediction import Conditions, LinearRows, MeasurementModel, Model, ReadingPoses
from orthoglide.prediction.measurement_model import JointResponse


@dataclass(frozen=True)
class NuisanceBlock:
    """Nuisances of one factor."""

    columns: Array  # derivative of its rows by them (n, k)
    sd: Array  # standard deviation about zero (k,); infinite where nothing is known


@dataclass(frozen=True)
class Factor:
    """Readings of one table: all of legs, or all of the tool."""

    readings: Readings
    noise: RowNoise
    instrument_priors: InstrumentPriors  # of how instruments stand
    instrument_poses: tuple[InstrumentPose, ...]  # of every setup
    # on the plates over their largest measured radius (n, 2), along their own axes, which turn with
    # them; of the nominal machine, which is near enough
    normalized_plate_xy: Array
    # height of outlying touches of a plate above the surface through the others (n,), metres;
    # 0 of all other readings
    outlier_height: Array
    exclusion_sentences: tuple[
        str, ...
    ] = ()  # a sentence for each outlying touch that was excluded

    @classmethod
    def from_readings(
        cls,
        readings: Readings,
        machine: Machine,
        noise: RowNoise,
        beliefs: InstrumentPriors | None = None,
    ) -> Factor:
        """Return readings with their instruments about where a machine has them.

        Args:
            readings: of legs, or of the tool.
            machine: its nominal poses say where plates, balls and frames are.
            noise: of the readings.
            beliefs: of how instruments stand; as the machine file says where absent.
        """
        if beliefs is None:
            beliefs = machine_instrument_priors(machine)
        n = len(readings)
        made = cls(
            readings, noise, beliefs, (InstrumentPose(),) * len(readings.setups), np.zeros((n, 2)),
            np.zeros(n),
        )  # fmt: skip
        if made.on_legs:
            return made
        p, beside = machine.forward(readings.command), readings.beside
        made = replace(made, normalized_plate_xy=_normalized_plate_xy(readings, p + beside))
        return made.with_instrument_poses(
            ReadingPoses(np.zeros((n, 0)), p + beside, beside), initial=True
        )

    @classmethod
    def from_planned(cls, readings: Readings, machine: Machine) -> Factor:
        """Return readings that were not taken yet, with the noise to reckon with."""
        sigma, n = expected_sigma(readings, machine.spec), len(readings)
        noise = replace(RowNoise.zeros(n), sigma=sigma, expected=sigma)
        return cls.from_readings(readings, machine, noise)

    # What is read --------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name of the file, without its ending."""
        return self.readings.name

    @property
    def on_legs(self) -> bool:
        """Whether the readings are taken on legs; else they are taken at the tool."""
        return bool(self.readings.on_legs.all())

    @property
    def setup_names(self) -> tuple[str, ...]:
        """Names of the mountings."""
        return tuple(s.name for s in self.readings.setups)

    @property
    def sigma(self) -> Array:
        """Standard deviation of each row ``(n,)``, metres or radians."""
        return self.noise.sigma

    @property
    def measured(self) -> Array:
        """The readings ``(n,)``."""
        return self.readings.reading

    @property
    def setup(self) -> Ints:
        """The mounting of each row ``(n,)``."""
        return self.readings.setup

    @cached_property
    def visit_number(self) -> Ints:
        """Number of the visit at which each row was read ``(n,)``: coordinates of one point of the
        tool are wrong together.
        """
        if not self.readings.by_point:
            return np.arange(len(self.readings))
        return np.unique(self.readings.order, return_inverse=True)[1].reshape(-1)

    @cached_property
    def station(self) -> Ints:
        """Number of the station of each row ``(n,)``: visits that differ in nothing share one."""
        return group_ids(self.readings.stations)

    @cached_property
    def place_number(self) -> Ints:
        """Number of the place of each row ``(n,)``: setup and command, whatever the approach."""
        return group_ids(self.readings.places)

    def setups_of(self, effect: Effect) -> tuple[str, ...]:
        """Return the setups of which an instrument's effect has parameters."""
        return tuple(s.name for s in self.readings.setups if s.takes(effect))

    # Other factors -------------------------------------------------------------------------

    def with_readings(self, reading: Array) -> Factor:
        """Return the same for other values ``(n,)``, metres or radians."""
        return replace(self, readings=self.readings.with_readings(reading))

    def with_table(self, readings: Readings) -> Factor:
        """Return the same with a changed table of as many rows."""
        more = len(readings.setups) - len(self.instrument_poses)
        stands = (*self.instrument_poses, *(InstrumentPose(),) * more)
        return replace(self, readings=readings, instrument_poses=stands)

    def subset(self, rows: NDArray[Any]) -> Factor:
        """Return some of the rows, by indices or booleans ``(n,)``."""
        used = np.unique(self.setup[rows])
        return replace(
            self, readings=self.readings.subset(rows), noise=self.noise.subset(rows),
            instrument_poses=tuple(self.instrument_poses[k] for k in used), normalized_plate_xy=self.normalized_plate_xy[rows],
            outlier_height=self.outlier_height[rows],
        )  # fmt: skip

    def with_noise(self, rows: NDArray[np.intp], noise: RowNoise) -> Factor:
        """Return the same with other noise of some rows."""
        return replace(self, noise=self.noise.with_rows(rows, noise))

    def without_weight(self, rows: NDArray[np.bool_]) -> Factor:
        """Return the factor with the visits of some rows ``(n,)`` without weight."""
        visits = np.isin(self.visit_number, self.visit_number[rows])
        return replace(self, noise=self.noise.without_weight(visits))

    def with_instrument_poses(self, seen: ReadingPoses, initial: bool = False) -> Factor:
        """Return the same with instruments standing where a machine has them.

        Args:
            seen: where it takes the readings.
            initial: whether nothing is known of the stands yet; else they are near.
        """
        r, known, stands = self.readings, self.noise.weighted, list(self.instrument_poses)
        for k, setup in enumerate(r.setups):
            rows = np.flatnonzero((self.setup == k) & known)
            read = np.isfinite(r.reading[rows])
            rows = rows[read] if read.any() else rows
            if not len(rows):
                continue
            taken = SetupReadings(
                seen.p[rows], seen.offset_from_tool[rows], r.axis[rows], r.sign[rows] * r.reading[rows],
                self.sigma[rows],
            )  # fmt: skip
            found = setup.observation.estimate_pose(
                taken, None if initial else stands[k], self.instrument_priors
            )
            if not found.is_close_to(stands[k]):
                stands[k] = found
        same = all(new is old for new, old in zip(stands, self.instrument_poses, strict=True))
        return self if same else replace(self, instrument_poses=tuple(stands))

    # What a machine makes of them ----------------------------------------------------------

    @cached_property
    def measurement_model(self) -> MeasurementModel:
        """The readings with their instruments in place."""
        return MeasurementModel(self.readings, self.instrument_poses, self.normalized_plate_xy)

    def conditions(self) -> Conditions:
        """Return conditions of every row, then of the second commands."""
        return self.measurement_model.conditions()

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Return the rows ``(n,)`` to expect, nuisances apart."""
        return self.measurement_model.predict(model, values)

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Return the rows and their derivatives by parameters."""
        return self.measurement_model.linearise(model, values, names)

    def joint_response(self, model: Model, values: Mapping[str, float]) -> JointResponse:
        """Return how the rows follow virtual joints that move as functions of the conditions."""
        return self.measurement_model.joint_response(model, values)

    def nuisance_sd(self, setup: int) -> Array:
        """Return standard deviations of a setup's nuisances ``(K,)``."""
        own = self.readings.setups[setup]
        return own.observation.nuisance_sds(
            own, self.readings.axis[self.setup == setup], self.instrument_priors
        )

    def nuisances(self, seen: ReadingPoses) -> NuisanceBlock:
        """Return what each setup's instrument brings, setup by setup for each of its numbers, and
        once what setups have together.
        """
        n, columns, sd = len(self.readings), list[Array](), list[float]()
        together = dict[tuple[int, str], int]()
        known = [self.nuisance_sd(k) for k in range(len(self.readings.setups))]
        for j in range(max(map(len, known), default=0)):
            for k, own in enumerate(known):
                if j >= len(own) or own[j] == 0:
                    continue
                column = np.zeros(n)
                rows = self.setup == k
                column[rows] = seen.nuisance_jacobian[rows, j]
                if np.abs(column).max(initial=0.0) == 0:  # what no row shows is no nuisance
                    continue
                setup = self.readings.setups[k]
                if name := setup.observation.shared_nuisance_name(setup, j):
                    at = together.setdefault((j, name), len(columns))
                    if at < len(columns):
                        columns[at] = columns[at] + column
                        continue
                columns.append(column)
                sd.append(float(own[j]))
        return NuisanceBlock(np.array(columns).reshape(-1, n).T, np.array(sd))

    # Its noise -----------------------------------------------------------------------------

    def with_roughness(self, machine: Machine) -> Factor:
        """Return the same with the noise that plates' roughness shows, where none was declared."""
        r, p = self.readings, machine.forward(self.readings.command) + self.readings.beside
        sigma, shown = self.sigma.copy(), self.noise.from_repeats.copy()
        off_surface = np.zeros(len(r))
        for k, setup in enumerate(r.setups):
            rows = self.setup == k
            if not setup.observation.touches:
                continue
            height = p[rows, 2] - r.reading[rows]
            rough, off = roughness(self.normalized_plate_xy[rows], height, r.approach[rows])
            most = np.minimum(rough, MAX_NOISE_RATIO * self.noise.expected[rows])
            rougher = ~np.isfinite(r.sigma[rows]) & (most > sigma[rows])
            sigma[rows], shown[rows] = np.where(rougher, most, sigma[rows]), shown[rows] | rougher
            if np.bincount(self.station[rows]).max(initial=0) <= 1:
                off_surface[rows] = off
        noise = replace(self.noise, sigma=sigma, from_repeats=shown)
        return replace(self, noise=noise, outlier_height=off_surface)

    def without_outlying_touches(self, machine: Machine) -> Factor:
        """Return the same without touches that are none of their surface, which it names."""
        if not self.outlier_height.any():
            return self
        kept, r = self.outlier_height == 0, self.readings
        p = machine.forward(r.command) + r.beside
        said = list[str]()
        for k in np.flatnonzero(~kept):
            off = self.outlier_height[k] * 1e3
            above = off > 0
            what = "a speck on the plate" if above else "a dent in the plate"
            name = r.setups[r.setup[k]].name
            said.append(
                f"{source(r)}, line {r.line[k]}, setup {name!r}: the touch at x "
                f"{plain(p[k, 0] * 1e3, 0)}, y {plain(p[k, 1] * 1e3, 0)} mm is {abs(off):.2f} mm "
                f"{'above' if above else 'below'} the surface of all others, as {what} or a bad "
                f"touch is, and does not count: {'clean' if above else 'look at'} the plate and "
                f"probe again"
            )
        return replace(self.subset(kept), exclusion_sentences=tuple(said))

    def noise_and_expected(self, setup: int) -> tuple[float, float]:
        """Return the noise of a setup's readings, and what is usual of them: root mean squares."""
        rows = self.setup == setup
        each = (self.noise.total, self.noise.expected)
        own, usual = (float(np.sqrt(np.mean(s[rows] ** 2))) for s in each)
        return own, usual

    def noise_by_kind(self) -> Iterator[tuple[str, Array, NoiseSource]]:
        """Yield each kind of readings with the standard deviations of its rows ``(n,)``, all
        counted, and where they come from; what a plate's roughness says is said by repeats, too.
        """
        for kind in dict.fromkeys(self.readings.kind):
            rows = self.readings.of_kind(kind) & self.noise.weighted
            told = np.isfinite(self.readings.sigma[rows]).all()
            shown = self.noise.from_repeats[rows].any()
            where: NoiseSource = "declared" if told else "repeats" if shown else "machine"
            yield kind, self.noise.total[rows], where

    @cached_property
    def repeat_dof(self) -> tuple[tuple[int, int], ...]:
        """How many readings have their noise from repeats, by kind, and the degrees of freedom
        behind it.
        """
        kinds = [
            (kind, len(own)) for kind, own, where in self.noise_by_kind() if where == "repeats"
        ]
        of = self.readings
        each = (repeat_variance([of.subset(of.of_kind(kind))]) for kind, _ in kinds)
        found = zip(kinds, each, strict=True)
        return tuple((n, dof) for (_, n), (_, dof) in found if dof >= MIN_REPEAT_DOF)

    @property
    def noise_capped(self) -> NDArray[np.bool_]:
        """Readings ``(n,)`` whose noise is the largest roughness that is assumed of a plate, as
        their heights scatter by more.
        """
        return np.asarray(
            self.readings.touching & (self.sigma == MAX_NOISE_RATIO * self.noise.expected)
        )

    def approach_known(self, setup: int) -> bool:
        """Return whether it is known from which side a setup's places were come to, on every axis;
        of distances, which have two ends, it never is, and is not asked.
        """
        approach = self.readings.approach[self.setup == setup]
        return self.readings.setups[setup].observation.paired or bool(approach.all())


def machine_instrument_priors(machine: Machine, frame: Frame = "rigid") -> InstrumentPriors:
    """Return what a machine file says of how instruments stand."""
    return InstrumentPriors(machine.spec.dial.placement, machine.spec.surface_slope or 0.0, frame)


def _normalized_plate_xy(readings: Readings, p: Array) -> Array:
    """Places over the largest measured radius of each plate, along axes that turn with it."""
    place = p[:, :2].copy()
    for k, setup in enumerate(readings.setups):
        rows = readings.setup == k
        place[rows] /= np.hypot(*p[rows, :2].T).max(initial=1e-3)
        angle = np.deg2rad(setup.turned)
        place[rows] = place[rows] @ np.array(
            [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        )
    return place
