"""The TCP over the workspace: three levels of z, a cell or an arrow a command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import orthoglide.figures.style as style
from orthoglide.figures.style import Drawing
from orthoglide.geometry import Array
from orthoglide.numerals import signed
from orthoglide.result import Workspace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DARKEST = 0.7  # opacity of a cell at the top of the scale


def draw_workspace(space: Workspace, effects: bool) -> Drawing:
    """What is wrong and what is not known on three levels of z; darker for larger.

    Args:
        space: of the result.
        effects: whether any were added; the base model is all there is otherwise.
    """
    at, chosen = _levels(space)
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
        there = np.abs(at[:, 2] - level) < 1e-3
        axes = style.place_axes(figure, left + 0.5, top + 0.32, width - 0.6, height - 0.78)
        _draw_level(axes, at[there], values[there] * 1e3, colour, scale[colour] * 1e3)
        _label(axes, space.axis)
        axes.set_title(f"{what}, z {signed(level, 0)} mm")
    return style.multiples("workspace", "The TCP over the workspace, mm", figure, corners, height)


def _levels(space: Workspace) -> tuple[Array, Array]:
    """Places ``(g, 3)`` and the lowest, middle and highest of their levels, millimetres."""
    at = np.round(space.at * 1e3, 6) + 0.0
    levels = np.unique(at[:, 2])
    return at, np.unique(levels[[0, len(levels) // 2, -1]])


def _label(axes: Axes, axis: str) -> None:
    axes.set_xlabel(f"{axis.format('x')}, mm", labelpad=2)
    axes.set_ylabel(f"{axis.format('y')}, mm", labelpad=3)


def _draw_level(axes: Axes, at: Array, values: Array, colour: str, most: float) -> None:
    from matplotlib.colors import to_rgba

    (xs, x), (ys, y) = (np.unique(np.round(at[:, k], 6), return_inverse=True) for k in (0, 1))
    places = 3 if most < 0.1 else 2
    cells = [
        (i, j, to_rgba(colour, 0.05 + (_DARKEST - 0.05) * v / max(most, 1e-12)), f"{v:.{places}f}")
        for i, j, v in zip(x.tolist(), y.tolist(), values.tolist(), strict=True)
    ]
    style.draw_cells(axes, cells, [signed(v, 0) for v in xs], [signed(v, 0) for v in ys])
