"""What a firmware stored of its probe and its owner's calliper, as campaigns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array
from orthoglide.instruments import Probe
from orthoglide.klipper.calibration import Calibration
from orthoglide.klipper.config import Config
from orthoglide.klipper.entries import Section
from orthoglide.klipper.probe import lies, probe_offset
from orthoglide.klipper.rows import ROUND, campaign_of, row
from orthoglide.machine_file import Firmware
from orthoglide.notes import Note
from orthoglide.numerals import signed
from orthoglide.observations import ToolCampaign

_SHIFTED = 3e-5  # metres: less is not told
_MOST_TOUCHES = 1000  # of a mesh: a bed's shape is smooth, and a scan's neighbours read alike

CALIBRATION = "calibration"
"""Name of the campaign of heights and distances, which are stored as steps from the endstops: they
go with any numbers of the firmware, as meshes do not."""


def stored_campaigns(
    config: Config, firmware: Firmware, turned: Mapping[str, float], notes: list[Note]
) -> Iterator[ToolCampaign]:
    """Stored readings, as travel of the carriages from mechanical zero: heights with distances,
    then meshes; no two of one name, in capitals or not.

    Args:
        config: the file.
        firmware: its present numbers.
        turned: by profile of a mesh, how far the plate was turned on its seat, degrees.
        notes: to which what was noticed is added, in sentences.

    Raises:
        FileError: of what cannot be read; of a mesh where nothing else was stored.
        InputError: where a mesh that is said to be of a turned plate is not stored.
    """
    set_since, rows = False, list[dict[str, Any]]()
    if "delta_calibrate" in config.sections:
        calibration = Calibration(config, firmware, notes)
        if rows := calibration.rows():
            yield campaign_of(CALIBRATION, rows)
        set_since = calibration.set_since
    read, refused = _profiles(config, firmware, turned, notes)
    if refused and not (read or rows):
        raise next(iter(refused.values()))
    known: dict[tuple[float, bytes], str] = {}
    shifts = list[str]()
    for profile, mesh in read:
        if set_since:  # z = 0 is where its owner has set it, before the mesh or after it
            higher, *_ = lies(firmware.points(mesh.command + firmware.zero), mesh.reading)
            mesh = replace(mesh, reading=mesh.reading + higher)
            if abs(higher) > _SHIFTED:
                shifts.append(f"{profile!r} by {signed(-higher * 1e3, 2)} mm")
        turn = turned.get(profile, 0.0)
        other = known.setdefault((turn, mesh.command.tobytes()), profile)
        if other == profile:
            yield mesh
        else:
            notes.append(Note(
                f"the mesh {profile!r} is {other!r} to the last digit, saved under another "
                f"name: it is left out, for it would count twice", "mesh",
            ))  # fmt: skip
    why: dict[str, list[str]] = {}
    for profile, error in refused.items():
        said = error.reason.removeprefix(f"[bed_mesh {profile}] ")
        why.setdefault(said, []).append(f"{profile!r} (line {error.line})")
    notes += [Note(f"left out: mesh {', '.join(names)}: {said}", "mesh")
              for said, names in why.items()]  # fmt: skip
    if shifts:
        notes.append(Note(
            f"meshes are shifted to z = 0 in the middle: {', '.join(shifts)}. The endstops were "
            f"moved together since the heights were stored, and whether before the mesh or after "
            f"it is not known", "mesh",
        ))  # fmt: skip


def _profiles(
    config: Config, firmware: Firmware, turned: Mapping[str, float], notes: list[Note]
) -> tuple[list[tuple[str, ToolCampaign]], dict[str, FileError]]:
    """Meshes by their profiles' names, and what is wrong with those that cannot be read."""
    taken, found = set[str](), list[tuple[str, ToolCampaign]]()
    refused, have = dict[str, FileError](), list[str]()
    for section in config.named("bed_mesh"):
        profile = section.name.partition(" ")[2]
        if not (profile and "points" in section):
            continue
        have.append(profile)
        # As files and parameters may carry it.
        plain, number = re.sub(r"[^A-Za-z0-9_-]+", "-", profile).strip("-")[:60] or "mesh", 1
        while (name := plain if number == 1 else f"{plain}-{number}").lower() in taken:
            number += 1
        taken.add(name.lower())
        try:
            rows = list(touches(config, firmware, section, name, notes))
        except FileError as error:
            refused[profile] = error
            continue
        if rows:
            mesh = campaign_of(f"mesh-{name}", rows, turned.get(profile, 0.0))
            found.append((profile, mesh))
    if unknown := set(turned).difference(have):
        raise InputError(
            f"there is no mesh {min(unknown)!r} whose plate was turned: take one of "
            f"{', '.join(map(repr, have)) or 'none'}"
        )
    return found, refused


def touches(
    config: Config, firmware: Firmware, section: Section, name: str, notes: list[Note]
) -> Iterator[dict[str, Any]]:
    """Rows of a profile.

    Args:
        config: the file.
        firmware: its present numbers.
        section: the profile's own.
        name: of the setup.
        notes: to which what was noticed is added.

    Raises:
        FileError: where the profile is none, or lies beyond the arms.
    """
    if section.number("version", 0) != 1:
        section.fail(
            "version",
            "is missing or not 1, as in meshes of before December 2019, which the firmware leaves "
            "out as well: probe the mesh again, or remove the profile",
        )
    table = section.table("points")
    if not table:
        section.fail("points", "are empty: probe the mesh again")
    if not np.any([value for line in table for value in line]):
        notes.append(Note(
            f"the mesh {name!r} has nothing but zeros, as no probe reads: it is left out", "mesh",
        ))  # fmt: skip
        return
    columns = section.whole("x_count", len(table[0]))
    lines = section.whole("y_count", len(table))
    if len(table) != lines or any(len(line) != columns for line in table):
        section.fail("points", f"are not {lines} rows of {columns}: probe the mesh again")
    spans = []
    for axis, count in (("x", columns), ("y", lines)):
        low, high = section.number(f"min_{axis}"), section.number(f"max_{axis}")
        if not low < high:
            section.fail(f"max_{axis}", f"is not above min_{axis}: correct it")
        spans.append(np.linspace(low, high, count) * 1e-3)
    probe, offset = probe_offset(config)
    across, along = spans
    for k in np.flatnonzero(_probed(config, np.array(table), across, along, offset, notes)):
        j, i = divmod(int(k), columns)
        x, y = across[i], along[j]
        p = np.array([[x - offset[0], y - offset[1], probe + table[j][i] * 1e-3]])
        try:
            travel = firmware.heights(p)[0] - firmware.zero
        except InputError:
            away = float(np.hypot(x, y))
            section.fail(
                "points",
                f"reach {away * 1e3:.0f} mm out, beyond the arms: probe the mesh again, or remove "
                f"the profile",
            )
        label = f"{x * 1e3:.6g} {y * 1e3:.6g}"
        touch = row(Probe.kind, name, label, np.round(travel, ROUND), probe)
        yield {**touch, "beside": offset}


def _probed(
    config: Config, table: Array, x: Array, y: Array, offset: Array, notes: list[Note]
) -> NDArray[np.bool_]:
    """Which values ``(rows * columns,)`` the probe touched: no padding, no faulty regions."""
    general = config.optional("bed_mesh")
    place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    radius = general.number("mesh_radius", 0.0, -1, 5000) * 1e-3
    if "mesh_radius" in general and not radius > 0:
        general.fail("mesh_radius", "must be above 0: correct it")
    kept = np.ones(len(place), dtype=bool)
    stride = int(np.ceil(np.sqrt(len(place) / _MOST_TOUCHES)))
    if stride > 1:
        kept &= _thinned(len(y), stride)[:, None].repeat(len(x), 1).reshape(-1)
        kept &= np.tile(_thinned(len(x), stride), len(y))
        notes.append(Note(
            f"a mesh of {len(y)} by {len(x)} is finer than any cause needs: of its rows and "
            f"columns one in {stride} is taken", "mesh",
        ))  # fmt: skip
    if radius:  # about the profile's own middle: mesh_origin may have been another one then
        middle = (place.min(axis=0) + place.max(axis=0)) / 2
        kept &= np.hypot(*(place - middle).T) <= radius * (1 + 1e-9) + 1e-5
    if min(table.shape) > 2 and (table[[0, 0, -1, -1], [0, -1, 0, -1]]
                                 == table[[0, 0, -1, -1], [1, -2, 1, -2]]).all():  # fmt: skip
        # Round, whatever [bed_mesh] says: beyond the circle the firmware repeats what is next.
        apart = (place - place.mean(axis=0)) / [np.ptp(x) / 2, np.ptp(y) / 2]
        kept &= np.hypot(*apart.T) <= 1 + 1e-6
    for k in range(1, 100):  # where the probe cannot work the firmware takes its neighbours
        low, high = f"faulty_region_{k}_min", f"faulty_region_{k}_max"
        if low not in general:
            break
        ends = np.array([general.numbers(low, 2), general.numbers(high, 2)]) * 1e-3
        for at in (place, place - offset):
            kept &= ~((at >= ends[0]) & (at <= ends[1])).all(axis=1)
    return kept


def _thinned(count: int, stride: int) -> NDArray[np.bool_]:
    """Every so-many-th of ``count``, the middle among them ``(count,)``."""
    return np.asarray((np.arange(count) - count // 2) % stride == 0)
