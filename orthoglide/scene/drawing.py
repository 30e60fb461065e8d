"""A machine as inline SVG: a parallel projection, drawn from far to near."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from orthoglide.geometry import Array
from orthoglide.scene.marks import arrow, mark_svg
from orthoglide.scene.paper import HEIGHT, WIDTH, Paper, Point, circle_box, lettering, text_box
from orthoglide.scene.parts import Dial, Option, Posed

_MARGIN, _DIAL_RADIUS = 34.0, 4.5  # on the paper
_NAMESPACE = 'xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" '
_STYLE = (
    "--m-rail:#98a4ad;--m-body:#c3ccd3;--m-bar:#7b8790;--m-ink:#1f2a33;--m-dial:#0072b2;"
    "--m-mark:#d55e00;--m-paper:#ffffff"
)


def blank_paper(posed: Posed) -> Paper:
    """Return the paper in the view in which no leg hides another, scaled so that the machine
    fits.
    """
    if posed.geometry.layout.hanging:  # an azimuth in which no tower leans toward the eye
        towers = [math.atan2(*leg.axes[1::-1, 1]) for leg in posed.geometry.legs]
        azimuth, elevation = min(towers) + math.radians(45), math.radians(14)
    else:
        azimuth, elevation = math.radians(52), math.radians(30)
    ca, sa, ce, se = (
        math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation),
    )  # fmt: skip
    view = np.array([[-sa, ca, 0.0], [ca * se, sa * se, -ce], [ca * ce, sa * ce, se]])
    ends = [end for leg in range(3) for end in posed.rail(leg)]
    flat = np.array([*ends, *posed.lines.reshape(-1, 3), posed.p]) @ view[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.array([WIDTH, HEIGHT])
    scale = float(np.min((size - 2 * _MARGIN) / (high - low)))
    return Paper(view, scale, size / 2 - scale * (low + high) / 2)


def drawing(
    posed: Posed,
    options: Sequence[Option] = (),
    dials: Sequence[Dial] = (),
    *,
    title: str = "The machine",
    first_shown: Sequence[int] = (0,),
    standalone: bool = False,
) -> str:
    """Return the machine as one inline ``<svg>``.

    Each option is a group of class ``option`` and ``option-k``. Options in ``first_shown`` have the
    class ``first`` too; only these are visible without a style sheet.

    Args:
        posed: the posture.
        options: possible errors.
        dials: dials at their places.
        title: title for readers who cannot see the drawing, followed by the options.
        first_shown: numbers of the options that are visible at first.
        standalone: whether the drawing is a separate file, not part of a page.
    """
    paper = blank_paper(posed)
    bodies = sorted(_bodies(posed, paper), key=lambda body: body[0])
    leg_names = _placed_leg_names(posed, paper)
    _occupy(paper, posed, dials, leg_names)
    names = "".join(lettering(*at, name, "ink", 3) for name, at in leg_names)
    groups = []
    for k, option in enumerate(options):
        # Labels of options that are visible together must not overlap.
        is_first = k in first_shown
        sheet = paper if is_first else paper.copy()
        drawn = "".join(mark_svg(mark, posed, dials, sheet) for mark in option.marks)
        attributes = ' first"' if is_first else '" style="display:none"'
        words = escape(option.words)
        groups.append(f'<g class="option option-{k}{attributes}><title>{words}</title>{drawn}</g>')
    text = escape(_description(posed, dials, "; or ".join(option.words for option in options)))
    return (
        f'<svg class="machine" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'{_NAMESPACE if standalone else ""}style="{_STYLE}" font-size="13">'
        f"<title>{escape(title)}</title><desc>{text}</desc>"
        f"{''.join(text for _, text in bodies)}"
        f'<g class="dials">{"".join(_dial(dial, paper) for dial in dials)}</g>'
        f"{''.join(groups)}{names}</svg>"
    )


def _description(posed: Posed, dials: Sequence[Dial], options: str) -> str:
    names = ", ".join(posed.geometry.leg_names)
    dial_names = ", ".join(dict.fromkeys(dial.name for dial in dials))
    dial_words = f" Dials: {dial_names}." if dials else ""
    option_words = f" Marked: {options}." if options else ""
    legs = f"Three legs {names}, each a carriage on its rail and two bars to the platform."
    return f"{posed.geometry.layout.names.in_layout_words(legs)}{dial_words}{option_words}"


def _bodies(posed: Posed, paper: Paper) -> list[tuple[float, str]]:
    """Return all solids with their depths, which are larger if nearer."""
    size, bodies = posed.geometry.d, []
    for leg in range(3):
        axes = posed.geometry.legs[leg].axes
        start, end = posed.rail(leg)
        half = float(np.linalg.norm(end - start)) / 2
        bodies += _box((start + end) / 2, axes, (half, 0.12 * size, 0.16 * size), "rail", paper)
        centre = posed.carriage(leg) + 0.2 * size * axes[:, 1]
        bodies += _box(centre, axes, (0.34 * size, 0.2 * size, 0.42 * size), "body", paper)
        for bar in range(2):
            a, b = posed.lines[leg, bar]
            bodies.append((float(paper.toward_eye @ (a + b)) / 2, line(a, b, paper, "bar", 4.0)))
        for k in range(2):
            a, b = posed.lines[leg, :, k]
            bodies.append((float(paper.toward_eye @ a) + 0.01, line(a, b, paper, "bar", 3.0)))
    corners = np.array([posed.platform(leg) for leg in range(3)])
    middle = corners.mean(axis=0)
    depth = float(paper.toward_eye @ middle)
    bodies.append((depth - 0.02, polygon(corners, paper, "body", 0.9)))
    bodies.append((depth, line(middle, posed.p, paper, "ink", 3.0)))
    x, y = paper.project(posed.p)
    bodies.append(
        (depth + 0.02, f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="var(--m-ink)"/>')
    )
    return bodies


def _box(
    centre: Array, axes: Array, half: tuple[float, ...], colour: str, paper: Paper
) -> list[tuple[float, str]]:
    """Return the three visible faces of a box, as one body."""
    faces = []
    for k in range(3):
        side = 1.0 if axes[:, k] @ paper.toward_eye > 0 else -1.0
        u, v = (axes[:, j] * half[j] for j in range(3) if j != k)
        middle = centre + side * half[k] * axes[:, k]
        corners = np.array([middle + u + v, middle + u - v, middle - u - v, middle - u + v])
        light = 0.55 + 0.45 * abs(float(axes[2, k]))
        faces.append(polygon(corners, paper, colour, light))
    return [(float(paper.toward_eye @ centre), "".join(faces))]


def polygon(corners: Array, paper: Paper, colour: str, opacity: float = 1.0) -> str:
    """Return a filled polygon; a smaller opacity makes it lighter."""
    coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(paper.project, corners))
    return (
        f'<polygon points="{coordinates}" fill="var(--m-paper)"/><polygon points="{coordinates}" '
        f'fill="var(--m-{colour})" fill-opacity="{opacity:.2f}" stroke="var(--m-bar)" '
        f'stroke-width=".7" stroke-linejoin="round"/>'
    )


def line(a: Array, b: Array, paper: Paper, colour: str, width: float) -> str:
    """Return a thick line from a to b ``(3,)``."""
    (x1, y1), (x2, y2) = paper.project(a), paper.project(b)
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
        f'stroke="var(--m-{colour})" stroke-width="{width:g}" stroke-linecap="round"/>'
    )


def _dial(dial: Dial, paper: Paper) -> str:
    """Return a dial: its stem, its face, and an arrow in the direction in which it counts up."""
    face = dial.face(paper.unit)
    x, y = paper.project(face)
    return (
        f"<g><title>dial {escape(dial.name)}</title>"
        f"{arrow(face, dial.tip(paper.unit), paper, 'dial', 1.3)}"
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_DIAL_RADIUS:g}" fill="var(--m-paper)" '
        f'stroke="var(--m-dial)" stroke-width="1.3"/></g>'
    )


def _placed_leg_names(posed: Posed, paper: Paper) -> list[tuple[str, Point]]:
    """Return the names of the legs with the middle of their base lines, beyond their rails."""
    placed = []
    for leg, name in enumerate(posed.geometry.leg_names):
        start, end = posed.rail(leg)
        x, y = paper.project(end + 0.12 * (end - start))
        placed.append((name, (x, y + 4)))
    return placed


def _occupy(
    paper: Paper, posed: Posed, dials: Sequence[Dial], leg_names: Sequence[tuple[str, Point]]
) -> None:
    """Note the names of the legs, dials, rails and bars as occupied."""
    paper.occupied += [text_box(*at, name) for name, at in leg_names]
    for dial in dials:
        paper.occupied.append(circle_box(*paper.project(dial.face(paper.unit)), _DIAL_RADIUS))
        paper.add_line([dial.face(paper.unit), dial.tip(paper.unit)])
    for leg in range(3):
        paper.add_line(posed.rail(leg))
        for ends in posed.lines[leg]:
            paper.add_line(ends)
