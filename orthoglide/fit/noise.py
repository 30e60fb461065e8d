"""Standard deviation of one reading: declared, from the machine file, from repeats, or usual.

The same rules hold for all kinds of readings. The rounding of an instrument's display is added.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
)
from orthoglide.geometry import Array
from orthoglide.instruments import LegDial, Observation
from orthoglide.machine_file import Instrument, MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids
from orthoglide.units import NOISE_LIMITS

NoiseSource = Literal["declared", "machine", "repeats"]
"""Where a standard deviation comes from; ``machine``: the machine file, or what is usual."""

NO_WEIGHT = 1e6
"""Factor on the standard deviation of a reading that is not to count."""

PUBLISHED_REPEATABILITY = LegDial.repeatability
"""Metres: the repeatability stated in 2008, section 4.1; used where nothing better is known."""

_NEGLIGIBLE_SHARE = 0.01  # share of a variance below which a part of it is not kept apart
_SIGMAS_PER_STEP = 4.0  # sigmas within a step of the dial: no scatter makes two digits of one value
_MEAN_RANGE = 2 / np.sqrt(np.pi)  # sigmas that two readings are apart, in the mean
_MAX_EDGE_SHARE = (
    0.25  # share of stations at such edges that is no chance, beside what scatter makes
)


@dataclass(frozen=True, repr=False)
class RowNoise:
    """Noise of the readings of one table."""

    sigma: Array  # standard deviation of each (n,), metres or radians: what averaging reduces
    # standard deviation of the rounding error that all visits to a station share; 0 where scatter
    # makes it independent (n,)
    common: Array
    step: Array  # of every reading's instrument, as far as it is counted (n,)
    # what the machine file or the kind's default says, or what is declared (n,)
    expected: Array
    from_repeats: NDArray[np.bool_]  # whether repeats, or a plate's roughness, say it (n,)
    weighted: NDArray[np.bool_]  # whether the readings have any weight (n,)

    @property
    def total(self) -> Array:
        """Standard deviation of one reading, all counted ``(n,)``."""
        return np.hypot(self.sigma, self.common)

    @classmethod
    def zeros(cls, n: int) -> RowNoise:
        """Return the noise of ``n`` readings of which nothing is known yet: zeros, to be filled."""
        sigma, common, step, expected = np.zeros((4, n))
        no = np.zeros(n, dtype=bool)
        return cls(sigma, common, step, expected, no, ~no)

    def fill(self, rows: NDArray[Any], noise: RowNoise) -> None:
        """Put the noise of some rows in its place."""
        for name, values in vars(noise).items():
            getattr(self, name)[rows] = values

    def with_rows(self, rows: NDArray[Any], noise: RowNoise) -> RowNoise:
        """Return the noise with that of some rows in its place."""
        changed = RowNoise(*(values.copy() for values in vars(self).values()))
        changed.fill(rows, noise)
        return changed

    def subset(self, rows: NDArray[Any]) -> RowNoise:
        """Return the noise of some rows, by indices or booleans ``(n,)``."""
        return RowNoise(*(values[rows] for values in vars(self).values()))

    def without_weight(self, rows: NDArray[np.bool_]) -> RowNoise:
        """Return the noise with some rows ``(n,)``, booleans, without any weight."""
        more = rows & self.weighted
        sigma = np.where(more, NO_WEIGHT * self.sigma, self.sigma)
        return replace(self, sigma=sigma, weighted=self.weighted & ~rows)


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviation of one reading of a kind."""

    total: float  # standard deviation, rounding to `step` counted, metres or radians
    step: float  # of the instruments that it was found for
    source: NoiseSource  # where it comes from
    dof: float = float("inf")  # degrees of freedom behind it; infinite where it was not estimated

    def for_step(self, step: Array) -> Array:
        """Return the standard deviation of readings of instruments with other steps."""
        scatter = max(self.total**2 - self.step**2 / 12, 0.0)
        return np.where(step == self.step, self.total, np.sqrt(scatter + step**2 / 12))


@dataclass(frozen=True, repr=False)
class Noise:
    """Noise of readings in one figure: of dials on legs, where there are any.

    Of readings of the tool alone it is the root mean square of lengths, or of inclinations where
    there are no lengths.
    """

    typical: float  # standard deviation of a single reading, metres or radians, all counted
    # where it comes from; of readings of the tool `declared` or `machine`, see `levels` for kinds
    source: NoiseSource
    resolution: float  # the commonest step of the first kind, which `typical` counts
    dof: float = float("inf")  # degrees of freedom behind the level of the first kind
    declared: float = float("nan")  # declared standard deviation before rounding; nan if none
    levels: Mapping[str, NoiseLevel] = field(default_factory=dict)  # by kind of reading
    # kinds of reading whose assumed noise is replaced by the larger one that their repeats show
    refuted: frozenset[str] = frozenset()


def instrument_of(spec: MachineFile, observation: Observation) -> Instrument:
    """Return what a machine file says of the instrument of a kind of readings."""
    own, dial = spec.instruments.get(observation.kind), spec.dial
    if own is not None or not observation.dials:
        return own or Instrument()
    one = dial.repeatability
    total = None if one is None else one * observation.dials**0.5
    return Instrument(dial.resolution, total)


def noise_of(
    given: Sequence[Readings],
    spec: MachineFile,
    declared: float | None = None,
    steps: Sequence[Array] | None = None,
) -> tuple[Noise, tuple[RowNoise, ...]]:
    """Return the noise of readings, and apart from it the rounding that averaging does not reduce.

    A figure declared for the run counts first (of dials on legs, where there are any), then the
    ``sigma`` of the rows, then the machine file's repeatability, then the scatter of repeats
    (successive differences, so that slow drift does not count), then what is usual of the kind.
    What an instrument rounds away is added, and never less: step^2 / 12, where the step is the
    instrument's, or the coarser one that its readings show.

    Args:
        given: tables of readings.
        spec: of the machine, says how its instruments read.
        declared: standard deviation of one reading, metres; replaces all others.
        steps: of every reading's instrument, by table, each ``(n,)``, metres, where it is known.

    Raises:
        InputError: where ``declared`` is nothing that an instrument scatters by.
    """
    each = tuple(RowNoise.zeros(len(one)) for one in given)
    on_legs = any(one.on_legs.any() for one in given)
    levels, noises = dict[str, NoiseLevel](), dict[str, Noise]()
    of_kind = dict.fromkeys(o for one in given for o, _ in one.observations)
    for observation in of_kind:
        found = [(k, one.of_kind(observation.kind)) for k, one in enumerate(given)]
        found = [(k, own) for k, own in found if own.any()]
        tables = [given[k].subset(own) for k, own in found]
        told = None if on_legs and not observation.on_leg else declared
        known = None if steps is None else [steps[k][own] for k, own in found]
        of = _KindNoise(observation, instrument_of(spec, observation), tables, told, known)
        noises[observation.kind], levels[observation.kind] = of.summary, of.level
        for (k, own), one in zip(found, of.rows(), strict=True):
            each[k].fill(own, one)
    first = next(iter(noises.values()), Noise(float("nan"), "machine", 0.0))
    if not on_legs:
        first = _tool_noise(given, each, noises, first)
    return replace(first, levels=levels), each


def _tool_noise(
    given: Sequence[Readings], rows: Sequence[RowNoise], noises: Mapping[str, Noise], first: Noise
) -> Noise:
    """The one figure of readings of the tool alone."""
    typical = rms_noise(given, [r.total for r in rows]) if rows else first.typical
    told = all(one.source == "declared" for one in noises.values())
    return replace(first, typical=typical, source="declared" if told else "machine")


def rms_noise(given: Sequence[Readings], sigma: Sequence[Array]) -> float:
    """Return the root mean square of the noise of lengths, or of turns where there are none.

    Args:
        given: tables of readings.
        sigma: standard deviations of each ``(n,)``, metres or radians.
    """
    every, turned = np.concatenate(sigma), np.concatenate([one.angular for one in given])
    of = every[~turned] if (~turned).any() else every
    return float(np.sqrt(np.mean(of**2)))


class _KindNoise:
    """Readings of one kind in all tables."""

    def __init__(
        self,
        observation: Observation,
        instrument: Instrument,
        tables: Sequence[Readings],
        declared: float | None,
        steps: Sequence[Array] | None,
    ) -> None:
        self._observation, self._instrument, self._declared = observation, instrument, declared
        self._tables = tables
        resolution = instrument.resolution or 0.0
        self._steps = (
            [_instrument_steps(one, resolution) for one in tables] if steps is None else steps
        )
        every = np.concatenate([np.zeros(0), *self._steps])
        sizes, count = np.unique(every, return_counts=True)
        self._commonest_step = float(sizes[np.argmax(count)]) if len(sizes) else resolution
        fine, finest = (
            readings_of_finest_step(tables, self._steps) if len(sizes) else (tables, resolution)
        )
        self.level = _noise_level(
            fine, observation, replace(instrument, resolution=finest), declared
        )
        # A declared noise may refer to averaged or unrounded readings: rounding is added to it only
        # if the instrument is known to round, and the readings lie on its grid.
        self._is_declared = self.level.source == "declared"
        # Steps of tables whose readings all are multiples of them, else 0; readings that were not
        # taken yet count as such.
        rounds = resolution > 0
        self._counted_steps = [
            s * bool(rounds and s.all() and not (off_grid(one.reading, s) > GRID_TOLERANCE).any())
            for one, s in zip(tables, self._steps, strict=True)
        ]

    @property
    def summary(self) -> Noise:
        """Noise of all readings of the kind as one figure."""
        counted = any(s.any() for s in self._counted_steps)
        step = self._commonest_step if not self._is_declared or counted else 0.0
        typical = float(self.level.for_step(np.array([step]))[0])
        told = self.level.total if self._is_declared else float("nan")
        return Noise(typical, self.level.source, self._commonest_step, self.level.dof, told)

    def rows(self) -> Iterator[RowNoise]:
        """Yield the noise of the rows of each table."""
        # Whether any station is visited twice from the same side.
        again = any(len(np.unique(one.stations, axis=0)) < len(one) for one in self._tables)
        usual = self._instrument.repeatability or self._observation.repeatability
        for table, size, own in zip(self._tables, self._steps, self._counted_steps, strict=True):
            given = np.isfinite(table.sigma) & (self._declared is None)
            rounding = np.where(given | self._is_declared, own, size)
            total = self.level.for_step(rounding)
            common = _common_rounding(total, rounding) if again else np.zeros(len(table))
            declared = np.hypot(table.sigma, rounding / np.sqrt(12))
            total = np.where(given, declared, total)
            if common.any():
                part = np.sqrt(np.maximum(total**2 - common**2, _NEGLIGIBLE_SHARE * total**2))
                total = np.where(
                    common > 0, _widen_at_rounding_edges(table, part, common, rounding), total
                )
            expected = np.hypot(usual, size / np.sqrt(12))
            told = given if self._declared is None else np.ones(len(table), dtype=bool)
            repeats = ~told & (self.level.source == "repeats")
            weighted = np.ones(len(table), dtype=bool)
            assumed = np.where(repeats, expected, total)
            yield RowNoise(total, common, rounding, assumed, repeats, weighted)


def expected_sigma(given: Readings, spec: MachineFile) -> Array:
    """Return the noise to reckon with before anything is read ``(n,)``, metres or radians."""
    found = np.empty(len(given))
    for observation, rows in given.observations:
        own = instrument_of(spec, observation)
        level = own.repeatability or observation.repeatability
        found[rows] = np.hypot(level, (own.resolution or 0.0) / np.sqrt(12))
    return np.where(np.isfinite(given.sigma), given.sigma, found)


def _instrument_steps(given: Readings, resolution: float) -> Array:
    """Step of every reading's instrument ``(n,)``: of a resolution that is known, or a coarser one
    that readings show; else what all readings are multiples of.
    """
    if resolution > 0:
        return dial_steps(given, resolution)
    shown = 0.0 if given.on_legs.any() else apparent_step(given.reading)
    return np.full(len(given), shown)


def _common_rounding(total: Array, step: Array) -> Array:
    """Rounding that repeats have in common ``(n,)``, metres; 0 where it is too small to matter."""
    found = np.zeros(len(total))
    for size in np.unique(step):
        rows = step == size
        common = float(common_rounding(total[rows][0], size))
        if common**2 >= _NEGLIGIBLE_SHARE * total[rows][0] ** 2:
            found[rows] = common
    return found


def _widen_at_rounding_edges(
    campaign: Readings, sigma: Array, common: Array, resolution: Array
) -> Array:
    """Sigmas ``(n,)`` of dials, half a step where a station's visits show two neighbouring digits.

    There the true value stands at the edge between them, and a quiet dial shows one or the other:
    a whole step apart, which to its scatter elsewhere would be a slip, or a drift. Where more
    stations than these show several digits, the dial is not as quiet as it was declared.
    """
    station = group_ids(campaign.stations)
    visits = np.bincount(station)
    low = np.full(len(visits), np.inf)
    high = -low
    np.minimum.at(low, station, campaign.reading)
    np.maximum.at(high, station, campaign.reading)
    apart = (high - low)[station]
    scatter = np.sqrt(np.maximum(sigma**2 + common**2 - resolution**2 / 12, 0.0))
    chance = _MEAN_RANGE * (visits[station] - 1) * scatter / resolution
    again = visits[station] > 1
    if again.any() and np.mean(apart[again] > 0.5 * resolution[again]) > _MAX_EDGE_SHARE + np.mean(
        chance[again]
    ):
        return sigma
    edge = (
        (apart > 0.5 * resolution)
        & (apart < 1.5 * resolution)
        & (resolution > _SIGMAS_PER_STEP * sigma)
    )
    return np.where(edge, np.maximum(sigma, resolution / 2), sigma)


def check_noise(noise: float, least: float = NOISE_LIMITS[0]) -> float:
    """The noise, a zero without its sign; refuses what no instrument scatters by, such as
    millimetres taken for metres.

    Raises:
        InputError: saying what is possible.
    """
    if not isinstance(noise, Real) or not least <= noise <= NOISE_LIMITS[1]:
        raise InputError(
            f"the noise must be a standard deviation in metres, from {least:g} to {NOISE_LIMITS[1]:g}, "
            f"not {noise!r}"
        )
    return noise + 0.0


def _noise_level(
    given: Sequence[Readings],
    observation: Observation,
    instrument: Instrument,
    declared: float | None,
) -> NoiseLevel:
    step = instrument.resolution or 0.0
    rounding = step**2 / 12
    if declared is not None:
        return NoiseLevel(check_noise(declared), 0.0, "declared")
    told = np.concatenate([np.zeros(0), *(one.sigma for one in given)])
    if len(told) and np.isfinite(told).all():
        return NoiseLevel(float(np.sqrt(np.mean(told**2))), 0.0, "declared")
    if instrument.repeatability is not None:
        return NoiseLevel(float(np.sqrt(instrument.repeatability**2 + rounding)), step, "machine")
    variance, dof = repeat_variance(given)
    if dof >= MIN_REPEAT_DOF and (variance > 0 or (step > 0 and observation.on_leg)):
        total = float(np.sqrt(total_variance(variance, step)))
        return NoiseLevel(max(total, observation.least_noise), step, "repeats", dof)
    return NoiseLevel(float(np.sqrt(observation.repeatability**2 + rounding)), step, "machine")
