"""A ``printer.cfg`` as sections of text with their lines: written, included and saved ones."""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
    "printer", "stepper_a", "stepper_b", "stepper_c", "delta_calibrate", "bed_mesh", "probe",
)  # fmt: skip
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
    missing_includes: Sequence[str] = ()  # files not found, which may have more of its keys

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def fail(self, key: str, message: str) -> NoReturn:
        """Refuse the value of a key, or its absence."""
        entry = self.entries.get(key, self.header)
        raise FileError(f"[{self.name}] {key} {message}", file=entry.file, line=entry.line)

    def text(self, key: str) -> str:
        """Return the value of a key that must be there."""
        if key not in self.entries:
            hint = _include_hint(self.missing_includes)
            self.fail(key, f"is missing: add it, or take the file that the firmware saved{hint}")
        return self.entries[key].text

    def number(
        self, key: str, default: float | None = None, low: float = -_MAX_NUMBER,
        high: float = _MAX_NUMBER,
    ) -> float:  # fmt: skip
        """Return a number between two limits, the limits themselves excluded."""
        if key not in self.entries and default is not None:
            return default
        return self._number(key, self.text(key), low, high)

    @property
    def temperature(self) -> float:
        """Temperature that is stored in the section, degrees Celsius; nan without one."""
        texts = (entry.text for key, entry in self.entries.items() if _TEMPERATURE.fullmatch(key))
        value = _cell(next(texts, "nan"))
        return math.nan if isinstance(value, str) else value

    def table(self, key: str) -> list[list[float]]:
        """Return rows of numbers separated by commas, one row a line."""
        lines = (line.strip().removesuffix(",") for line in self.text(key).split("\n"))
        return [
            [self._number(key, cell.strip(), -1e9, 1e9) for cell in line.split(",")]
            for line in filter(None, lines)
        ]

    def numbers(self, key: str, count: int) -> list[float]:
        """Return ``count`` numbers separated by commas."""
        cells = [cell for row in self.table(key) for cell in row]
        if len(cells) != count:
            self.fail(key, f"has {len(cells)} numbers where {count} belong: correct it")
        return cells

    def _number(self, key: str, text: str, low: float, high: float) -> float:
        value = _cell(text)
        if isinstance(value, str):
            remedy = "write digits with a decimal point, and no unit"
            self.fail(key, f"must be a number, not {text[:40]!r}: {remedy}")
        if not (math.isfinite(value) and low < value < high):
            limits = f"{compact(low, 6)} to {compact(high, 6)}"
            self.fail(key, f"is {text[:40]}, out of the range from {limits}: correct it")
        return value


@dataclass
class Config:
    """A file together with those that it includes."""

    file: str  # its name
    sha256: str  # its digest
    folder: Path  # in which it stands: nothing outside it is read
    sections: dict[str, ConfigSection] = field(default_factory=dict)  # in the order of the file
    missing_includes: list[str] = field(default_factory=list)  # included files that were not found
    notes: list[Note] = field(default_factory=list)  # for the owner
    # line, key and section of every key that a section has a second time
    repeated_keys: list[tuple[int, str, str]] = field(default_factory=list)

    def note(self, kind: str, text: str) -> None:
        """Add a note for the owner."""
        self.notes.append(Note(text, kind))

    @contextmanager
    def leaving_out(
        self, what: str = "", kind: str = "readings", instead: str = ""
    ) -> Iterator[None]:
        """Leave out what is read within the block, with a note of a kind, if the file has it wrong;
        ``instead``: what is taken, if anything.
        """
        try:
            yield
        except FileError as error:
            self.note(kind, f"left out: {what}{error}{instead and f'; {instead} is taken'}")

    def number_or_zero(self, name: str, key: str, low: float, high: float) -> float:
        """Return a number of a section; 0 if it is missing, and 0 with a note if it is unusable."""
        with self.leaving_out(instead="0"):
            return self.section_or_empty(name).number(key, 0.0, low, high)
        del self.sections[name].entries[key]  # so that it is said once
        return 0.0

    def section(self, name: str) -> ConfigSection:
        """Return a section that must be there.

        Raises:
            FileError: where it is not.
        """
        if name not in self.sections:
            message = f"has no section [{name}]: add it{_include_hint(self.missing_includes)}"
            if not any(other.split(" ")[0] in _READ_SECTIONS for other in self.sections):
                message = (
                    f"has none of the sections of a printer.cfg, such as [{name}]: give the file "
                    f"as the firmware saved it, without marks before its lines"
                )
            raise FileError(message, file=self.file)
        return self.sections[name]

    def section_or_empty(self, name: str) -> ConfigSection:
        """Return a section; an empty one if it is missing."""
        return self.sections.get(name) or ConfigSection(name, Entry("", 1, self.file))

    def sections_of_kind(self, *kinds: str) -> Iterator[ConfigSection]:
        """Return sections whose first word is one of these, in the order of the file."""
        return (s for name, s in self.sections.items() if name.split(" ")[0] in kinds)


def read_config(path: str | os.PathLike[str]) -> Config:
    """Read a ``printer.cfg``, or that of a folder, and the files that it includes.

    As in the firmware, values that the owner wrote override those of SAVE_CONFIG at its end.

    Raises:
        FileError: if the file is missing or another firmware's, or if the firmware would not read
            the block that it saved.
    """
    path = Path(files.result_file(path, "printer.cfg"))
    content = files.read_bytes(path)
    refuse_foreign(path, content[: files.TEXT_LIMIT], accepted=("klipper",))
    if len(content) > files.TEXT_LIMIT:
        size = f"{files.TEXT_LIMIT // 2**20} MB"
        raise FileError(f"is larger than {size}: give the right file", file=printable_path(path))
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
    """Return lines with their numbers; only comments may have other encodings."""
    text = files.decode(content, path, errors="replace")
    return list(enumerate(re.split(r"\r\n|\r|\n", text.translate(_WEB_CHARACTERS)), start=1))


def _written_lines(lines: Lines) -> Lines:
    """Return the lines that SAVE_CONFIG did not write."""
    return [(k, line) for k, line in lines if not line.lstrip().startswith(_SAVED_MARK)]


def _saved_lines(lines: Lines, file: str) -> Lines:
    """Return the lines that SAVE_CONFIG wrote, without their marks.

    Raises:
        FileError: if the firmware would leave them out.
    """
    headers = [k for k, line in lines if _HEADER.match(line.lstrip())]
    first = headers[0] if headers else 1
    keep_one = "keep the newer of the two blocks, and remove the other with its header"
    intruders = dict.fromkeys(headers[1:], ("a second header", keep_one))
    move = f"put {_SAVED_MARK} before it if it belongs to the block, else move it above the header"
    intruders |= {
        k: (f"a line without {_SAVED_MARK}", f"{move} or remove it")
        for k, line in _written_lines(lines)
        if headers and k > first and line.strip()
    }
    for k, (finding, remedy) in intruders.items():
        raise FileError(
            f"{finding} stands below the header of SAVE_CONFIG (line {first}), and the firmware "
            f"then leaves the whole block out: {remedy}",
            file=file,
            line=k,
        )
    return [
        (k, line.lstrip().removeprefix(_SAVED_MARK).removeprefix(" ")) for k, line in lines
        if line.lstrip().startswith(_SAVED_MARK) and k >= first
    ]  # fmt: skip


def _add_saved(config: Config, saved: Config) -> None:
    """Add values of SAVE_CONFIG that the owner did not write, with a note on conflicting ones, and
    one if a section lost its header: a key stands twice in the section above, or is one that
    SAVE_CONFIG writes only in sections of another kind.
    """
    conflicts = list[str]()
    misplaced = [
        (line, f"{key} stands twice in [{name}]", "it") for line, key, name in saved.repeated_keys
    ]
    misplaced += [
        (entry.line, f"{key} stands in [{name}]", f"[{kind}]")
        for name, section in saved.sections.items() for key, entry in section.entries.items()
        for kind, keys in _SAVED_KEYS.items()
        if name.partition(" ")[0] != kind and keys.fullmatch(key)
    ]  # fmt: skip
    config.notes += saved.notes
    for line, finding, header in sorted(misplaced)[:1]:
        config.note(
            BROKEN_HEADER,
            f"{saved.file}, line {line}: {finding}, so the header above it was lost: write "
            f"{header} there, else what stands below it is left out, or remove the line if "
            f"you added it",
        )
    for name, section in saved.sections.items():
        target = config.sections.setdefault(name, section)
        for key, below in section.entries.items():
            above = target.entries.setdefault(key, below)
            differs = above is not below and above.values != below.values
            if differs and name.partition(" ")[0] in _READ_SECTIONS:
                values = f"{_value_text(above, config)}, below {_value_text(below, config)}"
                conflicts.append(f"[{name}] {key}: {values}")
    if conflicts:
        config.notes.insert(0, Note(
            f"{Path(config.file).name} has other values above the header of SAVE_CONFIG than below "
            f"it, and the firmware takes those above, as is done here: {'; '.join(conflicts)}. "
            f"Remove the lines that are not meant: what is pasted below the header has no effect "
            f"while the same key stands above it", "twice",
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
    """Add the sections of a file's lines to ``config``; ``within`` are the files that led here."""
    section: ConfigSection | None = None
    key, level, file = "", 0, printable_path(path)
    for number, line in lines:
        uncommented = _COMMENT.sub("", line).rstrip()
        text = uncommented.strip()
        if not text:
            continue
        indent = len(uncommented) - len(uncommented.lstrip())
        is_unindented_row = key == "points" and _ROW.match(text)  # pasted without its indentation
        if section is not None and key and (indent > level or is_unindented_row):
            entry = section.entries[key]
            section.entries[key] = replace(entry, text=f"{entry.text}\n{text}")
            continue
        level = indent
        if match := _SECTION.match(text):
            name, key = _section_name(match[1]), ""
            section = ConfigSection(name, Entry("", number, file))
            if name.startswith("include "):
                _include(config, name.removeprefix("include "), path, within)
            else:
                section = config.sections.setdefault(name, section)
        elif (match := _ENTRY.match(text)) and section is not None:
            key = match[1].strip().lower()
            if key in section.entries:
                config.repeated_keys.append((number, key, section.name))
            section.entries[key] = Entry(match[2].strip(), number, file)
        elif intended_name := _broken_header(text):  # lines below it belong to no section
            section, key = ConfigSection("", Entry("", number, file)), ""
            config.note(
                BROKEN_HEADER,
                f"{file}, line {number}: {text[:40]!r} must be [{intended_name[:40]}], and is left "
                f"out with all that follows up to the next section",
            )
        elif (section and section.name.split(" ")[0] in _READ_SECTIONS) or match:
            reason = "'key: value' was expected" if section else "no section stands above it"
            config.note("line", f"{file}, line {number}: {text[:40]!r} is left out, as {reason}")


def _broken_header(text: str) -> str:
    """Return the section that a line without complete brackets names; empty if it names none.

    A line is a broken header if it has one of the brackets, or is the name of a known section.
    Lines of 'key: value' are recognised before.
    """
    inner = _section_name(text.strip("[](){}<> "))
    bracketed = text.startswith("[") or text.endswith("]")
    return inner if bracketed or inner.split(" ")[0] in _SECTIONS else ""


def _section_name(text: str) -> str:
    """Return the name of a section; a known one in lower case, as the firmware requires."""
    kind, *rest = text.split() or [""]
    return " ".join((kind.lower() if kind.lower() in _SECTIONS else kind, *rest))


def _include(config: Config, pattern: str, path: Path, within: tuple[Path, ...]) -> None:
    """Read included files, relative to the file that names them and within the first one's folder.

    A file in another folder of the printer's computer is sought beside the file, by its name.
    """
    folder = glob.escape(os.path.relpath(path.parent, config.folder))
    relative_pattern = os.path.normpath(os.path.join(folder, pattern))
    if os.path.isabs(relative_pattern) or relative_pattern.split(os.sep)[0] == os.pardir:
        relative_pattern = os.path.normpath(os.path.join(folder, glob.escape(Path(pattern).name)))
    try:
        paths = sorted(config.folder.glob(relative_pattern))
    except (ValueError, OSError, NotImplementedError):  # no pattern that a folder has
        paths = []
    if not paths:
        config.missing_includes.append(pattern)
    for included in paths:
        if included.is_file() and included not in within and len(within) < _MAX_INCLUDE_DEPTH:
            lines = _lines(files.read_bytes(included, files.TEXT_LIMIT), included)
            _parse(config, _written_lines(lines), included, (*within, included))
