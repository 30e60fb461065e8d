"""The request in a ``result.json``, checked, as the file may have been edited."""

from __future__ import annotations

import itertools
import json
from base64 import b64decode
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any, Literal, NoReturn

from orthoglide.effects import CATALOGUE, Effect
from orthoglide.errors import FileError
from orthoglide.files import decode, read_bytes
from orthoglide.instruments import Frame
from orthoglide.machine import Machine
from orthoglide.machine_file import parse_machine_file
from orthoglide.machine_file.posterior import parse_posterior
from orthoglide.observations import Readings, readings_from_rows
from orthoglide.result.codec import decoded
from orthoglide.result.request import COMMANDS, Request
from orthoglide.text import abbreviated, unprintable_problem

_LAST_LINE = 1_000_000
_LONGEST_NAME = 255  # bytes

SCHEMAS = (1, 2)
"""Schemas of results that can be run again."""

EDITED_FILE_ERRORS = (FileError, KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""Errors that the values of an edited ``result.json`` raise."""


def edited_file_error(error: Exception, file: str) -> FileError:
    """Return the error for an edited file, from one of ``EDITED_FILE_ERRORS``."""
    if isinstance(error, FileError) and error.file == file:
        return error
    reason = f"it has no key {error}" if isinstance(error, KeyError) else str(error)
    return FileError(f"is not as it was written ({reason}): take the original", file=file)


def read_result(path: Path) -> dict[str, Any]:
    """Return the keys of a ``result.json`` that can be run again.

    Raises:
        FileError: if the file is not such a result.
    """

    def fail(message: str, line: int | None = None) -> NoReturn:
        raise FileError(message, file=path, line=line) from None

    text = decode(read_bytes(path), path)
    try:
        keys = json.loads(text)
    except json.JSONDecodeError as error:
        fail(f"is not JSON ({error.msg}): give the result.json of a run", error.lineno)
    except (ValueError, RecursionError):  # a number with thousands of digits, or as many brackets
        fail("is no result: give the result.json of a run")
    if problem := unprintable_problem(keys):
        fail(problem)
    arguments = keys.get("arguments") if isinstance(keys, dict) else None
    if isinstance(arguments, dict) and arguments.get("fit_tcp") and not keys.get("machine"):
        fail("is of --fit-tcp, which kept no rows then: run that command again")
    needed = ("schema", "version", "command", "arguments", "seed", "inputs", "machine")
    missing = [n for n in needed if not isinstance(keys, dict) or n not in keys]
    if missing:
        fail(f"has no {missing[0]!r}: give the result.json of a run as it was written")
    if keys["schema"] not in SCHEMAS or keys["command"] not in COMMANDS:
        fail(
            f"is of schema {abbreviated(str(keys['schema']))}, command "
            f"{abbreviated(str(keys['command']))!r}: this version runs "
            f"schema {' and '.join(map(str, SCHEMAS))} of {', '.join(COMMANDS)} again"
        )
    return keys


def version_text(keys: Mapping[str, Any]) -> str:
    """Return the version of the program that wrote a ``result.json`` with these keys."""
    version, schema = (abbreviated(str(keys[name])) for name in ("version", "schema"))
    return f"version {version} (schema {schema})"


@dataclass(frozen=True)
class _Arguments:
    """The arguments that are needed to run a command again."""

    own: tuple[str, ...]
    machine: str | None
    noise_mm: float | None
    frame: Frame = "rigid"
    effects_file: str = ""
    free: tuple[str, ...] = CATALOGUE.base
    priors: bool = True
    reduced: bool = False

    def __post_init__(self) -> None:
        if self.noise_mm is not None and not self.noise_mm > 0:
            raise ValueError(f"noise_mm is {self.noise_mm}")


@dataclass(frozen=True)
class _Input:
    """A file of readings."""

    file: str  # its name
    sha256: str
    rows: tuple[Any, ...]  # cells by column
    role: Literal["campaign", "fit_tcp", "holdout", "tcp"] = "campaign"
    name: str | None = None  # of the readings, if it is not that of the file
    lines: tuple[int, ...] = ()  # lines of the rows in the file, if they are not consecutive

    def __post_init__(self) -> None:
        _check_name(self.file)
        if not self.rows:
            raise ValueError(f"{self.file} has no rows")
        for row in self.rows:
            cells = row.items() if isinstance(row, dict) else ()
            if not cells or not all(isinstance(c, str) for cell in cells for c in cell):
                raise ValueError(f"{self.file} has a row that is none")
        ordered = all(a < b for a, b in itertools.pairwise((1, *self.lines, _LAST_LINE)))
        if self.lines and (len(self.lines) != len(self.rows) or not ordered):
            raise ValueError(f"{self.file} has lines that are not those of its rows")

    def readings(self, machine: Machine) -> tuple[Readings, ...]:
        """Return the readings, of one or several kinds."""
        origin: dict[str, Any] = {"file": self.file, "lines": self.lines, "sha256": self.sha256}
        name = Path(self.file).stem if self.name is None else self.name
        return readings_from_rows(self.rows, machine.spec, name=name, **origin)


@dataclass(frozen=True)
class _StoredMachine:
    """A machine in a ``result.json``."""

    file: str | None
    sha256: str | None
    toml: str
    npz: str | None = None


def request_of(result: Mapping[str, Any], file: str, effects: Sequence[Effect] = ()) -> Request:
    """Return the request of a run from its ``result.json``.

    Args:
        result: keys of the file.
        file: its name, for messages.
        effects: the user's own effects, if the run had any.

    Raises:
        FileError: if a part of it was edited.
    """
    try:
        command, seed = result["command"], result["seed"]
        inputs = decoded(tuple[_Input, ...], result["inputs"], {})
        arguments = decoded(_Arguments, result["arguments"], {})
        # `identify` draws nothing, and accepts any seed.
        if type(seed) is not int or (seed < 0 and command != "identify"):
            raise ValueError("seed is no number that counts")
        if source := arguments.effects_file if not effects else "":
            message = f"had effects from {source}: give them too (--effects-file, effects=)"
            raise FileError(message, file=file)
        machine = machine_of(result["machine"], effects)
        readings = defaultdict[str, list[Readings]](list)
        for entry in inputs:
            readings[entry.role] += entry.readings(machine)
        if not readings["campaign"] and not readings["fit_tcp"]:
            raise ValueError("inputs has no campaign")
        return Request(
            command,
            (*readings["campaign"], *readings["fit_tcp"]),
            machine,
            own=arguments.own,
            noise=None if arguments.noise_mm is None else arguments.noise_mm * 1e-3,
            seed=seed,
            holdout=tuple(readings["holdout"]),
            tcp=next(iter(readings["tcp"]), None),
            frame=arguments.frame,
            effects_file=arguments.effects_file,
            free=arguments.free,
            priors=arguments.priors,
            reduced=arguments.reduced,
        )
    except EDITED_FILE_ERRORS as error:
        raise edited_file_error(error, file) from None


def machine_of(keys: Mapping[str, Any], effects: Sequence[Effect] = ()) -> Machine:
    """Return a machine from its keys in ``result.json``.

    Raises:
        FileError, KeyError, TypeError, ValueError: if they were edited.
    """
    stored = decoded(_StoredMachine, keys, {})
    name, digest = stored.file or "", stored.sha256 or ""
    if name:
        _check_name(name)
    spec, posterior = parse_machine_file(stored.toml, name, CATALOGUE.with_effects(effects)), None
    if stored.npz is not None:
        posterior = parse_posterior(b64decode(stored.npz, validate=True), digest, name)
    return Machine(replace(spec, file=name, sha256=digest, posterior=posterior))


def _check_name(name: str) -> None:
    plain = name not in ("", "..") and name == PurePath(name).name and "\0" not in name
    if not plain or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        raise ValueError(f"{name[:40]!r} is no name of a file")
