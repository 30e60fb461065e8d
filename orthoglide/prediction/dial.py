"""What a dial shows of a closed mechanism: the touched line where it crosses the dial's plane.

The line of leg i runs from its carriage A to the platform B. With the dial at ``gauge`` along the
leg's own axis a (r removed), it crosses the plane at ``X = A + mu (B - A)`` where
``mu = (gauge + r - A_a) / (B_a - A_a)``; the dial shows the component of X along its direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.effects.catalogue import CATALOGUE
from orthoglide.geometry import Array, leg_axes
from orthoglide.observations import Campaign

DIAL_FAMILIES: tuple[str, ...] = tuple(n for n, f in CATALOGUE.items() if f.group == "dial")


@dataclass(frozen=True)
class Crossing:
    """Readings with their derivatives.

    Attributes:
        value: what the dials show, datum apart ``(n,)``, metres.
        by_ends: by the ends of the leg's bars ``(n, bar, end, 3)``.
        by_gauge: by the place of the dial along the leg ``(n,)``: the slope of the line.
        by_dial: by the dial's own parameters, in the order of ``DIAL_FAMILIES`` ``(n, 3)``.
    """

    value: Array
    by_ends: Array
    by_gauge: Array
    by_dial: Array


def bar_weights(bar: int) -> tuple[float, float]:
    """Shares of bars 1 and 2 in the touched line; 0 is the median line."""
    return {0: (0.5, 0.5), 1: (1.0, 0.0), 2: (0.0, 1.0)}[bar]


def crossings(
    ends: Array, campaign: Campaign, r: float, values: Mapping[str, float] | None = None
) -> Crossing:
    """Readings of all rows of a campaign.

    Args:
        ends: of the touched leg's bars, for each row ``(n, bar, end, 3)``, metres.
        campaign: says leg, direction, gauge and bar.
        r: distance from the TCP to the legs' last revolutes, metres.
        values: parameters of the dials, ``gauge_scale.SETUP`` ...
    """
    rows = np.arange(len(campaign))
    setups = [campaign.setups[k] for k in campaign.setup]
    share = np.array([bar_weights(s.bar) for s in campaign.setups])[campaign.setup]
    line = np.einsum("nb,nbex->nex", share, ends)
    start, along = line[:, 0], line[:, 1] - line[:, 0]
    own = np.array([s.leg for s in setups])
    gauge = np.array([s.gauge for s in setups]) + r
    mu = (gauge - start[rows, own]) / along[rows, own]
    point = start + mu[:, None] * along

    scale, angle, drift = _dial_values(campaign, values or {})
    sensed, sideways = _directions(campaign)
    direction = np.cos(angle)[:, None] * sensed + np.sin(angle)[:, None] * sideways
    turned = -np.sin(angle)[:, None] * sensed + np.cos(angle)[:, None] * sideways
    sign = np.array([s.sign for s in setups], dtype=float)
    gain = sign * (1 + scale)
    time = np.nan_to_num(campaign.time)

    # The direction stands across the leg's own axis, so a point's own shift only moves mu.
    slope = np.sum(direction * along, axis=1) / along[rows, own]
    by_point = gain[:, None] * direction
    by_point[rows, own] -= gain * slope
    by_ends = share[:, :, None, None] * np.stack(
        [(1 - mu)[:, None] * by_point, mu[:, None] * by_point], axis=1
    )[:, None]
    shown = np.sum(direction * point, axis=1)
    by_dial = {
        "gauge_scale": sign * shown,
        "gauge_direction": gain * np.sum(turned * point, axis=1),
        "gauge_drift": time,
    }
    return Crossing(
        gain * shown + drift * time,
        by_ends,
        gain * slope,
        np.stack([by_dial[name] for name in DIAL_FAMILIES], axis=1),
    )


def _dial_values(campaign: Campaign, values: Mapping[str, float]) -> list[Array]:
    return [
        np.array([values.get(f"{family}.{s.name}", 0.0) for s in campaign.setups])[campaign.setup]
        for family in ("gauge_scale", "gauge_direction", "gauge_drift")
    ]


def _directions(campaign: Campaign) -> tuple[Array, Array]:
    """Unit vectors of the sensed axis, and of the one the dial turns toward about the leg."""
    sensed = np.zeros((len(campaign.setups), 3))
    sideways = np.zeros_like(sensed)
    for k, setup in enumerate(campaign.setups):
        a, _, _ = leg_axes(setup.leg)
        sensed[k, setup.axis] = 1.0
        sideways[k] = np.cross(np.eye(3)[a], sensed[k])
    return sensed[campaign.setup], sideways[campaign.setup]
