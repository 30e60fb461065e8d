"""Tables for notebooks: data frames where pandas is installed, and plain HTML everywhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar

from orthoglide.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Framed", "data_frame", "html_table"]


class Framed(ABC):
    """An object that is displayed as a table of its ``columns``, in the units of files."""

    _index: ClassVar[str | None] = None

    @property
    @abstractmethod
    def columns(self) -> dict[str, list[Any]]:
        """Columns of equal length by name."""

    def to_frame(self) -> pd.DataFrame:
        """Return the columns as a data frame.

        Raises:
            InputError: where pandas is not installed.
        """
        return data_frame(self.columns, index=self._index)

    def _repr_html_(self) -> str:
        return html_table(repr(self)[1:-1], self.columns)


def data_frame(columns: Mapping[str, Sequence[Any]], index: str | None = None) -> pd.DataFrame:
    """Return a pandas data frame of columns of equal length; ``index`` names the column that names
    the rows, which are numbered without it.

    Raises:
        InputError: where pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError:
        raise InputError("data frames need pandas: pip install pandas") from None
    frame = pd.DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


_MAX_ROWS = 20  # of a table in a notebook


def html_table(caption: str, columns: Mapping[str, Sequence[Any]]) -> str:
    """Return an HTML table of columns by name; the middle of a long table is left out, and floats
    have five digits.
    """
    lines = list(zip(*columns.values(), strict=True))
    if len(lines) > _MAX_ROWS:
        half = _MAX_ROWS // 2
        lines = [*lines[:half], ("...",) * len(columns), *lines[-half:]]
    body = "".join(f"<tr>{_cells('td', line)}</tr>" for line in lines)
    head = f"<thead><tr>{_cells('th', columns)}</tr></thead>"
    return f"<table><caption>{escape(caption)}</caption>{head}<tbody>{body}</tbody></table>"


def _cells(kind: str, values: Iterable[Any]) -> str:
    texts = (f"{v:.5g}" if isinstance(v, float) else str(v) for v in values)
    return "".join(f"<{kind}>{escape(text)}</{kind}>" for text in texts)
