"""Meshes of the plate that are stored in profiles (klippy/extras/bed_mesh.py)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain, count

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.firmware.imported import Row, plain_name
from orthoglide.firmware.klipper.config import Config, ConfigSection
from orthoglide.firmware.klipper.heights import probe_offset
from orthoglide.firmware.klipper.numbers import Numbers
from orthoglide.geometry import Array, fit_plane
from orthoglide.instruments import PlateTouch, Setup
from orthoglide.numerals import signed

_MAX_TOUCHES = 1000  # of a mesh: a bed is smooth, and neighbours of a scan read nearly the same


def stored_meshes(
    config: Config, numbers: Numbers, turned: Mapping[str, float], moved: bool
) -> dict[str, list[Row]]:
    """Return the touches of every mesh by the name of its campaign.

    Args:
        config: the file.
        numbers: present numbers of the firmware, with which meshes are taken as probed.
        turned: rotation of the plate on its seat by profile of a mesh, degrees.
        moved: whether z = 0 was moved before or after a mesh: meshes are shifted to it.

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
        name = _unique_name(profile, rows_by_campaign)
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


def _unique_name(profile: str, taken: Mapping[str, object]) -> str:
    """Return a profile's name as files and parameters may carry it, which differs from the names
    taken by more than capitals.
    """
    plain, lower_case = plain_name(profile, "mesh"), {name.lower() for name in taken}
    names = chain((plain,), (f"{plain}-{number}" for number in count(2)))
    return next(name for name in names if f"mesh-{name}".lower() not in lower_case)


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
