"""Output that cannot fail a finished run: full, closed and narrow terminals."""

from __future__ import annotations

import codecs
import errno
import os
import re
import shutil
import sys
import textwrap
import unicodedata

import click

from orthoglide.errors import FileError
from orthoglide.text import is_terminal

_PLAIN = "orthoglide.plain"
_SIGNS = {"−": "-", "–": "-", "—": "-", "·": "*", "→": "->", "≤": "<=", "≥": ">=", "χ": "chi",
          "±": "+-", "µ": "u", "μ": "u", "°": " deg", "…": "..."}  # fmt: skip
_RULES = dict.fromkeys("─━═", "-") | dict.fromkeys("│┃║", "|")
_RAISED = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")


def say(text: str | bytes, *, err: bool = False, needed: bool = False) -> None:
    """Print a text and a line end, or the bytes of a file as they are.

    Args:
        text: what to print.
        err: on the error stream.
        needed: whether nothing else is left of the run: only then is a failure one.

    Raises:
        FileError: where it is needed and the output is full or closed. A reader who has seen enough
            (``| head``) is no failure.
    """
    stream = sys.stderr if err else sys.stdout
    try:
        if stream is None:
            raise OSError(errno.EBADF, "closed")
        if isinstance(text, str) and is_terminal(err):
            text = wrapped(text, shutil.get_terminal_size().columns)
        click.echo(text, file=stream, nl=isinstance(text, str))
        stream.flush()
    except (OSError, ValueError) as error:
        # Nothing more is written there, not what is left in its buffer at the end either.
        nowhere = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        setattr(sys, "stderr" if err else "stdout", nowhere)
        number = getattr(error, "errno", None)
        if needed and number != errno.EPIPE:
            reason = (getattr(error, "strerror", None) or "closed").lower()
            raise FileError(
                f"cannot be written ({reason}): choose another place", file="standard output"
            ) from None


def tell(text: str, line: str, quiet: bool, kept: bool) -> None:
    """Print what was found, or with ``--quiet`` one line of it where no file keeps it.

    Raises:
        FileError: as `say`.
    """
    if not quiet or not kept:
        say(line if quiet else text, needed=not kept)


def wrapped(text: str, width: int) -> str:
    """Lines too long for a terminal broken between words; what follows stands below the words."""
    return "\n".join(_broken(line, width) for line in text.split("\n"))


def _broken(line: str, width: int) -> str:
    indent = len(line) - len(line.lstrip(" -"))
    if len(line) <= width or indent > width // 2:
        return line
    return textwrap.fill(line, width, subsequent_indent=" " * indent, replace_whitespace=False,
                         break_long_words=False, break_on_hyphens=False)  # fmt: skip


def speak_plainly() -> None:
    """Have this process write what its terminal's alphabet has, and spell out what it has not."""
    codecs.register_error(_PLAIN, _spelt)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_PLAIN)


def _spelt(error: UnicodeError) -> tuple[str, int]:
    """What to write for characters that an encoding has not: a minus sign is never lost."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = _RAISED.sub(lambda m: "^" + m[0], error.object[error.start : error.end])
    return "".join(map(_ascii, text)), error.end


def _ascii(character: str) -> str:
    known = _SIGNS.get(character) or _RULES.get(character)
    plain = unicodedata.normalize("NFKD", character).replace("−", "-")
    return known or plain.encode("ascii", "ignore").decode() or "?"
