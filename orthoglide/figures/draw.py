"""All figures of a result, or one by its name; the figures of workspace and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import orthoglide.figures.style as style
from orthoglide.effects import Catalogue, Effect
from orthoglide.errors import check_choice
from orthoglide.figures.causes import draw_located, draw_signatures
from orthoglide.figures.readings import draw_readings, draw_residuals
from orthoglide.figures.style import Drawing, figure_style
from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit, signed
from orthoglide.result import ReadingsShown, Result, Workspace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_OPACITY = 0.7  # opacity of the cell with the largest value


def draw(result: Result) -> list[Drawing]:
    """Return all figures of a result."""
    with figure_style():
        causes = enumerate(result.effects, start=1)
        drawings = [draw_signatures(cause, result.readings, k) for k, cause in causes]
        drawings += [draw_located(located, k) for k, located in enumerate(result.located, start=1)]
        return drawings + [drawn_by() for drawn_by in _result_figures(result).values()]


def draw_one(result: Result, what: str) -> Drawing:
    """Return one figure of a result: ``"residuals"``, ``"readings"``, ``"workspace"``, or after
    ``identify`` ``"parameters"``.

    Raises:
        InputError: if this result has no such figure.
    """
    return _draw_named(_result_figures(result), what)


def draw_fit(
    readings: ReadingsShown, noise: ByUnit, fit: Framed, catalogue: Catalogue, what: str
) -> Drawing:
    """Return one figure of a fit, with effects of a catalogue: ``"residuals"``, ``"readings"`` or
    ``"parameters"``; ``noise`` is the standard deviation of a reading.

    Raises:
        InputError: if there is no such figure.
    """
    return _draw_named(_fit_figures(readings, readings.nominal, noise, fit, catalogue), what)


_FigureMakers = dict[str, Callable[[], Drawing]]


def _result_figures(result: Result) -> _FigureMakers:
    readings, space = result.readings, result.workspace
    before = readings.before if result.improved else readings.nominal
    noise = result.noise.single_reading
    makers = _fit_figures(readings, before, noise, result, result.catalogue)
    if space is not None:
        del makers["parameters"]
        makers["workspace"] = lambda: draw_workspace(space, result.improved)
    return makers


def _fit_figures(
    readings: ReadingsShown, before: Array, noise: ByUnit, fit: Framed, catalogue: Catalogue
) -> _FigureMakers:
    return {
        "residuals": lambda: draw_residuals(readings, before, noise),
        "readings": lambda: draw_readings(readings, before),
        "parameters": lambda: draw_parameters(fit.columns, catalogue),
    }


def _draw_named(figures: _FigureMakers, what: str) -> Drawing:
    check_choice("figure", what, figures)
    with figure_style():
        return figures[what]()


# --- The workspace --------------------------------------------------------------------------


def draw_workspace(space: Workspace, improved: bool) -> Drawing:
    """Return the figure of the TCP's error and its uncertainty at three heights; darker is larger.
    ``improved``: whether the final model differs from the base model.
    """
    places = np.round(space.at * 1e3, 6) + 0.0
    levels = np.unique(places[:, 2])
    rows = [
        ("predicted error now", space.nominal, style.DATA),
        ("with offsets and lengths set", space.before, style.DATA),
        ("95 % radius afterwards", space.sure, style.FIT),
    ]
    if not improved:
        del rows[1]
    scale = dict[str, float]()  # largest value by colour
    for _, values, colour in rows:
        scale[colour] = max(scale.get(colour, 0.0), float(values.max()))
    height, shown_levels = 2.5, np.unique(levels[[0, len(levels) // 2, -1]])

    def draw(panel: tuple[str, Array, str, float], place: style.Place) -> tuple[()]:
        what, values, colour, level = panel
        on_level = np.abs(places[:, 2] - level) < 1e-3
        axes = place(0.5, 0.32, style.PANEL_SIZE[0] - 0.6, height - 0.78)
        _draw_level(axes, places[on_level], values[on_level] * 1e3, colour, scale[colour] * 1e3)
        axes.set_xlabel(f"{space.axis.format('x')}, mm", labelpad=2)
        axes.set_ylabel(f"{space.axis.format('y')}, mm", labelpad=3)
        axes.set_title(f"{what}, z {signed(level, 0)} mm")
        return ()

    panels = [(*row, float(level)) for row in rows for level in shown_levels]
    return style.panel_drawing("workspace", "The TCP over the workspace, mm", panels, draw, height)


def _draw_level(axes: Axes, at: Array, values: Array, colour: str, largest: float) -> None:
    """Draw a square with its value for each place of one level; darker is larger."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    (xs, x), (ys, y) = (np.unique(np.round(at[:, k], 6), return_inverse=True) for k in (0, 1))
    decimals = 3 if largest < 0.1 else 2
    opacity = (0.05 + (_MAX_OPACITY - 0.05) * values / max(largest, 1e-12)).tolist()
    corners = np.array([[0.03, 0.03], [0.97, 0.03], [0.97, 0.97], [0.03, 0.97]])
    squares = [corners + corner for corner in np.stack([x, y], axis=1)]
    colours = [to_rgba(colour, alpha) for alpha in opacity]
    axes.add_collection(PolyCollection(squares, facecolors=colours, linewidths=0))
    for i, j, value in zip(x.tolist(), y.tolist(), values.tolist(), strict=True):
        axes.text(i + 0.5, j + 0.48, f"{value:.{decimals}f}", ha="center", va="center", fontsize=7)
    axes.set_xlim(0, len(xs))
    axes.set_ylim(0, len(ys))
    axes.grid(visible=False)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(length=0)
    axes.set_xticks(np.arange(len(xs)) + 0.5, [signed(v, 0) for v in xs])
    axes.set_yticks(np.arange(len(ys)) + 0.5, [signed(v, 0) for v in ys])


# --- Parameters -----------------------------------------------------------------------------


def draw_parameters(columns: Mapping[str, Sequence[Any]], catalogue: Catalogue) -> Drawing:
    """Return the figure of values with 95 % intervals against tolerances, a strip for each effect;
    ``columns`` are those of a fit.
    """
    strips: dict[Effect, list[int]] = {}
    names = columns["parameter"]
    for k, name in enumerate(names):
        strips.setdefault(catalogue.effect_of(name), []).append(k)
    heights = [0.72 + 0.24 * len(members) for members in strips.values()]
    figure = style.new_figure(style.SINGLE_WIDTH, sum(heights) + 0.3)
    labels = [name.removeprefix(f"{catalogue.effect_of(name).name}.") for name in names]
    margin = min(0.2 + 0.06 * max(map(len, labels)), 1.7)
    top = 0.3
    for (effect, members), height in zip(strips.items(), heights, strict=True):
        axes = style.place_axes(
            figure, margin, top + 0.2, style.SINGLE_WIDTH - margin - 0.12, height - 0.58
        )
        handles = _draw_strip(axes, columns, effect, members)
        axes.set_yticks(range(len(members)), [labels[k] for k in members], color=style.INK)
        top += height
    corner = (margin / style.SINGLE_WIDTH - 0.02, 1.0)
    figure.legend(
        handles, ("value, 95 % interval", "tolerance, ± 1 sigma"), loc="upper left", ncols=2,
        bbox_to_anchor=corner, borderaxespad=0.1, handlelength=1.4,
    )  # fmt: skip
    title = "Identified values against their tolerances"
    return Drawing("parameters", title, style.svg_text(figure))


def _draw_strip(
    axes: Axes, columns: Mapping[str, Sequence[Any]], effect: Effect, members: list[int]
) -> list[Any]:
    unit = effect.unit
    value, low, high, tolerances = (
        np.array(columns[title], dtype=float)[members]
        for title in ("value", "lower", "upper", "tolerance")
    )
    half, tolerance = (high - low) / 2, float(tolerances[0])
    rows = np.arange(len(members))
    band = axes.axvspan(-tolerance, tolerance, color=style.BAND, alpha=0.25, linewidth=0)
    axes.axvline(0, color=style.MUTED, linewidth=0.6)
    axes.hlines(rows, value - half, value + half, color=style.FIT, linewidth=1.6)
    (dots,) = axes.plot(value, rows, color=style.FIT, marker="o", linestyle="none", markersize=4.4,
                        markeredgewidth=0)  # fmt: skip
    reach = 1.1 * max(float(np.max(np.abs(value) + half)), 1.1 * tolerance)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(members) - 0.5, -0.5)
    style.few_ticks(axes, across=5)
    axes.set_title(f"{effect.name.replace('_', ' ')}, {unit.name}", pad=3)
    return [dots, band]
