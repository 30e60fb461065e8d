"""How far one reading scatters: declared, from the machine file, or from the repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

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
_GRIDS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6)  # steps of instruments
_EXACT = 1e-3  # of a step, by which a figure that is printed in it may be off
_FEWEST_ON_GRID = 8  # readings: of a finer grid one in two or more is on the next by chance
FEWEST_REPEATS = 6  # degrees of freedom below which repeats say too little of the noise


@dataclass(frozen=True, repr=False)
class Noise:
    """Standard deviation of every reading.

    Attributes:
        sigma: by campaign, each ``(n,)``, metres: what averaging repeats reduces.
        typical: one figure for a single reading of a length, metres, all counted; radians where
            nothing but inclinations was read.
        source: where it comes from.
        common: standard deviation of what a dial rounds away alike at every visit to a station,
            metres; 0 where the scatter of the readings spreads the rounding out.
        dof: degrees of freedom behind ``typical``; infinite where it was not estimated.
    """

    sigma: tuple[Array, ...]
    typical: float
    source: NoiseSource
    common: float = 0.0
    dof: float = float("inf")


def noise_of(campaigns: Sequence[Campaign], dial: Dial, declared: float | None = None) -> Noise:
    """Noise of the readings, with the part that averaging does not reduce set apart.

    A figure declared for the run counts first, then ``sigma_mm`` of the rows, then the machine
    file's repeatability, then the scatter of repeats (successive differences, so that slow drift
    does not count), then the published repeatability. What a dial rounds away is added, and never
    less: resolution^2 / 12.

    Args:
        campaigns: the readings.
        dial: of the machine.
        declared: standard deviation of one reading, metres; replaces all others.

    Raises:
        InputError: where ``declared`` is nothing that a dial scatters by.
    """
    noise = _level(campaigns, dial, declared)
    common = float(common_rounding(noise.typical, dial.resolution))
    if common**2 < _COUNTS * noise.typical**2 or not repeated(campaigns):
        return noise
    sigma = tuple(np.sqrt(np.maximum(s**2 - common**2, _COUNTS * s**2)) for s in noise.sigma)
    at_edges = map(_at_edges, campaigns, sigma, [dial.resolution] * len(sigma))
    return replace(noise, sigma=tuple(at_edges), common=common)


def _at_edges(campaign: Campaign, sigma: Array, resolution: float) -> Array:
    """Sigmas ``(n,)``, half a step where the visits to a station show two neighbouring digits.

    There the true value stands at the edge between them, and a quiet dial shows one or the other:
    a whole step apart, which to its scatter elsewhere would be a slip, or a drift.
    """
    station = numbered(campaign.stations)
    low = np.full(int(station.max(initial=-1)) + 1, np.inf)
    high = -low
    np.minimum.at(low, station, campaign.reading)
    np.maximum.at(high, station, campaign.reading)
    steps = (high - low)[station] / resolution
    edge = (steps > 0.5) & (steps < 1.5) & (resolution > _QUIET * sigma)
    return np.where(edge, np.maximum(sigma, resolution / 2), sigma)


def off_grid(readings: Array, step: float) -> Array:
    """How far readings ``(n,)`` are from multiples of a dial's step, both metres; in steps."""
    return np.abs(readings / step - np.round(readings / step))


def shown_step(readings: Array) -> float:
    """The step that readings ``(n,)`` are multiples of, metres or radians; 0 where there is none,
    or they are too few to tell.
    """
    for step in _GRIDS if len(readings) >= _FEWEST_ON_GRID else ():
        if (off_grid(readings, step) < _EXACT).all() and np.ptp(readings) > step / 2:
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


def repeated(campaigns: Sequence[Campaign]) -> bool:
    """Whether any station is visited twice from the same side."""
    return any(len(np.unique(c.stations, axis=0)) < len(c) for c in campaigns)


def check_noise(noise: float, least: float = NOISE[0]) -> float:
    """The noise, a zero without its sign; refuses what no instrument scatters by, such as
    millimetres taken for metres.

    Raises:
        InputError: saying what is possible.
    """
    if not least <= noise <= NOISE[1]:
        raise InputError(
            f"the noise must be a standard deviation in metres, from {least:g} to {NOISE[1]:g}, "
            f"not {noise:g}"
        )
    return noise + 0.0


def _level(campaigns: Sequence[Campaign], dial: Dial, declared: float | None) -> Noise:
    rounding = dial.resolution**2 / 12
    if declared is not None:
        check_noise(declared)
        return _filled(campaigns, declared, "declared", rows_count=False)
    if dial.repeatability is not None:
        return _filled(campaigns, float(np.sqrt(dial.repeatability**2 + rounding)), "machine")
    variance, dof = repeat_variance(campaigns)
    if dof >= FEWEST_REPEATS and (variance > 0 or dial.resolution > 0):
        total = float(np.sqrt(total_variance(variance, dial.resolution)))
        return replace(_filled(campaigns, total, "repeats"), dof=dof)
    return _filled(campaigns, float(np.sqrt(PUBLISHED_REPEATABILITY**2 + rounding)), "machine")


def _filled(
    campaigns: Sequence[Campaign], typical: float, source: NoiseSource, *, rows_count: bool = True
) -> Noise:
    sigmas = tuple(
        np.where(np.isfinite(c.sigma), c.sigma, typical) if rows_count else np.full(len(c), typical)
        for c in campaigns
    )
    given = np.concatenate([np.zeros(0), *(c.sigma for c in campaigns)])
    if rows_count and len(given) and np.isfinite(given).all():
        return Noise(sigmas, float(np.sqrt(np.mean(given**2))), "declared")
    return Noise(sigmas, typical, source)


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
