"""New numbers for the firmware of a calibrated machine, and whether they are better.

They are judged by the residuals of the owner's readings, by the firmware's own equations with the
old and the new numbers. The residual of a touch is the height of the nozzle over the plate, whose
z is 0; the residual of a distance is computed minus measured distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from orthoglide.accuracy import MIN_SIGMAS
from orthoglide.add_ons import Corrections
from orthoglide.control.delta_numbers import (
    ENDSTOPS,
    RADIUS,
    TOWERS,
    PlateErrors,
    arms_are_seen,
    reach_rim,
)
from orthoglide.firmware.klipper.heights import CALIPER_REPEATABILITY, PROBE_REPEATABILITY
from orthoglide.firmware.klipper.numbers import (
    CALIBRATION,
    Numbers,
    ResidualChange,
    Triple,
    corrections_of,
    make_record,
)
from orthoglide.geometry import Array, fit_plane, plane_columns, polynomial_columns
from orthoglide.instruments import PRINTED
from orthoglide.instruments.distance import DISTANCE_OFFSET_SD, SHRINKAGE_BY_MATERIAL
from orthoglide.machine import Machine
from orthoglide.numerals import signed
from orthoglide.observations import Readings

_MIN_GAIN = 0.05  # share of a residual: numbers that gain less are not worth entering
_CHANCE_GAIN = 12.0
"""Change of chi2 by Akaike's criterion: two for each of six fitted numbers, of which chance
explains one."""

_SURFACE_DEGREE = 4  # of the smooth surface about which touches scatter, as in the fit
_SD_OF_MEDIAN = 1.4826  # standard deviation over the median size of a normal error

_WIDE_REACH = 0.8  # share of the widest list's reach at which a list determines z = 0 too
_RINGS, _RAYS = (0.0, 0.5, 1.0), 12  # of points on the plate
_ALONG_WEIGHT = 0.03
"""Weight of an error along the plate against one of height: layers of a print are a tenth of a
millimetre high, and touches hardly determine the place of the tool along the plate."""

_FITTED_COUNT = 6  # endstops, radius, and angles of two towers
_RECALIBRATE_FIRST = "the firmware's own calibration has to be repeated first, as the report says"

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
    of the calibrated machine; the plate is z = 0. Arms are those of the firmware, or those of the
    machine if measured rods or distances ask for these, and they are expected to be clearly better.
    """
    touched = [c.subset(np.flatnonzero(c.touching)) for c in campaigns if c.touching.sum() > 2]

    def nozzle(command: Array) -> tuple[Array, Array]:
        pose = machine.pose(command)
        return pose.p, pose.R[:, 2]

    plates = [plate_heights(nozzle, old, t) for t in touched]
    reach = [float(np.hypot(*places.T).max()) for places, _ in plates]
    if not reach_rim(np.concatenate([np.zeros((0, 2)), *(p for p, _ in plates)]), old.delta_radius):
        return None
    ring, angle = np.meshgrid(_RINGS, np.arange(_RAYS) * 2 * np.pi / _RAYS)
    x, y = max(reach) * ring.ravel() * [np.cos(angle.ravel()), np.sin(angle.ravel())]
    points = np.stack([x, y, 0 * x], axis=1)
    plane = plane_columns(points) @ _zero_plane(touched, plates, reach, meshes_relative)
    has_height = not meshes_relative or any(t.name == CALIBRATION for t in touched)
    rods_measured = machine.spec.measured.rods is not None  # and the machine's arms are as measured
    arms_seen = arms_are_seen(machine, campaigns)

    def computes(change: Array, commands: Array) -> Array:
        return _firmware_points(old.changed(change), old, commands)

    errors = PlateErrors(machine, computes, points, plane, _ALONG_WEIGHT, has_height, arms_seen)
    a, b, c = np.array(_calibrated_arms(machine)) - old.arm
    calibrated = np.array([0, 0, 0, 0, 0, 0, c, a - c, b - c])
    now, free = errors.error(0 * calibrated), [*ENDSTOPS, *RADIUS, *TOWERS]
    chosen, with_arms = errors.fit(free), errors.fit(free, calibrated)
    keep = errors.gain(now, chosen.error).lack
    asked = rods_measured or distances_ask_for_rods(old, campaigns)
    if asked and not errors.gain(now if keep else chosen.error, with_arms.error).lack:
        chosen, keep = with_arms, ""
    new = old.changed(chosen.change)
    changes = tuple(residual_changes(old, new, campaigns, meshes_relative))
    noise = _touch_noise(plates)
    judged = residual_changes(old, new, campaigns, meshes_relative, free_size=True)
    keep = _RECALIBRATE_FIRST if calibrate_again else rejection_reason([*judged], noise) or keep
    gain = errors.gain(now, chosen.error).along
    unasked = 0.0 if asked else float(np.mean(_calibrated_arms(machine)))
    return corrections_of(old, make_record(old, new, changes, keep, rods_measured, gain, unasked))


def distances_ask_for_rods(old: Numbers, campaigns: Sequence[Readings]) -> bool:
    """Return whether distances differ from the firmware's by two standard deviations more than
    parts of their material do, the widths of their pillars included.

    Heights do not ask: rods 3 mm longer and lobes of a tenth in the plate look alike, and of
    owners' printers, whose rods are of known length, nearly all plates have such lobes.
    """
    for material, (usual, sd) in SHRINKAGE_BY_MATERIAL.items():
        shares, setups = [np.zeros(0)], 0
        for campaign in campaigns:
            of_material = np.array([s.material == material for s in campaign.setups])
            rows = np.flatnonzero(campaign.paired & of_material[campaign.setup])
            part = campaign.subset(rows)
            shares.append(_distance_residuals(old, old, part, False) / part.reading)
            setups += len(np.unique(part.setup))
        if setups:  # the median, as one of a few distances may be mistyped
            length = float(np.median([r for c in campaigns for r in c.reading[c.paired]]))
            width_share = DISTANCE_OFFSET_SD / length / np.sqrt(setups)
            excess = abs(float(np.median(np.concatenate(shares))) - usual)
            if excess > MIN_SIGMAS * float(np.hypot(sd, width_share)):
                return True
    return False


def rejection_reason(
    changes: Sequence[ResidualChange], touch_noise: float = PROBE_REPEATABILITY
) -> str:
    """Return why new numbers are not to be entered; empty if they are better.

    They are better if they fit some readings better by more than chance, and none worse. A rise
    that a single reading causes, for example by a speck under a touch, does not count.
    """
    touches = sum(c.count for c in changes if c.kind == "heights")
    if touches <= _FITTED_COUNT:
        return (
            f"{_FITTED_COUNT} numbers fit any {touches} touches of the plate, right or "
            f"wrong: touch it at more places"
        )
    noise = {"heights": touch_noise, "distances": CALIPER_REPEATABILITY}
    if worse := [
        c for c in changes
        if _is_more_than_chance(c.count, c.old, c.new, noise[c.kind])
        and _is_more_than_chance(c.count - 1, c.others[0], c.others[1], noise[c.kind])
    ]:  # fmt: skip
        most = max(worse, key=lambda c: c.new - c.old)
        again = f"; it is largest at {most.largest}: take that reading again"
        return f"{_residual_clause(most, 'rises')}{again * bool(most.largest)}"
    if not any(
        _is_more_than_chance(c.count, c.new, c.old, max(noise[c.kind], c.new)) for c in changes
    ):
        most = min(changes, key=lambda c: c.new - c.old)
        return f"{_residual_clause(most, 'goes')}, which is less than 5 % or no more than chance"
    return ""


def _residual_clause(change: ResidualChange, verb: str) -> str:
    return (
        f"with them the residual of the {change.kind} of {change.file} {verb} from "
        f"{change.old * 1e3:.3f} to {change.new * 1e3:.3f} mm rms"
    )


def _touch_noise(plates: Sequence[tuple[Array, Array]]) -> float:
    """Return the standard deviation of a touch, metres: that of an instrument, or of the plates'
    heights ``(n,)`` about smooth surfaces through their places ``(n, 2)``, if that is larger.
    """
    deviations = [np.zeros(0)]
    for places, height in plates:
        columns = polynomial_columns(places / np.abs(places).max(), _SURFACE_DEGREE)
        count, unknowns = columns.shape
        if count > 2 * unknowns:
            residual = height - columns @ np.linalg.lstsq(columns, height)[0]
            deviations.append(np.abs(residual) * np.sqrt(count / (count - unknowns)))
    every = np.concatenate(deviations)
    return max(_SD_OF_MEDIAN * float(np.median(every)) if len(every) else 0.0, PROBE_REPEATABILITY)


def _is_more_than_chance(count: int, low: float, high: float, noise: float) -> bool:
    """Return whether a residual rises from low to high by more than chance, and by 5 %."""
    return high > (1 + _MIN_GAIN) * low and count * (high**2 - low**2) > _CHANCE_GAIN * noise**2


def residual_changes(
    old: Numbers, new: Numbers, campaigns: Sequence[Readings], meshes_relative: bool,
    free_size: bool = False,
) -> Iterator[ResidualChange]:  # fmt: skip
    """Yield the residuals of each file's touches and distances with the old and new numbers.

    With ``free_size`` the size of printed parts, which shrink by an unknown share, is fitted.
    """
    for campaign in campaigns:
        for kind, rows in (("heights", campaign.touching), ("distances", campaign.paired)):
            if rows.any():
                part = campaign.subset(np.flatnonzero(rows))
                before, after = (
                    _distance_residuals(numbers, old, part, free_size) if kind == "distances"
                    else _height_residuals(numbers, old, part, meshes_relative)
                    for numbers in (old, new)
                )  # fmt: skip
                worst = int(np.argmax(np.abs(after)))
                sums = [(float(r @ r), float(r @ r - r[worst] ** 2)) for r in (before, after)]
                rms = np.sqrt(np.array(sums) / [len(part), max(len(part) - 1, 1)])
                (first, last), others = rms.T.tolist()
                largest = f"line {part.line[worst]}, {signed(float(after[worst]) * 1e3, 3)} mm"
                name, count = campaign.name, len(part)
                yield ResidualChange(name, kind, count, first, last, largest, others)


def _firmware_points(numbers: Numbers, old: Numbers, command: Array) -> Array:
    """Return places of the nozzle ``(n, 3)`` by a firmware's numbers, at travel ``(n, 3)`` that was
    counted with the old numbers.
    """
    return numbers.points(command + old.zero - old.at_endstop + numbers.at_endstop)


def plate_heights(pose: PoseFunction, old: Numbers, touches: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` and heights over z = 0 ``(n,)`` of a touched plate, metres.

    The poses are those of a machine, or those of a firmware's equations. Where a probe
    triggers, the nozzle is ``z_offset`` above the plate. This offset was set in the middle, where
    the probe and then the nozzle touched the same place.
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


def _distance_residuals(numbers: Numbers, old: Numbers, part: Readings, free_size: bool) -> Array:
    """Return the residuals of distances ``(n,)``, metres, as `residual_changes` has them."""
    ends = [_firmware_points(numbers, old, c) for c in (part.command, part.second)]
    residual = np.linalg.norm(ends[0] - ends[1], axis=1) - part.reading
    printed = np.array([s.material == PRINTED for s in part.setups])[part.setup]
    size = part.reading * printed * free_size
    return np.asarray(residual - size * (size @ residual) / max(size @ size, 1e-9))


def _calibrated_arms(machine: Machine) -> Triple:
    """Return the arms of the calibrated machine, metres."""
    lengths = machine.catalogue.correctable_by("bar_length")
    a, b, c = (
        machine.geometry.L + sum(machine.values.get(f"{name}.{leg}", 0.0) for name in lengths)
        for leg in machine.geometry.leg_names
    )
    return a, b, c
