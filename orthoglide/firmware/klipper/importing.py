"""A ``printer.cfg`` as a machine file and readings; the meshes of its profiles
(klippy/extras/bed_mesh.py).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.add_ons import MARK_KEY
from orthoglide.arguments import public
from orthoglide.effects import catalogue_of
from orthoglide.errors import FileError, InputError
from orthoglide.firmware.imported import (
    Imported,
    Row,
    campaign_of_rows,
    note_few_touches,
    plain_name,
)
from orthoglide.firmware.klipper.config import BROKEN_HEADER, Config, ConfigSection, read_config
from orthoglide.firmware.klipper.heights import (
    CALIBRATE_NOTE,
    CALIPER_REPEATABILITY,
    CHANGED_NOTE,
    PROBE_REPEATABILITY,
    probe_offset,
    probe_section,
    stored_readings,
)
from orthoglide.firmware.klipper.numbers import (
    CALIBRATION,
    DEFAULT_ANGLES,
    FIRMWARE_NAME,
    TOWERS,
    Numbers,
    unequal_arms_warning,
)
from orthoglide.geometry import Array, Geometry, fit_plane
from orthoglide.instruments import Distance, PlateTouch, Setup
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import Instrument, MachineFile, ParameterValue
from orthoglide.numerals import signed
from orthoglide.observations import Readings
from orthoglide.observations.touched_plates import disagreements
from orthoglide.text import printable_path

_MAX_TOUCHES = 1000  # of a mesh: a bed is smooth, and neighbours of a scan read nearly the same


def stored_meshes(
    config: Config, numbers: Numbers, turned: Mapping[str, float], moved: bool
) -> dict[str, list[Row]]:
    """Return the touches of every mesh by the name of its campaign, taken as probed with the
    present numbers; ``turned``: rotation of the plate on its seat by profile, degrees. If z = 0 was
    ``moved`` before or after a mesh, meshes are shifted to it.

    Raises:
        InputError: if a mesh in ``turned`` is not stored.
    """
    profiles = {
        s.name.partition(" ")[2]: s for s in config.sections_of_kind("bed_mesh") if "points" in s
    }
    profiles.pop("", None)
    if unknown := set(turned).difference(profiles):
        raise InputError(
            f"there is no mesh {min(unknown)!r} whose plate was turned: take one of "
            f"{', '.join(map(repr, profiles)) or 'none'}"
        )
    rows_by_campaign: dict[str, list[Row]] = {}
    profile_by_content: dict[tuple[float, bytes], str] = {}
    for profile, section in profiles.items():
        # Names differ by more than capitals, as files and parameters carry them.
        plain, taken = plain_name(profile, "mesh"), {name.lower() for name in rows_by_campaign}
        names = chain((plain,), (f"{plain}-{number}" for number in count(2)))
        name = next(n for n in names if f"mesh-{n}".lower() not in taken)
        rows = list[Row]()
        with config.leaving_out(f"mesh {profile!r}: ", kind="mesh"):
            rows = list(_touches(config, numbers, section, name, turned.get(profile, 0.0)))
        if not rows:
            continue
        command = np.array([row.travel for row in rows])
        first_profile = profile_by_content.setdefault(
            (rows[0].setup.turned, command.tobytes()), profile
        )
        if first_profile != profile:
            config.note(
                "mesh",
                f"the mesh {profile!r} is {first_profile!r} to the last digit, saved under another "
                f"name: it is left out, for it would count twice",
            )
            continue
        if moved:
            p = numbers.points(command + numbers.zero)
            (offset, *_), _ = fit_plane(p, p[:, 2] - [row.reading for row in rows])
            rows = [replace(row, reading=row.reading + offset) for row in rows]
            config.note(
                "mesh",
                f"the mesh {profile!r} is shifted by {signed(-offset * 1e3, 2)} mm, to z = 0 in "
                f"the middle, as the endstops were moved before it or after it",
            )
        rows_by_campaign[f"mesh-{name}"] = rows
    return rows_by_campaign


def _touches(
    config: Config, numbers: Numbers, section: ConfigSection, name: str, turned: float
) -> Iterator[Row]:
    """Yield the touches of a profile.

    Raises:
        FileError: if the profile is invalid, or lies beyond the arms.
    """
    if section.number("version", 0) != 1:
        section.fail(
            "version",
            "is missing or not 1, as in meshes of before December 2019, which the firmware leaves "
            "out as well: probe the mesh again, or remove the profile",
        )
    table = section.table("points")
    if not np.any([value for line in table for value in line]):
        section.fail("points", "are nothing but zeros, as no probe reads: probe the mesh again")
    columns = int(section.number("x_count", len(table[0]), 0))
    lines = int(section.number("y_count", len(table), 0))
    if len(table) != lines or any(len(line) != columns for line in table):
        section.fail("points", f"are not {lines} rows of {columns}: probe the mesh again")
    spans = []
    for axis, number in (("x", columns), ("y", lines)):
        low, high = section.number(f"min_{axis}"), section.number(f"max_{axis}")
        if not low < high:
            section.fail(f"max_{axis}", f"is not above min_{axis}: correct it")
        spans.append(np.linspace(low, high, number) * 1e-3)
    height, beside = probe_offset(config)
    profile = section.name.partition(" ")[2]
    places, z = np.stack(np.meshgrid(*spans), axis=-1).reshape(-1, 2), np.array(table)
    rows_kept = np.flatnonzero(_touched_points(config, profile, z, places, beside))
    p = np.column_stack([places - beside, height + z.ravel() * 1e-3])[rows_kept]
    travel = numbers.heights(p) - numbers.zero
    if np.isnan(travel).any():
        farthest = float(np.hypot(*places[rows_kept].T).max())
        section.fail(
            "points",
            f"reach {farthest * 1e3:.0f} mm out, beyond the arms: probe the mesh again, or remove "
            f"the profile",
        )
    probe_place = (*beside.tolist(), 0.0)
    setup = Setup(name, kind=PlateTouch.kind, beside=probe_place, turned=turned)
    for position, (x, y) in zip(travel, places[rows_kept] * 1e3, strict=True):
        label = f"{x:.6g} {y:.6g}"
        yield Row(setup, label, position, height, temperature=section.temperature)


def _touched_points(
    config: Config, profile: str, table: Array, place: Array, offset: Array
) -> NDArray[np.bool_]:
    """Return which values of a mesh ``(rows, columns)`` at places ``(rows * columns, 2)`` were
    touched ``(rows * columns,)``: not padding, and not in faulty regions.
    """
    general, (lines, columns) = config.section_or_empty("bed_mesh"), table.shape
    touched = np.ones(len(place), dtype=bool)
    stride = int(np.ceil(np.sqrt(len(place) / _MAX_TOUCHES)))
    if stride > 1:
        taken = [(np.arange(n) - n // 2) % stride == 0 for n in (lines, columns)]
        touched &= np.outer(*taken).ravel()
        config.note(
            "mesh",
            f"a mesh of {lines} by {columns} is finer than any cause needs: of its rows and "
            f"columns one in {stride} is taken",
        )
    # Of a round bed the firmware touches the circle in the profile's own square; beyond, it repeats
    # values, or some firmware continues them. mesh_radius may have been another one then.
    repeats = min(table.shape) > 2 and bool((
        table[[0, 0, -1, -1], [0, -1, 0, -1]] == table[[0, 0, -1, -1], [1, -2, 1, -2]]
    ).all())  # fmt: skip
    if config.number_or_zero("bed_mesh", "mesh_radius", 0, 5000) or repeats:
        scaled = (place - (place.min(axis=0) + place.max(axis=0)) / 2) / np.ptp(place, axis=0)
        beyond = touched & (np.hypot(*scaled.T) > (1 + 1e-6) / 2)
        touched &= ~beyond
        if not repeats:
            _note_left_out(config, profile, beyond, "beyond its circle", "mesh_radius is given")
    inside = np.zeros_like(touched)
    for k in range(1, 100):  # in faulty regions the firmware interpolates neighbouring values
        low, high = f"faulty_region_{k}_min", f"faulty_region_{k}_max"
        if low not in general:
            break
        with config.leaving_out(kind="mesh"):
            corners = np.array([general.numbers(low, 2), general.numbers(high, 2)]) * 1e-3
            for positions in (place, place - offset):
                inside |= ((positions >= corners[0]) & (positions <= corners[1])).all(axis=1)
    _note_left_out(config, profile, touched & inside, "in a faulty_region", "regions are given")
    return touched & ~inside


def _note_left_out(
    config: Config, profile: str, left_out: NDArray[np.bool_], where: str, given: str
) -> None:
    """Add a note on values of a mesh that are no touches because of an option, if there are any."""
    if left_out.any():
        config.note(
            "mesh",
            f"{int(left_out.sum())} of the {len(left_out)} values of the mesh {profile!r} are left "
            f"out, as they lie {where}, where the firmware touches nothing while {given} in "
            f"[bed_mesh]: if that was changed since, put it back, or probe the mesh again",
        )


PLATFORM_RADIUS, ROD_DISTANCE, NOZZLE_DROP = 0.032, 0.050, 0.040
"""Typical sizes that the firmware does not store, metres: radius of the platform, distance of an
arm's two rods, nozzle below the platform's joints. Effects that turn the platform need them."""

_ZERO_REFERENCE_KEYS = ("zero_reference_position", "relative_reference_index")
_UNFITTED_RADIUS_SD = 3e-3  # metres: standard deviation of a radius that no calibration has fitted
_UNREPEATED_NOTES = ("line", "mesh", "readings", "rods")  # kinds of notes that no result repeats


@public
def import_printer(
    path: str | os.PathLike[str], turned: Mapping[str, float] | None = None
) -> Imported:
    """Read what a printer stores; what cannot be read is left out, with a note.

    Args:
        path: its ``printer.cfg``, or the folder that it is in.
        turned: by profile of a mesh, how far the plate was turned on its seat, counter-clockwise
            from above, degrees.

    Raises:
        FileError: naming the line and what would be right.
        InputError: where a mesh that is said to be of a turned plate is not stored.
    """
    config = read_config(path)
    try:
        return _imported(config, turned or {})
    except InputError as error:
        reasons = [note for note in config.notes if note.kind in ("twice", BROKEN_HEADER)]
        if not reasons:
            raise
        if not isinstance(error, FileError):
            error = FileError(str(error), file=config.file)
        message = f"{error.reason}; {'; '.join(reasons)}"
        raise FileError(message, file=error.file, line=error.line) from None


def _imported(config: Config, turned: Mapping[str, float]) -> Imported:
    """Return the machine, readings and notes of a file."""
    numbers = Numbers.read(config)
    calibration, moved = stored_readings(config, numbers)
    rows = {CALIBRATION: calibration, **stored_meshes(config, numbers, turned, moved)}
    if not any(rows.values()):
        raise _no_readings_error(config)
    machine = _machine(config, numbers, list(chain.from_iterable(rows.values())))
    campaigns = list[Readings]()
    for name, readings in rows.items():
        if readings:
            with config.leaving_out(kind="mesh"):
                campaigns.append(campaign_of_rows(name, readings, machine))
    if not campaigns:
        raise _no_readings_error(config)
    relative = any(key in config.section_or_empty("bed_mesh") for key in _ZERO_REFERENCE_KEYS)
    kinematics = numbers.kinematics(numbers.zero)
    differing = list(disagreements(kinematics, campaigns, relative=relative))
    # The heights of the calibration are valid for any numbers: a mesh that lies elsewhere, with the
    # same shape, tells as much of all but the endstops.
    since = [n for _, other, n in differing if other == CALIBRATION and n.kind == "moved"]
    apart = [(name, other) for name, other, note in differing if note not in since]
    is_known = all(other == CALIBRATION for _, other in apart)
    excluded = {name for name, _ in apart}
    _add_notes(config, numbers, campaigns, relative)
    notes = [*config.notes, *(note for _, _, note in differing)]
    ordered = sorted(dict.fromkeys(notes), key=lambda note: note.kind not in ("twice", "rods"))
    unrepeated = (*_UNREPEATED_NOTES, BROKEN_HEADER)
    warnings = [printable_path(note) for note in ordered if note.kind not in unrepeated]
    since += [note for note in ordered if note.kind == CHANGED_NOTE]
    calibrate_again = bool(since) or any(note.kind == CALIBRATE_NOTE for note in ordered)
    table: dict[str, Any] = {
        "file": Path(config.file).name,
        "sha256": config.sha256,
        MARK_KEY: numbers.mark,
        **numbers.as_dict(),
        "meshes_relative": relative,
        **({"warnings": warnings} if warnings else {}),
        **({"calibrate_again": True} if calibrate_again else {}),
        **({"changed_since": [printable_path(n) for n in since]} if since else {}),
        "assumed_mm": {
            "r": PLATFORM_RADIUS * 1e3, "d": ROD_DISTANCE * 1e3, "tool_below": NOZZLE_DROP * 1e3,
        },
    }  # fmt: skip
    machine = replace(machine, provenance={FIRMWARE_NAME: table})
    together = tuple(c.name for c in campaigns if is_known and c.name not in excluded)
    return Imported(machine, tuple(campaigns), tuple(ordered), together)


def _no_readings_error(config: Config) -> FileError:
    """Return the error of a file without usable readings, with what was left out."""
    kinds = (*_UNREPEATED_NOTES, CALIBRATE_NOTE)
    left_out = [str(note) for note in config.notes if note.kind in kinds]
    reasons = (
        f" ({'; '.join(left_out[:2])}{', and more' * (len(left_out) > 2)})" if left_out else ""
    )
    return FileError(
        f"has no readings that can be used: run DELTA_CALIBRATE or BED_MESH_CALIBRATE and "
        f"SAVE_CONFIG, and take the file that the firmware saved{reasons}",
        file=config.file,
    )


def _machine(config: Config, numbers: Numbers, rows: Sequence[Row]) -> MachineFile:
    """Return the nominal machine of the firmware's numbers, with all rows in its stroke."""
    arm = numbers.mean_arm
    ends = [end for row in rows for end in (row.travel, row.second) if end is not None]
    radius = config.number_or_zero("printer", "print_radius", -1, 5000) * 1e-3
    angle = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    rim = numbers.heights(radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    if np.isnan(rim).any():  # not reached by the arms
        rim = numbers.heights(np.zeros((1, 3)))
    heights = np.concatenate([np.array(ends), rim - numbers.zero])
    low = min(np.floor((float(heights.min()) - 1e-3) * 1e3) * 1e-3, -1e-3)
    high = max(float(heights.max()), float((numbers.at_endstop - numbers.zero).max()))
    stroke = (round(float(low), 6), round(max(float(np.ceil(high * 1e3)) * 1e-3, 1e-3), 6))
    radius = round(numbers.delta_radius + PLATFORM_RADIUS, 9)
    layout = LinearDelta((radius,) * 3, numbers.angle, (0.0, 0.0, -NOZZLE_DROP))
    try:
        geometry = Geometry(arm, ROD_DISTANCE, PLATFORM_RADIUS, stroke, layout)
    except InputError as error:
        config.section(f"stepper_{TOWERS[0]}").fail(
            "position_endstop",
            f"does not go with the stored positions ({error}): give it in millimetres, or probe "
            "again",
        )
    catalogue = catalogue_of(LinearDelta.names)
    effect_name = next(e.name for e in catalogue.effects if e.controller == "bar_length")
    # A radius from a drawing was never fitted. Rods of one set are equal: where a fit gives them
    # different lengths, its other numbers have errors of that size.
    belts, spread = catalogue.belt_tolerance, float(np.ptp(numbers.arm))
    never_fitted = numbers.angle == DEFAULT_ANGLES and len(set(numbers.endstop)) == 1
    tolerance = {
        name: _UNFITTED_RADIUS_SD if never_fitted else max(belts[name], spread)
        for name in catalogue.correctable_by("place")
    }
    return MachineFile(
        name=Path(config.file).stem,
        geometry=geometry,
        instruments={
            PlateTouch.kind: Instrument(repeatability=PROBE_REPEATABILITY),
            Distance.kind: Instrument(repeatability=CALIPER_REPEATABILITY),
        },
        tolerance=tolerance,
        parameters={
            f"{effect_name}.{name}": ParameterValue(round(length - arm, 9), 0.0, "mm")
            for name, length in zip(TOWERS, numbers.arm, strict=True)
            if abs(length - arm) > 1e-9
        },
    )


def _add_notes(
    config: Config, numbers: Numbers, campaigns: Sequence[Readings], relative: bool
) -> None:
    """Add notes on the numbers and the readings for the owner."""
    if warning := unequal_arms_warning(numbers):
        config.note("rods", warning)
    config.notes += note_few_touches(max(int(c.touching.sum()) for c in campaigns))
    if all(c.name == CALIBRATION for c in campaigns):
        return
    if config.missing_includes and probe_section(config) is None:
        missing = ", ".join(map(repr, config.missing_includes))
        config.note(
            "probe",
            f"{missing} is not where it is included from: if it describes the probe, put it there; "
            f"the probe is taken to touch where the nozzle is",
        )
    if relative:
        config.note(
            "relative",
            "[bed_mesh] takes the height at one place out of every mesh (zero_reference_position): "
            "how high the nozzle stands there is not known; set it by hand once new numbers are "
            "entered, or remove the key and probe again",
        )
    config.note(
        "mesh",
        "a mesh is taken as probed with the numbers that are stored now; if they were changed "
        "since, probe it again",
    )
