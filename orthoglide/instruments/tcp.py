"""Coordinates of the tool, by a tracker, a measuring machine or a dial held against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import LEGS, Array, rotation_columns
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
from orthoglide.instruments.unit_mistakes import (
    FACTORS,
    MAX_RESIDUAL_RATIO,
    MIN_MISFIT,
    MIN_READINGS,
    index_of_smallest,
    unit_error,
)
from orthoglide.numerals import MINUS, compact, plain
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of
from orthoglide.units import UNIT_MISTAKES

HELD_DIRECTION_SD = 0.02
"""Standard deviation of the direction of a dial that is held at the tool, radians: a degree."""

_MAX_STEPS = 30  # of Gauss-Newton
_STEP_TOLERANCE = 1e-13  # metres or radians
_SINGULAR_VALUE_CUTOFF = 1e-3  # relative: rotations that the readings determine less are left out
_MISALIGNED_SIGMAS = 3.0  # standard deviations from which a warning is given
_FRAMES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
_MIRRORED = np.linalg.det(_FRAMES) < 0


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
        """Return the prior standard deviations of three datums and of the frame's rotation."""
        datum_sd = 0.0 if priors.tracker_frame == "none" else np.inf
        return np.repeat([datum_sd, self._rotation_sd(axis, priors)], 3)

    def _rotation_sd(self, axis: Ints, priors: InstrumentPriors) -> float:
        """Return the prior standard deviation of the frame's rotation, radians; infinite if two
        axes or more are read.
        """
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
        """Return the pose with its small rotation applied exactly, and the nuisances with that
        rotation set to zero; the formula contains it to first order only.
        """
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
                f"its readings fit a direction {np.rad2deg(angle):.1f} degrees from "
                f"{LEGS[axis[0]]} (along {', '.join(plain(v, 3) for v in direction)}), and this "
                f"direction is used. Check how the dial is held and the direction in the file",
                "askew",
            )

    def find_unit_or_frame_error(
        self, readings: SetupReadings, distance: Array, priors: InstrumentPriors
    ) -> str:
        """Return a message on the frame or unit in which the coordinates seem to be given by
        mistake; empty if they are plausible.

        A rotation without a prior is no mistake, because it is estimated later.
        """
        p, axis, value = readings.p, readings.axis, readings.value
        sd = self._rotation_sd(axis, priors)
        if len(value) < MIN_READINGS:
            return ""
        rms = _residual_rms(np.eye(3), p, axis, value)
        if rms[0] < MIN_MISFIT:
            return ""
        if np.isinf(sd):
            frame = estimate_frame(p, axis, value, np.full(len(p), MIN_MISFIT), sd)
            limit = max(MIN_MISFIT, MAX_RESIDUAL_RATIO * rms[0])
            if _residual_rms(frame, p, axis, value)[0] < limit:
                return ""
        candidates = np.stack([_residual_rms(frame, p, axis, value) for frame in _FRAMES])
        # For points in one plane a mirrored frame fits as well as a rotated one: the rotated one is
        # preferred.
        penalty = np.where(_MIRRORED, 1 / MAX_RESIDUAL_RATIO, 1.0)
        best, unit = np.unravel_index(
            index_of_smallest(candidates * penalty[:, None]), candidates.shape
        )
        frame, residual = _FRAMES[best], candidates[best, unit]
        if residual > MAX_RESIDUAL_RATIO * rms[0]:
            return ""
        if np.allclose(frame, np.eye(3)):
            return unit_error(rms)
        handedness = " (a left-handed frame)" if _MIRRORED[best] else ""
        factor = float(FACTORS[unit])
        unit_clause = "" if factor == 1 else f", and they are {UNIT_MISTAKES[factor]}"
        return (
            f"the coordinates differ by {compact(rms[0] * 1e3, 2)} mm rms from those that this "
            f"machine can give. They fit if the instrument's x, y, z are the machine's "
            f"{', '.join(map(_axis_label, frame))}{handedness}{unit_clause}: give them along the "
            f"machine's axes"
        )


def estimate_frame(
    p: Array,
    axis: Ints,
    value: Array,
    sigma: Array,
    sd: float,
    start: Array | None = None,
) -> Array:
    """Return the axes, in the base, of the frame in which coordinates were read ``(3, 3)``.

    Each axis has a free datum. Gauss-Newton; rotations that the readings do not determine are zero.

    Args:
        p: measured points on the machine ``(n, 3)``, metres.
        axis: axis of the frame that was read ``(n,)``.
        value: coordinates read ``(n,)``, metres.
        sigma: standard deviation of each ``(n,)``, metres.
        sd: prior standard deviation of the rotation from the base, radians; may be infinite.
        start: initial frame; if ``None``, the base's, or without a prior the best of those along
            the base's axes.
    """
    from scipy.spatial.transform import Rotation

    rows, centred = np.arange(len(p)), p - p.mean(axis=0)
    datum = np.eye(3)[axis]

    def linearise(rotation: Array) -> tuple[Array, Array]:
        """Return the Gauss-Newton step, and the whitened residuals after it."""
        coordinates = centred @ rotation.T
        columns = np.hstack([rotation_columns(coordinates, axis), datum]) / sigma[:, None]
        deviation = Rotation.from_matrix(rotation).as_rotvec() / sd
        residual = np.append((value - coordinates[rows, axis]) / sigma, -deviation)
        columns = np.vstack([columns, np.eye(3, 6) / sd])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        step = np.linalg.lstsq(columns / scale, residual, rcond=_SINGULAR_VALUE_CUTOFF)[0] / scale
        return step[:3], residual - columns @ step

    def cost(rotation: Array) -> float:
        residual = linearise(rotation)[1]
        return float(residual @ residual)

    if start is not None:
        rotation = start
    elif np.isfinite(sd):
        rotation = np.eye(3)
    else:
        axis_rotations = Rotation.create_group("O").as_matrix()
        rotation = best_of(
            axis_rotations, lambda r: -float(np.log(max(cost(r), 1e-300))), LOG_ODDS_MARGIN
        )
    for _ in range(_MAX_STEPS):
        step, _ = linearise(rotation)
        rotation = Rotation.from_rotvec(step).as_matrix() @ rotation
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return np.asarray(rotation)


def _residual_rms(frame: Array, p: Array, axis: Ints, value: Array) -> Array:
    """Return the rms residual by factor ``(factors,)``, metres, for an instrument in a frame, with
    a datum per axis and a small rotation fitted.
    """
    coordinates, rows = p @ frame.T, np.arange(len(p))
    columns = np.column_stack([np.eye(3)[axis], rotation_columns(coordinates, axis)])
    residual = value[:, None] * FACTORS - coordinates[rows, axis][:, None]
    residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.mean(residual**2, axis=0)))


def _axis_label(row: Array) -> str:
    k = int(np.argmax(np.abs(row)))
    return f"{MINUS if row[k] < 0 else ''}{LEGS[k]}"
