"""Axes of a figure as SVG: ticks, labels, marks at data, and keys of a legend.

Lengths are SVG units (1/72 inch) from the top left corner of the figure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import NamedTuple, TypeVar
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.figures.style import GRID, INK, MUTED, Box, Drawing
from orthoglide.geometry import Array
from orthoglide.numerals import compact, plain

T = TypeVar("T")

SINGLE_WIDTH = 281.0  # width of a figure that fits a phone
PANEL_WIDTH, PANEL_HEIGHT = 216.0, 198.0
LEGEND_HEIGHT = 22.0

_TITLE, _LABEL = 8.5, 7.5  # font sizes
_RIGHT = 9.0  # margin of axes at the right
_HAIRLINE = 0.6  # width of grid lines and frames
_LABEL_DISTANCE = 35.0  # of a rotated label from the axes: room for ticks of seven characters
_DESCENT = 0.36  # of the font size: from the middle of digits down to their base line
_LETTER = 0.6  # of the font size: average width of a letter in wide fonts
_SAMPLE = 17.0  # width of a key in a legend
_LINE_SAMPLE, _BOX_SAMPLE = f"h{_SAMPLE:g}", f"m0 -2.6h{_SAMPLE:g}v5.2h-{_SAMPLE:g}z"
_DASH, _GAP = 3.7, 1.6  # of the width of a dashed line
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # round numbers
_MOST_DECIMALS = 4  # of a tick; with more, powers of ten are shorter

Limits = tuple[float, float]
"""Values at both ends of an axis."""

Ticks = Sequence[tuple[float, str]]
"""Places and texts of ticks; a tick without text is a grid line alone."""


class Key(NamedTuple):
    """Sample of a mark in a legend."""

    shape: str  # path relative to the left end of the sample, as SVG
    style: str  # attributes of the mark


def padded(values: ArrayLike, margin: float) -> Limits:
    """Return limits that leave a margin on both sides of values, as a share of their range."""
    low, high = float(np.min(values)), float(np.max(values))
    room = margin * (high - low)
    return low - room, high + room


def round_ticks(limits: Limits, most: int = 4) -> list[tuple[float, str]]:
    """Return at least two ticks at round numbers, with about ``most`` intervals between them."""
    low, high = _regular(limits)
    least_step = (high - low) / most
    exponent = math.floor(math.log10(least_step))
    ticks: list[tuple[float, str]] = []
    first_step = next(
        k for k, s in enumerate(_STEPS) if s >= least_step * 10.0**-exponent * (1 - 1e-9)
    )
    for mantissa in _STEPS[first_step::-1]:
        step = mantissa * 10.0**exponent
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        values = [k * step for k in range(first, last + 1)]
        decimals = max(0, -exponent - (mantissa == 10.0) + (mantissa == 2.5))
        digits = decimals + 1 + math.floor(math.log10(max(abs(low), abs(high))))
        ticks = [(v, plain(v, decimals)) for v in values]
        if decimals > _MOST_DECIMALS:
            ticks = [(v, compact(v, max(digits, 1))) for v in values]
        if len(ticks) > 1:
            break
    return ticks


def _regular(limits: Limits) -> Limits:
    """Return limits that are distinct."""
    low, high = limits
    return (low, high) if low != high else (low - 0.5, high + 0.5)


def text(
    x: float, y: float, words: str, size: float = _LABEL, anchor: str = "start",
    colour: str = INK, rotated: bool = False,
) -> str:  # fmt: skip
    """Return a line of text with the given place of its base line."""
    turn = f' transform="rotate(-90 {x:.2f} {y:.2f})"' if rotated else ""
    return (
        f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" text-anchor="{anchor}" '
        f'fill="{colour}"{turn}>{escape(words)}</text>'
    )


def legend(x: float, y: float, keys: Sequence[Key], names: Sequence[str]) -> str:
    """Return a row of keys with their names; ``y`` is the middle of the row."""
    parts = []
    for key, name in zip(keys, names, strict=True):
        parts.append(f'<path d="M{x:.2f} {y:.2f}{key.shape}" {key.style}/>')
        parts.append(text(x + _SAMPLE + 5, y + _DESCENT * _LABEL, name))
        x += _SAMPLE + 20 + _LETTER * _LABEL * len(name)
    return "".join(parts)


def _stroke(colour: str, width: float, dashed: bool = False, alpha: float = 1.0) -> str:
    dashes = f' stroke-dasharray="{_DASH * width:.3g} {_GAP * width:.3g}"' if dashed else ""
    opacity = f' stroke-opacity="{alpha:g}"' if alpha < 1 else ""
    return f'fill="none" stroke="{colour}" stroke-width="{width:g}"{dashes}{opacity}'


def _fill(colour: str, alpha: float = 1.0) -> str:
    opacity = f' fill-opacity="{alpha:.3g}"' if alpha < 1 else ""
    return f'fill="{colour}"{opacity}'


class Axes:
    """A rectangle with two scales, on which marks are drawn in the order of the calls."""

    def __init__(self, box: Box, x: Limits, y: Limits) -> None:
        self.left, self.top, self.width, self.height = box
        self._x, self._y = _regular(x), _regular(y)
        self._grid, self._marks, self._labels = list[str](), list[str](), list[str]()

    # --- Scales -----------------------------------------------------------------------------

    def across(self, x: ArrayLike) -> Array:
        """Return horizontal places of values."""
        low, high = self._x
        return self.left + self.width * (np.asarray(x, dtype=float) - low) / (high - low)

    def up(self, y: ArrayLike) -> Array:
        """Return vertical places of values."""
        low, high = self._y
        return self.top + self.height * (high - np.asarray(y, dtype=float)) / (high - low)

    def set_title(self, words: str) -> None:
        """Write a title above the axes."""
        self._labels.append(text(self.left, self.top - 6, words, _TITLE))

    def set_x_axis(self, ticks: Ticks, label: str = "", lines: bool = True) -> None:
        """Draw ticks and the label below; ``lines``: with the axis, tick marks and the grid."""
        top, bottom = self.top, self.top + self.height
        places = self.across([value for value, _ in ticks]).tolist()
        if lines:
            self._add_grid([f"M{x:.2f} {top:.2f}V{bottom:.2f}" for x in places])
            labelled = [x for x, (_, words) in zip(places, ticks, strict=True) if words]
            marks = "".join(f"M{x:.2f} {bottom:.2f}v2.5" for x in labelled)
            axis = f"M{self.left:.2f} {bottom:.2f}h{self.width:.2f}{marks}"
            self._labels.append(f'<path d="{axis}" {_stroke(MUTED, _HAIRLINE)}/>')
        self._labels += [
            text(x, bottom + 11, words, anchor="middle", colour=MUTED)
            for x, (_, words) in zip(places, ticks, strict=True)
            if words
        ]
        if label:
            middle = self.left + self.width / 2
            self._labels.append(text(middle, bottom + 21, label, anchor="middle", colour=MUTED))

    def set_y_axis(self, ticks: Ticks, label: str = "", lines: bool = True) -> None:
        """Draw tick texts and the label at the left; ``lines``: with the grid."""
        left, places = self.left, self.up([value for value, _ in ticks]).tolist()
        if lines:
            self._add_grid([f"M{left:.2f} {y:.2f}h{self.width:.2f}" for y in places])
        self._labels += [
            text(left - 3.5, y + _DESCENT * _LABEL, words, anchor="end", colour=MUTED)
            for y, (_, words) in zip(places, ticks, strict=True)
            if words
        ]
        if label:
            x, y = left - _LABEL_DISTANCE, self.top + self.height / 2
            self._labels.append(text(x, y, label, anchor="middle", colour=MUTED, rotated=True))

    def _add_grid(self, lines: Sequence[str]) -> None:
        self._grid.append(f'<path d="{"".join(lines)}" {_stroke(GRID, _HAIRLINE)}/>')

    # --- Marks ------------------------------------------------------------------------------

    def line(
        self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 1.3, dashed: bool = False
    ) -> Key:
        """Draw a line through points."""
        path = f"M{'L'.join(self._places(x, y))}"
        return self._add(path, _stroke(colour, width, dashed), _LINE_SAMPLE)

    def segments(
        self, x: ArrayLike, y: ArrayLike, to_x: ArrayLike, to_y: ArrayLike, colour: str,
        width: float = _HAIRLINE, alpha: float = 1.0,
    ) -> Key:  # fmt: skip
        """Draw a straight line between each pair of points."""
        x, y, to_x, to_y = np.broadcast_arrays(x, y, to_x, to_y)
        ends = zip(self._places(x, y), self._places(to_x, to_y), strict=True)
        path = "".join(f"M{start}L{end}" for start, end in ends)
        return self._add(path, _stroke(colour, width, alpha=alpha), _LINE_SAMPLE)

    def zero(self, vertical: bool = False) -> None:
        """Draw a line at zero."""
        if vertical:
            self.segments(0.0, self._y[0], 0.0, self._y[1], MUTED)
        else:
            self.segments(self._x[0], 0.0, self._x[1], 0.0, MUTED)

    def points(
        self, x: ArrayLike, y: ArrayLike, colour: str, size: float, filled: bool = True
    ) -> Key:
        """Draw a circle around each point."""
        half = size / 2
        arc = f"a{half:g} {half:g} 0 1 0"
        circle = f"m-{half:g} 0{arc} {size:g} 0{arc} -{size:g} 0z"
        style = _fill(colour) if filled else _stroke(colour, 0.9)
        path = "".join(f"M{place}{circle}" for place in self._places(x, y))
        return self._add(path, style, f"m{_SAMPLE / 2:g} 0{circle}")

    def ticks(self, x: ArrayLike, y: ArrayLike, colour: str, size: float) -> Key:
        """Draw a short horizontal line at each point."""
        tick = f"m-{size / 2:g} 0h{size:g}"
        path = "".join(f"M{place}{tick}" for place in self._places(x, y))
        return self._add(path, _stroke(colour, 0.9), f"m{_SAMPLE / 2:g} 0{tick}")

    def band(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, alpha: float = 1.0
    ) -> Key:
        """Fill between two curves."""
        edge = [*self._places(x, low), *self._places(x, high)[::-1]]
        return self._add(f"M{'L'.join(edge)}z", _fill(colour, alpha), _BOX_SAMPLE)

    def boxes(
        self, x: ArrayLike, y: ArrayLike, width: float, height: float, colour: str, alpha: float
    ) -> Key:
        """Fill boxes of equal size around points."""
        x, y = np.asarray(x) - width / 2, np.asarray(y) - height / 2
        across, up = (
            float(np.diff(ends).round(2)[0])
            for ends in (self.across([0.0, width]), self.up([0.0, height]))
        )
        path = "".join(f"M{p}h{across}v{up}h{-across}z" for p in self._places(x, y))
        return self._add(path, _fill(colour, alpha), _BOX_SAMPLE)

    def write(self, x: float, y: float, words: str, size: float) -> None:
        """Write a text centred at a point."""
        centre = float(self.across(x)), float(self.up(y)) + _DESCENT * size
        self._labels.append(text(*centre, words, size, "middle"))

    def _places(self, x: ArrayLike, y: ArrayLike) -> list[str]:
        places = np.stack([np.ravel(self.across(x)), np.ravel(self.up(y))], axis=1)
        return [f"{x} {y}" for x, y in np.round(places, 2).tolist()]

    def _add(self, path: str, style: str, sample: str) -> Key:
        self._marks.append(f'<path d="{path}" {style}/>')
        return Key(sample, style)

    def svg(self) -> str:
        """Return everything drawn, with marks only within the rectangle."""
        rectangle = (
            f'<rect x="{self.left:.2f}" y="{self.top:.2f}" width="{self.width:.2f}" '
            f'height="{self.height:.2f}"/>'
        )
        marks = "".join(self._marks)
        # A page may hold several figures, whose names must differ.
        name = f"clip-{crc32(f'{rectangle}{marks}'.encode()):x}"
        return (
            f'<g>{"".join(self._grid)}<clipPath id="{name}">{rectangle}</clipPath>'
            f'<g clip-path="url(#{name})">{marks}</g>'
            f"{''.join(self._labels)}</g>"
        )


# --- Figures --------------------------------------------------------------------------------


@dataclass
class Panel:
    """A figure, or a part of one that a page may show separately, to which axes are added."""

    box: Box
    axes: list[Axes] = field(default_factory=list)

    def add_axes(
        self, x: Limits, y: Limits, left: float = 40.0, top: float = 22.0, right: float = _RIGHT,
        bottom: float = 32.0,
    ) -> Axes:  # fmt: skip
        """Return new axes within margins, which contain titles, ticks and labels."""
        box = (
            self.box[0] + left, self.box[1] + top,
            self.box[2] - left - right, self.box[3] - top - bottom,
        )  # fmt: skip
        self.axes.append(Axes(box, x, y))
        return self.axes[-1]

    def svg(self) -> str:
        """Return everything drawn."""
        return "".join(axes.svg() for axes in self.axes)


def panel_drawing(
    name: str, title: str, items: Sequence[T], draw: Callable[[T, Panel], Sequence[Key]],
    height: float, names: Sequence[str] = (),
) -> Drawing:  # fmt: skip
    """Return a drawing with a panel for each item, three in a row, which a page may arrange;
    ``draw`` returns the keys of the legend, whose names stand in a row above all panels.
    """
    above, across = LEGEND_HEIGHT if names else 0.0, min(3, len(items))
    keys: Sequence[Key] = ()
    panels = []
    for k, item in enumerate(items):
        box = (k % across * PANEL_WIDTH, k // across * height + above, PANEL_WIDTH, height)
        panels.append(Panel(box))
        keys = draw(item, panels[-1])
    return Drawing(
        name, title, (across * PANEL_WIDTH, -(-len(items) // across) * height + above),
        tuple(panel.svg() for panel in panels), legend(8.0, 10.0, keys, names),
        tuple(panel.box for panel in panels),
    )  # fmt: skip
