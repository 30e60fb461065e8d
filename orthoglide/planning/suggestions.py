"""Suggestions of readings to take next, and those for a residual without an explanation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from orthoglide.explanation import FullPosterior
from orthoglide.frames import Framed
from orthoglide.geometry import LEGS, Geometry
from orthoglide.instruments import OBSERVATIONS
from orthoglide.observations import Moves, Readings, campaign_rows, source
from orthoglide.observations.approach import stroke_overshoot
from orthoglide.planning.sheets import reading_pool, sheet_from_pool
from orthoglide.result import DataRival, SetupResidual

Aim = Literal["separate", "narrow", "trace", "none"]

DECISIVE_SIGMAS = 2.0  # sigmas: a chi2 of 4; less leaves both in one credible set
_VISITS = 2  # visits: a single one may be misread
_NEIGHBOUR_DISTANCES = 3  # distances from a posture: itself, and those next to it
_GAUGE_FRACTION = 0.5  # of the leg


@dataclass(frozen=True)
class Suggestion(Framed):
    """A few readings to take, and why.

    Attributes:
        reason: purpose and expected result, in words.
        aim: ``separate`` rivals; ``narrow`` a weak direction; ``trace`` an unexplained residual or
            a doubtful reading; ``none`` if no sheet is proposed, although another instrument may
            help.
        gain: separation of rivals in sigmas, the least of all pairs, or by another instrument the
            largest; of a direction the ratio of its standard deviations; nan for ``trace``.
        pool: the readings to choose from; ``None`` where another instrument is what helps.
        chosen: rows of the pool, with repetitions; none where nothing helps.
        what: what to measure, without the expected result; empty where that is the whole reason.
    """

    reason: str
    aim: Aim
    gain: float
    pool: Readings | None
    chosen: tuple[int, ...] = ()
    what: str = ""

    @property
    def campaign(self) -> Readings | None:
        """The readings without their values; ``None`` if no reading helps."""
        if not self.chosen or self.pool is None:
            return None
        return sheet_from_pool(self.pool, self.chosen)

    @property
    def hopeless(self) -> bool:
        """True if no reading helps."""
        return self.aim == "none" and self.gain < DECISIVE_SIGMAS

    def __repr__(self) -> str:
        count = len(self.chosen)
        readings = f", {count} reading{'s' * (count > 1)}" if count else " of no reading"
        return f"<Suggestion{readings}: {self.reason}>"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The rows of a campaign file by column; empty if no reading helps."""
        rows = self.rows
        return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}

    @property
    def rows(self) -> tuple[dict[str, str], ...]:
        """The rows of a campaign file, moves included, without the reading."""
        if self.campaign is None:
            return ()
        table = campaign_rows(self.campaign)
        return tuple({k: v for k, v in row.items() if k != "reading_mm"} for row in table)


def next_sheet(suggestions: Sequence[Suggestion]) -> Readings | None:
    """Return one measuring sheet for all suggestions of a run; ``None`` where nothing helps.

    A visit that serves two purposes stands once.
    """
    pools: dict[tuple[Any, ...], Readings] = {}
    visits: dict[tuple[Any, ...], Counter[int]] = {}
    for suggestion in suggestions:
        pool = suggestion.pool
        if pool is not None and suggestion.chosen:
            key = (*pool.setups, len(pool))
            pools.setdefault(key, pool)
            visits[key] = visits.get(key, Counter()) | Counter(suggestion.chosen)
    sheets = [sheet_from_pool(pools[k], tuple(counts.elements())) for k, counts in visits.items()]
    return Readings.concatenated(sheets) if sheets else None


def _trace_suggestion(
    reason: str, pool: Readings | None = None, rows: Sequence[int] = ()
) -> Suggestion:
    """Return a ``trace`` suggestion; rows of a pool that are given are visited twice."""
    visits = np.repeat(np.asarray(rows, dtype=int), _VISITS)
    return Suggestion(reason, "trace", float("nan"), pool, tuple(visits.tolist()))


def suggest_tracing(residual: SetupResidual, geometry: Geometry) -> Suggestion:
    """Return a sheet for the dial whose residual is largest; no rival explanation is needed.

    Both bars of the leg are touched along the direction of the largest residual, at every step of
    its travel, reached from both sides. A curve distinguishes a bend from a tilt, two sides show
    lost motion, and two bars distinguish a twist from a shift.
    """
    pool = reading_pool(geometry)
    gauge = _GAUGE_FRACTION * geometry.L
    dial = residual.leg, residual.axis
    setups = [
        k for k, s in enumerate(pool.setups)
        if (s.leg, s.axis) == dial and s.bar and abs(s.gauge - gauge) < 1e-6
    ]  # fmt: skip
    others = [axis for axis in range(3) if axis != residual.leg]
    # The two other drives have equal commands: the TCP is on the leg's axis.
    on_axis = np.ptp(pool.command[:, others], axis=1) < 1e-6
    rows = np.flatnonzero(np.isin(pool.setup, setups) & on_axis)
    axis = LEGS[residual.axis]
    reason = (
        f"the residual is largest on {residual.reads}, so take {len(rows) * _VISITS} readings of "
        f"both bars of the leg along {axis}, over its whole travel and from both sides, which "
        f"distinguish a bent part, a turned part, lost motion and a wrong bar"
    )
    return _trace_suggestion(reason, pool, rows.tolist())


def suggest_repeating(residual: SetupResidual) -> Suggestion:
    """Return the advice to repeat readings of the tool where the residual is largest."""
    instrument = OBSERVATIONS[residual.kind]
    sides = "" if instrument.touches or instrument.paired else " and coming from either side"
    return _trace_suggestion(
        f"the residual is largest in {residual.reads} ({residual.setup}), so read it again with "
        f"the tool at {'; '.join(residual.where)} mm, three times each{sides}. If the error "
        f"repeats, the machine or what the instrument stands on causes it; if not, look for a "
        f"loose part, lost motion or a faulty instrument"
    )


def suggest_deciding_visits(posterior: FullPosterior, fault: DataRival) -> Suggestion:
    """Return the advice to repeat a reading that shows a defect of the machine or a data fault: at
    its posture and the neighbours for dials, else the reading itself.

    A defect appears again and is smaller at neighbouring postures; a slip or a wrong command does
    not appear again.
    """
    problem = posterior.linearised.problem
    tables = (f.readings for f in problem.factors if source(f.readings) == fault.file)
    table = next(t for t in tables if fault.rows[0] in t.line)
    faulty_rows = np.flatnonzero(np.isin(table.line, fault.rows) & table.on_legs)
    if not len(faulty_rows):
        several = len(set(fault.rows)) > 1
        settled = ", in the same order and after the instrument has settled" if several else ""
        return _trace_suggestion(
            f"{fault.lines} of {fault.file} once more{settled}: a defect of the machine appears "
            f"again, {'a move or a drift of the instrument' if several else 'a slip'} does not"
        )
    rows = np.flatnonzero(np.isin(table.setup, table.setup[faulty_rows]))
    distances = np.linalg.norm(table.command[rows] - table.command[faulty_rows[0]], axis=1).round(6)
    nearest = rows[np.isin(distances, np.unique(distances)[:_NEIGHBOUR_DISTANCES])]
    visits = np.column_stack([table.stations[nearest], table.approach[nearest]])
    first = table.subset(np.sort(nearest[np.unique(visits, axis=0, return_index=True)[1]]))
    setups = tuple(replace(s, name=f"{s.name}-line-{fault.rows[0]}") for s in first.setups)
    overshoot = stroke_overshoot(posterior.machine.geometry.stroke)
    pool = Readings(
        "next", setups, first.setup, first.command, np.full(len(first), np.nan), first.approach,
        posture=first.posture, moves=Moves(overshoot=overshoot),
    )  # fmt: skip
    reason = (
        f"the posture of line {fault.rows[0]} and the nearest postures once more, "
        f"{len(pool) * _VISITS} readings, each command entered anew: a defect of the machine "
        f"appears again, a slip or a wrong command does not"
    )
    return _trace_suggestion(reason, pool, range(len(pool)))
