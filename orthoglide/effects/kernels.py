"""What a place may do by its variable: free functions, each of a coefficient of unit variance.

A Gaussian process in the first eigenfunctions of the Laplacian on an interval somewhat longer than
its variable's (Solin and Sarkka 2020, *Hilbert space methods for reduced-rank Gaussian process
regression*, eq. 17 and 56); or lost motion that builds up after a reversal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from orthoglide.effects.motions import exp, sin
from orthoglide.geometry import Array

_INTERVAL_RATIO = 1.25
"""Half the interval of the eigenfunctions over half the variable's: at its ends they are free."""


@dataclass(frozen=True)
class Kernel:
    """A Gaussian process of unit variance over [-1, 1]."""

    length: float  # correlation length, over half the variable's range
    waves: int  # number of eigenfunctions
    # share of the variance that has steps and corners, Ornstein-Uhlenbeck; the rest is smooth,
    # Matern 3/2
    rough: float = 0.0
    # whether a straight line is one more function, which eigenfunctions draw badly
    line: bool = False

    @property
    def count(self) -> int:
        """Number of functions."""
        return self.waves + self.line

    @cached_property
    def weights(self) -> Array:
        """Standard deviation of each eigenfunction's coefficient ``(waves,)``."""
        frequency = np.pi * np.arange(1, self.waves + 1) / (2 * _INTERVAL_RATIO)
        rate = np.sqrt(3) / self.length
        smooth = 4 * rate**3 / (rate**2 + frequency**2) ** 2
        rate = 1 / self.length
        stepped = 2 * rate / (rate**2 + frequency**2)
        density = (1 - self.rough) * smooth + self.rough * stepped
        return np.asarray(np.sqrt(density / _INTERVAL_RATIO))

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """Eigenfunctions of a variable in [-1, 1], each times its weight."""
        turn = np.pi * (u + _INTERVAL_RATIO) / (2 * _INTERVAL_RATIO)
        return [
            float(self.weights[k]) * sin((k + 1) * turn) if k < self.waves else u
            for k in range(self.count)[which]
        ]


@dataclass(frozen=True)
class Level:
    """A constant."""

    count = 1

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """One, at any variable."""
        return [u * 0.0 + 1.0][which]


@dataclass(frozen=True)
class Bump:
    """A bump at one value of the variable: a Gaussian of unit height."""

    centre: float  # where it is highest, within [-1, 1]
    width: float  # standard deviation, over half the variable's range
    count = 1

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """One, at any variable."""
        return [exp(-0.5 * ((u - self.centre) / self.width) ** 2)][which]


@dataclass(frozen=True)
class Jump:
    """A step of unit height at one value of the variable."""

    position: float  # where it is, within [-1, 1]
    count = 1

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """One, at any variable."""
        return [np.where(u > self.position, 1.0, 0.0)][which]


@dataclass(frozen=True)
class BuildUp:
    """What builds up over some lengths after a drive turns round, each for itself."""

    lengths: tuple[float, ...]  # over half the stroke

    @property
    def count(self) -> int:
        """Number of functions."""
        return len(self.lengths)

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """Each after a long way and a turn, by the way gone since, from -1 to 1: the stroke."""
        return [0.5 - np.exp(-(u + 1) / length) for length in self.lengths[which]]
