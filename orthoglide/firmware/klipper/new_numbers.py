"""New numbers for the firmware of a calibrated machine, and whether they are better.

They are judged by the residuals of the owner's readings, by the firmware's own equations with the
old and the new numbers. The residual of a touch is the height of the nozzle over the plate, whose
z is 0; the residual of a distance is computed minus measured distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.accuracy import drawn_errors, lack_of_gain
from orthoglide.add_ons import Corrections
from orthoglide.firmware.klipper.heights import CALIPER_REPEATABILITY, PROBE_REPEATABILITY
from orthoglide.firmware.klipper.numbers import (
    CALIBRATION,
    Numbers,
    ResidualChange,
    corrections_of,
    make_record,
)
from orthoglide.geometry import Array, fit_plane, plane_columns
from orthoglide.machine import Machine
from orthoglide.observations import Readings

_MIN_GAIN = 0.05  # share of a residual: numbers that gain less are not worth entering
_CHANCE_GAIN = 12.0
"""Change of chi2 by Akaike's criterion: two for each of six fitted numbers, of which chance
explains one."""

_NOISE = {"heights": PROBE_REPEATABILITY, "distances": CALIPER_REPEATABILITY}
"""Standard deviation of a reading, metres."""

_MIN_REACH = 1 / 3
"""Share of the radius of the towers that touches must reach: numbers that fit the middle of a plate
alone may be far off at its rim."""

_WIDE_REACH = 0.8  # share of the widest list's reach at which a list determines z = 0 too
_RINGS, _RAYS = (0.0, 0.5, 1.0), 12  # of points on the plate
_LATERAL_WEIGHT = 0.03
"""Weight of an error along the plate against one of height: layers of a print are a tenth of a
millimetre high, and touches hardly determine the place of the tool along the plate."""

_DISTANCE_WEIGHT = 0.5  # against a height: a caliper is two to five times as noisy
_COUNT_WITHOUT_ARMS, _COUNT_WITH_ARMS = 6, 9  # fitted numbers, in the order of `Numbers.changed`
_RECALIBRATE_FIRST = "DELTA_CALIBRATE comes first, as is said at the top"
_FIT_TOLERANCE = 1e-13  # relative changes at which a fit ends, close to rounding

PoseFunction = Callable[[Array], tuple[Array, Array]]
"""Places of a nozzle, and upward parts of its platform's axes, ``(n, 3)`` each, at travel
``(n, 3)``."""


def new_numbers(
    old: Numbers, machine: Machine, campaigns: Sequence[Readings], meshes_relative: bool,
    calibrate_again: bool,
) -> Corrections | None:  # fmt: skip
    """Return new numbers for a calibrated machine; ``None`` if its readings do not touch the plate
    beyond its middle.

    With the new numbers, the firmware computes places of the nozzle over the plate nearest to those
    of the calibrated machine; the plate is z = 0. Measured distances are fitted with them.
    """
    touched = [c.subset(np.flatnonzero(c.touching)) for c in campaigns if c.touching.sum() > 2]
    paired = [c.subset(np.flatnonzero(c.paired)) for c in campaigns if c.paired.any()]

    def nozzle(command: Array) -> tuple[Array, Array]:
        pose = machine.pose(command)
        return pose.p, pose.R[:, 2]

    plates = [plate_heights(nozzle, old, t) for t in touched]
    reach = [float(np.hypot(*places.T).max()) for places, _ in plates]
    widest = max(reach, default=0.0)
    if widest < _MIN_REACH * old.delta_radius:
        return None
    ring, angle = np.meshgrid(_RINGS, np.arange(_RAYS) * 2 * np.pi / _RAYS)
    x, y = widest * ring.ravel() * [np.cos(angle.ravel()), np.sin(angle.ravel())]
    points = np.stack([x, y, 0 * x], axis=1)
    plane = plane_columns(points) @ _zero_plane(touched, plates, reach, meshes_relative)
    wanted = points + np.outer(plane, [0.0, 0.0, 1.0])
    commands = machine.inverse(wanted)

    def residuals(numbers: Numbers) -> Array:
        error = _firmware_points(numbers, old, commands) - points
        along = _LATERAL_WEIGHT * _without_rigid_motion(points, error[:, :2])
        distances = [_DISTANCE_WEIGHT * _distance_residuals(numbers, old, c) for c in paired]
        return np.concatenate([error[:, 2], along.ravel(), *distances])

    start = replace(old, arm=_calibrated_arms(old, machine))
    rods_measured = machine.spec.measured.rods is not None  # and the machine's arms are as measured
    count = _COUNT_WITH_ARMS if paired and not rods_measured else _COUNT_WITHOUT_ARMS
    new = _fit_numbers(start, residuals, count)
    changes = tuple(residual_changes(old, new, campaigns, meshes_relative))
    keep = _RECALIBRATE_FIRST if calibrate_again else rejection_reason(changes)
    if not keep:
        relative = meshes_relative and all(t.name != CALIBRATION for t in touched)
        before, after = (
            _drawn_rms(machine, _commands(n, old, points), wanted, relative) for n in (old, new)
        )
        keep = lack_of_gain(float(np.mean(before - after)), float(np.std(before - after)))
    return corrections_of(old, make_record(old, new, changes, keep, rods_measured))


def rejection_reason(changes: Sequence[ResidualChange]) -> str:
    """Return why new numbers are not to be entered; empty if they are better.

    They are better if they fit some readings better by more than chance, and none worse.
    """
    touches = sum(c.count for c in changes if c.kind == "heights")
    if touches <= _COUNT_WITHOUT_ARMS:
        return (
            f"{_COUNT_WITHOUT_ARMS} numbers fit any {touches} touches of the plate, right or "
            f"wrong: touch it at more places"
        )
    if worse := [c for c in changes if c.new > c.old and _is_more_than_chance(c)]:
        return _residual_clause(worse[0], "rises")
    if not any(c.new < c.old and _is_more_than_chance(c) for c in changes):
        most = min(changes, key=lambda c: c.new - c.old)
        return f"{_residual_clause(most, 'goes')}, which is no more than chance"
    return ""


def _residual_clause(change: ResidualChange, verb: str) -> str:
    return (
        f"with them the residual of the {change.kind} of {change.file} {verb} from "
        f"{change.old * 1e3:.3f} to {change.new * 1e3:.3f} mm rms"
    )


def _is_more_than_chance(change: ResidualChange) -> bool:
    """Return whether the residual of readings changes by more than chance, and noticeably.

    Their noise is that of the instrument; where they fit better, the residual that is left if this
    is larger, as what the model lacks must not count as a gain.
    """
    low, high = sorted((change.old, change.new))
    noise = _NOISE[change.kind]
    noise = max(noise, low) if change.new < change.old else noise
    chi2 = change.count * (high**2 - low**2) / noise**2
    return high > (1 + _MIN_GAIN) * low and chi2 > _CHANCE_GAIN


def residual_changes(
    old: Numbers, new: Numbers, campaigns: Sequence[Readings], meshes_relative: bool
) -> Iterator[ResidualChange]:
    """Yield the residuals of each file's touches and distances with the old and new numbers."""
    for campaign in campaigns:
        for kind, rows in (("heights", campaign.touching), ("distances", campaign.paired)):
            if rows.any():
                part = campaign.subset(np.flatnonzero(rows))
                residuals = [
                    _distance_residuals(numbers, old, part) if kind == "distances"
                    else _height_residuals(numbers, old, part, meshes_relative)
                    for numbers in (old, new)
                ]  # fmt: skip
                before, after = (float(np.sqrt(np.mean(r**2))) for r in residuals)
                yield ResidualChange(campaign.name, kind, len(part), before, after)


def _firmware_points(numbers: Numbers, old: Numbers, command: Array) -> Array:
    """Return places of the nozzle ``(n, 3)`` by a firmware's numbers, at travel ``(n, 3)`` that was
    counted with the old numbers.
    """
    return numbers.points(command + old.zero - old.at_endstop + numbers.at_endstop)


def _commands(numbers: Numbers, old: Numbers, points: Array) -> Array:
    """Return travel ``(n, 3)`` as counted with the old numbers, by which a firmware with others
    goes to points ``(n, 3)``.
    """
    return numbers.heights(points) - numbers.at_endstop + old.at_endstop - old.zero


def _drawn_rms(machine: Machine, commands: Array, wanted: Array, relative: bool) -> Array:
    """Return weighted root mean squares ``(draws,)`` of errors of the nozzle at commands for places
    on the plate ``(n, 3)``, of machines drawn from the posterior, metres.

    Whatever the machine, z = 0 is the plane of its touches: only the machine itself has an error of
    height and slope there, and none of height if ``relative`` says that this is unknown.
    """
    error, mean = drawn_errors(machine, commands, wanted), machine.forward(commands) - wanted
    height = mean[:, 2] - relative * mean[:, 2].mean()
    height = height + fit_plane(wanted, (error[:, :, 2] - mean[:, 2]).T)[1].T
    along = _LATERAL_WEIGHT * _without_rigid_motion(wanted, error[:, :, :2])
    return np.asarray(np.sqrt(np.mean(height**2 + np.sum(along**2, axis=-1), axis=1)))


def plate_heights(pose: PoseFunction, old: Numbers, touches: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` and heights over z = 0 ``(n,)`` of a touched plate, metres.

    The poses are those of a machine, or those of a firmware's equations. Where a probe touches, the
    nozzle is lower by ``z_offset``. It was set in the middle, where the probe and then the nozzle
    touched the same place.
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


def _zero_plane(
    touched: Sequence[Readings],
    plates: Sequence[tuple[Array, Array]],
    reach: Sequence[float],
    meshes_relative: bool,
) -> Array:
    """Return height and slopes ``(3,)`` of the plane that the firmware takes as z = 0.

    This is the plane of the heights by which z = 0 was set, else the mean plane of all plates that
    were touched far out. Its height is the mean of those plates whose height is known, if any.
    """
    rows = [k for k, campaign in enumerate(touched) if campaign.name == CALIBRATION]
    rows = rows or [k for k, radius in enumerate(reach) if radius >= _WIDE_REACH * max(reach)]
    planes = np.array([fit_plane(*plates[k])[0] for k in rows])
    has_height = np.array([not meshes_relative or touched[k].name == CALIBRATION for k in rows])
    height = planes[has_height | ~has_height.any(), 0].mean()
    return np.append(height, planes[:, 1:].mean(axis=0))


def _height_residuals(
    numbers: Numbers, old: Numbers, touches: Readings, meshes_relative: bool
) -> Array:
    """Return the residuals of touches ``(n,)``, metres."""
    upright = np.tile([0.0, 0.0, 1.0], (max(len(touches), 2), 1))

    def pose(command: Array) -> tuple[Array, Array]:
        return _firmware_points(numbers, old, command), upright[: len(command)]

    _, height = plate_heights(pose, old, touches)
    return height - height.mean() if meshes_relative and touches.name != CALIBRATION else height


def _distance_residuals(numbers: Numbers, old: Numbers, distances: Readings) -> Array:
    """Return the residuals of distances ``(n,)``, metres."""
    ends = [_firmware_points(numbers, old, c) for c in (distances.command, distances.second)]
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=1) - distances.reading)


def _calibrated_arms(old: Numbers, machine: Machine) -> tuple[float, float, float]:
    """Return the arms of the calibrated machine, metres; the stored ones if none differs from them
    by more than its standard deviation.
    """
    lengths, posterior = machine.catalogue.correctable_by("bar_length"), machine.posterior
    sd = dict(zip(posterior.names, np.sqrt(np.diag(posterior.covariance)), strict=True))
    by_leg = [[f"{name}.{leg}" for name in lengths] for leg in machine.geometry.leg_names]
    a, b, c = (machine.geometry.L + sum(machine.values.get(n, 0.0) for n in leg) for leg in by_leg)
    change = np.abs(np.subtract((a, b, c), old.arm))
    arm_sd = [np.linalg.norm([sd.get(n, 0.0) for n in leg]) for leg in by_leg]
    return old.arm if (change <= arm_sd).all() else (a, b, c)


def _fit_numbers(start: Numbers, residuals: Callable[[Numbers], Array], count: int) -> Numbers:
    """Return numbers of which the first ``count`` are fitted by least squares.

    Without a solution, the initial numbers are returned, whose residuals then show no gain.
    """
    from scipy.optimize import least_squares  # which is slow to load

    steps = np.eye(max(count, _COUNT_WITHOUT_ARMS))[:count]
    solution = least_squares(
        lambda x: residuals(start.changed(x @ steps)), np.zeros(count), "3-point", method="lm",
        xtol=_FIT_TOLERANCE, ftol=_FIT_TOLERANCE, gtol=_FIT_TOLERANCE,
    )  # fmt: skip
    return start.changed(solution.x @ steps) if solution.success else start


def _without_rigid_motion(points: Array, along: Array) -> Array:
    """Return errors along the plate ``(..., n, 2)`` without their common shift and rotation."""
    moves = np.zeros((len(points), 2, 3))
    moves[:, 0, 0] = moves[:, 1, 1] = 1.0
    moves[:, :, 2] = np.column_stack([-points[:, 1], points[:, 0]])
    turn = np.linalg.qr(moves.reshape(-1, 3))[0]
    flat = along.reshape(*along.shape[:-2], -1)
    return np.asarray(flat - flat @ turn @ turn.T).reshape(along.shape)
