"""A dial on a leg: the touched line where it crosses the dial's plane.

The line of leg i runs from its carriage A to the platform B. With the dial at ``gauge`` along the
leg's own axis a (r removed), it crosses the plane at ``X = A + mu (B - A)`` where
``mu = (gauge + r - A_a) / (B_a - A_a)``; the dial shows the component of X along its direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import DialReading, Effect
from orthoglide.geometry import Array, Geometry
from orthoglide.instruments.observation import (
    InstrumentPriors,
    Ints,
    MountingContext,
    Observation,
    ReadingVariables,
    Setup,
    Table,
    Vector,
    add,
    dot,
    vector,
)

BAR_WEIGHTS = {0: (0.5, 0.5), 1: (1.0, 0.0), 2: (0.0, 1.0)}
"""Shares of bars 1 and 2 in the line that a setup touches, by its bar."""

DIAL_MOUNTING_SIZE = 13
"""Numbers that say how a dial stands on a leg, see :func:`dial_mountings`."""


DATUM_INDEX, PLACEMENT_INDEX = 0, 1
"""Nuisances of a dial: its datum, and how far beside its place along the leg it stands."""


def dial_mountings(table: Table, rows: NDArray[np.intp], geometry: Geometry) -> Array:
    """Return how each row's dial stands on its leg ``(m, 13)``: shares of the bars, the leg's own
    axis, the axis sensed, the axis that the dial turns toward, place and sign.
    """
    found, axes = np.zeros((len(table.setups), DIAL_MOUNTING_SIZE)), np.eye(3)
    for row, setup in zip(found, table.setups, strict=True):
        if setup.leg >= 0:
            slide, sensed = geometry.slides[setup.leg], axes[setup.axis]
            row[:2] = BAR_WEIGHTS[setup.bar]
            row[2:5], row[5:8], row[8:11] = slide, sensed, np.cross(slide, sensed)
            row[11], row[12] = setup.gauge + geometry.r, setup.sign
    return np.asarray(found[table.setup[rows]])


def dial_plane_crossing(ends: Any, mounting: Any, place: Any) -> Vector:
    """Return where the touched line crosses a plane across the leg ``(3,)``, metres.

    Args:
        ends: of the leg's bars (bar, end, xyz) ``(12,)``, metres.
        mounting: how the dial stands, as :func:`dial_mountings` has it.
        place: of the plane along the leg's own axis, metres.
    """
    one, two, own = mounting[0], mounting[1], vector(mounting, 2)
    start = add((one, vector(ends)), (two, vector(ends, 6)))
    along = add((one, vector(ends, 3)), (two, vector(ends, 9)), (-1, start))
    return add((1, start), ((place - dot(own, start)) / dot(own, along), along))


def dial_setup_error(setup: Setup) -> str:
    """Return what is wrong with where a dial stands on a leg, as a clause."""
    three = (0, 1, 2)
    if setup.leg not in three or setup.axis not in three:
        return "legs and axes are 0, 1 or 2"
    if setup.leg == setup.axis:
        return "direction is the leg's own axis: name one across the leg"
    places = (setup.gauge, setup.gauge2)
    if setup.sign not in (1, -1) or setup.bar not in BAR_WEIGHTS or not np.isfinite(places).all():
        return "its sign is 1 or -1, its bar 0, 1 or 2, and its gauge a length in metres"
    return ""


class LegDial(Observation):
    """Readings of a dial whose zero lies anywhere."""

    kind = "leg"
    instrument_phrase = "dials on the legs"
    quantity_phrase = "leg {1} along {0}"
    sheet_instruction = "reading_mm is what the dial shows"
    nuisance_summary = "datum, and the dial's place along the leg to its placement"
    repeatability = 2e-5  # stated in 2008, section 4.1
    dials = 1
    protocol = "sweep"
    axes = (0, 1, 2)
    setup_columns = ("leg", "direction", "gauge_mm", "bar")
    min_postures = 2
    nuisance_count = 2

    def is_affected_by(self, effect: Effect) -> bool:
        """Return whether an effect changes what a dial shows."""
        return effect.dial is not None

    def check(self, setup: Setup) -> str:
        """Return what is wrong with a setup."""
        return dial_setup_error(setup)

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the crossing along the dial's direction, as the dial shows it."""
        stands, sign, time = row.mounting, row.mounting[12], row.mounting[13]
        place = stands[11] + row.nuisance[PLACEMENT_INDEX]
        x = dial_plane_crossing(row.pose, stands, place)
        reading, across = sign * dot(vector(stands, 5), x), sign * dot(vector(stands, 8), x)
        for effect, value in zip(effects, row.effect_parameters, strict=True):
            if effect.dial is not None:
                reading = effect.dial(DialReading(reading, across, time), value)
        return reading + row.nuisance[DATUM_INDEX]

    def mounting_values(self, table: Table, rows: NDArray[np.intp], site: MountingContext) -> Array:
        """Return how the dials stand, and the time of each reading."""
        time = np.nan_to_num(table.time[rows])
        return np.column_stack([dial_mountings(table, rows, site.geometry), time])

    def nuisance_sds(self, setup: Setup, axis: Ints, beliefs: InstrumentPriors) -> Array:
        """Return what is known of the datum, and of the dial's place along the leg."""
        return np.array([np.inf, beliefs.dial_placement_sd])
