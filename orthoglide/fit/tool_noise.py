"""How far one reading of the tool scatters: declared, usual, or as repeats and plates show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from orthoglide.fit.noise import FEWEST_REPEATS, repeat_variance, shown_step
from orthoglide.geometry import Array
from orthoglide.instruments import INSTRUMENTS
from orthoglide.machine_file import Instrument
from orthoglide.observations import ToolCampaign
from orthoglide.ordering import largest

LOUD = 3.0
"""Times the noise that is usual of an instrument, from which that is said; of a plate's roughness
no more counts as noise of its touches: the printers that are tested with have two at most."""

DEGREE = 4
"""Of the smoothest surface: no rigid cause makes more waves than a polynomial of this degree."""

_OF_A_SIDE = 1  # degree of what approach from the other side adds
_FEWEST_ROUGH = 12
_STRAY = 6.0  # times what the other heights scatter, of one that is none of them
_STRAYS = 0.05  # share of a mesh: more are no single touches
_FINEST = 1e-6  # metres: no plate is smoother

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


def _polynomials(place: Array, degree: int) -> Array:
    """Powers of both coordinates up to a degree ``(n, k)``."""
    x, y = place.T
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def roughness(place: Array, height: Array, approach: Array) -> tuple[float, Array]:
    """Standard deviation of heights about the smoothest surface, and by how much single ones are
    off it ``(n,)``, metres; 0 where there are too few, or a height is as rough as the others.

    A bed is rough besides being bent: what no polynomial of the fourth degree follows, which is
    more than any rigid cause makes, counts as noise of its touches. From the other side a machine
    with lost motion shows another surface: smoother, as the drives' shares in the height are. A
    touch that is far off the surface of all others is a speck, or a bad touch.

    Args:
        place: on the plate over its radius ``(n, 2)``.
        height: ``(n,)``, metres.
        approach: of each axis ``(n, 3)``.
    """
    smoother = _polynomials(place, _OF_A_SIDE)
    columns = np.hstack(
        [_polynomials(place, DEGREE), *(side[:, None] * smoother for side in approach.T)]
    )
    kept, stray, rough = np.ones(len(height), dtype=bool), np.zeros(len(height)), 0.0
    while (fit := _surface(columns[kept], height[kept])) is not None:
        basis, rest, dof = fit
        rough = float(np.sqrt(rest @ rest / dof))
        # As all others have the surface, and by what they scatter about it.
        free = np.maximum(1 - np.sum(basis**2, axis=1), 1e-9)
        others = np.sqrt(np.maximum(rest @ rest - rest**2 / free, 0.0) / (dof - 1))
        off = rest / free
        far = np.abs(off) * np.sqrt(free) / np.maximum(others, _FINEST)
        worst = largest(far)
        if far[worst] < _STRAY or np.sum(~kept) >= _STRAYS * len(kept):
            break
        at = np.flatnonzero(kept)[worst]
        kept[at], stray[at] = False, off[worst]
    return rough, stray


def _surface(columns: Array, height: Array) -> tuple[Array, Array, int] | None:
    """Orthonormal columns, what they leave, and its degrees of freedom, where these are enough."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, size > 1e-9 * size.max(initial=0.0)]
    dof = len(height) - basis.shape[1]
    if dof < _FEWEST_ROUGH:
        return None
    return basis, height - basis @ (basis.T @ height), dof
