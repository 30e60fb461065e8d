"""Touches of a plate in files of firmware and people: height maps, logs, and plain tables."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from orthoglide.errors import FileError

MIN_PLACES = 3
"""Places that determine a plane: a list of fewer is left out."""

_HEIGHT_MAP = re.compile(r"RepRapFirmware height map file", re.IGNORECASE)
_NUMBER = r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?|nan"
_LABELLED = [
    re.compile(rf"(?<![A-Za-z]){axis}\s*[:=]\s*({_NUMBER})", re.I)
    for axis in ("x", "y", "z(?:-probe)?")  # Z-probe: of Repetier
]
_CONSOLE = re.compile(  # of Klipper, which changed its words, and of Smoothieware's centre
    rf"\bprobe:? at ({_NUMBER}),({_NUMBER})(?: (?:is|bed will contact at) z=| is )?", re.I
)
_SMOOTHIEWARE = re.compile(rf"\bX({_NUMBER}), Y({_NUMBER}), Z(?=[-+.\d])")  # G-code has no commas
_BED_LINE = re.compile(r"\bbed\s+x\s*[:=]|\bprobe:? at [-+.\d]", re.IGNORECASE)
_POSITION = re.compile(r"\bE\s*:|\bCount\b", re.IGNORECASE)  # of a tool, not of a touch
_BED_TEMPERATURE = re.compile(rf"(?<![A-Za-z])B\s*:\s*({_NUMBER})\s*/", re.I)  # in a log
_PROBING = re.compile(r"\bG(?:29|32|33)\b")  # commands after which the plate is touched anew
_COMMENT = re.compile(r"^\s*(?:#|//|;\s*[A-Za-z]).*")
_UNTOUCHED = ("", "nan", "-", "null", "none", "n/a")
_AXES = {"x": 0, "y": 1, "z": 2, "height": 2}
_UNITS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "microns": 1e-3,
          "m": 1e3, "cm": 10.0, "in": 25.4, "inch": 25.4, "inches": 25.4}  # fmt: skip
_EQUAL_PLACES = 0.01  # millimetres: grid on which places are compared
_METRES_LIMIT = 1.0  # largest coordinate of a list in metres that is taken as millimetres
_MAX_COORDINATE = 1e5  # millimetres: no plate is wider
_MAX_MAP_LINES = 1000  # of a height map

Columns = Mapping[int, tuple[int, float]]
"""Column of each axis in a table, and its unit in millimetres."""


@dataclass(frozen=True)
class Touch:
    """A touch as a file has it, millimetres."""

    line: int
    x: float
    y: float
    z: float
    temperature: float = math.nan  # that the firmware recorded then, degrees Celsius

    @property
    def place(self) -> tuple[int, int]:
        """Place on a grid, so that equal places compare equal."""
        return round(self.x / _EQUAL_PLACES), round(self.y / _EQUAL_PLACES)


@dataclass
class TouchLists:
    """Lists of touches in a file, and lines that were left out."""

    lists: list[list[Touch]] = field(default_factory=list)  # touches of one probing each
    # lines that were left out, by the reason, each with the value in it
    left_out: dict[str, dict[int, str]] = field(default_factory=dict)
    last_places: set[tuple[int, int]] = field(default_factory=set)  # of the last list
    starts_list: bool = True  # whether the next touch is the first of a probing
    temperature: float = math.nan  # last recorded one, degrees Celsius

    def leave_out(self, reason: str, line: int, value: str = "") -> None:
        """Record that a line is left out."""
        self.left_out.setdefault(reason, {}).setdefault(line, value.strip())

    def add(self, touch: Touch) -> None:
        """Add a touch to the last list, or to a new one if a probing begins: after a new heading,
        or when a place other than the previous one is touched again.
        """
        if not (abs(touch.x) < _MAX_COORDINATE and abs(touch.y) < _MAX_COORDINATE):
            self.leave_out("no place on a plate", touch.line, f"x {touch.x:g}, y {touch.y:g}")
            return
        if not math.isfinite(touch.z):
            self.leave_out("not touched", touch.line, f"x {touch.x:g}, y {touch.y:g}")
            return
        is_repeated = touch.place in self.last_places and touch.place != self.lists[-1][-1].place
        if self.starts_list or is_repeated:
            self.lists.append([])
            self.last_places.clear()
        self.lists[-1].append(touch)
        self.last_places.add(touch.place)
        self.starts_list = False


def read_touches(lines: Sequence[str], file: str) -> TouchLists:
    """Read the lines of a file in the format that is recognised."""
    touch_lists = TouchLists()
    if any(_HEIGHT_MAP.search(line) for line in lines):
        _read_maps(lines, file, touch_lists)
    elif any(len(_labelled_numbers(line)) == len(_LABELLED) for line in lines):
        _read_labelled(lines, touch_lists)
    else:
        _read_table(lines, file, touch_lists)
    return touch_lists


def _labelled_numbers(line: str) -> list[str]:
    """Return the numbers of x, y and z that a line names, those of Klipper's console too."""
    line = _with_labels(line)
    return [match[1] for pattern in _LABELLED if (match := pattern.search(line))]


def _with_labels(line: str) -> str:
    """Return a line of a console as Marlin's ``Bed X: Y: Z:``; another line as it is."""
    return _SMOOTHIEWARE.sub(r"Bed X:\1 Y:\2 Z:", _CONSOLE.sub(r"Bed X:\1 Y:\2 Z:", line))


def _read_labelled(lines: Sequence[str], touch_lists: TouchLists) -> None:
    """Read lines that name x, y and z; in a log, only those of touches."""
    has_bed_lines = any(_BED_LINE.search(_with_labels(line)) for line in lines)
    for number, line in enumerate(lines, start=1):
        cells = _labelled_numbers(line)
        labelled = _BED_LINE.search(_with_labels(line))
        is_touch = labelled if has_bed_lines else not _POSITION.search(line)
        if temperature := _BED_TEMPERATURE.search(line):
            touch_lists.temperature = _number(temperature[1])
        if is_touch and len(cells) == len(_LABELLED):
            x, y, z = map(_number, cells)
            touch_lists.add(Touch(number, x, y, z, touch_lists.temperature))
        elif is_touch and (has_bed_lines or len(cells) == len(_LABELLED) - 1):
            touch_lists.leave_out("not all of x, y and z, as of a line cut off", number, line)
        elif _PROBING.search(line):
            touch_lists.starts_list = True


def _read_maps(lines: Sequence[str], file: str, touch_lists: TouchLists) -> None:
    """Read height maps: a heading, names of sizes, the sizes, and a row of heights for each y.

    A bare 0 denotes a place that was not touched, and no place beyond the radius is touched.
    """
    rows = [(k, line) for k, line in enumerate(lines, start=1) if line.strip()]
    starts = [k for k, (_, line) in enumerate(rows) if _HEIGHT_MAP.search(line)]
    for start, end in zip(starts, [*starts[1:], len(rows)], strict=True):
        block, touch_lists.starts_list = rows[start + 1 : end], True
        try:
            (_, names), (_, values), *heights = block
            sizes = dict(zip(_cells(names.lower()), _cells(values), strict=False))
            across, along = (_span(sizes, axis) for axis in range(2))
            heights[0]
        except (ValueError, IndexError):
            line, names = block[0] if block else rows[start]
            raise FileError(
                f"has a height map whose sizes or heights are missing or not understood, "
                f"{names[:60]!r}: give the whole file",
                file=file,
                line=line,
            ) from None
        radius = _number(sizes.get("radius", "-1"))
        swapped = sizes.get("axis0", "x").lower() == "y"
        radius = radius if radius > 0 else math.inf
        for (number, row), y in zip(heights, along, strict=False):
            cells = _cells(row)
            if len(cells) != len(across):
                reason = f"the number of heights is {len(cells)}, not {len(across)}"
                touch_lists.leave_out(reason, number, row)
                continue
            for x, cell in zip(across, cells, strict=True):
                if math.hypot(x, y) <= radius + _EQUAL_PLACES:
                    place, z = (y, x) if swapped else (x, y), _number(cell)
                    touch_lists.add(Touch(number, *place, math.nan if cell == "0" else z))
        if len(heights) < len(along):
            reason = f"{len(heights)} rows of {len(along)}; more are missing below"
            touch_lists.leave_out(reason, *heights[-1])
        for number, row in heights[len(along) :]:
            reason = f"more than the {len(along)} rows of the height map"
            touch_lists.leave_out(reason, number, row)


def _span(sizes: Mapping[str, str], axis: int) -> list[float]:
    """Return the places of a height map along an axis, millimetres; ``xmin`` is now ``min0``."""

    def size(name: str) -> float:
        names = (f"{name}{axis}", f"{'xy'[axis]}{name}", name)
        return _number(next((sizes[n] for n in names if sizes.get(n)), ""))

    low, step, count = map(size, ("min", "spacing", "num"))
    if not (math.isfinite(low + step) and 1 <= count <= _MAX_MAP_LINES):
        raise ValueError(axis)
    return [low + k * step for k in range(int(count))]


def _read_table(lines: Sequence[str], file: str, touch_lists: TouchLists) -> None:
    """Read a table of x, y, z, with or without a line of names, which may be a comment."""
    columns: Columns = {axis: (axis, 1.0) for axis in range(3)}
    name_count = 0
    for number, line in enumerate(lines, start=1):
        cells, comment = _cells(line.lstrip("#/; ")), bool(_COMMENT.match(line))
        if named_columns := _columns(cells):
            columns, name_count, touch_lists.starts_list = named_columns, len(cells), True
        elif comment or not line.strip():
            continue
        elif 0 < name_count < len(cells) and all(math.isfinite(_number(c)) for c in cells):
            reason = "more numbers than names: separate numbers with decimal commas by semicolons"
            touch_lists.leave_out(reason, number, line)
        elif (touch := _row(number, cells, columns)) and (name_count or len(cells) == 3):
            touch_lists.add(touch)
        else:
            numbers = len(cells) > 3 and all(math.isfinite(_number(c)) for c in cells)
            reason = "numbers without names, as of a grid" if numbers else "no row of x, y and z"
            touch_lists.leave_out(reason, number, line)
    touches = [t for part in touch_lists.lists for t in part]
    if len(touches) >= MIN_PLACES and all(max(abs(t.x), abs(t.y)) < _METRES_LIMIT for t in touches):
        raise FileError(
            "has all places within a millimetre of the centre: give millimetres, or the unit "
            "behind the names of the columns (x_m); of a grid of heights give each with its x and "
            "y", file=file, line=touches[0].line,
        )  # fmt: skip


def _row(line: int, cells: Sequence[str], columns: Columns) -> Touch | None:
    """Return the touch of a row, with height nan if none is given; ``None`` for another row."""
    if max(column for column, _ in columns.values()) >= len(cells):
        return None
    x, y, z = (_number(cells[columns[axis][0]]) * columns[axis][1] for axis in range(3))
    is_height = math.isfinite(z) or cells[columns[2][0]].lower() in _UNTOUCHED
    return Touch(line, x, y, z) if math.isfinite(x + y) and is_height else None


def _columns(cells: Sequence[str]) -> Columns:
    """Return the columns of a row of names; empty if it does not name all axes."""
    columns: dict[int, tuple[int, float]] = {}
    for column, cell in enumerate(cells):
        words = re.findall(r"[a-zµμ]+", cell.lower())
        axis = next((_AXES[word] for word in words if word in _AXES), None)
        if axis is not None and axis not in columns:
            unit = next((size for name, size in _UNITS.items() if name in words), 1.0)
            columns[axis] = (column, unit)
    return columns if len(columns) == 3 else {}


def _cells(line: str) -> list[str]:
    """Return the cells of a line, separated by semicolons, tabs, commas or blanks.

    A comma between digits is a decimal comma, unless commas separate the cells.
    """
    line = line.strip().strip("\ufeff")
    blanks = line.split()
    if len(blanks) == 3 and all(re.fullmatch(_NUMBER, cell, re.I) for cell in blanks):
        return blanks
    mark = next((mark for mark in ";\t," if mark in line), None)
    cells = [cell.strip().strip('"') for cell in line.split(mark)]
    return cells[:-1] if len(cells) > 3 and not cells[-1] else cells


def _number(cell: str) -> float:
    """Return a number with a decimal point or comma; nan for anything else."""
    try:
        value = float(cell.strip().strip('"').replace(",", "."))
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
