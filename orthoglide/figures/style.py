"""Colours of all figures, and a figure as SVG."""

from __future__ import annotations

import os
from dataclasses import dataclass
from html import escape

from orthoglide.errors import InputError
from orthoglide.files import write_file

# Okabe and Ito's colours, which colour-blind readers can distinguish.
PALETTE = {
    "ink": "#1f2a33",
    "muted": "#66727c",
    "grid": "#dfe4e8",
    "data": "#d55e00",
    "fit": "#0072b2",
    "before": "#939ca3",
    "band": "#56b4e9",
}
INK, MUTED, GRID = PALETTE["ink"], PALETTE["muted"], PALETTE["grid"]
DATA, FIT, BEFORE, BAND = (PALETTE[name] for name in ("data", "fit", "before", "band"))

Box = tuple[float, float, float, float]
"""Left, top, width and height in SVG units, 1/72 inch."""


@dataclass(frozen=True, repr=False)
class Drawing:
    """One figure."""

    name: str  # name of its file
    title: str  # its content, a phrase
    size: tuple[float, float]  # width and height, SVG units
    bodies: tuple[str, ...]  # SVG of its panels, or of the whole
    legend: str = ""  # SVG of the legend
    panels: tuple[Box, ...] = ()  # places of its panels; empty for a figure that is shown whole

    @property
    def svg(self) -> str:
        """Text of its file."""
        width, height = (f"{length:g}" for length in self.size)
        bodies = "\n".join((self.legend, *self.bodies))
        return (
            '<?xml version="1.0" encoding="utf-8"?>\n'
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}pt" height="{height}pt" '
            f'viewBox="0 0 {width} {height}" font-family="\'DejaVu Sans\', sans-serif" '
            f'stroke-linejoin="round">\n{bodies}\n</svg>\n'
        )

    def inline(self) -> str:
        """Return one inline ``<svg>``, with the font and the colours of the page around it."""
        body = "".join((self.legend, *self.bodies))
        return _inline(body, (0.0, 0.0, *self.size), self.title)

    def inline_panels(self) -> list[str]:
        """Return each panel as an inline ``<svg>``, so that a page can arrange them."""
        return [
            _inline(body, box, f"{self.title}, {k}")
            for k, (body, box) in enumerate(zip(self.bodies, self.panels, strict=True), start=1)
        ]

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


def _inline(body: str, box: Box, title: str) -> str:
    for colour, code in PALETTE.items():  # of attributes only: texts contain no quotation marks
        body = body.replace(f'="{code}"', f'="var(--fig-{colour})"')
    x, y, width, height = box
    return (
        f'<svg viewBox="{x:g} {y:g} {width:g} {height:g}" role="img" aria-label="{escape(title)}" '
        f'preserveAspectRatio="xMidYMid meet">{body}</svg>'
    )
