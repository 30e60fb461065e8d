"""A ``printer.cfg`` as a machine file and readings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.add_ons import MARK_KEY
from orthoglide.arguments import public
from orthoglide.effects import catalogue_of
from orthoglide.errors import FileError, InputError
from orthoglide.firmware.imported import Imported, Row, campaign_of_rows, note_few_touches
from orthoglide.firmware.klipper import provenance
from orthoglide.firmware.klipper.config import BROKEN_HEADER, Config, read_config
from orthoglide.firmware.klipper.heights import (
    CALIBRATE_NOTE,
    CALIPER_REPEATABILITY,
    CHANGED_NOTE,
    PROBE_REPEATABILITY,
    probe_section,
    stored_readings,
)
from orthoglide.firmware.klipper.meshes import stored_meshes
from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.geometry import Array, Geometry
from orthoglide.instruments import Distance, PlateTouch
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import Instrument, MachineFile, ParameterValue
from orthoglide.observations import Readings
from orthoglide.observations.touched_plates import disagreements
from orthoglide.text import printable_path

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
    rows = {provenance.CALIBRATION: calibration, **stored_meshes(config, numbers, turned, moved)}
    if not any(rows.values()):
        raise _no_readings_error(config)
    machine = _machine(config, numbers, list(chain.from_iterable(rows.values())))
    campaigns = list(_campaigns(config, rows, machine))
    if not campaigns:
        raise _no_readings_error(config)
    relative = any(key in config.section_or_empty("bed_mesh") for key in _ZERO_REFERENCE_KEYS)
    kinematics = numbers.kinematics(numbers.zero)
    differing = list(disagreements(kinematics, campaigns, relative=relative))
    # The heights of the calibration are valid for any numbers: a mesh that lies elsewhere, with the
    # same shape, tells as much of all but the endstops.
    since = [
        n for _, other, n in differing if other == provenance.CALIBRATION and n.kind == "moved"
    ]
    apart = [(name, other) for name, other, note in differing if note not in since]
    is_known = all(other == provenance.CALIBRATION for _, other in apart)
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
        provenance.MESHES_RELATIVE_KEY: relative,
        **({provenance.WARNINGS_KEY: warnings} if warnings else {}),
        **({provenance.CALIBRATE_AGAIN_KEY: True} if calibrate_again else {}),
        **({provenance.CHANGED_KEY: [printable_path(n) for n in since]} if since else {}),
        provenance.ASSUMED_KEY: {
            "r": PLATFORM_RADIUS * 1e3, "d": ROD_DISTANCE * 1e3, "tool_below": NOZZLE_DROP * 1e3,
        },
    }  # fmt: skip
    machine = replace(machine, provenance={provenance.FIRMWARE_NAME: table})
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


def _campaigns(
    config: Config, rows: Mapping[str, Sequence[Row]], machine: MachineFile
) -> Iterator[Readings]:
    """Yield the readings of every list that has some."""
    for name, campaign_rows in rows.items():
        if not campaign_rows:
            continue
        try:
            yield campaign_of_rows(name, campaign_rows, machine)
        except FileError as error:
            config.note("mesh", f"left out: {name}.csv: {error.reason}")


def _machine(config: Config, numbers: Numbers, rows: Sequence[Row]) -> MachineFile:
    """Return the nominal machine of the firmware's numbers, with all rows in its stroke."""
    arm = numbers.mean_arm
    ends = [end for row in rows for end in (row.travel, row.second) if end is not None]
    heights = np.concatenate([np.array(ends), _plate_rim_heights(config, numbers) - numbers.zero])
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
    tolerance = {
        name: _UNFITTED_RADIUS_SD if numbers.are_nominal else max(belts[name], spread)
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


def _plate_rim_heights(config: Config, numbers: Numbers) -> Array:
    """Return heights of the carriages ``(n, 3)`` around the plate, metres; over its middle if the
    radius is not given or not reached by the arms.
    """
    radius = config.number_or_zero("printer", "print_radius", -1, 5000) * 1e-3
    angle = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    rim = numbers.heights(radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    return numbers.heights(np.zeros((1, 3))) if np.isnan(rim).any() else rim


def _add_notes(
    config: Config, numbers: Numbers, campaigns: Sequence[Readings], relative: bool
) -> None:
    """Add notes on the numbers and the readings for the owner."""
    if warning := provenance.unequal_arms_warning(numbers):
        config.note("rods", warning)
    config.notes += note_few_touches(max(int(c.touching.sum()) for c in campaigns))
    if all(c.name == provenance.CALIBRATION for c in campaigns):
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
