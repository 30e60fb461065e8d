"""One coordinate of the tool, by a tracker, a measuring machine or a dial held against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import LEGS, Array
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
    dot,
    reading_point,
    signed_axes,
    vector,
)
from orthoglide.instruments.pose_estimation import estimate_frame
from orthoglide.instruments.unit_and_frame_checks import wrong_frame
from orthoglide.numerals import plain

HELD_DIRECTION_SD = 0.02
"""How well a dial that is held at the tool points along its direction, radians: a degree."""

_MISALIGNED_SIGMAS = 3.0  # standard deviations from which it is said


class Coordinate(Observation):
    """Coordinates of the tool, in a frame that may be turned; of a dial that reads one of them the
    direction is known, and not exactly.
    """

    kind = "tcp"
    instrument_phrase = "a tracker at the tool"
    quantity_phrase = "the tool along {}"
    sheet_instruction = "reading_mm is the tool's coordinate along the direction"
    nuisance_summary = (
        "datum of each direction; any turn where a setup has two directions or "
        "more; the direction of a single one to a degree"
    )
    repeatability = 1e-5
    axes = (0, 1, 2)
    nuisance_count = 6

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the coordinate along the axis, past a datum an axis and a small turn."""
        p, along = reading_point(row.pose, vector(row.mounting)), vector(row.mounting, 3)
        datum, turn = vector(row.nuisance), vector(row.nuisance, 3)
        turned = [
            p[0] + turn[1] * p[2] - turn[2] * p[1],
            p[1] + turn[2] * p[0] - turn[0] * p[2],
            p[2] + turn[0] * p[1] - turn[1] * p[0],
        ]
        return dot(along, turned) + dot(vector(row.mounting, 6), datum)

    def mounting_values(self, table: Table, rows: NDArray[np.intp], site: MountingContext) -> Array:
        """Return the place beside the tool, the axis in the base, and which datum counts."""
        turns = np.array([stand.rotation for stand in site.instrument_poses]).reshape(-1, 3, 3)
        axes = turns[table.setup[rows], table.axis[rows]]
        along = table.sign[rows, None] * axes
        return np.hstack([table.beside[rows], along, signed_axes(table, rows)])

    def nuisance_sds(self, setup: Setup, axis: Ints, beliefs: InstrumentPriors) -> Array:
        """Return what is known of a datum an axis and of three turns of the frame: nothing of a
        frame of two axes or more.
        """
        datum = 0.0 if beliefs.tracker_frame == "none" else np.inf
        return np.repeat(
            [datum, self._turn_sd(axis) if beliefs.tracker_frame == "rigid" else 0.0], 3
        )

    def _turn_sd(self, axis: Ints) -> float:
        return HELD_DIRECTION_SD if len(np.unique(axis)) < 2 else np.inf

    def estimate_pose(
        self, taken: SetupReadings, near: InstrumentPose | None, beliefs: InstrumentPriors
    ) -> InstrumentPose:
        """Return the frame in which the coordinates were read; the base's before they are."""
        if beliefs.tracker_frame != "rigid" or taken.is_unread:
            return InstrumentPose()
        start = None if near is None else near.rotation
        sd = self._turn_sd(taken.axis)
        return InstrumentPose(
            rotation=estimate_frame(taken.p, taken.axis, taken.value, taken.sigma, sd, start)
        )

    def apply_pose_nuisances(
        self, stand: InstrumentPose, nuisance: Array
    ) -> tuple[InstrumentPose, Array]:
        """Return the frame turned, as its small turn is one to the first order only."""
        from scipy.spatial.transform import Rotation

        turn = stand.rotation @ Rotation.from_rotvec(nuisance[3:]).as_matrix()
        return InstrumentPose(rotation=turn), np.concatenate([nuisance[:3], np.zeros(3)])

    def placement_warnings(
        self, stand: InstrumentPose, p: Array, axis: Ints
    ) -> Iterator[tuple[str, str]]:
        """Yield that a dial points beside its direction by more than one is held askew."""
        if len(np.unique(axis)) > 1:
            return
        along = stand.rotation[axis[0]]
        angle = float(np.arccos(np.clip(along[axis[0]], -1.0, 1.0)))
        if angle > _MISALIGNED_SIGMAS * HELD_DIRECTION_SD:
            yield (
                f"by its readings it points {np.rad2deg(angle):.1f} degrees beside "
                f"{LEGS[axis[0]]} (along {', '.join(plain(v, 3) for v in along)}), and is taken "
                "so: "
                f"look how it is held, and whether the direction in the file is right",
                "askew",
            )

    def find_unit_or_frame_error(
        self, taken: SetupReadings, apart: Array, beliefs: InstrumentPriors
    ) -> str:
        """Return which other frame or unit the coordinates seem to have."""
        sd = self._turn_sd(taken.axis) if beliefs.tracker_frame == "rigid" else 0.0
        return wrong_frame(taken.p, taken.axis, taken.value, sd)
