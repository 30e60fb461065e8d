"""``Request``: a command with its campaigns, machine and options, as typed values."""

from __future__ import annotations

import shlex
from base64 import b64encode
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from orthoglide.effects import CATALOGUE
from orthoglide.errors import check_integer
from orthoglide.files import sha256
from orthoglide.instruments import Frame
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile, machine_text
from orthoglide.machine_file.posterior import posterior_bytes
from orthoglide.observations import Readings, Setup, campaign_rows, csv_text
from orthoglide.text import MACHINE_OPTION
from orthoglide.urdf import urdf_digests

Command = Literal["identify", "close-loop", "diagnose", "demo"]
COMMANDS: tuple[Command, ...] = get_args(Command)
"""Whose results can be run again."""


@dataclass(frozen=True)
class Request:
    """All that influences the numbers of a run."""

    command: Command  # of the command line
    given: tuple[Readings, ...]  # all readings that are fitted: of legs, then of the tool
    machine: Machine  # machine before calibration
    own: tuple[str, ...] = ()  # effects or parameters that are specific to each campaign
    # standard deviation of one reading, metres; `None`: from files or repeats
    noise: float | None = None
    seed: int = 0  # seed of every random draw
    holdout: tuple[Readings, ...] = ()  # readings that judge the finished result
    tcp: Readings | None = None  # points that judge the finished result
    free: tuple[str, ...] = CATALOGUE.base  # effects or parameters that `identify` frees
    priors: bool = True  # whether tolerances act as priors in `identify`
    reduced: bool = False  # whether the analytic reduction identifies
    frame: Frame = "rigid"  # motion allowed between the instrument of `points` and the machine
    effects_file: str = ""  # name of the file with the user's own effects, if there is one

    def __post_init__(self) -> None:
        object.__setattr__(self, "given", (*self.campaigns, *self.points))
        if self.searches:  # otherwise nothing is drawn
            object.__setattr__(self, "seed", check_integer("seed", self.seed, 0))

    @property
    def searches(self) -> bool:
        """Whether causes are searched for; ``identify`` does not."""
        return self.command != "identify"

    @property
    def effects_option(self) -> str:
        """Option with the user's own effects for a command; empty without any."""
        return f" --effects-file {shlex.quote(self.effects_file)}" if self.effects_file else ""

    @property
    def machine_option(self) -> str:
        """Options with the machine and the user's own effects for a command; the file has no
        folder.
        """
        spec = self.machine.spec
        file = f" --machine {shlex.quote(Path(spec.file).name)}" if spec.file else MACHINE_OPTION
        return ("" if spec == MachineFile() else file) + self.effects_option

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments for ``result.json``, with names of files without their folders."""
        return {
            "campaigns": list(dict.fromkeys(name_of(c) for c in self.readings)),
            "fit_tcp": [name_of(p) for p in self.points if p.by_point],
            "holdout": next((name_of(readings) for readings in self.holdout), None),
            "tcp": None if self.tcp is None else name_of(self.tcp),
            "own": list(self.own),
            "machine": Path(self.machine.spec.file).name or None,
            "noise_mm": None if self.noise is None else round(self.noise * 1e3, 12),
            "effects_file": self.effects_file,
            "frame": self.frame,
            "free": list(self.free),
            "priors": self.priors,
            "reduced": self.reduced,
        }

    @property
    def readings(self) -> tuple[Readings, ...]:
        """Readings of all kinds except measured TCP points."""
        return (*self.campaigns, *(p for p in self.points if not p.by_point))

    @property
    def campaigns(self) -> tuple[Readings, ...]:
        """Readings of legs."""
        return tuple(readings for readings in self.given if not readings.of_tool)

    @property
    def points(self) -> tuple[Readings, ...]:
        """Readings of the tool: TCP points to be fitted, and files of other kinds."""
        return tuple(readings for readings in self.given if readings.of_tool)

    @property
    def setups(self) -> tuple[Setup, ...]:
        """Setups of all readings that are fitted."""
        return tuple(setup for given in self.given for setup in given.setups)

    @cached_property
    def inputs(self) -> list[dict[str, Any]]:
        """Files of readings for ``result.json``: name, digest, role and rows."""
        roles = [(r, "fit_tcp" if r.by_point else "campaign") for r in self.given]
        roles += [(r, "holdout") for r in self.holdout]
        roles += [] if self.tcp is None else [(self.tcp, "tcp")]
        return [_input(readings, role, self.machine.spec) for readings, role in roles]

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``result.json`` from which it can be run again."""
        spec = self.machine.spec
        return {
            "command": self.command,
            "arguments": self.arguments,
            "seed": self.seed,
            "inputs": self.inputs,
            "machine": {
                "file": Path(spec.file).name or None,
                "sha256": spec.sha256 or None,
                **stored_machine(spec),
                **({"urdf": urdf_digests(spec.urdf)} if spec.urdf else {}),
            },
        }


def stored_machine(spec: MachineFile) -> dict[str, str | None]:
    """Return a machine for ``result.json``: the text of its file, and its covariance."""
    covariance = None
    if spec.posterior is not None:
        covariance = b64encode(posterior_bytes(spec.posterior, spec.sha256)).decode()
    return {"toml": machine_text(spec), "npz": covariance}


def name_of(readings: Readings) -> str:
    """Return the name of the file of readings without its folder, or a name from the readings."""
    if readings.file:
        return Path(readings.file).name
    if readings.by_point:
        return "points.tcp.csv"
    plain = readings.name.replace("/", "_").replace("\0", "_")
    return f"{plain or 'readings'}.csv"


def _input(readings: Readings, role: str, machine: MachineFile) -> dict[str, Any]:
    """Return a file of readings for ``result.json``."""
    rows = campaign_rows(readings, machine if readings.of_tool else None)
    entry: dict[str, Any] = {
        "file": name_of(readings),
        "sha256": readings.sha256 or sha256(csv_text(rows).encode()),
    }
    if role != "campaign":
        entry["role"] = role
    if readings.name != Path(entry["file"]).stem and not readings.by_point:  # a part of its file
        entry["name"] = readings.name
    if readings.by_point:
        lines = readings.points().line.tolist()
    else:
        lines = sorted([*readings.line.tolist(), *readings.moves.line.tolist()])
    if lines != list(range(2, len(rows) + 2)):
        entry["lines"] = lines
    return entry | {"rows": rows}
