"""The readings a machine can give: setups, and the stations that each of them can visit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orthoglide import reduction
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.observations import Moves, Readings, Setup
from orthoglide.observations.approach import stroke_overshoot
from orthoglide.observations.protocols import dial_setup, require_dial_layout

GAUGES: tuple[float, ...] = (0.25, 0.35, 0.5, 0.65, 0.75)
"""Where the dials may stand, as fractions of the leg from its end at the platform."""

BARS: tuple[int, ...] = (0, 1, 2)
"""What they may touch: the leg's median line, bar 1, bar 2."""

DIAL_TRAVEL = 5e-3
"""Metres that the touched line may move sideways at the dial; see :func:`dial_scale`."""

_STEPS_UP, _STEPS_DOWN = 3, 4  # of the upper and the lower half stroke
_OFF_AXIS = 6e-3  # metres off the axis
_CLEARANCE = 5e-3  # metres that a dial keeps from either end of the leg
_COMMAND_DECIMALS = 9  # decimals of a metre that fit on a sheet


class Stations(NamedTuple):
    """Commands and the sides that they are reached from."""

    posture: list[str]  # labels for people, n of them
    command: Array  # rho (n, 3), metres
    p: Array  # nominal TCP (n, 3), metres
    approach: Array  # +1 or -1, the last move of all three axes (n,)

    def visible(self, setup: Setup, geometry: Geometry) -> NDArray[np.intp]:
        """Return the stations at which a dial stays on its leg and within its travel, nominally."""
        scale = dial_scale(geometry)
        carriage, platform = self.command[:, setup.leg], self.p[:, setup.leg]
        clearance = _CLEARANCE * scale
        on_leg = (platform + clearance <= setup.gauge) & (setup.gauge <= carriage - clearance)
        # The touched point moves by this share of the platform's motion.
        share = (carriage - setup.gauge) / (carriage - platform)
        sideways = np.abs(np.delete(self.p, setup.leg, axis=1)).max(axis=1) * share
        return np.flatnonzero(on_leg & (sideways <= DIAL_TRAVEL * scale))


def stations(leg: int, geometry: Geometry) -> Stations:
    """Return stations for a leg's dials, all within the stroke, approaches included.

    On the leg's own axis: steps of the stroke, reached with all axes moving in + and in -. Off it:
    6 mm to either side, at mechanical zero and in the middle of both half strokes, reached in +.
    """
    low, high = geometry.stroke
    down = low * np.arange(_STEPS_DOWN, 0, -1) / _STEPS_DOWN
    travels = [*down, *(high * np.arange(_STEPS_UP + 1) / _STEPS_UP)]
    # Label, places along the axes, and the direction from which it is reached.
    planned: list[tuple[str, dict[int, float], int]] = [
        (f"{travel * 1e3:+.6g}", {leg: travel}, side) for travel in travels for side in (1, -1)
    ]
    offset, others = _OFF_AXIS * dial_scale(geometry), [axis for axis in range(3) if axis != leg]
    for travel, axis, side in product((low / 2, 0.0, high / 2), others, (1, -1)):
        label = f"{travel * 1e3:+.6g} {LEGS[axis]}{side * offset * 1e3:+.6g}"
        planned.append((label, {leg: travel, axis: side * offset}, 1))
    p = np.array([[point.get(axis, 0.0) for axis in range(3)] for _, point, _ in planned])
    approach = np.array([float(side) for *_, side in planned])
    rho = np.round(reduction.inverse(p, geometry=geometry), _COMMAND_DECIMALS)
    before = rho - approach[:, None] * stroke_overshoot(geometry.stroke)
    in_stroke = geometry.in_stroke(np.stack([rho, before], axis=1)).all(axis=(1, 2))
    reachable = np.flatnonzero(in_stroke)
    labels = [planned[k][0] for k in reachable]
    return Stations(labels, rho[reachable], p[reachable], approach[reachable])


def dial_scale(geometry: Geometry) -> float:
    """Return the relative size of a dial with its stand, at most that in a workshop."""
    return min(geometry.scale, 1.0)


def reading_pool(geometry: Geometry, *, load: float = 0.0) -> Readings:
    """Return every reading that can be chosen, under a load in newtons, as a campaign without
    readings: a setup for every leg, direction, place and bar, one row a station.
    """
    require_dial_layout(geometry)
    setups: list[Setup] = []
    rows: list[tuple[int, str, Array, float]] = []
    for leg in range(3):
        on_leg = stations(leg, geometry)
        axes = map(LEGS.index, geometry.layout.names.across[leg])
        for axis, gauge, bar in product(axes, GAUGES, BARS):
            setup = dial_setup(geometry, leg, axis, gauge, bar)
            rows += [
                (len(setups), on_leg.posture[k], on_leg.command[k], on_leg.approach[k])
                for k in on_leg.visible(setup, geometry)
            ]
            setups.append(replace(setup, name=f"next-{setup.name}"))
    setup_rows, posture, command, approach = zip(*rows, strict=True)
    return Readings(
        "next", tuple(setups), np.array(setup_rows), np.array(command),
        np.full(len(posture), np.nan), np.repeat(np.array(approach)[:, None], 3, axis=1),
        load=np.array(load), posture=posture,
        moves=Moves(overshoot=stroke_overshoot(geometry.stroke)),
    )  # fmt: skip


def sheet_from_pool(pool: Readings, chosen: Sequence[int], name: str = "next") -> Readings:
    """Return chosen rows of a pool, with repetitions where a station is visited again, mounting by
    mounting, visits numbered, with their moves.
    """
    rows = np.array(sorted(chosen, key=lambda k: (pool.setup[k], k)), dtype=np.int64)
    repeat = np.array([int(np.sum(rows[:i] == k)) + 1 for i, k in enumerate(rows)], dtype=np.int64)
    # All stations once, then again: successive repeats would hide creep of the stand.
    order = np.lexsort([rows, repeat, pool.setup[rows]])
    return replace(pool.subset(rows[order]), name=name, repeat=repeat[order]).with_moves()
