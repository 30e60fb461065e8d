"""Where a plate lies at two visits: the difference of its height and slopes.

Touches ``h = z - r``, with the height z of the tool of one machine and the reading r, are fitted by
a plane at each visit. The difference of the planes may be that of the plate, of the instrument or
of the machine: these readings cannot tell which.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from orthoglide.explanation.change import SIGNIFICANT_SIGMAS
from orthoglide.fit import Problem
from orthoglide.geometry import Array, plane_columns
from orthoglide.observations.touched_plates import LEAST_MOVE, PlateMove

_FEWEST_TOUCHES = 4  # touches: one more than a plane has unknowns


def plate_moves(
    problem: Problem, x: Array, before: Collection[str], after: Collection[str]
) -> tuple[PlateMove, ...]:
    """Return the plates of one name that lie elsewhere than before.

    Args:
        problem: readings of both visits, by the tool alone.
        x: its unknowns ``(P,)``; the machine of the first visit is used for both.
        before: names of the campaigns of the first visit.
        after: names of the campaigns of the second visit.
    """
    if problem.campaigns:
        return ()
    first = next(k for k, factor in enumerate(problem.factors) if factor.name in before)
    values = problem.values(first, x)
    # The last campaign of a visit shows the state that it leaves.
    old, new = (dict(_touches(problem, values, names)) for names in (before, after))
    least = LEAST_MOVE * problem.machine.geometry.scale
    moves = (_move(name, old[name], new[name], least) for name in old if name in new)
    return tuple(move for move in moves if move.higher or move.rise)


def _touches(
    problem: Problem, values: dict[str, float], names: Collection[str]
) -> Iterator[tuple[str, Array]]:
    """Yield each setup with x, y, height and noise of its touches ``(m, 4)``, metres."""
    for _, factor, k, setup in problem.iter_tool_setups():
        rows = (factor.setup == k) & factor.noise.weighted
        enough = rows.sum() >= _FEWEST_TOUCHES
        if enough and setup.observation.touches and factor.name in names:
            place = problem.machine.forward(factor.readings.command)[:, :2]
            height = factor.predict(problem.machine.model, values) - factor.measured
            yield setup.name, np.column_stack([place, height, factor.sigma])[rows]


def _move(setup: str, old: Array, new: Array, least: float) -> PlateMove:
    """Return the move between touches ``(m, 4)`` of two visits, by a plane for both and another
    that is added at the later one.

    Height and slope are set to 0 unless larger than ``least``, metres, and than their uncertainty.
    """
    touches = np.concatenate([old, new])
    place = touches[:, :2] - touches[:, :2].mean(axis=0)
    columns = plane_columns(place / np.hypot(*place.T).max())
    later = np.arange(len(touches)) >= len(old)
    columns = np.hstack([columns, columns * later[:, None]]) / touches[:, 3:]
    covariance = np.linalg.pinv(columns.T @ columns)
    higher, *slope = (covariance @ columns.T @ (touches[:, 2] / touches[:, 3]))[3:]
    rise = float(np.hypot(*slope))
    along = np.array(slope) / max(rise, 1e-12)
    toward = float(np.degrees(np.arctan2(along[1], along[0]))) % 360

    def significant(size: float, variance: float) -> float:
        limit = max(least, SIGNIFICANT_SIGMAS * np.sqrt(variance))
        return float(size) if abs(size) > limit else 0.0

    higher = significant(higher, covariance[3, 3])
    rise = significant(rise, float(along @ covariance[4:, 4:] @ along))
    return PlateMove(setup, higher, rise, toward)
