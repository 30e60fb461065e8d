"""The figures of a result: readings, residuals, free-form errors, and the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import orthoglide.figures.style as style
from orthoglide.errors import check_choice
from orthoglide.figures.axes import (
    LEGEND_HEIGHT,
    PANEL_HEIGHT,
    SINGLE_WIDTH,
    Axes,
    Key,
    Panel,
    legend,
    padded,
    panel_drawing,
    round_ticks,
)
from orthoglide.figures.style import Drawing
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit, signed
from orthoglide.result import Curve, Mounting, ReadingsShown, Result, Workspace

_BOTTOM, _RESIDUALS = 32.0, 40.0  # height below the axes; height of the axes of residuals


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
    setups = _panels(readings, before)
    limits = {unit: _axis_limits(some) for unit, some in _panels_by_unit(setups).items()}

    def draw(setup: _Panel, panel: Panel) -> list[Key]:
        x, (limit, residual_limit) = padded(setup.x, 0.05), limits[setup.mounting.unit]
        y, below = (-limit, limit), (-residual_limit, residual_limit)
        axes = panel.add_axes(x, y, bottom=_BOTTOM + _RESIDUALS + 8)
        keys = _draw_setup(axes, setup)
        axes.set_title(setup.mounting.title)
        axes.set_x_axis([(place, "") for place, _ in round_ticks(x)])
        axes.set_y_axis(round_ticks(y), setup.mounting.unit)
        axes = panel.add_axes(x, below, top=PANEL_HEIGHT - _BOTTOM - _RESIDUALS, bottom=_BOTTOM)
        order = np.argsort(setup.x, kind="stable")
        noise = 2 * setup.sigma[order]
        axes.band(setup.x[order], -noise, noise, style.BAND, 0.35)
        axes.zero()
        size = 3.0 if len(setup.x) < 12 else 2.2
        axes.points(setup.x, setup.measured - setup.fit, style.DATA, size)
        axes.set_x_axis(round_ticks(x), setup.mounting.label)
        axes.set_y_axis(round_ticks(below, 2), f"residual, {setup.mounting.unit}")
        return keys

    return panel_drawing("readings", "Readings and fit by setup", setups, draw, PANEL_HEIGHT,
                         ("reading", "fit", "noise, ± 2 sigma", "before"))  # fmt: skip


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


def _draw_setup(axes: Axes, setup: _Panel) -> list[Key]:
    order = np.argsort(setup.x, kind="stable")
    x, fit, before = setup.x[order], setup.fit[order], setup.before[order]
    noise = 2 * setup.sigma[order]
    # A line is drawn only if every abscissa has a single fitted value.
    step = np.diff(x) < 1e-6
    if not np.any(np.abs(np.diff(fit)[step]) > noise[1:][step] / 2):
        noise_key = axes.band(x, fit - noise, fit + noise, style.BAND, 0.35)
        before_key = axes.line(x, before, style.BEFORE, 1.0, dashed=True)
        fit_key = axes.line(x, fit, style.FIT)
    else:
        noise_key = axes.segments(x, fit - noise, x, fit + noise, style.BAND, 3.0, 0.5)
        before_key = axes.ticks(x, before, style.BEFORE, 4.0)
        fit_key = axes.ticks(x, fit, style.FIT, 6.0)
    size = 3.6 if len(x) < 12 else 2.4
    return [axes.points(setup.x, setup.measured, style.DATA, size), fit_key, noise_key, before_key]


def draw_residuals(readings: ReadingsShown, before: Array, noise: ByUnit) -> Drawing:
    """Return the figure of residuals by setup, before and after, with the noise of a reading;
    ``before`` as for `draw_readings`.
    """
    setups = _panels(readings, before)
    names = [s.mounting.name for s in setups]
    wide = [2 * noise.shown[s.mounting.unit] for s in setups]
    reach = 1.1 * max(float(np.abs(s.measured - s.before).max()) for s in setups)
    after = 1.1 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    reach = max(reach, after, 1.2 * max(wide))
    size = (SINGLE_WIDTH, 58.0 + 22.0 * len(setups))
    left = min(14.0 + 4.0 * max(map(len, names)), 115.0)
    panel = Panel((0.0, 0.0, *size))
    x, y = (-reach, reach), (len(setups) - 0.5, -0.5)
    axes = panel.add_axes(x, y, left=left, top=LEGEND_HEIGHT)
    for k, (setup, half) in enumerate(zip(setups, wide, strict=True)):
        band = axes.boxes([0.0], [k], 2 * half, 1.0, style.BAND, 0.35)
        rows = np.full(len(setup.x), float(k))
        open_dots = axes.points(setup.measured - setup.before, rows - 0.17, style.BEFORE, 3.4,
                                filled=False)  # fmt: skip
        dots = axes.points(setup.measured - setup.fit, rows + 0.17, style.FIT, 3.6)
    axes.zero(vertical=True)
    units = " or ".join(_panels_by_unit(setups))
    axes.set_x_axis(round_ticks(x, 6), f"reading less prediction, {units}")
    axes.set_y_axis(list(enumerate(names)))
    keys = legend(8.0, 10.0, [open_dots, dots, band], ("before", "after", "noise, ± 2 sigma"))
    title = "Residuals by setup, before and after"
    return Drawing("residuals", title, size, (panel.svg(),), keys)


_MOST_PANELS = 6  # free-form errors of a figure
_HEIGHT = 151.0  # of a panel


_AXIS_LABELS = {
    "travel": "travel, mm", "approach": "travel, mm", "time": "time, s", "reading": "reading, mm",
    "reversal": "distance since the reversal, mm",
}  # fmt: skip


def _draw_curve(curve: Curve, panel: Panel) -> tuple[()]:
    at = curve.at * (1.0 if curve.against == "time" else 1e3)
    value, band = curve.value * 1e3, 1.96e3 * curve.sigma
    x, y = padded(at, 0.02), padded([*(value - band), *(value + band), 0.0], 0.05)
    axes = panel.add_axes(x, y)
    axes.band(at, value - band, value + band, style.BAND)
    axes.line(at, value, style.FIT, 1.6)
    axes.zero()
    axes.set_title(curve.name)
    axes.set_x_axis(round_ticks(x), _AXIS_LABELS.get(curve.against, "command, mm"))
    axes.set_y_axis(round_ticks(y), curve.unit)
    return ()


_MAX_OPACITY = 0.7  # opacity of the cell with the largest value


def draw(result: Result) -> list[Drawing]:
    """Return all figures of a result."""
    located = (one.members[:_MOST_PANELS] for one in result.located)
    return [
        *(panel_drawing(f"located-{k}", "Free-form errors", curves, _draw_curve, _HEIGHT)
          for k, curves in enumerate(located, start=1)),
        *_result_figures(result),
    ]  # fmt: skip


def draw_one(result: Result, what: str) -> Drawing:
    """Return one figure of a result: ``"residuals"``, ``"readings"`` or ``"workspace"``.

    Raises:
        InputError: if this result has no such figure.
    """
    return _named(_result_figures(result), what)


def draw_fit(readings: ReadingsShown, noise: ByUnit, what: str) -> Drawing:
    """Return one figure of a fit, ``"residuals"`` or ``"readings"``; ``noise`` is the standard
    deviation of a reading.

    Raises:
        InputError: if there is no such figure.
    """
    return _named(_fit_figures(readings, readings.nominal, noise), what)


def _result_figures(result: Result) -> list[Drawing]:
    readings, space = result.readings, result.workspace
    before = readings.before if result.improved else readings.nominal
    drawings = _fit_figures(readings, before, result.noise.single_reading)
    return drawings if space is None else [*drawings, draw_workspace(space, result.improved)]


def _fit_figures(readings: ReadingsShown, before: Array, noise: ByUnit) -> list[Drawing]:
    return [draw_residuals(readings, before, noise), draw_readings(readings, before)]


def _named(drawings: Sequence[Drawing], what: str) -> Drawing:
    by_name = {drawing.name: drawing for drawing in drawings}
    check_choice("figure", what, by_name)
    return by_name[what]


# --- The workspace --------------------------------------------------------------------------


def draw_workspace(space: Workspace, improved: bool) -> Drawing:
    """Return the figure of the TCP's error and its uncertainty at three heights; darker is larger.
    ``improved``: whether the final model differs from the base model.
    """
    *errors, (what, radius) = space.stages(improved)
    rows = [(words, error * 1e3, style.DATA) for words, error in errors]
    rows.append((what, radius * 1e3, style.FIT))
    return draw_levels("workspace", "The TCP over the workspace, mm", rows, space.at, space.axis)


def draw_levels(
    name: str, title: str, rows: Sequence[tuple[str, Array, str]], at: Array, axis: str
) -> Drawing:
    """Return a figure of values over the workspace at three heights; darker is larger.

    A row of panels has what it shows, the values ``(n,)`` at places ``(n, 3)``, metres, and their
    colour; values of equal colour share a scale. ``axis`` has a placeholder for x and y.
    """
    places = np.round(at * 1e3, 6) + 0.0
    levels = np.unique(places[:, 2])
    scale = dict[str, float]()  # largest value by colour
    for _, values, colour in rows:
        scale[colour] = max(scale.get(colour, 0.0), float(values.max()))

    def draw(part: tuple[str, Array, str, float], panel: Panel) -> tuple[()]:
        what, values, colour, level = part
        on_level = np.abs(places[:, 2] - level) < 1e-3
        shades = values[on_level], colour, scale[colour]
        axes = _draw_level(panel, places[on_level], *shades, axis)
        axes.set_title(f"{what}, z {signed(level, 0)}")  # mm, as the axes; more is cut off
        return ()

    shown_levels = np.unique(levels[[0, len(levels) // 2, -1]])
    panels = [(*row, float(level)) for row in rows for level in shown_levels]
    return panel_drawing(name, title, panels, draw, 180.0)


def _draw_level(
    panel: Panel, at: Array, values: Array, colour: str, largest: float, axis: str
) -> Axes:
    """Draw a square with its value for each place of one level; darker is larger."""
    (xs, x), (ys, y) = (np.unique(np.round(at[:, k], 6), return_inverse=True) for k in (0, 1))
    axes = panel.add_axes((0.0, float(len(xs))), (0.0, float(len(ys))))
    decimals = 3 if largest < 0.1 else 2 if largest < 10 else 1
    opacity = (0.05 + (_MAX_OPACITY - 0.05) * values / max(largest, 1e-12)).tolist()
    for i, j, value, alpha in zip(x.tolist(), y.tolist(), values.tolist(), opacity, strict=True):
        axes.boxes([i + 0.5], [j + 0.5], 0.94, 0.94, colour, alpha)
        axes.write(i + 0.5, j + 0.5, f"{value:.{decimals}f}", 7.0)
    x_ticks, y_ticks = (
        [(k + 0.5, signed(v, 0)) for k, v in enumerate(v.tolist())] for v in (xs, ys)
    )
    axes.set_x_axis(x_ticks, f"{axis.format('x')}, mm", lines=False)
    axes.set_y_axis(y_ticks, f"{axis.format('y')}, mm", lines=False)
    return axes
