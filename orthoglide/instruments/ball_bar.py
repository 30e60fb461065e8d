"""A ball bar: the distance of the tool from a fixed ball."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.meant import wrong_bar
from orthoglide.instruments.observation import (
    Beliefs,
    Ints,
    Observation,
    Row,
    Setup,
    Site,
    Stand,
    Table,
    Taken,
    add,
    length,
    place_of,
    vector,
)
from orthoglide.instruments.placing import centre_of, plane_of
from orthoglide.numerals import compact

CENTRE_SD = 1e-2
"""How far the ball may be from where its readings about one machine have it, metres: as far as a
machine that its owner can run is from another. Across the plane of a circle the readings do not
say, and everywhere else they know it far better."""

_BESIDE = 0.1  # of the extent of its places, how far a ball is from their plane


class BallBar(Observation):
    """Lengths, or deviations of them, about a ball that stands somewhere near its place."""

    kind = "ballbar"
    words = "a ball bar"
    reads = "the ball bar"
    fill = "reading_mm is the bar's length, or how much longer it is than at some place"
    fitted = "centre and length"
    repeatability = 5e-6
    about_ball = True
    nuisances = 4

    def formula(self, row: Row, effects: Sequence[Effect]) -> Any:
        """Return the length from the ball, past the bar's own."""
        p, ball = place_of(row.pose, vector(row.mounting)), vector(row.mounting, 3)
        away = add((1, p), (-1, ball), (-1, vector(row.nuisance)))
        return length(away) + row.nuisance[3]

    def mountings(self, table: Table, rows: NDArray[np.intp], site: Site) -> Array:
        """Return where the place is beside the tool, and the ball."""
        balls = np.array([stand.ball for stand in site.stands]).reshape(-1, 3)
        return np.hstack([table.beside[rows], balls[table.setup[rows]]])

    def known(self, setup: Setup, axis: Ints, beliefs: Beliefs) -> Array:
        """Return what is known of the ball's centre, and that nothing is of the bar's length."""
        return np.array([CENTRE_SD, CENTRE_SD, CENTRE_SD, np.inf])

    def stand(self, taken: Taken, near: Stand | None, beliefs: Beliefs) -> Stand:
        """Return where the readings have the ball; in the middle of their places before they are
        taken.
        """
        about = None if near is None else near.ball
        return Stand(ball=centre_of(taken.p, np.nan_to_num(taken.value), about))

    def remarks(self, stand: Stand, p: Array, axis: Ints) -> Iterator[tuple[str, str]]:
        """Yield that the ball stands beside the one plane of all places, on a side that is not
        known.
        """
        if (across := plane_of(p)) is None:
            return
        size = float(np.sqrt(np.mean((p - p.mean(axis=0)) ** 2)))
        beside = float(abs((stand.ball - p.mean(axis=0)) @ across))
        if beside > _BESIDE * size:
            yield (
                f"its places lie in one plane, and the ball {compact(beside * 1e3, 2)} mm beside "
                f"it; on which side no reading says, below was taken: on the other one, what is "
                f"told of the machine across that plane has the other sign; read places out of it "
                f"as well",
                "mirrored",
            )

    def doubts(self, taken: Taken, apart: Array, beliefs: Beliefs) -> str:
        """Return which other unit the lengths seem to have."""
        return wrong_bar(taken.p, taken.value)
