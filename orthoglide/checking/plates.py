"""Where a plate lies at two visits: what the height and slopes that each fit leaves free say.

Touches ``h = z - r``, z the height of the tool by one and the same machine and r the reading, have
at both visits a plane. The difference of the planes is a plate that was moved, an instrument set
anew, or a machine that moves the tool alike: these readings cannot tell which.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from orthoglide.fit import Problem
from orthoglide.geometry import Array, plane_columns
from orthoglide.numerals import plain

_SIGNIFICANT_SIGMAS = 3.0
_LEAST_MOVE = 1e-4
"""A difference below is not worth a sentence on a machine of a workshop's size, metres: paper is as
thick."""

_FEWEST_TOUCHES = 4  # touches, of which a plane leaves one


@dataclass(frozen=True)
class PlateMove:
    """A plate that lies elsewhere than at the visit before, at equal commands."""

    setup: str  # that touched it
    higher: float  # by how much its middle is, metres; 0 where that is not significant
    rise: float  # by how much more its rim is, where it is most, metres; 0 likewise
    toward: float  # where that is, degrees from x toward y

    @property
    def words(self) -> str:
        """Clause with direction and size of the move, without a cause."""
        said = []
        if self.higher:
            size = plain(abs(self.higher) * 1e3, 2)
            said.append(f"lies {size} mm {'higher' if self.higher > 0 else 'lower'} than before")
        if self.rise:
            size, where = plain(self.rise * 1e3, 2), f"{self.toward:.0f} degrees"
            said.append(
                f"is tilted against before: its rim rises by {size} mm toward {where} (x is 0, "
                f"y is 90)"
            )
        return f"at equal commands the plate of {self.setup} {' and '.join(said)}"


def plate_moves(
    problem: Problem, x: Array, before: Collection[str], after: Collection[str]
) -> tuple[PlateMove, ...]:
    """Return the plates of one name that lie elsewhere than before.

    Args:
        problem: of both visits, read by the tool alone.
        x: its unknowns ``(P,)``, of which the machine of the first visit is taken for both.
        before: names of the campaigns of the first visit.
        after: of the second.
    """
    if problem.campaigns:
        return ()
    first = next(k for k, factor in enumerate(problem.factors) if factor.name in before)
    values = problem.values(first, x)
    # The last of a visit is the state that it leaves.
    old, new = (dict(_touches(problem, values, names)) for names in (before, after))
    least = _LEAST_MOVE * problem.machine.geometry.scale
    found = (_move(name, old[name], new[name], least) for name in old if name in new)
    return tuple(move for move in found if move.higher or move.rise)


def _touches(
    problem: Problem, values: dict[str, float], names: Collection[str]
) -> Iterator[tuple[str, Array]]:
    """Yield setups, and place, height and noise of the touches of each ``(m, 4)``, metres."""
    for factor in problem.tool_factors:
        if factor.name not in names:
            continue
        place = problem.machine.forward(factor.readings.command)
        height = factor.predict(problem.machine.model, values) - factor.measured
        for k, setup in enumerate(factor.readings.setups):
            rows = (factor.setup == k) & factor.noise.weighted
            if setup.observation.touches and rows.sum() >= _FEWEST_TOUCHES:
                yield setup.name, np.column_stack([place[:, :2], height, factor.sigma])[rows]


def _move(setup: str, old: Array, new: Array, least: float) -> PlateMove:
    """Fit touches ``(m, 4)`` of two visits by one plane and what the later ones have beside it.

    Only what is larger than ``least``, metres, and than its uncertainty is reported.
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
        return (
            float(size) if abs(size) > max(least, _SIGNIFICANT_SIGMAS * np.sqrt(variance)) else 0.0
        )

    higher = significant(higher, covariance[3, 3])
    rise = significant(rise, float(along @ covariance[4:, 4:] @ along))
    return PlateMove(setup, higher, rise, toward)
