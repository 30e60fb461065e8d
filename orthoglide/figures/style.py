"""Common style of all figures: SVG, colours, fonts, and the layout of panels."""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from orthoglide.errors import InputError
from orthoglide.files import write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

T = TypeVar("T")

# Okabe and Ito's colours, which colour-blind readers can distinguish.
PALETTE = {
    "ink": "#1f2a33",
    "muted": "#66727c",
    "grid": "#dfe4e8",
    "data": "#d55e00",
    "fit": "#0072b2",
    "before": "#939ca3",
    "band": "#56b4e9",
    "minus": "#cc79a7",
    "third": "#009e73",
}
INK, MUTED, GRID = PALETTE["ink"], PALETTE["muted"], PALETTE["grid"]
DATA, FIT, BEFORE, BAND = (PALETTE[name] for name in ("data", "fit", "before", "band"))

POINTS_PER_INCH = 72.0  # SVG units an inch
SINGLE_WIDTH = 3.9  # inches: width of a figure that fits a phone
PANEL_SIZE = (3.0, 2.75)  # inches: width and height of a panel
LABEL_POSITION = -0.195  # of the width of the axes: place of a panel's unit


@dataclass(frozen=True, repr=False)
class Drawing:
    """One figure."""

    name: str  # name of its file
    title: str  # its content, a phrase
    svg: str  # text of its file
    # boxes (x, y, width, height) in units of the SVG that a page may show separately, in the order
    # of the axes; empty for a figure that is shown whole
    panels: tuple[tuple[float, float, float, float], ...] = ()
    axes: int = 1  # number of axes of each panel

    def __repr__(self) -> str:
        return f"<Drawing {self.name}: {self.title}>"

    def _repr_svg_(self) -> str:
        return self.svg

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the figure as an SVG file.

        Args:
            path: path of the file.
            overwrite: whether an existing file may be replaced.

        Raises:
            InputError: for a name that does not end in ``.svg``.
            FileError: if the file exists and may not be replaced, or cannot be written.
        """
        if not os.fspath(path).lower().endswith(".svg"):
            raise InputError("figures are drawn as SVG: choose a name that ends in .svg")
        write_file(path, self.svg, overwrite=overwrite)


@contextmanager
def figure_style() -> Iterator[None]:
    """Apply the style of all figures within a ``with`` block."""
    import matplotlib

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # its font cache is nobody's concern
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(
            {
                "svg.hashsalt": "orthoglide",
                "svg.fonttype": "none",
                "text.parse_math": False,  # names are what they are, dollars included
                "font.sans-serif": ["DejaVu Sans"],  # what widths are measured with
                "font.size": 8.0,
                "axes.titlesize": 8.5,
                "axes.titlelocation": "left",
                "axes.titley": 1.0,  # else every label is measured to find a place above them
                "axes.labelsize": 7.5,
                "xtick.labelsize": 7.5,
                "ytick.labelsize": 7.5,
                "text.color": INK,
                "axes.labelcolor": MUTED,
                "axes.edgecolor": MUTED,
                "axes.linewidth": 0.6,
                "xtick.color": MUTED,
                "ytick.color": MUTED,
                "xtick.major.size": 2.5,
                "ytick.major.size": 0.0,
                "axes.spines.top": False,
                "axes.spines.right": False,
                "axes.spines.left": False,
                "axes.grid": True,
                "grid.color": GRID,
                "grid.linewidth": 0.6,
                "axes.axisbelow": True,
                "lines.linewidth": 1.3,
                "figure.facecolor": "none",
                "axes.facecolor": "none",
                "legend.frameon": False,
                "legend.fontsize": 7.5,
            }
        )
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def place_axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Return axes at a place in inches from the top left corner."""
    w, h = figure.get_size_inches()
    return figure.add_axes((left / w, 1 - (top + height) / h, width / w, height / h))


def svg_text(figure: Figure) -> str:
    """Return the text of a figure's file: the same bytes for the same figure."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def few_ticks(axes: Axes, across: int = 4, up: int = 4) -> None:
    """Set few ticks, at round numbers."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(across, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(up, steps=[1, 2, 2.5, 5, 10]))


def label_axes(axes: Axes, title: str, across: str, up: str) -> None:
    """Set the title and the labels of both axes; empty ones are not drawn."""
    axes.set_title(title)
    axes.set_xlabel(across, labelpad=2)
    axes.set_ylabel(up)
    axes.yaxis.set_label_coords(LABEL_POSITION, 0.5)


Place = Callable[..., "Axes"]
"""Adds axes to a panel: left, top, width and height in inches from its top left corner."""


def _panel_axes(
    figure: Figure, corner: tuple[float, float], height: float, left: float = 0.56,
    top: float = 0.3, width: float = PANEL_SIZE[0] - 0.68, up: float | None = None,
) -> Axes:  # fmt: skip
    """Return axes in a panel; without ``up`` they leave 0.75 inches of its height to the labels."""
    x, y = corner
    return place_axes(figure, x + left, y + top, width, height - 0.75 if up is None else up)


def panel_drawing(
    name: str, title: str, items: Sequence[T], draw: Callable[[T, Place], Sequence[Any]],
    height: float = 2.1, legend: Sequence[str] = (), axes: int = 1,
) -> Drawing:  # fmt: skip
    """Return a drawing with a panel for each item, three in a row, which a page may arrange.

    Args:
        name: name of its file.
        title: its content, a phrase.
        items: contents of the panels.
        draw: draws an item and returns the handles of the legend.
        height: height of a panel, inches.
        legend: names of the handles, in a strip above all panels.
        axes: number of axes of each panel.
    """
    width, strip, across = PANEL_SIZE[0], 0.3 if legend else 0.0, min(3, len(items))
    figure = new_figure(across * width, -(-len(items) // across) * height + strip)
    corners = [(k % across * width, k // across * height + strip) for k in range(len(items))]
    handles: Sequence[Any] = ()
    for corner, item in zip(corners, items, strict=True):
        handles = draw(item, partial(_panel_axes, figure, corner, height))
    if legend:
        figure.legend(handles, legend, loc="upper left", ncols=4, bbox_to_anchor=(0.0, 1.0),
                      borderaxespad=0.2, handlelength=2.2)  # fmt: skip
    units = POINTS_PER_INCH
    boxes = tuple((x * units, y * units, width * units, height * units) for x, y in corners)
    return Drawing(name, title, svg_text(figure), boxes, axes)
