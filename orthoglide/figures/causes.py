"""Predicted readings of each cause and its rivals, and curves of free-form errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import orthoglide.figures.style as style
from orthoglide.figures.style import Drawing
from orthoglide.geometry import Array
from orthoglide.ordering import descending
from orthoglide.result import Cause, Curve, Explanation, Located, Mounting, ReadingsShown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_MOST_PANELS = 6  # setups, or places, of a figure
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

    def draw(pattern: Pattern, place: style.Place) -> list[Line2D]:
        axes, limit = place(), limits[pattern.mounting.unit]
        handles = _draw_pattern(axes, pattern)
        axes.set_ylim(-limit, limit)
        style.few_ticks(axes)
        return handles

    names = [drawn.name for drawn in drawn_explanations(cause)]
    title = "What is to be explained, and what each cause makes of it"
    return style.panel_drawing(f"signatures-{number}", title, patterns, draw, legend=names)


def _draw_pattern(axes: Axes, pattern: Pattern) -> list[Line2D]:
    """Draw one panel, and return a handle for each cause."""
    sides = pattern.distinct_sides
    handles = []
    for curve, (colour, dash, width, alpha) in zip(pattern.curves, _CURVES, strict=False):
        for side in sides or [0.0]:
            rows = np.flatnonzero(pattern.side == side) if sides else np.arange(len(pattern.x))
            order = rows[np.lexsort([curve[rows], pattern.x[rows]])]
            (line,) = axes.plot(pattern.x[order], curve[order], color=colour, linestyle=dash,
                                linewidth=width, alpha=alpha)  # fmt: skip
        handles.append(line)
    marks = {1.0: "^", -1.0: "v"} if len(sides) > 1 else {}
    axes.vlines(pattern.x, pattern.residual - pattern.noise, pattern.residual + pattern.noise,
                color=style.DATA, linewidth=0.8)  # fmt: skip
    for side in sides or [0.0]:
        rows = pattern.side == side if sides else np.ones(len(pattern.x), dtype=bool)
        axes.plot(pattern.x[rows], pattern.residual[rows], color=style.DATA, linestyle="none",
                  marker=marks.get(side, "o"), markersize=4.2, markeredgewidth=0)  # fmt: skip
    axes.axhline(0, color=style.MUTED, linewidth=0.6)
    mounting = pattern.mounting
    style.label_axes(axes, mounting.title, mounting.label, mounting.unit)
    axes.margins(x=0.05)
    return handles


def draw_located(located: Located, number: int) -> Drawing:
    """Return the figure of free-form errors with their 95 % bands; ``number`` counts from 1."""
    title, shown = "What was found, by place", located.members[:_MOST_PANELS]
    return style.panel_drawing(f"located-{number}", title, shown, _draw_curve)


_AXIS_LABELS = {
    "travel": "travel, mm", "approach": "travel, mm", "time": "time, s", "reading": "reading, mm",
    "reversal": "way since the drive turned, mm",
}  # fmt: skip


def _draw_curve(curve: Curve, place: style.Place) -> tuple[()]:
    axes, x = place(), curve.at * (1.0 if curve.against == "time" else 1e3)
    value, band = curve.value * 1e3, 1.96e3 * curve.sigma
    axes.fill_between(x, value - band, value + band, color=style.BAND, linewidth=0)
    axes.plot(x, value, color=style.FIT, linewidth=1.6)
    axes.axhline(0, color=style.MUTED, linewidth=0.6)
    style.label_axes(axes, curve.name, _AXIS_LABELS.get(curve.against, "command, mm"), curve.unit)
    axes.margins(x=0.02)
    style.few_ticks(axes)
    return ()
