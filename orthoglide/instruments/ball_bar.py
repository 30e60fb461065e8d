"""A ball bar: the distance of the tool from a fixed ball."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    InstrumentPose,
    InstrumentPriors,
    Ints,
    MountingContext,
    Observation,
    ReadingVariables,
    Setup,
    SetupReadings,
    Table,
    add,
    length,
    reading_point,
    vector,
)
from orthoglide.instruments.pose_estimation import estimate_sphere_centre, plane_normal
from orthoglide.instruments.unit_and_frame_checks import wrong_bar_unit
from orthoglide.numerals import compact

BALL_CENTRE_SD = 1e-2
"""How far the ball may be from where its readings about one machine have it, metres: as far as a
machine that its owner can run is from another. Across the plane of a circle the readings do not
say, and everywhere else they know it far better."""

_MIN_PLANE_DISTANCE = 0.1  # of the extent of its places, how far a ball is from their plane


class BallBar(Observation):
    """Lengths, or deviations of them, about a ball that stands somewhere near its place."""

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
        """Return the length from the ball, past the bar's own."""
        p, ball = reading_point(row.pose, vector(row.mounting)), vector(row.mounting, 3)
        away = add((1, p), (-1, ball), (-1, vector(row.nuisance)))
        return length(away) + row.nuisance[3]

    def mounting_values(self, table: Table, rows: NDArray[np.intp], site: MountingContext) -> Array:
        """Return where the place is beside the tool, and the ball."""
        balls = np.array([stand.ball_centre for stand in site.instrument_poses]).reshape(-1, 3)
        return np.hstack([table.beside[rows], balls[table.setup[rows]]])

    def nuisance_sds(self, setup: Setup, axis: Ints, beliefs: InstrumentPriors) -> Array:
        """Return what is known of the ball's centre, and that nothing is of the bar's length."""
        return np.array([BALL_CENTRE_SD, BALL_CENTRE_SD, BALL_CENTRE_SD, np.inf])

    def estimate_pose(
        self, taken: SetupReadings, near: InstrumentPose | None, beliefs: InstrumentPriors
    ) -> InstrumentPose:
        """Return where the readings have the ball; in the middle of their places before they are
        taken.
        """
        about = None if near is None else near.ball_centre
        return InstrumentPose(
            ball_centre=estimate_sphere_centre(taken.p, np.nan_to_num(taken.value), about)
        )

    def placement_warnings(
        self, stand: InstrumentPose, p: Array, axis: Ints
    ) -> Iterator[tuple[str, str]]:
        """Yield that the ball stands beside the one plane of all places, on a side that is not
        known.
        """
        if (across := plane_normal(p)) is None:
            return
        size = float(np.sqrt(np.mean((p - p.mean(axis=0)) ** 2)))
        beside = float(abs((stand.ball_centre - p.mean(axis=0)) @ across))
        if beside > _MIN_PLANE_DISTANCE * size:
            yield (
                f"its places lie in one plane, and the ball {compact(beside * 1e3, 2)} mm beside "
                f"it; on which side no reading says, below was taken: on the other one, what is "
                f"told of the machine across that plane has the other sign; read places out of it "
                f"as well",
                "mirrored",
            )

    def find_unit_or_frame_error(
        self, taken: SetupReadings, apart: Array, beliefs: InstrumentPriors
    ) -> str:
        """Return which other unit the lengths seem to have."""
        return wrong_bar_unit(taken.p, taken.value)
