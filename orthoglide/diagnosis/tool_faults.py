"""Readings of the tool that repeats or all others contradict: slips, an instrument that was moved.

Slips are set aside. The rest is refused, with its lines: noise that is taken from the repeats would
believe all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Rows, clock, message
from orthoglide.diagnosis.misreadings import with_noise_of_the_rest, without_weight
from orthoglide.diagnosis.repeat_faults import Slips
from orthoglide.diagnosis.scatter import Scatter, median_scatter
from orthoglide.errors import InputError
from orthoglide.fit import Estimate, solve
from orthoglide.fit.doubts import find_slips
from orthoglide.fit.factors import Factor
from orthoglide.geometry import Array
from orthoglide.observations import source
from orthoglide.observations.approach import SIDES_UNTOLD, TELL_SIDES
from orthoglide.observations.arrays import numbered
from orthoglide.ordering import EQUAL_ODDS, best_of, largest
from orthoglide.prediction import Seen

_BEYOND = 10.0  # times what such an instrument scatters, from which it is no noise of its own
_KIND = 2.0  # degrees of freedom of knowing the noise by the kind of instrument
_ALIKE = 4.0  # squared scatter that one may leave which is as its kind is
_CANDIDATES = 64  # moments at which it may have been moved, tried before those beside the best
_NEAR = 1.0  # log of the odds by which moments, and a move and a drift, are told apart

Evidence = tuple[float, list[str]]
"""Log Bayes factor of faults, and each in words."""

NOTHING: Evidence = (-np.inf, [])


def check_repeats(estimate: Estimate) -> None:
    """Refuse readings of the tool that their repeats contradict, where nothing is set aside.

    Raises:
        InputError: naming file, line and setup, what it looks like and what to do.
    """
    if slips := repeat_slips(estimate):
        said = "; ".join(message(estimate.problem, fault) for fault in slips)
        raise InputError(f"{said}; or let close-loop set aside what slipped")


def tool_slips(estimate: Estimate) -> list[Fault]:
    """Return readings of the tool that slipped: that repeats contradict, or all others.

    Raises:
        InputError: as :func:`repeat_slips`.
    """
    problem, found = estimate.problem, repeat_slips(estimate)
    # Far from all others are readings that no repeat contradicts.
    for slip in find_slips(solved_without(estimate, found)):
        setup = int(problem.setup_of_row[slip.rows[0]])
        found.append(Fault("outlier", slip.rows, (setup,), slip.size))
    return found


def repeat_slips(estimate: Estimate) -> list[Fault]:
    """Return single readings of the tool that their repeats contradict.

    Raises:
        InputError: for an instrument that was moved, and repeats that scatter as no readings do,
            naming file, line and setup, what it looks like and what to do.
    """
    problem, first = estimate.problem, len(estimate.problem.leg_setups)
    found, refused = list[Fault](), list[str]()
    for number, (k, factor, setup, _) in enumerate(problem.mounted, first):
        rows = problem.factor_rows[k]
        check = _Setup(factor, setup, estimate.at.seen[k], estimate.residuals[rows])
        slips, trouble = check.fault()
        refused += trouble
        found += [replace(f, rows=f.rows + rows.start, setups=(number,)) for f in slips]
    if refused:
        raise InputError("; ".join(refused))
    return found


def solved_without(estimate: Estimate, faults: Sequence[Fault]) -> Estimate:
    """Return the fit without the rows of faults; the same where there are none."""
    if not faults:
        return estimate
    silent = np.concatenate([f.rows for f in faults])
    rest = with_noise_of_the_rest(without_weight(estimate.problem, silent))
    return solve(rest, method="nested", start=estimate.x)


@dataclass(frozen=True)
class _Setup:
    """Readings of one setup, ``m`` of the ``n`` of a file."""

    factor: Factor  # the file's
    setup: int  # its number
    seen: Seen  # of the fit
    left: Array  # of the fit (n,)

    def fault(self) -> tuple[list[Fault], list[str]]:
        """Single readings that the repeats contradict, or in words what else they do."""
        scatter = self._scatter
        size, usual = self.factor.noise_and_expected(self.setup)
        moved, slips = self._moved(scatter), self._slips(scatter)
        if slips and _evidence(slips) >= moved[0]:
            return slips, []
        if moved[1]:
            return [], moved[1]
        return [], [self._scattered(size)] if size > _BEYOND * usual else []

    @property
    def _scatter(self) -> Scatter:
        """In the order they were taken, about the means of their stations, by what is usual."""
        campaign = self.factor.readings
        order = np.argsort(campaign.order, kind="stable")
        rows = order[campaign.setup[order] == self.setup]
        weight = 1 / self.factor.noise.expected[rows]
        second = np.nan_to_num(campaign.second[rows])
        alike = np.column_stack([campaign.stations, campaign.axis])[rows]
        powers = clock(campaign.time[rows], np.arange(len(rows)))[:, None] ** [1, 2, 3]
        return Scatter(
            self.setup, rows, weight, numbered(np.column_stack([alike, second])),
            np.ones_like(rows), campaign.reading[rows] * weight, powers * weight[:, None],
            self.left[rows] * weight, np.zeros((len(rows), 0)),
        )  # fmt: skip

    def _slips(self, scatter: Scatter) -> list[Fault]:
        """Single readings: of an instrument as sound as its kind but for these, or as noisy as most
        of its stations.
        """
        if scatter.dof < 2:
            return []
        step = float(self.factor.noise.step[scatter.rows].max())
        for scale in dict.fromkeys((1.0, median_scatter([scatter], 1.0))):
            faults = Slips(scatter, scale, step, len(scatter.rows)).confirmed()
            if outliers := [f for f in faults if f.kind == "outlier"]:
                return outliers
        return []

    def _moved(self, scatter: Scatter) -> Evidence:
        """The instrument elsewhere from some moment on, where that leaves nothing unusual of its
        repeats; no slower, if the machine itself may have been warming.
        """
        if scatter.dof < 2 or scatter.chi2 <= _ALIKE * scatter.dof:
            return NOTHING
        count = len(scatter.rows)
        shown = self.factor.nuisances(self.seen).columns[scatter.rows]
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
        times = self.factor.readings.time[scatter.rows]
        slower = self._drifted(scatter, shown) - np.log(count)
        slower += -_NEAR if np.isnan(times).any() else _NEAR
        if not alike or evidence[best] < max(EVIDENCE, slower):
            return NOTHING
        near = places[evidence >= evidence[best] - _NEAR]
        size = _change(scatter, self.factor.readings.reading, int(places[best]))
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
        return self.factor.readings.setups[self.setup].observation.unit

    def _where(self, lines: NDArray[np.int64]) -> str:
        campaign = self.factor.readings
        at = f", line {lines[0]}" if len(lines) == 1 else ""
        at = f", lines {lines.min()} to {lines.max()}" if len(lines) > 1 else at
        return f"{source(campaign)}{at}, setup {campaign.setups[self.setup].name!r}"

    @property
    def _or_lost(self) -> str:
        """What else visits of one place differ by, where nobody knows their sides."""
        if self.factor.approach_known(self.setup):
            return ""
        return f"; or it is lost motion, as {SIDES_UNTOLD}: {TELL_SIDES}"

    def _displaced(self, rows: Rows, size: float) -> str:
        when = "here" if len(rows) == 1 else "one of these"
        return (
            f"{self._where(self.factor.readings.line[rows])}: from {when} on the same places read "
            f"about {size * 1e3:.2g} {self._unit} otherwise than before, as if the instrument, or "
            f"what it stands on, had been moved, or drifted: give the rows from there on a setup "
            f"name of their own, or measure the setup again{self._or_lost}"
        )

    def _scattered(self, size: float) -> str:
        instrument = self.factor.readings.setups[self.setup].observation
        near = ", or to places beside it," if instrument.touches else ""
        return (
            f"{self._where(np.zeros(0, dtype=int))}: visits to the same place{near} scatter by "
            f"{size * 1e3:.2g} {self._unit}, which is no noise of such an instrument: rows were "
            f"exchanged, the readings have another unit, or something is loose; put it right, or "
            f"give repeatability in the machine file under [instrument.{instrument.kind}]"
            f"{self._or_lost}"
        )


def _evidence(faults: Sequence[Fault]) -> float:
    return max(f.evidence for f in faults)


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
