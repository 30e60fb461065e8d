"""A machine to turn and move: its data for the page, and the page itself without any network."""

from __future__ import annotations

import json
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from orthoglide.geometry import Array, Geometry

MOST_WAYS = 10
"""Switches of one view."""


@dataclass(frozen=True, eq=False, repr=False)
class Way:
    """What one cause does to a machine over its workspace."""

    words: str  # a clause
    lines: Array  # displacement of the bars' ends (n, leg, bar, end, 3), metres
    p: Array  # of the tool (n, 3), metres


@dataclass(frozen=True, eq=False, repr=False)
class View:
    """A machine in postures along a way through its workspace, and what may be wrong with it."""

    geometry: Geometry  # its nominal dimensions
    lines: Array  # ends of the bars (n, leg, bar, end, 3), metres
    p: Array  # tool (n, 3)
    travel: Array  # of the carriages from mechanical zero (n, 3)
    ways: tuple[Way, ...]  # causes, each to be switched on

    def data(self) -> dict[str, Any]:
        """For the page: postures in hundredths, displacements in tenths of micrometres."""
        geometry = self.geometry
        legs = geometry.legs
        return {
            "names": list(geometry.leg_names),
            "hanging": geometry.layout.hanging,
            "d": round(geometry.d * 1e3, 3),
            "stroke": [round(v * 1e3, 3) for v in geometry.stroke],
            "axes": [np.round(leg.axes.T, 6).tolist() for leg in legs],
            "carriage": [np.round(leg.carriage * 1e3, 3).tolist() for leg in legs],
            "frames": _whole(np.concatenate([_flat(self.lines), self.p], axis=1), 1e5),
            "ways": [
                {"words": way.words, "moved": _whole(np.hstack([_flat(way.lines), way.p]), 1e7)}
                for way in self.ways[:MOST_WAYS]
            ],
        }


def _flat(lines: Array) -> Array:
    return lines.reshape(len(lines), -1)


def _whole(values: Array, scale: float) -> list[list[int]]:
    found: list[list[int]] = np.round(values * scale).astype(int).tolist()
    return found


def view_html(view: View, still: str) -> str:
    """The view as part of a page.

    Args:
        view: what is shown.
        still: a drawing that stands there where no script runs.
    """
    data = json.dumps(view.data(), separators=(",", ":"), ensure_ascii=False)
    script = files("orthoglide.scene").joinpath("view.js").read_text(encoding="utf-8")
    switches = "".join(
        f'<label><input type="checkbox" class="way" value="{k}"{" checked" if k == 0 else ""}/> '
        f"{escape(way.words)}</label>"
        for k, way in enumerate(view.ways[:MOST_WAYS])
    )
    what = "The machine on its way through the workspace; arrows: how far the tool is off there."
    return (
        f'<div class="view" hidden><canvas role="img" aria-label="{what}"></canvas>'
        f'<div class="controls"><button type="button" class="play">move</button>'
        f'<label>place <input type="range" class="place" min="0" max="{len(view.p) - 1}" '
        f'step="0.02" value="0"/></label><label>errors <select class="times">'
        f'<option value="1">as they are</option><option value="10">×10</option>'
        f'<option value="100">×100</option><option value="300">×300</option>'
        f'<option value="1000">×1000</option>'
        f'</select></label></div><div class="ways">{switches}</div>'
        f'<p class="small readout" aria-live="off"></p>'
        f'<script type="application/json">{data.replace("<", chr(92) + "u003c")}</script></div>'
        f"<noscript>{still}</noscript><script>{script}</script>"
    )


def view_style() -> str:
    """The style that a page with a view needs."""
    return files("orthoglide.scene").joinpath("view.css").read_text(encoding="utf-8")


def view_page(view: View, still: str, title: str) -> str:
    """A page of its own with one view."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'\"/>"
        f"<title>{escape(title)}</title><style>{_PAGE}{view_style()}</style></head><body>"
        f"<main><h1>{escape(title)}</h1>{view_html(view, still)}</main></body></html>\n"
    )


_PAGE = (
    "body{margin:0 auto;padding:1rem;max-width:60rem;background:#fbfbfa;color:#1f2a33;"
    "font:1rem/1.5 'Segoe UI','Noto Sans','DejaVu Sans',Arial,sans-serif}h1{font-size:1.3rem}"
    ".small{color:#5c6872;font-size:.875rem}"
)
