"""What is wrong as a drawing shows it: the part in colour, an arrow, the size beside it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from html import escape

import numpy as np

from orthoglide.geometry import Array
from orthoglide.scene.parts import Dial, Mark, Posed

Project = Callable[[Array], tuple[float, float]]

_LENGTH = 0.075  # metres of an arrow
_BOW = 0.055  # metres to which the largest error of a path is drawn
_WIDE = 440.0
_LETTER = 7.6  # width of one, on the average


def marked(mark: Mark, posed: Posed, dials: Sequence[Dial], project: Project) -> str:
    """One mark as SVG."""
    draw = {
        "drive": _drive, "rail": _rail, "carriage": _turn, "bar": _bar, "link": _link,
        "platform": _end, "plate": _plate,
    }  # fmt: skip
    if mark.part == "dial":
        return "".join(_dialled(mark, d, project) for d in dials if d.name == mark.setup)
    return draw[mark.part](mark, posed, project)


def arrow(a: Array, b: Array, project: Project, colour: str, width: float = 2.6) -> str:
    """An arrow from a to b ``(3,)``."""
    (x1, y1), (x2, y2) = project(a), project(b)
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


def _pointing(at: Array, mark: Mark, project: Project, length: float = _LENGTH) -> str:
    back = -length * mark.way if mark.both else 0.0
    one = arrow(at, at + length * mark.way, project, "mark")
    return one + (arrow(at, at + back, project, "mark") if mark.both else "")


def _label(at: Array, text: str, project: Project, tail: Array | None = None) -> str:
    """Words beside a point, kept on the paper; beyond it where an arrow from a tail ends there."""
    if not text:
        return ""
    x, y = project(at)
    down = tail is not None and y > project(tail)[1] + 2
    half = _LETTER * len(text) / 2
    x = min(max(x, half + 3), _WIDE - half - 3)
    return (
        f'<text x="{x:.1f}" y="{y + (16 if down else -6):.1f}" text-anchor="middle" '
        f'font-weight="600" '
        f'fill="var(--m-mark)" stroke="var(--m-paper)" stroke-width="3.5" '
        f'paint-order="stroke">{escape(text)}</text>'
    )


def _stroke(points: Sequence[Array], project: Project, width: float, dash: str = "") -> str:
    at = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(project, points))
    return (
        f'<polyline points="{at}" fill="none" stroke="var(--m-mark)" stroke-width="{width:g}" '
        f'stroke-linecap="round" stroke-linejoin="round"{dash}/>'
    )


def _drive(mark: Mark, posed: Posed, project: Project) -> str:
    at = posed.carriage(mark.leg)
    low, high = posed.geometry.stroke
    along = [posed.path(mark.leg, low), posed.path(mark.leg, high)]
    start = at + 0.5 * posed.geometry.d * mark.way
    return (
        _stroke(along, project, 2.0, ' stroke-dasharray="2 5"')
        + _stroke([at, at], project, 11.0)
        + _pointing(start, mark, project)
        + _label(start + 1.1 * _LENGTH * mark.way, mark.label, project, start)
    )


def _rail(mark: Mark, posed: Posed, project: Project) -> str:
    curve = np.array([[mark.at, 1.0]]) if mark.curve is None else mark.curve
    straight = [posed.path(mark.leg, float(s)) for s in curve[:, 0]]
    wrong = [p + _BOW * float(v) * mark.way for p, v in zip(straight, curve[:, 1], strict=True)]
    at = posed.path(mark.leg, mark.at)
    tip = at + _BOW * mark.way
    ends = posed.rail(mark.leg)
    return (
        _stroke(ends, project, 5.0)
        + _stroke(straight, project, 1.2, ' stroke-dasharray="3 4"')
        + _stroke(wrong, project, 2.2)
        + arrow(at, tip, project, "mark")
        + (arrow(at, at - _BOW * mark.way, project, "mark") if mark.both else "")
        + _label(tip, mark.label, project, at)
    )


def _turn(mark: Mark, posed: Posed, project: Project) -> str:
    """Part of a circle about the way, right-handed, around the carriage."""
    at, d = posed.carriage(mark.leg), posed.geometry.d
    other = np.eye(3)[int(np.argmin(np.abs(mark.way)))]
    u = np.cross(mark.way, other)
    u /= np.linalg.norm(u)
    v = np.cross(mark.way, u)
    turn = np.radians(np.linspace(-150, 100, 26))
    points = [at + 0.62 * d * (math.cos(t) * u + math.sin(t) * v) for t in turn]
    axis = [at - 0.9 * d * mark.way, at + 0.9 * d * mark.way]
    return (
        _stroke([at, at], project, 11.0)
        + _stroke(axis, project, 1.2, ' stroke-dasharray="5 3"')
        + _stroke(points[:-2], project, 2.6)
        + arrow(points[-3], points[-1], project, "mark")
        + _label(at + 0.95 * d * mark.way, mark.label, project)
    )


def _bar(mark: Mark, posed: Posed, project: Project) -> str:
    bars = [mark.bar - 1] if mark.bar else [0, 1]
    lines = [posed.lines[mark.leg, k] for k in bars]
    middle = np.mean([line.mean(axis=0) for line in lines], axis=0)
    found = [_stroke(list(line), project, 5.0) for line in lines]
    grows = float(mark.way @ (posed.carriage(mark.leg) - posed.platform(mark.leg))) > 0
    for a, b in lines:
        along = (a - b) / np.linalg.norm(a - b)
        for end, out in ((a, along), (b, -along)):
            near, far = end + 0.1 * _LENGTH * out, end + 0.7 * _LENGTH * out
            found.append(arrow(*((near, far) if grows else (far, near)), project, "mark"))
    return "".join(found) + _label(middle, mark.label, project)


def _link(mark: Mark, posed: Posed, project: Project) -> str:
    """The short link at the platform, wider or narrower along the way."""
    ends = posed.lines[mark.leg, :, 1]
    out = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
    grows, found = float(mark.way @ out) > 0, [_stroke(list(ends), project, 5.0)]
    for end, away in ((ends[0], out), (ends[1], -out)):
        tip = end + 0.6 * _LENGTH * away
        found.append(arrow(*((end, tip) if grows else (tip, end)), project, "mark"))
    top = ends[0] + 0.75 * _LENGTH * out
    return "".join(found) + _label(top, mark.label, project)


def _end(mark: Mark, posed: Posed, project: Project) -> str:
    """The leg's end at the platform."""
    at = posed.platform(mark.leg)
    tip = at + 1.1 * _LENGTH * mark.way
    return (
        _stroke(list(posed.lines[mark.leg, :, 1]), project, 5.0)
        + _pointing(at, mark, project)
        + _label(tip, mark.label, project, at)
    )


def _plate(mark: Mark, posed: Posed, project: Project) -> str:
    """A ring under the tool."""
    radius = 0.35 * posed.geometry.L
    turn = np.linspace(0, 2 * np.pi, 49)
    ring = [radius * np.array([math.cos(t), math.sin(t), 0.0]) for t in turn]
    return _stroke(ring, project, 3.0) + _label(ring[36], mark.label, project)


def _dialled(mark: Mark, dial: Dial, project: Project) -> str:
    x, y = project(dial.at - 0.035 * dial.way)
    here = dial.at + 0.0 * dial.way
    found = (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="none" stroke="var(--m-mark)" '
        f'stroke-width="3"/>'
    )
    if mark.way.any():
        found += arrow(here, here + _LENGTH * mark.way, project, "mark")
    return found + _label(here + 1.1 * _LENGTH * mark.way, mark.label, project, here)
