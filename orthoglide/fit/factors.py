"""Factors, the terms of a problem: readings with their noise and instruments in place.

A factor predicts and differentiates its rows. Its nuisances are parameters of the instruments, such
as a dial's datum and placement or the frame of a tracker; they are fitted with all others.
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
    sd: Array  # prior standard deviation about zero (k,); infinite without a prior


@dataclass(frozen=True)
class Factor:
    """Readings of one table: all of legs, or all of the tool."""

    readings: Readings
    noise: RowNoise
    instrument_priors: InstrumentPriors  # of placements
    instrument_poses: tuple[InstrumentPose, ...]  # of every setup
    # places on plates over their largest measured radius (n, 2), along axes that turn with the
    # plate; by the nominal machine, which is accurate enough
    normalized_plate_xy: Array
    # height of outlying touches of a plate above the surface through the others (n,), metres;
    # 0 of all other readings
    outlier_height: Array
    exclusion_sentences: tuple[str, ...] = ()  # one for each outlying touch that was excluded

    @classmethod
    def from_readings(
        cls,
        readings: Readings,
        machine: Machine,
        noise: RowNoise,
        instrument_priors: InstrumentPriors | None = None,
    ) -> Factor:
        """Return readings with their instruments placed by a machine.

        Args:
            readings: of legs, or of the tool.
            machine: its nominal poses place plates, balls and frames.
            noise: of the readings.
            instrument_priors: of placements; those of the machine file where absent.
        """
        priors = instrument_priors or machine_instrument_priors(machine)
        n, poses = len(readings), (InstrumentPose(),) * len(readings.setups)
        factor = cls(readings, noise, priors, poses, np.zeros((n, 2)), np.zeros(n))
        if factor.on_legs:
            return factor
        p = machine.forward(readings.command) + readings.beside
        factor = replace(factor, normalized_plate_xy=_normalized_plate_xy(readings, p))
        nominal = ReadingPoses(np.zeros((n, 0)), p, readings.beside)
        return factor.with_instrument_poses(nominal, initial=True)

    @classmethod
    def from_planned(cls, readings: Readings, machine: Machine) -> Factor:
        """Return readings that were not taken yet, with their expected noise."""
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
        """Number of the visit at which each row was read ``(n,)``, one for all coordinates of a
        point of the tool.
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
        """Return the factor with other values ``(n,)``, metres or radians."""
        return replace(self, readings=self.readings.with_readings(reading))

    def with_table(self, readings: Readings) -> Factor:
        """Return the factor with a changed table of as many rows."""
        added = len(readings.setups) - len(self.instrument_poses)
        poses = (*self.instrument_poses, *(InstrumentPose(),) * added)
        return replace(self, readings=readings, instrument_poses=poses)

    def subset(self, rows: NDArray[Any]) -> Factor:
        """Return some of the rows, by indices or booleans ``(n,)``."""
        setups = np.unique(self.setup[rows])
        return replace(
            self, readings=self.readings.subset(rows), noise=self.noise.subset(rows),
            instrument_poses=tuple(self.instrument_poses[k] for k in setups),
            normalized_plate_xy=self.normalized_plate_xy[rows],
            outlier_height=self.outlier_height[rows],
        )  # fmt: skip

    def with_noise(self, rows: NDArray[np.intp], noise: RowNoise) -> Factor:
        """Return the factor with other noise of some rows."""
        return replace(self, noise=self.noise.with_rows(rows, noise))

    def without_weight(self, rows: NDArray[np.bool_]) -> Factor:
        """Return the factor with the visits of some rows ``(n,)`` without weight."""
        visits = np.isin(self.visit_number, self.visit_number[rows])
        return replace(self, noise=self.noise.without_weight(visits))

    def with_instrument_poses(self, reading_poses: ReadingPoses, initial: bool = False) -> Factor:
        """Return the factor with instruments placed by a machine; itself if their poses stay.

        Args:
            reading_poses: the machine's, in which the readings are taken.
            initial: whether the present instrument poses are no estimates yet.
        """
        r, poses = self.readings, list(self.instrument_poses)
        for k, setup in enumerate(r.setups):
            rows = np.flatnonzero((self.setup == k) & self.noise.weighted)
            finite = np.isfinite(r.reading[rows])
            rows = rows[finite] if finite.any() else rows
            if not len(rows):
                continue
            taken = SetupReadings(
                reading_poses.p[rows], reading_poses.offset_from_tool[rows], r.axis[rows],
                r.sign[rows] * r.reading[rows], self.sigma[rows],
            )  # fmt: skip
            start = None if initial else poses[k]
            pose = setup.observation.estimate_pose(taken, start, self.instrument_priors)
            if not pose.is_close_to(poses[k]):
                poses[k] = pose
        unchanged = all(new is old for new, old in zip(poses, self.instrument_poses, strict=True))
        return self if unchanged else replace(self, instrument_poses=tuple(poses))

    # Predictions ---------------------------------------------------------------------------

    @cached_property
    def measurement_model(self) -> MeasurementModel:
        """The readings with their instruments in place."""
        return MeasurementModel(self.readings, self.instrument_poses, self.normalized_plate_xy)

    def conditions(self) -> Conditions:
        """Return conditions of every row, then of the second commands."""
        return self.measurement_model.conditions()

    def predict(self, model: Model, values: Mapping[str, float]) -> Array:
        """Return the predicted rows ``(n,)``, without nuisances."""
        return self.measurement_model.predict(model, values)

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Return the rows and their derivatives by parameters."""
        return self.measurement_model.linearise(model, values, names)

    def joint_response(self, model: Model, values: Mapping[str, float]) -> JointResponse:
        """Return the response of the rows to virtual joints that move with the conditions."""
        return self.measurement_model.joint_response(model, values)

    def nuisance_sd(self, number: int) -> Array:
        """Return standard deviations of a setup's nuisances ``(K,)``."""
        setup, axis = self.readings.setups[number], self.readings.axis[self.setup == number]
        return setup.observation.nuisance_sds(setup, axis, self.instrument_priors)

    def nuisances(self, reading_poses: ReadingPoses) -> NuisanceBlock:
        """Return the nuisances of all instruments: number by number, each for all setups; nuisances
        that setups share have one column.
        """
        n, columns, sd = len(self.readings), list[Array](), list[float]()
        shared_columns = dict[tuple[int, str], int]()
        sd_by_setup = [self.nuisance_sd(k) for k in range(len(self.readings.setups))]
        for j in range(max(map(len, sd_by_setup), default=0)):
            for k, setup_sd in enumerate(sd_by_setup):
                if j >= len(setup_sd) or setup_sd[j] == 0:
                    continue
                column = np.zeros(n)
                rows = self.setup == k
                column[rows] = reading_poses.nuisance_jacobian[rows, j]
                if not column.any():  # without effect on any row
                    continue
                setup = self.readings.setups[k]
                if name := setup.observation.shared_nuisance_name(setup, j):
                    index = shared_columns.setdefault((j, name), len(columns))
                    if index < len(columns):
                        columns[index] = columns[index] + column
                        continue
                columns.append(column)
                sd.append(float(setup_sd[j]))
        return NuisanceBlock(np.array(columns).reshape(-1, n).T, np.array(sd))

    # Its noise -----------------------------------------------------------------------------

    def with_roughness(self, machine: Machine) -> Factor:
        """Return the factor with noise from the plates' roughness, where none was declared."""
        r, p = self.readings, machine.forward(self.readings.command) + self.readings.beside
        sigma, from_repeats = self.sigma.copy(), self.noise.from_repeats.copy()
        outlier_height = np.zeros(len(r))
        for k, setup in enumerate(r.setups):
            rows = self.setup == k
            if not setup.observation.touches:
                continue
            height = p[rows, 2] - r.reading[rows]
            xy = self.normalized_plate_xy[rows]
            plate_noise, outliers = roughness(xy, height, r.approach[rows])
            capped = np.minimum(plate_noise, MAX_NOISE_RATIO * self.noise.expected[rows])
            rougher = ~np.isfinite(r.sigma[rows]) & (capped > sigma[rows])
            sigma[rows] = np.where(rougher, capped, sigma[rows])
            from_repeats[rows] |= rougher
            if np.bincount(self.station[rows]).max(initial=0) <= 1:
                outlier_height[rows] = outliers
        noise = replace(self.noise, sigma=sigma, from_repeats=from_repeats)
        return replace(self, noise=noise, outlier_height=outlier_height)

    def without_outlying_touches(self, machine: Machine) -> Factor:
        """Return the factor without outlying touches, with a sentence on each."""
        if not self.outlier_height.any():
            return self
        rows_kept, r = self.outlier_height == 0, self.readings
        p = machine.forward(r.command) + r.beside
        sentences = list[str]()
        for k in np.flatnonzero(~rows_kept):
            height = self.outlier_height[k] * 1e3
            above = height > 0
            cause = "a speck on the plate" if above else "a dent in the plate"
            name = r.setups[r.setup[k]].name
            sentences.append(
                f"{source(r)}, line {r.line[k]}, setup {name!r}: the touch at x "
                f"{plain(p[k, 0] * 1e3, 0)}, y {plain(p[k, 1] * 1e3, 0)} mm is "
                f"{abs(height):.2f} mm "
                f"{'above' if above else 'below'} the surface of all others, as {cause} or a bad "
                f"touch is, and does not count: {'clean' if above else 'look at'} the plate and "
                f"probe again"
            )
        return replace(self.subset(rows_kept), exclusion_sentences=tuple(sentences))

    def noise_and_expected(self, number: int) -> tuple[float, float]:
        """Return the root mean squares of a setup's noise, and of its expected noise."""
        sigmas = np.stack([self.noise.total, self.noise.expected])[:, self.setup == number]
        noise, expected = np.sqrt(np.mean(sigmas**2, axis=1)).tolist()
        return noise, expected

    def noise_by_kind(self) -> Iterator[tuple[str, Array, NoiseSource]]:
        """Yield each kind of readings with the total standard deviations of its rows ``(n,)`` and
        their source; a plate's roughness counts as repeats.
        """
        for kind in dict.fromkeys(self.readings.kind):
            rows = self.readings.of_kind(kind) & self.noise.weighted
            declared = np.isfinite(self.readings.sigma[rows]).all()
            from_repeats = self.noise.from_repeats[rows].any()
            found: NoiseSource = "repeats" if from_repeats else "machine"
            yield kind, self.noise.total[rows], "declared" if declared else found

    @cached_property
    def repeat_counts_and_dof(self) -> tuple[tuple[int, int], ...]:
        """For each kind of reading with noise from repeats: number of readings, and degrees of
        freedom of the noise.
        """
        counts = list[tuple[int, int]]()
        for kind, sigma, origin in self.noise_by_kind():
            if origin == "repeats":
                readings = self.readings.subset(self.readings.of_kind(kind))
                counts.append((len(sigma), repeat_variance([readings])[1]))
        return tuple((n, dof) for n, dof in counts if dof >= MIN_REPEAT_DOF)

    @property
    def noise_capped(self) -> NDArray[np.bool_]:
        """Touches ``(n,)`` whose noise is capped: their heights scatter by more than that."""
        capped = self.sigma == MAX_NOISE_RATIO * self.noise.expected
        return np.asarray(self.readings.touching & capped)

    def approach_known(self, number: int) -> bool:
        """Return whether the approach of every axis was recorded in a setup; true of distances, for
        which it is not needed.
        """
        approach = self.readings.approach[self.setup == number]
        return self.readings.setups[number].observation.paired or bool(approach.all())


def machine_instrument_priors(machine: Machine, frame: Frame = "rigid") -> InstrumentPriors:
    """Return the priors of placements in a machine file."""
    return InstrumentPriors(machine.spec.dial.placement, machine.spec.surface_slope or 0.0, frame)


def _normalized_plate_xy(readings: Readings, p: Array) -> Array:
    """Return places over the largest measured radius of each plate, along axes of the plate."""
    xy = p[:, :2].copy()
    for k, setup in enumerate(readings.setups):
        rows = readings.setup == k
        xy[rows] /= np.hypot(*p[rows, :2].T).max(initial=1e-3)
        angle = np.deg2rad(setup.turned)
        sine, cosine = np.sin(angle), np.cos(angle)
        xy[rows] = xy[rows] @ np.array([[cosine, -sine], [sine, cosine]])
    return xy
