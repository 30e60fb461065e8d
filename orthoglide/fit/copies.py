"""Readings that are there twice: repeats that were copied, files given under two names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from orthoglide.fit.repeats import repeat_steps
from orthoglide.observations import Readings

_FEWEST = 6  # repeats that are too few to say they are copies


def copied(campaign: Readings) -> int:
    """Number of repeats, where each is the same to the last digit as the visit before; else 0."""
    alike = repeat_steps(campaign) == 0
    return len(alike) if len(alike) >= _FEWEST and alike.all() else 0


def repeated_points(points: Readings) -> tuple[int, ...]:
    """Lines whose point an earlier line has too, to the last digit of command and coordinates."""
    of = points.points()
    rows = np.nan_to_num(np.hstack([of.command, of.approach, of.p]))
    first = np.unique(rows, axis=0, return_index=True)[1]
    return tuple(np.delete(of.line, first).tolist())


def shared(one: Readings, other: Readings) -> float:
    """Share of readings that another table has too: the same value, instrument and command."""

    def rows(given: Readings) -> set[tuple[object, ...]]:
        of = [
            (s.kind, s.leg, s.gauge, s.gauge2, s.bar)
            for s in (given.setups[k] for k in given.setup)
        ]
        numbers = np.column_stack(
            [given.axis, given.sign, given.command, np.nan_to_num(given.second), given.repeat,
             given.reading]
        )  # fmt: skip
        return {(*what, *values) for what, values in zip(of, numbers.tolist(), strict=True)}

    own = rows(one)
    return len(own & rows(other)) / max(len(own), 1)


def twice(several: Sequence[Readings]) -> Iterator[str]:
    """A sentence for each file whose readings are all those of an earlier one."""
    for k, one in enumerate(several):
        for other in several[:k]:
            if len(one) == len(other) and shared(one, other) == 1.0:
                yield (
                    f"the readings of {one.name} are those of {other.name} to the last digit: a "
                    f"copy tells nothing that the other does not, so leave one of them out"
                )
                break
