"""The readings, linear in everything that could be wrong, and scales of the background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array

SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Scales of the effects of the catalogue that no slab lets out, in tolerances."""

STRANGE = 0.1
"""Probability of a place to be wrong in its own way, over that of a cause of the catalogue: what is
known to go wrong with such machines goes wrong more often. One that may be wrong in short waves or
else smoothly is so in either way with half of that."""

EXPECTED = 3.0
"""Causes that stand out, expected before the readings are seen (the mean of a Poisson law): who
measures a machine has a reason to."""

_UNSEEN = 1e-6
"""Sigmas that the largest slab may add along a direction which counts as not seen at all."""

RARE = -3.0
"""Log of the prior weight of a machine beyond its tolerances altogether, and of noise larger than
the repeats show: one in twenty each."""

FREE = (0.003, 0.03, 0.1, 0.3)
"""Scales of the free functions that no slab lets out, in their units."""

NOISE = (1.0, 1.7, 3.0, 5.0, 9.0, 16.0, 30.0)
"""Scales of the noise beyond the declared one: standard deviations of an error of its own at every
station, in sigmas of a reading. Steps of 1.7 lose at most 0.1 of ln Z on 50 readings."""

_NOISY_SHARES = (0.003, 0.1, 0.3, 1.0, 3.0)
"""Shares that are told apart under larger noise, in which small ones do not show."""

SOUND = 0.03
"""Tolerances: a machine of which everything is off by less is sound."""

SLABS = (0.3, 1.0, 3.0, 10.0)
"""Scales of what stands out."""


@dataclass(frozen=True, eq=False, repr=False)
class Group:
    """Coefficients that stand out together, or not."""

    name: str  # of the cause or place
    places: NDArray[np.intp]  # of the coefficients that it moves (k,), or (q,) with `weights`
    weights: Array  # from its own coefficients to those (q, k)
    free: bool  # whether it is a free function
    chance: float = 1.0  # how often it goes wrong, over a cause of the catalogue
    unit: float = 1.0  # tolerances that a slab of scale one lets its coefficients out by
    # of a fault of the data how many of it are expected, before the readings are seen; of what is
    # wrong with the machine that follows from all chances
    expected: float | None = None

    @property
    def of_data(self) -> bool:
        """Whether it is a fault of the data."""
        return self.expected is not None

    @property
    def size(self) -> int:
        """Number of its own coefficients."""
        return self.weights.shape[1]


@dataclass(frozen=True, eq=False, repr=False)
class Linear:
    """Readings about a machine, linear in everything that could be wrong."""

    columns: Array  # whitened, nuisances projected out, by coefficient in tolerances (m, C)
    residual: Array  # what the readings say of the sum (m,)
    fixed: Array  # prior sd of the coefficients that no background has (C,); nan elsewhere
    free: NDArray[np.bool_]  # which belong to free functions (C,)
    # which belong to shapes of a plate that no effect names (C,): these explain readings without
    # telling anything
    unnamed: NDArray[np.bool_]
    groups: tuple[Group, ...]  # that may stand out
    stations: Array  # an error of one sigma at each station (m, s)
    # scales that the effects' background may have, in tolerances
    shares: tuple[float, ...] = SHARES
    slabs: tuple[float, ...] = SLABS  # those of what stands out
    # share beyond which a background is unlikely, and log of its weight
    wide: tuple[float, float] = (max(SHARES), 0.0)
    noise_weight: float = RARE  # log of the prior weight of noise larger than declared
    # what stations show beside all columns: squared, in how many directions, and the visits that
    # each has; none where all directions are kept
    beyond: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def spike(self, share: float, free_share: float) -> Array:
        """Prior variance of each coefficient without slabs ``(C,)``."""
        background = np.where(self.free, free_share, share)
        return np.where(np.isfinite(self.fixed), self.fixed, background) ** 2

    @cached_property
    def squares(self) -> tuple[Array, Array, Array, Array]:
        """What readings would vary by ``(m, m)``: for coefficients that no background has, free
        functions of scale one, a background of one tolerance, and errors of stations of one sigma.
        """
        fixed, A = np.isfinite(self.fixed), self.columns
        known = A[:, fixed] * self.fixed[fixed]
        some = (known, A[:, self.free & ~fixed], A[:, ~self.free & ~fixed], self.stations)
        fixed_one, free, background, stations = (rows @ rows.T for rows in some)
        return fixed_one, free, background, stations

    @cached_property
    def by_group(self) -> Array:
        """What readings see of all groups side by side ``(m, K)``."""
        none = np.zeros((len(self.columns), 0))  # where nothing is seen through the noise
        both = zip(self.groups, self.seen, strict=True)
        return np.hstack([none, *(self.columns[:, g.places] @ seen for g, seen in both)])

    @cached_property
    def seen(self) -> tuple[Array, ...]:
        """Of each group the combinations of its coefficients that readings see ``(q, r)``.

        All its coefficients stand out alike, so any turn of them is as good.
        """
        found = []
        for group in self.groups:
            turned = np.eye(1)
            if group.size > 1:
                shown = group.unit * self.columns[:, group.places] @ group.weights
                _, size, turn = np.linalg.svd(shown, full_matrices=False)
                turned = turn[: max(1, int((size * max(self.slabs) > _UNSEEN).sum()))].T
            found.append(group.unit * group.weights @ turned)
        return tuple(found)


class Basis:
    """Everything whitened by all but the background of the effects, along what that would add.

    Its directions are the same for all shares, of which each makes no more than other weights.

    Attributes:
        free_share: scale of the free functions that no slab lets out.
        noise: error of its own at every station, in the noise of a reading.
        columns: by coefficient ``(m, C)``.
        residual: ``(m,)``.
        by_group: those of all groups side by side, see :attr:`Linear.by_group`.
        grows: what a background of one tolerance adds to the variance of each direction ``(m,)``.
        log_det: of the covariance without background.
    """

    def __init__(self, linear: Linear, free_share: float, noise: float) -> None:
        self.linear, self.free_share, self.noise = linear, free_share, noise
        fixed, free, background, stations = linear.squares
        cov = fixed + free_share**2 * free + noise**2 * stations
        cov[np.diag_indices_from(cov)] += 1.0
        root = np.linalg.cholesky(cov)
        self.log_det = 2 * float(np.log(np.diag(root)).sum())
        whiten = np.linalg.inv(root)
        grows, turn = np.linalg.eigh(whiten @ background @ whiten.T)
        self.grows = np.maximum(grows, 0.0)
        whiten = turn.T @ whiten
        self.columns, self.residual = whiten @ linear.columns, whiten @ linear.residual
        self.by_group = whiten @ linear.by_group


class Scale:
    """One point of the grid of scales: everything whitened by its background."""

    def __init__(self, basis: Basis, share: float) -> None:
        self.basis, self.share = basis, share
        self.free_share, self.noise = basis.free_share, basis.noise
        self.spike = basis.linear.spike(share, basis.free_share)
        self.weight = 1 / np.sqrt(1 + share**2 * basis.grows)
        # Where no repeats show the noise, more of it than was declared is nothing rare.
        self.rare = (share > 1) + (basis.noise > 0 and basis.linear.noise_weight < 0)
        square, count, visits = basis.linear.beyond
        beyond, weight = basis.linear.wide
        alike = 1 + basis.noise**2 * visits
        self.log_z = (
            RARE * (share > 1)
            + basis.linear.noise_weight * (basis.noise > 0)
            + weight * (share > beyond)
            - 0.5 * (square / alike + count * float(np.log(alike)))
            - 0.5 * float(self.residual @ self.residual)
            - 0.5 * basis.log_det
            + float(np.log(self.weight).sum())
        )

    @property
    def columns(self) -> Array:
        """By coefficient ``(m, C)``."""
        return self.basis.columns * self.weight[:, None]

    def along(self, rows: Array) -> Array:
        """What rows ``(..., m)`` have along the columns of all coefficients ``(..., C)``."""
        return np.asarray((rows * self.weight) @ self.basis.columns)

    @property
    def residual(self) -> Array:
        """Of the readings ``(m,)``."""
        return self.basis.residual * self.weight

    def of_groups(self, at: NDArray[np.intp]) -> Array:
        """Some columns of those of all groups side by side ``(m, k)``."""
        return self.basis.by_group[:, at] * self.weight[:, None]


def scales(linear: Linear) -> tuple[Scale, ...]:
    """The grid of scales."""
    quiet = [Basis(linear, free, 0.0) for free in FREE]
    noisy = [Basis(linear, FREE[0], noise) for noise in NOISE]
    found = [Scale(basis, share) for share in linear.shares for basis in quiet]
    shares = [share for share in linear.shares if share in _NOISY_SHARES]
    return (*found, *(Scale(basis, share) for share in shares for basis in noisy))


def whole(
    name: str, places: Sequence[int] | NDArray[np.intp], *, free: bool, chance: float = 1.0
) -> Group:
    """A group of coefficients, each for itself."""
    return Group(name, np.array(places, dtype=np.intp), np.eye(len(places)), free, chance)
