"""A ``printer.cfg`` as sections of text with their lines: its own, included and saved ones."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.klipper.entries import Entry, Section
from orthoglide.klipper.foreign import foreign
from orthoglide.text import shown

_SAVED = "#*#"
_HEADER = re.compile(r"#\*#\s*<-+ *SAVE_CONFIG *-+>")
_SECTION = re.compile(r"\[([^\]]+)\]")
_ENTRY = re.compile(r"([^\s:=#;\[][^:=]*?)\s*[:=]\s*(.*)$")
_COMMENT = re.compile(r"#.*$|(?:^|\s);.*$")
_ROW = re.compile(r"[-+.,\d\seE]+$")
_READ = ("printer", "stepper_a", "stepper_b", "stepper_c", "delta_calibrate", "bed_mesh", "probe")
_NAMED = 5  # files that are missing
_DEEPEST = 8  # files that include one another


@dataclass(frozen=True)
class Override:
    """A value above the header of SAVE_CONFIG, which the firmware takes, and another below it."""

    section: str  # its name
    key: str
    own: Entry  # above
    saved: Entry  # below


@dataclass(frozen=True)
class Config:
    """The file, with those that it includes."""

    file: str  # its name
    sha256: str  # its digest
    sections: dict[str, Section]  # by name, in the order of the file
    missing: tuple[str, ...]  # files that it includes and that are not beside it
    overrides: tuple[Override, ...] = ()  # what it says twice, and differently

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

    @property
    def as_saved(self) -> Config:
        """The same by the values below the header of SAVE_CONFIG."""
        sections = dict(self.sections)
        for one in self.overrides:
            own = sections[one.section]
            sections[one.section] = replace(own, entries={**own.entries, one.key: one.saved})
        return replace(self, sections=sections, overrides=())


def read_config(path: str | os.PathLike[str]) -> Config:
    """Read a ``printer.cfg``, or that of a folder, and the files that it includes.

    As in the firmware, what its owner wrote goes before what SAVE_CONFIG wrote at its end.

    Raises:
        FileError: where it is missing, no text, a line is neither section nor entry, or the
            firmware would not read what it saved.
    """
    path = files.inside(path, "printer.cfg")
    content = files.read_bytes(path)
    told = foreign(content[: files.TEXT])
    if told or len(content) > files.TEXT:
        too_large = f"is larger than {files.TEXT // 2**20} MB: give the right file"
        raise FileError(told or too_large, file=shown(path))
    reader = _Reader(Path(path).parent)
    reader.read(content, Path(path), ())
    missing = tuple(dict.fromkeys(reader.missing))
    for section in reader.sections.values():
        section.elsewhere = _elsewhere(missing)
    return Config(
        shown(path), files.sha256(content), reader.sections, missing, tuple(reader.overrides)
    )


def _elsewhere(missing: tuple[str, ...]) -> str:
    if not missing:
        return ""
    one = "that file" if len(missing) == 1 else "those files"
    return f" (it may stand in {these(missing)}: put {one} where this one includes them)"


def these(missing: tuple[str, ...]) -> str:
    """Names of files that are not here, as far as there are few."""
    names = [repr(name) for name in missing[:_NAMED]]
    names += [f"{len(missing) - _NAMED} more"] * (len(missing) > _NAMED)
    *most, last = names
    return f"{', '.join(most)} or {last}" if most else last


def _header(lines: list[tuple[int, str]], path: Path) -> int:
    """Line of the header of SAVE_CONFIG; 1 where there is none.

    Raises:
        FileError: where the firmware would leave out what stands below it.
    """
    found = [number for number, line in lines if _HEADER.match(line.lstrip())]
    if len(found) > 1:
        raise FileError(
            f"a second header of SAVE_CONFIG, after that of line {found[0]}: the firmware reads "
            f"neither block; remove the older one", file=shown(path), line=found[1],
        )  # fmt: skip
    for number, line in lines if found else ():
        bare = line.strip()
        if number > found[0] and bare and not bare.startswith(_SAVED):
            raise FileError(
                f"{bare[:40]!r} stands below the header of SAVE_CONFIG (line {found[0]}), where "
                f"the firmware allows lines that begin with {_SAVED} only, and leaves the whole "
                f"block out: move it above the header",
                file=shown(path),
                line=number,
            )
    return found[0] if found else 1


class _Reader:
    """Sections as they fill, file by file, line by line."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder  # of the first file: nothing outside it is read
        self.sections: dict[str, Section] = {}
        self.missing: list[str] = []
        self.overrides: list[Override] = []

    def read(self, content: bytes, path: Path, within: tuple[Path, ...]) -> None:
        """One file's text; ``within``: the files that led here."""
        # A vendor's comments may be in any alphabet: only numbers are read.
        text = files.decode(content, path, errors="replace")
        lines = list(enumerate(re.split(r"\r\n|\r|\n", text), start=1))
        first = 1 if within else _header(lines, path)
        own, saved = [], []
        for number, line in lines:
            bare = line.lstrip()
            if not bare.startswith(_SAVED):
                own.append((number, line))
            elif number >= first:
                saved.append((number, bare[len(_SAVED) :].removeprefix(" ")))
        self._parse(own, path, (*within, path))
        if not within:
            self._add_saved(saved, path)

    def _add_saved(self, lines: list[tuple[int, str]], path: Path) -> None:
        """What SAVE_CONFIG wrote, where nothing else says it."""
        own, self.sections = self.sections, {}
        self._parse(lines, path, (path,), saved=True)
        saved, self.sections = self.sections, own
        for name, section in saved.items():
            here = own.setdefault(name, section)
            for key, entry in section.entries.items():
                kept = here.entries.setdefault(key, entry)
                if not kept.same(entry) and name.partition(" ")[0] in _READ:
                    self.overrides.append(Override(name, key, kept, entry))

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
        """Files that one names from where it stands, within the first one's folder; no others of
        this computer are read.

        What lies elsewhere on the printer's own computer is looked for beside, by its name.
        """
        here = glob.escape(os.path.relpath(path.parent, self.folder))
        wanted = os.path.normpath(os.path.join(here, pattern))
        if os.path.isabs(wanted) or wanted.split(os.sep)[0] == os.pardir:
            wanted = os.path.normpath(os.path.join(here, glob.escape(Path(pattern).name)))
        try:
            found = sorted(self.folder.glob(wanted))
        except (ValueError, OSError, NotImplementedError):  # no pattern that a folder has
            found = []
        if not found:
            self.missing.append(pattern)
        for other in found:
            if other.is_file() and other not in within and len(within) < _DEEPEST:
                self.read(files.read_bytes(other, files.TEXT), other, within)
