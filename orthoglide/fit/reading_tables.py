"""Readings of a fit, as tables for figures and reports."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.geometry import LEGS, Array
from orthoglide.observations import Readings
from orthoglide.result import Mounting, ReadingsShown
from orthoglide.result.display import Numbers

_MIN_TRAVEL = 1e-3  # metres: setups with less travel are drawn in the order of the file


def fitted_readings(
    problem: Problem, nominal: Array, before: Array, after: Array,
    requested: tuple[Readings, ...] = (),
) -> ReadingsShown:  # fmt: skip
    """Return measured and predicted readings, setup by setup.

    Args:
        problem: that was solved, with ``n`` readings.
        nominal: readings predicted by the uncalibrated machine ``(n,)``, metres or radians.
        before: by the base model.
        after: by the last fit.
        requested: readings of the request, of which the problem uses a part; if empty, all.
    """
    tables = [factor.readings for factor in problem.factors]
    rows = [row_indices(*pair) for pair in zip(tables, requested or tables, strict=True)]
    return ReadingsShown(
        mountings=tuple(_mountings(problem)),
        file=np.repeat(np.arange(len(tables)), [len(part) for part in tables]),
        row=np.concatenate(rows),
        measured=problem.measured,
        sigma=problem.sigma,
        nominal=nominal,
        before=before,
        after=after,
    )


def row_indices(part: Readings, whole: Readings) -> Numbers:
    """Return the row of each reading of ``part`` within ``whole`` ``(n,)``, matched by line and
    order, and by axis where a line has several; both are in the order of the file.

    The axis of a dial does not identify its reading, because a wrong label may have been corrected.
    """

    def keys(table: Readings) -> Iterator[tuple[int, int, int]]:
        axis = table.axis if whole.by_point else np.zeros_like(table.line)
        return zip(table.line.tolist(), table.order.tolist(), axis.tolist(), strict=True)

    places: dict[tuple[int, int, int], deque[int]] = defaultdict(deque)
    for k, key in enumerate(keys(whole)):
        places[key].append(k)
    return np.array([places[key].popleft() for key in keys(part)], dtype=np.int64)


def _mountings(problem: Problem) -> Iterator[Mounting]:
    """Yield all setups of a problem, in their order; of TCP points their coordinates."""
    several_files = len(problem.campaigns) > 1
    for factor, factor_slice in zip(problem.factors, problem.factor_rows, strict=True):
        readings = factor.readings
        for k, setup in enumerate(readings.setups):
            chosen = np.flatnonzero(factor.setup == k)
            if not len(chosen):
                continue
            x: Array = np.arange(1.0, len(chosen) + 1)
            if setup.leg >= 0:
                leg = setup.leg
                travel = readings.command[chosen, leg] - problem.machine.geometry.zero[leg]
                moves = np.ptp(travel) > _MIN_TRAVEL
                name = _setup_label(readings.name, setup.name) if several_files else setup.name
                title = f"{name}: leg {LEGS[leg]}, read along {setup.direction}"
                label = f"travel of carriage {LEGS[leg]}, mm" if moves else "place in the file"
                x = travel * 1e3 if moves else readings.order[chosen].astype(float)
            else:
                name, label = _setup_label(readings.name, setup.name), "reading"
                title = f"{name}, {setup.kind}"
            rows = (factor_slice.start + chosen).astype(np.int64)
            unit = setup.observation.unit
            setup_name = "" if readings.by_point else setup.name
            yield Mounting(setup_name, name, title, label, rows, x, unit)


def _setup_label(file: str, setup: str) -> str:
    """Return the label of a setup: its file's name, and its own unless that contains it."""
    return file if setup in file else f"{file} · {setup}"
