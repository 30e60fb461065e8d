"""A ``printer.cfg`` as sections of text with their lines: written, included and saved ones."""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.foreign import refuse_foreign
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.text import printable_path

_SAVED_MARK = "#*#"
_HEADER = re.compile(r"#\*#\s*<-+ *SAVE_CONFIG *-+>")
_SECTION = re.compile(r"\[([^\]]+)\]")
_ENTRY = re.compile(r"([^\s:=#;\[][^:=]*?)\s*[:=]\s*(.*)$")
_COMMENT = re.compile(r"#.*$|(?:^|\s);.*$")
_ROW = re.compile(r"[-+.,\d\seE]+$")
_TEMPERATURE = re.compile(r"(?:\w+_)?temp(?:erature)?(?:_c)?")
_READ_SECTIONS = (
    "printer",
    "stepper_a",
    "stepper_b",
    "stepper_c",
    "delta_calibrate",
    "bed_mesh",
    "probe",
)
_MAX_INCLUDE_DEPTH = 8  # files that include one another
_SECTIONS = (*_READ_SECTIONS, "include", "bltouch", "smart_effector", "beacon", "cartographer")
_WEB_CHARACTERS = {0x200B: None, 0xFEFF: None, 0x2212: "-"}  # what web pages put into pasted text
_SAVED_KEYS = {  # by the kind of section in which alone SAVE_CONFIG writes them
    "printer": re.compile("delta_radius"),
    "delta_calibrate": re.compile(r"(height|distance)\d+(_pos\d?)?"),
    "bed_mesh": re.compile(r"points|[xy]_count|mesh_[xy]_pps"),
}
_MAX_NUMBER = 1e6  # of anything that a printer's file counts

BROKEN_HEADER = "broken header"
"""Kind of a note on a section that is lost, as its header is missing or cannot be read."""

Lines = Sequence[tuple[int, str]]
"""Lines of text with their numbers."""


@dataclass(frozen=True)
class Entry:
    """A value with the line and file in which its key stands."""

    text: str
    line: int
    file: str

    @property
    def values(self) -> list[float | str]:
        """Cells of the value, those that are numbers as such."""
        return [_cell(text) for text in re.split(r"[\s,]+", self.text)]


def _cell(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


@dataclass
class ConfigSection:
    """A section of the file."""

    name: str  # between the brackets
    header: Entry  # where it stands
    entries: dict[str, Entry] = field(default_factory=dict)  # values by key, lower case
    missing_includes: Sequence[
        str
    ] = ()  # included files that were not found and may have more of its keys

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def fail(self, key: str, message: str) -> NoReturn:
        """Refuse the value of a key, or its absence."""
        at = self.entries.get(key, self.header)
        raise FileError(f"[{self.name}] {key} {message}", file=at.file, line=at.line)

    def text(self, key: str) -> str:
        """Return the value of a key that must be there."""
        if key not in self.entries:
            remedy = f"add it, or take the file that the firmware saved{_include_hint(self.missing_includes)}"
            self.fail(key, f"is missing: {remedy}")
        return self.entries[key].text

    def number(
        self,
        key: str,
        default: float | None = None,
        low: float = -_MAX_NUMBER,
        high: float = _MAX_NUMBER,
    ) -> float:
        """Return a number between two limits, the limits themselves excluded."""
        if key not in self.entries and default is not None:
            return default
        return self._number(key, self.text(key), low, high)

    @property
    def temperature(self) -> float:
        """Temperature that was stored with it, degrees Celsius; nan where none was."""
        found = (e.text for key, e in self.entries.items() if _TEMPERATURE.fullmatch(key))
        value = _cell(next(found, "nan"))
        return math.nan if isinstance(value, str) else value

    def table(self, key: str) -> list[list[float]]:
        """Return rows of numbers, one a line, parted by commas."""
        lines = [line.strip().removesuffix(",") for line in self.text(key).split("\n")]
        return [
            [self._number(key, cell.strip(), -1e9, 1e9) for cell in line.split(",")]
            for line in lines
            if line
        ]

    def numbers(self, key: str, count: int) -> list[float]:
        """Return so many numbers, parted by commas."""
        cells = [cell for row in self.table(key) for cell in row]
        if len(cells) != count:
            self.fail(key, f"has {len(cells)} numbers where {count} belong: correct it")
        return cells

    def _number(self, key: str, text: str, low: float, high: float) -> float:
        value = _cell(text)
        if isinstance(value, str):
            self.fail(
                key,
                f"is {text[:40]!r}, which is no number: write digits with a decimal point, and no "
                f"unit",
            )
        if not (math.isfinite(value) and low < value < high):
            self.fail(
                key,
                f"is {text[:40]}, out of the range from {compact(low, 6)} to {compact(high, 6)}: "
                "correct it",
            )
        return value


@dataclass
class Config:
    """The file, with those that it includes."""

    file: str  # its name
    sha256: str  # its digest
    folder: Path  # in which it stands: nothing outside it is read
    sections: dict[str, ConfigSection] = field(default_factory=dict)  # in the order of the file
    missing_includes: list[str] = field(default_factory=list)  # included files that were not found
    notes: list[Note] = field(default_factory=list)  # of what was noticed on reading it
    # line, key and section of keys that stand there a second time
    repeated_keys: list[tuple[int, str, str]] = field(default_factory=list)

    def note(self, kind: str, text: str) -> None:
        """Note something for the owner."""
        self.notes.append(Note(text, kind))

    def number_or_zero(self, name: str, key: str, low: float, high: float) -> float:
        """Return a number of a section, or 0 with a note where it is missing or of no use."""
        section = self.sections.get(name)
        try:
            return section.number(key, 0.0, low, high) if section else 0.0
        except FileError as error:
            self.note("readings", f"{error}; 0 is taken")
            del self.sections[name].entries[key]
            return 0.0

    def section(self, name: str) -> ConfigSection:
        """Return a section that must be there.

        Raises:
            FileError: where it is not.
        """
        if name not in self.sections:
            message = f"has no section [{name}]: add it{_include_hint(self.missing_includes)}"
            if not any(one.split(" ")[0] in _READ_SECTIONS for one in self.sections):
                message = (
                    f"has none of the sections of a printer.cfg, such as [{name}]: give the file "
                    f"as the firmware saved it, without marks before its lines"
                )
            raise FileError(message, file=self.file)
        return self.sections[name]

    def section_or_empty(self, name: str) -> ConfigSection:
        """Return a section, empty where it is not there."""
        return self.sections.get(name) or ConfigSection(name, Entry("", 1, self.file))

    def sections_of_kind(self, *kinds: str) -> Iterator[ConfigSection]:
        """Return sections whose first word is one of these, in the order of the file."""
        return (s for name, s in self.sections.items() if name.split(" ")[0] in kinds)


def read_config(path: str | os.PathLike[str]) -> Config:
    """Read a ``printer.cfg``, or that of a folder, and the files that it includes.

    As in the firmware, what its owner wrote goes before what SAVE_CONFIG wrote at its end.

    Raises:
        FileError: where it is missing, is another firmware's, or the firmware would not read what
            it saved.
    """
    path = Path(files.result_file(path, "printer.cfg"))
    content = files.read_bytes(path)
    refuse_foreign(path, content[: files.TEXT_LIMIT], accepted=("klipper",))
    if len(content) > files.TEXT_LIMIT:
        raise FileError(
            f"is larger than {files.TEXT_LIMIT // 2**20} MB: give the right file",
            file=printable_path(path),
        )
    config = Config(printable_path(path), files.sha256(content), path.parent)
    lines = _lines(content, path)
    _parse(config, _written_lines(lines), path, (path,))
    saved = Config(config.file, config.sha256, path.parent)
    _parse(saved, _saved_lines(lines, printable_path(path)), path, (path,))
    _add_saved(config, saved)
    for section in config.sections.values():
        section.missing_includes = config.missing_includes
    return config


def _lines(content: bytes, path: Path) -> Lines:
    """Return lines with their numbers; of comments in any alphabet, as only numbers are read."""
    text = files.decode(content, path, errors="replace")
    return list(enumerate(re.split(r"\r\n|\r|\n", text.translate(_WEB_CHARACTERS)), start=1))


def _written_lines(lines: Lines) -> Lines:
    """Return the lines that SAVE_CONFIG did not write."""
    return [(k, line) for k, line in lines if not line.lstrip().startswith(_SAVED_MARK)]


def _saved_lines(lines: Lines, file: str) -> Lines:
    """Return the lines that SAVE_CONFIG wrote, without their marks.

    Raises:
        FileError: where the firmware would leave them out.
    """
    headers = [k for k, line in lines if _HEADER.match(line.lstrip())]
    first = headers[0] if headers else 1
    below = [k for k, line in _written_lines(lines) if k > first and line.strip()]
    for wrong, what in ((headers[1:], "a second header"), (below, f"a line without {_SAVED_MARK}")):
        if headers and wrong:
            raise FileError(
                f"{what} stands below the header of SAVE_CONFIG (line {first}), and the firmware "
                f"then leaves the whole block out: put {_SAVED_MARK} before it if it belongs to the "
                f"block, else move it above the header or remove it",
                file=file,
                line=wrong[0],
            )
    return [
        (k, line.lstrip().removeprefix(_SAVED_MARK).removeprefix(" "))
        for k, line in lines
        if line.lstrip().startswith(_SAVED_MARK) and k >= first
    ]


def _lost_headers(saved: Config) -> Iterator[Note]:
    """Yield a note where a header was lost: below it a key stands twice in a section, or in a
    section of another kind than SAVE_CONFIG writes it in.
    """
    found = [
        (line, f"{key} stands twice in [{name}]", "it") for line, key, name in saved.repeated_keys
    ]
    for kind, keys in _SAVED_KEYS.items():
        found += [
            (entry.line, f"{key} stands in [{name}]", f"[{kind}]")
            for name, section in saved.sections.items() if name.partition(" ")[0] != kind
            for key, entry in section.entries.items() if keys.fullmatch(key)
        ]  # fmt: skip
    for line, what, header in sorted(found)[:1]:
        yield Note(
            f"{saved.file}, line {line}: {what}, so the header above it was lost: write {header} "
            f"there, else what stands below it is left out",
            BROKEN_HEADER,
        )


def _add_saved(config: Config, saved: Config) -> None:
    """Add what SAVE_CONFIG wrote where nothing else gives it, with a note of other values above."""
    twice = list[str]()
    config.notes += [*saved.notes, *_lost_headers(saved)]
    for name, section in saved.sections.items():
        own = config.sections.setdefault(name, section)
        for key, below in section.entries.items():
            above = own.entries.setdefault(key, below)
            differs = above is not below and above.values != below.values
            if differs and name.partition(" ")[0] in _READ_SECTIONS:
                values = f"{_value_text(above, config)}, below {_value_text(below, config)}"
                twice.append(f"[{name}] {key}: {values}")
    if twice:
        config.notes.insert(0, Note(
            f"{Path(config.file).name} has other values above the header of SAVE_CONFIG than below "
            f"it, and the firmware takes those above, as is done here: {'; '.join(twice)}. Remove "
            f"the lines that are not meant: what is pasted below the header has no effect while "
            f"the same key stands above it", "twice",
        ))  # fmt: skip


def _value_text(entry: Entry, config: Config) -> str:
    file = f" of {entry.file}" if entry.file != config.file else ""
    return f"{' '.join(entry.text.split())[:40]} (line {entry.line}{file})"


def _include_hint(missing: Sequence[str]) -> str:
    if not missing:
        return ""
    names = ", ".join(map(repr, dict.fromkeys(missing)))
    return f" (it may stand in {names}: put that beside this file)"


def _parse(config: Config, lines: Lines, path: Path, within: tuple[Path, ...]) -> None:
    """Add the sections of lines to those of a file; ``within``: the files that led here."""
    section: ConfigSection | None = None
    key, level = "", 0
    for number, line in lines:
        bare = _COMMENT.sub("", line).rstrip()
        text = bare.strip()
        if not text:
            continue
        indent = len(bare) - len(bare.lstrip())
        row = key == "points" and _ROW.match(text)  # pasted without its indentation
        if section is not None and key and (indent > level or row):
            before = section.entries[key]
            section.entries[key] = replace(before, text=f"{before.text}\n{text}")
            continue
        level = indent
        if found := _SECTION.match(text):
            name, key = _section_name(found[1]), ""
            section = ConfigSection(name, Entry("", number, printable_path(path)))
            if name.startswith("include "):
                _include(config, name.removeprefix("include "), path, within)
            else:
                section = config.sections.setdefault(name, section)
        elif (found := _ENTRY.match(text)) and section is not None:
            key = found[1].strip().lower()
            if key in section.entries:
                config.repeated_keys.append((number, key, section.name))
            section.entries[key] = Entry(found[2].strip(), number, printable_path(path))
        elif meant := _broken_header(text):  # what follows belongs to nothing
            section, key = ConfigSection("", Entry("", number, printable_path(path))), ""
            at = f"{printable_path(path)}, line {number}: {text[:40]!r}"
            config.note(BROKEN_HEADER, f"{at} is no '[section]' and is left out with all that follows up "
                        f"to the next one: write [{meant[:40]}]")  # fmt: skip
        elif (section and section.name.split(" ")[0] in _READ_SECTIONS) or found:
            why = "it is no 'key: value'" if section else "no section stands above it"
            at = f"{printable_path(path)}, line {number}"
            config.note("line", f"{at}: {text[:40]!r} is left out, as {why}")


def _broken_header(text: str) -> str:
    """Return the section that a line without complete brackets names; empty where it names none.

    A line is a broken header if it has one of the brackets, or only the name of a section that is
    read. Lines of 'key: value' are recognised before.
    """
    inner = _section_name(text.strip("[](){}<> "))
    bracketed = text.startswith("[") or text.endswith("]")
    return inner if bracketed or inner.split(" ")[0] in _SECTIONS else ""


def _section_name(text: str) -> str:
    """Return the name of a section; one that is read in small letters, as the firmware wants it."""
    kind, *rest = text.split() or [""]
    return " ".join((kind.lower() if kind.lower() in _SECTIONS else kind, *rest))


def _include(config: Config, pattern: str, path: Path, within: tuple[Path, ...]) -> None:
    """Read files that one names from where it stands, within the first one's folder.

    What lies elsewhere on the printer's own computer is looked for beside, by its name.
    """
    folder = glob.escape(os.path.relpath(path.parent, config.folder))
    wanted = os.path.normpath(os.path.join(folder, pattern))
    if os.path.isabs(wanted) or wanted.split(os.sep)[0] == os.pardir:
        wanted = os.path.normpath(os.path.join(folder, glob.escape(Path(pattern).name)))
    try:
        found = sorted(config.folder.glob(wanted))
    except (ValueError, OSError, NotImplementedError):  # no pattern that a folder has
        found = []
    if not found:
        config.missing_includes.append(pattern)
    for other in found:
        if other.is_file() and other not in within and len(within) < _MAX_INCLUDE_DEPTH:
            lines = _lines(files.read_bytes(other, files.TEXT_LIMIT), other)
            _parse(config, _written_lines(lines), other, (*within, other))
