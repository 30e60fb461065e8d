"""Readings of the tool that repeats contradict: slips, an instrument that was moved, no readings.

They are refused, with their lines: noise that is taken from the repeats would believe all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Rows, clock
from orthoglide.diagnosis.repeat_faults import Slips
from orthoglide.diagnosis.scatter import Scatter, median_scatter
from orthoglide.errors import InputError
from orthoglide.fit import Estimate
from orthoglide.fit.tool import ToolReadings
from orthoglide.fit.tool_noise import step_of
from orthoglide.geometry import Array
from orthoglide.machine_file import Instrument
from orthoglide.observations import source
from orthoglide.observations.approach import SIDES_UNTOLD, TELL_SIDES
from orthoglide.observations.arrays import numbered
from orthoglide.ordering import EQUAL_ODDS, best_of, largest

_BEYOND = 10.0  # times what such an instrument scatters, from which it is no noise of its own
_KIND = 2.0  # degrees of freedom of knowing the noise by the kind of instrument
_ALIKE = 4.0  # squared scatter that one may leave which is as its kind is
_CANDIDATES = 64  # moments at which it may have been moved, tried before those beside the best
_NEAR = 1.0  # log of the odds by which moments, and a move and a drift, are told apart

Evidence = tuple[float, list[str]]
"""Log Bayes factor of faults, and each in words."""

NOTHING: Evidence = (-np.inf, [])


def check_repeats(estimate: Estimate) -> None:
    """Refuse readings of the tool that their repeats contradict.

    Raises:
        InputError: naming file, line and setup, what it looks like and what to do.
    """
    problem, own = estimate.problem, estimate.problem.machine.spec.instruments
    found: list[str] = []
    for k, factor, setup, mounted in problem.mounted:
        left, instrument = estimate.residuals[problem.factor_rows[k]], own.get(mounted.kind)
        check = _Setup(factor, setup, estimate.at.slopes[k], left, instrument or Instrument())
        found += check.fault()
    if found:
        raise InputError("; ".join(found))


@dataclass(frozen=True)
class _Setup:
    """Readings of one setup, ``m`` of the ``n`` of a file."""

    factor: ToolReadings  # the file's
    setup: int  # its number
    slopes: Array  # of the fit (n, 4)
    left: Array  # of the fit (n,)
    own: Instrument  # what the machine file says of the instrument

    def fault(self) -> Iterator[str]:
        """What the repeats contradict, in words, if anything."""
        scatter = self._scatter
        size, usual = self.factor.loudness(self.setup)
        both = self._moved(scatter), self._slips(scatter)
        _, slips = best_of(both, lambda found: found[0], EQUAL_ODDS)
        if slips:
            yield from slips
        elif size > _BEYOND * usual:
            yield self._scattered(size)

    @property
    def _scatter(self) -> Scatter:
        """In the order they were taken, about the means of their stations, by what is usual."""
        campaign = self.factor.points
        order = np.argsort(campaign.order, kind="stable")
        rows = order[campaign.setup[order] == self.setup]
        weight = 1 / self.factor.usual[rows]
        second = np.nan_to_num(campaign.second[rows])
        alike = np.column_stack([campaign.stations, campaign.axis])[rows]
        powers = clock(campaign.time[rows], np.arange(len(rows)))[:, None] ** [1, 2, 3]
        return Scatter(
            self.setup, rows, weight, numbered(np.column_stack([alike, second])),
            np.ones_like(rows), campaign.reading[rows] * weight, powers * weight[:, None],
            self.left[rows] * weight, np.zeros((len(rows), 0)),
        )  # fmt: skip

    def _slips(self, scatter: Scatter) -> Evidence:
        """Single readings: of an instrument as sound as its kind but for these, or as noisy as most
        of its stations.
        """
        if scatter.dof < 2:
            return NOTHING
        step = step_of(self.factor.points.subset(scatter.rows), self.own)
        for scale in dict.fromkeys((1.0, median_scatter([scatter], 1.0))):
            faults = Slips(scatter, scale, step, len(scatter.rows)).confirmed()
            outliers = [f for f in faults if f.kind == "outlier"]
            if outliers:
                return max(f.evidence for f in outliers), [self._slipped(f) for f in outliers]
        return NOTHING

    def _moved(self, scatter: Scatter) -> Evidence:
        """The instrument elsewhere from some moment on, where that leaves nothing unusual of its
        repeats; no slower, if the machine itself may have been warming.
        """
        if scatter.dof < 2 or scatter.chi2 <= _ALIKE * scatter.dof:
            return NOTHING
        count = len(scatter.rows)
        shown = self.factor.nuisances(self.slopes).columns[scatter.rows]
        shown = (shown * scatter.weight[:, None])[:, shown.any(axis=0)]

        def at(place: int) -> float:
            columns = np.where(np.arange(count)[:, None] >= place, shown, 0.0)
            return scatter.gain(scatter.past(columns))

        def of(gain: Array) -> Array:
            return scatter.evidence(gain, shown.shape[1], 1.0, _KIND) - np.log(count)

        gains = _about_best(at, count)
        places = np.array(sorted(gains))
        evidence = of(np.array([gains[k] for k in places]))
        best = largest(evidence, EQUAL_ODDS)
        rest = max(scatter.dof - shown.shape[1], 1)
        alike = scatter.chi2 - gains[int(places[best])] <= _ALIKE * rest
        times = self.factor.points.time[scatter.rows]
        slower = self._drifted(scatter, shown) - np.log(count)
        slower += -_NEAR if np.isnan(times).any() else _NEAR
        if not alike or evidence[best] < max(EVIDENCE, slower):
            return NOTHING
        near = places[evidence >= evidence[best] - _NEAR]
        size = _change(scatter, self.factor.points.reading, int(places[best]))
        return float(evidence[best]), [self._displaced(scatter.rows[near], size)]

    def _drifted(self, scatter: Scatter, shown: Array) -> float:
        """Evidence of the instrument's going there little by little.

        Args:
            scatter: of the readings.
            shown: what the instrument's place shows, whitened ``(m, q)``.
        """
        found, columns = [], np.zeros((len(shown), 0))
        for power in scatter.trend.T / scatter.weight:
            columns = np.hstack([columns, shown * power[:, None]])
            gain = scatter.gain(scatter.past(columns))
            found.append(float(scatter.evidence(gain, columns.shape[1], 1.0, _KIND)))
        return max(found)

    # In words -----------------------------------------------------------------------------

    @property
    def _unit(self) -> str:
        return self.factor.points.setups[self.setup].instrument.unit

    def _where(self, lines: NDArray[np.int64]) -> str:
        campaign = self.factor.points
        at = f", line {lines[0]}" if len(lines) == 1 else ""
        at = f", lines {lines.min()} to {lines.max()}" if len(lines) > 1 else at
        return f"{source(campaign)}{at}, setup {campaign.setups[self.setup].name!r}"

    def _slipped(self, fault: Fault) -> str:
        read = self.factor.points.reading[fault.rows[0]] * 1e3
        return (
            f"{self._where(self.factor.points.line[fault.rows])}: the reading {read:.6g} "
            f"{self._unit} is {fault.size * 1e3:+.3g} {self._unit} off the others of this place: "
            f"correct the row or remove it{self._or_lost}"
        )

    @property
    def _or_lost(self) -> str:
        """What else visits of one place differ by, where nobody knows their sides."""
        if self.factor.sided(self.setup):
            return ""
        return f"; or it is lost motion, as {SIDES_UNTOLD}: {TELL_SIDES}"

    def _displaced(self, rows: Rows, size: float) -> str:
        when = "here" if len(rows) == 1 else "one of these"
        return (
            f"{self._where(self.factor.points.line[rows])}: from {when} on the same places read "
            f"about {size * 1e3:.2g} {self._unit} otherwise than before, as if the instrument, or "
            f"what it stands on, had been moved, or drifted: give the rows from there on a setup "
            f"name of their own, or measure the setup again{self._or_lost}"
        )

    def _scattered(self, size: float) -> str:
        instrument = self.factor.points.setups[self.setup].instrument
        near = ", or to places beside it," if instrument.touches else ""
        return (
            f"{self._where(np.zeros(0, dtype=int))}: visits to the same place{near} scatter by "
            f"{size * 1e3:.2g} {self._unit}, which is no noise of such an instrument: rows were "
            f"exchanged, the readings have another unit, or something is loose; put it right, or "
            f"give repeatability in the machine file under [instrument.{instrument.kind}]"
            f"{self._or_lost}"
        )


def _about_best(gain: Callable[[int], float], count: int) -> dict[int, float]:
    """Gains at places from 1 to ``count`` - 1: at some, and at more about the best, until at all
    beside it.
    """
    found: dict[int, float] = {}
    low, high = 1, count - 1
    while True:
        places = np.unique(np.linspace(low, high, _CANDIDATES).astype(int)).tolist()
        found |= {k: gain(k) for k in places if k not in found}
        step = -(-(high - low + 1) // _CANDIDATES)
        if step <= 1:
            return found
        best = best_of(sorted(found), found.__getitem__, EQUAL_ODDS)
        low, high = max(1, best - step), min(count - 1, best + step)


def _change(scatter: Scatter, reading: Array, place: int) -> float:
    """Difference, root mean square, of what a station showed before a place in order and after."""
    late, read = np.arange(len(scatter.rows)) >= place, reading[scatter.rows]
    count = int(scatter.station.max()) + 1
    with np.errstate(invalid="ignore"):
        mean = [
            np.bincount(scatter.station[side], read[side], count)
            / np.bincount(scatter.station[side], minlength=count)
            for side in (late, ~late)
        ]
    return float(np.sqrt(np.nanmean((mean[0] - mean[1]) ** 2)))
