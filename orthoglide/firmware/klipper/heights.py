"""Heights and distances of [delta_calibrate], which are stored as steps from the endstops
(klippy/extras/delta_calibrate.py).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import compress, product

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.firmware.imported import Row
from orthoglide.firmware.klipper.config import Config, ConfigSection
from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.geometry import Array, fit_plane
from orthoglide.instruments import PRINTED, Distance, PlateTouch, Setup
from orthoglide.numerals import compact, plain, signed
from orthoglide.units import MICROSTEP_RATIOS, PULLEY_RATIOS

PROBE_REPEATABILITY = 1.8e-5
"""Repeatability of a touch, metres."""

CALIPER_REPEATABILITY, RIM_REPEATABILITY = 5e-5, 1e-4
"""Repeatability of a caliper's distance, metres. Around the rim the width of only one of two
pillars is subtracted, and pillars differ by a tenth of a millimetre."""

CALIBRATE_NOTE = "calibrate"
"""Kind of a note that the firmware's own calibration has to be run again."""

CHANGED_NOTE = "changed"
"""Kind of a note on what was changed in the file since that calibration."""

PROBE_SECTIONS = (
    "probe", "bltouch", "smart_effector", "load_cell_probe", "probe_eddy_current", "beacon",
    "cartographer", "scanner", "dockable_probe",
)  # fmt: skip
_STORED_KINDS = {  # kinds of values in [delta_calibrate]: keys of positions; limits, millimetres
    "height": (["pos"], -100.0, 100.0),
    "manual_height": (["pos"], -100.0, 100.0),
    "distance": (["pos1", "pos2"], 1.0, 1000.0),
}
_FULL_STEPS = 200  # of a motor in one turn, the firmware's default
_MAX_VALUE_ERROR = 3e-3  # metres between a stored value and the one that the stored numbers give
_MAX_DISTANCE_ERROR = 0.2, 1e-2  # share, or metres: one wrong digit, or a pillar's width, is found
_MIN_PROBE_OFFSET = 1e-3  # metres: a smaller offset of a probe corrects the nozzle's height
_EQUAL_OFFSETS = 2e-5  # metres: heights stored with another offset of the probe differ by more
_TOWER_SETS = (np.ones(3), *np.eye(3))  # whose steps are changed together
_NOISE = {"height": PROBE_REPEATABILITY, "manual_height": PROBE_REPEATABILITY, "distance": 1e-4}
_NEWTON_STEPS = 6  # of a factor of travel, to which heights are nearly proportional
_CHANGE = 1e-6  # metres, or relative: for derivatives of heights
_MIN_STEP_GAIN = 14.0
"""Decrease of chi2 that a changed length of a step must reach against moved endstops, which are a
thousand times as frequent (2 ln 1000)."""
_MIN_PLANE_HEIGHTS = 3  # heights that determine a mean and a slope
_MIN_ENDSTOP_SHIFT = 3e-5  # metres: larger residuals of heights mean moved endstops
_MAX_SLOPE = 2e-5, 0.1  # largest slope beside that mean: metres at the rim, or share of the mean


def probe_section(config: Config) -> ConfigSection | None:
    """Return the section of the probe; ``None`` if there is none."""
    sections = config.sections_of_kind(*PROBE_SECTIONS)
    return next((s for s in sections if s.name == "probe" or "z_offset" in s), None)


def probe_offset(config: Config) -> tuple[float, Array]:
    """Return the height of the nozzle above the plate where the probe triggers (z_offset), and the
    place of the probe beside the nozzle ``(2,)``, metres.
    """
    if (section := probe_section(config)) is None:
        return 0.0, np.zeros(2)
    beside = [config.number_or_zero(section.name, f"{axis}_offset", -200, 200) for axis in "xy"]
    above = config.number_or_zero(section.name, "z_offset", -100, 100)
    return above * 1e-3, np.round(np.array(beside) * 1e-3, 12)  # lengths without rounding errors


def stored_readings(config: Config, numbers: Numbers) -> tuple[list[Row], bool]:
    """Return the stored heights and distances, and whether z = 0 was moved since.

    What cannot be used is left out with a note.
    """
    section, moved, rows = config.section_or_empty("delta_calibrate"), False, list[Row]()
    step: Array | None = None
    with config.leaving_out("heights and distances: "):
        step = np.array([_microstep(config, name) for name in TOWERS]) if section.entries else None
    if step is None:
        return [], False
    lists = {kind: _read_kind(config, section, kind) for kind in _STORED_KINDS}
    lists = {kind: found for kind, found in lists.items() if found[0]}
    values = {kind: value for kind, (_, value, _) in lists.items()}
    ways = {
        kind: steps * step * _microstep_ratios(config, numbers, kind, value, steps * step)
        for kind, (_, value, steps) in lists.items()
    }  # fmt: skip
    factors = _step_factors(config, numbers, values, ways)
    for kind, (keys, value, _) in lists.items():
        way = ways[kind] * factors.get(kind, 1.0)
        p, travel = _positions(numbers, way), numbers.at_endstop - way - numbers.zero
        kept = _plausible_rows(config, numbers, kind, keys, value, p)
        keys, value, travel = list(compress(keys, kept)), value[kept], travel[kept]
        if p.shape[1] > 1:  # distances between two places
            rows += _distance_rows(keys, value, travel)
        elif keys:
            shift = _endstop_shift(config, kind, p[kept, 0], value)
            rows += _height_rows(config, kind, value, travel[:, 0], shift)
            moved |= shift != 0
    return [replace(row, temperature=section.temperature) for row in rows], moved


def _read_kind(config: Config, section: ConfigSection, kind: str) -> tuple[list[str], Array, Array]:
    """Return the keys of the readable readings of a kind, their values ``(n,)``, metres, and the
    motor steps of the one or two places at which they were taken ``(n, k, 3)``.
    """
    places, low, high = _STORED_KINDS[kind]
    pattern = re.compile(rf"{kind}([0-9]{{1,4}})(?:_pos[12]?)?")
    indices = {int(m[1]) for key in section.entries if (m := pattern.fullmatch(key))}
    values, steps = dict[str, float](), list[list[list[float]]]()
    for key in (f"{kind}{k}" for k in sorted(indices)):
        with config.leaving_out():
            value = section.number(key, low=low, high=high) * 1e-3
            steps.append([section.numbers(f"{key}_{place}", 3) for place in places])
            values[key] = value
    return [*values], np.array([*values.values()]), np.array(steps)


def _excess(value: Array, p: Array) -> tuple[Array, Array]:
    """Return computed minus stored values for places ``(n, k, 3)``, and their limits, metres.

    Heights have one column ``(n, 1)``. Distances have three ``(n, 3)``: the distance, and z at both
    ends, which is 0 on the plate.
    """
    if p.shape[1] == 1:
        return p[:, :, 2] - value[:, None], np.full((len(value), 1), _MAX_VALUE_ERROR)
    distance = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
    most = np.full((len(value), 3), _MAX_VALUE_ERROR)
    most[:, 0] = np.maximum(_MAX_DISTANCE_ERROR[0] * value, _MAX_DISTANCE_ERROR[1])
    return np.column_stack([distance - value, p[:, :, 2]]), most


def _positions(numbers: Numbers, way: Array) -> Array:
    """Return places of the nozzle by the firmware's equations ``(n, k, 3)``, metres, for ways from
    the endstops; nan where the arms do not reach.
    """
    with suppress(InputError):
        return numbers.points((numbers.at_endstop - way).reshape(-1, 3)).reshape(way.shape)
    p = np.full(way.shape, np.nan)
    for index in np.ndindex(way.shape[:-1]):
        with suppress(InputError):
            p[index] = numbers.points((numbers.at_endstop - way[index])[None])[0]
    return p


def _inside(numbers: Numbers, p: Array) -> NDArray[np.bool_]:
    """Return a mask ``(n,)`` of positions between towers: beyond, heights fit wrong steps too."""
    return np.asarray(np.hypot(*p[..., :2].T).max(axis=0) <= numbers.delta_radius)


def _microstep_ratios(
    config: Config, numbers: Numbers, kind: str, value: Array, way: Array
) -> Array:  # fmt: skip
    """Return the ratios of the stored length of a microstep to the present one ``(3,)``, for ways
    from the endstops at the present one.

    Microsteps, of all towers or of one, may have been changed since: the first ratio at which most
    readings are plausible is taken, else 1. Other pulleys or motors, of all towers, are sought for
    distances: to heights, `_step_factors` fits any ratio.
    """
    others = product(PULLEY_RATIOS, _TOWER_SETS[:1]) if way.shape[1] > 1 else ()
    for ratio, towers in (*product(MICROSTEP_RATIOS, _TOWER_SETS), *others):
        ratios = np.where(towers, ratio, 1.0)
        excess, most = _excess(value, p := _positions(numbers, way * ratios))
        if np.mean((np.abs(excess) <= most).all(axis=1) & _inside(numbers, p)) > 0.5:
            if ratio != 1.0:
                alone, outcome = _single_tower(ratios), "and are converted"
                if ratio in PULLEY_RATIOS:
                    outcome += ": the motor's steps or the pulley's teeth were others"
                if alone:
                    outcome = f"on {alone} alone: correct its microsteps, or run DELTA_CALIBRATE"
                config.note(
                    CHANGED_NOTE if alone else "readings",
                    f"the positions of {kind}s in [delta_calibrate] were stored with "
                    f"{1 / ratio:.4g} times the microsteps of now, {outcome}",
                )
            return ratios
    return np.ones(3)


def _single_tower(ratios: Array) -> str:
    """Return the tower whose steps alone changed, in words; empty if those of all did."""
    changed = np.flatnonzero(ratios != 1)
    return f"tower {TOWERS[changed[0]]}" if len(changed) == 1 else ""


def _step_factors(
    config: Config, numbers: Numbers, values: Mapping[str, Array], ways: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the ratios of the steps' lengths at the touches to the present ones ``(3,)``, by kind
    of reading; empty if no change of all towers or of one is significant.

    A changed rotation_distance shifts heights, as moved endstops do. It also bends the plate and
    scales distances, which the firmware had fitted.
    """
    heights = next((k for k in values if ways[k].shape[1] == 1), "")
    if len(values.get(heights, ())) < _MIN_PLANE_HEIGHTS:
        return {}

    def excess(kind: str, way: Array) -> Array:
        return _excess(values[kind], _positions(numbers, way))[0][:, 0]

    def gain(kind: str, shift: Array, factor: Array) -> float:
        """Return the decrease of chi2 of a kind by factors; of heights, against a shift."""
        way = ways[kind]
        before = float(np.mean(excess(kind, way + shift * (kind == heights)) ** 2))
        after = float(np.mean(excess(kind, way * factor) ** 2))
        return len(way) * (before - after) / max(_NOISE[kind] ** 2, after)

    def fitted(towers: Array, change: Callable[[Array, Array], Array], neutral: float) -> Array:
        """Return the change of the heights' ways of some towers that fits them best ``(3,)``."""
        size = neutral
        for _ in range(_NEWTON_STEPS):
            low, high = (
                excess(heights, change(ways[heights], neutral + (x - neutral) * towers))
                for x in (size, size + _CHANGE)
            )
            slope = (high - low) / _CHANGE
            size -= float(slope @ low / (slope @ slope))
        return np.asarray(neutral + (size - neutral) * towers)

    best, factor, gains = math.inf, np.ones(3), dict[str, float]()
    for towers in _TOWER_SETS:
        shift, factors = fitted(towers, np.add, 0.0), fitted(towers, np.multiply, 1.0)
        misfit = excess(heights, ways[heights] * factors)
        residual = float(np.mean(misfit**2))
        if residual < best and np.abs(misfit).max() < _MAX_VALUE_ERROR:
            best, factor = residual, factors
            gains = {kind: gain(kind, shift, factors) for kind in values}
    scaled = [kind for kind, fall in gains.items() if fall > 0]
    if heights not in scaled or sum(gains[kind] for kind in scaled) <= _MIN_STEP_GAIN:
        return {}
    first = int(np.flatnonzero(factor != 1)[0])
    ratio = float(factor[first])
    turn = config.section(f"stepper_{TOWERS[first]}").number("rotation_distance", 0.0)
    alone = _single_tower(factor)
    example = f", as with a rotation_distance of {compact(turn * ratio, 4)} mm" if turn else ""
    config.note(
        CHANGED_NOTE,
        f"the {' and '.join(f'{kind}s' for kind in scaled)} of [delta_calibrate] fit the stored "
        f"numbers with steps{alone and f' of {alone}'} that are "
        f"{abs(ratio - 1) * 1e2:.2f} % {'longer' if ratio > 1 else 'shorter'} than now{example}: "
        f"rotation_distance or the microsteps were changed after the calibration; restore them, or "
        f"run DELTA_CALIBRATE",
    )
    return dict.fromkeys(scaled, factor)


def _plausible_rows(
    config: Config, numbers: Numbers, kind: str, keys: Sequence[str], value: Array, p: Array
) -> NDArray[np.bool_]:
    """Return which readings agree with the stored numbers ``(n,)``; none if most of them do not.

    A common shift of heights is left to `_endstop_shift`.
    """
    excess, most = _excess(value, p)
    reached, common = np.asarray(np.isfinite(excess).all(axis=1)), 0.0
    if p.shape[1] == 1 and reached.sum() >= _MIN_PLANE_HEIGHTS:
        common = float(np.median(excess[reached]))
    plausible = _inside(numbers, p) & (np.abs(excess - common) <= most).all(axis=1)
    plausible &= np.mean(plausible) > 0.5
    if len(plausible) > 1 and not plausible.any():
        largest = plain(np.abs(excess[reached]).max(initial=0.0) * 1e3, 1)
        misses = f"the stored numbers miss by up to {largest} mm"
        misses = f", which {misses if reached.any() else 'the arms do not reach'}"
        remedy = "they are of different times, or a number of one tower is wrong: correct it"
        if p.shape[1] > 1 and (np.abs(excess[:, 1:]) <= most[:, 1:]).all():  # right positions
            share = float(np.median(value / (value + excess[:, 0])))
            remedy = f"they are {share:.3g} times as long as their positions are apart: look at "
            remedy += "their unit"
        config.note(
            CALIBRATE_NOTE if p.shape[1] == 1 else "readings",
            f"left out: all {len(plausible)} {kind}s of [delta_calibrate]{misses}: {remedy}, or "
            f"run DELTA_CALIBRATE",
        )
        return plausible
    elsewhere = ", or in another place of DELTA_ANALYZE's list" if p.shape[1] > 1 else ""
    for k in np.flatnonzero(~plausible).tolist():
        entry = config.section("delta_calibrate").entries[keys[k]]
        stored, computed = value[k], value[k] + excess[k, 0]
        worst = int(np.argmax(np.abs(excess[k]) / most[k])) if reached[k] else 0
        if worst > 0:  # an end of a distance
            stored, computed = 0.0, excess[k, worst]
        given = "the arms do not reach"
        if reached[k]:
            given = f"the stored numbers give {plain(computed * 1e3, 1)} mm at"
        config.note(
            "readings",
            f"left out: {entry.file}, line {entry.line}: [delta_calibrate] {keys[k]} is "
            f"{'at z = ' * (worst > 0)}{compact(stored * 1e3, 6)} mm, where {given} its stored "
            f"position: they are of different times, or it is mistyped{elsewhere}",
        )
    return plausible


def _endstop_shift(config: Config, kind: str, p: Array, height: Array) -> float:
    """Return computed less stored heights if all endstops were moved after the touches, metres;
    else 0.

    The residuals of the firmware's own fit have neither a mean nor a slope. A mean without a slope
    is a later change of the endstops (Z_OFFSET_APPLY_ENDSTOP). Then z = 0 stays where the owner put
    it, and the heights determine everything else as before. A residual beyond 3 mm is such a change
    with any slope, but the note asks for a new calibration.
    """
    if len(height) < _MIN_PLANE_HEIGHTS:
        return 0.0
    residual = p[:, 2] - height
    mean, along_x, along_y = fit_plane(p, residual)[0].tolist()
    median = float(np.median(residual))
    rise_at_rim = float(np.hypot(along_x, along_y) * np.hypot(*p[:, :2].T).max())
    is_far = abs(median) > _MAX_VALUE_ERROR
    is_level = rise_at_rim <= max(_MAX_SLOPE[0], _MAX_SLOPE[1] * abs(mean))
    # A single slip moves the mean alone.
    if not is_far and not (is_level and min(abs(mean), abs(median)) > _MIN_ENDSTOP_SHIFT):
        return 0.0
    shift = mean if is_level else median
    doubt = "; if they are of another machine or hotend, run DELTA_CALIBRATE again"
    config.note(
        CALIBRATE_NOTE if is_far else "heights",
        f"the {kind}s of [delta_calibrate] are {'all ' * is_level}{signed(shift * 1e3, 2)} mm away "
        f"from the endstops that are stored now, which were moved after the touches "
        f"(Z_OFFSET_APPLY_ENDSTOP); the present z = 0 is kept{doubt * is_far}",
    )
    return shift


def _height_rows(
    config: Config, kind: str, value: Array, travel: Array, shift: float
) -> Iterator[Row]:
    """Yield touches of the plate: by the nozzle for ``manual_height``, or if all values of
    ``height`` are 0 although the probe has an offset; else by the probe.
    """
    offset, beside = probe_offset(config)
    stored_offset, touched_beside = float(np.median(value)), (0.0, 0.0)
    if kind == "height" and abs(offset) >= _MIN_PROBE_OFFSET and not value.any():
        config.note(
            "heights",
            "the heights of [delta_calibrate] are all 0, as DELTA_CALIBRATE METHOD=manual stores "
            "them: they are taken as touches of the nozzle itself; if the probe touched, with a "
            "z_offset of 0, run DELTA_CALIBRATE again",
        )
    elif kind == "height":
        touched_beside = tuple(beside.tolist())
        if not shift and offset and abs(stored_offset - offset) > _EQUAL_OFFSETS:
            config.note(
                "heights",
                f"the heights of [delta_calibrate] were stored with a z_offset of "
                f"{compact(stored_offset * 1e3, 6)} mm, and it is {compact(offset * 1e3, 6)} mm "
                f"now: the nozzle may end {abs(stored_offset - offset) * 1e3:.2g} mm too high or "
                f"too low; run DELTA_CALIBRATE again",
            )
    name = {"height": "heights", "manual_height": "manual-heights"}[kind]
    setup = Setup(name, kind=PlateTouch.kind, beside=(*touched_beside, 0.0))
    for position, height in zip(travel, value.tolist(), strict=True):
        label = f"{position[0] * 1e3:.0f} {position[1] * 1e3:.0f}"
        yield Row(setup, label, position, height + shift)


def _distance_rows(keys: Sequence[str], value: Array, travel: Array) -> Iterator[Row]:
    """Yield distances of a printed part: six spokes and six sides of its rim, each between two
    pillars.
    """
    spokes, rim = (Setup(n, kind=Distance.kind, material=PRINTED) for n in ("spokes", "rim"))
    for key, ends, distance in zip(keys, travel, value.tolist(), strict=True):
        label = key.removeprefix("distance")
        is_rim = int(label) % 12 >= 6
        setup, sigma = (rim, RIM_REPEATABILITY) if is_rim else (spokes, math.nan)
        yield Row(setup, label, ends[0], distance, second=ends[1], sigma=sigma)


def _microstep(config: Config, tower: str) -> float:
    """Return the travel of one microstep of a tower, metres."""
    section = config.section(f"stepper_{tower}")
    if "rotation_distance" not in section and "step_distance" in section:  # of older firmware
        return section.number("step_distance", low=1e-5, high=10) * 1e-3
    rotation = section.number("rotation_distance", low=0.1, high=1000)
    full_steps = section.number("full_steps_per_rotation", _FULL_STEPS, 3, 1001)
    microsteps = section.number("microsteps", low=0.5, high=1025)
    gear = 1.0
    for pair in section.entries["gear_ratio"].text.split(",") if "gear_ratio" in section else ():
        try:
            driven, driving = map(float, pair.split(":"))
            gear *= driven / driving
        except (ValueError, ZeroDivisionError):
            gear = math.nan
    if not 0 < gear < 1e3:
        section.fail("gear_ratio", "must be a list of ratios such as 80:16")
    return rotation * 1e-3 / (full_steps * microsteps * gear)
