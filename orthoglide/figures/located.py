"""Curves of free-form errors."""

from __future__ import annotations

import orthoglide.figures.style as style
from orthoglide.figures.axes import Panel, padded, panel_drawing, round_ticks
from orthoglide.figures.style import Drawing
from orthoglide.result import Curve, Located

_MOST_PANELS = 6  # free-form errors of a figure
_HEIGHT = 151.0  # of a panel


def draw_located(located: Located, number: int) -> Drawing:
    """Return the figure of free-form errors with their 95 % bands; ``number`` counts from 1."""
    title, shown = "Free-form errors", located.members[:_MOST_PANELS]
    return panel_drawing(f"located-{number}", title, shown, _draw_curve, _HEIGHT)


_AXIS_LABELS = {
    "travel": "travel, mm", "approach": "travel, mm", "time": "time, s", "reading": "reading, mm",
    "reversal": "distance since the reversal, mm",
}  # fmt: skip


def _draw_curve(curve: Curve, panel: Panel) -> tuple[()]:
    at = curve.at * (1.0 if curve.against == "time" else 1e3)
    value, band = curve.value * 1e3, 1.96e3 * curve.sigma
    x, y = padded(at, 0.02), padded([*(value - band), *(value + band), 0.0], 0.05)
    axes = panel.add_axes(x, y)
    axes.band(at, value - band, value + band, style.BAND)
    axes.line(at, value, style.FIT, 1.6)
    axes.zero()
    axes.set_title(curve.name)
    axes.set_x_axis(round_ticks(x), _AXIS_LABELS.get(curve.against, "command, mm"))
    axes.set_y_axis(round_ticks(y), curve.unit)
    return ()
