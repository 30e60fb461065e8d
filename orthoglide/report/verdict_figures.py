"""Figures of a closed loop: causes, their signatures against the data, the TCP's workspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import LEGS, Array
from orthoglide.numerals import signed
from orthoglide.report.figures import (
    BAND,
    DATA,
    FIT,
    INK,
    LABEL,
    MUTED,
    PALETTE,
    PANEL,
    POINTS,
    SINGLE,
    Drawing,
    draw_readings,
    draw_residuals,
    few_ticks,
    new_figure,
    place_axes,
    style,
    svg_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

    from orthoglide.report.verdict_view import Explained, View

_MOST_PANELS = 6
_LEAST_PATTERN = 0.15  # of the largest: setups that show less of a cause are left out
_MOST_CURVES = 4
_SAME = 0.03  # of what is left: less is no difference between approaches
_CURVES = (  # the chosen cause, then its rivals
    (FIT, "-", 2.6, 0.75),
    (PALETTE["minus"], "--", 1.3, 1.0),
    (PALETTE["third"], ":", 1.7, 1.0),
    (INK, "-.", 1.0, 1.0),
)
_DARKEST = 0.7  # opacity of a cell at the top of the scale


def draw_verdict(view: View) -> list[Drawing]:
    """All figures of a closed loop."""
    verdict = view.verdict
    base = verdict.base
    earlier = base.predicted if view.effects else base.predicted_before
    with style():
        return [
            *([_causes(view)] if view.effects else []),
            *(_signatures(e, k) for k, e in enumerate(view.effects, start=1)),
            draw_residuals(verdict.fit, earlier),
            draw_readings(verdict.fit, earlier),
            _workspace(view),
        ]


# --- Causes by probability ------------------------------------------------------------------


def _causes(view: View) -> Drawing:
    """Bars of probability: each cause that was added, its rivals, and all else together."""
    rows: list[tuple[float, str, float, str]] = []
    place = 0.0
    for explained in view.effects:
        effect = explained.effect
        found = [(effect.name, effect.probability, FIT)]
        found += [(r.trial.candidate.name, r.weight, BAND) for r in effect.rivals]
        rest = max(1.0 - sum(p for _, p, _ in found), 0.0)
        found.append(("all else together", rest, PALETTE["before"]))
        for name, p, colour in found:
            rows.append((place, name, p, colour))
            place += 1
        place += 0.6
    height = 0.34 + 0.24 * place
    figure = new_figure(SINGLE, height)
    margin = min(0.2 + 0.062 * max(len(r[1]) for r in rows), 1.9)
    axes = place_axes(figure, margin, 0.06, SINGLE - margin - 0.45, height - 0.3)
    axes.barh([r[0] for r in rows], [r[2] for r in rows], height=0.62, color=[r[3] for r in rows])
    for at, _, p, _ in rows:
        axes.text(p + 0.015, at, f"{p:.2f}", va="center", fontsize=7.5, color=INK)
    axes.set_xlim(0, 1)
    axes.set_ylim(place - 0.9, -0.6)
    axes.set_yticks([r[0] for r in rows], [r[1] for r in rows], color=INK)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "0.25", "0.5", "0.75", "1"])
    axes.grid(visible=False, axis="y")
    return Drawing("causes", "Causes by probability", svg_text(figure))


# --- Signatures against what is to be explained ---------------------------------------------


@dataclass(frozen=True)
class _Pattern:
    """One setup: what is left without a cause, and what each rival makes of it; millimetres.

    Attributes:
        title: of the panel.
        label: of the scale below.
        x: by station.
        side: side of the approach of the touched leg's own axis, by station.
        left: mean of what is left, by station.
        noise: two sigmas of that mean.
        curves: what the causes predict, by station.
    """

    title: str
    label: str
    x: Array
    side: Array
    left: Array
    noise: Array
    curves: tuple[Array, ...]

    @property
    def sides(self) -> list[float]:
        """Sides of the approach where the cause looks different from either; else none."""
        up, down = (
            dict(zip(np.round(self.x[own], 3).tolist(), self.curves[0][own], strict=True))
            for own in (self.side == 1, self.side == -1)
        )
        apart = [abs(up[x] - down[x]) for x in up if x in down]
        differ = apart and max(apart) > _SAME * float(np.ptp(self.left))
        return [1.0, -1.0] if differ else []


def _patterns(explained: Explained) -> list[_Pattern]:
    without = explained.without
    problem = without.problem
    residual = problem.measured - without.predicted
    predicted = [fit.predicted - without.predicted for _, fit in explained.fits[:_MOST_CURVES]]
    travel = np.concatenate([c.command for c in problem.campaigns]) - problem.machine.geometry.L
    approach = np.concatenate([c.approach for c in problem.campaigns])
    setups = [(c.name, s) for c in problem.campaigns for s in c.setups]
    several, found = len(problem.campaigns) > 1, []
    for k, (stem, setup) in enumerate(setups):
        rows = np.flatnonzero(problem.setup_of_row == k)
        _, first, station = np.unique(problem.station[rows], return_index=True, return_inverse=True)
        count = np.bincount(station)

        x = travel[rows[first], setup.leg] * 1e3
        moves = np.ptp(x) > 1.0
        noise = np.hypot(problem.sigma[rows[first]] / np.sqrt(count), problem.noise.common)
        prefix = f"{stem} · " if several else ""
        found.append(
            _Pattern(
                f"{prefix}{setup.name}: leg {LEGS[setup.leg]}, read along {setup.direction}",
                f"travel of carriage {LEGS[setup.leg]}, mm" if moves else "place in the file",
                x if moves else np.arange(len(x), dtype=float),
                approach[rows[first], setup.leg],
                _mean(residual[rows], station),
                2e3 * noise,
                tuple(_mean(p[rows], station) for p in predicted),
            )
        )
    return found


def _mean(values: Array, station: NDArray[np.intp]) -> Array:
    """By station, millimetres."""
    return np.asarray(np.bincount(station, values) / np.bincount(station) * 1e3)


def _shown(patterns: list[_Pattern]) -> list[_Pattern]:
    """The setups in which a cause shows most, in the order of the file."""
    size = np.array([np.sqrt(np.mean(p.curves[0] ** 2)) for p in patterns])
    most = set(np.argsort(-size, kind="stable")[:_MOST_PANELS].tolist())
    return [
        p for k, p in enumerate(patterns) if k in most and size[k] >= _LEAST_PATTERN * size.max()
    ]


def _signatures(explained: Explained, place: int) -> Drawing:
    patterns = _shown(_patterns(explained))
    across = min(3, len(patterns))
    width, height, strip = PANEL[0], 2.1, 0.3
    lines = -(-len(patterns) // across)
    figure = new_figure(across * width, lines * height + strip)
    reach = 1.15 * max(float(np.max(np.abs(p.left) + p.noise)) for p in patterns)
    places = []
    for k, pattern in enumerate(patterns):
        left, top = (k % across) * width, (k // across) * height + strip
        axes = place_axes(figure, left + 0.56, top + 0.3, width - 0.68, height - 0.75)
        handles = _draw_pattern(axes, pattern)
        axes.set_ylim(-reach, reach)
        few_ticks(axes)
        places.append((left * POINTS, top * POINTS, width * POINTS, height * POINTS))
    names = [name for name, _ in explained.fits[:_MOST_CURVES]]
    figure.legend(handles, names, loc="upper left", ncols=4, bbox_to_anchor=(0.0, 1.0),
                  borderaxespad=0.2, handlelength=2.2)  # fmt: skip
    title = "What is to be explained, and what each cause makes of it"
    return Drawing(f"signatures-{place}", title, svg_text(figure), tuple(places))


def _draw_pattern(axes: Axes, pattern: _Pattern) -> list[Line2D]:
    """One panel; returns a handle for each cause."""
    sides = pattern.sides
    handles = []
    for curve, (colour, dash, width, alpha) in zip(pattern.curves, _CURVES, strict=False):
        for side in sides or [0.0]:
            own = np.flatnonzero(pattern.side == side) if sides else np.arange(len(pattern.x))
            order = own[np.lexsort([curve[own], pattern.x[own]])]
            (line,) = axes.plot(pattern.x[order], curve[order], color=colour, linestyle=dash,
                                linewidth=width, alpha=alpha)  # fmt: skip
        handles.append(line)
    marks = {1.0: "^", -1.0: "v"} if len(sides) > 1 else {}
    axes.vlines(pattern.x, pattern.left - pattern.noise, pattern.left + pattern.noise,
                color=DATA, linewidth=0.8)  # fmt: skip
    for side in sides or [0.0]:
        own = pattern.side == side if sides else np.ones(len(pattern.x), dtype=bool)
        axes.plot(pattern.x[own], pattern.left[own], color=DATA, linestyle="none",
                  marker=marks.get(side, "o"), markersize=4.2, markeredgewidth=0)  # fmt: skip
    axes.axhline(0, color=MUTED, linewidth=0.6)
    axes.set_title(pattern.title)
    axes.set_xlabel(pattern.label, labelpad=2)
    axes.set_ylabel("mm")
    axes.yaxis.set_label_coords(LABEL, 0.5)
    axes.margins(x=0.05)
    return handles


# --- The TCP over the workspace -------------------------------------------------------------


def _workspace(view: View) -> Drawing:
    """What is wrong and what is not known on three levels of z; darker for larger."""
    space = view.workspace
    travel = (space.commands - view.verdict.fit.problem.machine.geometry.L) * 1e3
    levels = np.unique(np.round(travel[:, 2], 6))
    chosen = levels[[0, len(levels) // 2, -1]]
    rows = [
        ("predicted error now", space.nominal, DATA),
        ("with offsets and lengths set", space.before, DATA),
        ("95 % radius afterwards", space.sure, FIT),
    ]
    if not view.effects:  # then the base model is all there is
        del rows[1]
    scale = {c: max(float(v.max()) for _, v, own in rows if own == c) for c in (DATA, FIT)}
    width, height = PANEL[0], 2.5
    figure = new_figure(3 * width, len(rows) * height)
    places = []
    for i, (what, values, colour) in enumerate(rows):
        for j, level in enumerate(chosen):
            own = np.abs(travel[:, 2] - level) < 1e-3
            axes = place_axes(
                figure, j * width + 0.5, i * height + 0.32, width - 0.6, height - 0.78
            )
            _draw_cells(axes, travel[own], values[own] * 1e3, colour, scale[colour] * 1e3)
            axes.set_title(f"{what}, z {signed(level, 0)} mm")
            places.append(
                (j * width * POINTS, i * height * POINTS, width * POINTS, height * POINTS)
            )
    title = "The TCP over the workspace, mm"
    return Drawing("workspace", title, svg_text(figure), tuple(places))


def _draw_cells(axes: Axes, travel: Array, values: Array, colour: str, most: float) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    xs, ys = (np.unique(np.round(travel[:, k], 6)) for k in (0, 1))
    column = np.searchsorted(xs, np.round(travel[:, 0], 6))
    row = np.searchsorted(ys, np.round(travel[:, 1], 6))
    corners = np.array([[0.03, 0.03], [0.97, 0.03], [0.97, 0.97], [0.03, 0.97]])
    squares = np.stack([column, row], axis=1)[:, None, :] + corners
    shades = [to_rgba(colour, 0.05 + (_DARKEST - 0.05) * v / max(most, 1e-12)) for v in values]
    axes.add_collection(PolyCollection(list(squares), facecolors=shades, linewidths=0))
    places = 3 if most < 0.1 else 2
    for x, y, v in zip(column, row, values, strict=True):
        axes.text(x + 0.5, y + 0.47, f"{v:.{places}f}", ha="center", va="center", fontsize=7)
    axes.set_xlim(0, len(xs))
    axes.set_ylim(0, len(ys))
    axes.grid(visible=False)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(length=0)
    _name_places(axes, xs, ys)
    axes.set_xlabel("travel of x, mm", labelpad=2)
    axes.set_ylabel("travel of y, mm", labelpad=3)


def _name_places(axes: Axes, xs: Array, ys: Array) -> None:
    axes.set_xticks(np.arange(len(xs)) + 0.5, [signed(x, 0) for x in xs])
    axes.set_yticks(np.arange(len(ys)) + 0.5, [signed(y, 0) for y in ys])
