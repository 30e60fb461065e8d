"""Remarks that are no errors: sentences that know what they are about."""

from __future__ import annotations

from typing import Any


class Note(str):
    """A sentence for people that programs can tell from others."""

    kind: str  # what it is about, one word
    lines: tuple[int, ...]  # lines of the file in question, where it is about lines

    def __new__(cls, text: str, kind: str, lines: tuple[int, ...] = ()) -> Note:
        """A sentence of a kind."""
        made = super().__new__(cls, text)
        made.kind, made.lines = kind, lines
        return made

    def __getnewargs__(self) -> Any:
        return str(self), self.kind, self.lines
