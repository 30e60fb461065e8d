"""What is typed, or sent by a dial, in answer to a question."""

from __future__ import annotations

import re
from decimal import Decimal
from typing import Literal

from orthoglide.errors import InputError
from orthoglide.text import brief

Word = Literal["skip", "undo", "quit", "help"]

WORDS: dict[str, Word] = {
    "skip": "skip", "s": "skip", "undo": "undo", "u": "undo", "back": "undo", "b": "undo",
    "quit": "quit", "q": "quit", "exit": "quit", "?": "help", "help": "help", "h": "help",
}  # fmt: skip

HELP = """\
  12.34   what the dial shows, in millimetres; 12,34 and 340 um are understood
  skip    this reading cannot be taken: go on with the next
  undo    take the last reading back and ask for it again (also: back)
  quit    stop here; the same command goes on later
  ?       this help"""

_NUMBER = re.compile(r"([+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+))\s*(mm|um|µm|μm)?", re.IGNORECASE)
_PLACES = {"": 0, "mm": 0}
_MOST = Decimal(1000)  # millimetres: no dial shows more


def understood(answer: str) -> Decimal | Word:
    """A reading in millimetres, exactly as it was given, or a word of `WORDS`.

    Raises:
        InputError: where it is neither.
    """
    text = answer.strip().replace("−", "-")
    if text.lower() in WORDS:
        return WORDS[text.lower()]
    found = _NUMBER.fullmatch(text)
    if found is None:
        raise InputError(
            f"{brief(text)!r} is no reading: type a number such as 12.34, or ? for help"
        )
    unit = (found[2] or "").lower()
    value = Decimal(found[1].replace(",", ".")).scaleb(_PLACES.get(unit, -3))
    if abs(value) > _MOST:
        raise InputError(f"{brief(text)} is more than any dial shows: give millimetres")
    return value
