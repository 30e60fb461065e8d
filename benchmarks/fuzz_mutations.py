"""Mutations of whole files for ``fuzz.py``: tables, files of lines (machines, firmware), results.

Every function takes a ``random.Random`` and what to spoil; the same draws give the same bytes.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Sequence
from copy import deepcopy
from random import Random
from typing import Any

NAMES = (
    "[/b]", "$$", "$\\frac{$", "a@b", "common", "=1+1", "@SUM(A1)", "<b>&\"'", "a\x1b[31mb",
    "a\ufffeb", "\u202eabc", "x" * 99, "x" * 5000, "-", "--", "'", '"', ".", "..", "/", "a/b",
    "a\\b", "a\nb", "%s{}", "None", "nan", "0", "", " ", "é", "日本", "😀", "a,b", "a;b",
    "\ufeff", ":smile:", "xy.common", "xy@", "x",
)  # fmt: skip
NUMBERS = (
    "0", "-0", "1", "-1", "1e-320", "1e-12", "1e-7", "1e-3", "1e3", "1e6", "1e9", "-1e9", "1e18",
    "1e308", "1e999", "-1e999", "nan", "inf", "-inf", "NaN", "0x10", "1_000", "1,5", "1.5.2", "+5",
    "5.", ".5", "--5", "1e", "٣", "1" * 400, "1" * 5000, "0." + "0" * 400 + "1", "1 mm", "true",
    "", "3.0", "310.25", "2147483648", "9223372036854775808", "4294967296.5",
)  # fmt: skip
WORDS = (
    "x", "y", "z", "-x", "+y", "w", "X", "xy", "leg", "move", "1", "2", "1.0", "0", "-1", "+1",
    "tcp",
)  # fmt: skip

Rows = list[list[str]]


# -- cells and bytes, of any file ------------------------------------------------------------------


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
                lambda v: v + draw.gauss(0, 10 ** draw.uniform(-2, 1.5)), lambda v: round(v, 1),
                lambda v: v * (1 + 1e-9), lambda v: v * 1e200,
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
    return f"{draw.choice((value * factor, value + draw.gauss(0, 0.1))):.6g}"


def spoil_bytes(draw: Random, content: bytes) -> bytes:
    """Bytes as they are, mostly; else cut, flipped, doubled or written in another alphabet."""
    if draw.random() < 0.93 or not content:
        return content
    place = draw.randrange(len(content))
    flipped = bytearray(content)
    for _ in range(draw.choice((1, 3, 20))):
        flipped[draw.randrange(len(flipped))] = draw.randrange(256)
    text = content.decode("utf-8", "replace")
    return draw.choice((
        content[:place], content[place:], bytes(flipped), content * 2, b"\xef\xbb\xbf" + content,
        b"", text.encode("utf-16"), text.encode("latin-1", "replace"), content + b"\0",
        content[:place] + b'"' + content[place:], content.replace(b"\n", b"\n\n"),
    ))  # fmt: skip


def _reordered(draw: Random, rows: list[Any]) -> None:
    """Leave out, repeat or move rows or lines."""
    place = draw.randrange(len(rows))
    change: Callable[[], Any] = draw.choice((
        lambda: rows.pop(place), lambda: rows.insert(place, deepcopy(draw.choice(rows))),
        rows.reverse, lambda: draw.shuffle(rows), lambda: rows.__delitem__(slice(place, None)),
        lambda: rows.__delitem__(slice(1, place + 1)), lambda: rows.extend(deepcopy(rows[1:])),
    ))  # fmt: skip
    change()


# -- tables ----------------------------------------------------------------------------------------


def _cells(draw: Random, table: Rows) -> None:
    """Change single cells, those of the header too, or several mildly."""
    mild = draw.random() < 0.5
    for row in draw.choices(table[mild:] or table, k=draw.choice((1, 1, 2, 5, 50 if mild else 5))):
        if row:
            place = draw.randrange(len(row))
            row[place] = (mild_cell if mild else some_cell)(draw, row[place])


def _column(draw: Random, table: Rows) -> None:
    """Change a whole column alike: a value, a unit, an odd name for each of its own, or none."""
    place = draw.randrange(len(table[0]))
    value = draw.choice(draw.choice((NUMBERS, WORDS, NAMES)))
    factor = draw.choice((-1, 1e-3, 1e3, 25.4, 0, 1e-9, 1e9))
    new = {row[place]: draw.choice(NAMES) for row in table[1:] if len(row) > place}
    change = draw.choice((
        lambda old: [value], lambda old: [old, old], lambda old: [], lambda old: [new[old]],
        lambda old: [_scaled(old, factor)],
    ))  # fmt: skip
    for row in table[1:]:
        row[place : place + 1] = [cell for old in row[place : place + 1] for cell in change(old)]
    table[0][place : place + 1] = table[0][place : place + 1] * len(change(next(iter(new), "")))


def _scaled(cell: str, factor: float) -> str:
    try:
        return repr(float(cell) * factor)
    except ValueError:
        return cell


def _header(draw: Random, table: Rows) -> None:
    place = draw.randrange(len(table[0]))
    name = table[0][place]
    table[0][place] = draw.choice((
        name.upper(), name[:-1], name + " ", "", draw.choice(table[0]), name.replace("mm", "m"),
        draw.choice(NAMES), name.replace("rho", "travel"),
    ))  # fmt: skip


OPTIONAL = (
    "bar", "repeat", "order", "approach_x", "approach_y", "approach_z", "time_s", "temperature_C",
    "load_N", "sigma_mm", "kind", "notes", "posture",
)  # fmt: skip


def _more(draw: Random, table: Rows) -> None:
    """Add an optional column, with values that may be right."""
    name = draw.choice(OPTIONAL)
    likely = {"bar": ("1", "2", ""), "kind": ("leg", "move"), "sigma_mm": ("0.005", "1e-6", "1")}
    cells = likely.get(name, ("1", "-1", "0", "20", ""))
    same = draw.choice(cells)
    for k, row in enumerate(table):
        row.append(name if k == 0 else draw.choice((same, draw.choice(cells))))


def _numbers(draw: Random, table: Rows) -> None:
    """Readings, sigmas or points that a file may well hold, and nobody measured."""
    known = ("reading_mm", "sigma_mm", "p_x_mm", "p_y_mm")
    likely = [k for k, name in enumerate(table[0]) if name in known]
    rows = [row for row in table[1:] if len(row) == len(table[0])]
    if not likely or not rows:
        return
    place, chosen, same = draw.choice(likely), draw.choice(rows), draw.uniform(-5, 5)
    size, kind = 10.0 ** draw.uniform(-4, 1.2), draw.randrange(5)
    for k, row in enumerate(rows):
        value = float(_scaled(row[place], 1.0)) if re.fullmatch(r"-?[\d.]+", row[place]) else 0.0
        new = (value + draw.gauss(0, size), value + size * (row is chosen), same, value * size,
               value + size * k / len(rows))[kind]  # fmt: skip
        row[place] = f"{new:.{draw.choice((2, 4, 9))}f}"


def spoil_table(draw: Random, text: str) -> bytes:
    """Return a CSV file with cells, rows or columns changed, in a way in which CSV is written."""
    table = [list(row) for row in csv.reader(io.StringIO(text))]
    kinds = (_numbers, _numbers, _cells, _cells, _column, _reordered, _header, _more)
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        if table and table[0]:
            draw.choice(kinds)(draw, table)
    delimiter = draw.choice((",",) * 6 + (";", "\t"))
    end = draw.choice(("\n",) * 6 + ("\r\n", "\r"))
    if delimiter == ";":
        table = [[cell.replace(".", ",") for cell in row] for row in table]
    stream = io.StringIO(newline="")
    csv.writer(stream, delimiter=delimiter, lineterminator=end).writerows(table)
    return spoil_bytes(draw, stream.getvalue().encode("utf-8", "surrogatepass"))


# -- machine files and those of firmware -----------------------------------------------------------

_VALUES = (
    "[]", "[1]", "[1, 2, 3]", "[60.0, -100.0]", "{}", '"text"', "true", "1979-05-27", "[[]]",
    "{ value = 1, sigma = 0, unit = \"mm\" }", "inf", "nan", "0xfff",
)  # fmt: skip


def spoil_lines(draw: Random, text: str) -> bytes:
    """Return a machine file or a firmware's file with numbers, values, keys or lines changed."""
    lines, change = text.splitlines(), draw.choice((mild_cell, some_cell))
    for _ in range(draw.choice((1, 1, 2, 3, 6))):
        place, kind = draw.randrange(len(lines)) if lines else 0, draw.randrange(8)
        numbers = re.findall(r"(?<![\w.])-?\d[\d.e-]*", lines[place]) if lines else []
        if not lines:
            break
        if kind < 4 and numbers:
            old = draw.choice(numbers)
            lines[place] = lines[place].replace(old, change(draw, old), 1)
        elif kind == 4 and "=" in lines[place]:
            new = draw.choice((*_VALUES, draw.choice(NUMBERS), json.dumps(draw.choice(NAMES))))
            lines[place] = f"{lines[place].partition('=')[0]}= {new}"
        elif kind == 5:
            lines += ["[parameters]"] * ("[parameters]" not in lines) + [_parameter(draw)]
        elif kind == 6:
            _reordered(draw, lines)
        else:
            odd = draw.choice((":", "=", "[", "]", "#", " ", "x", draw.choice(NAMES)))
            lines[place] = lines[place].replace(draw.choice("_aeo.:=[]#"), odd, 1)
    return spoil_bytes(draw, ("\n".join(lines) + "\n").encode("utf-8", "surrogatepass"))


def _parameter(draw: Random) -> str:
    """Return a line of an error that a machine file may state."""
    effect = draw.choice(("joint_offset", "leg_length", "axis_tilt", "gauge_scale", "backlash"))
    where = draw.choice(("x", "y", "y.z", "z.x", "x.y", "w", "common", "cyclic", "x@a", ""))
    value = draw.choice((draw.choice(NUMBERS), f"{draw.gauss(0, 10 ** draw.uniform(-2, 0)):.4g}"))
    sigma, unit = draw.choice(("0", "0.01", "-1", "1e9")), draw.choice(("mm", "rad", "1", "m"))
    return f'"{effect}.{where}" = {{ value = {value}, sigma = {sigma}, unit = "{unit}" }}'


# -- results ---------------------------------------------------------------------------------------

_JSON_VALUES: Sequence[Any] = (
    None, True, 0, -1, 1.5, 1e308, 10**400, "", "x", "\x1b", "\ud800", "../up", "a\0b", [], {},
    [[]], [None], {"": None}, "nan", -1e-320,
)  # fmt: skip


def spoil_json(draw: Random, text: str) -> bytes:
    """A result with entries somewhere in it taken out, exchanged or repeated."""
    data = json.loads(text)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        _spoil_inside(draw, data)
    return spoil_bytes(draw, json.dumps(data, indent=1, ensure_ascii=draw.random() < 0.9)
                       .encode("utf-8", "surrogatepass"))  # fmt: skip


_TELLING = ("inputs", "machine", "arguments", "schema", "command", "seed", "version", "parameters")


def _spoil_inside(draw: Random, data: Any) -> None:
    at = data
    key: Any = draw.choice(_TELLING) if draw.random() < 0.8 else draw.choice(list(data) or [""])
    while key in at if isinstance(at, dict) else isinstance(key, int) and key < len(at):
        inner = at[key]
        if not isinstance(inner, dict | list) or not inner or draw.random() < 0.25:
            break
        at = inner
        key = draw.choice(list(at)) if isinstance(at, dict) else draw.randrange(len(at))
    else:
        return
    old, kind = at[key], draw.randrange(5)
    if kind == 0:
        del at[key]
    elif kind == 1 and isinstance(old, str):
        at[key] = some_cell(draw, old)
    elif kind == 2 and isinstance(old, list):
        at[key] = draw.choice((old * 2, old[:1], old[::-1]))
    elif kind == 3 and isinstance(old, int | float) and abs(old) < 1e300:
        at[key] = draw.choice((-old, old * 1000, old + 1, str(old), float(old)))
    else:
        at[key] = deepcopy(draw.choice(_JSON_VALUES))  # which a later change may go into
