"""What was asked of the program, and the files it was given: enough to run it again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from orthoglide import __version__

Role = Literal["campaign", "holdout", "tcp"]


@dataclass(frozen=True)
class InputFile:
    """One file of readings as it came.

    Attributes:
        file: its name, without its folder.
        sha256: digest of its content.
        rows: its cells by column, as text.
        role: ``campaign``, ``holdout`` or ``tcp``.
        lines: line of each row where they do not simply follow the header; empty where they do.
    """

    file: str
    sha256: str
    rows: tuple[Mapping[str, str], ...]
    role: Role = "campaign"
    lines: tuple[int, ...] = ()

    def mapping(self) -> dict[str, Any]:
        """As `result.json` keeps it."""
        told: dict[str, Any] = {"file": self.file, "sha256": self.sha256}
        if self.role != "campaign":
            told["role"] = self.role
        if self.lines:
            told["lines"] = list(self.lines)
        return {**told, "rows": [dict(row) for row in self.rows]}


@dataclass(frozen=True)
class Run:
    """One run of a command.

    Attributes:
        command: such as ``identify``.
        arguments: all that has an influence on the numbers; names of files, no places.
        seed: of random draws.
        inputs: the files of readings.
        again: a command line that does the same, as run beside the files; empty where none does.
        version: of this package.
    """

    command: str
    arguments: Mapping[str, Any]
    inputs: tuple[InputFile, ...]
    seed: int = 0
    again: str = ""
    version: str = __version__


def read_input(path: str | os.PathLike[str], role: Role = "campaign") -> InputFile:
    """A CSV file's rows and digest.

    Args:
        path: the file.
        role: what it is for.

    Raises:
        FileError: where it is no table.
    """
    from orthoglide.observations.table import read_table

    table = read_table(path)
    rows = tuple(dict(zip(table.names, row, strict=True)) for row in table.rows)
    follow = table.lines == tuple(range(2, len(rows) + 2))
    return InputFile(Path(path).name, table.sha256, rows, role, () if follow else table.lines)
