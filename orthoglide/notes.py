"""Notes: sentences for people with their subject for programs."""

from __future__ import annotations

from typing import Any


class Note(str):
    """A sentence for people, with attributes by which programs distinguish it."""

    kind: str  # its subject, one word
    lines: tuple[int, ...]  # numbers of the lines of a file that it is about

    def __new__(cls, text: str, kind: str, lines: tuple[int, ...] = ()) -> Note:
        """Return a note of a kind."""
        note = super().__new__(cls, text)
        note.kind, note.lines = kind, lines
        return note

    def __getnewargs__(self) -> Any:
        return str(self), self.kind, self.lines
