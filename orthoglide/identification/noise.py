"""How far one reading scatters: declared, from the machine file, or from the repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.machine_file import Dial
from orthoglide.observations import Campaign

NoiseSource = Literal["declared", "machine", "repeats"]

PUBLISHED_REPEATABILITY = 2e-5
"""Metres: the repeatability stated in 2008, section 4.1; used where nothing better is known."""

_FEWEST_REPEATS = 6  # degrees of freedom below which repeats say too little of the noise


@dataclass(frozen=True)
class Noise:
    """Standard deviation of every reading.

    Attributes:
        sigma: by campaign, each ``(n,)``, metres.
        typical: one figure for a single reading, metres.
        source: where it comes from.
    """

    sigma: tuple[Array, ...]
    typical: float
    source: NoiseSource


def noise_of(campaigns: Sequence[Campaign], dial: Dial, declared: float | None = None) -> Noise:
    """Noise of the readings.

    A figure declared for the run counts first, then ``sigma_mm`` of the rows, then the machine
    file's repeatability, then the scatter of repeats (successive differences, so that slow drift
    does not count), then the published repeatability. What a dial rounds away is added, and never
    less: resolution^2 / 12.

    Args:
        campaigns: the readings.
        dial: of the machine.
        declared: standard deviation of one reading, metres; replaces all others.

    Raises:
        InputError: where ``declared`` is no positive length.
    """
    rounding = dial.resolution**2 / 12
    if declared is not None:
        if not (np.isfinite(declared) and declared > 0):
            raise InputError("the noise must be a positive standard deviation, in metres")
        return _filled(campaigns, declared, "declared", rows_count=False)
    if dial.repeatability is not None:
        return _filled(campaigns, float(np.sqrt(dial.repeatability**2 + rounding)), "machine")
    variance, dof = repeat_variance(campaigns)
    if dof >= _FEWEST_REPEATS:
        return _filled(campaigns, float(np.sqrt(max(variance, rounding))), "repeats")
    return _filled(campaigns, float(np.sqrt(PUBLISHED_REPEATABILITY**2 + rounding)), "machine")


def _filled(
    campaigns: Sequence[Campaign], typical: float, source: NoiseSource, *, rows_count: bool = True
) -> Noise:
    sigmas = tuple(
        np.where(np.isfinite(c.sigma), c.sigma, typical) if rows_count else np.full(len(c), typical)
        for c in campaigns
    )
    given = np.concatenate([c.sigma for c in campaigns])
    if rows_count and np.isfinite(given).all():
        return Noise(sigmas, float(np.sqrt(np.mean(given**2))), "declared")
    return Noise(sigmas, typical, source)


def repeat_variance(campaigns: Sequence[Campaign]) -> tuple[float, int]:
    """Variance of one reading from repeats, and its degrees of freedom.

    Repeats share setup, command and the approach of all three axes; successive ones are
    differenced, so that a slow drift hardly counts: ``mean (y_k+1 - y_k)^2 / 2``.
    """
    total, count = 0.0, 0
    for campaign in campaigns:
        table = np.column_stack(
            [campaign.setup, campaign.command, campaign.approach, campaign.load]
        )
        order = np.lexsort([campaign.order, *table.T[::-1]])
        same = np.all(np.diff(table[order], axis=0) == 0, axis=1)
        steps = np.diff(campaign.reading[order])[same]
        total += float(np.sum(steps**2)) / 2
        count += len(steps)
    # Differences of a run share readings: n of them carry about two thirds n degrees of freedom.
    return (total / count if count else float("nan")), int(np.floor(2 * count / 3))
