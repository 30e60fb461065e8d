"""The campaign file while it is measured: every row is on the disk before the next question."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orthoglide import files
from orthoglide.instruments import LegDial
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.reading import readings_of_table
from orthoglide.observations.schema import COLUMNS, ORDER
from orthoglide.observations.table import parse_table, rows_table
from orthoglide.observations.writing import Row, campaign_rows, command_columns
from orthoglide.text import csv_text, printable_path

RETURN_POSTURE = "again"
"""Posture of a move that leads back to where a reading is to be taken after an interruption."""

SKIPPED_POSTURE = "skipped"
"""Posture of a place that was gone to and not read."""

_COLUMNS_BEFORE_COMMANDS = ("kind", "setup", "leg", "direction", "posture")
_COLUMNS_AFTER_COMMANDS = ("gauge_mm", "bar", "repeat", "order", "load_N", "time_s", "reading_mm")


class Record:
    """A campaign file that grows by a row at a time, in the coordinates of a machine's controller.

    It has ``rows``, moves included; ``idle`` is the time in seconds since the last of them, where
    the file was there already.
    """

    def __init__(self, path: Path, machine_file: MachineFile) -> None:
        self.path, self.machine_file = path, machine_file
        self.rows: list[Row] = []
        self.idle = 0.0
        self._columns: tuple[str, ...] = ()
        self._is_stale = False  # whether the file lacks rows, or is as a spreadsheet saved it

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
            FileError: where it is no file of this kind, has rows that cannot be used, or cannot be
                written.
        """
        self._columns = tuple(self.plan(first)[0])
        if not self.path.exists():
            self._write(overwrite=False)
            return False
        text = files.decode(files.read_bytes(self.path), self.path)
        complete = text[: text.rfind("\n") + 1]  # a row that was torn by a power cut is none
        if self._text().startswith(complete or text):  # nothing but the header, or a part of it
            self._write()
            return False
        table = parse_table(complete, self.path)
        if table.names != self._columns:
            problem = "was not begun by this command with this machine file"
            table.fail(f"{problem}: choose another name for --out")
        for column in COLUMNS:
            for name in column.names(self.machine_file.geometry.leg_names):
                table.values(column, name)  # raises
        cells = zip(*table.columns.values(), strict=True)
        self.rows = [dict(zip(table.names, row, strict=True)) for row in cells]
        # No row may be missing, as they determine what is asked next.
        for k, (row, order) in enumerate(zip(self.rows, table.values(ORDER), strict=True)):
            if order != k:
                table.fail(
                    f"has order {order}, not {k}: put back what was removed, of kind move if it is "
                    "not to count, or remove all rows from here on, which are asked for again",
                    k,
                )
            if row["kind"] != "move" and not row["reading_mm"]:
                remedy = "fill it in, or make its kind move if it is not to count"
                table.fail(f"reading_mm is empty: {remedy}", k)
            row["order"] = str(k)
        self.campaign(self.rows)  # raises
        self.idle = max(time.time() - self.path.stat().st_mtime, 0.0)
        self._is_stale = text != self._text()
        return True

    def append(self, row: Row) -> None:
        """Add a row, numbered, and see it on the disk."""
        full = row | {"order": str(len(self.rows))}
        self.rows.append(full)
        if self._is_stale:
            self._write()
            return
        with files.as_file_errors(self.path), open(self.path, "ab") as stream:
            stream.write(csv_text(list(full.values()), ()).encode())
            stream.flush()
            os.fsync(stream.fileno())

    def take_back(self) -> bool:
        """Remove the last reading and what follows it; return whether there was one."""
        readings = [k for k, row in enumerate(self.rows) if row["kind"] != "move"]
        if readings:
            self.rows = self.rows[: readings[-1]]
            self._write()
        return bool(readings)

    def _text(self) -> str:
        return csv_text(self._columns, [row.values() for row in self.rows])

    def _write(self, *, overwrite: bool = True) -> None:
        files.write_file(self.path, self._text(), overwrite=overwrite)
        self._is_stale = False

    def campaign(self, rows: Sequence[Row]) -> Readings | None:
        """Return some of the rows as a campaign, without mountings that were read at one station
        only: their datum is free, so they contain no information. `None` if there are no others.

        Raises:
            FileError: where the readings cannot be used.
        """
        stations: dict[str, set[tuple[str, ...]]] = {}
        for row in rows:
            if row["kind"] != "move":
                command = tuple(row[name] for name in command_columns(row))
                stations.setdefault(row["setup"], set()).add(command)
        if max(map(len, stations.values()), default=0) < 2:
            return None
        unused = {"kind": "move", "reading_mm": ""}
        used = [row if len(stations.get(row["setup"], ())) > 1 else row | unused for row in rows]
        table = rows_table(used, printable_path(self.path))
        return readings_of_table(table, self.path.stem, self.machine_file)
