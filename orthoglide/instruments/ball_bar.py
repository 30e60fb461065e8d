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
from orthoglide.instruments.pose_estimation import (
    estimate_sphere_centre,
    plane_normal,
    wrong_unit,
    wrong_unit_of_constant,
)
from orthoglide.numerals import compact

BALL_CENTRE_SD = 1e-2
"""Prior standard deviation of the ball's centre about its estimate, metres: the deviation of a
usable machine from its nominal. It matters only across the plane of a circle: other directions
are known far better from the readings."""

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
        """Return the prior of the ball's centre; the bar's length has none."""
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
                f"its places lie in one plane, and the ball {compact(height * 1e3, 2)} mm beside "
                f"it: no reading shows on which side, and below is assumed; if it is above, errors "
                f"of the machine across that plane have the opposite sign; read places out of it "
                f"as well",
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

        return wrong_unit(readings.value, residual) or wrong_unit_of_constant(
            readings.value, lambda length: float(off_sphere(length).mean())
        )
