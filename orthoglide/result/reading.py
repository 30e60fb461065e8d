"""The request that a ``result.json`` keeps, checked: the file may have been edited."""

from __future__ import annotations

import json
from base64 import b64decode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any, NoReturn

from orthoglide.effects import CATALOGUE, Effect
from orthoglide.errors import FileError
from orthoglide.files import decode, read_bytes
from orthoglide.machine import Machine
from orthoglide.machine_file import parse_machine_file
from orthoglide.machine_file.posterior import parse_posterior
from orthoglide.observations import Readings, readings_from_rows
from orthoglide.result.request import COMMANDS, Request
from orthoglide.text import brief, shown, unseen_in

_ROLES = ("campaign", "fit_tcp", "holdout", "tcp")
_FRAMES = ("rigid", "translation", "none")
_LAST_LINE = 1_000_000
_LONGEST_NAME = 255  # bytes

SCHEMAS = (1, 2)
"""Of results that can be run again."""


EDITED = (FileError, KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""Errors that an edited ``result.json`` raises where its values are used."""


def as_edited(error: Exception, file: str) -> FileError:
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
    """A ``result.json`` that can be run again.

    Raises:
        FileError: where it is none.
    """

    def fail(message: str, line: int | None = None) -> NoReturn:
        raise FileError(message, file=shown(path), line=line) from None

    text = decode(read_bytes(path), path)
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        fail(f"is not JSON ({error.msg}): give the result.json of a run", error.lineno)
    except (ValueError, RecursionError):  # a number of thousands of digits, or brackets as many
        fail("is no result: give the result.json of a run")
    if trouble := unseen_in(found):
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
            f"is of schema {brief(str(found['schema']))}, command "
            f"{brief(str(found['command']))!r}: this version runs "
            f"schema {' and '.join(map(str, SCHEMAS))} of {', '.join(COMMANDS)} again"
        )
    return found


def request_of(result: Mapping[str, Any], file: str, effects: Sequence[Effect] = ()) -> Request:
    """The request of a run from its ``result.json``; ``effects`` are the user's own, where the run
    had some.

    Raises:
        FileError: where a part of it is not as it was written.
    """
    try:
        inputs, given, seed = result["inputs"], result["arguments"], result["seed"]
        single = result["command"] == "identify"
        _check_inputs(inputs)
        _check_arguments(given, single)
        # Nothing is drawn to identify, and any seed went.
        if not isinstance(seed, int) or isinstance(seed, bool) or (seed < 0 and not single):
            raise ValueError("seed is no number that counts")
        noise = given["noise_mm"]
        if given.get("effects_file") and not effects:
            raise FileError(
                f"had effects from {given['effects_file']}: give them too (--effects-file, "
                f"effects=)",
                file=file,
            )
        machine = machine_of(result["machine"], effects)
        by_role = {role: [i for i in inputs if i.get("role", _ROLES[0]) == role] for role in _ROLES}
        read = [r for i in by_role["campaign"] for r in _readings(i, machine)]
        tool = [r for r in read if r.of_tool]
        request = Request(
            result["command"],
            tuple(r for r in read if not r.of_tool),
            machine,
            own=tuple(given["own"]),
            noise=None if noise is None else noise * 1e-3,
            seed=seed,
            holdout=tuple(r for i in by_role["holdout"] for r in _readings(i, machine)),
            tcp=next((_points(i, machine) for i in by_role["tcp"]), None),
            points=(*tool, *(_points(i, machine) for i in by_role["fit_tcp"])),
            frame=given.get("frame", "rigid"),
            effects_file=given.get("effects_file", ""),
        )
        if not single:
            return request
        free, priors, reduced = tuple(given["free"]), given["priors"], given["reduced"]
        return replace(request, free=free, priors=priors, reduced=reduced)
    except EDITED as error:
        raise as_edited(error, file) from None


def machine_of(given: Mapping[str, Any], effects: Sequence[Effect] = ()) -> Machine:
    """A machine that a ``result.json`` keeps.

    Raises:
        FileError, KeyError, TypeError, ValueError: where it is not as it was written.
    """
    name = given["file"] or ""
    if name:
        _check_name(name)
    spec = parse_machine_file(given["toml"], name, CATALOGUE.with_effects(effects))
    digest, kept = given["sha256"] or "", given.get("npz")
    if not isinstance(digest, str) or not isinstance(kept, str | None):
        raise ValueError("the machine's digest or covariance is no text")
    known = None if kept is None else parse_posterior(b64decode(kept, validate=True), digest, name)
    return Machine(replace(spec, file=name, sha256=digest, posterior=known))


def _readings(found: Mapping[str, Any], machine: Machine) -> tuple[Readings, ...]:
    name = found.get("name", Path(found["file"]).stem)
    return readings_from_rows(found["rows"], machine.spec, name=name, **_origin(found))


def _points(found: Mapping[str, Any], machine: Machine) -> Readings:
    (points,) = _readings(found, machine)
    return points


def _origin(found: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "file": found["file"], "lines": found.get("lines", ()), "sha256": found["sha256"]
    }  # fmt: skip


def _check_arguments(given: Mapping[str, Any], single: bool) -> None:
    """ValueError or KeyError where an argument is none that the command takes."""

    def names(value: Any) -> bool:
        return isinstance(value, list) and all(isinstance(n, str) for n in value)

    def number(value: Any) -> bool:
        return value is None or (type(value) in (int, float) and 0 < float(value) < float("inf"))

    checks: dict[str, Callable[[Any], bool]] = {
        "campaigns": names,
        "own": names,
        "machine": lambda value: isinstance(value, str | None),
        "noise_mm": number,
    }
    if single:
        truth: Callable[[Any], bool] = lambda value: isinstance(value, bool)  # noqa: E731
        checks |= {"free": names, "priors": truth, "reduced": truth}
    if given.get("frame", "rigid") not in _FRAMES:
        raise ValueError(f"frame is {given['frame']!r}")
    for name, check in checks.items():
        if not check(given[name]):
            raise ValueError(f"{name} is {given[name]!r}")


def _check_inputs(found: Any) -> None:
    """ValueError or KeyError where a file of readings is not as it was written."""
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise ValueError("inputs is no list of files")
    for item in found:
        _check_name(item["file"])
        if not isinstance(item.get("name", ""), str):
            raise ValueError(f"{item['file']} has no name of its readings")
        if not isinstance(item["sha256"], str):
            raise ValueError(f"{item['file']} has no digest")
        if item.get("role", _ROLES[0]) not in _ROLES:
            raise ValueError(f"{item['file']} is none of {', '.join(_ROLES)}")
        _check_rows(item["file"], item["rows"])
        _check_lines(item["file"], item.get("lines", []), len(item["rows"]))
    if not any(item.get("role", _ROLES[0]) in _ROLES[:2] for item in found):
        raise ValueError("inputs has no campaign")


def _check_name(name: Any) -> None:
    plain = isinstance(name, str) and name not in ("", "..") and name == PurePath(name).name
    if not plain or "\0" in name or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        raise ValueError(f"{str(name)[:40]!r} is no name of a file")


def _check_rows(file: str, rows: Any) -> None:
    if not isinstance(rows, list) or not rows:
        raise ValueError(f"{file} has no rows")
    for row in rows:
        cells = row.items() if isinstance(row, dict) else ()
        if not cells or not all(isinstance(c, str) for cell in cells for c in cell):
            raise ValueError(f"{file} has a row that is none")


def _check_lines(file: str, lines: Any, count: int) -> None:
    if not isinstance(lines, list) or not all(type(line) is int for line in lines):
        raise ValueError(f"{file} has lines that are no numbers")
    ordered = all(a < b for a, b in zip([1, *lines], [*lines, _LAST_LINE], strict=True))
    if lines and (len(lines) != count or not ordered):
        raise ValueError(f"{file} has lines that are not those of its rows")
