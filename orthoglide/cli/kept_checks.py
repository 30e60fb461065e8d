"""Whether the parts of a ``result.json`` are as they were written: it may have been edited."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

ROLES = ("campaign", "holdout", "tcp")
_LAST_LINE = 1_000_000
_LONGEST_NAME = 255  # bytes


def check_inputs(found: Any) -> None:
    """The files that were read; ValueError or KeyError where one is not as it was written."""
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise ValueError("inputs is no list of files")
    for item in found:
        check_name(item["file"])
        if not isinstance(item["sha256"], str):
            raise ValueError(f"{item['file']} has no digest")
        if item.get("role", ROLES[0]) not in ROLES:
            raise ValueError(f"{item['file']} is none of {', '.join(ROLES)}")
        _check_rows(item["file"], item["rows"])
        _check_lines(item["file"], item.get("lines", []), len(item["rows"]))
    if not any(item.get("role", ROLES[0]) == ROLES[0] for item in found):
        raise ValueError("inputs has no campaign")


def check_name(name: Any) -> None:
    """A file's name without a folder; ValueError where it is none."""
    plain = isinstance(name, str) and name not in ("", "..") and name == PurePath(name).name
    if not plain or "\0" in name or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        raise ValueError(f"{str(name)[:40]!r} is no name of a file")


def check_arguments(command: str, told: Mapping[str, Any], seed: Any) -> None:
    """Whether arguments are those of a command; ValueError or KeyError where they are not."""
    single = command == "identify"
    for name in ("campaigns", "own", *(("free",) if single else ())):
        if not isinstance(told[name], list) or not all(isinstance(n, str) for n in told[name]):
            raise ValueError(f"{name} is no list of names")
    for name in ("machine", *(() if single else ("holdout", "tcp"))):
        if not isinstance(told.get(name), str | None):
            raise ValueError(f"{name} is no name")
    for name in ("priors", "reduced") if single else ():
        if not isinstance(told[name], bool):
            raise ValueError(f"{name} is neither true nor false")
    noise = told["noise_mm"]
    if isinstance(noise, bool) or not isinstance(noise, int | float | None):
        raise ValueError("noise_mm is no number")
    # Nothing is drawn to identify, and any seed went.
    if isinstance(seed, bool) or not isinstance(seed, int) or (seed < 0 and not single):
        raise ValueError("seed is no number that counts")


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
    if not lines:
        return
    ordered = all(a < b for a, b in zip([1, *lines], [*lines, _LAST_LINE], strict=True))
    if len(lines) != count or not ordered:
        raise ValueError(f"{file} has lines that are not those of its rows")
