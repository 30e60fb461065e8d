"""Predicted readings of each cause and its rivals, and curves of free-form errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import orthoglide.figures.style as style
from orthoglide.figures.axes import Key, Panel, padded, panel_drawing, round_ticks
from orthoglide.figures.style import Drawing
from orthoglide.geometry import Array
from orthoglide.ordering import descending
from orthoglide.result import Cause, Curve, Explanation, Located, Mounting, ReadingsShown

_MOST_PANELS = 6  # setups, or places, of a figure
_HEIGHT = 151.0  # of a panel
_MIN_PATTERN = 0.15  # smallest pattern of a cause that is drawn, relative to the largest
_MIN_DIFFERENCE = 0.03  # smallest difference between approaches, relative to the residuals' range
_CURVES = (  # the chosen cause, then its rivals
    (style.FIT, "-", 2.6, 0.75),
    (style.PALETTE["minus"], "--", 1.3, 1.0),
    (style.PALETTE["third"], ":", 1.7, 1.0),
    (style.INK, "-.", 1.0, 1.0),
)


@dataclass(frozen=True)
class Pattern:
    """Residuals of one setup without a cause and the predictions of causes, mm or mrad."""

    mounting: Mounting  # the setup
    x: Array  # by station
    side: Array  # direction of approach of the touched leg's axis, by station
    residual: Array  # mean residual, by station
    noise: Array  # two standard deviations of that mean
    curves: tuple[Array, ...]  # predictions of the causes, by station

    @property
    def distinct_sides(self) -> list[float]:
        """Both directions of approach if the prediction depends on them; else none."""
        up, down = (
            dict(zip(np.round(self.x[rows], 3).tolist(), self.curves[0][rows], strict=True))
            for rows in (self.side == 1, self.side == -1)
        )
        differences = [abs(up[x] - down[x]) for x in up if x in down]
        differ = differences and max(differences) > _MIN_DIFFERENCE * float(np.ptp(self.residual))
        return [1.0, -1.0] if differ else []


def drawn_explanations(cause: Cause) -> tuple[Explanation, ...]:
    """Return the explanations of a credible set that have predicted readings."""
    return tuple(one for one in cause.explanations if len(one.shown))


def _patterns(cause: Cause, readings: ReadingsShown) -> list[Pattern]:
    residual = readings.measured - readings.after + cause.chosen.shown
    predicted = [one.shown for one in drawn_explanations(cause)]
    patterns = []
    for mounting in readings.mountings:
        rows = mounting.rows
        _, first, station = np.unique(
            readings.station[rows], return_index=True, return_inverse=True
        )
        noise = readings.sigma[rows[first]] / np.sqrt(np.bincount(station))
        patterns.append(
            Pattern(
                mounting,
                mounting.x[first],
                mounting.side[first],
                _station_means(residual[rows], station),
                2e3 * np.hypot(noise, readings.common[rows[first]]),
                tuple(_station_means(p[rows], station) for p in predicted),
            )
        )
    return patterns


def _station_means(values: Array, station: NDArray[np.intp]) -> Array:
    """Return means by station, millimetres or milliradians."""
    return np.asarray(np.bincount(station, values) / np.bincount(station) * 1e3)


def _largest_patterns(patterns: list[Pattern]) -> list[Pattern]:
    """Return the setups with the largest effect of a cause, in the order of the file."""
    size = np.array([np.sqrt(np.mean(p.curves[0] ** 2)) for p in patterns])
    shown = set(descending(size)[:_MOST_PANELS])
    return [
        p for k, p in enumerate(patterns) if k in shown and size[k] >= _MIN_PATTERN * size.max()
    ]


def draw_signatures(cause: Cause, readings: ReadingsShown, number: int) -> Drawing:
    """Return the figure of predictions of a cause and its rivals; ``number`` counts from 1."""
    patterns = _largest_patterns(_patterns(cause, readings))
    limits: dict[str, float] = {}
    for pattern in patterns:
        unit = pattern.mounting.unit
        largest = float(np.max(np.abs(pattern.residual) + pattern.noise))
        limits[unit] = max(limits.get(unit, 0.0), 1.15 * largest)

    def draw(pattern: Pattern, panel: Panel) -> list[Key]:
        return _draw_pattern(panel, pattern, limits[pattern.mounting.unit])

    names = [drawn.name for drawn in drawn_explanations(cause)]
    title = "What is to be explained, and what each cause makes of it"
    return panel_drawing(f"signatures-{number}", title, patterns, draw, _HEIGHT, names)


def _draw_pattern(panel: Panel, pattern: Pattern, limit: float) -> list[Key]:
    """Draw one panel, and return a key for each cause."""
    x, y = padded(pattern.x, 0.05), (-limit, limit)
    axes, sides, keys = panel.add_axes(x, y), pattern.distinct_sides, []
    for curve, (colour, dash, width, alpha) in zip(pattern.curves, _CURVES, strict=False):
        for side in sides or [0.0]:
            rows = np.flatnonzero(pattern.side == side) if sides else np.arange(len(pattern.x))
            order = rows[np.lexsort([curve[rows], pattern.x[rows]])]
            key = axes.line(pattern.x[order], curve[order], colour, width, dash, alpha)
        keys.append(key)
    marks = {1.0: "^", -1.0: "v"} if len(sides) > 1 else {}
    axes.segments(pattern.x, pattern.residual - pattern.noise, pattern.x,
                  pattern.residual + pattern.noise, style.DATA, 0.8)  # fmt: skip
    for side in sides or [0.0]:
        rows = pattern.side == side if sides else np.ones(len(pattern.x), dtype=bool)
        shape = marks.get(side, "o")
        axes.points(pattern.x[rows], pattern.residual[rows], style.DATA, 4.2, shape)
    axes.zero()
    axes.set_title(pattern.mounting.title)
    axes.set_x_axis(round_ticks(x), pattern.mounting.label)
    axes.set_y_axis(round_ticks(y), pattern.mounting.unit)
    return keys


def draw_located(located: Located, number: int) -> Drawing:
    """Return the figure of free-form errors with their 95 % bands; ``number`` counts from 1."""
    title, shown = "What was found, by place", located.members[:_MOST_PANELS]
    return panel_drawing(f"located-{number}", title, shown, _draw_curve, _HEIGHT)


_AXIS_LABELS = {
    "travel": "travel, mm", "approach": "travel, mm", "time": "time, s", "reading": "reading, mm",
    "reversal": "way since the drive turned, mm",
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
