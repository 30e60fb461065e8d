"""Figures for inclusion in a page: with its font and its colours."""

from __future__ import annotations

from html import escape

from orthoglide.figures.style import PALETTE, Box, Drawing


def inline_svg(drawing: Drawing) -> str:
    """Return a drawing as one inline ``<svg>``."""
    return _inline("".join((drawing.legend, *drawing.bodies)), (0.0, 0.0, *drawing.size),
                   drawing.title)  # fmt: skip


def inline_panels(drawing: Drawing) -> list[str]:
    """Return each panel of a drawing as an inline ``<svg>``, so that a page can arrange them."""
    return [
        _inline(body, box, f"{drawing.title}, {k}")
        for k, (body, box) in enumerate(zip(drawing.bodies, drawing.panels, strict=True), start=1)
    ]


def _inline(body: str, box: Box, title: str) -> str:
    for colour, code in PALETTE.items():  # of attributes only: texts contain no quotation marks
        body = body.replace(f'="{code}"', f'="var(--fig-{colour})"')
    x, y, width, height = box
    return (
        f'<svg viewBox="{x:g} {y:g} {width:g} {height:g}" role="img" aria-label="{escape(title)}" '
        f'preserveAspectRatio="xMidYMid meet">{body}</svg>'
    )
