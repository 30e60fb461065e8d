"""A machine as inline SVG: a parallel projection, drawn from far to near."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from orthoglide.geometry import Array
from orthoglide.scene.marks import arrow, mark_svg
from orthoglide.scene.paper import HEIGHT, WIDTH, Paper, circle_box, lettering, text_box
from orthoglide.scene.parts import Dial, Option, Posed

_MARGIN, _DIAL_RADIUS = 34.0, 4.5  # on the paper
_NAMESPACE = 'xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" '
_STYLE = (
    "--m-rail:#98a4ad;--m-body:#c3ccd3;--m-bar:#7b8790;--m-ink:#1f2a33;--m-dial:#0072b2;"
    "--m-mark:#d55e00;--m-paper:#ffffff"
)


@dataclass(frozen=True)
class Projection:
    """Parallel projection from the base frame to the paper."""

    right: Array  # unit vector (3,)
    up: Array  # unit vector (3,)
    near: Array  # unit vector toward the eye (3,)
    scale: float = 1.0  # paper units a metre
    shift: tuple[float, float] = (0.0, 0.0)  # paper coordinates of the base frame's origin (2,)

    def __call__(self, point: Array) -> tuple[float, float]:
        """Paper coordinates of a point ``(3,)``."""
        return (
            self.shift[0] + self.scale * float(self.right @ point),
            self.shift[1] - self.scale * float(self.up @ point),
        )


def projection(posed: Posed, points: Array) -> Projection:
    """Return the view in which no leg hides another, scaled so that points ``(n, 3)`` fit the
    paper.
    """
    if posed.geometry.layout.hanging:  # an azimuth in which no tower leans toward the eye
        towers = [math.atan2(*leg.axes[1::-1, 1]) for leg in posed.geometry.legs]
        azimuth, elevation = min(towers) + math.radians(45), math.radians(14)
    else:
        azimuth, elevation = math.radians(52), math.radians(30)
    ca, sa, ce, se = (
        math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation),
    )  # fmt: skip
    right, up = np.array([-sa, ca, 0.0]), np.array([-ca * se, -sa * se, ce])
    toward_eye = np.array([ca * ce, sa * ce, se])
    flat = np.stack([points @ right, -(points @ up)], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.array([WIDTH, HEIGHT]) - 2 * _MARGIN
    scale = float(np.min(room / (high - low)))
    shift = np.array([WIDTH, HEIGHT]) / 2 - scale * (low + high) / 2
    return Projection(right, up, toward_eye, scale, (float(shift[0]), float(shift[1])))


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
    ends = [end for leg in range(3) for end in posed.rail(leg)]
    points = np.array([*ends, *posed.lines.reshape(-1, 3), posed.p])
    project = projection(posed, points)
    bodies = sorted(_bodies(posed, project), key=lambda body: body[0])
    paper = _paper_with_machine(posed, dials, project)
    names = "".join(
        lettering(*at, name, "ink", 3) for name, at in _placed_leg_names(posed, project)
    )
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


def _bodies(posed: Posed, project: Projection) -> list[tuple[float, str]]:
    """Return all solids with their depths, which are larger if nearer."""
    size, bodies = posed.geometry.d, []
    for leg in range(3):
        axes = posed.geometry.legs[leg].axes
        start, end = posed.rail(leg)
        half = float(np.linalg.norm(end - start)) / 2
        bodies += _box((start + end) / 2, axes, (half, 0.12 * size, 0.16 * size), "rail", project)
        centre = posed.carriage(leg) + 0.2 * size * axes[:, 1]
        bodies += _box(centre, axes, (0.34 * size, 0.2 * size, 0.42 * size), "body", project)
        for bar in range(2):
            a, b = posed.lines[leg, bar]
            bodies.append((float(project.near @ (a + b)) / 2, line(a, b, project, "bar", 4.0)))
        for k in range(2):
            a, b = posed.lines[leg, :, k]
            bodies.append((float(project.near @ a) + 0.01, line(a, b, project, "bar", 3.0)))
    corners = np.array([posed.platform(leg) for leg in range(3)])
    middle = corners.mean(axis=0)
    depth = float(project.near @ middle)
    bodies.append((depth - 0.02, polygon(corners, project, "body", 0.9)))
    bodies.append((depth, line(middle, posed.p, project, "ink", 3.0)))
    x, y = project(posed.p)
    bodies.append(
        (depth + 0.02, f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="var(--m-ink)"/>')
    )
    return bodies


def _box(
    centre: Array, axes: Array, half: tuple[float, ...], colour: str, project: Projection
) -> list[tuple[float, str]]:
    """Return the three visible faces of a box, as one body."""
    faces = []
    for k in range(3):
        side = 1.0 if axes[:, k] @ project.near > 0 else -1.0
        u, v = (axes[:, j] * half[j] for j in range(3) if j != k)
        middle = centre + side * half[k] * axes[:, k]
        corners = np.array([middle + u + v, middle + u - v, middle - u - v, middle - u + v])
        light = 0.55 + 0.45 * abs(float(axes[2, k]))
        faces.append(polygon(corners, project, colour, light))
    return [(float(project.near @ centre), "".join(faces))]


def polygon(corners: Array, project: Projection, colour: str, opacity: float = 1.0) -> str:
    """Return a filled polygon; a smaller opacity makes it lighter."""
    coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(project, corners))
    return (
        f'<polygon points="{coordinates}" fill="var(--m-paper)"/><polygon points="{coordinates}" '
        f'fill="var(--m-{colour})" fill-opacity="{opacity:.2f}" stroke="var(--m-bar)" '
        f'stroke-width=".7" stroke-linejoin="round"/>'
    )


def line(a: Array, b: Array, project: Projection, colour: str, width: float) -> str:
    """Return a thick line from a to b ``(3,)``."""
    (x1, y1), (x2, y2) = project(a), project(b)
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


def _placed_leg_names(posed: Posed, project: Projection) -> list[tuple[str, tuple[float, float]]]:
    """Return the names of the legs with the middle of their base lines, beyond their rails."""
    placed = []
    for leg, name in enumerate(posed.geometry.leg_names):
        start, end = posed.rail(leg)
        x, y = project(end + 0.12 * (end - start))
        placed.append((name, (x, y + 4)))
    return placed


def _paper_with_machine(posed: Posed, dials: Sequence[Dial], project: Projection) -> Paper:
    """Return the paper with names, dials, rails and bars noted as occupied."""
    paper = Paper(project, 1 / project.scale)
    paper.occupied += [text_box(*at, name) for name, at in _placed_leg_names(posed, project)]
    for dial in dials:
        paper.occupied.append(circle_box(*project(dial.face(paper.unit)), _DIAL_RADIUS))
        paper.add_line([dial.face(paper.unit), dial.tip(paper.unit)])
    for leg in range(3):
        paper.add_line(posed.rail(leg))
        for ends in posed.lines[leg]:
            paper.add_line(ends)
    return paper
