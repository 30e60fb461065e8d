"""Free functions of the variable of a free-form error, with coefficients of unit variance.

A Gaussian process in the first eigenfunctions of the Laplacian on an interval somewhat longer than
its variable's (Solin and Sarkka 2020, *Hilbert space methods for reduced-rank Gaussian process
regression*, eq. 17 and 56); or lost motion that builds up after a reversal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from orthoglide.effects.effect import exp, sin
from orthoglide.geometry import Array

_INTERVAL_RATIO = 1.25
"""Interval of the eigenfunctions over that of the variable, so that they need not vanish there."""


@dataclass(frozen=True)
class Kernel:
    """A Gaussian process over [-1, 1], of about unit variance inside and less at the ends.

    A line, and a start at zero, come on top of that.
    """

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
        """Standard deviation of each coefficient, of eigenfunctions and the line ``(count,)``."""
        frequency = np.pi * np.arange(1, self.waves + 1) / (2 * _INTERVAL_RATIO)
        rate = np.sqrt(3) / self.length
        smooth = 4 * rate**3 / (rate**2 + frequency**2) ** 2
        rate = 1 / self.length
        rough = 2 * rate / (rate**2 + frequency**2)
        density = (1 - self.rough) * smooth + self.rough * rough
        return np.append(np.sqrt(density / _INTERVAL_RATIO), np.ones(int(self.line)))

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """Eigenfunctions of a variable in [-1, 1], each times its weight, and the line, less their
        values at the start if they are zero there.
        """
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
class Step:
    """A step of unit height whose place between two values of the variable is unknown: its mean, a
    straight line between them.

    A step along the travel has one more function, its deviation from that line, which no reading
    shows: the first eigenfunction of a Brownian bridge, scaled to the bridge's mean variance, 1/6.
    """

    start: float  # within [-1, 1]
    end: float  # above
    # least width on a calibrated machine, of a step along the travel; `None`: in time
    least_width: float | None = None

    @property
    def count(self) -> int:
        """Number of functions."""
        return 1 if self.least_width is None else 2

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """The step, and the deviation from its mean."""
        share = (u - self.start) / (self.end - self.start)
        share = (abs(share) - abs(share - 1) + 1) / 2  # of symbols too
        return [share, sin(np.pi * share) / np.sqrt(3)][: self.count][which]

    @property
    def lasting(self) -> Step | Level:
        """The step of a calibrated machine, which stays as it is after a jump in time."""
        if self.least_width is None:
            return Level()
        middle = (self.start + self.end) / 2
        half = max(self.end - self.start, self.least_width) / 2
        return replace(self, start=middle - half, end=middle + half)


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


@dataclass(frozen=True)
class Wave:
    """A wave of one period: a sine and a cosine of unit height."""

    cycles: float  # over the variable's range
    count = 2

    def functions(self, u: Any, which: slice = slice(None)) -> list[Any]:
        """The sine and the cosine."""
        phase = np.pi * self.cycles * u
        return [sin(phase), sin(phase + np.pi / 2)][which]


_SAMPLES_PER_CYCLE = 12
_BUMP_WIDTHS = 3.0  # from the centre of a bump, beyond which a hundredth of it is left


def sample_points(kernel: Kernel | BuildUp | Bump | Step | Level | Wave, fine: bool) -> Array:
    """Return values of the variable ``(n,)`` that show the functions; ``fine``: of short waves."""
    if isinstance(kernel, Wave):
        return np.linspace(-1, 1, 1 + math.ceil(_SAMPLES_PER_CYCLE * kernel.cycles))
    if isinstance(kernel, Bump):
        return kernel.centre + kernel.width * np.linspace(-_BUMP_WIDTHS, _BUMP_WIDTHS, 41)
    u = np.linspace(-1, 1, 2 * kernel.count + 1 if fine else 41)
    if isinstance(kernel, Step) and kernel.least_width is not None:
        return np.union1d(u, np.linspace(kernel.start, kernel.end, 11))
    return u


LENGTH = 0.08  # metres: half of the stroke for which the lengths below hold; they scale with it
FINE, COARSE = Kernel(0.030 / LENGTH, 12), Kernel(0.050 / LENGTH, 8)
FINE_AND_LINE = replace(FINE, line=True)
# A coupling slips, an encoder misses a count, a carriage sticks and jumps. Half-waves of 96
# functions are 2 mm long; lost motion changes within 8 mm.
DRIVE, LOST = Kernel(0.030 / LENGTH, 96, rough=0.1), Kernel(0.030 / LENGTH, 24, rough=0.1)
# Harmonics of a screw, a worn ball: unknown between stations that are farther apart.
SCREW = Kernel(0.003 / LENGTH, 96)
ACROSS = Kernel(0.050 / LENGTH, 8, line=True)
# Most drives that follow another's command, and carriages that turn, do so in proportion. A free
# function is too wide for that: a dial's scale and a bent rail were named in its place.
LINE = Kernel(1.0, 0, line=True)
# Warmth comes and goes slowly, and begins at once. The machine is that of the session's start: with
# the mean change in it, other causes seem active. With 12 functions a dial took a part of a drift,
# and without a line another cause its steady part.
DRIFT = Kernel(0.5, 24, rough=0.1, line=True, from_zero=True)
STEADY = replace(LINE, from_zero=True)
# Rollers, and a profile that was pressed or printed: waves of some centimetres, however long the
# stroke; half as long as those of `FINE` on a stroke of two `LENGTH`, and on a shorter one.
_SHORT = 0.015
_PER_LENGTH, _MOST = 5, 96  # functions for each correlation length in half a stroke; in all
BUILD_UP = BuildUp((0.05, 0.1, 0.2, 0.4, 0.8))


def short_wave_kernel(half: float) -> Kernel:
    """Return the kernel of waves of some centimetres on a stroke of ``2 half``, metres."""
    length = min(_SHORT / half, FINE.length / 2)
    return Kernel(length, min(_MOST, math.ceil(_PER_LENGTH / length)))
