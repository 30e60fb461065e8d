"""All figures of a result, or one by its name; the figure of the workspace."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

import orthoglide.figures.style as style
from orthoglide.errors import check_choice
from orthoglide.figures.axes import Axes, Panel, panel_drawing
from orthoglide.figures.located import draw_located
from orthoglide.figures.readings import draw_readings, draw_residuals
from orthoglide.figures.style import Drawing
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit, signed
from orthoglide.result import ReadingsShown, Result, Workspace

_MAX_OPACITY = 0.7  # opacity of the cell with the largest value


def draw(result: Result) -> list[Drawing]:
    """Return all figures of a result."""
    drawings = [draw_located(located, k) for k, located in enumerate(result.located, start=1)]
    return drawings + [drawn_by() for drawn_by in _result_figures(result).values()]


def draw_one(result: Result, what: str) -> Drawing:
    """Return one figure of a result: ``"residuals"``, ``"readings"`` or ``"workspace"``.

    Raises:
        InputError: if this result has no such figure.
    """
    return _draw_named(_result_figures(result), what)


def draw_fit(readings: ReadingsShown, noise: ByUnit, what: str) -> Drawing:
    """Return one figure of a fit, ``"residuals"`` or ``"readings"``; ``noise`` is the standard
    deviation of a reading.

    Raises:
        InputError: if there is no such figure.
    """
    return _draw_named(_fit_figures(readings, readings.nominal, noise), what)


_FigureMakers = dict[str, Callable[[], Drawing]]


def _result_figures(result: Result) -> _FigureMakers:
    readings, space = result.readings, result.workspace
    before = readings.before if result.improved else readings.nominal
    makers = _fit_figures(readings, before, result.noise.single_reading)
    if space is not None:
        makers["workspace"] = lambda: draw_workspace(space, result.improved)
    return makers


def _fit_figures(readings: ReadingsShown, before: Array, noise: ByUnit) -> _FigureMakers:
    return {
        "residuals": lambda: draw_residuals(readings, before, noise),
        "readings": lambda: draw_readings(readings, before),
    }


def _draw_named(figures: _FigureMakers, what: str) -> Drawing:
    check_choice("figure", what, figures)
    return figures[what]()


# --- The workspace --------------------------------------------------------------------------


def draw_workspace(space: Workspace, improved: bool) -> Drawing:
    """Return the figure of the TCP's error and its uncertainty at three heights; darker is larger.
    ``improved``: whether the final model differs from the base model.
    """
    *errors, (what, radius) = space.stages(improved)
    rows = [(words, error * 1e3, style.DATA) for words, error in errors]
    rows.append((what, radius * 1e3, style.FIT))
    return draw_levels("workspace", "The TCP over the workspace, mm", rows, space.at, space.axis)


def draw_levels(
    name: str, title: str, rows: Sequence[tuple[str, Array, str]], at: Array, axis: str
) -> Drawing:
    """Return a figure of values over the workspace at three heights; darker is larger.

    Args:
        name: name of its file.
        title: its content, a phrase.
        rows: for each row of panels what it shows, the values ``(n,)`` and the colour; values of
            equal colour share a scale.
        at: places of the values ``(n, 3)``, metres.
        axis: label of the axes, with a placeholder for x and y.
    """
    places = np.round(at * 1e3, 6) + 0.0
    levels = np.unique(places[:, 2])
    scale = dict[str, float]()  # largest value by colour
    for _, values, colour in rows:
        scale[colour] = max(scale.get(colour, 0.0), float(values.max()))

    def draw(part: tuple[str, Array, str, float], panel: Panel) -> tuple[()]:
        what, values, colour, level = part
        on_level = np.abs(places[:, 2] - level) < 1e-3
        shades = values[on_level], colour, scale[colour]
        axes = _draw_level(panel, places[on_level], *shades, axis)
        axes.set_title(f"{what}, z {signed(level, 0)}")  # mm, as the axes; more is cut off
        return ()

    shown_levels = np.unique(levels[[0, len(levels) // 2, -1]])
    panels = [(*row, float(level)) for row in rows for level in shown_levels]
    return panel_drawing(name, title, panels, draw, 180.0)


def _draw_level(
    panel: Panel, at: Array, values: Array, colour: str, largest: float, axis: str
) -> Axes:
    """Draw a square with its value for each place of one level; darker is larger."""
    (xs, x), (ys, y) = (np.unique(np.round(at[:, k], 6), return_inverse=True) for k in (0, 1))
    axes = panel.add_axes((0.0, float(len(xs))), (0.0, float(len(ys))))
    decimals = 3 if largest < 0.1 else 2 if largest < 10 else 1
    opacity = (0.05 + (_MAX_OPACITY - 0.05) * values / max(largest, 1e-12)).tolist()
    for i, j, value, alpha in zip(x.tolist(), y.tolist(), values.tolist(), opacity, strict=True):
        axes.boxes([i + 0.5], [j + 0.5], 0.94, 0.94, colour, alpha)
        axes.write(i + 0.5, j + 0.5, f"{value:.{decimals}f}", 7.0)
    x_ticks, y_ticks = (
        [(k + 0.5, signed(v, 0)) for k, v in enumerate(v.tolist())] for v in (xs, ys)
    )
    axes.set_x_axis(x_ticks, f"{axis.format('x')}, mm", lines=False)
    axes.set_y_axis(y_ticks, f"{axis.format('y')}, mm", lines=False)
    return axes
