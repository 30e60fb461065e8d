"""``Request``: a command with its campaigns, machine and options, and its keys in ``result.json``.

What is read is checked, as the file may have been edited.
"""

from __future__ import annotations

import itertools
import json
import shlex
from base64 import b64decode, b64encode
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, get_args

from orthoglide.effects import CATALOGUE, Effect
from orthoglide.effects.catalogue import CUSTOM_EFFECTS_HINT
from orthoglide.errors import FileError, check_integer
from orthoglide.files import decode, read_bytes, sha256
from orthoglide.instruments import Frame
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile, machine_text, parse_machine_file
from orthoglide.machine_file.posterior import parse_posterior, posterior_bytes
from orthoglide.observations import Readings, Setup, campaign_rows, csv_text, split_legs_and_tool
from orthoglide.observations.reading import readings_from_rows
from orthoglide.result.codec import Key, decoded, decoded_fields, encoded
from orthoglide.text import MACHINE_OPTION, abbreviated, unprintable_problem
from orthoglide.urdf.parallel import urdf_digests

Command = Literal["identify", "close-loop", "diagnose", "demo"]
COMMANDS: tuple[Command, ...] = get_args(Command)
"""Commands whose results can be run again."""

SCHEMAS = (1, 2)
"""Schemas of results that can be run again."""

EDITED_FILE_ERRORS = (FileError, KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""Errors that the values of an edited ``result.json`` raise."""

_EFFECTS_REMEDY = (
    "give them too (--effects-file FILE.py; in Python Verdict.load(path, effects=[...]))"
)
_LAST_LINE = 1_000_000  # of a file: more rows than any campaign has
_LONGEST_NAME = 255  # bytes of a file name, as file systems allow
_NOT_AN_ARGUMENT = Key(in_file=False)


@dataclass(frozen=True)
class Request:
    """All that influences the numbers of a run; its options are ``arguments`` in the file."""

    command: Annotated[Command, _NOT_AN_ARGUMENT]  # of the command line
    # all readings that are fitted: of legs, then of the tool
    given: Annotated[tuple[Readings, ...], _NOT_AN_ARGUMENT]
    machine: Machine  # machine before calibration
    own: tuple[str, ...] = ()  # effects or parameters that are specific to each campaign
    # standard deviation of one reading, metres; `None`: from files, repeats or the usual figure
    noise: Annotated[float | None, Key(suffix="_mm", si=1e-3, places=12)] = None
    seed: Annotated[int, _NOT_AN_ARGUMENT] = 0  # seed of every random draw
    # readings that judge the finished result
    holdout: Annotated[tuple[Readings, ...], _NOT_AN_ARGUMENT] = ()
    # points that judge the finished result
    tcp: Annotated[Readings | None, _NOT_AN_ARGUMENT] = None
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
            "machine": Path(self.machine.spec.file).name or None,
            **encoded(self),
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
        return [_Input.of(readings, role, self.machine.spec).as_dict() for readings, role in roles]

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``result.json`` from which the command can be run again."""
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


@dataclass(frozen=True)
class _Input:
    """A file of readings."""

    file: str  # its name
    sha256: str
    rows: tuple[Mapping[str, str], ...]  # cells by column
    role: Literal["campaign", "fit_tcp", "holdout", "tcp"] = "campaign"
    name: str | None = None  # of the readings, if it is not that of the file
    lines: tuple[int, ...] = ()  # lines of the rows in the file, if they are not consecutive

    def __post_init__(self) -> None:
        _check_name(self.file)
        ordered = all(a < b for a, b in itertools.pairwise((1, *self.lines, _LAST_LINE)))
        complete = self.rows and all(self.rows) and len(self.lines) in (0, len(self.rows))
        if not (complete and ordered):
            raise ValueError(f"{self.file} has no rows, or line numbers that do not match them")

    @classmethod
    def of(cls, readings: Readings, role: Any, machine: MachineFile) -> _Input:
        """Return the file of readings."""
        rows = tuple(campaign_rows(readings, machine if readings.of_tool else None))
        file = name_of(readings)
        is_part = readings.name != Path(file).stem and not readings.by_point
        if readings.by_point:
            lines = readings.points().line.tolist()
        else:
            lines = sorted([*readings.line.tolist(), *readings.moves.line.tolist()])
        digest = readings.sha256 or sha256(csv_text(rows).encode())
        consecutive = lines == list(range(2, len(rows) + 2))
        return cls(
            file, digest, rows, role, readings.name if is_part else None,
            () if consecutive else tuple(lines),
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """Return the entry in ``result.json``, without what has its usual value."""
        usual: dict[str, Any] = {"role": "campaign", "name": None, "lines": []}
        return {k: v for k, v in encoded(self).items() if k not in usual or v != usual[k]}

    def readings(self, machine: Machine) -> tuple[Readings, ...]:
        """Return the readings, of one or several kinds."""
        origin: dict[str, Any] = {"file": self.file, "lines": self.lines, "sha256": self.sha256}
        name = Path(self.file).stem if self.name is None else self.name
        readings = readings_from_rows(self.rows, machine.spec, name=name, **origin)
        return split_legs_and_tool(readings)


# -- reading --------------------------------------------------------------------------------------


def edited_file_error(error: Exception, file: str) -> FileError:
    """Return the error for an edited file, from one of ``EDITED_FILE_ERRORS``."""
    if isinstance(error, FileError) and error.file == file:
        return error
    reason = f"it has no key {error}" if isinstance(error, KeyError) else str(error)
    if CUSTOM_EFFECTS_HINT in reason:
        return FileError(f"had effects of its own: {_EFFECTS_REMEDY}", file=file)
    return FileError(f"is not as it was written ({reason}): take the original", file=file)


def read_result(path: Path) -> dict[str, Any]:
    """Return the keys of a ``result.json`` that can be run again.

    Raises:
        FileError: if the file is not such a result.
    """
    text, line = decode(read_bytes(path), path), None
    try:
        keys = json.loads(text)
    except json.JSONDecodeError as error:
        problem, line = f"is not JSON ({error.msg}): give the result.json of a run", error.lineno
    except (ValueError, RecursionError):  # a number with thousands of digits, or as many brackets
        problem = "must be the result.json of a run"
    else:
        needed = ("schema", "version", "command", "arguments", "seed", "inputs", "machine")
        missing = [n for n in needed if not isinstance(keys, dict) or n not in keys]
        problem = unprintable_problem(keys)
        if missing and not problem:
            problem = f"has no {missing[0]!r}: give the result.json of a run as it was written"
        if not problem and (keys["schema"] not in SCHEMAS or keys["command"] not in COMMANDS):
            schema, command = (abbreviated(str(keys[name])) for name in ("schema", "command"))
            problem = (
                f"is of schema {schema}, command {command!r}: this version runs schema "
                f"{' and '.join(map(str, SCHEMAS))} of {', '.join(COMMANDS)} again"
            )
    if problem:
        raise FileError(problem, file=path, line=line)
    return dict(keys)


def version_text(keys: Mapping[str, Any]) -> str:
    """Return the version of the program that wrote a ``result.json`` with these keys."""
    version, schema = (abbreviated(str(keys[name])) for name in ("version", "schema"))
    return f"version {version} (schema {schema})"


def request_of(result: Mapping[str, Any], file: str, effects: Sequence[Effect] = ()) -> Request:
    """Return the request of a run from the keys of its ``result.json``; ``file`` is its name for
    messages, ``effects`` are the user's own ones, if the run had any.

    Raises:
        FileError: if a part of it was edited.
    """
    try:
        arguments, seed, machine = result["arguments"], result["seed"], result["machine"]
        inputs = decoded(tuple[_Input, ...], result["inputs"], {})
        decoded(str | None, arguments["machine"], {})
        options = decoded_fields(Request, arguments, {})
        if (noise := options.get("noise")) is not None and not noise > 0:
            raise ValueError(f"noise_mm is {noise * 1e3:g}")
        # `identify` draws nothing, and accepts any seed.
        if type(seed) is not int or (seed < 0 and result["command"] != "identify"):
            raise ValueError("seed is not a whole number from 0 on")
        source = options.get("effects_file")
        if source and not effects:
            raise FileError(f"had effects from {source}: {_EFFECTS_REMEDY}", file=file)
        machine = machine_of(machine, effects)
        readings = defaultdict[str, list[Readings]](list)
        for entry in inputs:
            readings[entry.role] += entry.readings(machine)
        if not readings["campaign"] and not readings["fit_tcp"]:
            raise ValueError("inputs has no campaign")
        return Request(
            command=result["command"],
            given=(*readings["campaign"], *readings["fit_tcp"]),
            machine=machine,
            seed=seed,
            holdout=tuple(readings["holdout"]),
            tcp=next(iter(readings["tcp"]), None),
            **options,
        )
    except EDITED_FILE_ERRORS as error:
        raise edited_file_error(error, file) from None


def machine_of(keys: Mapping[str, Any], effects: Sequence[Effect] = ()) -> Machine:
    """Return a machine from its keys in ``result.json``.

    Raises:
        FileError, KeyError, TypeError, ValueError: if they were edited.
    """
    name, digest = (decoded(str | None, keys.get(key), {}) or "" for key in ("file", "sha256"))
    toml, npz = decoded(str, keys["toml"], {}), decoded(str | None, keys.get("npz"), {})
    if name:
        _check_name(name)
    spec, posterior = parse_machine_file(toml, name, CATALOGUE.with_effects(effects)), None
    if npz is not None:
        posterior = parse_posterior(b64decode(npz, validate=True), digest, name)
    return Machine(replace(spec, file=name, sha256=digest, posterior=posterior))


def _check_name(name: str) -> None:
    plain = name not in ("", "..") and name == PurePath(name).name and "\0" not in name
    if not plain or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        raise ValueError(f"expected the name of a file, found {name[:40]!r}")
