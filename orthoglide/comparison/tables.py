"""The comparison with the reduction as tables, figures and a page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from html import escape
from typing import Any

from orthoglide.comparison.comparing import Slice
from orthoglide.comparison.rows import READING_LIMIT, TCP_LIMIT, Difference, Row
from orthoglide.effects import family_of
from orthoglide.geometry import LEGS

_UM = 1e6
_HEAD = (
    "effect", "size", "TCP as it is: mean, max", "best translation: max",
    "six fitted: mean, max", "where", "platform turns", "readings: change",
    "six fitted: rms, max", "calibrated TCP: max", "reduction will do", "up to",
)  # fmt: skip


def verdict_text() -> str:
    """What "the reduction will do" means."""
    return (
        f"The reduction will do where, after its six parameters are fitted, the TCP is nowhere "
        f"more than {TCP_LIMIT * _UM:g} µm and the readings no more than {READING_LIMIT * _UM:g} "
        f"µm rms from the mechanism."
    )


def micrometres(value: float) -> str:
    """A length in micrometres, three digits at most; below a nanometre it counts as 0."""
    size = abs(value) * _UM
    if size < 1e-3:
        return "0"
    return f"{size:.{max(0, min(2, 2 - math.floor(math.log10(size))))}f}"


def _size(row: Row, value: float) -> str:
    if math.isnan(value):
        return "all"
    if math.isinf(value):
        return "any"
    unit = family_of(row.name).unit
    return f"{value / unit.si:.2g}" + ("" if unit.name == "1" else f" {unit.name}")


def _place(where: Difference) -> str:
    if where.max * _UM < 1e-3:
        return "–"
    return "({})".format(", ".join(f"{x * 1e3:.0f}".replace("-0", "0") for x in where.where))


def _cells(row: Row) -> tuple[str, ...]:
    def both(d: Difference) -> str:
        return f"{micrometres(d.mean)}, {micrometres(d.max)}"

    return (
        row.name,
        _size(row, row.value),
        both(row.nominal),
        micrometres(row.translated.max),
        both(row.fitted),
        _place(row.fitted),
        micrometres(row.rotation),
        micrometres(row.reading_change),
        f"{micrometres(row.reading_rms)}, {micrometres(row.reading_max)}",
        micrometres(row.identified.max),
        "yes" if row.good_enough else "no",
        "–" if math.isnan(row.value) else _size(row, row.good_up_to),
    )


def markdown_table(rows: Sequence[Row]) -> str:
    """The table in Markdown: micrometres, microradians, and millimetres for places."""
    lines = ["| " + " | ".join(_HEAD) + " |", "|" + "---|" * len(_HEAD)]
    lines += ["| " + " | ".join((f"`{c[0]}`", *c[1:])) + " |" for c in map(_cells, rows)]
    return "\n".join(lines) + "\n"


def csv_table(rows: Sequence[Row]) -> str:
    """All numbers of the rows as CSV, names with their unit."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for k, row in enumerate(rows):
        record = _record(row)
        if k == 0:
            writer.writerow(record)
        writer.writerow(record.values())
    return stream.getvalue()


def _record(row: Row) -> dict[str, Any]:
    unit = None if math.isnan(row.value) else family_of(row.name).unit
    record: dict[str, Any] = {
        "effect": row.name,
        "value": "" if unit is None else f"{row.value / unit.si:.6g}",
        "unit": "" if unit is None else unit.name,
    }
    for name in ("nominal", "translated", "fitted", "identified"):
        difference: Difference = getattr(row, name)
        record[f"tcp_{name}_mean_mm"] = f"{difference.mean * 1e3:.7f}"
        record[f"tcp_{name}_max_mm"] = f"{difference.max * 1e3:.7f}"
        for axis, at in zip(LEGS, difference.where, strict=True):
            record[f"tcp_{name}_max_at_{axis}_mm"] = f"{at * 1e3:.3f}"
    six = (f"{kind}_{leg}_mm" for kind in ("fitted_offset", "fitted_length") for leg in LEGS)
    record.update({n: f"{v * 1e3:.7f}" for n, v in zip(six, row.six, strict=True)})
    return {
        **record,
        "rotation_max_rad": f"{row.rotation:.9f}",
        "reading_change_rms_mm": f"{row.reading_change * 1e3:.7f}",
        "reading_fitted_rms_mm": f"{row.reading_rms * 1e3:.7f}",
        "reading_fitted_max_mm": f"{row.reading_max * 1e3:.7f}",
        "reduction_will_do": "yes" if row.good_enough else "no",
    }


def slice_figure(title: str, planes: Sequence[Slice]) -> str:
    """Three planes of the cube in SVG, coloured by the difference at the TCP after the fit."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    top = max(float(plane.difference.max()) for plane in planes) * _UM
    # A fixed salt and no date: the same numbers give the same bytes.
    with matplotlib.rc_context({"svg.hashsalt": "orthoglide", "svg.fonttype": "none"}):
        figure = Figure(figsize=(9.5, 3.2), layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.subplots(1, 3)
        for ax, plane in zip(axes, planes, strict=True):
            across, up = (axis for axis in range(3) if axis != plane.normal)
            mesh = ax.pcolormesh(
                plane.p[..., across] * 1e3,
                plane.p[..., up] * 1e3,
                plane.difference * _UM,
                vmin=0,
                vmax=max(top, 1e-3),
                shading="nearest",
                rasterized=True,
            )
            ax.set(xlabel=f"{LEGS[across]}, mm", ylabel=f"{LEGS[up]}, mm", aspect="equal")
            ax.set_title(f"{LEGS[plane.normal]} = 0", fontsize="medium")
        figure.colorbar(mesh, ax=axes, label="difference at the TCP, µm")
        figure.suptitle(title, fontsize="medium")
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return stream.getvalue()


def comparison_page(
    title: str, sections: Sequence[tuple[str, Sequence[Row]]], figures: Sequence[str]
) -> str:
    """One self-contained HTML page: tables by heading, then figures (SVG texts)."""
    body = [f"<h1>{escape(title)}</h1><p>{escape(verdict_text())} {escape(LEGEND)}</p>"]
    for heading, rows in sections:
        head = "".join(f"<th>{escape(name)}</th>" for name in _HEAD)
        lines = [
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in _cells(row)) + "</tr>"
            for row in rows
        ]
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
        body.append(f"<h2>{escape(heading)}</h2><div>{table}</div>")
    body += [f"<figure>{svg[svg.index('<svg') :]}</figure>" for svg in figures]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body>{''.join(body)}</body></html>\n"
    )


LEGEND = (
    "Lengths in µm, turns of the platform in µrad, places as TCP in mm, all over the cube of TCP "
    "points within the strokes; calibrated TCP: identified from the readings with the tolerances "
    "as priors, after the best translation; up to: the size at which the reduction stops being "
    "enough, by proportion."
)
"""What the table's columns are."""

_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;"
    "color:#1f2a33}div{overflow-x:auto}table{border-collapse:collapse;font-size:13px}"
    "td,th{border-bottom:1px solid #dfe4e8;padding:.25rem .5rem;text-align:right;"
    "white-space:nowrap}th{white-space:normal}td:first-child,th:first-child{text-align:left}"
    "figure{margin:1.5rem 0}svg{max-width:100%;height:auto}"
)
