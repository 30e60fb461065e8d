"""The campaign file while it is measured: every row is on the disk before the next question."""

from __future__ import annotations

import csv
import io
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.instruments import LegDial
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.reading import readings_of_table
from orthoglide.observations.table import rows_table
from orthoglide.observations.writing import Row, campaign_rows, command_columns
from orthoglide.text import csv_text, printable_path

RETURN_POSTURE = "again"
"""Posture of a move that leads back to where a reading is to be taken after an interruption."""

SKIPPED_POSTURE = "skipped"
"""Posture of a place that was gone to and not read."""

_COLUMNS_BEFORE_COMMANDS = ("kind", "setup", "leg", "direction", "posture")
_COLUMNS_AFTER_COMMANDS = ("gauge_mm", "bar", "repeat", "order", "load_N", "time_s", "reading_mm")


class Record:
    """A campaign file that grows by a row at a time.

    Args:
        path: of the file; made where there is none.
        machine_file: whose controller's coordinates the commands are in.

    Attributes:
        rows: of the file, moves included.
        idle: seconds since the last row, where the file was there already.
    """

    def __init__(self, path: Path, machine_file: MachineFile) -> None:
        self.path, self.machine_file = path, machine_file
        self.rows: list[Row] = []
        self.idle = 0.0
        self._columns: tuple[str, ...] = ()

    @property
    def readings(self) -> int:
        """Number of readings in the file."""
        return sum(row["kind"] != "move" for row in self.rows)

    def plan(self, sheet: Readings) -> list[Row]:
        """Return the rows of a sheet as this file has them, in the order they are gone through."""
        planned = campaign_rows(sheet.with_readings(np.full(len(sheet), np.nan)), self.machine_file)
        commands = command_columns(planned[0])
        columns = (*_COLUMNS_BEFORE_COMMANDS, *commands, *_COLUMNS_AFTER_COMMANDS)
        kind = {"kind": LegDial.kind}
        return [{name: (kind | row).get(name, "") for name in columns} for row in planned]

    def open(self, first: Readings) -> bool:
        """Read what the file contains, or begin it with a sheet; return whether it was there.

        Raises:
            FileError: where it is no file of this kind, or cannot be written.
        """
        self._columns = tuple(self.plan(first)[0])
        if not self.path.exists():
            self._write(overwrite=False)
            return False
        text = files.decode(files.read_bytes(self.path), self.path)
        complete = text[: text.rfind("\n") + 1]  # a row that was torn by a power cut is none
        reader = csv.DictReader(io.StringIO(complete, newline=""))
        self.rows = list(reader)
        ragged = any(None in (*row, *row.values()) for row in self.rows)
        if ragged or tuple(reader.fieldnames or ()) != self._columns:
            problem = "was not begun by this command with this machine file"
            raise FileError(
                f"{problem}: choose another name for --out", file=printable_path(self.path), line=1
            )
        self.idle = max(time.time() - self.path.stat().st_mtime, 0.0)
        if complete != text:
            self._write()
        return True

    def append(self, row: Row) -> None:
        """Add a row, numbered, and see it on the disk."""
        full = row | {"order": str(len(self.rows))}
        with files.as_file_errors(self.path), open(self.path, "ab") as stream:
            stream.write(csv_text(list(full.values()), ()).encode())
            stream.flush()
            os.fsync(stream.fileno())
        self.rows.append(full)

    def take_back(self) -> bool:
        """Remove the last reading and what follows it; return whether there was one."""
        readings = [k for k, row in enumerate(self.rows) if row["kind"] != "move"]
        if readings:
            self.rows = self.rows[: readings[-1]]
            self._write()
        return bool(readings)

    def _write(self, *, overwrite: bool = True) -> None:
        text = csv_text(self._columns, [row.values() for row in self.rows])
        files.write_file(self.path, text, overwrite=overwrite)

    def campaign(self, rows: Sequence[Row]) -> Readings:
        """Return some of the rows as a campaign, without mountings that were read at one station
        only: their datum is free, so they contain no information.

        Raises:
            FileError: where the readings cannot be used.
        """
        stations: dict[str, set[tuple[str, ...]]] = {}
        for row in rows:
            if row["kind"] != "move":
                command = tuple(row[name] for name in command_columns(row))
                stations.setdefault(row["setup"], set()).add(command)
        unused = {"kind": "move", "reading_mm": ""}
        used = [row if len(stations.get(row["setup"], ())) > 1 else row | unused for row in rows]
        table = rows_table(used, printable_path(self.path))
        return readings_of_table(table, self.path.stem, self.machine_file)
