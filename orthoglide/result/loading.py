"""The request that a ``result.json`` keeps, checked: the file may have been edited."""

from __future__ import annotations

import itertools
import json
from base64 import b64decode
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
from orthoglide.text import abbreviated, printable_path, unprintable_problem

_LAST_LINE = 1_000_000
_LONGEST_NAME = 255  # bytes

SCHEMAS = (1, 2)
"""Of results that can be run again."""


EDITED_FILE_ERRORS = (FileError, KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""Errors that an edited ``result.json`` raises where its values are used."""


def edited_file_error(error: Exception, file: str) -> FileError:
    """Return the error that an edited file is reported with.

    Args:
        error: one of ``EDITED``.
        file: name of the file.
    """
    if isinstance(error, FileError) and error.file == file:
        return error
    reason = f"it has no key {error}" if isinstance(error, KeyError) else str(error)
    return FileError(f"is not as it was written ({reason}): take the original", file=file)


def read_result(path: Path) -> dict[str, Any]:
    """Return the keys of a ``result.json`` that can be run again.

    Raises:
        FileError: where it is none.
    """

    def fail(message: str, line: int | None = None) -> NoReturn:
        raise FileError(message, file=printable_path(path), line=line) from None

    text = decode(read_bytes(path), path)
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        fail(f"is not JSON ({error.msg}): give the result.json of a run", error.lineno)
    except (ValueError, RecursionError):  # a number of thousands of digits, or brackets as many
        fail("is no result: give the result.json of a run")
    if trouble := unprintable_problem(found):
        fail(trouble)
    given = found.get("arguments") if isinstance(found, dict) else None
    if isinstance(given, dict) and "fit_tcp" in given and not found.get("machine"):
        fail("is of --fit-tcp, which kept no rows then: run that command again")
    needed = ("schema", "version", "command", "arguments", "seed", "inputs", "machine")
    missing = [n for n in needed if not isinstance(found, dict) or n not in found]
    if missing:
        fail(f"has no {missing[0]!r}: give the result.json of a run as it was written")
    if found["schema"] not in SCHEMAS or found["command"] not in COMMANDS:
        fail(
            f"is of schema {abbreviated(str(found['schema']))}, command "
            f"{abbreviated(str(found['command']))!r}: this version runs "
            f"schema {' and '.join(map(str, SCHEMAS))} of {', '.join(COMMANDS)} again"
        )
    return found


def version_text(found: Mapping[str, Any]) -> str:
    """Return which version of the program wrote a result, from the keys of ``result.json``."""
    return (
        f"version {abbreviated(str(found['version']))} (schema {abbreviated(str(found['schema']))})"
    )


@dataclass(frozen=True)
class _Arguments:
    """The arguments of a run, as far as they are needed to run it again."""

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
    name: str | None = None  # of the readings, where it is not that of the file
    lines: tuple[int, ...] = ()  # of the rows in the file, where they do not follow one another

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
    """A machine as a result keeps it."""

    file: str | None
    sha256: str | None
    toml: str
    npz: str | None = None


def request_of(result: Mapping[str, Any], file: str, effects: Sequence[Effect] = ()) -> Request:
    """Return the request of a run from its ``result.json``.

    Args:
        result: keys of the file.
        file: its name, for messages.
        effects: the user's own, where the run had some.

    Raises:
        FileError: where a part of it is not as it was written.
    """
    try:
        command, seed = result["command"], result["seed"]
        single = command == "identify"
        inputs = decoded(tuple[_Input, ...], result["inputs"], {})
        given = decoded(_Arguments, result["arguments"], {})
        # Nothing is drawn to identify, and any seed went.
        if type(seed) is not int or (seed < 0 and not single):
            raise ValueError("seed is no number that counts")
        if given.effects_file and not effects:
            raise FileError(
                f"had effects from {given.effects_file}: give them too (--effects-file, effects=)",
                file=file,
            )
        machine = machine_of(result["machine"], effects)
        read: dict[str, list[Readings]] = {"campaign": [], "fit_tcp": [], "holdout": [], "tcp": []}
        for one in inputs:
            read[one.role] += one.readings(machine)
        if not read["campaign"] and not read["fit_tcp"]:
            raise ValueError("inputs has no campaign")
        return Request(
            command,
            tuple(r for r in read["campaign"] if not r.of_tool),
            machine,
            own=given.own,
            noise=None if given.noise_mm is None else given.noise_mm * 1e-3,
            seed=seed,
            holdout=tuple(read["holdout"]),
            tcp=next(iter(read["tcp"]), None),
            points=(*(r for r in read["campaign"] if r.of_tool), *read["fit_tcp"]),
            frame=given.frame,
            effects_file=given.effects_file,
            free=given.free,
            priors=given.priors,
            reduced=given.reduced,
        )
    except EDITED_FILE_ERRORS as error:
        raise edited_file_error(error, file) from None


def machine_of(given: Mapping[str, Any], effects: Sequence[Effect] = ()) -> Machine:
    """Return a machine that a ``result.json`` keeps.

    Raises:
        FileError, KeyError, TypeError, ValueError: where it is not as it was written.
    """
    kept = decoded(_StoredMachine, given, {})
    name, digest = kept.file or "", kept.sha256 or ""
    if name:
        _check_name(name)
    spec, known = parse_machine_file(kept.toml, name, CATALOGUE.with_effects(effects)), None
    if kept.npz is not None:
        known = parse_posterior(b64decode(kept.npz, validate=True), digest, name)
    return Machine(replace(spec, file=name, sha256=digest, posterior=known))


def _check_name(name: str) -> None:
    plain = name not in ("", "..") and name == PurePath(name).name and "\0" not in name
    if not plain or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        raise ValueError(f"{name[:40]!r} is no name of a file")
