"""Where a plate lies at two visits: what the height and slopes that each fit leaves free say.

Touches ``h = z - r``, z the height of the tool by one and the same machine and r the reading, have
at both visits the plane ``h = c + s (x - m)``, m the middle of all touches. The difference of two
planes is a plate that was moved, an instrument set anew, or a machine that moves the tool alike.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array, plane_columns
from orthoglide.numerals import plain

_SIGMAS = 3.0
_LEAST = 1e-4
"""A difference below is not worth a sentence on a machine of a workshop's size, metres: paper is as
thick."""

_FEWEST = 4  # touches, of which a plane leaves one


@dataclass(frozen=True)
class PlateMove:
    """A plate that lies elsewhere than at the visit before, at equal commands."""

    setup: str  # that touched it
    higher: float  # by how much its middle is, metres
    rise: float  # by how much more its rim is, where it is most, metres
    toward: float  # where that is, degrees from x toward y
    sigma: tuple[float, float]  # of both, from the noise of the touches, metres
    least: float = _LEAST  # that is worth a sentence, metres

    @property
    def is_higher(self) -> bool:
        """Whether its height differs beyond its uncertainty, by what matters."""
        return self._tells(self.higher, self.sigma[0])

    @property
    def leans(self) -> bool:
        """Whether its slopes differ significantly."""
        return self._tells(self.rise, self.sigma[1])

    def _tells(self, size: float, sigma: float) -> bool:
        return abs(size) > max(self.least, _SIGMAS * sigma)

    @property
    def words(self) -> str:
        """Clause with direction and size of the move, without a cause."""
        said = []
        if self.is_higher:
            size = plain(abs(self.higher) * 1e3, 2)
            said.append(f"lies {size} mm {'higher' if self.higher > 0 else 'lower'} than before")
        if self.leans:
            size, where = plain(self.rise * 1e3, 2), f"{self.toward:.0f} degrees"
            said.append(
                f"is tilted against before: its rim rises by {size} mm toward {where} (x is 0, "
                f"y is 90)"
            )
        return f"at equal commands the plate of {self.setup} {' and '.join(said)}"


def plate_moves(
    problem: Problem, x: Array, before: Collection[str], after: Collection[str]
) -> tuple[PlateMove, ...]:
    """Plates of one name that lie elsewhere than before.

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
    least = _LEAST * problem.machine.geometry.scale
    found = (_move(setup, old[setup], new[setup], least) for setup in old if setup in new)
    return tuple(move for move in found if move.is_higher or move.leans)


def _touches(
    problem: Problem, values: dict[str, float], names: Collection[str]
) -> Iterator[tuple[str, Array]]:
    """Setups, and place, height and noise of the touches of each ``(m, 4)``, metres."""
    for factor in problem.tool:
        if factor.name not in names:
            continue
        place = problem.machine.forward(factor.readings.command)
        height = factor.predict(problem.machine.model, values) - factor.measured
        for k, setup in enumerate(factor.readings.setups):
            rows = (factor.setup == k) & factor.noise.weighted
            if setup.observation.touches and rows.sum() >= _FEWEST:
                yield setup.name, np.column_stack([place[:, :2], height, factor.sigma])[rows]


def _move(setup: str, old: Array, new: Array, least: float) -> PlateMove:
    """Return the move between touches ``(m, 4)`` of two visits; ``least`` is reported, metres."""
    places = np.concatenate([old, new])[:, :2]
    middle = places.mean(axis=0)
    radius = float(np.hypot(*(places - middle).T).max())
    (one, spread), (other, more) = (_plane(touches, middle, radius) for touches in (old, new))
    apart, covariance = other - one, spread + more
    rise = float(np.hypot(*apart[1:]))
    along = apart[1:] / max(rise, 1e-12)
    sigma = float(np.sqrt(along @ covariance[1:, 1:] @ along))
    toward = float(np.degrees(np.arctan2(along[1], along[0]))) % 360
    both = float(np.sqrt(covariance[0, 0])), sigma
    return PlateMove(setup, float(apart[0]), rise, toward, both, least)


def _plane(touches: Array, middle: Array, radius: float) -> tuple[Array, Array]:
    """Height in the middle and rise to the rim along x and y ``(3,)``, and their covariance."""
    place, height, sigma = (touches[:, :2] - middle) / radius, touches[:, 2], touches[:, 3]
    columns = plane_columns(place) / sigma[:, None]
    spread = np.linalg.pinv(columns.T @ columns)
    return np.asarray(spread @ columns.T @ (height / sigma)), np.asarray(spread)
