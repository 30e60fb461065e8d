"""A comparison as files: tables and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from orthoglide.comparison.comparing import READING_LIMIT, TCP_LIMIT, Row
from orthoglide.figures import style
from orthoglide.figures.draw import draw_levels
from orthoglide.machine import Machine

_UM = 1e6

LIMITS = (
    f"The simplified model will do where, after its six parameters are fitted, the TCP is nowhere "
    f"more than {TCP_LIMIT * _UM:g} µm and the readings no more than {READING_LIMIT * _UM:g} µm "
    f"rms from the mechanism."
)
"""When the simplified model will do."""

_LEGEND = (
    "Differences once the six parameters are fitted, turns of the platform in µrad; up to: the "
    "largest size at which the simplified model will do, by proportion."
)
_NOT_READ = " Readings are not compared: dials are set against the legs of an Orthoglide alone."


def micrometres(value: float) -> str:
    """Return a length in micrometres, three digits at most; below a nanometre it counts as 0."""
    um = abs(value) * _UM
    if um < 1e-3:
        return "0"
    return f"{um:.{max(0, min(2, 2 - math.floor(math.log10(um))))}f}"


def _size_text(row: Row, value: float, machine: str) -> str:
    if math.isnan(value):
        return machine
    if math.isinf(value):
        return "any"
    return f"{value / row.unit.si:.2g}" + row.unit.behind


_OF_READINGS = "readings differ, rms, µm"
_COLUMNS: dict[str, Callable[[Row], str]] = {
    "effect": lambda row: row.name,
    "size": lambda row: _size_text(row, row.value, "all"),
    "TCP differs, max, µm": lambda row: micrometres(row.fitted.max),
    "platform turns": lambda row: micrometres(row.rotation),
    _OF_READINGS: lambda row: micrometres(row.reading_rms),
    "will do": lambda row: "yes" if row.good_enough else "no",
    "up to": lambda row: _size_text(row, row.value and row.good_up_to, "–"),
}
_SHORT = ("effect", "TCP differs, max, µm", _OF_READINGS, "will do")


def short_table(
    rows: Sequence[Row], columns: Iterable[str] = _SHORT
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return heads and rows of a table, by default for the terminal; that of readings only where
    some were compared.
    """
    read = any(row.read for row in rows)
    heads = tuple(head for head in columns if read or head != _OF_READINGS)
    return heads, [tuple(_COLUMNS[head](row) for head in heads) for row in rows]


def markdown_table(rows: Sequence[Row], columns: Iterable[str] = tuple(_COLUMNS)) -> str:
    """Return the table in Markdown, turns of the platform in microradians."""
    heads, cells = short_table(rows, columns)
    names = [f"`{name.replace('|', '/')}`" for name, *_ in cells]
    lines = [heads, *((name, *row[1:]) for name, row in zip(names, cells, strict=True))]
    text = ["| " + " | ".join(line) + " |" for line in lines]
    text.insert(1, "|" + "---|" * len(heads))
    return "\n".join(text) + "\n"


def comparison_files(
    machine: Machine,
    whole: Sequence[Row],
    rows: Sequence[Row],
    drawn: Sequence[Row] = (),
) -> dict[str, str]:
    """Return the files of a comparison's folder by name.

    Args:
        machine: that was compared.
        whole: rows of all that it was identified to have; may be empty.
        rows: rows of every effect at its tolerance.
        drawn: rows of which a figure is drawn, if the reduction cannot follow them.
    """
    legend = f"{LIMITS} {_LEGEND}{'' if any(row.read for row in (*whole, *rows)) else _NOT_READ}"
    text = f"# When the simplified model is good enough\n\n{legend}\n"
    if whole:
        title = f"{machine.spec.title}: all it has, and each alone"
        text += f"\n## {title}\n\n{markdown_table(whole)}"
    if rows:
        text += f"\n## Every effect at its tolerance\n\n{markdown_table(rows)}"
    files = {"table.md": text}
    for row in drawn:
        if not row.effect or (not row.good_enough and row.fitted.max > 0):
            shown = [(f"{row.name}, µm", row.difference * _UM, style.FIT)]
            title = f"{row.name}: difference at the TCP over the workspace, µm"
            drawing = draw_levels(row.name, title, shown, row.at, "{} of the TCP")
            files[f"figures/{row.name}.svg"] = drawing.svg
    return files
