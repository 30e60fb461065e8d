"""Structure-aware mutations of tables for ``fuzz.py``, and the odd cells that all mutations use.

Every function takes a ``random.Random`` and what to spoil; the same draws give the same bytes.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from random import Random
from typing import Any

NAMES = (
    "[/b]", "$$", "$\\frac{$", "a@b", "common", "=1+1", "@SUM(A1)", "<b>&\"'", "a\x1b[31mb",
    "a\ufffeb",
    "\u202eabc", "x" * 99, "x" * 5000, "-", "--", "'", '"', ".", "..", "/", "a/b", "a\\b", "a\nb",
    "%s{}", "None",
    "nan", "0", "", " ", "é", "日本", "😀",
    "a,b", "a;b", "\ufeff", ":smile:", "xy.common", "xy@", "x",
)  # fmt: skip
NUMBERS = (
    "0", "-0", "1", "-1", "1e-320", "1e-12", "1e-7", "1e-3", "1e3", "1e6", "1e9", "-1e9", "1e18",
    "1e308",
    "1e999", "-1e999", "nan", "inf", "-inf", "NaN", "0x10", "1_000", "1,5", "1.5.2", "+5", "5.",
    ".5", "--5", "1e",
    "٣", "1" * 400, "1" * 5000, "0." + "0" * 400 + "1", "1 mm", "true", "", "3.0", "310.25",
    "2147483648",
    "9223372036854775808", "4294967296.5",
)  # fmt: skip
WORDS = (
    "x",
    "y",
    "z",
    "-x",
    "+y",
    "w",
    "X",
    "xy",
    "leg",
    "move",
    "1",
    "2",
    "1.0",
    "0",
    "-1",
    "+1",
    "tcp",
)

Table = list[list[str]]


def some_cell(draw: Random, old: str) -> str:
    """Another cell: a number near the old one, an odd number, a word or a name."""
    if draw.random() < 0.75:
        try:
            value = float(old)
        except ValueError:
            pass
        else:
            change = draw.choice((
                lambda v: -v, lambda v: v * 25.4, lambda v: v / 1000, lambda v: v * 1000,
                lambda v: v + draw.gauss(0, 0.01), lambda v: v + draw.gauss(0, 0.1),
                lambda v: v + draw.gauss(0, 1), lambda v: v + draw.gauss(0, 30),
                lambda v: v * (1 + 1e-9), lambda v: round(v, 1), lambda v: v * 1e200,
            ))  # fmt: skip
            return repr(change(value))
    return draw.choice(draw.choice((NUMBERS, WORDS, NAMES)))


def mild_cell(draw: Random, old: str) -> str:
    """A number that may well be meant; what is none stays."""
    try:
        value = float(old)
    except ValueError:
        return old
    factor = draw.choice((-1.0, 0.0, 0.1, 0.5, 0.9, 0.99, 1.01, 1.1, 2.0, 10.0, 100.0))
    return (
        f"{draw.choice((value * factor, value + draw.gauss(0, 0.1), value + draw.gauss(0, 5))):.6g}"
    )


def _mild_cells(draw: Random, table: Table) -> None:
    for row in draw.sample(table[1:], min(len(table) - 1, draw.choice((1, 2, 5, 50)))):
        for place in draw.sample(range(len(row)), draw.choice((1, 2)) if len(row) > 1 else 0):
            row[place] = mild_cell(draw, row[place])


def _cells(draw: Random, table: Table) -> None:
    for _ in range(draw.choice((1, 1, 2, 5))):
        row = draw.choice(table)
        if row:
            place = draw.randrange(len(row))
            row[place] = some_cell(draw, row[place])


def _column(draw: Random, table: Table) -> None:
    """Changes a whole column alike."""
    place = draw.randrange(len(table[0]))
    kind, value = draw.randrange(4), draw.choice(draw.choice((NUMBERS, WORDS, NAMES)))
    if kind == 0:
        for row in table[1:]:
            row[place : place + 1] = [value]
    elif kind == 1:
        for row in table:
            del row[place : place + 1]
    elif kind == 2:
        for row in table:
            row.append(row[place] if place < len(row) else "")
    else:
        factor = draw.choice((-1, 1e-3, 1e3, 25.4, 0, 1e-9, 1e9))
        for row in table[1:]:
            try:
                row[place] = repr(float(row[place]) * factor)
            except (ValueError, IndexError):
                continue


def _rows(draw: Random, table: Table) -> None:
    place = draw.randrange(len(table))
    change: Callable[[], Any] = draw.choice((
        lambda: table.pop(place), lambda: table.insert(place, list(table[place])),
        lambda: table.reverse(), lambda: draw.shuffle(table),
        lambda: table.__delitem__(slice(place, None)),
        lambda: table.__delitem__(slice(1, place + 1)),
        lambda: table.extend([list(r) for r in table[1:]]),
        lambda: table.insert(place, []), lambda: table.insert(place, [""] * len(table[0])),
        lambda: table[place].append("extra"), lambda: table[place][:1] and table[place].pop(),
    ))  # fmt: skip
    change()


def _header(draw: Random, table: Table) -> None:
    names = table[0]
    if names:
        place = draw.randrange(len(names))
        names[place] = draw.choice((
            names[place].upper(), names[place][:-1], names[place] + " ", "", draw.choice(names),
            names[place].replace("mm", "m"), draw.choice(NAMES), names[place].replace("rho",
            "travel"),
        ))  # fmt: skip


OPTIONAL = (
    "bar", "repeat", "order", "approach_x", "approach_y", "approach_z", "time_s", "temperature_C",
    "load_N",
    "sigma_mm", "kind", "notes", "posture",
)  # fmt: skip


def _more(draw: Random, table: Table) -> None:
    """An optional column, with values that may be right."""
    name = draw.choice(OPTIONAL)
    likely = {"bar": ("1", "2", ""), "kind": ("leg", "move"), "sigma_mm": ("0.005", "1e-6", "1")}
    cells = likely.get(name, ("1", "-1", "0", "20", ""))
    same = draw.choice(cells)
    for k, row in enumerate(table):
        own = draw.choice(cells) if draw.random() < 0.5 else same
        row.append(name if k == 0 else own)


def _names(draw: Random, table: Table) -> None:
    """Every setup gets an odd name."""
    new = {name: draw.choice(NAMES) for name in dict.fromkeys(r[0] for r in table[1:] if r)}
    for row in table[1:]:
        if row:
            row[0] = new[row[0]]


def _number(cell: str, otherwise: float) -> float:
    try:
        return float(cell)
    except ValueError:
        return otherwise


def _numbers(draw: Random, table: Table) -> None:
    """Readings, sigmas or points that a file may well hold, and nobody measured."""
    known = ("reading_mm", "sigma_mm", "p_x_mm", "p_y_mm")
    likely = [k for k, name in enumerate(table[0]) if name in known]
    place = draw.choice(likely) if likely else -1
    rows = [row for row in table[1:] if likely and len(row) == len(table[0])]
    size, kind = 10.0 ** draw.uniform(-4, 1.2), draw.randrange(6)
    same = draw.uniform(-5, 5)
    chosen = draw.choice(rows) if rows else None
    cells = [row[place] for row in rows]
    for k, row in enumerate(rows):
        value = _number(row[place], 0.0)
        new = (
            value + draw.gauss(0, size),
            value + size * (row is chosen),
            same,
            value * size,
            value + size * k / len(rows),
            _number(cells[-1 - k], value),
        )[kind]
        row[place] = f"{new:.{draw.choice((2, 4, 9))}f}"


_ON_TABLES = (
    _numbers,
    _numbers,
    _numbers,
    _numbers,
    _cells,
    _cells,
    _cells,
    _column,
    _rows,
    _header,
    _more,
    _more,
    _names,
    _names,
)


def spoilt_table(draw: Random, text: str) -> bytes:
    """A CSV file with cells, rows or columns changed, in one of the ways CSV is written."""
    table = [list(row) for row in csv.reader(io.StringIO(text))]
    kinds = (_mild_cells, _numbers, _numbers) if draw.random() < 0.5 else _ON_TABLES
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        if table and table[0]:
            draw.choice(kinds)(draw, table)
    delimiter = draw.choice((",",) * 6 + (";", "\t"))
    end = draw.choice(("\n",) * 6 + ("\r\n", "\r"))
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, delimiter=delimiter, lineterminator=end)
    for row in table:
        if delimiter == ";" and draw.random() < 0.5:
            row = [c.replace(".", ",") for c in row]
        writer.writerow(row)
    return stream.getvalue().encode("utf-8", "surrogatepass")
