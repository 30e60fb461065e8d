"""Readings against the fit, and residuals, by setup."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import orthoglide.figures.style as style
from orthoglide.figures.style import Drawing
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit
from orthoglide.result import Mounting, ReadingsShown

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class _Panel:
    """Readings and predictions of one setup about the middle of the fit, mm or mrad."""

    mounting: Mounting
    x: Array
    measured: Array
    fit: Array
    before: Array
    sigma: Array


MAX_DRAWN = 400
"""Readings of a setup that are drawn; more dots overlap in a panel of 3 inches."""


def _rows_to_draw(x: Array, residual: Array) -> NDArray[np.intp]:
    """Return the rows to draw ``(k,)``: all, or of more than `MAX_DRAWN` the two extreme residuals
    in each part of the scale; abscissas ``x`` and residuals are ``(m,)``.
    """
    if len(x) <= MAX_DRAWN:
        return np.arange(len(x))
    parts = MAX_DRAWN // 2
    share = (x - x.min()) / max(float(np.ptp(x)), 1e-12)
    part = np.minimum((share * parts).astype(np.intp), parts - 1)
    order = np.lexsort([residual, part])
    first = np.diff(part[order], prepend=-1) > 0
    last = np.append(first[1:], True)
    return np.sort(order[first | last])


def _panels(readings: ReadingsShown, before: Array) -> list[_Panel]:
    panels, residual = [], readings.measured - readings.after
    for mounting in readings.mountings:
        shown = _rows_to_draw(mounting.x, residual[mounting.rows])
        rows = mounting.rows[shown]
        measured, fit, prior, sigma = (
            values[rows] * 1e3
            for values in (readings.measured, readings.after, before, readings.sigma)
        )
        middle, x = (fit.max() + fit.min()) / 2, mounting.x[shown]
        panels.append(_Panel(mounting, x, measured - middle, fit - middle, prior - middle, sigma))
    return panels


def draw_readings(readings: ReadingsShown, before: Array) -> Drawing:
    """Return the figure of readings, fit and residuals by setup; ``before``: predictions before the
    fit ``(n,)``, metres or radians.
    """
    setups, height = _panels(readings, before), style.PANEL_SIZE[1]
    limits = {unit: _axis_limits(some) for unit, some in _panels_by_unit(setups).items()}

    def draw(setup: _Panel, place: style.Place) -> list[Any]:
        axes, below = place(up=height - 1.4), place(top=height - 1.0, up=0.55)
        handles = _draw_setup(axes, setup)
        limit, residual_limit = limits[setup.mounting.unit]
        axes.set_ylim(-limit, limit)
        style.few_ticks(axes)
        axes.tick_params(labelbottom=False, bottom=False)
        _draw_residual_panel(below, setup)
        below.set_ylim(-residual_limit, residual_limit)
        below.set_xlim(axes.get_xlim())
        style.few_ticks(below, up=2)
        return handles

    return style.panel_drawing(
        "readings", "Readings and fit by setup", setups, draw, height,
        ("reading", "fit", "noise, ± 2 sigma", "before"), axes=2,
    )  # fmt: skip


def _panels_by_unit(setups: Sequence[_Panel]) -> dict[str, list[_Panel]]:
    by_unit: dict[str, list[_Panel]] = {}
    for setup in setups:
        by_unit.setdefault(setup.mounting.unit, []).append(setup)
    return by_unit


def _axis_limits(setups: Sequence[_Panel]) -> tuple[float, float]:
    """Return the common limits of readings and of residuals."""
    largest = max(
        float(np.abs(np.concatenate([s.measured, s.fit, s.before])).max()) for s in setups
    )
    residual_limit = 1.2 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    return 1.12 * largest, max(residual_limit, 2.4 * float(max(s.sigma.max() for s in setups)))


def _draw_setup(axes: Axes, setup: _Panel) -> list[Any]:
    order = np.argsort(setup.x, kind="stable")
    x, fit, before = setup.x[order], setup.fit[order], setup.before[order]
    noise = 2 * setup.sigma[order]
    # A line is drawn only if every abscissa has a single fitted value.
    step = np.diff(x) < 1e-6
    one_value = not np.any(np.abs(np.diff(fit)[step]) > noise[1:][step] / 2)
    band = axes.fill_between(x, fit - noise, fit + noise, color=style.BAND, alpha=0.35, linewidth=0)
    if not one_value:
        band.set_visible(False)
        axes.vlines(x, fit - noise, fit + noise, color=style.BAND, alpha=0.5, linewidth=3)
    (before_line,) = axes.plot(x, before, color=style.BEFORE, marker="_", markersize=4, linewidth=1,
                               linestyle="--" if one_value else "none")  # fmt: skip
    (fit_line,) = axes.plot(x, fit, color=style.FIT, linestyle="-" if one_value else "none",
                      marker="" if one_value else "_")  # fmt: skip
    (dots,) = axes.plot(setup.x, setup.measured, color=style.DATA, linestyle="none", marker="o",
                        markersize=3.6 if len(x) < 12 else 2.4, markeredgewidth=0)  # fmt: skip
    style.label_axes(axes, setup.mounting.title, "", setup.mounting.unit)
    axes.margins(x=0.05)
    return [dots, fit_line, band, before_line]


def _draw_residual_panel(axes: Axes, setup: _Panel) -> None:
    """Draw the residual of each reading on its own scale."""
    order = np.argsort(setup.x, kind="stable")
    noise = 2 * setup.sigma[order]
    axes.fill_between(setup.x[order], -noise, noise, color=style.BAND, alpha=0.35, linewidth=0)
    axes.axhline(0, color=style.MUTED, linewidth=0.6)
    axes.plot(setup.x, setup.measured - setup.fit, color=style.DATA, linestyle="none", marker="o",
              markersize=3 if len(setup.x) < 12 else 2.2, markeredgewidth=0)  # fmt: skip
    style.label_axes(axes, "", setup.mounting.label, f"left, {setup.mounting.unit}")


def draw_residuals(readings: ReadingsShown, before: Array, noise: ByUnit) -> Drawing:
    """Return the figure of residuals by setup, before and after, with the noise of a reading;
    ``before`` as for `draw_readings`.
    """
    setups = _panels(readings, before)
    names = [s.mounting.name for s in setups]
    height = 0.8 + 0.3 * len(setups)
    figure = style.new_figure(style.SINGLE_WIDTH, height)
    margin = min(0.2 + 0.055 * max(map(len, names)), 1.6)
    axes = style.place_axes(figure, margin, 0.32, style.SINGLE_WIDTH - margin - 0.12, height - 0.78)
    wide = np.array([2 * noise.shown[s.mounting.unit] for s in setups])
    axes.barh(range(len(setups)), 2 * wide, 1.0, -wide, color=style.BAND, alpha=0.35, linewidth=0,
              label="noise, ± 2 sigma")  # fmt: skip
    axes.axvline(0, color=style.MUTED, linewidth=0.6)
    for k, setup in enumerate(setups):
        row, label = np.full(len(setup.x), float(k)), "_" if k else ""
        axes.plot(setup.measured - setup.before, row - 0.17, color=style.BEFORE, marker="o",
                  linestyle="none", markersize=3.4, fillstyle="none", markeredgewidth=0.9,
                  label=label or "before")  # fmt: skip
        axes.plot(setup.measured - setup.fit, row + 0.17, color=style.FIT, marker="o",
                  linestyle="none", markersize=3.6, markeredgewidth=0,
                  label=label or "after")  # fmt: skip
    reach = 1.1 * max(float(np.abs(s.measured - s.before).max()) for s in setups)
    after = 1.1 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    reach = max(reach, after, 1.2 * float(wide.max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(setups) - 0.5, -0.5)
    style.few_ticks(axes, across=6)
    axes.set_yticks(range(len(setups)), names, color=style.INK)
    units = " or ".join(_panels_by_unit(setups))
    axes.set_xlabel(f"reading less prediction, {units}", labelpad=2)
    figure.legend(loc="upper left", ncols=3, borderaxespad=0.1, handlelength=1.4,
                  bbox_to_anchor=(0.0, 1.0))  # fmt: skip
    return Drawing("residuals", "Residuals by setup, before and after", style.svg_text(figure))
