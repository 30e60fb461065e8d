"""Readings against the fit, and residuals, by setup."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
    """One setup: readings and predictions about the middle of the fit, mm or mrad."""

    mounting: Mounting
    measured: Array
    fit: Array
    before: Array
    sigma: Array

    @property
    def x(self) -> Array:
        return self.mounting.x


MAX_DRAWN = 400
"""Readings of a setup that are drawn; in a panel of 3 inches more dots hide one another."""


def _rows_to_draw(x: Array, left: Array) -> NDArray[np.intp]:
    """Return the rows to draw ``(k,)``: all, or of many the two extreme residuals in each part of
    the scale.

    Args:
        x: where each reading is drawn ``(m,)``.
        left: its residual ``(m,)``.
    """
    if len(x) <= MAX_DRAWN:
        return np.arange(len(x))
    parts = MAX_DRAWN // 2
    place = (x - x.min()) / max(float(np.ptp(x)), 1e-12)
    part = np.minimum((place * parts).astype(np.intp), parts - 1)
    order = np.lexsort([left, part])
    first = np.diff(part[order], prepend=-1) > 0
    last = np.append(first[1:], True)
    return np.sort(order[first | last])


def _panels(read: ReadingsShown, before: Array) -> list[_Panel]:
    found = []
    for every in read.mountings:
        shown = _rows_to_draw(every.x, (read.measured - read.after)[every.rows])
        mounting = replace(every, rows=every.rows[shown], x=every.x[shown], side=every.side[shown])
        measured, fit, was, sigma = (
            values[mounting.rows] * 1e3
            for values in (read.measured, read.after, before, read.sigma)
        )
        middle = (fit.max() + fit.min()) / 2
        panel = _Panel(mounting, measured - middle, fit - middle, was - middle, sigma)
        found.append(panel)
    return found


def draw_readings(read: ReadingsShown, before: Array) -> Drawing:
    """Return the figure of readings, fit and residuals by setup.

    Args:
        read: the readings.
        before: what was predicted of them before the fit ``(n,)``, metres or radians.
    """
    setups = _panels(read, before)
    width, height = style.PANEL_SIZE
    figure, corners = style.panel_grid(len(setups), height, strip=0.3)
    reach = {unit: _axis_limits(some) for unit, some in _panels_by_unit(setups).items()}
    for (left, top), setup in zip(corners, setups, strict=True):
        axes = style.place_axes(figure, left + 0.56, top + 0.3, width - 0.68, height - 1.4)
        handles = _draw_setup(axes, setup)
        far, left_over = reach[setup.mounting.unit]
        axes.set_ylim(-far, far)
        style.few_ticks(axes)
        axes.tick_params(labelbottom=False, bottom=False)
        below = style.place_axes(figure, left + 0.56, top + height - 1.0, width - 0.68, 0.55)
        _draw_residual_panel(below, setup)
        below.set_ylim(-left_over, left_over)
        below.set_xlim(axes.get_xlim())
        style.few_ticks(below, up=2)
    figure.legend(
        handles, ("reading", "fit", "noise, ± 2 sigma", "before"), loc="upper left", ncols=4,
        bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, handlelength=1.6,
    )  # fmt: skip
    title = "Readings and fit by setup"
    return style.panel_drawing("readings", title, figure, corners, height, axes=2)


def _panels_by_unit(setups: Sequence[_Panel]) -> dict[str, list[_Panel]]:
    found: dict[str, list[_Panel]] = {}
    for setup in setups:
        found.setdefault(setup.mounting.unit, []).append(setup)
    return found


def _axis_limits(setups: Sequence[_Panel]) -> tuple[float, float]:
    """Return the common limits of readings and of residuals."""
    most = max(float(np.abs(np.concatenate([s.measured, s.fit, s.before])).max()) for s in setups)
    left_over = 1.2 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    return 1.12 * most, max(left_over, 2.4 * float(max(s.sigma.max() for s in setups)))


def _draw_setup(axes: Axes, setup: _Panel) -> list[Any]:
    order = np.argsort(setup.x, kind="stable")
    x, fit, before = setup.x[order], setup.fit[order], setup.before[order]
    noise = 2 * setup.sigma[order]
    # A line is honest only where place along the axis says all: one fitted value a place.
    step = np.diff(x) < 1e-6
    single = not np.any(np.abs(np.diff(fit)[step]) > noise[1:][step] / 2)
    band = axes.fill_between(x, fit - noise, fit + noise, color=style.BAND, alpha=0.35, linewidth=0)
    if not single:
        band.set_visible(False)
        axes.vlines(x, fit - noise, fit + noise, color=style.BAND, alpha=0.5, linewidth=3)
    (was,) = axes.plot(x, before, color=style.BEFORE, linestyle="--" if single else "none",
                       marker="_", markersize=4, linewidth=1)  # fmt: skip
    (line,) = axes.plot(x, fit, color=style.FIT, linestyle="-" if single else "none",
                      marker="" if single else "_")  # fmt: skip
    (dots,) = axes.plot(setup.x, setup.measured, color=style.DATA, linestyle="none", marker="o",
                        markersize=3.6 if len(x) < 12 else 2.4, markeredgewidth=0)  # fmt: skip
    axes.set_title(setup.mounting.title)
    axes.set_ylabel(setup.mounting.unit)
    axes.yaxis.set_label_coords(style.LABEL_POSITION, 0.5)
    axes.margins(x=0.05)
    return [dots, line, band, was]


def _draw_residual_panel(axes: Axes, setup: _Panel) -> None:
    """Draw the residuals of each reading, on a scale of their own."""
    order = np.argsort(setup.x, kind="stable")
    noise = 2 * setup.sigma[order]
    axes.fill_between(setup.x[order], -noise, noise, color=style.BAND, alpha=0.35, linewidth=0)
    axes.axhline(0, color=style.MUTED, linewidth=0.6)
    axes.plot(setup.x, setup.measured - setup.fit, color=style.DATA, linestyle="none", marker="o",
              markersize=3 if len(setup.x) < 12 else 2.2, markeredgewidth=0)  # fmt: skip
    axes.set_xlabel(setup.mounting.label, labelpad=2)
    axes.set_ylabel(f"left, {setup.mounting.unit}")
    axes.yaxis.set_label_coords(style.LABEL_POSITION, 0.5)


def draw_residuals(read: ReadingsShown, before: Array, noise: ByUnit) -> Drawing:
    """Return the figure of residuals by setup, before and after.

    Args:
        read: the readings.
        before: what was predicted of them before the fit ``(n,)``, metres or radians.
        noise: standard deviation of one of them.
    """
    setups = _panels(read, before)
    names = [s.mounting.name for s in setups]
    height = 0.8 + 0.3 * len(setups)
    figure = style.new_figure(style.SINGLE_WIDTH, height)
    margin = min(0.2 + 0.055 * max(map(len, names)), 1.6)
    axes = style.place_axes(figure, margin, 0.32, style.SINGLE_WIDTH - margin - 0.12, height - 0.78)
    _draw_noise(axes, setups, noise.shown)
    axes.axvline(0, color=style.MUTED, linewidth=0.6)
    for k, setup in enumerate(setups):
        place, label = np.full(len(setup.x), float(k)), "_" if k else ""
        axes.plot(setup.measured - setup.before, place - 0.17, color=style.BEFORE, marker="o",
                  linestyle="none", markersize=3.4, fillstyle="none", markeredgewidth=0.9,
                  label=label or "before")  # fmt: skip
        axes.plot(setup.measured - setup.fit, place + 0.17, color=style.FIT, marker="o",
                  linestyle="none", markersize=3.6, markeredgewidth=0,
                  label=label or "after")  # fmt: skip
    reach = 1.1 * max(float(np.abs(s.measured - s.before).max()) for s in setups)
    after = 1.1 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    widest = max(noise.shown[s.mounting.unit] for s in setups)
    reach = max(reach, after, 2 * widest * 1.2)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(setups) - 0.4, -0.6)
    style.few_ticks(axes, across=6)
    axes.set_yticks(range(len(setups)), names, color=style.INK)
    units = " or ".join(_panels_by_unit(setups))
    axes.set_xlabel(f"reading less prediction, {units}", labelpad=2)
    figure.legend(loc="upper left", ncols=3, borderaxespad=0.1, handlelength=1.4,
                  bbox_to_anchor=(0.0, 1.0))  # fmt: skip
    return Drawing("residuals", "Residuals by setup, before and after", style.svg_text(figure))


def _draw_noise(axes: Axes, setups: Sequence[_Panel], noise: Mapping[str, float]) -> None:
    """Draw two sigmas of a reading behind all setups, with those of a level on their own."""
    look: Any = {"color": style.BAND, "alpha": 0.35, "linewidth": 0}
    label = "noise, ± 2 sigma"
    if len(noise) == 1:
        (sigma,) = noise.values()
        axes.axvspan(-2 * sigma, 2 * sigma, label=label, **look)
        return
    wide = [2 * noise[s.mounting.unit] for s in setups]
    axes.barh(
        range(len(setups)), [2 * w for w in wide], 1.0, [-w for w in wide], label=label, **look
    )
