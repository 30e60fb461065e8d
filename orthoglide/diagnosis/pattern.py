"""The pattern of what a fit leaves, for somebody who looks for a cause outside the catalogue.

Simple contrasts, each against the residual itself and not against the noise: with

    gain = |projection of the residual onto the contrast's columns|^2

past what was fitted, ``F = (gain / k) / ((rest - gain) / (degrees - k))`` tells whether a contrast
takes more than its share. Only what does is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.faults import setup_names
from orthoglide.fit import Estimate
from orthoglide.fit.least_squares import fitted_basis
from orthoglide.geometry import LEGS, Array

ALPHA = 0.005
"""Probability of saying something of a structureless residual, for each contrast."""

_FEWEST_STATIONS = 5  # of a setup, for one of them to stand out
_MOSTLY = 0.5
_FEWEST_TRAVELS = 8  # places along an axis below which no period is looked for
_FEWEST_TURNS = 1.5  # of a period that must lie within the travel
_PERIODS = 60


@dataclass(frozen=True)
class _Left:
    """What is left, whitened and past what was fitted.

    Attributes:
        estimate: the fit.
        basis: orthonormal columns of everything fitted, rows of readings ``(n, q)``.
        residual: whitened ``(n,)``.
        travel: of the touched leg's carriage from mechanical zero ``(n,)``, metres.
        degrees: degrees of freedom of station means; of readings.
        setups: number of setups.
    """

    estimate: Estimate
    basis: Array
    residual: Array
    travel: Array
    degrees: tuple[float, float]
    setups: int

    @property
    def setup(self) -> NDArray[np.int64]:
        """Setup of each reading ``(n,)``."""
        return self.estimate.problem.setup_of_row

    def by_setup(self, column: Array) -> Array:
        """A column of its own for every setup ``(n, setups)``."""
        return np.asarray((self.setup[:, None] == np.arange(self.setups)) * column[:, None])

    def gain(self, columns: Array) -> tuple[float, int]:
        """Squared length of the residual along columns ``(n, k)`` past the fit, and their rank."""
        weighted = columns * self.estimate.nuisance.weight[:, None]
        past = weighted - self.basis @ (self.basis.T @ weighted)
        scale = np.linalg.norm(weighted, axis=0)
        kept = np.linalg.norm(past, axis=0) > 1e-3 * np.where(scale > 0, scale, 1)
        if not kept.any():
            return 0.0, 0
        left, singular, _ = np.linalg.svd(past[:, kept] / scale[kept], full_matrices=False)
        left = left[:, singular > 1e-3 * singular[0]]
        return float(np.sum((left.T @ self.residual) ** 2)), left.shape[1]

    def p_value(self, columns: Array, by_reading: bool = False) -> tuple[float, float]:
        """Probability by the F test, and the share of what is left that the columns take."""
        from scipy.special import fdtrc

        total = float(self.residual @ self.residual)
        if not by_reading:
            total = self.between
        gain, k = self.gain(columns)
        degrees = self.degrees[1 if by_reading else 0]
        if k == 0 or degrees - k < 1 or total <= 0:
            return 1.0, 0.0
        rest = max(total - gain, 1e-12 * total)
        return float(fdtrc(k, degrees - k, gain / k / (rest / (degrees - k)))), gain / total

    @property
    def between(self) -> float:
        """Squared length of the station means."""
        station, weight = self.estimate.problem.station, self.estimate.nuisance.weight
        total = np.bincount(station, self.residual * weight)
        size = np.bincount(station, weight**2)
        return float(np.sum(total**2 / size))


def describe_left(estimate: Estimate) -> tuple[str, ...]:
    """What is left of the readings, in sentences without a full stop; only what is significant.

    Args:
        estimate: the last fit.

    Returns:
        Which setups and stations hold it, whether it is odd or even in travel, whether it differs
        by approach, drifts in time, or repeats along an axis.
    """
    left = _left(estimate)
    loud = _loud(left)
    found = [
        *_where(left, loud),
        *_single_station(left),
        *_parity(left, loud),
        *_hysteresis(left),
        *_trend(left),
        *_period(left),
    ]
    if not found:
        found = ["it shows no pattern that can be told from chance by these readings"]
    return tuple(found)


def _left(estimate: Estimate) -> _Left:
    problem = estimate.problem
    leg = np.concatenate([c.leg for c in problem.campaigns])
    command = np.concatenate([c.command for c in problem.campaigns])
    basis = fitted_basis(problem, estimate.nuisance, estimate.at)[: len(problem.measured)]
    stations, taken = int(problem.station.max()) + 1, float(np.sum(basis**2))
    return _Left(
        estimate,
        basis,
        estimate.residuals * estimate.nuisance.weight,
        command[np.arange(len(leg)), leg] - problem.machine.geometry.L,
        (stations - taken, len(leg) - taken),
        problem.setup_count,
    )


def _loud(left: _Left) -> NDArray[np.int64]:
    """Setups that hold more of what is left than their share of the readings."""
    from scipy.special import fdtrc

    if left.setups < 2:
        return np.zeros(0, dtype=np.int64)
    squares = np.bincount(left.setup, left.residual**2)
    rows = np.bincount(left.setup)
    own = rows - np.bincount(left.setup, np.sum(left.basis**2, axis=1))
    rest, others = squares.sum() - squares, own.sum() - own
    usable = (own > 0.5) & (others > 0.5) & (rest > 0)
    ratio = np.where(usable, squares / np.maximum(own, 0.5), 0.0)
    ratio /= np.where(usable, rest / np.maximum(others, 0.5), 1.0)
    p = fdtrc(np.maximum(own, 0.5), np.maximum(others, 0.5), ratio)
    loud = np.flatnonzero(usable & (p < ALPHA / left.setups))
    return loud if len(loud) <= left.setups / 2 else loud[:0]


def _where(left: _Left, loud: NDArray[np.int64]) -> list[str]:
    if not len(loud):
        return []
    squares = np.bincount(left.setup, left.residual**2)
    names = setup_names(left.estimate.problem)
    share = squares[loud].sum() / squares.sum()
    told = " and ".join(names[k] for k in loud)
    return [f"setup{'s' * (len(loud) > 1)} {told} hold{'s' * (len(loud) < 2)} {share:.0%} of it"]


def _single_station(left: _Left) -> list[str]:
    """A single station that stands out: a slip at one posture, or an end of the travel."""
    problem = left.estimate.problem
    columns = np.eye(int(problem.station.max()) + 1)[problem.station]
    weighted = columns * left.estimate.nuisance.weight[:, None]
    past = weighted - left.basis @ (left.basis.T @ weighted)
    size = np.sum(past**2, axis=0)
    seen = size > 1e-6 * np.sum(weighted**2, axis=0)
    gains = np.where(seen, (left.residual @ past) ** 2 / np.where(seen, size, 1.0), 0.0)
    best = int(np.argmax(gains))
    p, share = left.p_value(columns[:, [best]])
    own = left.setup == left.setup[problem.station == best][0]
    # Where a setup has few stations, whatever is left of it looks like one of them.
    few = len(np.unique(problem.station[own])) < _FEWEST_STATIONS
    if few or share < _MOSTLY or p * len(gains) >= ALPHA:
        return []
    row = int(np.flatnonzero(problem.station == best)[0])
    postures = [label for c in problem.campaigns for label in c.posture]
    name = setup_names(problem)[problem.setup_of_row[row]]
    label = postures[row] or f"{left.travel[row] * 1e3:+.4g} mm"
    return [f"a single station, posture {label} of setup {name}, holds {share:.0%} of it"]


def _parity(left: _Left, loud: NDArray[np.int64]) -> list[str]:
    """Odd or even along the stroke of the touched leg's own axis, where most of it is."""
    from scipy.special import fdtrc

    own = loud if len(loud) else np.arange(left.setups)
    gain, degrees = np.zeros(2), np.zeros(2)  # odd, even
    for k in own:
        for power, column in enumerate(_along(left, int(k)), start=1):
            # What the fit takes of a column is not free to be left.
            degrees[1 - power % 2] += 1 - float(np.sum((column @ left.basis) ** 2))
            gain[1 - power % 2] += float(column @ left.residual) ** 2
    if degrees.min() < 1:
        return []
    words = (
        "it is odd along the stroke: what is too much at one end is too little at the other",
        "it is even along the stroke: both ends deviate the same way, as with a bend",
    )
    per = gain / degrees
    for k, text in enumerate(words):
        ratio = per[k] / max(per[1 - k], 1e-12 * per[k]) if per[k] else 0.0
        if float(fdtrc(degrees[k], degrees[1 - k], ratio)) < ALPHA:
            return [text]
    return []


def _along(left: _Left, setup: int) -> Array:
    """Orthonormal polynomials of degree 1 to 4 in the travel of a setup, as rows ``(k, n)``."""
    rows = np.flatnonzero(left.setup == setup)
    s, weight = left.travel[rows], left.estimate.nuisance.weight[rows]
    places = len(np.unique(np.round(s, 6)))
    u = (s - (s.max() + s.min()) / 2) / max(np.ptp(s) / 2, 1e-12)
    powers = np.vander(u, min(places, 5), increasing=True) * weight[:, None]
    columns = np.zeros((powers.shape[1] - 1, len(left.residual)))
    columns[:, rows] = np.linalg.qr(powers)[0].T[1:]
    return columns


def _hysteresis(left: _Left) -> list[str]:
    """Readings that differ by the side from which an axis came."""
    approach = np.concatenate([c.approach for c in left.estimate.problem.campaigns])
    found = []
    for axis, leg in enumerate(LEGS):
        column = np.nan_to_num(approach[:, axis])
        if len(np.unique(column[column != 0])) < 2:
            continue
        p, share = left.p_value(left.by_setup(column))
        if p < ALPHA / 3:
            found.append((p, leg, share))
    if not found:
        return []
    _, leg, share = min(found)
    return [f"it depends on the side from which axis {leg} came ({share:.0%} of it): hysteresis"]


def _trend(left: _Left) -> list[str]:
    """A drift along the sequence of the readings."""
    campaigns = left.estimate.problem.campaigns
    place = np.concatenate([_progress(c.time, c.order.astype(float)) for c in campaigns])
    p, share = left.p_value(left.by_setup(place), by_reading=True)
    return [f"it drifts in time ({share:.0%} of it)"] if p < ALPHA else []


def _progress(time: Array, order: Array) -> Array:
    """Place in time from -1 to 1; in the sequence where no time was recorded."""
    along = time if np.isfinite(time).all() and np.ptp(time) > 0 else order
    return np.asarray(2 * (along - along.min()) / max(np.ptp(along), 1e-300) - 1)


def _period(left: _Left) -> list[str]:
    """Something that repeats along the travel of one axis."""
    problem = left.estimate.problem
    leg = np.concatenate([c.leg for c in problem.campaigns])
    found = []
    for axis, name in enumerate(LEGS):
        own = leg == axis
        places = np.unique(np.round(left.travel[own], 6)) if own.any() else np.zeros(0)
        if len(places) < _FEWEST_TRAVELS:
            continue
        # Shorter than twice the finest step is not told from longer; longer is a bend.
        low, high = 2 * np.diff(places).min(), np.ptp(places) / _FEWEST_TURNS
        if low >= high:
            continue
        rates = np.linspace(1 / high, 1 / low, _PERIODS)
        tests = []
        for rate in rates:
            phase = 2 * np.pi * rate * left.travel
            columns = [left.by_setup(f(phase) * own) for f in (np.sin, np.cos)]
            tests.append(left.p_value(np.hstack(columns)))
        best = int(np.argmin([p for p, _ in tests]))
        p, share = tests[best]
        if p * len(rates) * len(LEGS) < ALPHA:
            found.append((p, name, 1e3 / rates[best], share, 1e3 * np.diff(places).min()))
    if not found:
        return []
    _, name, period, share, step = min(found)
    return [
        f"it repeats along the travel of {name}, every {period:.0f} mm as far as steps of "
        f"{step:.2g} mm can tell ({share:.0%} of it)"
    ]
