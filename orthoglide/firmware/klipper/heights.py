"""Heights and distances of [delta_calibrate], which are stored as steps from the endstops
(klippy/extras/delta_calibrate.py).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import FileError, InputError
from orthoglide.firmware.imported import Row
from orthoglide.firmware.klipper.config import Config, ConfigSection
from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.geometry import Array, plane_columns
from orthoglide.instruments import PRINTED, Distance, PlateTouch
from orthoglide.numerals import compact, plain, signed

CALIPER_REPEATABILITY, RIM_REPEATABILITY = 5e-5, 1e-4
"""Repeatability of a caliper's distance, metres; around the rim only one of two pillars' widths is
taken off, and pillars differ by a tenth of a millimetre."""

CALIBRATE_NOTE = "calibrate"
"""Kind of a note that the firmware's own calibration has to be run again."""

PROBE_SECTIONS = (
    "probe", "bltouch", "smart_effector", "load_cell_probe", "probe_eddy_current", "beacon",
    "cartographer", "scanner", "dockable_probe",
)  # fmt: skip
_STORED_KINDS = {  # what [delta_calibrate] stores: its positions, the limits of a value in millimetres
    "height": (["pos"], -100.0, 100.0),
    "manual_height": (["pos"], -100.0, 100.0),
    "distance": (["pos1", "pos2"], 1.0, 1000.0),
}
_FULL_STEPS = 200
_MAX_VALUE_ERROR = (
    3e-3  # metres by which a stored value may miss the one that the stored numbers give
)
_MAX_DISTANCE_SHARE = (
    0.2  # relative tolerance of distances: one wrong digit is left to the search for slips
)
_MIN_PROBE_OFFSET = (
    1e-3  # metres: smallest offset of a probe; less is a correction of the nozzle's height
)
_EQUAL_OFFSETS = (
    2e-5  # metres: a height that is stored with another offset of the probe differs by more
)
# candidate ratios of the stored length of a step to that of now
_STEP_RATIOS = (1.0, *(2.0**k for k in (1, -1, 2, -2, 3, -3, 4, -4)))
_MIN_PLANE_HEIGHTS = 3  # heights that tell of a mean and a slope
_MIN_ENDSTOP_SHIFT = (
    3e-5  # metres: mean of the heights' residuals above which the endstops were moved
)
_MAX_SLOPE = 2e-5, 0.1  # largest slope beside that mean: metres at the rim, or share of the mean


def fit_plane(p: Array, height: Array) -> tuple[float, float, float]:
    """Return by how much places ``(n, 3)`` are higher than ``(n,)`` in the middle, metres, and two
    slopes of that.
    """
    middle, x, y = np.linalg.lstsq(plane_columns(p), p[:, 2] - height, rcond=None)[0].tolist()
    return middle, x, y


def probe_section(config: Config) -> ConfigSection | None:
    """Return the section of the probe; ``None`` where there is none."""
    found = (
        s for s in config.sections_of_kind(*PROBE_SECTIONS) if s.name == "probe" or "z_offset" in s
    )
    return next(found, None)


def probe_offset(config: Config) -> tuple[float, Array]:
    """Return the probe's offset above the nozzle, and beside it ``(2,)``, metres."""
    if (section := probe_section(config)) is None:
        return 0.0, np.zeros(2)
    beside = [config.number_or_zero(section.name, f"{axis}_offset", -200, 200) for axis in "xy"]
    above = config.number_or_zero(section.name, "z_offset", -100, 100)
    return above * 1e-3, np.array(beside) * 1e-3


@dataclass(frozen=True, eq=False)
class _StoredReadings:
    """Readings of one kind with the steps at which they were taken."""

    kind: str
    keys: list[str]
    value: Array  # (n,), metres
    steps: Array  # at one or two places (n, k, 3)

    @property
    def is_distance(self) -> bool:
        """Whether these are distances between two places."""
        return self.steps.shape[1] > 1

    def excess(self, p: Array) -> Array:
        """Return by how much places ``(n, k, 3)`` give more than was read ``(n,)``, metres."""
        given = np.linalg.norm(p[:, 1] - p[:, 0], axis=1) if self.is_distance else p[:, 0, 2]
        return np.asarray(given - self.value)

    @property
    def max_error(self) -> Array:
        """By how much a value may be missed ``(n,)``, metres."""
        return np.maximum(_MAX_VALUE_ERROR, _MAX_DISTANCE_SHARE * self.value * self.is_distance)


def stored_readings(config: Config, numbers: Numbers) -> tuple[list[Row], bool]:
    """Return heights, those by hand, and distances, and whether z = 0 was moved since; what cannot
    be used is left out with a note.
    """
    section, moved, found = config.section_or_empty("delta_calibrate"), False, list[Row]()
    if not section.entries:
        return [], False
    warm = section.temperature
    try:
        step = np.array([_microstep(config, name) for name in TOWERS])
    except FileError as error:
        config.note("readings", f"heights and distances are left out: {error}")
        return [], False
    for word in _STORED_KINDS:
        read = _read_kind(config, word)
        if not read.keys:
            continue
        travel, p = _stored_positions(config, numbers, read, step)
        good = _plausible_rows(config, numbers, read, p)
        read = replace(read, keys=[k for k, fits in zip(read.keys, good, strict=True) if fits],
                       value=read.value[good])  # fmt: skip
        if read.is_distance:
            found += _distance_rows(read, travel[good])
        elif good.any():
            since = _endstop_shift(config, word, p[good, 0], read.value)
            found += _height_rows(config, read, travel[good, 0], since)
            moved |= since != 0
    return [replace(row, temperature=warm) for row in found], moved


def _read_kind(config: Config, word: str) -> _StoredReadings:
    """Return the readings of a kind that can be read."""
    section = config.section("delta_calibrate")
    places, low, high = _STORED_KINDS[word]
    pattern = re.compile(rf"{word}([0-9]{{1,4}})(?:_pos[12]?)?")
    known = {int(m[1]) for key in section.entries if (m := pattern.fullmatch(key))}
    keys, value, steps = list[str](), list[float](), list[list[list[float]]]()
    for key in (f"{word}{k}" for k in sorted(known)):
        try:
            one = section.number(key, low=low, high=high) * 1e-3
            at = [section.numbers(f"{key}_{place}", 3) for place in places]
        except FileError as error:
            config.note("readings", f"left out: {error}")
            continue
        keys.append(key)
        value.append(one)
        steps.append(at)
    return _StoredReadings(word, keys, np.array(value), np.array(steps))


def _stored_positions(
    config: Config, numbers: Numbers, read: _StoredReadings, step: Array
) -> tuple[Array, Array]:
    """Return the travel of readings from mechanical zero and where the firmware believes the nozzle
    ``(n, k, 3)`` each, metres, nan beyond its arms.

    Microsteps may have been changed since they were stored: the ratio at which most
    readings fit is taken, else 1.
    """

    def at(times: float) -> tuple[Array, Array]:
        heights = numbers.at_endstop - read.steps * step * times
        p = np.full(heights.shape, np.nan)
        for index in np.ndindex(heights.shape[:-1]):
            with suppress(InputError):
                p[index] = numbers.points(heights[index][None])[0]
        return heights - numbers.zero, p

    for times in _STEP_RATIOS:
        travel, p = at(times)
        if np.mean(np.abs(read.excess(p)) <= read.max_error) > 0.5:
            if times != 1.0:
                config.note(
                    "readings",
                    f"the positions of {read.kind}s in [delta_calibrate] were stored with "
                    f"{1 / times:g} times the microsteps of now, and are taken so",
                )
            return travel, p
    return at(1.0)


def _plausible_rows(
    config: Config, numbers: Numbers, read: _StoredReadings, p: Array
) -> NDArray[np.bool_]:
    """Return which readings go with the stored numbers ``(n,)``; of heights a common shift is left
    to `_endstop_shift`, and where most go with nothing none is kept.
    """
    section, miss = config.section("delta_calibrate"), read.excess(p)
    off, good = miss, np.isfinite(miss)
    if not read.is_distance:
        off = miss - (np.nanmedian(miss) if good.any() else 0.0)
        good &= np.hypot(*p[:, 0, :2].T) <= numbers.delta_radius
    good &= np.abs(off) <= read.max_error
    good &= np.mean(good) > 0.5
    for k in np.flatnonzero(~good):
        at, value = section.entries[read.keys[k]], read.value[k]
        config.note(
            "readings",
            f"left out: {at.file}, line {at.line}: [delta_calibrate] {read.keys[k]} is "
            f"{compact(value * 1e3, 6)} mm, where the stored numbers give "
            f"{plain((value + miss[k]) * 1e3, 1)} mm at its stored position: they are of "
            "different times, or it is mistyped or in another "
            f"place of DELTA_ANALYZE's list",
        )
    return np.asarray(good)


def _endstop_shift(config: Config, word: str, p: Array, height: Array) -> float:
    """Return by how much all endstops were moved together since, metres.

    The firmware's own fit leaves neither a mean nor a slope of its heights. A mean without a slope
    is a later change of the endstops (Z_OFFSET_APPLY_ENDSTOP): z = 0 stays where the owner has it,
    and the heights give all else as before.
    """
    if len(height) < _MIN_PLANE_HEIGHTS:
        return 0.0
    mean, along_x, along_y = fit_plane(p, height)
    off = float(np.median(p[:, 2] - height))
    leans = float(np.hypot(along_x, along_y) * np.hypot(*p[:, :2].T).max())
    far, level = abs(off) > _MAX_VALUE_ERROR, leans <= max(_MAX_SLOPE[0], _MAX_SLOPE[1] * abs(mean))
    if not far and not (level and abs(mean) > _MIN_ENDSTOP_SHIFT):
        return 0.0
    since = mean if level else off
    doubt = (
        "; if these heights are of another machine, or of another hotend, run DELTA_CALIBRATE "
        "again before you enter anything"
    )
    config.note(
        CALIBRATE_NOTE if far else "heights",
        f"the {word}s of [delta_calibrate] are {'all ' * level}{signed(since * 1e3, 2)} mm away "
        f"from the endstops that are stored now, which were moved after the touches "
        f"(Z_OFFSET_APPLY_ENDSTOP); z = 0 is left where they put it{doubt * far}",
    )
    return since


def _height_rows(
    config: Config, read: _StoredReadings, travel: Array, since: float
) -> Iterator[Row]:
    """Touches of the plate, by the probe or (``manual_height``) by the nozzle itself."""
    offset, beside = probe_offset(config)
    stored, touched = float(np.median(read.value)), None
    if read.kind == "height" and abs(offset) >= _MIN_PROBE_OFFSET and not read.value.any():
        config.note(
            "heights",
            "the heights of [delta_calibrate] are all 0, as DELTA_CALIBRATE METHOD=manual stores "
            "them: they are taken as touches of the nozzle itself; if the probe touched, with a "
            "z_offset of 0, run DELTA_CALIBRATE again",
        )
    elif read.kind == "height":
        touched = beside
        if not since and offset and abs(stored - offset) > _EQUAL_OFFSETS:
            config.note(
                "heights",
                f"the heights of [delta_calibrate] were stored with a z_offset of "
                f"{compact(stored * 1e3, 6)} mm, and it is {compact(offset * 1e3, 6)} mm now: the "
                "nozzle may end "
                f"{abs(stored - offset) * 1e3:.2g} mm too high or too low; run DELTA_CALIBRATE "
                f"again",
            )
    setup = {"height": "heights", "manual_height": "manual-heights"}[read.kind]
    for at, height in zip(travel, read.value, strict=True):
        label = f"{at[0] * 1e3:.0f} {at[1] * 1e3:.0f}"
        yield Row(PlateTouch.kind, setup, label, at, float(height) + since, beside=touched)


def _distance_rows(read: _StoredReadings, travel: Array) -> Iterator[Row]:
    """Distances of a printed part: six spokes and six sides of its rim, each with pillars of its
    own.
    """
    for key, (one, other), value in zip(read.keys, travel, read.value.tolist(), strict=True):
        label = key.removeprefix("distance")
        rim = int(label) % 12 >= 6
        sigma = RIM_REPEATABILITY if rim else math.nan
        setup = "rim" if rim else "spokes"
        yield Row(Distance.kind, setup, label, one, value, second=other, sigma=sigma,
                  material=PRINTED)  # fmt: skip


def _microstep(config: Config, tower: str) -> float:
    """Return the travel of one microstep of a tower, metres."""
    section = config.section(f"stepper_{tower}")
    if "rotation_distance" not in section and "step_distance" in section:  # of older firmware
        return section.number("step_distance", low=1e-5, high=10) * 1e-3
    around = section.number("rotation_distance", low=0.1, high=1000)
    count = section.number("full_steps_per_rotation", _FULL_STEPS, 3, 1001)
    microsteps = section.number("microsteps", low=0.5, high=1025)
    gear = 1.0
    for pair in section.entries["gear_ratio"].text.split(",") if "gear_ratio" in section else ():
        try:
            driven, driving = map(float, pair.split(":"))
            gear *= driven / driving
        except (ValueError, ZeroDivisionError):
            gear = math.nan
    if not 0 < gear < 1e3:
        section.fail("gear_ratio", "is no list of ratios such as 80:16: correct it")
    return around * 1e-3 / (count * microsteps * gear)
