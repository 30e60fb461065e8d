"""Choosing readings: greedy, then every mounting in turn taken out and chosen again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from orthoglide.errors import InputError
from orthoglide.ordering import largest
from orthoglide.planning.criteria import Criterion
from orthoglide.planning.linear import LinearReadings

C = TypeVar("C", bound=Criterion)

_PASSES = 2
_MOST = 500  # readings of a sheet: a day's work, and some minutes to choose
_BETTER = 1e-6  # of a criterion's value: an exchange that gains less is none
_NOTHING = 1e-9  # gain below which a step is not worth a reading


def choose(
    readings: LinearReadings,
    start: C,
    count: int,
    *,
    mounting: float = 2.0,
    exchange: bool = False,
) -> tuple[tuple[int, ...], C]:
    """Readings that serve a criterion best.

    Args:
        readings: to choose from.
        start: the criterion before any is taken.
        count: how many readings at most.
        mounting: what it costs to mount a dial and take its first two readings, in readings.
        exchange: whether to try again mounting by mounting, until nothing improves.

    Returns:
        Rows of the pool, with repetitions, and the criterion with them.

    Raises:
        InputError: for a number of readings that is not whole, fewer than two, or more than anybody
            reads.
    """
    if count != int(count):
        raise InputError(f"readings are counted: ask for {int(count)}, not {count}")
    if count < 2:
        raise InputError(
            f"a setup needs two readings, as its datum is free: ask for 2, not {count}"
        )
    if count > _MOST:
        raise InputError(f"nobody reads a sheet of {count}: ask for {_MOST} at most")
    rows, best = _grow(readings, start, [], count, mounting)
    for _ in range(_PASSES if exchange else 0):
        before = best.value
        for setup in dict.fromkeys(int(readings.campaign.setup[k]) for k in rows):
            kept = [k for k in rows if readings.campaign.setup[k] != setup]
            again, found = _grow(readings, start.with_rows(readings, kept), kept, count, mounting)
            if found.value > best.value + _BETTER * abs(best.value):
                rows, best = again, found
        if best.value - before <= _BETTER * abs(before):
            break
    return tuple(rows), best


def _grow(
    readings: LinearReadings, criterion: C, rows: Sequence[int], count: int, mounting: float
) -> tuple[list[int], C]:
    """Take the step of most gain for its cost until the readings are used up."""
    taken = list(rows)
    while len(taken) < count and not (taken and criterion.reached):
        steps = readings.steps(taken, count - len(taken))
        if not len(steps.rows):
            break
        gains = criterion.gains(steps)
        worth = gains / np.where(steps.opening, mounting, 1.0)
        k = largest(worth)
        if not gains[k] > _NOTHING:
            break
        criterion = criterion.after(steps, k)
        taken += steps.taken(k)
    return taken, criterion
