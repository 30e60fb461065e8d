"""The pattern of what a fit leaves, for somebody who looks for a cause outside the catalogue.

Simple contrasts, each against the residual itself and not against the noise: with

    gain = |projection of the residual onto the contrast's columns|^2

past what was fitted, ``F = (gain / k) / ((rest - gain) / (degrees - k))`` tells whether a contrast
takes more than its share. Only what does is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.rest import rest_by_setup
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import fitted_basis, past
from orthoglide.geometry import LEGS, Array
from orthoglide.ordering import EQUAL_ODDS, best_of, largest

ALPHA = 0.005
"""Probability of saying something of a structureless residual, for each contrast."""

_FEWEST_STATIONS = 5  # of a setup, for one of them to stand out
_AT_ONCE = 500  # stations: a column of all readings each
_MOSTLY = 0.5
_FEWEST_TRAVELS = 8  # places along an axis below which no period is looked for
_FEWEST_TURNS = 1.5  # of a period that must lie within the travel
_PERIODS = 60


def describe_left(estimate: Estimate) -> tuple[str, ...]:
    """What the last fit leaves, in sentences without a full stop; only what is significant.

    Returns:
        Which setups and stations hold it, whether it is odd or even in travel, whether it differs
        by approach, drifts in time, or repeats along an axis.
    """
    every = rest_by_setup(estimate)
    of_tool = tuple(
        f"{r.share:.0%} of it is in {r.reads} ({r.setup})" for r in every[:1] if r.leg < 0
    )
    if not estimate.problem.campaigns:  # no more is looked for in readings of the tool
        return of_tool
    rest = _Rest(estimate)
    tests = (_where, _single_station, _parity, _hysteresis, _trend, _period)
    found = (*of_tool, *(text for test in tests if (text := test(rest))))
    return found or ("it shows no pattern that can be told from chance by these readings",)


def _f_test(k: Array | float, degrees: Array | float, ratio: Array | float) -> Array:
    """Probability of a ratio of mean squares this large on k and ``degrees``."""
    from scipy.special import fdtrc

    return np.asarray(fdtrc(k, degrees, ratio))


@dataclass(frozen=True)
class _Rest:
    """What a fit leaves, whitened and past what was fitted."""

    estimate: Estimate  # the fit

    @property
    def problem(self) -> Problem:
        """Of the fit."""
        return self.estimate.problem

    @property
    def count(self) -> int:
        """Number of dial readings: only these are looked at."""
        return sum(map(len, self.problem.campaigns))

    def whiten(self, rows: Array) -> Array:
        """Readings ``(n, ...)`` in metres in units of their noise."""
        padded = np.zeros((len(self.problem.measured), *rows.shape[1:]))
        padded[: self.count] = rows
        return self.problem.weighing.whiten(padded)[: self.count]

    @property
    def setup(self) -> NDArray[np.int64]:
        """Setup of each reading ``(n,)``."""
        return self.problem.setup_of_row[: self.count]

    @property
    def station(self) -> NDArray[np.int64]:
        """Station of each reading ``(n,)``."""
        return self.problem.station[: self.count]

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns of everything fitted, rows of readings ``(n, q)``."""
        return fitted_basis(self.problem, self.estimate.nuisance, self.estimate.at)[: self.count]

    @cached_property
    def residual(self) -> Array:
        """Whitened ``(n,)``."""
        return self.whiten(self.estimate.residuals[: self.count])

    @cached_property
    def leg(self) -> NDArray[np.int64]:
        """Leg touched by each reading ``(n,)``."""
        return self.problem.of_dials("leg")

    @cached_property
    def travel(self) -> Array:
        """Of the touched leg's carriage from mechanical zero ``(n,)``, metres."""
        own = self.problem.of_dials("command")[np.arange(len(self.leg)), self.leg]
        return np.asarray(own - self.problem.machine.geometry.zero[0])

    @cached_property
    def dominant(self) -> NDArray[np.int64]:
        """Setups that hold more of what is left than their share of the readings."""
        squares, rows = np.bincount(self.setup, self.residual**2), np.bincount(self.setup)
        degrees = rows - np.bincount(self.setup, np.sum(self.basis**2, axis=1))
        rest, others = squares.sum() - squares, degrees.sum() - degrees
        usable = (degrees > 0.5) & (others > 0.5) & (rest > 0)
        degrees, others = np.maximum(degrees, 0.5), np.maximum(others, 0.5)
        ratio = np.where(usable, squares / degrees / np.where(usable, rest / others, 1.0), 0.0)
        p = _f_test(degrees, others, ratio)
        found = np.flatnonzero(usable & (p < ALPHA / len(rows)))
        return found if len(found) <= len(rows) / 2 else found[:0]

    def past(self, columns: Array) -> tuple[Array, Array]:
        """Columns ``(n, k)`` whitened and past the fit, and their length before ``(k,)``."""
        weighted = self.whiten(columns)
        scale = np.linalg.norm(weighted, axis=0)
        return past(self.basis, weighted), np.where(scale > 0, scale, 1.0)

    def by_setup(self, column: Array) -> Array:
        """A column of its own for every setup ``(n, setups)``."""
        setups = np.array(self.problem.leg_setups)
        return np.asarray((self.setup[:, None] == setups) * column[:, None])

    def p_value(self, columns: Array, by_reading: bool = False) -> tuple[float, float]:
        """Probability by the F test, and the share of what is left that the columns take.

        Args:
            columns: of the contrast ``(n, k)``.
            by_reading: against all readings instead of the station means.
        """
        past, scale = self.past(columns)
        kept = np.linalg.norm(past, axis=0) > 1e-3 * scale
        station = self.station
        total = float(self.residual @ self.residual)
        degrees = len(station) - float(np.sum(self.basis**2))
        if not by_reading:
            along = self.problem.weighing.direction[: self.count]
            total = float(np.sum(np.bincount(station, self.residual * along) ** 2))
            degrees += int(station.max()) + 1 - len(station)
        if not kept.any() or total <= 0:
            return 1.0, 0.0
        left, singular, _ = np.linalg.svd(past[:, kept] / scale[kept], full_matrices=False)
        left = left[:, singular > 1e-3 * singular[0]]
        gain, k = float(np.sum((left.T @ self.residual) ** 2)), left.shape[1]
        if degrees - k < 1:
            return 1.0, 0.0
        remainder = max(total - gain, 1e-12 * total) / (degrees - k)
        return float(_f_test(k, degrees - k, gain / k / remainder)), gain / total


def _where(rest: _Rest) -> str:
    """Setups that hold most of it."""
    setups = rest.dominant
    if not len(setups):
        return ""
    names, every = [rest.problem.setups[k].name for k in setups], rest_by_setup(rest.estimate)
    share = sum(one.share for one in every if one.setup in names)
    listed = " and ".join(names)
    return (
        f"setup{'s' * (len(setups) > 1)} {listed} hold{'s' * (len(setups) < 2)} {share:.0%} of it"
    )


def _single_station(rest: _Rest) -> str:
    """A single station that stands out: a slip at one posture, or an end of the travel."""
    station, found = rest.station, list[Array]()
    every = np.arange(int(station.max()) + 1)
    for some in np.split(every, range(_AT_ONCE, len(every), _AT_ONCE)):
        past, scale = rest.past((station[:, None] == some).astype(float))
        size = np.linalg.norm(past, axis=0)
        visible = size > 1e-3 * scale
        found.append(
            np.where(visible, (rest.residual @ past / np.where(visible, size, 1.0)) ** 2, 0.0)
        )
    gains = np.concatenate(found)
    best = largest(gains)
    p, share = rest.p_value((station[:, None] == best).astype(float))
    row = int(np.flatnonzero(station == best)[0])
    # Where a setup has few stations, whatever is left of it looks like one of them.
    few = len(np.unique(station[rest.setup == rest.setup[row]])) < _FEWEST_STATIONS
    if few or share < _MOSTLY or p * len(gains) >= ALPHA:
        return ""
    label = rest.problem.of_dials("posture")[row] or f"{rest.travel[row] * 1e3:+.4g} mm"
    name = rest.problem.setups[rest.setup[row]].name
    return f"a single station, posture {label} of setup {name}, holds {share:.0%} of it"


def _parity(rest: _Rest) -> str:
    """Odd or even along the stroke of the touched leg's own axis, where most of it is."""
    setups = rest.dominant if len(rest.dominant) else np.array(rest.problem.leg_setups)
    gain, degrees = np.zeros(2), np.zeros(2)  # odd, even
    for k in setups:
        for power, column in enumerate(_polynomials(rest, int(k)), start=1):
            # What the fit takes of a column is not free to be left.
            degrees[1 - power % 2] += 1 - float(np.sum((column @ rest.basis) ** 2))
            gain[1 - power % 2] += float(column @ rest.residual) ** 2
    if degrees.min() < 1:
        return ""
    per = gain / degrees
    ratio = per / np.maximum(per[::-1], 1e-12 * np.maximum(per, 1e-300))
    odd, even = _f_test(degrees, degrees[::-1], ratio) < ALPHA
    if odd:
        return "it is odd along the stroke: what is too much at one end is too little at the other"
    if even:
        return "it is even along the stroke: both ends deviate the same way, as with a bend"
    return ""


def _polynomials(rest: _Rest, setup: int) -> Array:
    """Orthonormal polynomials of degree 1 to 4 in the travel of a setup, as rows ``(k, n)``."""
    rows = np.flatnonzero(rest.setup == setup)
    s = rest.travel[rows]
    places = len(np.unique(np.round(s, 6)))
    u = (s - (s.max() + s.min()) / 2) / max(np.ptp(s) / 2, 1e-12)
    powers = np.zeros((len(rest.residual), min(places, 5)))
    powers[rows] = np.vander(u, powers.shape[1], increasing=True)
    return np.asarray(np.linalg.qr(rest.whiten(powers))[0].T[1:])


def _hysteresis(rest: _Rest) -> str:
    """Readings that differ by the side from which an axis came."""
    approach = np.nan_to_num(rest.problem.of_dials("approach"))
    found = []
    for column, leg in zip(approach.T, LEGS, strict=True):
        if len(np.unique(column[column != 0])) > 1:
            p, share = rest.p_value(rest.by_setup(column))
            found.append((p, leg, share))
    if not found or min(found)[0] >= ALPHA / len(LEGS):
        return ""
    _, leg, share = best_of(found, _decisive, EQUAL_ODDS)
    return f"it depends on the side from which axis {leg} came ({share:.0%} of it): hysteresis"


def _decisive(found: Sequence[Any]) -> float:
    """Return minus the logarithm of the p-value that stands first."""
    return -float(np.log(max(found[0], 1e-300)))


def _trend(rest: _Rest) -> str:
    """A drift along the sequence of the readings."""
    campaigns = rest.problem.campaigns
    place = np.concatenate([clock(c.time, c.order) for c in campaigns])
    p, share = rest.p_value(rest.by_setup(place), by_reading=True)
    return f"it drifts in time ({share:.0%} of it)" if p < ALPHA else ""


def _period(rest: _Rest) -> str:
    """Something that repeats along the travel of one axis."""
    found = []
    for axis, name in enumerate(LEGS):
        on_leg = rest.leg == axis
        places = np.unique(np.round(rest.travel[on_leg], 6))
        if len(places) < _FEWEST_TRAVELS:
            continue
        # Shorter than twice the finest step is not told from longer; longer is a bend.
        step, high = np.diff(places).min(), np.ptp(places) / _FEWEST_TURNS
        if 2 * step >= high:
            continue
        for rate in np.linspace(1 / high, 1 / (2 * step), _PERIODS):
            phase = 2 * np.pi * rate * rest.travel
            waves = [rest.by_setup(wave(phase) * on_leg) for wave in (np.sin, np.cos)]
            p, share = rest.p_value(np.hstack(waves))
            found.append((p, name, 1e3 / rate, share, 1e3 * step))
    if not found or min(found)[0] * _PERIODS * len(LEGS) >= ALPHA:
        return ""
    _, name, period, share, step = best_of(found, _decisive, EQUAL_ODDS)
    return (
        f"it repeats along the travel of {name}, every {period:.0f} mm as far as steps of "
        f"{step:.2g} mm can tell ({share:.0%} of it)"
    )


def clock(time: Array, order: NDArray[np.int64]) -> Array:
    """Time of readings ``(k,)`` over -1 to 1, or their place in order where none was recorded."""
    along = time if np.isfinite(time).all() and np.ptp(time) > 0 else order
    return np.asarray(2 * (along - along.min()) / max(np.ptp(along), 1e-300) - 1)
