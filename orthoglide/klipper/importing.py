"""A ``printer.cfg`` as a machine file and campaigns."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.effects import catalogue_of
from orthoglide.effects.printers import of_printers
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.klipper.config import Config, Section, read_config
from orthoglide.klipper.firmware import TOWERS, Firmware, rods_words
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import Instrument, MachineFile, ParameterValue
from orthoglide.notes import Note
from orthoglide.observations import ToolCampaign, ToolSetup
from orthoglide.text import shown

PLATFORM, WIDTH, DROP = 0.032, 0.050, 0.040
"""What the firmware does not store, metres: radius of the platform, distance of an arm's two rods,
nozzle below the platform's joints. Typical ones; effects that turn the platform depend on them."""

PROBE, CALLIPER, RIM = 1.8e-5, 5e-5, 1e-4
"""Repeatability of a touch of the probe and of a calliper's distance, metres; around the rim only
one of two pillars' widths is taken off, and pillars differ by a tenth of a millimetre."""

_FULL_STEPS = 200
_FAR = 3e-3  # metres by which a stored height may miss the height that the stored numbers give
_ROUND = 12


@dataclass(frozen=True)
class Imported:
    """What a printer stored.

    Attributes:
        machine: nominal, with the firmware's numbers kept in its provenance.
        campaigns: heights with distances, and each mesh.
        notes: what an owner should know, in sentences.
    """

    machine: MachineFile
    campaigns: tuple[ToolCampaign, ...]
    notes: tuple[Note, ...]


def import_printer(path: str | os.PathLike[str]) -> Imported:
    """Read what a printer stores.

    Args:
        path: its ``printer.cfg``.

    Raises:
        FileError: naming the line and what would be right.
    """
    config = read_config(path)
    kinematics = config.section("printer").entries.get("kinematics")
    if kinematics is not None and kinematics.text != "delta":
        config.section("printer").fail("kinematics", f"is {kinematics.text!r}, not 'delta'")
    firmware = _firmware(config)
    arm = round(float(np.mean(firmware.arm)), 6)
    read = _Reader(config, firmware, arm)
    stored = list(read.all())
    if not stored:
        raise FileError(
            "holds no readings: run DELTA_CALIBRATE or BED_MESH_CALIBRATE and SAVE_CONFIG, and "
            "take the file that the firmware saved",
            file=shown(path),
        )
    machine = _machine(config, firmware, arm, stored)
    return Imported(machine, tuple(stored), tuple(_notes(firmware, stored)))


def _firmware(config: Config) -> Firmware:
    printer = config.section("printer")
    radius = printer.number("delta_radius", low=10, high=5000) * 1e-3
    towers = [config.section(f"stepper_{name}") for name in TOWERS]
    first = towers[0]
    arm_a = first.number("arm_length", low=10, high=5000)
    endstop_a = first.number("position_endstop", low=1, high=10000)
    arms, ends, angles = [], [], []
    for tower, angle in zip(towers, (210.0, 330.0, 90.0), strict=True):
        arms.append(tower.number("arm_length", arm_a, 10, 5000) * 1e-3)
        ends.append(tower.number("position_endstop", endstop_a, 1, 10000) * 1e-3)
        angles.append(tower.number("angle", angle, -720, 720))
        if arms[-1] <= 1.02 * radius:
            tower.fail(
                "arm_length",
                f"is {arms[-1] * 1e3:g}, not longer than delta_radius "
                f"({radius * 1e3:g}): are they exchanged?",
            )
    (a, b, c), (d, e, f), (g, h, i) = arms, ends, angles
    return Firmware(radius, (g, h, i), (a, b, c), (d, e, f))


class _Reader:
    """Stored readings, as travel of the carriages from mechanical zero."""

    def __init__(self, config: Config, firmware: Firmware, arm: float) -> None:
        self.config, self.firmware = config, firmware
        self.zero = float(np.sqrt(arm**2 - firmware.delta_radius**2))
        self._step: Array | None = None

    @property
    def step(self) -> Array:
        """Travel of one step ``(3,)``, metres."""
        if self._step is None:
            self._step = np.array([_step(self.config, name) for name in TOWERS])
        return self._step

    def all(self) -> Iterator[ToolCampaign]:
        """Heights with distances, then meshes."""
        if "delta_calibrate" in self.config.sections:
            rows = [*self._heights(), *self._distances()]
            if rows:
                yield _campaign("calibration", rows)
        for name, section in self.config.sections.items():
            kind, _, profile = name.partition(" ")
            if kind == "bed_mesh" and profile and "points" in section:
                name = _plain(profile)
                yield _campaign(f"mesh-{name}", list(self._mesh(section, name)))

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
        section = self.config.section("delta_calibrate")
        for word, setup in (("height", "heights"), ("manual_height", "manual-heights")):
            k = 0
            while f"{word}{k}" in section:
                height = section.number(f"{word}{k}", low=-100, high=100) * 1e-3
                key = f"{word}{k}_pos"
                travel = self._travel(section, key)
                p = self._believed(section, key, travel)
                if abs(p[2] - height) > _FAR or np.hypot(*p[:2]) > self.firmware.delta_radius:
                    section.fail(
                        key,
                        f"puts the nozzle at ({p[0] * 1e3:.1f}, {p[1] * 1e3:.1f}, "
                        f"{p[2] * 1e3:.1f}) mm by the stored numbers, where its height above the "
                        f"bed was {height * 1e3:g} mm: the positions, the steps or the numbers of "
                        f"[printer] and [stepper_*] are of different times or mistyped",
                    )
                label = f"{p[0] * 1e3:.0f} {p[1] * 1e3:.0f}"
                yield _row("plate", setup, label, travel, height)
                k += 1

    def _distances(self) -> Iterator[dict[str, Any]]:
        section, k = self.config.section("delta_calibrate"), 0
        while f"distance{k}" in section:
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
            row = _row("distance", "spokes" if spoke else "rim", f"{k}", ends[0], distance, ends[1])
            yield row if spoke else {**row, "sigma": RIM}
            k += 1

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
        general = self.config.optional("bed_mesh")
        radius = general.number("mesh_radius", 0.0, -1, 5000) * 1e-3
        middle = np.array(general.numbers("mesh_origin", 2) if "mesh_origin" in general else [0, 0])
        if "mesh_radius" in general and not radius > 0:
            general.fail("mesh_radius", "must be above 0: correct it")
        probe, offset = _probe(self.config)
        for j, y in enumerate(spans[1]):
            for i, x in enumerate(spans[0]):
                away = float(np.hypot(x - middle[0] * 1e-3, y - middle[1] * 1e-3))
                if radius and away > radius * (1 + 1e-9) + 1e-5:
                    continue  # beyond the circle the mesh is padded
                z = table[j][i] * 1e-3
                p = np.array([[x - offset[0], y - offset[1], probe + z]])
                try:
                    travel = self.firmware.heights(p)[0] - self.zero
                except InputError:
                    section.fail("points", f"reach {away * 1e3:.0f} mm out, beyond the arms")
                yield _row("plate", name, f"{x * 1e3:.6g} {y * 1e3:.6g}", np.round(travel, _ROUND),
                           probe)  # fmt: skip


def _probe(config: Config) -> tuple[float, Array]:
    """The probe's offset above the nozzle and beside it, metres."""
    for name in ("probe", "bltouch", "smart_effector", "load_cell_probe"):
        if name in config.sections:
            section = config.sections[name]
            beside = [section.number(f"{axis}_offset", 0.0, -200, 200) for axis in "xy"]
            return section.number("z_offset", 0.0, -100, 100) * 1e-3, np.array(beside) * 1e-3
    return 0.0, np.zeros(2)


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


def _campaign(name: str, rows: list[dict[str, Any]]) -> ToolCampaign:
    setups: dict[str, ToolSetup] = {}
    for row in rows:
        setups.setdefault(row["setup"], ToolSetup(row["setup"], row["kind"]))
    place, n = {name: k for k, name in enumerate(setups)}, len(rows)
    plates = np.array([row["kind"] == "plate" for row in rows])
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


def _machine(
    config: Config, firmware: Firmware, arm: float, stored: list[ToolCampaign]
) -> MachineFile:
    zero = float(np.sqrt(arm**2 - firmware.delta_radius**2))
    every = np.concatenate([np.concatenate([c.command, c.second]) for c in stored])
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    low = min(np.floor((low - 1e-3) * 1e3) * 1e-3, -1e-3)
    high = max(np.ceil((max(high, (firmware.at_endstop - zero).max())) * 1e3) * 1e-3, 1e-3)
    radius = round(firmware.delta_radius + PLATFORM, 9)
    geometry = Geometry(
        arm,
        WIDTH,
        PLATFORM,
        (round(float(low), 6), round(float(high), 6)),
        LinearDelta((radius,) * 3, firmware.angle, (0.0, 0.0, -DROP)),
    )
    catalogue = catalogue_of(LinearDelta.names)
    length = next(e.name for e in catalogue.effects if e.controller == "bar_length")
    lengths = {
        f"{length}.{name}": ParameterValue(round(own - arm, 9), 0.0, "mm")
        for name, own in zip(TOWERS, firmware.arm, strict=True)
        if abs(own - arm) > 1e-9
    }
    return MachineFile(
        name=Path(config.file).stem,
        geometry=geometry,
        instruments={
            "plate": Instrument(repeatability=PROBE),
            "distance": Instrument(repeatability=CALLIPER),
        },
        tolerance=of_printers(catalogue),
        parameters=lengths,
        provenance={
            "klipper": {
                "file": Path(config.file).name,
                "sha256": config.sha256,
                **firmware.as_dict(),
                "assumed_mm": {"r": PLATFORM * 1e3, "d": WIDTH * 1e3, "tool_below": DROP * 1e3},
            }
        },
    )


def _notes(firmware: Firmware, stored: list[ToolCampaign]) -> Iterator[Note]:
    if told := rods_words(firmware):
        yield Note(told, "rods")
    names = {s.kind for c in stored for s in c.setups}
    if "plate" in names and not any(c.name.startswith("mesh") for c in stored):
        yield Note(
            "there is no mesh: seven heights leave hardly anything to look for a cause with; probe "
            "one of 9 by 9 or more with a round bed's full radius",
            "mesh",
        )
    if any(c.name.startswith("mesh") for c in stored):
        yield Note(
            "a mesh is taken as probed with the numbers that are stored now; if they were changed "
            "since, probe it again",
            "mesh",
        )
