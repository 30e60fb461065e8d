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

from orthoglide.effects import DialReading, Effect
from orthoglide.geometry import Array, Geometry
from orthoglide.observations import Campaign

SHARES = {0: (0.5, 0.5), 1: (1.0, 0.0), 2: (0.0, 1.0)}
"""Of bars 1 and 2 in the line that a setup touches, by its bar."""


def reading_function(effects: tuple[Effect, ...]) -> Any:
    """CasADi function (ends ``(12,)``, mounting ``(14,)``, dial ``(D,)``) -> reading, metres.

    ``ends`` are those of the touched leg's bars (bar, end, xyz); ``mounting`` is a row of
    :func:`mountings`; ``dial`` holds the values of the dial's effects.

    Args:
        effects: of the dial, ``D`` of them, in the order in which they change a reading.
    """
    ends, mounting = ca.SX.sym("ends", 12), ca.SX.sym("mounting", 14)
    dial = ca.SX.sym("dial", len(effects))
    share, own, sensed = mounting[:2], mounting[2:5], mounting[5:8]
    sideways, place, sign, time = mounting[8:11], mounting[11], mounting[12], mounting[13]
    start = share[0] * ends[0:3] + share[1] * ends[6:9]
    along = share[0] * ends[3:6] + share[1] * ends[9:12] - start
    crossing = start + (place - ca.dot(own, start)) / ca.dot(own, along) * along
    reading, across = sign * ca.dot(sensed, crossing), sign * ca.dot(sideways, crossing)
    for k, shows in enumerate(e.dial for e in effects if e.dial is not None):
        reading = shows(DialReading(reading, across, time), dial[k])
    return ca.Function("reading", [ends, mounting, dial], [reading])


def reading_tangent(function: Any) -> Any:
    """The reading with its derivatives by ends ``(12,)``, mounting ``(14,)`` and dial ``(D,)``."""
    arguments = [ca.SX.sym(f"a{k}", function.size1_in(k)) for k in range(3)]
    reading = function(*arguments)
    gradients = [ca.densify(ca.gradient(reading, a)) for a in arguments]
    return ca.Function("reading_tangent", arguments, [reading, *gradients])


BY_GAUGE = 11
"""Place of the dial's position among a mounting's entries."""


def mountings(campaign: Campaign, geometry: Geometry) -> Array:
    """How each row's dial is mounted ``(n, 14)``: shares of the bars, the leg's own axis, the axis
    sensed, the axis the dial turns toward, position, sign, time.
    """
    table = np.zeros((len(campaign.setups), 14))
    axes = np.eye(3)
    for row, setup in zip(table, campaign.setups, strict=True):
        slide, sensed = geometry.slides[setup.leg], axes[setup.axis]
        row[:2] = SHARES[setup.bar]
        row[2:5], row[5:8], row[8:11] = slide, sensed, np.cross(slide, sensed)
        row[11], row[12] = setup.gauge + geometry.r, setup.sign
    rows = table[campaign.setup]
    rows[:, 13] = np.nan_to_num(campaign.time)
    return rows


def dial_values(
    campaign: Campaign, values: Mapping[str, float], effects: tuple[Effect, ...]
) -> Array:
    """The dials' own parameters of each row ``(n, D)``, in the order of ``effects``."""
    table = [
        [values.get(name, 0.0) for effect in effects for name in effect.parameters((setup.name,))]
        for setup in campaign.setups
    ]
    return np.array(table).reshape(-1, len(effects))[campaign.setup]
