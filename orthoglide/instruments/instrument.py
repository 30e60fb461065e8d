"""What an instrument at the tool owes: the reading to expect, its gradient, and its nuisances.

The pose is the tool's place p and the platform's rotation R; some instruments read between two
poses. A file beside this one declares each instrument, whole; `INSTRUMENTS` has them all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array

Nuisance = tuple[Array, float]
"""A column of the readings ``(n,)`` and the standard deviation of its factor about zero; infinite
where nothing is known."""

Varied = Literal["p", "R", "apart"]
"""What of a pose a reading follows: `Pose` has each."""


@dataclass(frozen=True)
class Pose:
    """Where readings are taken, row by row."""

    p: Array  # place of the tool, or beside or below it (n, 3), metres
    R: Array  # rotation of the platform (n, 3, 3)
    apart: Array  # from the place of the second command (n, 3), metres; nan where there is none

    def at(self, rows: NDArray[np.intp]) -> Pose:
        """Some of the rows."""
        return Pose(self.p[rows], self.R[rows], self.apart[rows])


@dataclass(frozen=True)
class Mounting:
    """How the instruments stand, row by row."""

    axis: NDArray[np.int64]  # base axis that is read (n,); 0 where the instrument has none
    sign: Array  # -1 where it counts against that axis, else +1 (n,)
    ball: Array  # centre of a fixed ball (n, 3), metres; 0 where there is none
    turn: Array  # axes of the instrument's frame, in the base (n, 3, 3)

    def at(self, rows: NDArray[np.intp]) -> Mounting:
        """Some of the rows."""
        return Mounting(self.axis[rows], self.sign[rows], self.ball[rows], self.turn[rows])

    @property
    def along(self) -> Array:
        """Direction in which it counts, in the base ``(n, 3)``."""
        own = self.turn[np.arange(len(self.axis)), self.axis]
        return np.asarray(self.sign[:, None] * own)


class Instrument(ABC):
    """One kind of instrument; ``n`` rows at a time, SI.

    Attributes:
        kind: what files call its readings, and the machine file its table.
        words: what takes the readings.
        reads: what is read; ``{}`` stands for the axis.
        fill: what to write on a sheet.
        fill_place: what to write where its rows say places, if that is another way.
        how: said behind ``words`` of readings that are proposed to tell causes apart; empty where
            none are.
        repeatability: standard deviation of one reading where nothing is known.
        slip: how far off a reading must be to be called a slip, where more than two are; more than
            a bed's bumps, a part's pillars or a rail that rolls its carriage in waves move it. A
            length is that of a machine of a workshop's size.
        slip_alone: the same of one reading or two.
        angular: whether it reads radians; metres otherwise.
        axes: base axes along or about which it reads; none where it has no direction.
        touches: whether it touches a plate.
        paired: whether it reads between two commands.
        about_ball: whether it reads about a fixed ball.
    """

    kind: ClassVar[str]
    words: ClassVar[str]
    reads: ClassVar[str]
    fill: ClassVar[str]
    fill_place: ClassVar[str] = ""
    how: ClassVar[str] = ""
    repeatability: ClassVar[float]
    slip: ClassVar[float] = 1e-3
    slip_alone: ClassVar[float] = 1e-3
    angular: ClassVar[bool] = False
    axes: ClassVar[tuple[int, ...]] = ()
    touches: ClassVar[bool] = False
    paired: ClassVar[bool] = False
    about_ball: ClassVar[bool] = False

    @property
    def unit(self) -> str:
        """In which files and people give its readings."""
        return "mrad" if self.angular else "mm"

    @abstractmethod
    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """Readings ``(n,)`` of an instrument in its place."""

    @abstractmethod
    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """Derivative of `value` by the pose, of the shape of what it follows."""

    @abstractmethod
    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """What one setup's readings contain besides the machine.

        Args:
            p: where they are taken ``(n, 3)``.
            value: the readings there ``(n,)``.
            mounting: of the instrument.
        """

    def turn_sd(self, axis: NDArray[np.int64]) -> float:
        """How well the frame of a setup that reads some axes is known to be the base's, radians:
        0 where it has none, infinite where nothing is known.
        """
        return 0.0

    def displaced(
        self, p: Array, mounting: Mounting, draw: np.random.Generator, sd: float
    ) -> Array | None:
        """Readings ``(n,)`` of one setup by an instrument that stands about ``sd`` off its place;
        ``None`` where its nuisances say all of it.
        """
        return None

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """Places of a measuring sheet ``(k, 3)``, and the second ones where it reads between two.

        Args:
            ring: places on a circle of radius 1 about z ``(m, 3)``.
        """
        return np.concatenate([ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]]), None


def unit_vectors(vectors: Array) -> Array:
    """Vectors ``(n, 3)`` of length 1; of length 0 as they are."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-9)[:, None])


def datums(mounting: Mounting) -> list[Nuisance]:
    """A datum for each axis."""
    return [(mounting.sign * (mounting.axis == j), np.inf) for j in range(3)]
