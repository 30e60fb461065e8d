"""Readings that follow a residual without an explanation, taken where the residual is largest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orthoglide.explanation import FullPosterior
from orthoglide.geometry import LEGS, Geometry
from orthoglide.instruments import OBSERVATIONS
from orthoglide.observations.protocols import unread
from orthoglide.planning.pool import reading_pool
from orthoglide.planning.suggestions import Suggestion
from orthoglide.result import DataRival, SetupResidual

_TWICE = 2  # visits: a single one may be misread
_NEIGHBOURS = 3  # distances from a posture: itself, and those next to it
_MID = 0.5  # of the leg


def tracing(rest: SetupResidual, geometry: Geometry) -> Suggestion:
    """Return a sheet for the dial whose residual is largest; no rival explanation is needed.

    Both bars of the leg are touched along the direction in which most is left, at every step of its
    travel, reached from both sides: a curve tells a bend from a tilt, two sides lost motion, two
    bars a twist from a shift.
    """
    pool = reading_pool(geometry)
    gauge = _MID * geometry.L
    dials = [
        k
        for k, s in enumerate(pool.setups)
        if (s.leg, s.axis) == (rest.leg, rest.axis) and s.bar and abs(s.gauge - gauge) < 1e-6
    ]
    own = [axis for axis in range(3) if axis != rest.leg]
    along = np.ptp(pool.command[:, own], axis=1) < 1e-6  # the other two stand alike: on the axis
    rows = np.flatnonzero(np.isin(pool.setup, dials) & along)
    axis = LEGS[rest.axis]
    reason = (
        f"the residual is largest on {rest.reads}: take {len(rows) * _TWICE} readings of both "
        f"bars of the leg along {axis}, over its whole travel and from both sides, which "
        f"distinguish a bent part, a turned part, lost motion and a wrong bar"
    )
    return Suggestion(reason, "trace", float("nan"), pool, tuple(np.repeat(rows, _TWICE).tolist()))


def repeating(rest: SetupResidual) -> Suggestion:
    """Return the advice to repeat the readings of an instrument at the tool at the places where its
    residual is largest.
    """
    own = OBSERVATIONS[rest.kind]
    sides = "" if own.touches or own.paired else " and coming from either side"
    reason = (
        f"the residual is largest in {rest.reads} ({rest.setup}): read it again with the tool at "
        f"{'; '.join(rest.where)} mm, three times each{sides}. If the error repeats, the machine "
        f"or what the instrument stands on causes it; if not, look for a loose part, lost motion "
        f"or a faulty instrument"
    )
    return Suggestion(reason, "trace", float("nan"), None)


def deciding_visits(posterior: FullPosterior, fault: DataRival) -> Suggestion | None:
    """Return the advice to visit a posture and its neighbours again, where its readings show either
    a defect of the machine at one place or a fault of the data; ``None`` where no dial was read.

    A defect comes again and is smaller beside the place; a wrong command or a slip does not come
    again.
    """
    problem = posterior.about.problem
    table = next(f.readings for f in problem.factors if fault.rows[0] in f.readings.line)
    own = np.flatnonzero(np.isin(table.line, fault.rows) & table.on_legs)
    if not len(own):
        return None
    rows = np.flatnonzero(np.isin(table.setup, table.setup[own]))
    apart = np.linalg.norm(table.command[rows] - table.command[own[0]], axis=1).round(6)
    near = rows[np.isin(apart, np.unique(apart)[:_NEIGHBOURS])]
    visits = np.column_stack([table.stations[near], table.approach[near]])
    once = table.subset(np.sort(near[np.unique(visits, axis=0, return_index=True)[1]]))
    setups = [replace(s, name=f"{s.name}-line-{fault.rows[0]}") for s in once.setups]
    pool = unread(
        posterior.machine.geometry, "next", setups, once.setup, once.command, once.approach,
        posture=once.posture,
    )  # fmt: skip
    reason = (
        f"the posture of line {fault.rows[0]} and the nearest postures once more, "
        f"{len(pool) * _TWICE} readings, each command entered anew: a defect of the machine "
        f"appears again, a slip or a wrong command does not"
    )
    chosen = np.repeat(np.arange(len(pool)), _TWICE)
    return Suggestion(reason, "trace", float("nan"), pool, tuple(chosen.tolist()))
