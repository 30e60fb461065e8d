"""A machine as inline SVG, drawn from far to near, with its errors marked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from orthoglide.geometry import Array
from orthoglide.ordering import largest
from orthoglide.scene.parts import (
    HEIGHT,
    WIDTH,
    Dial,
    Mark,
    Option,
    Paper,
    Posed,
    circle_box,
    lettering,
    text_box,
)

_ARROW_LENGTH = 46.0  # length of an arrow on the paper
_MAX_BOW = 34.0  # length on the paper of the largest error of a path
_LABEL_DISTANCE = 1.1  # distance of a label over the length of its arrow


def mark_svg(mark: Mark, posed: Posed, dials: Sequence[Dial], paper: Paper) -> str:
    """Return one mark as SVG."""
    draw = {
        "drive": _drive, "rail": _rail, "carriage": _turn, "bar": _bar, "link": _link,
        "platform": _platform_end, "plate": _plate,
    }  # fmt: skip
    if mark.part == "dial":
        return "".join(_dial_mark(mark, d, paper) for d in dials if mark.setup in ("", d.name))
    return draw[mark.part](mark, posed, paper)


def arrow(a: Array, b: Array, paper: Paper, colour: str, width: float = 2.6) -> str:
    """Return an arrow from a to b ``(3,)``."""
    (x1, y1), (x2, y2) = paper.project(a), paper.project(b)
    length = math.hypot(x2 - x1, y2 - y1)
    if length < 1e-6:
        return ""
    ux, uy, size = (x2 - x1) / length, (y2 - y1) / length, 2.2 * width + 2.5
    bx, by = x2 - size * ux, y2 - size * uy
    head = (
        f"{x2:.1f},{y2:.1f} {bx - 0.5 * size * uy:.1f},{by + 0.5 * size * ux:.1f} "
        f"{bx + 0.5 * size * uy:.1f},{by - 0.5 * size * ux:.1f}"
    )
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{bx:.1f}" y2="{by:.1f}" '
        f'stroke="var(--m-{colour})" stroke-width="{width:g}"/>'
        f'<polygon points="{head}" fill="var(--m-{colour})"/>'
    )


def _labelled_arrow(at: Array, mark: Mark, paper: Paper, length: float = _ARROW_LENGTH) -> str:
    """Return an arrow from a point along the mark's direction, with its label at the end; one
    against it as well if the mark has both.
    """
    direction = length * paper.unit * mark.way
    drawn = arrow(at, at + direction, paper, "mark")
    drawn += arrow(at, at - direction, paper, "mark") if mark.both else ""
    return drawn + paper.place_text(at + _LABEL_DISTANCE * direction, mark.label, at)


def _stroke(points: Sequence[Array], paper: Paper, width: float, dash: str = "") -> str:
    coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(paper.project, points))
    paper.add_line(points)
    return (
        f'<polyline points="{coordinates}" fill="none" stroke="var(--m-mark)" '
        f'stroke-width="{width:g}" stroke-linecap="round" stroke-linejoin="round"{dash}/>'
    )


def _drive(mark: Mark, posed: Posed, paper: Paper) -> str:
    at = posed.carriage(mark.leg)
    low, high = posed.geometry.stroke
    along = [posed.path(mark.leg, low), posed.path(mark.leg, high)]
    return (
        _stroke(along, paper, 2.0, ' stroke-dasharray="2 5"')
        + _stroke([at, at], paper, 11.0)
        + _labelled_arrow(at + 0.5 * posed.geometry.d * mark.way, mark, paper)
    )


def _rail(mark: Mark, posed: Posed, paper: Paper) -> str:
    curve = np.array([[mark.at, 1.0]]) if mark.curve is None else mark.curve
    straight = [posed.path(mark.leg, float(s)) for s in curve[:, 0]]
    shift = _MAX_BOW * paper.unit * mark.way
    actual = [p + float(v) * shift for p, v in zip(straight, curve[:, 1], strict=True)]
    at = posed.path(mark.leg, mark.at)
    return (
        _stroke(posed.rail(mark.leg), paper, 5.0)
        + _stroke(straight, paper, 1.2, ' stroke-dasharray="3 4"')
        + _stroke(actual, paper, 2.2)
        + _labelled_arrow(at, mark, paper, _MAX_BOW)
    )


def _turn(mark: Mark, posed: Posed, paper: Paper) -> str:
    """Return part of a circle about the direction, right-handed, around the carriage."""
    at, d = posed.carriage(mark.leg), posed.geometry.d
    other = np.eye(3)[largest(-np.abs(mark.way))]
    u = np.cross(mark.way, other)
    u /= np.linalg.norm(u)
    v = np.cross(mark.way, u)
    turn = np.radians(np.linspace(-150, 100, 26))
    points = [at + 0.62 * d * (math.cos(t) * u + math.sin(t) * v) for t in turn]
    axis = [at - 0.9 * d * mark.way, at + 0.9 * d * mark.way]
    return (
        _stroke([at, at], paper, 11.0)
        + _stroke(axis, paper, 1.2, ' stroke-dasharray="5 3"')
        + _stroke(points[:-2], paper, 2.6)
        + arrow(points[-3], points[-1], paper, "mark")
        + paper.place_text(at + 0.95 * d * mark.way, mark.label)
    )


def _bar(mark: Mark, posed: Posed, paper: Paper) -> str:
    lines = posed.lines[mark.leg, [mark.bar - 1] if mark.bar else [0, 1]]
    longer = float(mark.way @ (posed.carriage(mark.leg) - posed.platform(mark.leg))) > 0
    drawn = _stretched(lines, longer, paper)
    return drawn + paper.place_text(lines.mean(axis=(0, 1)), mark.label)


def _link(mark: Mark, posed: Posed, paper: Paper) -> str:
    """Return the short link at the platform, wider or narrower along the direction."""
    first, second = ends = posed.lines[mark.leg, :, 1]
    outward = _ARROW_LENGTH * paper.unit * (first - second) / np.linalg.norm(first - second)
    drawn = _stretched(ends[None], float(mark.way @ outward) > 0, paper)
    return drawn + paper.place_text(first + 0.75 * outward, mark.label)


def _stretched(lines: Array, longer: bool, paper: Paper) -> str:
    """Return lines ``(n, 2, 3)`` with arrows at both ends, apart if they are longer."""
    drawn = [_stroke(list(line), paper, 5.0) for line in lines]
    for a, b in lines:
        along = _ARROW_LENGTH * paper.unit * (a - b) / np.linalg.norm(a - b)
        for end, outward in ((a, along), (b, -along)):
            near, far = end + 0.1 * outward, end + 0.7 * outward
            drawn.append(arrow(*((near, far) if longer else (far, near)), paper, "mark"))
    return "".join(drawn)


def _platform_end(mark: Mark, posed: Posed, paper: Paper) -> str:
    """Return the leg's end at the platform."""
    ends = _stroke(list(posed.lines[mark.leg, :, 1]), paper, 5.0)
    return ends + _labelled_arrow(posed.platform(mark.leg), mark, paper)


def _plate(mark: Mark, posed: Posed, paper: Paper) -> str:
    """Return a ring under the tool."""
    radius = 0.35 * posed.geometry.L
    turn = np.linspace(0, 2 * np.pi, 49)
    ring = [radius * np.array([math.cos(t), math.sin(t), 0.0]) for t in turn]
    return _stroke(ring, paper, 3.0) + paper.place_text(ring[36], mark.label)


def _dial_mark(mark: Mark, dial: Dial, paper: Paper) -> str:
    x, y = paper.project(dial.face(paper.unit))
    drawn = (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="none" stroke="var(--m-mark)" '
        f'stroke-width="3"/>'
    )
    return drawn + _labelled_arrow(dial.at, mark, paper)


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
    """Return the machine in a posture as one inline ``<svg>``.

    Each option, a possible error, is a group of class ``option`` and ``option-k``. Options in
    ``first_shown`` have the class ``first`` too; only these are visible without a style sheet.
    Readers who cannot see the drawing get its title and the options; ``standalone``: whether it is
    a file.
    """
    paper = blank_paper(posed)
    bodies = sorted(_bodies(posed, paper), key=lambda body: body[0])
    names = ""
    for leg, name in enumerate(posed.geometry.leg_names):  # beyond its rail
        start, end = posed.rail(leg)
        x, y = paper.project(end + 0.12 * (end - start))
        names += lettering(x, y + 4, name, "ink", 3)
        paper.occupied.append(text_box(x, y + 4, name))
        for ends in ((start, end), *posed.lines[leg]):
            paper.add_line(ends)
    for dial in dials:
        face, tip = dial.face(paper.unit), dial.tip(paper.unit)
        paper.occupied.append(circle_box(*paper.project(face), _DIAL_RADIUS))
        paper.add_line([face, tip])
    groups = []
    for k, option in enumerate(options):
        # Labels of options that are visible together must not overlap.
        is_first = k in first_shown
        sheet = paper if is_first else paper.copy()
        drawn = "".join(mark_svg(mark, posed, dials, sheet) for mark in option.marks)
        attributes = ' first"' if is_first else '" style="display:none"'
        words = escape(option.words)
        groups.append(f'<g class="option option-{k}{attributes}><title>{words}</title>{drawn}</g>')
    legs = f"Three legs {', '.join(posed.geometry.leg_names)}, each a carriage on its rail and "
    legs += "two bars to the platform."
    description = posed.geometry.layout.names.in_layout_words(legs)
    if dials:
        description += f" Dials: {', '.join(dict.fromkeys(dial.name for dial in dials))}."
    if options:
        description += f" Marked: {'; or '.join(option.words for option in options)}."
    return (
        f'<svg class="machine" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'{_NAMESPACE if standalone else ""}style="{_STYLE}" font-size="13">'
        f"<title>{escape(title)}</title><desc>{escape(description)}</desc>"
        f"{''.join(text for _, text in bodies)}"
        f'<g class="dials">{"".join(_dial(dial, paper) for dial in dials)}</g>'
        f"{''.join(groups)}{names}</svg>"
    )


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
