"""The readings of a fit as figures and tables show them."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.geometry import LEGS, Array
from orthoglide.observations import Readings
from orthoglide.result import Mounting, ReadingsShown
from orthoglide.result.display import Numbers

if TYPE_CHECKING:
    from orthoglide.fit.estimate import Estimate

_MIN_TRAVEL = 1e-3  # metres of travel from which a setup is drawn over it


def fitted_readings(
    fit: Estimate, base: Estimate, given: tuple[Readings, ...] = ()
) -> ReadingsShown:
    """Return measured and predicted readings, setup by setup.

    Args:
        fit: the last fit.
        base: fit of the base model to the same readings.
        given: readings of the request, of which ``fit`` uses a part; if empty, it uses all.
    """
    problem = fit.problem
    tables = [factor.readings for factor in problem.factors]
    rows = [row_indices(some, all_) for some, all_ in zip(tables, given or tables, strict=True)]
    return ReadingsShown(
        mountings=tuple(_mountings(problem)),
        file=np.repeat(np.arange(len(tables)), [len(some) for some in tables]),
        row=np.concatenate(rows),
        station=problem.station.astype(np.int64),
        measured=problem.measured,
        sigma=problem.sigma,
        common=problem.common,
        nominal=base.predicted_before,
        before=base.predicted,
        after=fit.predicted,
    )


def row_indices(part: Readings, whole: Readings) -> Numbers:
    """Return the row of each reading of ``part`` within ``whole`` ``(n,)``, matched by line and
    axis; both are in the order of the file.
    """
    places: dict[tuple[int, int], deque[int]] = defaultdict(deque)
    for k, key in enumerate(zip(whole.line.tolist(), whole.axis.tolist(), strict=True)):
        places[key].append(k)
    keys = zip(part.line.tolist(), part.axis.tolist(), strict=True)
    return np.array([places[key].popleft() for key in keys], dtype=np.int64)


def _mountings(problem: Problem) -> Iterator[Mounting]:
    """All setups of a problem, in their order; of TCP points their coordinates."""
    several = len(problem.campaigns) > 1
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        read = factor.readings
        for k, setup in enumerate(read.setups):
            there = np.flatnonzero(factor.setup == k)
            if not len(there):
                continue
            x: Array = np.arange(1.0, len(there) + 1)
            side: Array = np.zeros(len(there))
            if setup.leg >= 0:
                leg = setup.leg
                travel = read.command[there, leg] - problem.machine.geometry.zero[leg]
                moves = np.ptp(travel) > _MIN_TRAVEL
                name = _setup_label(read.name, setup.name) if several else setup.name
                title = f"{name}: leg {LEGS[leg]}, read along {setup.direction}"
                label = f"travel of carriage {LEGS[leg]}, mm" if moves else "place in the file"
                x = travel * 1e3 if moves else read.order[there].astype(float)
                side = read.approach[there, leg].astype(float)
            else:
                name, label = _setup_label(read.name, setup.name), "reading"
                title = f"{name}, {setup.kind}"
            rows = (part.start + there).astype(np.int64)
            unit = setup.observation.unit
            own = "" if read.by_point else setup.name
            yield Mounting(own, name, title, label, rows, x, side, unit)


def _setup_label(file: str, setup: str) -> str:
    """A setup by its file, whose name may have it already."""
    return file if setup in file else f"{file} · {setup}"
