"""Coordinates of the tool, by a tracker, a measuring machine or a dial held against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments.observation import (
    InstrumentPose,
    InstrumentPriors,
    Ints,
    Mounted,
    Observation,
    ReadingVariables,
    Setup,
    SetupReadings,
    dot,
    reading_point,
    vector,
)
from orthoglide.instruments.pose_estimation import estimate_frame, wrong_frame
from orthoglide.numerals import plain

HELD_DIRECTION_SD = 0.02
"""Standard deviation of the direction of a dial that is held at the tool, radians: a degree."""

_MISALIGNED_SIGMAS = 3.0  # standard deviations from which a warning is given


class Coordinate(Observation):
    """Coordinates of the tool in a frame that may be rotated; the direction of a dial, which reads
    a single coordinate, has a prior.
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
        """Return the coordinate along the axis, after a small rotation, plus the axis' datum."""
        p, direction = reading_point(row.pose, vector(row.mounting)), vector(row.mounting, 3)
        datum, turn = vector(row.nuisance), vector(row.nuisance, 3)
        turned = [
            p[0] + turn[1] * p[2] - turn[2] * p[1],
            p[1] + turn[2] * p[0] - turn[0] * p[2],
            p[2] + turn[0] * p[1] - turn[1] * p[0],
        ]
        return dot(direction, turned) + dot(vector(row.mounting, 6), datum)

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the offset from the tool, the axis in the base, and the weights of the datums."""
        rotations = mounted.by_reading(pose.rotation for pose in mounted.instrument_poses)
        directions = np.einsum("mj,mjk->mk", mounted.signed_axes, rotations)
        return np.hstack([mounted.beside, directions, mounted.signed_axes])

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return the priors of three datums and of three rotations of the frame."""
        datum_sd = 0.0 if priors.tracker_frame == "none" else np.inf
        return np.repeat([datum_sd, self._rotation_sd(axis, priors)], 3)

    def _rotation_sd(self, axis: Ints, priors: InstrumentPriors) -> float:
        """Return the prior of the frame's rotation; infinite if two axes or more are read."""
        if priors.tracker_frame != "rigid":
            return 0.0
        return HELD_DIRECTION_SD if len(np.unique(axis)) < 2 else np.inf

    def estimate_pose(
        self, readings: SetupReadings, initial: InstrumentPose | None, priors: InstrumentPriors
    ) -> InstrumentPose:
        """Return the frame in which the coordinates were read; the base's before readings."""
        if priors.tracker_frame != "rigid" or np.isnan(readings.value).all():
            return InstrumentPose()
        start = None if initial is None else initial.rotation
        sd, r = self._rotation_sd(readings.axis, priors), readings
        return InstrumentPose(estimate_frame(r.p, r.axis, r.value, r.sigma, sd, start))

    def apply_pose_nuisances(
        self, pose: InstrumentPose, nuisance: Array
    ) -> tuple[InstrumentPose, Array]:
        """Return the frame after its small rotation, which the formula has to first order only."""
        from scipy.spatial.transform import Rotation

        rotation = pose.rotation @ Rotation.from_rotvec(nuisance[3:]).as_matrix()
        return InstrumentPose(rotation=rotation), np.concatenate([nuisance[:3], np.zeros(3)])

    def placement_warnings(
        self, pose: InstrumentPose, p: Array, axis: Ints
    ) -> Iterator[tuple[str, str]]:
        """Yield that a dial is misaligned by more than its prior allows."""
        if len(np.unique(axis)) > 1:
            return
        direction = pose.rotation[axis[0]]
        angle = float(np.arccos(np.clip(direction[axis[0]], -1.0, 1.0)))
        if angle > _MISALIGNED_SIGMAS * HELD_DIRECTION_SD:
            yield (
                f"by its readings it points {np.rad2deg(angle):.1f} degrees beside "
                f"{LEGS[axis[0]]} (along {', '.join(plain(v, 3) for v in direction)}), and is "
                f"taken so: look how it is held, and whether the direction in the file is right",
                "askew",
            )

    def find_unit_or_frame_error(
        self, readings: SetupReadings, distance: Array, priors: InstrumentPriors
    ) -> str:
        """Return a sentence on the frame or unit that the coordinates seem to have by mistake."""
        sd = self._rotation_sd(readings.axis, priors)
        return wrong_frame(readings.p, readings.axis, readings.value, sd)
