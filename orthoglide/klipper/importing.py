"""A ``printer.cfg`` as a machine file and campaigns."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orthoglide.effects import catalogue_of
from orthoglide.effects.printers import of_printers
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array, Geometry, plane_columns
from orthoglide.instruments import Distance, Probe
from orthoglide.klipper.agreeing import RELATIVE, Disagreement, disagreements, lying_apart
from orthoglide.klipper.calibration import CALLIPER
from orthoglide.klipper.config import Config, read_config, these
from orthoglide.klipper.numbers import ANGLES, firmware_of
from orthoglide.klipper.overrides import STALE, override_note
from orthoglide.klipper.probe import PROBE, lies, probe_section
from orthoglide.klipper.rods import rods_words
from orthoglide.klipper.stored import CALIBRATION, stored_campaigns
from orthoglide.klipper.told import kept
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import TOWERS, Firmware, Instrument, MachineFile, ParameterValue
from orthoglide.notes import Note
from orthoglide.observations import ToolCampaign
from orthoglide.text import shown

ASSUMED = "assumed_mm"
"""Key of a machine file's provenance: what the firmware does not store, millimetres."""

PLATFORM, WIDTH, DROP = 0.032, 0.050, 0.040
"""What the firmware does not store, metres: radius of the platform, distance of an arm's two rods,
nozzle below the platform's joints. Typical ones; effects that turn the platform depend on them."""


_OF_ONE_PLACE = ("zero_reference_position", "relative_reference_index")
_DRAWN = 3e-3  # metres: standard deviation of a radius that no calibration has fitted
_ROUGH = 5e-4  # metres: half of what a touch is off by at least that is none of the plate
_BESIDE = 5e-3  # metres: at a tilt of 5 mrad a probe there is lifted by no more than it repeats

FEW = 30
"""Touches: three endstops, six coordinates of towers, three arms and a plane leave half of them."""


@dataclass(frozen=True)
class Imported:
    """What a printer stored.

    Attributes:
        machine: nominal, with the firmware's numbers kept in its provenance.
        campaigns: heights with distances, and each mesh.
        notes: what an owner should know, in sentences.
        apart: which of the campaigns are not of one plate and one set of numbers.
    """

    machine: MachineFile
    campaigns: tuple[ToolCampaign, ...]
    notes: tuple[Note, ...]
    apart: tuple[Disagreement, ...]

    @property
    def together(self) -> tuple[str, ...]:
        """Names of the campaigns that go with one another; none where that is not known.

        Stored heights are steps, and so of whatever numbers; a mesh that is apart from them is not.
        """
        return tuple(c.name for c in _together(self.campaigns, self.apart))

    @property
    def rough(self) -> tuple[ToolCampaign, ...]:
        """Campaigns with a touch that is so far off the plane of all that it may be none."""
        firmware = self.machine.printer
        return tuple(c for c in self.campaigns if firmware and _off_plane(firmware, c) > _ROUGH)


def _off_plane(firmware: Firmware, campaign: ToolCampaign) -> float:
    """How far a touch is off the plane of all at most, metres."""
    rows = campaign.touching
    p, height = firmware.points(campaign.command[rows] + firmware.zero), campaign.reading[rows]
    off = p[:, 2] - height - plane_columns(p) @ lies(p, height)
    return float(np.abs(off).max(initial=0.0))


def _together(
    stored: Iterable[ToolCampaign], apart: Collection[Disagreement]
) -> list[ToolCampaign]:
    out = {one.name for one in apart}
    known = all(one.other == CALIBRATION for one in apart)
    return [c for c in stored if known and c.name not in out]


def import_printer(
    path: str | os.PathLike[str], turned: Mapping[str, float] | None = None
) -> Imported:
    """Read what a printer stores.

    Args:
        path: its ``printer.cfg``, or the folder that it is in.
        turned: by profile of a mesh, how far the plate was turned on its seat, counter-clockwise
            from above, degrees.

    Raises:
        FileError: naming the line and what would be right.
        InputError: where a mesh that is said to be of a turned plate is not stored.
    """
    config = read_config(path)
    kinematics = config.section("printer").entries.get("kinematics")
    if kinematics is not None and kinematics.text.lower() != "delta":
        turning = ", arms that turn about shoulders" * kinematics.text.startswith("rotary")
        config.section("printer").fail(
            "kinematics",
            f"is {kinematics.text[:40]!r}{turning}, not 'delta': only printers whose carriages run "
            f"on three towers are imported, and calibrated",
        )
    noticed, override = list[Note](), override_note(config)
    try:
        firmware = firmware_of(config)
        stored = list(stored_campaigns(config, firmware, turned or {}, noticed))
    except FileError:
        if override is not None and override.kind == STALE:
            told = override.removeprefix(f"{Path(config.file).name} ")
            raise FileError(told, file=config.file) from None
        raise
    if not stored:
        raise FileError(
            "holds no readings: run DELTA_CALIBRATE or BED_MESH_CALIBRATE and SAVE_CONFIG, and "
            "take the file that the firmware saved",
            file=shown(path),
        )
    relative = _is_relative(config)
    apart = tuple(disagreements(firmware, stored, relative=relative))
    notes = (
        *([override] if override is not None else ()),
        *_notes(config, firmware, stored),
        *(one.note for one in apart),
        *lying_apart(firmware, _together(stored, apart), relative=relative),
        *noticed,
    )
    return Imported(_machine(config, firmware, stored, notes), tuple(stored), notes, apart)


def _machine(
    config: Config, firmware: Firmware, stored: list[ToolCampaign], notes: Iterable[Note]
) -> MachineFile:
    arm, zero = firmware.mean_arm, firmware.zero
    every = np.concatenate([*(np.concatenate([c.command, c.second]) for c in stored),
                            _around(config, firmware) - zero])  # fmt: skip
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    low = min(np.floor((low - 1e-3) * 1e3) * 1e-3, -1e-3)
    high = max(np.ceil((max(high, (firmware.at_endstop - zero).max())) * 1e3) * 1e-3, 1e-3)
    radius = round(firmware.delta_radius + PLATFORM, 9)
    stroke = (round(float(low), 6), round(float(high), 6))
    layout = LinearDelta((radius,) * 3, firmware.angle, (0.0, 0.0, -DROP))
    try:
        geometry = Geometry(arm, WIDTH, PLATFORM, stroke, layout)
    except InputError as error:
        config.section(f"stepper_{TOWERS[0]}").fail(
            "position_endstop",
            f"does not go with the stored positions ({error}): give it in millimetres, or probe "
            f"again",
        )
    catalogue = catalogue_of(LinearDelta.names)
    length = next(e.name for e in catalogue.effects if e.controller == "bar_length")
    # Nobody has fitted what was taken from a drawing: the radius.
    drawn = catalogue.held_as("place") if _as_told(firmware) else ()
    lengths = {
        f"{length}.{name}": ParameterValue(round(own - arm, 9), 0.0, "mm")
        for name, own in zip(TOWERS, firmware.arm, strict=True)
        if abs(own - arm) > 1e-9
    }
    return MachineFile(
        name=Path(config.file).stem,
        geometry=geometry,
        instruments={
            Probe.kind: Instrument(repeatability=PROBE),
            Distance.kind: Instrument(repeatability=CALLIPER),
        },
        tolerance=of_printers(catalogue) | dict.fromkeys(drawn, _DRAWN),
        parameters=lengths,
        provenance={
            "klipper": {
                "file": Path(config.file).name,
                "sha256": config.sha256,
                "numbers": firmware.mark,
                **firmware.as_dict(),
                RELATIVE: _is_relative(config),
                **kept(notes),
                ASSUMED: {"r": PLATFORM * 1e3, "d": WIDTH * 1e3, "tool_below": DROP * 1e3},
            }
        },
    )


def _as_told(firmware: Firmware) -> bool:
    """Whether the numbers are round ones that no calibration has touched."""
    return firmware.angle == ANGLES and len(set(firmware.endstop)) == 1


def _around(config: Config, firmware: Firmware) -> Array:
    """Heights of the carriages ``(n, 3)`` around the plate, if the firmware says how far it is."""
    radius = config.section("printer").number("print_radius", 0.0, -1, 5000) * 1e-3
    angle = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    ring = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    try:
        return firmware.heights(ring)
    except InputError:  # it goes as far as its arms
        return firmware.heights(np.zeros((1, 3)))


def _is_relative(config: Config) -> bool:
    """Whether the firmware takes the height at one place out of every mesh."""
    bed = config.optional("bed_mesh")
    return any(key in bed for key in _OF_ONE_PLACE)


def _notes(config: Config, firmware: Firmware, stored: list[ToolCampaign]) -> Iterator[Note]:
    if told := rods_words(firmware):
        yield Note(told, "rods")
    if _as_told(firmware):
        yield Note(
            "the towers stand at 210, 330 and 90 degrees and all endstops alike, as before a first "
            "calibration: run DELTA_CALIBRATE and probe again, for a radius that is off by "
            "millimetres looks like a bowl",
            "numbers",
        )
    most = max(int(c.touching.sum()) for c in stored)
    if most < FEW:
        yield Note(
            f"{most} touches of the plate leave hardly anything to look for a cause with: probe a "
            f"mesh of 9 by 9 or more over a round bed's full radius",
            "mesh",
        )
    meshes = any(c.name.startswith("mesh") for c in stored)
    if meshes and config.missing and probe_section(config) is None:
        yield Note(
            f"{these(config.missing)} is not where it is included from: if the probe is described "
            f"there, put it there; here the probe is taken to touch where the nozzle is",
            "probe",
        )
    beside = max(float(np.linalg.norm(c.beside, axis=1).max()) for c in stored)
    if beside > _BESIDE:
        yield Note(
            f"the probe touches {beside * 1e3:.0f} mm beside the nozzle, where a platform that "
            f"tilts lifts it: its tilt and the plate's shape are told apart badly, and heights "
            f"are known no better than that; z_offset is taken as set in the middle of the plate",
            "probe",
        )
    if meshes and _is_relative(config):
        yield Note(
            "[bed_mesh] takes the height at one place out of every mesh (zero_reference_position): "
            "how high the nozzle stands there is not known, and stays as it is; set it by hand "
            "once new numbers are entered, or remove the key and probe again",
            "relative",
        )
    if meshes:
        yield Note(
            "a mesh is taken as probed with the numbers that are stored now; if they were changed "
            "since, probe it again",
            "mesh",
        )
