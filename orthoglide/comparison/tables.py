"""A comparison as files: tables and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from orthoglide.comparison.comparing import Slice, slices
from orthoglide.comparison.rows import READING_LIMIT, TCP_LIMIT, Difference, Row
from orthoglide.figures import style
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import csv_text
from orthoglide.progress import Progress, Step, no_progress

_TITLE = "When the simplified model is good enough"
_UM = 1e6

LIMITS = (
    f"The reduction will do where, after its six parameters are fitted, the TCP is nowhere more "
    f"than {TCP_LIMIT * _UM:g} µm and the readings no more than {READING_LIMIT * _UM:g} µm rms "
    f"from the mechanism."
)
"""What "the reduction will do" means."""

LEGEND = (
    "Lengths in µm, turns of the platform in µrad, places as TCP in mm, all over the cube of TCP "
    "points within the strokes; calibrated TCP: identified from the readings with the tolerances "
    "as priors, after the best translation; up to: the size at which the reduction stops being "
    "enough, by proportion."
)
"""What the table's columns are."""

_LEGEND_WITHOUT_DIALS = (
    f"The reduction will do where, after its six parameters are fitted, the TCP is nowhere more "
    f"than {TCP_LIMIT * _UM:g} µm from the mechanism. Readings are not compared: dials are set "
    f"against the legs of an Orthoglide alone. Lengths in µm, turns of the platform in µrad, "
    f"places as TCP in mm, all over the workspace; up to: the size at which the reduction stops "
    f"being enough, by proportion."
)
"""The legend where no dials stand on legs."""


def micrometres(*values: float) -> str:
    """Return lengths in micrometres, three digits at most; below a nanometre they count as 0."""

    def text(um: float) -> str:
        if um < 1e-3:
            return "0"
        return f"{um:.{max(0, min(2, 2 - math.floor(math.log10(um))))}f}"

    return ", ".join(text(abs(value) * _UM) for value in values)


def _size_text(row: Row, value: float, machine: str) -> str:
    if math.isnan(value):
        return machine
    if math.isinf(value):
        return "any"
    return f"{value / row.unit.si:.2g}" + row.unit.behind


def _place_text(difference: Difference) -> str:
    if difference.max * _UM < 1e-3:
        return "–"
    return "({})".format(", ".join(plain(x * 1e3, 0) for x in difference.where))


_READING_COLUMNS = ("readings: change", "six fitted: rms, max", "calibrated TCP: max")

_COLUMNS: dict[str, Callable[[Row], str]] = {
    "effect": lambda row: row.name,
    "size": lambda row: _size_text(row, row.value, "all"),
    "TCP as it is: mean, max": lambda row: micrometres(row.nominal.mean, row.nominal.max),
    "best translation: max": lambda row: micrometres(row.translated.max),
    "six fitted: mean, max": lambda row: micrometres(row.fitted.mean, row.fitted.max),
    "where": lambda row: _place_text(row.fitted),
    "platform turns": lambda row: micrometres(row.rotation),
    "readings: change": lambda row: micrometres(row.reading_change),
    "six fitted: rms, max": lambda row: micrometres(row.reading_rms, row.reading_max),
    "calibrated TCP: max": lambda row: micrometres(row.identified.max),
    "reduction will do": lambda row: "yes" if row.good_enough else "no",
    "up to": lambda row: _size_text(row, row.value and row.good_up_to, "–"),
}


def _cells_by_column(rows: Sequence[Row]) -> dict[str, list[str]]:
    read = any(row.read for row in rows)
    return {
        head: [cell(row) for row in rows] for head, cell in _COLUMNS.items()
        if read or head not in _READING_COLUMNS
    }  # fmt: skip


def legend(rows: Sequence[Row]) -> str:
    """Return what the columns of the tables mean."""
    return f"{LIMITS} {LEGEND}" if any(row.read for row in rows) else _LEGEND_WITHOUT_DIALS


def markdown_table(rows: Sequence[Row], columns: Sequence[str] | None = None) -> str:
    """Return the table in Markdown: micrometres, microradians, and millimetres for places.

    Args:
        rows: effects, or a machine.
        columns: heads of the columns to show; all where absent.
    """
    table = _cells_by_column(rows)
    table = {head: table[head] for head in columns or table}
    table["effect"] = [f"`{name.replace('|', '/')}`" for name in table["effect"]]
    cells = [tuple(table), *zip(*table.values(), strict=True)]
    lines = ["| " + " | ".join(line) + " |" for line in cells]
    lines.insert(1, "|" + "---|" * len(table))
    return "\n".join(lines) + "\n"


def short_table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return heads and rows of a table for the terminal, with the largest residuals."""
    read = any(row.read for row in rows)
    columns = ("effect", "TCP, max, µm", *["readings, rms, µm"] * read, "reduction will do")
    cells = [
        (
            row.name,
            micrometres(row.fitted.max),
            *([micrometres(row.reading_rms)] if read else []),
            "yes" if row.good_enough else "no",
        )
        for row in rows
    ]
    return columns, cells


def csv_table(rows: Sequence[Row]) -> str:
    """Return all numbers of the rows as CSV, names with their unit."""
    return csv_text([_csv_record(row) for row in rows])


def _csv_record(row: Row) -> dict[str, str]:
    is_parameter = not math.isnan(row.value)
    record = {
        "effect": row.name,
        "value": f"{row.value / row.unit.si:.6g}" if is_parameter else "",
        "unit": row.unit.name if is_parameter else "",
    }
    for name in ("nominal", "translated", "fitted", *["identified"] * row.read):
        difference: Difference = getattr(row, name)
        record[f"tcp_{name}_mean_mm"] = f"{difference.mean * 1e3:.7f}"
        record[f"tcp_{name}_max_mm"] = f"{difference.max * 1e3:.7f}"
        for axis, coordinate in zip(LEGS, difference.where, strict=True):
            record[f"tcp_{name}_max_at_{axis}_mm"] = f"{round(coordinate * 1e3, 3) + 0.0:.3f}"
    names = (f"{kind}_{leg}_mm" for kind in ("fitted_offset", "fitted_length") for leg in row.legs)
    lengths = dict(zip(names, row.six, strict=True))
    if row.read:
        lengths |= {
            "reading_change_rms_mm": row.reading_change,
            "reading_fitted_rms_mm": row.reading_rms,
            "reading_fitted_max_mm": row.reading_max,
        }
    # Zero has no sign, which rounding would choose.
    record |= {name: f"{round(value * 1e3, 7) + 0.0:.7f}" for name, value in lengths.items()}
    record["rotation_max_rad"] = f"{row.rotation:.9f}"
    return record | {"reduction_will_do": "yes" if row.good_enough else "no"}


def slice_figure(title: str, planes: Sequence[Slice]) -> str:
    """Return three planes of the workspace as SVG, coloured by the difference at the TCP."""
    largest = max(float(np.nanmax(plane.difference)) for plane in planes) * _UM
    with style.figure_style():
        figure = style.new_figure(9.5, 3.2)
        figure.set_layout_engine("constrained")
        axes = figure.subplots(1, 3)
        for ax, plane in zip(axes, planes, strict=True):
            across, up = (axis for axis in range(3) if axis != plane.normal)
            x, y = plane.p[..., across] * 1e3, plane.p[..., up] * 1e3
            size = plane.difference * _UM
            limits = {"vmin": 0, "vmax": max(largest, 1e-3)}
            mesh = ax.pcolormesh(x, y, size, shading="nearest", rasterized=True, **limits)
            ax.set(xlabel=f"{LEGS[across]}, mm", ylabel=f"{LEGS[up]}, mm", aspect="equal")
            ax.set_title(f"{LEGS[plane.normal]} = 0", fontsize="medium")
        figure.colorbar(mesh, ax=axes, label="difference at the TCP, µm")
        figure.suptitle(title, fontsize="medium")
        return style.svg_text(figure)


def comparison_files(
    machine: Machine,
    whole: Sequence[Row],
    rows: Sequence[Row],
    drawn: Sequence[Row] = (),
    progress: Progress = no_progress,
) -> dict[str, str]:
    """Return the files of a comparison's folder by name.

    Args:
        machine: that was compared.
        whole: rows of all that it was identified to have; may be empty.
        rows: rows of every effect at its tolerance.
        drawn: rows of which a figure is drawn, if the reduction cannot follow them.
        progress: called with each figure.
    """
    figures = _figures(machine, drawn, progress)
    sections = {
        f"{machine.spec.title}: all it has, and each alone": whole,
        "Every effect at its tolerance": rows,
    }
    tables = "".join(
        f"\n## {name}\n\n{markdown_table(part)}" for name, part in sections.items() if part
    )
    all_rows = [*whole, *rows]
    return {
        "table.csv": csv_table(all_rows),
        "table.md": f"# {_TITLE}\n\n{legend(all_rows)}\n{tables}",
        **{f"figures/{name}.svg": svg for name, svg in figures},
    }


def _figures(
    machine: Machine, rows: Sequence[Row], progress: Progress
) -> Iterator[tuple[str, str]]:
    """Yield drawings of the machine as identified, and of effects the reduction cannot follow."""
    for row in rows:
        progress(Step("computing", f"drawing {row.name}"))
        if not row.effect:
            yield row.name, slice_figure(machine.spec.title, slices(machine))
        elif not row.good_enough and row.fitted.max > 0:
            single_error = machine.with_only({row.name: row.value})
            yield row.name, slice_figure(f"{row.name} at its tolerance", slices(single_error))
