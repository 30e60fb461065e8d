"""Standard deviation of one reading: declared, from the machine file, from repeats, or usual.

The same rules hold for all kinds of readings. The rounding of an instrument's display is added.
`Weighing` measures rows in units of that noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.fit.repeats import (
    GRID_TOLERANCE,
    MIN_REPEAT_DOF,
    apparent_step,
    common_rounding,
    dial_steps,
    off_grid,
    readings_of_finest_step,
    repeat_variance,
    total_variance,
    widen_at_rounding_edges,
    without_noisier_setups,
)
from orthoglide.geometry import Array
from orthoglide.instruments import LegDial, Observation
from orthoglide.machine_file import Instrument, MachineFile
from orthoglide.numerals import ByUnit
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids
from orthoglide.units import NOISE_LIMITS

NoiseSource = Literal["declared", "machine", "repeats", "residuals", "usual"]
"""Source of a standard deviation; ``machine``: the machine file, and in summaries also the usual
figure of a kind; ``residuals``: larger noise of one setup, as the search found it."""

NO_WEIGHT = 1e6
"""Factor on the standard deviation of a reading without weight: of a million million such readings,
the information of one."""

PUBLISHED_REPEATABILITY = LegDial.repeatability
"""Metres: the repeatability stated in 2008, section 4.1; the default."""

_NEGLIGIBLE_SHARE = 0.01  # share of a variance below which a component is neglected


@dataclass(frozen=True, repr=False)
class RowNoise:
    """Noise of the readings of one table."""

    sigma: Array  # standard deviation of each (n,), metres or radians, reduced by averaging
    # standard deviation of the rounding error that all visits to a station share; 0 where scatter
    # makes it independent (n,)
    common: Array
    step: Array  # of every reading's instrument, as far as it is counted (n,)
    expected: Array  # by declaration, machine file or default of the kind (n,)
    source: NDArray[np.str_]  # a `NoiseSource`; a plate's roughness counts as repeats (n,)
    weighted: NDArray[np.bool_]  # whether the readings have any weight (n,)

    @property
    def total(self) -> Array:
        """Standard deviation of one reading, all counted ``(n,)``."""
        return np.hypot(self.sigma, self.common)

    @property
    def from_repeats(self) -> NDArray[np.bool_]:
        """Whether it is from repeats or a plate's roughness ``(n,)``."""
        return np.asarray(self.source == "repeats")

    @classmethod
    def zeros(cls, n: int) -> RowNoise:
        """Return zeros for the noise of ``n`` readings."""
        sigma, common, step, expected = np.zeros((4, n))
        return cls(sigma, common, step, expected, np.full(n, "declared"), np.ones(n, dtype=bool))

    def with_rows(self, rows: NDArray[Any], noise: RowNoise) -> RowNoise:
        """Return the noise with that of some rows, by indices or booleans, in its place."""
        columns = {name: values.copy() for name, values in vars(self).items()}
        for name, values in vars(noise).items():
            columns[name][rows] = values
        return RowNoise(**columns)

    def subset(self, rows: NDArray[Any]) -> RowNoise:
        """Return the noise of some rows, by indices or booleans ``(n,)``."""
        return RowNoise(*(values[rows] for values in vars(self).values()))

    def enlarged(self, scale: Array) -> RowNoise:
        """Return the noise with standard deviations that many times larger ``(n,)``, where it is
        more than once; visits then share less of their rounding.
        """
        total, larger = self.total * scale, scale > 1
        common = np.where(larger, common_rounding(total, self.step), self.common)
        sigma = np.sqrt(np.maximum(total**2 - common**2, 0.0))
        return replace(self, sigma=np.where(larger, sigma, self.sigma), common=common)

    def without_weight(self, rows: NDArray[np.bool_]) -> RowNoise:
        """Return the noise with some rows ``(n,)``, booleans, without any weight."""
        removed = rows & self.weighted
        sigma = np.where(removed, NO_WEIGHT * self.sigma, self.sigma)
        return replace(self, sigma=sigma, weighted=self.weighted & ~rows)


@dataclass(frozen=True, repr=False)
class Noise:
    """Noise of readings in one figure: of dials on legs, where there are any.

    Of readings of the tool alone it is the root mean square of lengths, or of inclinations where
    there are no lengths.
    """

    typical: float  # standard deviation of a single reading, metres or radians, all counted
    source: NoiseSource  # where it comes from; of readings of the tool `declared` or `machine`
    resolution: float  # the commonest step of the first kind, which `typical` counts
    dof: float = float("inf")  # degrees of freedom behind the level of the first kind
    declared: float = float("nan")  # declared standard deviation before rounding; nan if none
    # by kind of reading whose assumed noise is replaced by the larger one that its repeats show:
    # number of those readings, and degrees of freedom of that noise
    refuted: Mapping[str, tuple[int, float]] = field(default_factory=dict)


def instrument_of(spec: MachineFile, observation: Observation) -> Instrument:
    """Return the instrument of a kind of readings by the machine file."""
    instrument, dial = spec.instruments.get(observation.kind), spec.dial
    if instrument is not None or not observation.dials:
        return instrument or Instrument()
    dial_sigma = dial.repeatability
    sigma = None if dial_sigma is None else dial_sigma * observation.dials**0.5
    return Instrument(dial.resolution, sigma)


def noise_of(
    given: Sequence[Readings],
    spec: MachineFile,
    declared: float | None = None,
    steps: Sequence[Array] | None = None,
) -> tuple[Noise, tuple[RowNoise, ...]]:
    """Return the noise of readings in one figure, and that of the rows of each table.

    A figure declared for the run counts first (of dials on legs, where there are any), then the
    ``sigma`` of the rows, then the machine file's repeatability, then the scatter of repeats
    (successive differences, so that slow drift does not count, and none of a setup that scatters
    more than the others), then the usual figure of the kind.
    The variance of rounding is added: step^2 / 12, where the step is the instrument's, or the
    coarser one that its readings show.

    Args:
        given: tables of readings.
        spec: of the machine, with its instruments.
        declared: standard deviation of one reading, metres; replaces all others.
        steps: of every reading's instrument, by table, each ``(n,)``, metres; by default they are
            found from the readings.

    Raises:
        InputError: where ``declared`` is no plausible noise of an instrument.
    """
    row_noises = [RowNoise.zeros(len(table)) for table in given]
    on_legs = any(table.on_legs.any() for table in given)
    noises = list[Noise]()
    for observation in dict.fromkeys(o for table in given for o, _ in table.observations):
        chosen = [(k, table.of_kind(observation.kind)) for k, table in enumerate(given)]
        chosen = [(k, rows) for k, rows in chosen if rows.any()]
        noise, of_tables = _noise_of_kind(
            observation,
            instrument_of(spec, observation),
            [given[k].subset(rows) for k, rows in chosen],
            None if on_legs and not observation.on_leg else declared,
            None if steps is None else [steps[k][rows] for k, rows in chosen],
        )
        noises.append(noise)
        for (k, rows), of_table in zip(chosen, of_tables, strict=True):
            row_noises[k] = row_noises[k].with_rows(rows, of_table)
    summary = noises[0] if noises else Noise(float("nan"), "machine", 0.0)
    if noises and not on_legs:
        all_declared = all(noise.source == "declared" for noise in noises)
        typical = rms_noise(given, [noise.total for noise in row_noises])
        source: NoiseSource = "declared" if all_declared else "machine"
        summary = replace(summary, source=source, typical=typical)
    return summary, tuple(row_noises)


def rms_by_unit(rows: Array, angular: NDArray[np.bool_]) -> ByUnit:
    """Return the root mean squares of lengths, metres, and of angles, radians ``(n,)``; nan values
    do not count.
    """
    finite = np.isfinite(rows)
    parts = (rows[finite & ~angular], rows[finite & angular])
    return ByUnit(*(float(np.sqrt(np.mean(p**2))) if len(p) else float("nan") for p in parts))


def rms_noise(given: Sequence[Readings], sigma: Sequence[Array]) -> float:
    """Return the root mean square of the noise of lengths, or of angles where there are none, by
    the standard deviations ``(n,)`` of each table's readings.
    """
    angular = np.concatenate([table.angular for table in given])
    rms = rms_by_unit(np.concatenate(sigma), angular)
    return rms.turn if angular.all() else rms.length


def _noise_of_kind(
    observation: Observation,
    instrument: Instrument,
    tables: Sequence[Readings],
    declared: float | None,
    steps: Sequence[Array] | None,
) -> tuple[Noise, list[RowNoise]]:
    """Return the noise of readings of one kind in one figure, and that of the rows of each table;
    arguments as of :func:`noise_of`, but tables that have no other readings.
    """
    resolution = instrument.resolution or 0.0
    if steps is None:
        steps = [_instrument_steps(table, resolution) for table in tables]
    finest_tables, finest = readings_of_finest_step(tables, steps)
    scatter, level_source, dof = _scatter(finest_tables, observation, instrument, finest, declared)
    is_declared = level_source == "declared"
    # A declared noise may refer to averaged or unrounded readings: rounding is added to it only if
    # the instrument is known to round, and the readings, as far as taken, lie on its grid.
    counted_steps = [
        step * float(
            resolution > 0 and step.all() and not (off_grid(t.reading, step) > GRID_TOLERANCE).any()
        )
        for t, step in zip(tables, steps, strict=True)
    ]  # fmt: skip
    any_repeats = any(len(np.unique(table.stations, axis=0)) < len(table) for table in tables)
    rows = []
    for table, step, counted_step in zip(tables, steps, counted_steps, strict=True):
        has_sigma = np.isfinite(table.sigma) & (declared is None)
        rounding = np.where(has_sigma | is_declared, counted_step, step)
        total = np.hypot(scatter, rounding / np.sqrt(12))
        common = np.zeros(len(table))
        if any_repeats:
            common = common_rounding(total, rounding)
            common[common**2 < _NEGLIGIBLE_SHARE * total**2] = 0.0
        total = np.where(has_sigma, np.hypot(table.sigma, rounding / np.sqrt(12)), total)
        if common.any():
            own = np.sqrt(np.maximum(total**2 - common**2, _NEGLIGIBLE_SHARE * total**2))
            widened = widen_at_rounding_edges(table, own, common, rounding)
            total = np.where(common > 0, widened, total)
        usual = instrument.repeatability or observation.repeatability
        expected = np.hypot(usual, step / np.sqrt(12))
        source = np.where(has_sigma, "declared", level_source)
        assumed = np.where(source == "repeats", expected, total)
        everywhere = np.ones(len(table), dtype=bool)
        rows.append(RowNoise(total, common, rounding, assumed, source, everywhere))
    sizes, counts = np.unique(np.concatenate(steps), return_counts=True)
    commonest = float(sizes[np.argmax(counts)])
    rounding_counted = not is_declared or any(step.any() for step in counted_steps)
    typical = float(np.hypot(scatter, commonest * rounding_counted / np.sqrt(12)))
    of_kind: NoiseSource = "machine" if level_source == "usual" else level_source
    return Noise(typical, of_kind, commonest, dof, scatter if is_declared else float("nan")), rows


def expected_sigma(given: Readings, spec: MachineFile) -> Array:
    """Return the noise to expect before anything is read ``(n,)``, metres or radians."""
    sigma = np.empty(len(given))
    for observation, rows in given.observations:
        instrument = instrument_of(spec, observation)
        repeatability = instrument.repeatability or observation.repeatability
        sigma[rows] = np.hypot(repeatability, (instrument.resolution or 0.0) / np.sqrt(12))
    return np.where(np.isfinite(given.sigma), given.sigma, sigma)


def _instrument_steps(given: Readings, resolution: float) -> Array:
    """Return the step of every reading's instrument ``(n,)``: its known resolution, or a coarser
    one that readings show; else the step of which all readings are multiples.
    """
    if resolution > 0:
        return dial_steps(given, resolution)
    step = 0.0 if given.on_legs.any() else apparent_step(given.reading)
    return np.full(len(given), step)


def check_noise(noise: float, least: float = NOISE_LIMITS[0]) -> float:
    """Return the noise, a negative zero as zero.

    Raises:
        InputError: where it is not plausible, such as millimetres taken for metres.
    """
    most = NOISE_LIMITS[1]
    if not isinstance(noise, Real) or not least <= noise <= most:
        raise InputError(
            f"the noise must be a standard deviation in metres, from {least:g} to {most:g}, "
            f"not {noise!r}"
        )
    return noise + 0.0


def _scatter(
    given: Sequence[Readings],
    observation: Observation,
    instrument: Instrument,
    step: float,
    declared: float | None,
) -> tuple[float, NoiseSource, float]:
    """Return the standard deviation of readings of one kind before their rounding to ``step``, its
    source by the order in :func:`noise_of`, and the degrees of freedom behind it.
    """
    if declared is not None:
        return check_noise(declared), "declared", np.inf
    declared_sigmas = np.concatenate([table.sigma for table in given])
    if np.isfinite(declared_sigmas).all():
        return float(np.sqrt(np.mean(declared_sigmas**2))), "declared", np.inf
    if instrument.repeatability is not None:
        return instrument.repeatability, "machine", np.inf
    variance, dof = repeat_variance(without_noisier_setups(given, step))
    if dof >= MIN_REPEAT_DOF and (variance > 0 or (step > 0 and observation.on_leg)):
        total = max(float(total_variance(variance, step)), observation.least_noise**2)
        return float(np.sqrt(max(total - step**2 / 12, 0.0))), "repeats", dof
    return observation.repeatability, "usual", np.inf


@dataclass(frozen=True, eq=False, repr=False)
class Weighing:
    """The inverse root of the covariance of rows: readings in units of their noise.

    The covariance of a station's readings is ``diag(sigma^2) + common^2``: independent scatter, and
    a rounding error that they share. Its inverse root is a diagonal and one direction a station,
    which needs no matrix of rows times stations::

        W = (1 - a u u^T) diag(1 / sigma),   u ~ 1 / sigma
        a = 1 - 1 / sqrt(1 + common^2 sum(1 / sigma^2))
    """

    sigma: Array  # of each row, reduced by averaging (n,), metres
    common: Array  # of each row, shared by its station (n,), metres; one figure a station
    station: NDArray[np.int64]  # of each row (n,)

    def subset(self, rows: NDArray[Any]) -> Weighing:
        """Return the weighing of some rows, given as indices or booleans ``(n,)``."""
        return Weighing(self.sigma[rows], self.common[rows], group_ids(self.station[rows]))

    @cached_property
    def weight(self) -> Array:
        """1 / sigma of each row ``(n,)``."""
        return 1 / self.sigma

    @cached_property
    def _sorted(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows sorted by station, and the index of each station's first one among them."""
        order = np.argsort(self.station, kind="stable")
        return order, np.flatnonzero(np.diff(self.station[order], prepend=-1))

    @cached_property
    def direction(self) -> Array:
        """Direction of the common error of each station, whitened, of unit length ``(n,)``."""
        return self.weight / np.sqrt(np.bincount(self.station, self.weight**2))[self.station]

    @cached_property
    def _stretch(self) -> Array:
        """Standard deviation along ``direction`` over that without common error ``(n,)``."""
        square = np.bincount(self.station, self.weight**2)[self.station]
        return np.sqrt(1 + self.common**2 * square)

    @property
    def log_determinant(self) -> float:
        """Log determinant of the covariance, metres squared."""
        return 2 * float(np.log(self.sigma).sum() + np.log(self._stretch[self.first_rows]).sum())

    def station_components(self, rows: Array) -> Array:
        """Part of whitened rows ``(n, ...)`` along each station's direction ``(stations, ...)``."""
        order, starts = self._sorted
        return np.add.reduceat((rows.T * self.direction).T[order], starts, axis=0)

    @cached_property
    def first_rows(self) -> NDArray[np.int64]:
        """The first row of each station ``(stations,)``."""
        order, starts = self._sorted
        return order[starts]

    def _scaled(self, rows: Array, factor: Array) -> Array:
        """Rows with their part along each station's direction multiplied by ``factor (n,)``."""
        if not self.common.any():
            return rows
        part = self.station_components(rows)[self.station]
        return np.asarray(rows + (part.T * (self.direction * (factor - 1))).T)

    def whiten(self, rows: Array) -> Array:
        """Return whitened rows ``(n, ...)``, dimensionless, from rows in metres."""
        return self._scaled((rows.T * self.weight).T, 1 / self._stretch)

    def metres(self, rows: Array) -> Array:
        """Return whitened rows ``(n, ...)`` in metres; the inverse of :meth:`whiten`."""
        return np.asarray((self._scaled(rows, self._stretch).T * self.sigma).T)
