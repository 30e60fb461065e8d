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


def draw_vectors(space: Workspace) -> Drawing:
    """Where the tool goes instead: arrows on three levels of z, as it is and with zeros and lengths
    set; up and down in colour.
    """
    at, chosen = _levels(space)
    rows = (("now", space.now * 1e3), ("zeros and lengths set", space.left * 1e3))
    panels = [(*row, level) for row in rows for level in chosen]
    width, height = style.PANEL[0], 2.7
    figure, corners = style.sheet(len(panels), height)
    for (left, top), (what, errors, level) in zip(corners, panels, strict=True):
        there = np.abs(at[:, 2] - level) < 1e-3
        axes = style.place_axes(figure, left + 0.5, top + 0.32, width - 0.6, height - 0.78)
        most = float(np.linalg.norm(errors[:, :2], axis=1).max())
        _draw_arrows(axes, at[there], errors[there], most, float(np.abs(errors[:, 2]).max()))
        _label(axes, space.axis)
        axes.set_title(f"{what}, z {signed(level, 0)} mm")
        axes.text(0.98, 0.02, f"longest {most:.3g} mm", transform=axes.transAxes, ha="right",
                  va="bottom", fontsize=6.5, color=style.MUTED)  # fmt: skip
    title = "Where the tool goes instead: orange up, blue down along z"
    return style.multiples("vectors", title, figure, corners, height)


def _draw_arrows(axes: Axes, at: Array, errors: Array, most: float, high: float) -> None:
    """Arrows ``(m, 3)`` of which the longest of all is as long as the cells are wide."""
    from matplotlib.colors import to_rgba

    xs, ys = (np.unique(np.round(at[:, k], 6)) for k in (0, 1))
    step = min(float(np.min(np.diff(v))) for v in (xs, ys) if len(v) > 1)
    drawn = errors[:, :2] / max(most, 1e-12) * step
    colours = [
        to_rgba(style.DATA if z > 0 else style.FIT, 0.25 + 0.75 * abs(z) / max(high, 1e-12))
        for z in errors[:, 2].tolist()
    ]
    axes.quiver(at[:, 0], at[:, 1], *drawn.T, color=colours, angles="xy",
                scale_units="xy", scale=1.0, width=0.012, pivot="tail")  # fmt: skip
    axes.set_xlim(xs[0] - step, xs[-1] + step)
    axes.set_ylim(ys[0] - step, ys[-1] + step)
    axes.set_aspect("equal")
    style.few_ticks(axes)
