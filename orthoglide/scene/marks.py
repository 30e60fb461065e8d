"""Marks of errors in a drawing: the part in colour, an arrow, and the size beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orthoglide.geometry import Array
from orthoglide.ordering import largest
from orthoglide.scene.paper import Paper
from orthoglide.scene.parts import Dial, Mark, Posed

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
