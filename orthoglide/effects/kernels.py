"""Free functions of the variable of a free-form error, with coefficients of unit variance.

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
"""Interval of the eigenfunctions over that of the variable, so that they need not vanish there."""


@dataclass(frozen=True)
class Kernel:
    """A Gaussian process of unit variance over [-1, 1]."""

    length: float  # correlation length, over half the variable's range
    waves: int  # number of eigenfunctions
    # share of the variance that has steps and corners, Ornstein-Uhlenbeck; the rest is smooth,
    # Matern 3/2
    rough: float = 0.0
    # whether a straight line is one more function, which eigenfunctions approximate badly
    line: bool = False
    # whether it is zero at the start of its variable's range, before which nothing has changed
    from_zero: bool = False

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
        rough = 2 * rate / (rate**2 + frequency**2)
        density = (1 - self.rough) * smooth + self.rough * rough
        return np.asarray(np.sqrt(density / _INTERVAL_RATIO))

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """Eigenfunctions of a variable in [-1, 1], each times its weight."""
        values = self._functions_with_level(u, which)
        if not self.from_zero:
            return values
        start = self._functions_with_level(-1.0, which)
        return [value - before for value, before in zip(values, start, strict=True)]

    def _functions_with_level(self, u: Any, which: slice) -> list[Any]:
        phase = np.pi * (u + _INTERVAL_RATIO) / (2 * _INTERVAL_RATIO)
        return [
            float(self.weights[k]) * sin((k + 1) * phase) if k < self.waves else u
            for k in range(self.count)[which]
        ]


@dataclass(frozen=True)
class Level:
    """A constant."""

    count = 1

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """The constant 1."""
        return [u * 0.0 + 1.0][which]


@dataclass(frozen=True)
class Bump:
    """A bump at one value of the variable: a Gaussian of unit height."""

    centre: float  # where it is highest, within [-1, 1]
    width: float  # standard deviation, over half the variable's range
    count = 1

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """The bump."""
        return [exp(-0.5 * ((u - self.centre) / self.width) ** 2)][which]


@dataclass(frozen=True)
class Jump:
    """A step of unit height at one value of the variable."""

    position: float  # where it is, within [-1, 1]
    count = 1

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """The step."""
        return [np.where(u > self.position, 1.0, 0.0)][which]


@dataclass(frozen=True)
class BuildUp:
    """Lost motion that builds up exponentially after a reversal, one function a length."""

    lengths: tuple[float, ...]  # over half the stroke

    @property
    def count(self) -> int:
        """Number of functions."""
        return len(self.lengths)

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """The functions of the distance since the reversal, from -1 to 1 over the stroke."""
        return [0.5 - np.exp(-(u + 1) / length) for length in self.lengths[which]]
