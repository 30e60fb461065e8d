"""Structure-aware mutations of tables, machine files and results, for ``fuzz.py``.

Every function takes a ``random.Random`` and what to spoil,
and returns it spoilt; the same draws give
the same bytes.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Sequence
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
    likely = {"bar": ("1", "2", ""), "kind": ("leg", "move"), "sigma_mm": ("0.005", "1e-6", "1000")}
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


_ON_TABLES = (_cells, _cells, _cells, _column, _rows, _header, _more, _more, _names, _names)


def spoil_table(draw: Random, text: str) -> bytes:
    """A CSV file with cells, rows or columns changed, in one of the ways CSV is written."""
    table = [list(row) for row in csv.reader(io.StringIO(text))]
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        if table and table[0]:
            draw.choice(_ON_TABLES)(draw, table)
    delimiter = draw.choice((",",) * 6 + (";", "\t"))
    end = draw.choice(("\n",) * 6 + ("\r\n", "\r"))
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, delimiter=delimiter, lineterminator=end)
    for row in table:
        if delimiter == ";" and draw.random() < 0.5:
            row = [c.replace(".", ",") for c in row]
        writer.writerow(row)
    return spoil_bytes(draw, stream.getvalue().encode("utf-8", "surrogatepass"))


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
        b"",
        b"\xef\xbb\xbf", text.encode("utf-16"), text.encode("latin-1", "replace"), content + b"\0",
        content[:place] + b'"' + content[place:], content[:place] + b"\x1b" + content[place:],
        content.replace(b",", b",,"), content.replace(b"\n", b"\n\n"),
    ))  # fmt: skip


_TOML_VALUES = (
    "[]", "[1]", "[1, 2, 3]", "[-100.0, 60.0]", "[60.0, -100.0]", "{}", '"text"', "true",
    "1979-05-27", "[[]]",
    "{ value = 1, sigma = 0, unit = \"mm\" }", "-5", "0", "inf", "nan", "-0.0", "0xfff",
)  # fmt: skip


def spoil_toml(draw: Random, text: str) -> bytes:
    """A machine file with values, keys or lines changed."""
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 2, 3))):
        place = draw.randrange(len(lines)) if lines else 0
        kind = draw.randrange(8)
        if kind <= 3 and lines and "=" in lines[place]:
            key, _, value = lines[place].partition("=")
            new = draw.choice((*_TOML_VALUES, draw.choice(NUMBERS), json.dumps(draw.choice(NAMES))))
            number = re.search(r"-?\d[\d.e-]*", value)
            if number and draw.random() < 0.5:
                new = value.replace(number[0], some_cell(draw, number[0]), 1).strip()
            lines[place] = f"{key}= {new}"
        elif kind == 4 and lines:
            lines.insert(place, draw.choice(lines))
        elif kind == 5 and lines:
            del lines[place]
        elif kind == 6:
            lines.append(_parameter(draw))
        elif lines:
            lines[place] = lines[place].replace(draw.choice("_aeio.="), draw.choice("xy. ="), 1)
    return spoil_bytes(draw, ("\n".join(lines) + "\n").encode("utf-8", "surrogatepass"))


def spoil_config(draw: Random, text: str) -> bytes:
    """A firmware's file with values, keys or lines changed."""
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 2, 3))):
        place = draw.randrange(len(lines)) if lines else 0
        kind = draw.randrange(6)
        if kind <= 2 and lines:
            numbers = re.findall(r"-?\d[\d.]*", lines[place])
            if numbers:
                old = draw.choice(numbers)
                lines[place] = lines[place].replace(old, some_cell(draw, old), 1)
        elif kind == 3 and lines:
            lines.insert(place, draw.choice(lines))
        elif kind == 4 and lines:
            del lines[place]
        elif lines:
            odd = draw.choice((":", "=", "[", "]", "#", " ", draw.choice(NAMES)))
            lines[place] = lines[place].replace(draw.choice(":=_a[]#"), odd, 1)
    return spoil_bytes(draw, ("\n".join(lines) + "\n").encode("utf-8", "surrogatepass"))


def _parameter(draw: Random) -> str:
    effect = draw.choice(
        ("joint_offset", "leg_length", "axis_tilt", "gauge_scale", "backlash", "no")
    )
    where = draw.choice(("x", "y.z", "w", "x.x", "common", "cyclic", "x@a", ""))
    unit = draw.choice(("mm", "rad", "1", "m"))
    value, sigma = draw.choice(NUMBERS), draw.choice(("0", "0.01", "-1", "1e9"))
    numbers = f"value = {value}, sigma = {sigma}"
    return f'[parameters]\n"{effect}.{where}" = {{ {numbers}, unit = "{unit}" }}'


_JSON_VALUES: Sequence[Any] = (
    None, True, 0, -1, 1.5, 1e308, 10**400, "", "x", "\x1b", "\ud800", "../up", "a\0b", [], {},
    [[]], [None],
    {"": None}, "nan", -1e-320,
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
        at[key] = draw.choice(_JSON_VALUES)
