"""An instrument's own frame brought near the machine's by a rigid motion; the centre of a ball.

What is left of the turn is small and is fitted. Points with missing coordinates cannot be turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array, moved_onto
from orthoglide.observations import TcpPoints, ToolCampaign
from orthoglide.observations.arrays import numbered

_FEWEST = 4  # points
_SMALL = 1e-3  # radians: the square of a smaller turn moves no more than parts of a micrometre
_CENTRE_STEPS, _SETTLED = 50, 1e-13  # at most; metres
_PLANE = 1e-2  # of its extent, by which a circle may leave its plane
_HELD = 5e-3  # weight of a ball's place against a reading: a noise of 5 um in a millimetre


def turned_to(points: TcpPoints, p: Array) -> TcpPoints:
    """Points in a frame turned by any angle; as they are where any coordinate is missing.

    Args:
        points: measured.
        p: about where the machine has them ``(n, 3)``, metres.
    """
    if len(points) < _FEWEST or not np.isfinite(points.p).all():
        return points
    return replace(points, p=moved_onto(points.p, points.p, p))


def turned_back(
    points: ToolCampaign, value: Array, known: NDArray[np.bool_] | None = None
) -> ToolCampaign:
    """The same of the setups of a file that have all three coordinates of every point.

    Args:
        points: readings of the tool.
        value: about what the machine has for them ``(n,)``, metres.
        known: which have any weight ``(n,)``; all where absent.
    """
    reading, changed = points.reading.copy(), False
    for k in range(len(points.setups)):
        rows = whole_points(points, k)
        if rows is None:
            continue
        whole = np.ones(len(rows), dtype=bool) if known is None else known[rows].all(axis=1)
        measured, p = ((points.sign * read)[rows] for read in (points.reading, value))
        near = turned_near(measured, p, np.asarray(whole))
        if near is not None:
            reading[rows], changed = points.sign[rows] * near, True
    return replace(points, reading=reading) if changed else points


def turned_near(measured: Array, p: Array, known: NDArray[np.bool_]) -> Array | None:
    """Points ``(m, 3)`` moved near others, by those that are known ``(m,)``; ``None`` where no turn
    worth mention brings them.
    """
    near = moved_onto(measured, measured[known], p[known])
    centred = measured - measured.mean(axis=0)
    turned = np.linalg.norm(near - near.mean(axis=0) - centred)
    return near if turned > _SMALL * np.linalg.norm(centred) else None


def whole_points(points: ToolCampaign, setup: int) -> NDArray[np.intp] | None:
    """Rows of x, y and z of every point of a setup ``(m, 3)``; ``None`` where one is missing, or
    it has no coordinates.
    """
    instrument = points.setups[setup].instrument
    if instrument.angular or not instrument.axes:
        return None
    rows = np.flatnonzero(points.setup == setup)
    if len(rows) < 3 * _FEWEST:
        return None
    known = np.column_stack([points.command, points.approach, points.repeat, points.load])[rows]
    point = numbered(known)
    # A point that was visited twice has its first x with its first y and its first z.
    coordinates = [rows[points.axis[rows] == j] for j in range(3)]
    places = [point[points.axis[rows] == j] for j in range(3)]
    order = [np.argsort(own, kind="stable") for own in places]
    first, *others = (own[k] for own, k in zip(places, order, strict=True))
    if any(not np.array_equal(first, other) for other in others):
        return None
    return np.stack([own[k] for own, k in zip(coordinates, order, strict=True)], axis=1)


def centre_of(p: Array, distance: Array, near: Array | None = None) -> Array:
    """Centre of the sphere on which points ``(n, 3)`` lie at about these distances ``(n,)``.

    Across a circle's plane its centre could be anywhere: there it stays near a place ``(3,)`` that
    goes with the middle of the points, or near the plane.
    """
    if near is None:
        middle = p.mean(axis=0)
        size = max(float(np.sqrt(np.mean((p - middle) ** 2))), 1e-9)
        q = (p - middle) / size
        right = np.sum(q * q, axis=1) - (distance / size) ** 2
        columns = np.column_stack([2 * q, np.ones(len(q))])
        near = middle + size * np.linalg.lstsq(columns, right, rcond=_PLANE)[0][:3]
    centre, longer = near, 0.0
    held = _HELD * np.eye(3, 4)
    for _ in range(_CENTRE_STEPS):
        toward = p - centre
        length = np.maximum(np.linalg.norm(toward, axis=1), 1e-9)
        slopes = np.column_stack([-toward / length[:, None], np.ones(len(p))])
        rest = np.concatenate([distance - length - longer, _HELD * (near - centre)])
        step = np.linalg.lstsq(np.vstack([slopes, held]), rest, rcond=1e-9)[0]
        centre, longer = centre + step[:3], longer + float(step[3])
        if np.abs(step).max() < _SETTLED:
            break
    return np.asarray(centre)


def centre_moves(p: Array, distance: Array, centre: Array, moved: Array) -> Array:
    """How far that centre goes ``(3, P)`` as its points move by ``(n, 3, P)``, by what is implied
    where squares are least.
    """
    away = p - centre
    length = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    u = away / length[:, None]
    rest = distance - length
    share = (rest - rest.mean()) / length
    bent = share[:, None, None] * (np.eye(3) - u[:, :, None] * u[:, None])
    along = np.einsum("ni,nip->np", u, moved)
    square = u.T @ u - bent.sum(axis=0) + _HELD**2 * np.eye(3)
    matrix = np.block([[square, -u.sum(axis=0)[:, None]], [u.sum(axis=0), -float(len(p))]])
    held = u.T @ along - np.einsum("nij,njp->ip", bent, moved) + _HELD**2 * moved.mean(axis=0)
    right = np.vstack([held, along.sum(axis=0)])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0][:3])
