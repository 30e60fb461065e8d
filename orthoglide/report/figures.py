"""Figures as SVG: readings against the fit, residuals, parameters, correlations.

Texts stay texts and colours are named (see `PALETTE`), so that the page can give them its own font
and its colours of day and night. The same result gives the same bytes.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.effects import family_of
from orthoglide.geometry import LEGS, Array
from orthoglide.numerals import signed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from orthoglide.fit import Estimate

# Okabe and Ito's colours, which the colour-blind can tell apart; each hex stands for its name.
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

POINTS = 72.0  # SVG units an inch
SINGLE = 3.9  # inches: width of a figure that fits a phone
PANEL = (3.0, 2.75)  # inches: one of the small multiples
_ACROSS = 3
LABEL = -0.195  # of the axes: where the small multiples carry the name of their scale
_MOST_CELLS = 8  # unknowns up to which correlations are printed as numbers


@dataclass(frozen=True)
class Drawing:
    """One figure.

    Attributes:
        name: of its file.
        title: what it shows, in a phrase.
        svg: the text of its file.
        panels: places ``(x, y, width, height)`` in units of the SVG that a page may show by
            themselves, in the order of the axes; empty for a figure that stays whole.
        axes: how many axes each panel holds.
    """

    name: str
    title: str
    svg: str
    panels: tuple[tuple[float, float, float, float], ...] = ()
    axes: int = 1


def draw(estimate: Estimate) -> list[Drawing]:
    """All figures of an identification."""
    with style():
        return [
            draw_readings(estimate),
            draw_residuals(estimate),
            _parameters(estimate),
            _correlations(estimate),
        ]


@contextmanager
def style() -> Iterator[None]:
    """The look of all figures, for a while."""
    import matplotlib

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # its font cache is nobody's concern
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(
            {
                "svg.hashsalt": "orthoglide",
                "svg.fonttype": "none",
                "font.sans-serif": ["DejaVu Sans"],  # what widths are measured with
                "font.size": 8.0,
                "axes.titlesize": 8.5,
                "axes.titlelocation": "left",
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
    """An empty figure, inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def place_axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes at a place in inches from the top left corner."""
    w, h = figure.get_size_inches()
    return figure.add_axes((left / w, 1 - (top + height) / h, width / w, height / h))


def svg_text(figure: Figure) -> str:
    """The text of a figure's file: the same bytes for the same figure."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def few_ticks(axes: Axes, across: int = 4, up: int = 4) -> None:
    """Round numbers, and few of them."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(across, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(up, steps=[1, 2, 2.5, 5, 10]))


# --- Readings against the fit ---------------------------------------------------------------


@dataclass(frozen=True)
class _Panel:
    """One setup: readings and predictions about the middle of the fit, millimetres."""

    title: str
    label: str
    x: Array
    measured: Array
    fit: Array
    before: Array
    sigma: Array


def _setups(estimate: Estimate, earlier: Array | None = None) -> list[_Panel]:
    problem, found = estimate.problem, []
    earlier = estimate.predicted_before if earlier is None else earlier
    for campaign, part in zip(problem.campaigns, problem.rows, strict=True):
        fit, before = estimate.predicted[part], earlier[part]
        for k, setup in enumerate(campaign.setups):
            own = campaign.setup == k
            travel = campaign.command[own, setup.leg] - problem.machine.geometry.L
            moves = np.ptp(travel) > 1e-3
            stem = f"{campaign.name} · " if len(problem.campaigns) > 1 else ""
            middle = (fit[own].max() + fit[own].min()) / 2
            found.append(
                _Panel(
                    f"{stem}{setup.name}: leg {LEGS[setup.leg]}, read along {setup.direction}",
                    f"travel of carriage {LEGS[setup.leg]}, mm" if moves else "place in the file",
                    travel * 1e3 if moves else campaign.order[own].astype(float),
                    (campaign.reading[own] - middle) * 1e3,
                    (fit[own] - middle) * 1e3,
                    (before[own] - middle) * 1e3,
                    problem.sigma[part][own] * 1e3,
                )
            )
    return found


def draw_readings(estimate: Estimate, earlier: Array | None = None) -> Drawing:
    """Readings and fit by setup, with what the fit leaves of them.

    Args:
        estimate: the fit.
        earlier: readings ``(n,)`` predicted before it, metres; the nominal machine's where absent.
    """
    setups = _setups(estimate, earlier)
    across = min(_ACROSS, len(setups))
    width, height, strip = *PANEL, 0.3
    rows = -(-len(setups) // across)
    figure = new_figure(across * width, rows * height + strip)
    reach = 1.12 * max(
        float(np.abs(np.concatenate([s.measured, s.fit, s.before])).max()) for s in setups
    )
    left_over = 1.2 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    left_over = max(left_over, 2.4 * float(max(s.sigma.max() for s in setups)))
    places = []
    for k, setup in enumerate(setups):
        left, top = (k % across) * width, (k // across) * height + strip
        axes = place_axes(figure, left + 0.56, top + 0.3, width - 0.68, height - 1.4)
        handles = _draw_setup(axes, setup)
        axes.set_ylim(-reach, reach)
        few_ticks(axes)
        axes.tick_params(labelbottom=False, bottom=False)
        below = place_axes(figure, left + 0.56, top + height - 1.0, width - 0.68, 0.55)
        _draw_left(below, setup)
        below.set_ylim(-left_over, left_over)
        below.set_xlim(axes.get_xlim())
        few_ticks(below, up=2)
        places.append((left * POINTS, top * POINTS, width * POINTS, height * POINTS))
    figure.legend(
        handles, ("reading", "fit", "noise, ± 2 sigma", "before"), loc="upper left", ncols=4,
        bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, handlelength=1.6,
    )  # fmt: skip
    return Drawing("readings", "Readings and fit by setup", svg_text(figure), tuple(places), 2)


def _draw_setup(axes: Axes, setup: _Panel) -> list[Any]:
    order = np.argsort(setup.x, kind="stable")
    x, fit, before = setup.x[order], setup.fit[order], setup.before[order]
    noise = 2 * setup.sigma[order]
    # A line is honest only where place along the axis says all: one fitted value a place.
    step = np.diff(x) < 1e-6
    single = not np.any(np.abs(np.diff(fit)[step]) > noise[1:][step] / 2)
    style = "-" if single else "none"
    band = axes.fill_between(x, fit - noise, fit + noise, color=BAND, alpha=0.35, linewidth=0)
    if not single:
        band.set_visible(False)
        axes.vlines(x, fit - noise, fit + noise, color=BAND, alpha=0.5, linewidth=3)
    (was,) = axes.plot(x, before, color=BEFORE, linestyle="--" if single else "none",
                       marker="_", markersize=4, linewidth=1)  # fmt: skip
    (line,) = axes.plot(x, fit, color=FIT, linestyle=style, marker="" if single else "_")
    (dots,) = axes.plot(setup.x, setup.measured, color=DATA, linestyle="none", marker="o",
                        markersize=3.6 if len(x) < 12 else 2.4, markeredgewidth=0)  # fmt: skip
    axes.set_title(setup.title)
    axes.set_ylabel("mm")
    axes.yaxis.set_label_coords(LABEL, 0.5)
    axes.margins(x=0.05)
    return [dots, line, band, was]


def _draw_left(axes: Axes, setup: _Panel) -> None:
    """What the fit leaves of each reading, on a scale of its own."""
    order = np.argsort(setup.x, kind="stable")
    noise = 2 * setup.sigma[order]
    axes.fill_between(setup.x[order], -noise, noise, color=BAND, alpha=0.35, linewidth=0)
    axes.axhline(0, color=MUTED, linewidth=0.6)
    axes.plot(setup.x, setup.measured - setup.fit, color=DATA, linestyle="none", marker="o",
              markersize=3 if len(setup.x) < 12 else 2.2, markeredgewidth=0)  # fmt: skip
    axes.set_xlabel(setup.label, labelpad=2)
    axes.set_ylabel("left, mm")
    axes.yaxis.set_label_coords(LABEL, 0.5)


# --- Residuals ------------------------------------------------------------------------------


def draw_residuals(estimate: Estimate, earlier: Array | None = None) -> Drawing:
    """Residuals by setup, before and after; arguments as for :func:`draw_readings`."""
    setups = _setups(estimate, earlier)
    names = [s.title.partition(":")[0] for s in setups]
    height = 0.8 + 0.3 * len(setups)
    figure = new_figure(SINGLE, height)
    margin = min(0.2 + 0.055 * max(map(len, names)), 1.6)
    axes = place_axes(figure, margin, 0.32, SINGLE - margin - 0.12, height - 0.78)
    noise = 2 * estimate.problem.noise.typical * 1e3
    axes.axvspan(-noise, noise, color=BAND, alpha=0.35, linewidth=0, label="noise, ± 2 sigma")
    axes.axvline(0, color=MUTED, linewidth=0.6)
    for k, setup in enumerate(setups):
        place, label = np.full(len(setup.x), float(k)), "_" if k else ""
        axes.plot(setup.measured - setup.before, place - 0.17, color=BEFORE, marker="o",
                  linestyle="none", markersize=3.4, fillstyle="none", markeredgewidth=0.9,
                  label=label or "before")  # fmt: skip
        axes.plot(setup.measured - setup.fit, place + 0.17, color=FIT, marker="o",
                  linestyle="none", markersize=3.6, markeredgewidth=0,
                  label=label or "after")  # fmt: skip
    reach = 1.1 * max(float(np.abs(s.measured - s.before).max()) for s in setups)
    after = 1.1 * max(float(np.abs(s.measured - s.fit).max()) for s in setups)
    reach = max(reach, after, noise * 1.2)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(setups) - 0.4, -0.6)
    few_ticks(axes, across=6)
    axes.set_yticks(range(len(setups)), names, color=INK)
    axes.set_xlabel("reading less prediction, mm", labelpad=2)
    figure.legend(loc="upper left", ncols=3, borderaxespad=0.1, handlelength=1.4,
                  bbox_to_anchor=(margin / SINGLE - 0.02, 1.0))  # fmt: skip
    return Drawing("residuals", "Residuals by setup, before and after", svg_text(figure))


# --- Parameters and their correlations ------------------------------------------------------


def _parameters(estimate: Estimate) -> Drawing:
    """Values with their 95 % intervals against the tolerances, a strip a family."""
    families: dict[str, list[int]] = {}
    for k, name in enumerate(estimate.names):
        families.setdefault(family_of(name).name, []).append(k)
    heights = [0.72 + 0.24 * len(members) for members in families.values()]
    figure = new_figure(SINGLE, sum(heights) + 0.3)
    short = [name.partition(".")[2] for name in estimate.names]
    margin = min(0.2 + 0.06 * max(map(len, short)), 1.7)
    top = 0.3
    for (family, members), height in zip(families.items(), heights, strict=True):
        axes = place_axes(figure, margin, top + 0.2, SINGLE - margin - 0.12, height - 0.58)
        handles = _draw_family(axes, estimate, family, members)
        axes.set_yticks(range(len(members)), [short[k] for k in members], color=INK)
        top += height
    figure.legend(
        handles, ("value, 95 % interval", "tolerance, ± 1 sigma"), loc="upper left", ncols=2,
        bbox_to_anchor=(margin / SINGLE - 0.02, 1.0), borderaxespad=0.1, handlelength=1.4,
    )  # fmt: skip
    return Drawing("parameters", "Identified values against their tolerances", svg_text(figure))


def _draw_family(axes: Axes, estimate: Estimate, family: str, members: list[int]) -> list[Any]:
    unit = family_of(family).unit
    value = estimate.x[members] / unit.si
    half = estimate.coverage_factor * np.sqrt(np.diag(estimate.covariance))[members] / unit.si
    tolerance = float(estimate.problem.tolerance[members[0]]) / unit.si
    rows = np.arange(len(members))
    band = axes.axvspan(-tolerance, tolerance, color=BAND, alpha=0.25, linewidth=0)
    axes.axvline(0, color=MUTED, linewidth=0.6)
    axes.hlines(rows, value - half, value + half, color=FIT, linewidth=1.6)
    (dots,) = axes.plot(value, rows, color=FIT, marker="o", linestyle="none", markersize=4.4,
                        markeredgewidth=0)  # fmt: skip
    reach = 1.1 * max(float(np.max(np.abs(value) + half)), 1.1 * tolerance)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(members) - 0.5, -0.5)
    few_ticks(axes, across=5)
    axes.set_title(f"{family.replace('_', ' ')}, {unit.name}", pad=3)
    return [dots, band]


def _correlations(estimate: Estimate) -> Drawing:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    matrix, count = estimate.correlation, len(estimate.names)
    labels = list(estimate.names)
    margin = 0.12 + 0.056 * max(map(len, labels))
    cell = max((SINGLE - margin - 0.1) / count, 0.14)
    width, height = margin + 0.1 + cell * count, margin + 0.1 + cell * count
    figure = new_figure(width, height)
    axes = place_axes(figure, margin, 0.05, cell * count, cell * count)
    row, column = np.divmod(np.arange(count**2), count)
    corners = np.array([[0.04, 0.04], [0.96, 0.04], [0.96, 0.96], [0.04, 0.96]])
    squares = np.stack([column, row], axis=1)[:, None, :] + corners
    flat = matrix.ravel()
    colours = [to_rgba(FIT if v < 0 else DATA, 0.06 + 0.74 * min(abs(v), 1)) for v in flat]
    axes.add_collection(PolyCollection(list(squares), facecolors=colours, linewidths=0))
    if count <= _MOST_CELLS:
        for i, j, v in zip(row, column, flat, strict=True):
            text = "1" if i == j else "0" if abs(v) < 5e-3 else signed(v, 2)
            axes.text(j + 0.5, i + 0.5, text, ha="center", va="center",
                      fontsize=7.5)  # fmt: skip
    axes.set_xlim(0, count)
    axes.set_ylim(count, 0)
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(length=0)
    axes.set_xticks(np.arange(count) + 0.5, labels, rotation=90, color=INK)
    axes.set_yticks(np.arange(count) + 0.5, labels, color=INK)
    return Drawing("correlations", "Correlations of the identified values", svg_text(figure))
