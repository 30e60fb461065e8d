"""A ball bar: the distance of the tool from a fixed ball."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    InstrumentPose,
    InstrumentPriors,
    Ints,
    Mounted,
    Observation,
    ReadingVariables,
    Setup,
    SetupReadings,
    length,
    linear_combination,
    reading_point,
    vector,
)
from orthoglide.instruments.unit_mistakes import wrong_unit
from orthoglide.numerals import compact

BALL_CENTRE_SD = 1e-2
"""Prior standard deviation of the ball's centre about its estimate, metres: the deviation of a
usable machine from its nominal. It matters only across the plane of a circle: other directions
are known far better from the readings."""

_MAX_STEPS = 50  # of Gauss-Newton
_STEP_TOLERANCE = 1e-13  # metres
_PLANARITY = 1e-2  # largest distance of points from their plane, over their extent
_MIN_OFFSET_SQUARED = 0.25  # squared height over radius; errors of zeros cause less
_CENTRE_PRIOR_WEIGHT = 5e-3  # weight of the initial centre: noise of 5 um against a millimetre
_MIN_PLANE_DISTANCE = 0.1  # height of a ball above the plane of the points, over their extent


class BallBar(Observation):
    """Lengths, or deviations of lengths, from a ball whose centre is estimated."""

    kind = "ballbar"
    instrument_phrase = "a ball bar"
    quantity_phrase = "the ball bar"
    sheet_instruction = (
        "reading_mm is the bar's length, or how much longer it is than at some place"
    )
    nuisance_summary = "centre and length"
    repeatability = 5e-6
    about_ball = True
    nuisance_count = 4

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the distance from the ball plus the bar's offset."""
        p, ball = reading_point(row.pose, vector(row.mounting)), vector(row.mounting, 3)
        from_ball = linear_combination((1, p), (-1, ball), (-1, vector(row.nuisance)))
        return length(from_ball) + row.nuisance[3]

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the offset from the tool, and the centre of the ball."""
        centres = mounted.by_reading(pose.ball_centre for pose in mounted.instrument_poses)
        return np.hstack([mounted.beside, centres])

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return the prior standard deviations of the ball's centre and, infinite, of the bar's
        length.
        """
        return np.array([BALL_CENTRE_SD, BALL_CENTRE_SD, BALL_CENTRE_SD, np.inf])

    def estimate_pose(
        self, readings: SetupReadings, initial: InstrumentPose | None, priors: InstrumentPriors
    ) -> InstrumentPose:
        """Return the centre of the ball; the middle of the points before readings are taken."""
        initial_centre = None if initial is None else initial.ball_centre
        return InstrumentPose(
            ball_centre=estimate_sphere_centre(
                readings.p, np.nan_to_num(readings.value), initial_centre
            )
        )

    def placement_warnings(
        self, pose: InstrumentPose, p: Array, axis: Ints
    ) -> Iterator[tuple[str, str]]:
        """Yield that the ball is off the plane of all points, on a side that is not known."""
        if (normal := plane_normal(p)) is None:
            return
        size = float(np.sqrt(np.mean((p - p.mean(axis=0)) ** 2)))
        height = float(abs((pose.ball_centre - p.mean(axis=0)) @ normal))
        if height > _MIN_PLANE_DISTANCE * size:
            yield (
                f"its points lie in one plane, {compact(height * 1e3, 2)} mm from the ball, and "
                f"the readings do not show on which side the ball is: below is assumed. If it is "
                f"above, errors of the machine across that plane have the opposite sign; measure "
                f"points off the plane too",
                "mirrored",
            )

    def find_unit_or_frame_error(
        self, readings: SetupReadings, distance: Array, priors: InstrumentPriors
    ) -> str:
        """Return a sentence on the unit that the lengths seem to have by mistake."""

        def off_sphere(length: Array) -> Array:
            centre = estimate_sphere_centre(readings.p, length)
            return np.asarray(length - np.linalg.norm(readings.p - centre, axis=1))

        def residual(length: Array) -> Array:
            off = off_sphere(length)
            return np.asarray(off - off.mean())

        # Nearly equal lengths fit in any unit, but at the wrong distance from the ball.
        value = readings.value
        return wrong_unit(value, residual) or wrong_unit(
            value, lambda v: off_sphere(v).mean(keepdims=True)
        )


def estimate_sphere_centre(p: Array, distance: Array, initial: Array | None = None) -> Array:
    """Return the centre of the sphere from which points ``(n, 3)`` have measured distances
    ``(n,)``, up to a common offset.

    The distances do not determine the centre across the plane of a circle: there it stays near
    the initial centre ``(3,)``. Without one, it is in the plane, or below it by the height that
    distances which are lengths give.
    """
    if initial is None:
        mean = p.mean(axis=0)
        scale = max(float(np.sqrt(np.mean((p - mean) ** 2))), 1e-9)
        q = (p - mean) / scale
        squares = np.sum(q * q, axis=1) - (distance / scale) ** 2
        columns = np.column_stack([2 * q, np.ones(len(q))])
        solution = np.linalg.lstsq(columns, squares, rcond=_PLANARITY)[0][:3]
        if (normal := plane_normal(p)) is not None and distance.min() > 0:
            # Lengths give the height above the plane, but not the side.
            squared_height = np.mean((distance / scale) ** 2 - np.sum((q - solution) ** 2, axis=1))
            if squared_height > _MIN_OFFSET_SQUARED:
                solution = solution + np.sqrt(squared_height) * normal
        initial = mean + scale * solution
    centre, bar_length = initial, 0.0
    prior_rows = _CENTRE_PRIOR_WEIGHT * np.eye(3, 4)
    for _ in range(_MAX_STEPS):
        from_centre = p - centre
        length = np.maximum(np.linalg.norm(from_centre, axis=1), 1e-9)
        jacobian = np.column_stack([-from_centre / length[:, None], np.ones(len(p))])
        residual = np.concatenate(
            [distance - length - bar_length, _CENTRE_PRIOR_WEIGHT * (initial - centre)]
        )
        step = np.linalg.lstsq(np.vstack([jacobian, prior_rows]), residual, rcond=1e-9)[0]
        centre, bar_length = centre + step[:3], bar_length + float(step[3])
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return np.asarray(centre)


def plane_normal(p: Array) -> Array | None:
    """Return the downward unit normal of the plane of points ``(n, 3)``; ``None`` without plane."""
    _, singular_values, directions = np.linalg.svd(p - p.mean(axis=0), full_matrices=False)
    if len(singular_values) < 3 or singular_values[2] > _PLANARITY * singular_values[1]:
        return None
    return np.asarray(-np.copysign(1.0, directions[2, 2]) * directions[2])
