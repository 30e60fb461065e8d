"""How far one reading of the tool scatters: declared, usual, or as repeats and plates show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from orthoglide.fit.noise import FEWEST_REPEATS, repeat_variance, shown_step
from orthoglide.fit.surface import roughness
from orthoglide.geometry import Array
from orthoglide.instruments import INSTRUMENTS
from orthoglide.machine_file import Instrument
from orthoglide.observations import ToolCampaign

LOUD = 3.0
"""Times the noise that is usual of an instrument, from which that is said; of a plate's roughness
no more counts as noise of its touches: the printers that are tested with have two at most."""

_LEAST = 0.05


def shown_sigma(
    campaign: ToolCampaign,
    instruments: Mapping[str, Instrument],
    usual: Array,
    place: Array,
    height: Array,
) -> tuple[Array, Array]:
    """Noise of each reading ``(n,)``: declared, or as repeats and rough plates show it; and by how
    much touches stray that no repeat speaks of.
    """
    found = _by_kind(campaign, instruments, step_of, _of_repeats)
    stray = np.zeros(len(campaign))
    for k, setup in enumerate(campaign.setups):
        if setup.instrument.touches:
            rows = campaign.setup == k
            rough, off = roughness(place[rows], height[rows], campaign.approach[rows])
            found[rows] = np.maximum(found[rows], np.minimum(rough, LOUD * usual[rows]))
            stations = campaign.stations[rows]
            if len(np.unique(stations, axis=0)) == len(stations):
                stray[rows] = off
    return np.where(np.isfinite(campaign.sigma), campaign.sigma, found), stray


def usual_sigma(
    campaign: ToolCampaign, instruments: Mapping[str, Instrument], noise: float | None
) -> Array:
    """What such instruments scatter by ``(n,)``, with the rounding that readings show."""
    return np.full(len(campaign), noise) if noise else _by_kind(campaign, instruments, step_of)


def expected_sigma(campaign: ToolCampaign, instruments: Mapping[str, Instrument]) -> Array:
    """Noise to reckon with before anything is read ``(n,)``: declared, or of the instruments."""
    return _by_kind(campaign, instruments, lambda _, own: own.resolution or 0.0)


def _by_kind(
    campaign: ToolCampaign,
    instruments: Mapping[str, Instrument],
    step: Callable[[ToolCampaign, Instrument], float],
    repeats: Callable[[ToolCampaign], float] = lambda _: 0.0,
) -> Array:
    """Noise of each reading ``(n,)``: declared, or of its kind: of its instrument, else of repeats
    where there are enough, else usual; and its rounding.
    """
    found = np.empty(len(campaign))
    for kind in dict.fromkeys(campaign.kind):
        rows, own = campaign.of_kind(kind), instruments.get(kind, Instrument())
        part = campaign.subset(rows)
        level = own.repeatability or repeats(part) or INSTRUMENTS[kind].repeatability
        found[rows] = np.hypot(level, step(part, own) / np.sqrt(12))
    return np.where(np.isfinite(campaign.sigma), campaign.sigma, found)


def step_of(part: ToolCampaign, own: Instrument) -> float:
    """Step of readings of a kind: declared, or what all of them are multiples of."""
    return own.resolution or shown_step(part.reading)


def _of_repeats(campaign: ToolCampaign) -> float:
    """Standard deviation of one reading of a kind from repeats; 0 where there are too few, or they
    are copies, or of a coarse step.
    """
    variance, dof = repeat_variance([campaign])
    if dof < FEWEST_REPEATS or variance == 0:
        return 0.0
    return max(float(np.sqrt(variance)), _LEAST * campaign.setups[0].instrument.repeatability)
