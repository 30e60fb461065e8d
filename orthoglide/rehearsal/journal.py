"""File of the finished campaigns of a rehearsal, from which a stopped run is resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from orthoglide import __version__
from orthoglide.errors import FileError
from orthoglide.files import as_file_errors, read_bytes, sha256, write_file
from orthoglide.machine_file.writing import machine_text
from orthoglide.observations import readings_text
from orthoglide.rehearsal.outcome import Outcome
from orthoglide.rehearsal.random_machines import Scope
from orthoglide.text import printable_path


def request_digests(scope: Scope, seed: int) -> dict[str, str]:
    """Return what determines every campaign, files by their digests."""
    machine = machine_text(scope.machine.spec) + " ".join(scope.machine.catalogue)
    return {
        "the version of orthoglide": __version__,
        "the machine file": sha256(machine.encode()),
        "the sheet": sha256(readings_text(scope.sheets, scope.machine.spec).encode()),
        "the seed": str(seed),
    }


class Journal:
    """The file of finished campaigns: the request in its first line, then a campaign a line.

    Args:
        folder: that contains it; new, empty, or of an earlier run.
        request: see :func:`request_digests`.
        campaigns: that are asked for.

    Raises:
        FileError: if the folder contains something else, or campaigns of another request, or more
            of them.
    """

    def __init__(self, folder: Path, request: Mapping[str, str], campaigns: int) -> None:
        self.path = folder / "campaigns.jsonl"
        self.finished: dict[int, Outcome] = {}
        with as_file_errors(folder):
            folder.mkdir(exist_ok=True)
            begun = self.path.exists()
            if not begun and any(folder.iterdir()):
                raise FileError(
                    "is not empty and holds no earlier rehearsal: name a new or empty folder",
                    file=printable_path(folder),
                )
        if not begun:
            write_file(self.path, json.dumps(dict(request)) + "\n", overwrite=False)
            return
        self._read(request)
        if (count := max(self.finished, default=-1) + 1) > campaigns:
            raise FileError(
                f"holds a rehearsal of {count} campaigns, and its table is not replaced by one "
                f"of {campaigns}: ask for {count} or more, or name another folder",
                file=printable_path(folder),
            )

    def _read(self, request: Mapping[str, str]) -> None:
        content = read_bytes(self.path)
        complete = content[: content.rfind(b"\n") + 1]
        try:
            stored_request, *records = map(json.loads, complete.decode().splitlines())
            differences = [k for k, v in request.items() if stored_request[k] != v]
            self.finished = {record["number"]: Outcome.from_dict(record) for record in records}
        except (ValueError, TypeError, KeyError, AttributeError):
            raise FileError(
                "holds no campaigns of a rehearsal: name another folder",
                file=printable_path(self.path),
            ) from None
        if differences:
            raise FileError(
                f"holds campaigns of another rehearsal, as {' and '.join(differences)} "
                f"{'is' if len(differences) == 1 else 'are'} not the same: name another folder",
                file=printable_path(self.path),
            )
        if len(complete) < len(content):  # stopped while a line was written
            with as_file_errors(self.path):
                os.truncate(self.path, len(complete))

    def add(self, outcome: Outcome) -> None:
        """Write one more outcome to the file, at once."""
        self.finished[outcome.number] = outcome
        line = json.dumps(outcome.as_dict(), allow_nan=False) + "\n"
        with as_file_errors(self.path), self.path.open("a", encoding="utf-8") as file:
            file.write(line)

    def conclude(self, table: str) -> None:
        """Write the table of all campaigns beside it, in place of an earlier one."""
        write_file(self.path.with_name("rehearsal.txt"), table, overwrite=True)
