"""Text: printable text, quotations from files, CSV tables, sentences and lists."""

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
"""Placeholder for the machine in a recommended command, which the printing code replaces."""

_FILE_WIDTH = 100  # of text that goes to a file
_MAX_QUOTED_LENGTH = 40  # characters of a file's text that a message repeats

# Control characters, surrogates, non-characters, and characters that reverse or break lines: no
# page, figure or terminal shows them, and XML does not allow them.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufdd0-\ufdef"
    "\ufffe\uffff]"
)


def unprintable(text: str) -> str:
    """Return the first unprintable character of a text, as ``U+001B``; empty for none."""
    match = _UNPRINTABLE.search(text)
    return f"U+{ord(match[0]):04X}" if match else ""


def leaves(data: Any) -> Iterator[Any]:
    """Yield every value and key of nested mappings and lists."""
    pending = [data]
    while pending:
        value = pending.pop()
        if isinstance(value, Mapping):
            pending += [*value, *value.values()]
        elif isinstance(value, list):
            pending += value
        else:
            yield value


def unprintable_problem(data: Any) -> str:
    """Return an error message for the first unprintable text in nested mappings and lists."""
    for value in leaves(data):
        if isinstance(value, str) and (character := unprintable(value)):
            readable = abbreviated(_UNPRINTABLE.sub("", value))
            return (
                f"holds the character {character}, which cannot be shown, in {readable!r}: "
                f"remove it"
            )
    return ""


def printable_path(path: str | os.PathLike[str]) -> str:
    """Return a file's name with unprintable characters replaced by U+FFFD."""
    return _UNPRINTABLE.sub("\ufffd", os.fspath(path))


def abbreviated(text: str, max_length: int = _MAX_QUOTED_LENGTH) -> str:
    """Return a text shortened to its beginning where it is long, for a message."""
    return text if len(text) <= max_length else f"{text[: max_length - 3]}..."


def nearest(word: str, names: Iterable[str]) -> str:
    """Return the name that a word most resembles, or nothing where none is similar."""
    return next(iter(get_close_matches(word, list(names), n=1, cutoff=0.6)), "")


# Cells that a spreadsheet computes instead of displaying; signed numbers and directions are not.
_FORMULA = re.compile(r"'*(?:[=@]|[+-](?![\w.]*$))")

_FORMULA_STARTS = "'=@+-"  # first characters of a formula, a quick test before the pattern


def csv_text(names: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return CSV text of a header and rows. A cell that a spreadsheet would compute gets a leading
    apostrophe, which :func:`cell_text` removes.
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
    """Return the original text of a cell of a CSV file; see :func:`csv_text`."""
    cell = cell.strip()
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def text_width() -> int:
    """Return the width of the terminal, or ``COLUMNS``; 100 where the output goes to a file."""
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


def is_terminal() -> bool:
    """Return whether the output is a terminal."""
    try:
        return sys.stdout is not None and sys.stdout.isatty()
    except (AttributeError, ValueError):  # no file, or closed
        return False


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop; a parameter's name stays in lower case."""
    first = text.partition(" ")[0]
    capital = text if "_" in first or "." in first else text[:1].upper() + text[1:]
    return capital if capital.endswith("?") else f"{capital}."


def lower_first(text: str) -> str:
    """Return a sentence with a small first letter, to follow other words."""
    return text[:1].lower() + text[1:]


def listed(parts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    items = list(parts)
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"
