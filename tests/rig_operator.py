"""Somebody at the independent machine: does what the lines of ``orthoglide measure`` say."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tests.rig import LEGS, Array, Rig

_GO = re.compile(r"go (?:past|to) +x (\S+)  y (\S+)  z (\S+)")
_DIAL = (
    ("leg", re.compile(r"On leg ([xyz]), against")),
    ("bar", re.compile(r"against bar ([12]),")),
    ("gauge", re.compile(r"([\d.]+) mm from the leg's joints at the platform")),
    ("direction", re.compile(r"It reads along ([xyz]):")),
)
_SHOWS = re.compile(r"(\S+) shows: *$")


@dataclass
class Operator:
    """Moves the machine, mounts dials, reads them.

    Attributes:
        rig: the machine.
        rng: of noise, datums and placement.
        noise: standard deviation of one reading, metres.
        resolution: of the dial, metres.
        placement: standard deviation of a dial's place, metres.
        rho_of: joint coordinates ``(3,)`` of what the controller shows ``(3,)``, metres.
        command: where the machine stands ``(3,)``, metres.
        approach: last move of each axis ``(3,)``.
        mountings: how often a dial was mounted.
    """

    rig: Rig
    rng: np.random.Generator
    noise: float = 5e-6
    resolution: float = 1e-5
    placement: float = 1e-3
    rho_of: Callable[[Array], Array] = lambda shown: shown
    command: Array = field(default_factory=lambda: np.full(3, np.nan))
    approach: Array = field(default_factory=lambda: np.ones(3))
    mountings: int = 0
    _dials: dict[str, dict[str, str]] = field(default_factory=dict)
    _mounted: dict[str, tuple[float, float]] = field(default_factory=dict)
    _told: str = ""

    def hear(self, line: str) -> float | None:
        """Do what a line says; the reading in millimetres where one is asked for."""
        if go := _GO.match(line):
            self._go(self.rho_of(np.array([float(cell) for cell in go.groups()]) * 1e-3))
        elif line.startswith("Mount"):
            self.mountings += 1
        elif re.fullmatch(r"  \S+", line):
            self._told = line.strip()
            self._dials.setdefault(self._told, {})
        elif shows := _SHOWS.match(line):
            return self._read(shows[1])
        elif line.startswith("    "):
            for name, pattern in _DIAL:
                if found := pattern.search(line):
                    self._dials[self._told][name] = found[1]
        return None

    def _go(self, command: Array) -> None:
        step = command - self.command
        moved = np.abs(step) > 1e-6
        self.approach = np.where(moved, np.sign(step), self.approach)
        self.command = command

    def _read(self, name: str) -> float:
        dial = self._dials[name]
        if name not in self._mounted:
            self._mounted[name] = (
                self.rng.uniform(-1e-3, 1e-3),
                self.rng.normal(0, self.placement),
            )
        datum, off = self._mounted[name]
        pose = self.rig.pose(self.command[None], self.approach[None], np.zeros(1), np.zeros(1), 0.0)
        shown = self.rig.readings(
            pose.lines,
            [LEGS.index(dial["leg"])],
            [dial["direction"]],
            np.array([float(dial["gauge"]) * 1e-3 + off]),
            [int(dial.get("bar", 0))],
            [name],
            np.zeros(1),
        )[0]
        value = shown + datum + self.rng.normal(0, self.noise)
        return round(round(value / self.resolution) * self.resolution * 1e3, 6)
