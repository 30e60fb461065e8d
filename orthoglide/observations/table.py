"""A CSV file or data frame as cells of text, with the line of each row, and its commands."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.geometry import LEGS, Array
from orthoglide.layout import LegNames
from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.numerals import MINUS
from orthoglide.observations.checks import check_commands
from orthoglide.observations.schema import (
    COLUMNS,
    COMMANDS,
    NAN,
    NUMBER,
    PLACE,
    POINT,
    RHO,
    TRAVEL,
    Column,
    column_names,
)
from orthoglide.text import abbreviated, cell_text, printable_path, unprintable

_DELIMITERS = ",;\t"
_SEPARATOR = re.compile(rf'"?sep=([{_DELIMITERS}])"?', re.IGNORECASE)
_SCHEMA = re.compile(r"^schema\b", re.MULTILINE)  # of machine files, after any comments
_MAX_COLUMNS = 200
_KNOWN_NAMES = frozenset(column_names((*COLUMNS, POINT)))  # by which a header is recognized
_MISSING = ("nan", "NaN", "None", "<NA>", "NaT")  # how data frames spell an empty cell
_PRINTED_MINUS = re.compile(rf"^{MINUS}(?=[.,]?[0-9])")  # as this package prints it


@dataclass(frozen=True)
class Table:
    """Cells of text by column, with the line of each row."""

    columns: Mapping[str, list[str]]  # cells by the name in the header
    lines: tuple[int, ...]  # line of each row, the header being line 1
    file: str  # name for errors
    sha256: str = ""  # digest of the file, or `""`

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def names(self) -> tuple[str, ...]:
        """The header."""
        return tuple(self.columns)

    def fail(self, message: str, row: int | None = None) -> NoReturn:
        """Refuse the table, at a row if one is given."""
        raise FileError(message, file=self.file, line=1 if row is None else self.lines[row])

    def cells(self, name: str) -> list[str]:
        """Return the cells of a column; empty ones if it is absent."""
        return self.columns.get(name, [""] * len(self))

    def values(self, column: Column, name: str = "") -> list[Any]:
        """Return the values of a column in SI; ``name`` selects one column of three.

        Raises:
            FileError: for the first cell that cannot be read.
        """
        name = name or column.name
        if name not in self.columns:
            return [column.empty_value] * len(self)
        cells, values = self.cells(name), dict[str, Any]()
        for cell in dict.fromkeys(cells):
            try:
                values[cell] = column.kind.read(cell) if cell else column.empty_value
            except ValueError as error:
                self.fail(f"{name} is {abbreviated(cell)!r}, {error}", cells.index(cell))
            if not cell and column.required:
                self.fail(f"{name} is empty: fill it in or remove the row", cells.index(cell))
        return [values[cell] for cell in cells]

    def array(self, column: Column, legs: tuple[str, str, str] = LEGS) -> Array:
        """Return the values of three columns ``(n, 3)``, by legs or base axes.

        Raises:
            FileError: as `values`.
        """
        names = column.names(legs)
        return np.array([self.values(column, name) for name in names], dtype=float).T

    def check_names(self, allowed: Iterable[str], required: Iterable[str]) -> tuple[Note, ...]:
        """Refuse missing and misspelt columns, and return warnings about ignored ones."""
        allowed = tuple(allowed)
        if not set(allowed) & set(self.names):
            case_hint = " in small letters" * any(name != name.lower() for name in self.names)
            self.fail(f"names no known column: give {', '.join(required)}{case_hint}")
        unknown = [name for name in self.names if name not in allowed]
        for name in unknown:
            close = get_close_matches(name, allowed, n=1, cutoff=0.75)
            if close and close[0] not in self.names:
                self.fail(f"there is no column {abbreviated(name)!r}: did you mean {close[0]!r}?")
        missing = [name for name in required if name not in self.names]
        if missing:
            self.fail(f"has no column {', '.join(missing)}: add what is missing to the first line")
        return tuple(
            Note(f"column {abbreviated(name)!r} is not known and was ignored", "column")
            for name in unknown
            if name
        )

    def part(self, rows: Sequence[int] | NDArray[np.intp]) -> Table:
        """Return the table of some rows, by index."""
        columns = {name: [cells[k] for k in rows] for name, cells in self.columns.items()}
        return replace(self, columns=columns, lines=tuple(self.lines[k] for k in rows))


def read_table(path: str | os.PathLike[str]) -> Table:
    """Read a CSV file: UTF-8, columns separated by commas, semicolons or tabs.

    Decimal commas are accepted where semicolons or tabs separate the columns.

    Raises:
        FileError: if the file is missing, empty, not text, or its rows are ragged.
    """
    content = files.read_bytes(path)
    return parse_table(files.decode(content, path), path, files.sha256(content))


def parse_table(text: str, path: str | os.PathLike[str], sha256: str = "") -> Table:
    """Return the table of a CSV file's text, with its name and digest; raises as `read_table`."""
    header = next((line for line in text.splitlines() if line.strip()), "")
    if header.lstrip()[:1] in ("{", "[") or _SCHEMA.search(text):
        raise FileError("must be CSV, not a result or a machine file: give the campaign's own file",
                        file=printable_path(path))  # fmt: skip
    if separator := _SEPARATOR.fullmatch(header):  # a spreadsheet's own first line
        text = text.replace(header, "", 1)
    elif not _names_columns(header):
        lines = text.splitlines()
        if number := next((k for k, line in enumerate(lines, 1) if _names_columns(line)), 0):
            raise FileError(
                f"the names of the columns stand on line {number}: remove what is above them",
                file=printable_path(path), line=1,
            )  # fmt: skip
    delimiter = separator[1] if separator else max(_DELIMITERS, key=header.count)
    names, rows, numbers = _parse_cells(text, delimiter, printable_path(path))
    if delimiter != ",":
        rows = [[_decimal_point(cell) for cell in row] for row in rows]
    return _checked_table(names, rows, numbers, printable_path(path), sha256)


def _names_columns(line: str) -> bool:
    """Return whether a line is a header: one known name may also be the cell of a reading."""
    return len(_KNOWN_NAMES.intersection(re.split(rf'[{_DELIMITERS}"\s]+', line))) > 1


def frame_table(df: Any, name: str) -> Table:
    """Return the cells of a data frame or a mapping of columns; rows count as lines below a header.

    Raises:
        FileError: if it is neither, or invalid as a file.
    """
    labels = getattr(df, "columns", df if isinstance(df, Mapping) else None)
    if labels is None or not hasattr(df, "__getitem__"):
        raise FileError(
            f"is a {type(df).__name__}: give a data frame, or a mapping of columns", file=name
        )
    names = [str(column) for column in labels]
    _check_distinct(names, name)
    try:
        cells = [[str(value).strip() for value in df[column]] for column in labels]
    except TypeError:
        raise FileError(
            "each column must be a list: give a value for each row", file=name
        ) from None
    columns = [["" if cell in _MISSING else cell for cell in column] for column in cells]
    if len({len(column) for column in columns}) > 1:
        raise FileError("has columns of unequal length: pad them", file=name)
    return _checked_table(names, list(zip(*columns, strict=True)), (), name)


def rows_table(
    rows: Sequence[Mapping[str, str]], file: str, lines: Sequence[int] = (), sha256: str = ""
) -> Table:
    """Return the cells of rows by column, as results keep them, the first row naming all columns;
    lines count from 2 on where none are given.
    """
    names = list(rows[0]) if rows else []
    cells = [[str(row.get(name, "")).strip() for name in names] for row in rows]
    return _checked_table(names, cells, lines, file, sha256)


def _parse_cells(
    text: str, delimiter: str, file: str
) -> tuple[list[str], list[list[str]], list[int]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    has_marks = "'" in text or MINUS in text  # marks of a spreadsheet, and of printed numbers
    rows, lines = [], []
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if has_marks:
                cells = [_PRINTED_MINUS.sub("-", cell_text(cell)) for cell in cells]
            if any(cells):
                rows.append(cells)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise FileError(
            f"is not CSV ({error}): close the quotes", file=file, line=reader.line_num
        ) from None
    if not rows:
        raise FileError("has only empty fields: name the columns in the first line", file=file)
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(rows[0]):
            raise FileError(
                f"has {len(row)} fields where the first line has {len(rows[0])}: begin with the "
                "names of the columns, give every line as many fields, and with decimal commas "
                "separate the columns by semicolons",
                file=file,
                line=line,
            )
    return rows[0], rows[1:], lines[1:]


def _checked_table(
    names: Sequence[str],
    rows: Sequence[Sequence[str]],
    lines: Sequence[int],
    file: str,
    digest: str = "",
) -> Table:
    """Return the table of a header and rows of cells, on lines from 2 on where none are given."""
    lines = tuple(lines or range(2, len(rows) + 2))
    if len(names) > _MAX_COLUMNS:
        raise FileError(
            f"names {len(names)} columns: give a sheet of {_MAX_COLUMNS} at most", file=file, line=1
        )
    for row, line in zip((names, *rows), (1, *lines), strict=True):
        if character := unprintable("".join(row)):
            raise FileError(
                f"holds the character {character}, which cannot be shown: remove it",
                file=file, line=line,
            )  # fmt: skip
        if row is not names and tuple(row) == tuple(names):
            raise FileError(
                "the header stands here again: make what follows it a file of its own",
                file=file, line=line,
            )  # fmt: skip
    _check_distinct(names, file)
    if not rows:
        raise FileError("has a header but no rows: add the readings", file=file, line=1)
    columns = {name: list(cells) for name, *cells in zip(names, *rows, strict=True)}
    return Table(columns, lines, file, digest)


def _check_distinct(names: Sequence[str], file: str) -> None:
    for name in names:
        if name and names.count(name) > 1:
            raise FileError(
                f"names column {abbreviated(name)!r} twice: remove one", file=file, line=1
            )


def _decimal_point(cell: str) -> str:
    pointed = cell.replace(",", ".", 1)
    return pointed if NUMBER.fullmatch(pointed) else cell


# Commands --------------------------------------------------------------------------------------

_AGREEMENT = 1e-8  # metres: commands that are stated in two ways, both rounded to a nanometre
_PLACE_WITHOUT_HEIGHT = replace(PLACE, empty_value=NAN)  # the height is empty before a touch


def native_command_column(names: LegNames) -> Column:
    """Return the columns of a layout's commands: joint coordinates, or travel."""
    return RHO if RHO.name.startswith(names.command) else TRAVEL


def native_command_names(names: LegNames) -> tuple[str, ...]:
    """Return the names of the three columns of a layout's commands."""
    return native_command_column(names).names(names.legs)


def stated_commands(table: Table, machine: MachineFile) -> Column:
    """Return the columns in which a table states its commands.

    Raises:
        FileError: if two ways of stating them disagree, or the columns are of another layout.
    """
    legs, is_delta = machine.geometry.leg_names, not machine.geometry.dialled
    native, other = (TRAVEL, PLACE) if is_delta else (RHO, TRAVEL)
    if not is_delta and "travel_a_mm" in table.names:
        table.fail(
            "has the columns of a linear delta: give its machine file, with [layout], by --machine"
        )
    names = [set(column.names(legs)) for column in (native, other)]
    if not names[1] & set(table.names) or (is_delta and machine.kinematics is None):
        return native
    if not names[0] & set(table.names):
        return other
    fault = "one of these kinds is not complete"
    if (names[0] | names[1]) <= set(table.names):  # `compensate` writes both
        difference = commands(table, native, machine) - commands(table, other, machine)
        if np.abs(difference).max(initial=0.0) <= _AGREEMENT:
            return native
        fault = "they disagree"
    both = f"{native.names(legs)[0]} and {other.names(legs)[0]}"
    table.fail(f"has {both}, and {fault}: keep the columns of one kind")


def commands(table: Table, column: Column, machine: MachineFile) -> Array:
    """Return the joint coordinates ``(n, 3)``, metres, of a table's commands, or of second ones.

    Raises:
        FileError: for a command that is invalid, or that the machine cannot reach.
    """
    kinematics = machine.kinematics
    if kinematics is None or column not in (PLACE, COMMANDS[PLACE]):
        given = table.array(column, machine.geometry.leg_names)
        is_travel = column in (TRAVEL, COMMANDS[TRAVEL])
        return check_commands(given, is_travel, machine, table.fail)
    columns = (column, column, _PLACE_WITHOUT_HEIGHT if column is PLACE else column)
    cells = [table.values(c, n) for c, n in zip(columns, column.names(), strict=True)]
    travel = kinematics.travel(np.nan_to_num(np.array(cells, dtype=float).T))
    unreachable = np.flatnonzero(np.isnan(travel).any(axis=1))
    if len(unreachable):
        names = ", ".join(column.names())
        table.fail(f"{names} is a place that no arm reaches: correct it", int(unreachable[0]))
    shown = machine.controller.from_rho(travel, machine.geometry)
    return check_commands(shown, True, machine, table.fail)
