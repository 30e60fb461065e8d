"""A ``printer.cfg`` as sections of text with their lines: its own, included and saved ones."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.text import shown

_SAVED = "#*#"
_SECTION = re.compile(r"\[([^\]]+)\]")
_ENTRY = re.compile(r"([^\s:=#;\[][^:=]*?)\s*[:=]\s*(.*)$")
_COMMENT = re.compile(r"#.*$|(?:^|\s);.*$")
_ROW = re.compile(r"[-+.,\d\seE]+$")
_READ = ("printer", "stepper_a", "stepper_b", "stepper_c", "delta_calibrate", "bed_mesh", "probe")
_DEEPEST = 8  # files that include one another
_MOST = 1e6  # of anything that a printer's file counts


@dataclass(frozen=True)
class Entry:
    """A value with the line and file in which its key stands."""

    text: str
    line: int
    file: str


@dataclass
class Section:
    """One section.

    Attributes:
        name: between the brackets.
        header: where it stands.
        entries: values by key, lower case.
        elsewhere: where else a key may stand: a file that is not here; empty where there is none.
    """

    name: str
    header: Entry
    entries: dict[str, Entry] = field(default_factory=dict)
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


@dataclass(frozen=True)
class Config:
    """The file, with those that it includes.

    Attributes:
        file: its name.
        sha256: its digest.
        sections: by name, in the order of the file.
        missing: files that it includes and that are not beside it.
    """

    file: str
    sha256: str
    sections: dict[str, Section]
    missing: tuple[str, ...]

    def section(self, name: str) -> Section:
        """A section that must be there.

        Raises:
            FileError: where it is not.
        """
        if name not in self.sections:
            more = _elsewhere(self.missing)
            raise FileError(f"has no section [{name}]: add it{more}", file=self.file)
        return self.sections[name]

    def optional(self, name: str) -> Section:
        """A section, empty where it is not there."""
        return self.sections.get(name) or Section(name, Entry("", 1, self.file))

    def named(self, *kinds: str) -> Iterator[Section]:
        """Sections whose first word is one of these, in the order of the file."""
        return (s for name, s in self.sections.items() if name.split(" ")[0] in kinds)


def read_config(path: str | os.PathLike[str]) -> Config:
    """Read a ``printer.cfg`` and the files that it includes, where they stand beside it.

    What the firmware saved at its end goes before what stands above.

    Raises:
        FileError: where it is missing, no text, or a line is neither section nor entry.
    """
    content = files.read_bytes(path, files.TEXT)
    reader = _Reader()
    reader.read(content, Path(path), ())
    missing = tuple(dict.fromkeys(reader.missing))
    for section in reader.sections.values():
        section.elsewhere = _elsewhere(missing)
    return Config(shown(path), files.sha256(content), reader.sections, missing)


def _elsewhere(missing: tuple[str, ...]) -> str:
    return f" (it may stand in {missing[0]!r}: put that file beside this one)" if missing else ""


class _Reader:
    """Sections as they fill, file by file, line by line."""

    def __init__(self) -> None:
        self.sections: dict[str, Section] = {}
        self.missing: list[str] = []

    def read(self, content: bytes, path: Path, within: tuple[Path, ...]) -> None:
        """One file's text; ``within``: the files that led here."""
        # A vendor's comments may be in any alphabet: only numbers are read.
        text = files.decode(content, path, errors="replace")
        own, saved = [], []
        for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
            bare = line.lstrip()
            if bare.startswith(_SAVED):
                saved.append((number, bare[len(_SAVED) :].removeprefix(" ")))
            else:
                own.append((number, line))
        self._parse(own, path, (*within, path))
        if not within:
            self._parse(saved, path, (path,), saved=True)

    def _parse(
        self,
        lines: list[tuple[int, str]],
        path: Path,
        within: tuple[Path, ...],
        saved: bool = False,
    ) -> None:
        here: Section | None = None
        key, level = "", 0
        for number, line in lines:
            bare = _COMMENT.sub("", line).rstrip()
            told = bare.strip()
            if not told:
                continue
            indent = len(bare) - len(bare.lstrip())
            row = key == "points" and _ROW.match(told)  # pasted without its indentation
            if here is not None and key and (indent > level or row):
                before = here.entries[key]
                here.entries[key] = replace(before, text=f"{before.text}\n{told}")
                continue
            level = indent
            if found := _SECTION.match(told):
                name, key = " ".join(found[1].split()), ""
                if name.startswith("include "):
                    self._include(name.removeprefix("include "), path, within)
                    here = Section(name, Entry("", number, shown(path)))
                else:
                    new = Section(name, Entry("", number, shown(path)))
                    here = self.sections.setdefault(name, new)
            elif (found := _ENTRY.match(told)) and here is not None:
                key = found[1].strip().lower()
                here.entries[key] = Entry(found[2].strip(), number, shown(path))
            elif here is None and not saved and found:
                raise FileError(
                    "a value stands before the first section: put a section such as [printer] "
                    "above it", file=shown(path), line=number,
                )  # fmt: skip
            elif here is not None and here.name.partition(" ")[0] in _READ:
                raise FileError(
                    f"{told[:40]!r} is neither a section nor 'key: value': correct the line",
                    file=shown(path),
                    line=number,
                )

    def _include(self, pattern: str, path: Path, within: tuple[Path, ...]) -> None:
        """Files beside the one that names them; no others of this computer are read."""
        inside = not Path(pattern).is_absolute() and ".." not in Path(pattern).parts
        try:
            found = sorted(path.parent.glob(pattern)) if inside else []
        except (ValueError, OSError, NotImplementedError):  # no pattern that a folder has
            found = []
        if not found:
            self.missing.append(pattern)
        for other in found:
            if other.is_file() and other not in within and len(within) < _DEEPEST:
                self.read(files.read_bytes(other, files.TEXT), other, within)
