"""Structure-aware mutations of whole files for ``fuzz.py``: tables, machine files, results.

Every function takes a ``random.Random`` and what to spoil; the same draws give the same bytes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from copy import deepcopy
from random import Random
from typing import Any

from benchmarks.fuzz_tables import NAMES, NUMBERS, mild_cell, some_cell, spoilt_table


def spoil_table(draw: Random, text: str) -> bytes:
    """A CSV file with cells, rows, columns or bytes changed."""
    return spoil_bytes(draw, spoilt_table(draw, text))


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
    lines, mild = text.splitlines(), draw.random() < 0.6
    change_of = mild_cell if mild else some_cell
    for _ in range(draw.choice((1, 1, 2, 3, 6))):
        place, kind = draw.randrange(len(lines)), 0 if mild else draw.randrange(12)
        numbers = re.findall(r"(?<![\w.])-?\d[\d.e-]*", lines[place])
        if kind <= 6 and numbers:
            old = draw.choice(numbers)
            lines[place] = lines[place].replace(old, change_of(draw, old), 1)
        elif mild:
            continue
        elif kind <= 7 and "=" in lines[place]:
            new = draw.choice((*_TOML_VALUES, draw.choice(NUMBERS), json.dumps(draw.choice(NAMES))))
            lines[place] = f"{lines[place].partition('=')[0]}= {new}"
        elif kind <= 9:
            lines += [] if "[parameters]" in lines else ["[parameters]"]
            lines.append(_parameter(draw))
        elif kind == 10:
            change = draw.choice((list.pop, lambda all, k: all.insert(k, draw.choice(all))))
            change(lines, place)
        else:
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
    where = draw.choice(("x", "y", "y.z", "z.x", "x.y", "w", "common", "cyclic", "x@a", ""))
    unit = draw.choice(("mm", "rad", "1", "m"))
    value = draw.choice(
        (draw.choice(NUMBERS), f"{draw.gauss(0, 1):.4g}", f"{draw.gauss(0, 1e-2):.4g}")
    )
    sigma = draw.choice(("0", "0.01", "1e-5", "-1", "1e9"))
    numbers = f"value = {value}, sigma = {sigma}"
    return f'"{effect}.{where}" = {{ {numbers}, unit = "{unit}" }}'


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
        at[key] = deepcopy(draw.choice(_JSON_VALUES))  # which a later change may go into
