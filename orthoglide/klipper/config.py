"""A ``printer.cfg`` as sections of text with their lines, what the firmware saved included."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from typing import NoReturn

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.text import shown

_SAVED = "#*#"
_SECTION = re.compile(r"\[([^\]]*)\]\s*(?:[#;].*)?$")
_ENTRY = re.compile(r"([^\s:=#;\[][^:=]*?)\s*[:=]\s*(.*)$")
_COMMENT = re.compile(r"(?:^|\s)[#;].*$")
_READ = ("printer", "stepper_a", "stepper_b", "stepper_c", "delta_calibrate", "bed_mesh", "probe")
_MOST = 1e6  # of anything that a printer's file counts


@dataclass(frozen=True)
class Entry:
    """A value with the line on which its key stands."""

    text: str
    line: int


@dataclass
class Section:
    """One section of the file.

    Attributes:
        name: between the brackets.
        line: of its header.
        file: name for errors.
        entries: values by key, lower case.
    """

    name: str
    line: int
    file: str
    entries: dict[str, Entry] = field(default_factory=dict)

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def fail(self, key: str, message: str) -> NoReturn:
        """Refuse the value of a key, or its absence."""
        line = self.entries[key].line if key in self.entries else self.line
        raise FileError(f"[{self.name}] {key} {message}", file=self.file, line=line)

    def number(
        self, key: str, default: float | None = None, low: float = -_MOST, high: float = _MOST
    ) -> float:
        """A number between two limits, the limits themselves excluded."""
        if key not in self.entries:
            if default is None:
                self.fail(key, "is missing: add it, or take the file that the firmware saved")
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
            self.fail(key, "is missing: add it, or take the file that the firmware saved")
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


@dataclass(frozen=True)
class Config:
    """The file.

    Attributes:
        file: its name.
        sha256: its digest.
        sections: by name, in the order of the file.
        includes: other files that it names, which are not read.
    """

    file: str
    sha256: str
    sections: dict[str, Section]
    includes: tuple[str, ...]

    def section(self, name: str) -> Section:
        """A section that must be there.

        Raises:
            FileError: where it is not.
        """
        if name not in self.sections:
            more = f" (it may stand in {self.includes[0]!r}: paste it in)" if self.includes else ""
            raise FileError(f"has no section [{name}]: add it{more}", file=self.file)
        return self.sections[name]

    def optional(self, name: str) -> Section:
        """A section, empty where it is not there."""
        return self.sections.get(name) or Section(name, 1, self.file)


def read_config(path: str | os.PathLike[str]) -> Config:
    """Read a ``printer.cfg``; what the firmware saved at its end goes before what stands above.

    Raises:
        FileError: where it is missing, no text, or a line is neither section nor entry.
    """
    content = files.read_bytes(path, files.TEXT)
    text = files.decode(content, path)
    lines = text.split("\n")
    own, saved = [], []
    for number, line in enumerate(lines, start=1):
        line = line.rstrip("\r")
        if line.startswith(_SAVED):
            body = line[len(_SAVED) :]
            saved.append((number, body[1:] if body.startswith(" ") else body))
        else:
            own.append((number, line))
    sections: dict[str, Section] = {}
    includes: list[str] = []
    _parse(own, shown(path), sections, includes)
    _parse(saved, shown(path), sections, includes)
    return Config(shown(path), files.sha256(content), sections, tuple(includes))


def _parse(
    lines: list[tuple[int, str]],
    file: str,
    sections: dict[str, Section],
    includes: list[str],
) -> None:
    here: Section | None = None
    key = ""
    for number, line in lines:
        bare = _COMMENT.sub("", line).rstrip()
        if not bare.strip():
            continue
        if here is not None and key and bare[0] in " \t":  # goes on with the value above
            before = here.entries[key]
            here.entries[key] = Entry(f"{before.text}\n{bare.strip()}", before.line)
        elif found := _SECTION.match(bare.strip()):
            name, key = " ".join(found[1].split()), ""
            if name.startswith("include "):
                includes.append(name.removeprefix("include "))
                here = Section(name, number, file)
            else:
                here = sections.setdefault(name, Section(name, number, file))
        elif found := _ENTRY.match(bare.strip()):
            if here is None:
                raise FileError(
                    "a value stands before the first section: put a section such as [printer] "
                    "above it", file=file, line=number,
                )  # fmt: skip
            key = found[1].strip().lower()
            here.entries[key] = Entry(found[2].strip(), number)
        elif here is not None and here.name.partition(" ")[0] in _READ:
            raise FileError(
                f"{bare.strip()[:40]!r} is neither a section nor 'key: value': correct the line",
                file=file,
                line=number,
            )
