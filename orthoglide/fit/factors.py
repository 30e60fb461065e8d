"""Factors, the terms of a problem: readings with their noise and instruments in place.

A factor predicts and differentiates its rows. Its nuisances are parameters of the instruments, such
as a dial's datum and placement or the frame of a tracker; they are fitted with all others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.fit.noise import RowNoise, expected_sigma
from orthoglide.fit.repeats import MAX_NOISE_RATIO, roughness
from orthoglide.geometry import Array
from orthoglide.instruments import Frame, InstrumentPriors, SetupReadings
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import Readings, source
from orthoglide.observations.approach import Ints
from orthoglide.observations.arrays import group_ids
from orthoglide.prediction import MeasurementModel, ReadingPoses
from orthoglide.text import listed


@dataclass(frozen=True)
class NuisanceBlock:
    """Nuisances of one factor."""

    columns: Array  # derivative of its rows by them (n, k)
    sd: Array  # prior standard deviation about zero (k,); infinite without a prior


@dataclass(frozen=True, eq=False, kw_only=True)
class Factor(MeasurementModel):
    """Readings of one table, all of legs or all of the tool, with their noise."""

    noise: RowNoise
    instrument_priors: InstrumentPriors  # of placements
    exclusion_sentences: tuple[str, ...] = ()  # one for each outlying touch that was excluded
    drifting: tuple[str, ...] = ()  # mountings whose nuisances change evenly over their readings

    @classmethod
    def from_readings(
        cls,
        readings: Readings,
        machine: Machine,
        noise: RowNoise,
        instrument_priors: InstrumentPriors | None = None,
    ) -> Factor:
        """Return readings of legs, or of the tool, with instruments placed by a machine's nominal
        poses; without ``instrument_priors`` those of the machine file hold.
        """
        priors = instrument_priors or machine_instrument_priors(machine)
        factor = cls(readings=readings, noise=noise, instrument_priors=priors)
        if factor.on_legs:
            return factor
        # The nominal machine is accurate enough for places on a plate.
        p = factor.nominal_places(machine)
        factor = replace(factor, normalized_plate_xy=_normalized_plate_xy(readings, p))
        nominal = ReadingPoses(np.zeros((len(readings), 0)), p, readings.beside)
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

    @cached_property
    def progress(self) -> Array:
        """Progress of each row within its mounting ``(n,)``, from -0.5 at the first reading to 0.5
        at the last: of the time if all rows have one, else of the order.
        """
        timed = np.isfinite(self.readings.time).all()
        moments = np.asarray(self.readings.time if timed else self.readings.order, dtype=float)
        progress = np.zeros(len(moments))
        for rows in (self.setup == k for k in np.unique(self.setup)):
            elapsed = moments[rows] - moments[rows].min()
            progress[rows] = elapsed / max(float(elapsed.max()), 1e-9) - 0.5
        return progress

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

    def nominal_places(self, machine: Machine) -> Array:
        """Return the places that are read ``(n, 3)``, metres, by the commands and a machine."""
        return machine.forward(self.readings.command) + self.readings.beside

    def setups_of(self, effect: Effect) -> tuple[str, ...]:
        """Return the setups of which an instrument's effect has parameters."""
        return tuple(
            s.name for s in self.readings.setups if s.observation.is_affected_by(effect, s)
        )

    # Other factors -------------------------------------------------------------------------

    def with_readings(self, reading: Array) -> Factor:
        """Return the factor with other values ``(n,)``, metres or radians."""
        return replace(self, readings=self.readings.with_readings(reading))

    def with_table(self, readings: Readings) -> Factor:
        """Return the factor with a changed table of as many rows. The instrument of a setup that
        was split off starts from the pose of the one that its rows had.
        """
        poses = self.instrument_poses
        numbers = range(len(poses), len(readings.setups))
        split_off = [poses[self.setup[readings.setup == k][0]] for k in numbers]
        return replace(self, readings=readings, instrument_poses=(*poses, *split_off))

    def subset(self, rows: NDArray[Any]) -> Factor:
        """Return some of the rows, by indices or booleans ``(n,)``."""
        setups = np.unique(self.setup[rows])
        return replace(
            self, readings=self.readings.subset(rows), noise=self.noise.subset(rows),
            instrument_poses=tuple(self.instrument_poses[k] for k in setups),
            normalized_plate_xy=self.normalized_plate_xy[rows],
        )  # fmt: skip

    def with_noise(self, rows: NDArray[np.intp], noise: RowNoise) -> Factor:
        """Return the factor with other noise of some rows."""
        return replace(self, noise=self.noise.with_rows(rows, noise))

    def without_weight(self, rows: NDArray[np.bool_]) -> Factor:
        """Return the factor with the visits of some rows ``(n,)`` without weight."""
        visits = np.isin(self.visit_number, self.visit_number[rows])
        return replace(self, noise=self.noise.without_weight(visits))

    def with_instrument_poses(self, reading_poses: ReadingPoses, initial: bool = False) -> Factor:
        """Return the factor with instruments placed by the poses of a machine in which the readings
        are taken; itself if their poses stay. ``initial``: the present ones are no estimates yet.
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
                drifts = setup.name in self.drifting and j < setup.observation.drifting_count
                columns += [column, column * self.progress] if drifts else [column]
                sd += [float(setup_sd[j])] * (1 + drifts)
        return NuisanceBlock(np.array(columns).reshape(-1, n).T, np.array(sd))

    # Its noise -----------------------------------------------------------------------------

    def _surfaces(self, machine: Machine) -> Iterator[tuple[NDArray[np.intp], float, Array]]:
        """Yield the rows ``(m,)`` on each plate, its roughness, and the height of outlying touches
        ``(m,)``; see :func:`~orthoglide.fit.repeats.roughness`.
        """
        r, height = self.readings, self.nominal_places(machine)[:, 2] - self.readings.reading
        for k, setup in enumerate(r.setups):
            rows = np.flatnonzero(self.setup == k)
            if setup.observation.touches:
                xy = self.normalized_plate_xy[rows]
                yield rows, *roughness(xy, height[rows], r.approach[rows])

    def with_roughness(self, machine: Machine) -> Factor:
        """Return the factor with noise from the plates' roughness, where none was declared."""
        noise, sigma = self.noise, self.sigma.copy()
        for rows, plate_noise, _ in self._surfaces(machine):
            capped = np.minimum(plate_noise, MAX_NOISE_RATIO * noise.expected[rows])
            sigma[rows] = np.maximum(sigma[rows], capped)
        sigma = np.where(np.isfinite(self.readings.sigma), self.sigma, sigma)
        source = np.where(sigma > self.sigma, "repeats", noise.source)
        return replace(self, noise=replace(noise, sigma=sigma, source=source))

    def without_outlying_touches(self, machine: Machine) -> Factor:
        """Return the factor without touches that lie off the surface of their plate, with a
        sentence on each patch of them.
        """
        heights = np.zeros(len(self.setup))
        for rows, _, outlying in self._surfaces(machine):
            heights[rows] = outlying
        return self.without_touches(heights, machine)

    def without_touches(self, heights: Array, machine: Machine) -> Factor:
        """Return the factor without touches that lie off their plate, by heights ``(n,)``, metres,
        which are 0 of all others, with a sentence on each patch of equal heights. Where places were
        touched more than once, repeats show them.
        """
        p, kept, sentences = self.nominal_places(machine), self.setup >= 0, list[str]()
        for k in range(len(self.readings.setups)):
            rows = np.flatnonzero(self.setup == k)
            if np.bincount(self.station[rows]).max(initial=0) > 1:
                continue
            for height in dict.fromkeys(heights[rows][heights[rows] != 0].tolist()):
                patch = rows[heights[rows] == height]
                kept[patch] = False
                sentences.append(self._outlying_sentence(patch, height, p))
        if not sentences:
            return self
        sentences = [*self.exclusion_sentences, *sentences]
        return replace(self.subset(kept), exclusion_sentences=tuple(sentences))

    def _outlying_sentence(self, rows: NDArray[np.intp], height: float, p: Array) -> str:
        """Return that touches at places ``p[rows]`` lie so much above their surface, metres."""
        r, side = self.readings, "above" if height > 0 else "below"
        places = "; ".join(f"x {plain(x, 0)}, y {plain(y, 0)}" for x, y in p[rows, :2] * 1e3)
        lines = f"line{'s' * (len(rows) > 1)} {listed(map(str, r.line[rows].tolist()))}"
        start = f"{source(r)}, {lines}, setup {r.setups[r.setup[rows[0]]].name!r}: the"
        size = f"{abs(height) * 1e3:.2f} mm {side} the surface of all others"
        if len(rows) > 1:
            cause = "on a clip or dirt" if height > 0 else "in a hollow or off the plate's edge"
            return (
                f"{start} {len(rows)} neighbouring touches at {places} mm are {size}, as {cause}, "
                f"and do not count: look at the plate there and probe again beside it"
            )
        cause, remedy = (
            ("a speck on the plate", "clean") if height > 0 else ("a dent in the plate", "look at")
        )
        return (
            f"{start} touch at {places} mm is {size}, as {cause} or a bad touch is, and does not "
            f"count: {remedy} the plate and probe again"
        )

    def noise_and_expected(self, number: int) -> tuple[float, float]:
        """Return the root mean squares of a setup's noise, and of its expected noise."""
        sigmas = np.stack([self.noise.total, self.noise.expected])[:, self.setup == number]
        noise, expected = np.sqrt(np.mean(sigmas**2, axis=1)).tolist()
        return noise, expected

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
