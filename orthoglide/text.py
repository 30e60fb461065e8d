"""Text: what of a file can be shown, repeated and tabulated; sentences and lists."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

MACHINE_OPTION = " --machine FILE"
"""In an advised command the machine that whoever prints it knows."""

_FILE_WIDTH = 100  # of text that goes to a file
_MAX_QUOTED_LENGTH = 40  # characters of a file's text that a message repeats

# Controls, halves of pairs, what is no character, and what turns or breaks lines unseen: no page,
# figure or terminal shows them, and XML has none of them.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufdd0-\ufdef"
    "\ufffe\uffff]"
)


def unprintable(text: str) -> str:
    """The first character of a text that cannot be shown, as ``U+001B``; empty where none is."""
    found = _UNPRINTABLE.search(text)
    return f"U+{ord(found[0]):04X}" if found else ""


def leaves(data: Any) -> Iterator[Any]:
    """Every value in nested mappings and lists, and every key."""
    waiting = [data]
    while waiting:
        value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [*value, *value.values()]
        elif isinstance(value, list):
            waiting += value
        else:
            yield value


def unprintable_problem(data: Any) -> str:
    """What is wrong with the first text in nested mappings and lists that cannot be shown."""
    for value in leaves(data):
        if isinstance(value, str) and (found := unprintable(value)):
            readable = abbreviated(_UNPRINTABLE.sub("", value))
            return f"holds the character {found}, which cannot be shown, in {readable!r}: remove it"
    return ""


def printable_path(path: str | os.PathLike[str]) -> str:
    """A file's name for people and for results: what cannot be shown stands as U+FFFD."""
    return _UNPRINTABLE.sub("\ufffd", os.fspath(path))


def abbreviated(text: str, most: int = _MAX_QUOTED_LENGTH) -> str:
    """A text from a file as a message repeats it: its beginning where it is long."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def nearest(word: str, names: Iterable[str]) -> str:
    """Return the name that a word most resembles, or nothing where none is similar."""
    return next(iter(get_close_matches(word, list(names), n=1, cutoff=0.6)), "")


# What a spreadsheet computes instead of showing it; signed numbers and directions are harmless.
_FORMULA = re.compile(r"'*(?:[=@]|[+-](?![\w.]*$))")

_FORMULA_STARTS = "'=@+-"  # what a formula begins with, which is quicker to ask for


def csv_text(names: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """CSV text of a header and rows; a cell that a spreadsheet would compute has an apostrophe
    before it, which :func:`cell_text` takes off again.
    """
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for row in (names, *rows):
        cells = map(str, row)
        writer.writerow(
            [f"'{c}" if c[:1] in _FORMULA_STARTS and _FORMULA.match(c) else c for c in cells]
        )
    return stream.getvalue()


def cell_text(cell: str) -> str:
    """A cell of a CSV file as it was meant: see :func:`csv_text`."""
    cell = cell.strip()
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def text_width() -> int:
    """Columns of the terminal, or as ``COLUMNS`` says; 100 where the output goes to a file."""
    if is_terminal() or os.environ.get("COLUMNS", "").isdigit():
        return shutil.get_terminal_size((_FILE_WIDTH, 24)).columns
    return _FILE_WIDTH


def wrapped(text: str) -> str:
    """Return a text with lines broken between words where they are wider than the terminal."""
    width = text_width()
    return "\n".join(
        textwrap.fill(
            line, width, subsequent_indent=" " * (len(line) - len(line.lstrip(" -"))),
            replace_whitespace=False, break_long_words=False, break_on_hyphens=False,
        )
        if len(line) > width else line
        for line in text.split("\n")
    )  # fmt: skip


def is_terminal(err: bool = False) -> bool:
    """Whether somebody sees the output, or the error stream, as it comes."""
    stream = sys.stderr if err else sys.stdout
    try:
        return stream is not None and stream.isatty()
    except (AttributeError, ValueError):  # no file, or closed
        return False


def sentence(text: str) -> str:
    """With a capital and a full stop; a parameter's name keeps its small letter."""
    first = text.partition(" ")[0]
    capital = text if "_" in first or "." in first else text[:1].upper() + text[1:]
    return capital if capital.endswith("?") else f"{capital}."


def listed(parts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    every = list(parts)
    if len(every) < 2:
        return "".join(every)
    return f"{', '.join(every[:-1])} and {every[-1]}"
