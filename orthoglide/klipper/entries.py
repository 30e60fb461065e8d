"""Values of a ``printer.cfg`` with the lines and files in which they stand."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import NoReturn

from orthoglide.errors import FileError

_MOST = 1e6  # of anything that a printer's file counts


@dataclass(frozen=True)
class Entry:
    """A value with the line and file in which its key stands."""

    text: str
    line: int
    file: str

    def same(self, other: Entry) -> bool:
        """Whether another says the same, in whatever digits."""
        one, two = ([_plain(cell) for cell in re.split(r"[\s,]+", e.text)] for e in (self, other))
        return one == two


@dataclass
class Section:
    """One section."""

    name: str  # between the brackets
    header: Entry  # where it stands
    entries: dict[str, Entry] = field(default_factory=dict)  # values by key, lower case
    # where else a key may stand: a file that is not here; empty where there is none
    elsewhere: str = ""

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def fail(self, key: str, message: str) -> NoReturn:
        """Refuse the value of a key, or its absence."""
        at = self.entries.get(key, self.header)
        raise FileError(f"[{self.name}] {key} {message}", file=at.file, line=at.line)

    def lack(self, key: str) -> NoReturn:
        """Refuse the absence of a key."""
        self.fail(
            key, f"is missing: add it, or take the file that the firmware saved{self.elsewhere}"
        )

    def number(
        self, key: str, default: float | None = None, low: float = -_MOST, high: float = _MOST
    ) -> float:
        """A number between two limits, the limits themselves excluded."""
        if key not in self.entries:
            if default is None:
                self.lack(key)
            return default
        return self._number(key, self.entries[key].text, low, high)

    def whole(self, key: str, default: int | None = None, low: int = 1, high: int = 100000) -> int:
        """A whole number."""
        value = self.number(key, default, low - 1, high + 1)
        if value != int(value):
            self.fail(key, f"is {value:g}, not a whole number: correct it")
        return int(value)

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        """Numbers parted by commas."""
        if key not in self.entries:
            self.lack(key)
        cells = [c.strip() for c in self.entries[key].text.split(",")]
        if cells and not cells[-1]:
            cells.pop()
        if count is not None and len(cells) != count:
            self.fail(key, f"has {len(cells)} numbers where {count} belong: correct it")
        return [self._number(key, cell, -1e9, 1e9) for cell in cells]

    def table(self, key: str) -> list[list[float]]:
        """Rows of numbers, one a line."""
        if key not in self.entries:
            self.fail(key, "is missing: probe the mesh again, or remove the profile")
        lines = [line for line in self.entries[key].text.split("\n") if line.strip()]
        return [
            [self._number(key, c.strip(), -1e3, 1e3) for c in line.strip().strip(",").split(",")]
            for line in lines
        ]

    def _number(self, key: str, text: str, low: float, high: float) -> float:
        try:
            value = float(text)
        except ValueError:
            self.fail(key, f"is {text[:40]!r}, which is no number: correct it")
        if not (math.isfinite(value) and low < value < high):
            self.fail(key, f"is {text[:40]}, out of the range from {low:g} to {high:g}: correct it")
        return value


def _plain(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell
