"""How far one reading scatters: declared, from the machine file, or from the repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.machine_file import Dial
from orthoglide.observations import Campaign, Recorded
from orthoglide.observations.arrays import numbered
from orthoglide.units import NOISE

NoiseSource = Literal["declared", "machine", "repeats"]

PUBLISHED_REPEATABILITY = 2e-5
"""Metres: the repeatability stated in 2008, section 4.1; used where nothing better is known."""

OFF_GRID = 0.06
"""Steps by which six decimals of a millimetre, in metres or inches, miss a multiple of a dial's."""

_COUNTS = 0.01  # share of a variance below which a part of it is not kept apart
_STEPS = 2.0  # scatter, in steps of a dial, from which its rounding is spread out evenly
_QUIET = 4.0  # sigmas within a step of the dial: no scatter makes two digits of one value
_RANGE = 2 / np.sqrt(np.pi)  # sigmas that two readings are apart, in the mean
_OFTENER = 0.25  # share of stations at such edges that is no chance, beside what scatter makes
_GRIDS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6)  # steps of instruments
_INCHES = (25.4e-6, 12.7e-6)  # a thousandth and half of it: steps of dials
_EXACT = 1e-3  # of a step, by which a figure that is printed in it may be off
_CHANCE = 1e-3  # of readings that all fall on a coarser step than their dial has
_FEWEST_ON_GRID = 8  # readings: of a finer grid one in two or more is on the next by chance
FEWEST_REPEATS = 6  # degrees of freedom below which repeats say too little of the noise


@dataclass(frozen=True, repr=False)
class Noise:
    """Standard deviation of every reading."""

    sigma: tuple[Array, ...]  # by campaign, each (n,), metres: what averaging repeats reduces
    # one figure for a single reading of a length, metres, all counted; radians where nothing but
    # inclinations was read
    typical: float
    source: NoiseSource  # where it comes from
    # by campaign, each (n,), metres: standard deviation of what a dial rounds away alike at every
    # visit to a station; 0 where the scatter spreads the rounding out
    common: tuple[Array, ...]
    step: tuple[Array, ...]  # by campaign, each (n,), metres: of every reading's dial
    resolution: float  # the commonest of the steps, which `typical` counts, metres
    # degrees of freedom behind `typical`; infinite where it was not estimated
    dof: float = float("inf")
    declared: float = float("nan")  # what was told of one dial, before its rounding, metres

    def of(self, rows: Sequence[NDArray[Any]]) -> Noise:
        """Of some rows of each campaign, by indices or booleans ``(n,)``."""
        sigma, common, step = (
            tuple(value[k] for value, k in zip(values, rows, strict=True))
            for values in (self.sigma, self.common, self.step)
        )
        return replace(self, sigma=sigma, common=common, step=step)


@dataclass(frozen=True)
class _Level:
    """What one reading scatters by."""

    total: float  # standard deviation, rounding to `step` counted, metres
    step: float  # of the dials that it was found for, metres
    source: NoiseSource  # where it comes from
    dof: float = float("inf")  # degrees of freedom behind it

    def at(self, step: Array) -> Array:
        """The same of dials of other steps."""
        scatter = max(self.total**2 - self.step**2 / 12, 0.0)
        return np.where(step == self.step, self.total, np.sqrt(scatter + step**2 / 12))


def noise_of(
    campaigns: Sequence[Campaign],
    dial: Dial,
    declared: float | None = None,
    step: Sequence[Array] | None = None,
) -> Noise:
    """Noise of the readings, with the part that averaging does not reduce set apart.

    A figure declared for the run counts first, then ``sigma_mm`` of the rows, then the machine
    file's repeatability, then the scatter of repeats (successive differences, so that slow drift
    does not count), then the published repeatability. What a dial rounds away is added, and never
    less: step^2 / 12, where the step is the dial's, or the coarser one that its readings show.

    Args:
        campaigns: the readings.
        dial: of the machine.
        declared: standard deviation of one reading, metres; replaces all others.
        step: of every reading's dial, by campaign, each ``(n,)``, metres, where it is known.

    Raises:
        InputError: where ``declared`` is nothing that a dial scatters by.
    """
    steps = tuple(dial_steps(c, dial.resolution) for c in campaigns) if step is None else step
    every = np.concatenate([np.zeros(0), *steps])
    sizes, count = np.unique(every, return_counts=True)
    commonest = float(sizes[np.argmax(count)]) if len(sizes) else dial.resolution
    fine, finest = finest_of(campaigns, steps) if len(sizes) else (campaigns, dial.resolution)
    level = _level(fine, replace(dial, resolution=finest), declared)
    # What is declared may be told of readings that were averaged, or never rounded.
    told = level.source == "declared"
    # Whether all are multiples of their dials' steps; those not taken yet will be.
    shown = [
        s * bool(s.all() and not (off_grid(c.reading, s) > OFF_GRID).any())
        for c, s in zip(campaigns, steps, strict=True)
    ]
    counted = commonest if not told or any(s.any() for s in shown) else 0.0
    typical = float(level.at(np.array([counted]))[0])
    # Whether any station is visited twice from the same side.
    again = any(len(np.unique(c.stations, axis=0)) < len(c) for c in campaigns)
    sigmas, commons = [], []
    for campaign, size, own in zip(campaigns, steps, shown, strict=True):
        given = np.isfinite(campaign.sigma) & (declared is None)
        rounding = np.where(given | told, own, size)
        total = level.at(rounding)
        common = _common(total, rounding) if again else np.zeros(len(campaign))
        total = np.where(given, np.hypot(campaign.sigma, rounding / np.sqrt(12)), total)
        if common.any():
            own = np.sqrt(np.maximum(total**2 - common**2, _COUNTS * total**2))
            total = np.where(common > 0, _at_edges(campaign, own, common, rounding), total)
        sigmas.append(total)
        commons.append(common)
    return Noise(
        tuple(sigmas), typical, level.source, tuple(commons), tuple(steps), commonest, level.dof,
        level.total if told else float("nan"),
    )  # fmt: skip


def _common(total: Array, step: Array) -> Array:
    """Rounding that repeats have in common ``(n,)``, metres; 0 where it is too small to matter."""
    found = np.zeros(len(total))
    for size in np.unique(step):
        rows = step == size
        common = float(common_rounding(total[rows][0], size))
        if common**2 >= _COUNTS * total[rows][0] ** 2:
            found[rows] = common
    return found


def finest_of(
    campaigns: Sequence[Campaign], step: Sequence[Array]
) -> tuple[Sequence[Campaign], float]:
    """Readings of the dials of the smallest step, which show best what readings scatter by, and
    that step.

    Args:
        campaigns: the readings.
        step: of every reading's dial, by campaign, each ``(n,)``, metres.
    """
    finest = float(np.concatenate(step).min())
    if all((s == finest).all() for s in step):
        return campaigns, finest
    kept = [(c, s == finest) for c, s in zip(campaigns, step, strict=True)]
    return [c.subset(rows) for c, rows in kept if rows.any()], finest


def dial_steps(campaign: Campaign, resolution: float) -> Array:
    """Step of every reading's dial ``(n,)``, metres: the resolution, or a coarser one of which all
    readings off the datum are multiples, of the campaign or else of one setup whose repeats show
    that it is no other unit.

    Args:
        campaign: the readings.
        resolution: of the machine's dial, metres; 0 where it does not round.
    """
    found = np.full(len(campaign), resolution)
    if resolution <= 0:
        return found
    apart = [_off_datum(campaign.reading[campaign.setup == k]) for k in range(len(campaign.setups))]
    whole = _coarser(np.concatenate(apart), resolution)
    for k, readings in enumerate(apart):
        rows, larger = campaign.setup == k, _coarser(readings, whole)
        found[rows] = larger if _is_coarse(campaign, rows, whole, larger) else whole
    return found


def _is_coarse(campaign: Campaign, rows: NDArray[np.bool_], step: float, larger: float) -> bool:
    """Whether repeats in some rows ``(n,)`` scatter less, in steps, than the rest does in its own:
    else these are readings of the same dial in a smaller unit.
    """
    if larger == step:
        return False
    own, dof = repeat_variance([campaign.subset(rows)])
    rest, _ = repeat_variance([campaign.subset(~rows)])
    less = own / larger**2 < rest / step**2 * np.sqrt(step / larger)
    return bool(less and dof >= FEWEST_REPEATS)


def _off_datum(readings: Array) -> Array:
    """Different readings of a setup less the first of them, metres; itself left out."""
    read = readings[np.isfinite(readings)]
    apart = np.unique(np.round(read - read[:1], 9))
    return np.asarray(apart[apart != 0])


def _coarser(apart: Array, step: float) -> float:
    """The largest step that different readings are multiples of; a smaller one where that may be
    by chance, which is of k readings ``(smaller / larger)^k``.

    Args:
        apart: readings off their datum, all different in a setup ``(k,)``, metres.
        step: that the dial has, metres.
    """
    for larger in sorted((*_GRIDS, *_INCHES)):
        few = larger <= step or (step / larger) ** len(apart) >= _CHANCE
        if not few and np.abs(apart).min() > larger / 2 and on_grid(apart, larger, _EXACT):
            step = larger
    return step


def _at_edges(campaign: Campaign, sigma: Array, common: Array, resolution: Array) -> Array:
    """Sigmas ``(n,)`` of dials, half a step where a station's visits show two neighbouring digits.

    There the true value stands at the edge between them, and a quiet dial shows one or the other:
    a whole step apart, which to its scatter elsewhere would be a slip, or a drift. Where more
    stations than these show several digits, the dial is not as quiet as it was declared.
    """
    station = numbered(campaign.stations)
    visits = np.bincount(station)
    low = np.full(len(visits), np.inf)
    high = -low
    np.minimum.at(low, station, campaign.reading)
    np.maximum.at(high, station, campaign.reading)
    apart = (high - low)[station]
    scatter = np.sqrt(np.maximum(sigma**2 + common**2 - resolution**2 / 12, 0.0))
    chance = _RANGE * (visits[station] - 1) * scatter / resolution
    again = visits[station] > 1
    if again.any() and np.mean(apart[again] > 0.5 * resolution[again]) > _OFTENER + np.mean(
        chance[again]
    ):
        return sigma
    edge = (apart > 0.5 * resolution) & (apart < 1.5 * resolution) & (resolution > _QUIET * sigma)
    return np.where(edge, np.maximum(sigma, resolution / 2), sigma)


def off_grid(readings: Array, step: float | Array) -> Array:
    """How far readings ``(n,)`` are from multiples of a dial's step, both metres; in steps."""
    return np.abs(readings / step - np.round(readings / step))


def on_grid(readings: Array, step: float | Array, miss: float = OFF_GRID) -> bool:
    """Whether readings ``(n,)`` are multiples of their dials' steps, but for less than ``miss``."""
    return bool((off_grid(readings, step) < miss).all())


def shown_step(readings: Array) -> float:
    """The step that readings ``(n,)`` are multiples of, metres or radians; 0 where there is none,
    or they are too few to tell.
    """
    for step in _GRIDS if len(readings) >= _FEWEST_ON_GRID else ():
        if on_grid(readings, step, _EXACT) and np.ptp(readings) > step / 2:
            return step
    return 0.0


def common_rounding(sigma: ArrayLike, resolution: float) -> Array:
    """Standard deviation of the rounding that repeats have in common, metres.

    The rounding of a value x that scatters by s (both in steps of the dial) has the mean
    ``sum_k (-1)^k sin(2 pi k x) exp(-2 (pi k s)^2) / (pi k)``. Over all x its variance is a
    twelfth of a squared step without scatter, and next to nothing once s is half a step.

    Args:
        sigma: of one reading, its rounding counted, metres.
        resolution: step of the dial, metres.
    """
    total = np.asarray(sigma, dtype=float)
    if resolution <= 0:
        return np.zeros_like(total)
    scatter = np.sqrt(np.maximum(total**2 - resolution**2 / 12, 0.0))[..., None] / resolution
    k = np.arange(1, 200)
    share = np.exp(-((2 * np.pi * k * scatter) ** 2)) / (2 * (np.pi * k) ** 2)
    return np.asarray(resolution * np.sqrt(share.sum(axis=-1)))


def total_variance(within: ArrayLike, resolution: float) -> Array:
    """Variance of one rounded reading from that of repeats about their mean, square metres.

    Repeats do not show the rounding that they share: with a scatter s before it, one reading
    has ``s^2 + step^2 / 12``, of which repeats show ``s^2 + step^2 / 12 - common(s)^2``. A dial
    that scatters by much less than its step shows hardly any variance at all.

    Args:
        within: from repeats, see :func:`repeat_variance`.
        resolution: step of the dial, metres.
    """
    if resolution <= 0:
        return np.asarray(within, dtype=float)
    scatter = np.concatenate([[0.0], np.geomspace(1e-3, _STEPS, 400)])
    total = (scatter**2 + 1 / 12) * resolution**2
    shown = np.maximum.accumulate(total - common_rounding(np.sqrt(total), resolution) ** 2)
    seen = np.asarray(within, dtype=float)
    return np.asarray(np.interp(seen, shown, total) + np.maximum(seen - shown[-1], 0.0))


def repeat_steps(campaign: Recorded) -> Array:
    """Each reading that repeats one, less the one at the visit before, metres."""
    table = campaign.stations
    order = np.lexsort([campaign.order, *table.T[::-1]])
    same = np.all(np.diff(table[order], axis=0) == 0, axis=1)
    return np.asarray(np.diff(campaign.reading[order])[same])


def check_noise(noise: float, least: float = NOISE[0]) -> float:
    """The noise, a zero without its sign; refuses what no instrument scatters by, such as
    millimetres taken for metres.

    Raises:
        InputError: saying what is possible.
    """
    if not isinstance(noise, Real) or not least <= noise <= NOISE[1]:
        raise InputError(
            f"the noise must be a standard deviation in metres, from {least:g} to {NOISE[1]:g}, "
            f"not {noise!r}"
        )
    return noise + 0.0


def _level(campaigns: Sequence[Campaign], dial: Dial, declared: float | None) -> _Level:
    step, rounding = dial.resolution, dial.resolution**2 / 12
    if declared is not None:
        return _Level(check_noise(declared), 0.0, "declared")
    given = np.concatenate([np.zeros(0), *(c.sigma for c in campaigns)])
    if len(given) and np.isfinite(given).all():
        return _Level(float(np.sqrt(np.mean(given**2))), 0.0, "declared")
    if dial.repeatability is not None:
        return _Level(float(np.sqrt(dial.repeatability**2 + rounding)), step, "machine")
    variance, dof = repeat_variance(campaigns)
    if dof >= FEWEST_REPEATS and (variance > 0 or step > 0):
        total = float(np.sqrt(total_variance(variance, step)))
        return _Level(total, step, "repeats", dof)
    return _Level(float(np.sqrt(PUBLISHED_REPEATABILITY**2 + rounding)), step, "machine")


def repeat_variance(campaigns: Sequence[Recorded]) -> tuple[float, int]:
    """Variance of one reading from repeats, and its degrees of freedom.

    Repeats share all that the machine is told, the approach of all three axes included; successive
    ones are differenced, so that a slow drift hardly counts: ``mean (y_k+1 - y_k)^2 / 2``.
    """
    total, count = 0.0, 0
    for campaign in campaigns:
        steps = repeat_steps(campaign)
        total += float(np.sum(steps**2)) / 2
        count += len(steps)
    # Differences of a run share readings: n of them carry about two thirds n degrees of freedom.
    return (total / count if count else float("nan")), int(np.floor(2 * count / 3))
