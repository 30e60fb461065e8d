"""What was asked of the program, and the files it was given: enough to run it again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orthoglide import __version__


@dataclass(frozen=True)
class InputFile:
    """One file of readings as it came.

    Attributes:
        file: its name, without its folder.
        sha256: digest of its content.
        rows: its cells by column, as text.
    """

    file: str
    sha256: str
    rows: tuple[Mapping[str, str], ...]


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


def read_input(path: str | os.PathLike[str]) -> InputFile:
    """A CSV file's rows and digest.

    Raises:
        FileError: where it is no table.
    """
    from orthoglide.observations.table import read_table

    table = read_table(path)
    rows = tuple(dict(zip(table.names, row, strict=True)) for row in table.rows)
    return InputFile(Path(path).name, table.sha256, rows)
