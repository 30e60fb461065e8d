"""Identified values against their tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import orthoglide.figures.style as style
from orthoglide.effects import Catalogue, Effect
from orthoglide.figures.style import Drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_parameters(columns: Mapping[str, Sequence[Any]], catalogue: Catalogue) -> Drawing:
    """Values with their 95 % intervals against the tolerances, a strip an effect.

    Args:
        columns: name, value, limits of the interval and tolerance of each, as a fit has them.
        catalogue: of their effects.
    """
    strips: dict[Effect, list[int]] = {}
    names = columns["parameter"]
    for k, name in enumerate(names):
        strips.setdefault(catalogue.effect_of(name), []).append(k)
    heights = [0.72 + 0.24 * len(members) for members in strips.values()]
    figure = style.new_figure(style.SINGLE, sum(heights) + 0.3)
    short = [name.removeprefix(f"{catalogue.effect_of(name).name}.") for name in names]
    margin = min(0.2 + 0.06 * max(map(len, short)), 1.7)
    top = 0.3
    for (effect, members), height in zip(strips.items(), heights, strict=True):
        axes = style.place_axes(
            figure, margin, top + 0.2, style.SINGLE - margin - 0.12, height - 0.58
        )
        handles = _draw_strip(axes, columns, effect, members)
        axes.set_yticks(range(len(members)), [short[k] for k in members], color=style.INK)
        top += height
    figure.legend(
        handles, ("value, 95 % interval", "tolerance, ± 1 sigma"), loc="upper left", ncols=2,
        bbox_to_anchor=(margin / style.SINGLE - 0.02, 1.0), borderaxespad=0.1, handlelength=1.4,
    )  # fmt: skip
    return Drawing(
        "parameters", "Identified values against their tolerances", style.svg_text(figure)
    )


def _draw_strip(
    axes: Axes, columns: Mapping[str, Sequence[Any]], effect: Effect, members: list[int]
) -> list[Any]:
    unit = effect.unit
    value, low, high, expected = (
        np.array(columns[title], dtype=float)[members]
        for title in ("value", "lower", "upper", "tolerance")
    )
    half, tolerance = (high - low) / 2, float(expected[0])
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
