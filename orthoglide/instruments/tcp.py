"""One coordinate of the tool, by a tracker, a measuring machine or a dial held against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments.meant import wrong_frame
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
    counted,
    dot,
    place_of,
    vector,
)
from orthoglide.instruments.placing import frame_of
from orthoglide.numerals import plain

HELD_SD = 0.02
"""How well a dial that is held at the tool points along its direction, radians: a degree."""

_ASKEW = 3.0  # standard deviations from which it is said


class Coordinate(Observation):
    """Coordinates of the tool, in a frame that may be turned; of a dial that reads one of them the
    direction is known, and not exactly.
    """

    kind = "tcp"
    words = "a tracker at the tool"
    reads = "the tool along {}"
    fill = "reading_mm is the tool's coordinate along the direction"
    fitted = (
        "datum of each direction; any turn where a setup has two directions or "
        "more; the direction of a single one to a degree"
    )
    repeatability = 1e-5
    axes = (0, 1, 2)
    nuisances = 6

    def formula(self, row: Row, effects: Sequence[Effect]) -> Any:
        """Return the coordinate along the axis, past a datum an axis and a small turn."""
        p, along = place_of(row.pose, vector(row.mounting)), vector(row.mounting, 3)
        datum, turn = vector(row.nuisance), vector(row.nuisance, 3)
        turned = [
            p[0] + turn[1] * p[2] - turn[2] * p[1],
            p[1] + turn[2] * p[0] - turn[0] * p[2],
            p[2] + turn[0] * p[1] - turn[1] * p[0],
        ]
        return dot(along, turned) + dot(vector(row.mounting, 6), datum)

    def mountings(self, table: Table, rows: NDArray[np.intp], site: Site) -> Array:
        """Return the place beside the tool, the axis in the base, and which datum counts."""
        turns = np.array([stand.turn for stand in site.stands]).reshape(-1, 3, 3)
        axes = turns[table.setup[rows], table.axis[rows]]
        along = table.sign[rows, None] * axes
        return np.hstack([table.beside[rows], along, counted(table, rows)])

    def known(self, setup: Setup, axis: Ints, beliefs: Beliefs) -> Array:
        """Return what is known of a datum an axis and of three turns of the frame: nothing of a
        frame of two axes or more.
        """
        datum = 0.0 if beliefs.frame == "none" else np.inf
        return np.repeat([datum, self._turn_sd(axis) if beliefs.frame == "rigid" else 0.0], 3)

    def _turn_sd(self, axis: Ints) -> float:
        return HELD_SD if len(np.unique(axis)) < 2 else np.inf

    def stand(self, taken: Taken, near: Stand | None, beliefs: Beliefs) -> Stand:
        """Return the frame in which the coordinates were read; the base's before they are."""
        if beliefs.frame != "rigid" or taken.open:
            return Stand()
        start = None if near is None else near.turn
        sd = self._turn_sd(taken.axis)
        return Stand(turn=frame_of(taken.p, taken.axis, taken.value, taken.sigma, sd, start))

    def off_place(self, stand: Stand, nuisance: Array) -> tuple[Stand, Array]:
        """Return the frame turned, as its small turn is one to the first order only."""
        from scipy.spatial.transform import Rotation

        turn = stand.turn @ Rotation.from_rotvec(nuisance[3:]).as_matrix()
        return Stand(turn=turn), np.concatenate([nuisance[:3], np.zeros(3)])

    def remarks(self, stand: Stand, p: Array, axis: Ints) -> Iterator[tuple[str, str]]:
        """Yield that a dial points beside its direction by more than one is held askew."""
        if len(np.unique(axis)) > 1:
            return
        along = stand.turn[axis[0]]
        angle = float(np.arccos(np.clip(along[axis[0]], -1.0, 1.0)))
        if angle > _ASKEW * HELD_SD:
            yield (
                f"by its readings it points {np.rad2deg(angle):.1f} degrees beside "
                f"{LEGS[axis[0]]} (along {', '.join(plain(v, 3) for v in along)}), and is taken "
                "so: "
                f"look how it is held, and whether the direction in the file is right",
                "askew",
            )

    def doubts(self, taken: Taken, apart: Array, beliefs: Beliefs) -> str:
        """Return which other frame or unit the coordinates seem to have."""
        sd = self._turn_sd(taken.axis) if beliefs.frame == "rigid" else 0.0
        return wrong_frame(taken.p, taken.axis, taken.value, sd)
