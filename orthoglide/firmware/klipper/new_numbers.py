"""New numbers for the firmware of a calibrated machine, and whether they are better.

They are judged by what the firmware's own equations leave of the owner's readings with the old and
the new ones: of a touch how far the nozzle is from where the plate is z = 0, of a distance by how
much it is another one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.add_ons import Corrections
from orthoglide.firmware.klipper.corrections import ResidualChange, make_corrections
from orthoglide.firmware.klipper.numbers import Numbers
from orthoglide.firmware.klipper.provenance import CALIBRATION
from orthoglide.geometry import Array, plane_columns
from orthoglide.machine import Machine
from orthoglide.observations import Readings

_MIN_GAIN = 0.05  # of the residual of a list: numbers that gain less are not worth a paste
_CHANCE_GAIN = 12.0
"""Akaike's criterion: by chance each of six numbers that are fitted takes one from chi2, and two
are asked of it."""

_MIN_REACH = 1 / 3
"""Of the radius of the towers, how far a plate has to be touched: numbers that fit its middle alone
may do anything at its rim."""

_WIDE_REACH = (
    0.8  # of the widest list of touches, how far another one reaches that tells of z = 0 too
)
_RINGS, _RAYS = (0.0, 0.5, 1.0), 12  # of points on the plate
_LATERAL_WEIGHT = 0.03
"""Weight of an error along the plate against one of height: prints are a tenth of a millimetre
high, and what a probe says of the tool's place along the plate is uncertain."""

_DISTANCE_WEIGHT = (
    0.5  # weight of a distance against a height: a caliper is two to five times as noisy
)
_COUNT_WITHOUT_ARMS, _COUNT_WITH_ARMS = (
    6,
    9,
)  # how many numbers are fitted, in the order of `Numbers.changed`
_RECALIBRATE_FIRST = "DELTA_CALIBRATE comes first, as is said at the top"
_FIT_TOLERANCE = 1e-13  # relative changes at which a fit ends, close to rounding


PoseFunction = Callable[[Array], tuple[Array, Array]]
"""Places of a nozzle, and upward parts of its platform's axes, ``(n, 3)`` each, at travel
``(n, 3)``."""


def new_numbers(
    old: Numbers, machine: Machine, read: Sequence[Readings], relative: bool, again: bool
) -> Corrections | None:
    """Return new numbers for a calibrated machine; ``None`` where its readings do not touch the
    plate, or its middle alone.

    The numbers bring the firmware's nozzle nearest to where the machine's is over the plate, z = 0
    being the plate; distances along it are as they were read.

    Args:
        old: the firmware's present numbers.
        machine: the calibrated one.
        read: all readings.
        relative: whether the firmware takes the height at one place out of every mesh.
        again: whether its own calibration has to be run again first.
    """
    touched = [one.subset(np.flatnonzero(one.touching)) for one in read if one.touching.sum() > 2]
    paired = [one.subset(np.flatnonzero(one.paired)) for one in read if one.paired.any()]
    seen = [plate_heights(lambda c: _nozzle_pose(machine, c), old, one) for one in touched]
    reach = [float(np.hypot(*places.T).max()) for places, _ in seen]
    most = max(reach, default=0.0)
    if most < _MIN_REACH * old.delta_radius:
        return None
    points = _grid_points(most)
    plane = plane_columns(points) @ _zero_plane(touched, seen, reach, relative)
    commands = machine.inverse(points + np.outer(plane, [0.0, 0.0, 1.0]))

    def miss(numbers: Numbers) -> Array:
        off = _firmware_points(numbers, old, commands) - points
        along = _LATERAL_WEIGHT * _without_rigid_motion(points, off[:, :2])
        apart = [_DISTANCE_WEIGHT * _distance_residuals(numbers, old, one) for one in paired]
        return np.concatenate([off[:, 2], along.ravel(), *apart])

    start = replace(old, arm=_calibrated_arms(old, machine))
    known = machine.spec.measured.rods is not None  # and the machine's arms are as measured
    new = _fit_numbers(
        start, miss, _COUNT_WITH_ARMS if paired and not known else _COUNT_WITHOUT_ARMS
    )
    left = tuple(residual_changes(old, new, read, relative))
    keep = _RECALIBRATE_FIRST if again else rejection_reason(left)
    return make_corrections(old, new, left, keep, known)


def rejection_reason(left: Sequence[ResidualChange]) -> str:
    """Return why new numbers are not to be entered; empty where they are better."""
    heights = [one for one in left if one.kind == "heights"]
    worse = [one for one in left if _residual_rises(one)]
    if any(_residual_falls(one) for one in heights) and not worse:
        return ""
    one = (worse or heights)[0]
    verb = "rises" if worse else "changes too little,"
    return (
        f"with them the residual of the {one.kind} of {one.file} {verb} from {one.old * 1e3:.3f} "
        f"to {one.new * 1e3:.3f} mm rms"
    )


def _residual_rises(left: ResidualChange) -> bool:
    """Return whether the new numbers leave more of a list."""
    return left.new > (1 + _MIN_GAIN) * left.old


def _residual_falls(left: ResidualChange) -> bool:
    """Return whether the new numbers leave less of a list, by more than chance does."""
    gain = 2 * left.count * np.log(max(left.old, 1e-12) / max(left.new, 1e-12))
    return bool(left.new < (1 - _MIN_GAIN) * left.old and gain > _CHANCE_GAIN)


def residual_changes(
    old: Numbers, new: Numbers, read: Sequence[Readings], relative: bool
) -> Iterator[ResidualChange]:
    """Return the residuals of each file's touches and distances with the old and new numbers."""
    for one in read:
        for kind, rows in (("heights", one.touching), ("distances", one.paired)):
            if rows.any():
                part = one.subset(np.flatnonzero(rows))
                off = [
                    _distance_residuals(numbers, old, part) if kind == "distances"
                    else _height_residuals(numbers, old, part, relative) for numbers in (old, new)
                ]  # fmt: skip
                before, after = (float(np.sqrt(np.mean(v**2))) for v in off)
                yield ResidualChange(one.name, kind, len(part), before, after)


def _firmware_points(numbers: Numbers, old: Numbers, command: Array) -> Array:
    """Return where a firmware has the nozzle ``(n, 3)`` at travel as the old one commanded it."""
    return numbers.points(command + old.zero - old.at_endstop + numbers.at_endstop)


def plate_heights(pose: PoseFunction, old: Numbers, touches: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` and height over z = 0 ``(n,)`` of a plate by the poses of a machine,
    or those that a firmware believes, metres.

    A probe touches it, and the nozzle is lower by ``z_offset``, which was set in the middle: there
    the probe touched a place, and then the nozzle.
    """
    height = np.zeros(len(touches))
    p, up = pose(touches.command)
    for k in np.unique(touches.setup):
        rows, beside = touches.setup == k, np.array(touches.setups[k].beside)
        offset = float(np.median(touches.reading[rows]))
        places = np.array([[0.0, 0.0, offset - beside[2]], [beside[0], beside[1], 0.0]])
        (probe, nozzle), (tilt, _) = pose(old.heights(places) - old.zero)
        lower = probe[2] + tilt @ beside - nozzle[2] - offset
        height[rows] = p[rows, 2] + up[rows] @ beside - touches.reading[rows] - lower
    return p[:, :2], height


def _nozzle_pose(machine: Machine, command: Array) -> tuple[Array, Array]:
    """Return places of a machine's nozzle and upward parts of its platform's axes."""
    pose = machine.pose(command)
    return pose.p, pose.R[:, 2]


def _zero_plane(
    touched: Sequence[Readings],
    seen: Sequence[tuple[Array, Array]],
    reach: Sequence[float],
    relative: bool,
) -> Array:
    """Return height and slopes ``(3,)`` of what the firmware takes as z = 0: the heights by which
    it was set, else the mean of all plates that were touched far out; the height by those that have
    one, where any has.
    """
    by = [one.name == CALIBRATION for one in touched]
    by = by if any(by) else [far >= _WIDE_REACH * max(reach) for far in reach]
    rows = [k for k, counts in enumerate(by) if counts]
    planes = np.array(
        [np.linalg.lstsq(plane_columns(seen[k][0]), seen[k][1], rcond=None)[0] for k in rows]
    )
    known = np.array([not relative or touched[k].name == CALIBRATION for k in rows])
    height = planes[known | ~known.any(), 0].mean()
    return np.append(height, planes[:, 1:].mean(axis=0))


def _height_residuals(numbers: Numbers, old: Numbers, touches: Readings, relative: bool) -> Array:
    """Return the residuals of touches ``(n,)``, metres."""
    upright = np.tile([0.0, 0.0, 1.0], (max(len(touches), 2), 1))

    def pose(command: Array) -> tuple[Array, Array]:
        return _firmware_points(numbers, old, command), upright[: len(command)]

    _, height = plate_heights(pose, old, touches)
    return height - height.mean() if relative and touches.name != CALIBRATION else height


def _distance_residuals(numbers: Numbers, old: Numbers, distances: Readings) -> Array:
    """Return the residuals of distances ``(n,)``, metres."""
    ends = [_firmware_points(numbers, old, c) for c in (distances.command, distances.second)]
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=1) - distances.reading)


def _calibrated_arms(old: Numbers, machine: Machine) -> tuple[float, float, float]:
    """Return the arms of the calibrated machine; those that are stored where all are known no
    better, metres.
    """
    lengths, known = machine.catalogue.correctable_by("bar_length"), machine.posterior
    sd = dict(zip(known.names, np.sqrt(np.diag(known.covariance)), strict=True))
    names = [[f"{name}.{leg}" for name in lengths] for leg in machine.geometry.leg_names]
    a, b, c = (machine.geometry.L + sum(machine.values.get(n, 0.0) for n in own) for own in names)
    off = np.abs(np.subtract((a, b, c), old.arm))
    unsure = [np.linalg.norm([sd.get(n, 0.0) for n in own]) for own in names]
    return old.arm if (off <= unsure).all() else (a, b, c)


def _fit_numbers(start: Numbers, miss: Callable[[Numbers], Array], count: int) -> Numbers:
    """Return numbers of which the first so many were changed to miss least; those to start from
    where no solution is found, which the residuals then show to gain nothing.
    """
    from scipy.optimize import least_squares  # which is slow to load

    steps = np.eye(max(count, _COUNT_WITHOUT_ARMS))[:count]
    found = least_squares(
        lambda by: miss(start.changed(by @ steps)), np.zeros(count), "3-point", method="lm",
        xtol=_FIT_TOLERANCE, ftol=_FIT_TOLERANCE, gtol=_FIT_TOLERANCE,
    )  # fmt: skip
    return start.changed(found.x @ steps) if found.success else start


def _without_rigid_motion(points: Array, along: Array) -> Array:
    """Return errors along the plate ``(n, 2)`` past a shift and a turn of everything."""
    moves = np.zeros((len(points), 2, 3))
    moves[:, 0, 0] = moves[:, 1, 1] = 1.0
    moves[:, :, 2] = np.column_stack([-points[:, 1], points[:, 0]])
    turn = np.linalg.qr(moves.reshape(-1, 3))[0]
    flat = along.ravel()
    return np.asarray(flat - turn @ (turn.T @ flat)).reshape(-1, 2)


def _grid_points(radius: float) -> Array:
    """Return points on a plate ``(g, 3)``, metres."""
    ring, angle = np.meshgrid(_RINGS, np.arange(_RAYS) * 2 * np.pi / _RAYS)
    x, y = radius * ring.ravel() * [np.cos(angle.ravel()), np.sin(angle.ravel())]
    return np.stack([x, y, 0 * x], axis=1)
