"""Readings that occur twice: repeat visits to a station, copied rows, and copies of files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.observations.readings import Readings

_MIN_EQUAL_REPEATS = 6  # equal repeats: fewer may be equal by chance


def repeat_rows(campaign: Readings) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of all repeat readings, by station, and those of the visits before them,
    both ``(k,)``.
    """
    table = campaign.stations
    order = np.lexsort([campaign.order, *table.T[::-1]])
    is_repeat = np.all(np.diff(table[order], axis=0) == 0, axis=1)
    return order[1:][is_repeat], order[:-1][is_repeat]


def repeat_steps(campaign: Readings) -> Array:
    """Return each repeat reading minus the reading of the visit before ``(k,)``, metres."""
    later, before = repeat_rows(campaign)
    return np.asarray(campaign.reading[later] - campaign.reading[before])


def count_copied_repeats(campaign: Readings) -> int:
    """Return the number of repeats if each equals the visit before to the last digit, else 0."""
    equal = repeat_steps(campaign) == 0
    return len(equal) if len(equal) >= _MIN_EQUAL_REPEATS and equal.all() else 0


def copied_point_lines(table: Readings) -> tuple[int, ...]:
    """Return the lines whose command and coordinates equal those of an earlier line."""
    points = table.points()
    rows = np.nan_to_num(np.hstack([points.command, points.approach, points.p]))
    first = np.unique(rows, axis=0, return_index=True)[1]
    return tuple(np.delete(points.line, first).tolist())


def shared_fraction(table: Readings, other: Readings) -> float:
    """Return the fraction of a table's readings, 0 to 1, that another table contains with the same
    value, instrument and command.
    """

    def keys(readings: Readings) -> set[tuple[object, ...]]:
        setups = (readings.setups[k] for k in readings.setup)
        instruments = [(s.kind, s.leg, s.gauge, s.gauge2, s.bar) for s in setups]
        numbers = np.column_stack(
            [readings.axis, readings.sign, readings.command, np.nan_to_num(readings.second),
             readings.repeat, readings.reading]
        )  # fmt: skip
        pairs = zip(instruments, numbers.tolist(), strict=True)
        return {(*instrument, *values) for instrument, values in pairs}

    keys_of_table = keys(table)
    return len(keys_of_table & keys(other)) / max(len(keys_of_table), 1)


def copied_files(tables: Sequence[Readings]) -> Iterator[str]:
    """Yield a sentence for each file whose readings all equal those of an earlier file."""
    for k, table in enumerate(tables):
        for other in tables[:k]:
            if len(table) == len(other) and shared_fraction(table, other) == 1.0:
                yield (
                    f"the readings of {table.name} are those of {other.name} to the last digit: a "
                    f"copy adds no information, so leave one of them out"
                )
                break
