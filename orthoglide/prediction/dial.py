"""What a dial shows of a closed mechanism: the touched line where it crosses the dial's plane.

The line of leg i runs from its carriage A to the platform B. With the dial at ``gauge`` along the
leg's own axis a (r removed), it crosses the plane at ``X = A + mu (B - A)`` where
``mu = (gauge + r - A_a) / (B_a - A_a)``; the dial shows the component of X along its direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.effects.catalogue import CATALOGUE
from orthoglide.geometry import Array, leg_axes
from orthoglide.observations import Campaign

DIAL_FAMILIES: tuple[str, ...] = tuple(n for n, f in CATALOGUE.items() if f.group == "dial")

_SHARES = {0: (0.5, 0.5), 1: (1.0, 0.0), 2: (0.0, 1.0)}  # of bars 1 and 2 in the touched line


def reading_function() -> Any:
    """CasADi function (ends ``(12,)``, mounting ``(14,)``, dial ``(3,)``) -> reading, metres.

    ``ends`` are those of the touched leg's bars (bar, end, xyz); ``mounting`` is a row of
    :func:`mountings`; ``dial`` holds gauge_scale, gauge_direction and gauge_drift.
    """
    ends, mounting = ca.SX.sym("ends", 12), ca.SX.sym("mounting", 14)
    dial = ca.SX.sym("dial", len(DIAL_FAMILIES))
    share, own, sensed = mounting[:2], mounting[2:5], mounting[5:8]
    sideways, place, sign, time = mounting[8:11], mounting[11], mounting[12], mounting[13]
    scale, angle, drift = dial[0], dial[1], dial[2]
    start = share[0] * ends[0:3] + share[1] * ends[6:9]
    along = share[0] * ends[3:6] + share[1] * ends[9:12] - start
    crossing = start + (place - ca.dot(own, start)) / ca.dot(own, along) * along
    direction = ca.cos(angle) * sensed + ca.sin(angle) * sideways
    reading = sign * (1 + scale) * ca.dot(direction, crossing) + drift * time
    return ca.Function("reading", [ends, mounting, dial], [reading])


def reading_tangent(function: Any) -> Any:
    """The reading with its derivatives by ends ``(12,)``, mounting ``(14,)`` and dial ``(3,)``."""
    arguments = [ca.SX.sym(f"a{k}", function.size1_in(k)) for k in range(3)]
    reading = function(*arguments)
    gradients = [ca.densify(ca.gradient(reading, a)) for a in arguments]
    return ca.Function("reading_tangent", arguments, [reading, *gradients])


BY_GAUGE = 11
"""Place of the dial's position among a mounting's entries."""


def mountings(campaign: Campaign, r: float) -> Array:
    """How each row's dial is mounted ``(n, 14)``: shares of the bars, the leg's own axis, the axis
    sensed, the axis the dial turns toward, position, sign, time.

    Args:
        campaign: its rows.
        r: distance from the TCP to the legs' last revolutes, metres.
    """
    table = np.zeros((len(campaign.setups), 14))
    axes = np.eye(3)
    for row, setup in zip(table, campaign.setups, strict=True):
        a, _, _ = leg_axes(setup.leg)
        row[:2] = _SHARES[setup.bar]
        row[2:5], row[5:8] = axes[a], axes[setup.axis]
        row[8:11] = np.cross(axes[a], axes[setup.axis])
        row[11], row[12] = setup.gauge + r, setup.sign
    rows = table[campaign.setup]
    rows[:, 13] = np.nan_to_num(campaign.time)
    return rows


def dial_values(campaign: Campaign, values: Mapping[str, float]) -> Array:
    """The dials' own parameters of each row ``(n, 3)``, in the order of ``DIAL_FAMILIES``."""
    table = [
        [values.get(f"{family}.{setup.name}", 0.0) for family in DIAL_FAMILIES]
        for setup in campaign.setups
    ]
    return np.array(table).reshape(-1, len(DIAL_FAMILIES))[campaign.setup]
