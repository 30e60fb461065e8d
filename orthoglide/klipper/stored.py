"""What a firmware stored of its probe and its owner's calliper, as readings of the tool."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.instruments import Distance, Probe
from orthoglide.klipper.config import Config
from orthoglide.klipper.entries import Section
from orthoglide.machine_file import TOWERS, Firmware
from orthoglide.notes import Note
from orthoglide.observations import ToolCampaign, ToolSetup

CALIBRATION = "calibration"
"""Name of the campaign of heights and distances, which are stored as steps from the endstops: they
go with any numbers of the firmware, as meshes do not."""

PROBE, CALLIPER, RIM = 1.8e-5, 5e-5, 1e-4
"""Repeatability of a touch of the probe and of a calliper's distance, metres; around the rim only
one of two pillars' widths is taken off, and pillars differ by a tenth of a millimetre."""

_FULL_STEPS = 200
_FAR = 3e-3  # metres by which a stored place may miss the one that the stored numbers give
_SAME = 2e-5  # metres: a height that is stored with another offset of the probe differs by more
_PROBES = (
    "probe", "bltouch", "smart_effector", "load_cell_probe", "probe_eddy_current", "beacon",
    "cartographer", "scanner", "dockable_probe",
)  # fmt: skip
_ROUND = 12
_MOST_TOUCHES = 1000  # of a mesh: a bed's shape is smooth, and a scan's neighbours read alike


class Stored:
    """Stored readings, as travel of the carriages from mechanical zero.

    Args:
        turned: by profile of a mesh, how far the plate was turned on its seat, degrees.

    Attributes:
        notes: what was noticed while reading, in sentences.
    """

    def __init__(
        self, config: Config, firmware: Firmware, turned: Mapping[str, float] | None = None
    ) -> None:
        self.config, self.firmware, self.zero = config, firmware, firmware.zero
        self.turned = dict(turned or {})
        self.notes: list[Note] = []

    @cached_property
    def step(self) -> Array:
        """Travel of one step ``(3,)``, metres."""
        return np.array([_step(self.config, name) for name in TOWERS])

    def campaigns(self) -> Iterator[ToolCampaign]:
        """Heights with distances, then meshes; no two of one name, in capitals or not."""
        if "delta_calibrate" in self.config.sections:
            rows = [*self._heights(), *self._distances()]
            if rows:
                yield _campaign(CALIBRATION, rows)
        taken, unknown = set[str](), set(self.turned)
        for section in self.config.named("bed_mesh"):
            profile = section.name.partition(" ")[2]
            if not (profile and "points" in section):
                continue
            plain, number = _plain(profile), 1
            while (name := plain if number == 1 else f"{plain}-{number}").lower() in taken:
                number += 1
            taken.add(name.lower())
            if rows := list(self._mesh(section, name)):
                yield _campaign(f"mesh-{name}", rows, self.turned.get(profile, 0.0))
                unknown.discard(profile)
        if unknown:
            meshes = (s.name.partition(" ")[2] for s in self.config.named("bed_mesh"))
            have = ", ".join(repr(name) for name in meshes if name)
            raise InputError(
                f"there is no mesh {min(unknown)!r} whose plate was turned: take one of "
                f"{have or 'none'}"
            )

    def _travel(self, section: Section, key: str) -> Array:
        steps = np.array(section.numbers(key, 3))
        return np.round(self.firmware.at_endstop - steps * self.step - self.zero, _ROUND)

    def _believed(self, section: Section, key: str, travel: Array) -> Array:
        """Where the firmware's numbers put the nozzle; refused where that is out of all reach."""
        try:
            p = self.firmware.points((travel + self.zero)[None])[0]
        except InputError:
            section.fail(key, "is a place that the arms do not reach: correct the steps")
        return p

    def _heights(self) -> Iterator[dict[str, Any]]:
        section, (offset, beside) = self.config.section("delta_calibrate"), _probe(self.config)
        for word, setup in (("height", "heights"), ("manual_height", "manual-heights")):
            found: list[tuple[float, Array, Array]] = []
            numbers = _numbers(section, word)
            for key in (f"{word}{k}" for k in numbers):
                height = section.number(key, low=-100, high=100) * 1e-3
                travel = self._travel(section, f"{key}_pos")
                found.append((height, travel, self._believed(section, f"{key}_pos", travel)))
            # A delta reads alike at every height: endstops of another time shift all of them.
            off = float(np.median([p[2] - height for height, _, p in found])) if found else 0.0
            if abs(off) > _FAR:
                self.notes.append(Note(
                    f"the {word}s of [delta_calibrate] lie {off * 1e3:+.1f} mm off by the endstops "
                    f"that are stored now: they are taken as of the same machine with endstops "
                    f"changed since; if anything else was changed, run DELTA_CALIBRATE again",
                    "heights",
                ))  # fmt: skip
            stored = float(np.median([height for height, _, _ in found])) if found else offset
            if word == "height" and offset and abs(stored - offset) > _SAME:
                self.notes.append(Note(
                    f"the heights of [delta_calibrate] were stored with a z_offset of "
                    f"{stored * 1e3:g} mm, and it is {offset * 1e3:g} mm now: new endstops go by "
                    f"the heights as they were stored, and the nozzle may end "
                    f"{abs(stored - offset) * 1e3:.2g} mm too high or too low; run DELTA_CALIBRATE "
                    f"again",
                    "heights",
                ))  # fmt: skip
            for k, (height, travel, p) in zip(numbers, found, strict=True):
                if abs(p[2] - height - off) > _FAR or np.hypot(*p[:2]) > self.firmware.delta_radius:
                    section.fail(
                        f"{word}{k}_pos",
                        f"puts the nozzle at ({p[0] * 1e3:.1f}, {p[1] * 1e3:.1f}, "
                        f"{p[2] * 1e3:.1f}) mm by the stored numbers, where its height above the "
                        f"bed was {height * 1e3:g} mm: the positions, the steps or the numbers of "
                        f"[printer] and [stepper_*] are of different times or mistyped",
                    )
                label = f"{p[0] * 1e3:.0f} {p[1] * 1e3:.0f}"
                touched = beside if word == "height" else np.zeros(2)  # by hand: the nozzle itself
                yield {**_row(Probe.kind, setup, label, travel, height), "beside": touched}

    def _distances(self) -> Iterator[dict[str, Any]]:
        section = self.config.section("delta_calibrate")
        for k in _numbers(section, "distance"):
            distance = section.number(f"distance{k}", low=1, high=1000) * 1e-3
            ends, believed = [], []
            for end in ("pos1", "pos2"):
                ends.append(self._travel(section, f"distance{k}_{end}"))
                believed.append(self._believed(section, f"distance{k}_{end}", ends[-1]))
            apart = float(np.linalg.norm(believed[1] - believed[0]))
            if abs(apart - distance) > max(_FAR, 0.1 * distance):
                section.fail(
                    f"distance{k}",
                    f"is {distance * 1e3:g} mm between places that are {apart * 1e3:.1f} mm apart "
                    f"by the stored numbers: is it in another place of DELTA_ANALYZE's list?",
                )
            # The firmware's part has six spokes and six rim sides, each with pillars of its own.
            spoke = k % 12 < 6
            row = _row(
                Distance.kind, "spokes" if spoke else "rim", f"{k}", ends[0], distance, ends[1]
            )
            yield row if spoke else {**row, "sigma": RIM}

    def _mesh(self, section: Section, name: str) -> Iterator[dict[str, Any]]:
        table = section.table("points")
        if not table:
            section.fail("points", "are empty: probe the mesh again")
        columns = section.whole("x_count", len(table[0]))
        lines = section.whole("y_count", len(table))
        if len(table) != lines or any(len(row) != columns for row in table):
            section.fail("points", f"are not {lines} rows of {columns}: probe the mesh again")
        spans = []
        for axis, count in (("x", columns), ("y", lines)):
            low, high = section.number(f"min_{axis}"), section.number(f"max_{axis}")
            if not low < high:
                section.fail(f"max_{axis}", f"is not above min_{axis}: correct it")
            spans.append(np.linspace(low, high, count) * 1e-3)
        probe, offset = _probe(self.config)
        across, along = spans
        for k in np.flatnonzero(self._probed(np.array(table), across, along, offset)):
            j, i = divmod(int(k), columns)
            x, y = across[i], along[j]
            p = np.array([[x - offset[0], y - offset[1], probe + table[j][i] * 1e-3]])
            try:
                travel = self.firmware.heights(p)[0] - self.zero
            except InputError:
                away = float(np.hypot(x, y))
                section.fail("points", f"reach {away * 1e3:.0f} mm out, beyond the arms")
            row = _row(
                Probe.kind, name, f"{x * 1e3:.6g} {y * 1e3:.6g}", np.round(travel, _ROUND), probe
            )
            yield {**row, "beside": offset}

    def _probed(self, table: Array, x: Array, y: Array, offset: Array) -> NDArray[np.bool_]:
        """Which values ``(rows * columns,)`` the probe touched: no padding, no faulty regions."""
        general = self.config.optional("bed_mesh")
        place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        radius = general.number("mesh_radius", 0.0, -1, 5000) * 1e-3
        middle = np.array(general.numbers("mesh_origin", 2) if "mesh_origin" in general else [0, 0])
        if "mesh_radius" in general and not radius > 0:
            general.fail("mesh_radius", "must be above 0: correct it")
        kept = np.ones(len(place), dtype=bool)
        stride = int(np.ceil(np.sqrt(len(place) / _MOST_TOUCHES)))
        if stride > 1:
            kept &= _thinned(len(y), stride)[:, None].repeat(len(x), 1).reshape(-1)
            kept &= np.tile(_thinned(len(x), stride), len(y))
            self.notes.append(Note(
                f"a mesh of {len(y)} by {len(x)} is finer than any cause needs: of its rows and "
                f"columns one in {stride} is taken", "mesh",
            ))  # fmt: skip
        if radius:
            kept &= np.hypot(*(place - middle * 1e-3).T) <= radius * (1 + 1e-9) + 1e-5
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


def _numbers(section: Section, word: str) -> list[int]:
    """Numbers of the readings of which anything is stored, those behind a gap too."""
    own = re.compile(rf"{word}([0-9]{{1,4}})(?:_pos[12]?)?")
    return sorted({int(m[1]) for key in section.entries if (m := own.fullmatch(key))})


def _thinned(count: int, stride: int) -> NDArray[np.bool_]:
    """Every so-many-th of ``count``, the middle among them ``(count,)``."""
    return np.asarray((np.arange(count) - count // 2) % stride == 0)


def probe_section(config: Config) -> Section | None:
    """The section of the probe; ``None`` where there is none."""
    found = (s for s in config.named(*_PROBES) if s.name == "probe" or "z_offset" in s)
    return next(found, None)


def _probe(config: Config) -> tuple[float, Array]:
    """The probe's offset above the nozzle and beside it, metres."""
    if (section := probe_section(config)) is None:
        return 0.0, np.zeros(2)
    beside = [section.number(f"{axis}_offset", 0.0, -200, 200) for axis in "xy"]
    return section.number("z_offset", 0.0, -100, 100) * 1e-3, np.array(beside) * 1e-3


def _step(config: Config, tower: str) -> float:
    """Travel of one microstep of a tower, metres."""
    section = config.section(f"stepper_{tower}")
    if "rotation_distance" not in section and "step_distance" in section:  # of older firmware
        return section.number("step_distance", low=1e-5, high=10) * 1e-3
    around = section.number("rotation_distance", low=0.1, high=1000)
    count = section.whole("full_steps_per_rotation", _FULL_STEPS, 4, 1000)
    if count % 4:
        section.fail("full_steps_per_rotation", f"is {count}, not a multiple of 4: correct it")
    gear = 1.0
    if "gear_ratio" in section:
        for pair in section.entries["gear_ratio"].text.split(","):
            ends = re.fullmatch(r"\s*([0-9.]+)\s*:\s*([0-9.]+)\s*", pair)
            try:
                gear *= float(ends[1]) / float(ends[2]) if ends else 0.0
            except (ValueError, ZeroDivisionError):
                gear = 0.0
        if not 0 < gear < 1e3:
            section.fail("gear_ratio", "is no list of ratios such as 80:16: correct it")
    return around * 1e-3 / (count * section.whole("microsteps", None, 1, 1024) * gear)


def _plain(name: str) -> str:
    """A profile's name as files and parameters may carry it."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:60] or "mesh"


def _row(
    kind: str, setup: str, label: str, travel: Array, reading: float, second: Array | None = None
) -> dict[str, Any]:
    return {
        "kind": kind, "setup": setup, "label": label, "travel": travel, "reading": reading,
        "second": np.full(3, np.nan) if second is None else second,
    }  # fmt: skip


def _campaign(name: str, rows: list[dict[str, Any]], turned: float = 0.0) -> ToolCampaign:
    setups: dict[str, ToolSetup] = {}
    for row in rows:
        x, y = row.get("beside", (0.0, 0.0))
        own = ToolSetup(row["setup"], row["kind"], (float(x), float(y), 0.0), turned)
        setups.setdefault(own.name, own)
    place, n = {name: k for k, name in enumerate(setups)}, len(rows)
    plates = np.array([row["kind"] == Probe.kind for row in rows])
    return ToolCampaign(
        name=name,
        setups=tuple(setups.values()),
        setup=np.array([place[row["setup"]] for row in rows]),
        axis=np.zeros(n, dtype=np.int64),
        sign=np.ones(n),
        command=np.array([row["travel"] for row in rows]),
        second=np.array([row["second"] for row in rows]),
        approach=np.where(plates[:, None], -1.0, 0.0) * np.ones((1, 3)),  # a probe comes from above
        time=np.full(n, np.nan),
        temperature=np.full(n, np.nan),
        load=np.zeros(n),
        repeat=np.ones(n, dtype=np.int64),
        order=np.arange(1, n + 1),
        posture=tuple(row["label"] for row in rows),
        reading=np.round([row["reading"] for row in rows], _ROUND),
        sigma=np.array([row.get("sigma", np.nan) for row in rows]),
        line=np.arange(2, n + 2),
    )
