"""What repeats show of an instrument's scatter, and what its display rounds away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.observations.repetition import repeat_steps

GRID_TOLERANCE = 0.06
"""Steps by which six decimals of a millimetre, in metres or inches, miss a multiple of a dial's."""

_MAX_SCATTER_STEPS = (
    2.0  # scatter, in steps of a dial, from which its rounding is spread out evenly
)
_METRIC_STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6)  # steps of instruments
_INCH_STEPS = (25.4e-6, 12.7e-6)  # a thousandth and half of it: steps of dials
_DISPLAY_TOLERANCE = 1e-3  # of a step, by which a figure that is printed in it may be off
_CHANCE = 1e-3  # of readings that all fall on a coarser step than their dial has
_MIN_READINGS_ON_GRID = 8  # readings: of a finer grid one in two or more is on the next by chance
MIN_REPEAT_DOF = 6  # degrees of freedom below which repeats say too little of the noise


def readings_of_finest_step(
    campaigns: Sequence[Readings], step: Sequence[Array]
) -> tuple[Sequence[Readings], float]:
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


def dial_steps(campaign: Readings, resolution: float) -> Array:
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
    apart = [
        _datum_differences(campaign.reading[campaign.setup == k])
        for k in range(len(campaign.setups))
    ]
    whole = _coarser_step(np.concatenate(apart), resolution)
    for k, readings in enumerate(apart):
        rows, larger = campaign.setup == k, _coarser_step(readings, whole)
        found[rows] = larger if _has_coarser_dial(campaign, rows, whole, larger) else whole
    return found


def _has_coarser_dial(
    campaign: Readings, rows: NDArray[np.bool_], step: float, larger: float
) -> bool:
    """Whether repeats in some rows ``(n,)`` scatter less, in steps, than the rest does in its own:
    else these are readings of the same dial in a smaller unit.
    """
    if larger == step:
        return False
    own, dof = repeat_variance([campaign.subset(rows)])
    rest, _ = repeat_variance([campaign.subset(~rows)])
    less = own / larger**2 < rest / step**2 * np.sqrt(step / larger)
    return bool(less and dof >= MIN_REPEAT_DOF)


def _datum_differences(readings: Array) -> Array:
    """Different readings of a setup less the first of them, metres; itself left out."""
    read = readings[np.isfinite(readings)]
    apart = np.unique(np.round(read - read[:1], 9))
    return np.asarray(apart[apart != 0])


def _coarser_step(apart: Array, step: float) -> float:
    """The largest step that different readings are multiples of; a smaller one where that may be
    by chance, which is of k readings ``(smaller / larger)^k``.

    Args:
        apart: readings off their datum, all different in a setup ``(k,)``, metres.
        step: that the dial has, metres.
    """
    for larger in sorted((*_METRIC_STEPS, *_INCH_STEPS)):
        few = larger <= step or (step / larger) ** len(apart) >= _CHANCE
        if (
            not few
            and np.abs(apart).min() > larger / 2
            and on_grid(apart, larger, _DISPLAY_TOLERANCE)
        ):
            step = larger
    return step


def off_grid(readings: Array, step: float | Array) -> Array:
    """Return the distance of readings ``(n,)`` from multiples of a step, both metres, in steps."""
    return np.abs(readings / step - np.round(readings / step))


def on_grid(readings: Array, step: float | Array, miss: float = GRID_TOLERANCE) -> bool:
    """Return whether readings ``(n,)`` are multiples of the step within ``miss`` steps."""
    return bool((off_grid(readings, step) < miss).all())


def apparent_step(readings: Array) -> float:
    """The step that readings ``(n,)`` are multiples of, metres or radians; 0 where there is none,
    or they are too few to tell.
    """
    for step in _METRIC_STEPS if len(readings) >= _MIN_READINGS_ON_GRID else ():
        if on_grid(readings, step, _DISPLAY_TOLERANCE) and np.ptp(readings) > step / 2:
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
    scatter = np.concatenate([[0.0], np.geomspace(1e-3, _MAX_SCATTER_STEPS, 400)])
    total = (scatter**2 + 1 / 12) * resolution**2
    shown = np.maximum.accumulate(total - common_rounding(np.sqrt(total), resolution) ** 2)
    seen = np.asarray(within, dtype=float)
    return np.asarray(np.interp(seen, shown, total) + np.maximum(seen - shown[-1], 0.0))


def repeat_variance(campaigns: Sequence[Readings]) -> tuple[float, int]:
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
