"""The TCP over the workspace: three levels of z, a cell a command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import orthoglide.report.figures.style as style
from orthoglide.geometry import Array
from orthoglide.numerals import signed
from orthoglide.report.figures.style import Drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from orthoglide.result import Workspace

_DARKEST = 0.7  # opacity of a cell at the top of the scale


def draw_workspace(space: Workspace, effects: bool) -> Drawing:
    """What is wrong and what is not known on three levels of z; darker for larger.

    Args:
        space: of the result.
        effects: whether any were added; the base model is all there is otherwise.
    """
    travel = space.travel * 1e3
    levels = np.unique(np.round(travel[:, 2], 6))
    chosen = levels[[0, len(levels) // 2, -1]]
    rows = [
        ("predicted error now", space.nominal, style.DATA),
        ("with offsets and lengths set", space.before, style.DATA),
        ("95 % radius afterwards", space.sure, style.FIT),
    ]
    if not effects:
        del rows[1]
    scale = {
        c: max(float(v.max()) for _, v, drawn in rows if drawn == c)
        for c in (style.DATA, style.FIT)
    }
    width, height = style.PANEL[0], 2.5
    panels = [(*row, level) for row in rows for level in chosen]
    figure, corners = style.sheet(len(panels), height)
    for (left, top), (what, values, colour, level) in zip(corners, panels, strict=True):
        there = np.abs(travel[:, 2] - level) < 1e-3
        axes = style.place_axes(figure, left + 0.5, top + 0.32, width - 0.6, height - 0.78)
        _draw_cells(axes, travel[there], values[there] * 1e3, colour, scale[colour] * 1e3)
        axes.set_title(f"{what}, z {signed(level, 0)} mm")
    return style.multiples("workspace", "The TCP over the workspace, mm", figure, corners, height)


def _draw_cells(axes: Axes, travel: Array, values: Array, colour: str, most: float) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    xs, ys = (np.unique(np.round(travel[:, k], 6)) for k in (0, 1))
    column = np.searchsorted(xs, np.round(travel[:, 0], 6))
    row = np.searchsorted(ys, np.round(travel[:, 1], 6))
    corners = np.array([[0.03, 0.03], [0.97, 0.03], [0.97, 0.97], [0.03, 0.97]])
    squares = np.stack([column, row], axis=1)[:, None, :] + corners
    shades = [to_rgba(colour, 0.05 + (_DARKEST - 0.05) * v / max(most, 1e-12)) for v in values]
    axes.add_collection(PolyCollection(list(squares), facecolors=shades, linewidths=0))
    places = 3 if most < 0.1 else 2
    for x, y, v in zip(column, row, values, strict=True):
        axes.text(x + 0.5, y + 0.47, f"{v:.{places}f}", ha="center", va="center", fontsize=7)
    axes.set_xlim(0, len(xs))
    axes.set_ylim(0, len(ys))
    axes.grid(visible=False)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(length=0)
    _name_places(axes, xs, ys)
    axes.set_xlabel("travel of x, mm", labelpad=2)
    axes.set_ylabel("travel of y, mm", labelpad=3)


def _name_places(axes: Axes, xs: Array, ys: Array) -> None:
    axes.set_xticks(np.arange(len(xs)) + 0.5, [signed(x, 0) for x in xs])
    axes.set_yticks(np.arange(len(ys)) + 0.5, [signed(y, 0) for y in ys])
