"""Dials on a leg: one, or two whose difference is read.

The line of leg i runs from its carriage A to the platform B. A dial touches it in a plane across
the leg's own axis a, at ``gauge + r`` along it (files give gauges less the platform's radius r): at
``X = A + mu (B - A)``, where ``mu = (gauge + r - A_a) / (B_a - A_a)``. The dial shows the
component of X along its direction.

Two dials at one posture are the first technique of the 2008 chapter (Fig. 4a): both are set to zero
against a reference surface, so their difference is the leg's inclination to it and has no datum.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from orthoglide.effects import DialReading, Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    InstrumentPriors,
    Ints,
    Mounted,
    Observation,
    ReadingVariables,
    Setup,
    Vector,
    dot,
    linear_combination,
    vector,
)

BAR_WEIGHTS = {0: (0.5, 0.5), 1: (1.0, 0.0), 2: (0.0, 1.0)}
"""Shares of bars 1 and 2 in the line that a setup touches, by its bar."""

_MOUNTING_SIZE = 13
"""Numbers that describe the mounting of a dial on a leg, see :func:`_dial_mountings`."""

_PLACE, _SIGN = 11, 12
"""Positions in the mounting of a dial: its place along the leg, its sign."""

_TIME = _SECOND_PLACE = _MOUNTING_SIZE
"""Position behind the mounting: the time of a reading, or the place of the second of two dials."""

DATUM_INDEX, PLACEMENT_INDEX = 0, 1
"""Nuisance parameters of a dial: its datum, and the error of its place along the leg."""


def _dial_mountings(mounted: Mounted) -> Array:
    """Return the mounting of each reading's dial ``(m, 13)``: weights of the bars, axis of the leg,
    axis sensed, axis toward which a rolled dial turns, place along the leg, sign.
    """
    setups, geometry, axes = mounted.table.setups, mounted.geometry, np.eye(3)
    mountings = np.zeros((len(setups), _MOUNTING_SIZE))
    for row, setup in zip(mountings, setups, strict=True):
        if setup.leg >= 0:
            slide, sensed = geometry.slides[setup.leg], axes[setup.axis]
            row[:2] = BAR_WEIGHTS[setup.bar]
            row[2:5], row[5:8], row[8:11] = slide, sensed, np.cross(slide, sensed)
            row[_PLACE], row[_SIGN] = setup.gauge + geometry.r, setup.sign
    return mounted.by_reading(mountings)


def _plane_crossing(ends: Any, mounting: Any, place: Any) -> Vector:
    """Return the point where the touched line, by the ends of the leg's bars (bar, end, xyz)
    ``(12,)``, crosses a plane across the leg at a place along its axis ``(3,)``, metres.
    """
    weight1, weight2, slide = mounting[0], mounting[1], vector(mounting, 2)
    start = linear_combination((weight1, vector(ends)), (weight2, vector(ends, 6)))
    line = linear_combination((weight1, vector(ends, 3)), (weight2, vector(ends, 9)), (-1, start))
    return linear_combination((1, start), ((place - dot(slide, start)) / dot(slide, line), line))


class LegDial(Observation):
    """Readings of a dial with an arbitrary zero."""

    kind = "leg"
    instrument_phrase = "dials on the legs"
    quantity_phrase = "leg {1} along {0}"
    sheet_instruction = "reading_mm is what the dial shows"
    nuisance_summary = "datum, and the dial's place along the leg within its placement"
    repeatability = 2e-5  # stated in 2008, section 4.1
    dials = 1
    protocol: ClassVar[Literal["sweep", "parallelism"]] = "sweep"
    axes = (0, 1, 2)
    setup_columns: ClassVar[tuple[str, ...]] = ("leg", "direction", "gauge_mm", "bar")
    min_postures = 2
    nuisance_count = 2

    def is_affected_by(self, effect: Effect, setup: Setup | None = None) -> bool:
        """Return whether an effect is an error of the dial itself, not of the machine."""
        return effect.dial is not None

    def setup_error(self, setup: Setup) -> str:
        """Return what is wrong with a setup."""
        if not {setup.leg, setup.axis} <= {0, 1, 2}:
            return "legs and axes are 0, 1 or 2"
        if setup.leg == setup.axis:
            return "direction is the leg's own axis: name one across the leg"
        places = (setup.gauge, setup.gauge2)
        is_valid = setup.sign in (1, -1) and setup.bar in BAR_WEIGHTS
        if not is_valid or not np.isfinite(places).all():
            return "its sign is 1 or -1, its bar 0, 1 or 2, and its gauge a length in metres"
        return ""

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the crossing point along the dial's direction, as the dial shows it."""
        mounting, sign, time = row.mounting, row.mounting[_SIGN], row.mounting[_TIME]
        place = mounting[_PLACE] + row.nuisance[PLACEMENT_INDEX]
        x = _plane_crossing(row.pose, mounting, place)
        reading, across = sign * dot(vector(mounting, 5), x), sign * dot(vector(mounting, 8), x)
        for effect, value in zip(effects, row.effect_parameters, strict=True):
            if effect.dial is not None:
                reading = effect.dial(DialReading(reading, across, time), value)
        return reading + row.nuisance[DATUM_INDEX]

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the mountings of the dials, and the time of each reading."""
        time = np.nan_to_num(mounted.table.time[mounted.rows])
        return np.column_stack([_dial_mountings(mounted), time])

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return the prior standard deviations of the datum, infinite, and of the dial's place
        along the leg, metres.
        """
        return np.array([np.inf, priors.dial_placement_sd])


class Parallelism(LegDial):
    """Readings of the dial at ``gauge2`` minus those of the dial at ``gauge``."""

    kind = "parallelism"
    instrument_phrase = "two dials on a leg"
    quantity_phrase = "the inclination of leg {1} along {0}"
    sheet_instruction = (
        "reading_mm is what the dial at gauge2_mm shows less what the dial at gauge_mm shows"
    )
    nuisance_summary = (
        "slope of the reference surface, where the machine file has a tolerance for it"
    )
    repeatability = 2e-5 * 2**0.5  # two dials, each as stated in 2008, section 4.1
    dials = 2
    protocol = "parallelism"
    setup_columns = ("leg", "direction", "gauge_mm", "gauge2_mm", "bar")
    min_postures = 1
    nuisance_count = 1

    def is_affected_by(self, effect: Effect, setup: Setup | None = None) -> bool:
        """Return ``False``: a pair has no errors of single dials."""
        return False

    def setup_error(self, setup: Setup) -> str:
        """Return what is wrong with a setup."""
        if setup.gauge2 != setup.gauge:
            return super().setup_error(setup)
        return "its two dials stand at one place: correct gauge_mm or gauge2_mm"

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the difference of two crossing points, plus the slope of the surface."""
        mounting = row.mounting
        place1, place2 = mounting[_PLACE], mounting[_SECOND_PLACE]
        x1, x2 = (_plane_crossing(row.pose, mounting, place) for place in (place1, place2))
        difference = dot(vector(mounting, 5), linear_combination((1, x2), (-1, x1)))
        return mounting[_SIGN] * difference + row.nuisance[0] * (place2 - place1)

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the mountings of the first dials, and the places of the second."""
        second = mounted.by_reading(s.gauge2 for s in mounted.table.setups) + mounted.geometry.r
        return np.column_stack([_dial_mountings(mounted), second])

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return the prior standard deviation of the surface's slope, radians."""
        return np.array([priors.surface_slope_sd])
