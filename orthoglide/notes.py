"""Notes: sentences that a user should read, each with its kind, so that nobody parses words."""

from __future__ import annotations

from typing import Any, Literal

Kind = Literal["campaign", "lack_of_fit", "bound", "tolerance", "second_order", "machine"]


class Note(str):
    """A sentence for the user.

    Attributes:
        kind: what it is about.
    """

    kind: Kind

    def __new__(cls, text: str, kind: Kind) -> Note:
        """A sentence and what it is about."""
        made = super().__new__(cls, text)
        made.kind = kind
        return made

    def __getnewargs__(self) -> Any:
        return str(self), self.kind
