"""Tables of readings from points or several tables; readings and files that occur twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.arguments import public
from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.instruments import Coordinate, Setup
from orthoglide.observations.approach import Moves
from orthoglide.observations.arrays import READING_ARRAYS, source
from orthoglide.observations.readings import Readings
from orthoglide.text import printable_path


@public
def from_points(
    command: ArrayLike,
    p: ArrayLike,
    sigma: ArrayLike = np.nan,
    approach: ArrayLike = 0.0,
    line: ArrayLike | None = None,
    *,
    name: str = "points",
    **more: Any,
) -> Readings:
    """Return measured positions of the tool as readings of kind ``tcp``.

    Args:
        command: commanded joint coordinates ``(m, 3)``, metres, r removed.
        p: measured ``(m, 3)``, metres; nan where a coordinate is missing.
        sigma: standard deviation of a coordinate ``(m,)``, metres; nan where none is declared.
        approach: direction of each axis' last move ``(m, 3)``; 0: the middle of the dead band.
        line: line in the file ``(m,)``; from 2 on where absent.
        name: of the readings.
        more: further attributes of :class:`Readings`.

    Raises:
        InputError: where the arrays do not fit together.
    """
    measured = np.asarray(p, dtype=float)
    m = len(np.atleast_1d(measured))
    if measured.shape != (m, 3):
        raise InputError(f"{name}: p must have shape (m, 3), not {measured.shape}")
    try:
        arrays: dict[str, Any] = {
            "command": np.broadcast_to(np.asarray(command, float), (m, 3)),
            "approach": np.broadcast_to(np.asarray(approach, float), (m, 3)),
            "sigma": np.broadcast_to(np.asarray(sigma, float), m),
            "line": np.arange(2, m + 2) if line is None else np.broadcast_to(np.asarray(line), m),
        }
    except ValueError:
        raise InputError(f"{name}: there must be as many commands as points, {m}") from None
    read = ~np.isnan(measured)
    if not (any_read := read.any(axis=1)).all():
        row = int(np.argmin(any_read))
        raise InputError(f"{name}: row {row} (counted from 0) has no coordinate: leave it out")
    point, axis = np.nonzero(read)
    setups = (Setup("points", kind=Coordinate.kind),) if len(point) else ()
    return Readings(
        name=name, setups=setups, setup=np.zeros_like(point), axis=axis, order=point,
        reading=measured[point, axis], by_point=True, **{k: v[point] for k, v in arrays.items()},
        **more,
    )  # fmt: skip


Readings.from_points = staticmethod(from_points)


@public
def concatenated(several: Sequence[Readings]) -> Readings:
    """Return one table of several, whose sequences follow each other, named as the first.

    Args:
        several: tables whose setups have different names.

    Raises:
        InputError: if two setups have one name, or the readings are of different machines.
    """
    if not several:
        raise InputError("there are no readings: give at least one table of them")
    if len({part.legs for part in several}) > 1:
        raise InputError(
            "one table is of one machine, and these call their legs otherwise: keep readings of "
            "different machines apart"
        )
    tables = renumbered(renumbered(several, "order"), "line")
    arrays = _stacked(tables, READING_ARRAYS)
    first_setup = np.cumsum([0, *(len(part.setups) for part in tables)])
    arrays["setup"] += np.repeat(first_setup[:-1], [len(part) for part in tables])
    moves = _stacked([part.moves for part in tables], ("command", "order", "line"))
    return replace(
        tables[0],
        **arrays,
        setups=tuple(s for part in tables for s in part.setups),
        posture=tuple(label for part in tables for label in part.posture),
        warnings=tuple(dict.fromkeys(w for part in tables for w in part.warnings)),
        moves=replace(tables[0].moves, **moves),
        by_point=all(part.by_point for part in tables),
    )


Readings.concatenated = staticmethod(concatenated)


def _stacked(parts: Sequence[Any], names: Iterable[str]) -> dict[str, Any]:
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}


def renumbered(tables: Sequence[Readings], name: Literal["order", "line"]) -> list[Readings]:
    """Return the tables with orders or lines that follow each other; lines of files are kept, and
    others only move back.
    """
    following, last = list[Readings](), 0
    for readings in tables:
        numbers, of_moves = getattr(readings, name), getattr(readings.moves, name)
        both = np.concatenate([numbers, of_moves])
        shift = last + 1 - both.min(initial=last + 1)
        if name == "line":
            shift = 0 if readings.file else max(shift, 0)
        elif not following:
            shift = 0
        moves: Moves = replace(readings.moves, **{name: of_moves + shift})
        following.append(replace(readings, **{name: numbers + shift, "moves": moves}))
        last = (both + shift).max(initial=last)
    return following


def split_legs_and_tool(readings: Readings) -> tuple[Readings, ...]:
    """Return separate tables of readings of legs, with the moves, and of the tool, which is named
    ``NAME-tool`` if there are both.
    """
    on_legs = readings.on_legs
    if on_legs.all() or not on_legs.any():
        return (readings,)
    legs, tool = readings.subset(on_legs), readings.subset(~on_legs)
    return legs, replace(tool, name=f"{readings.name}-tool", moves=Moves(), warnings=())


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


def with_distinct_sources(tables: Sequence[Readings]) -> list[Readings]:
    """Return the tables, with labels on those that messages could not distinguish.

    A label contains as many folders as distinguish files of equal name, and the table's name if
    several tables come from one file.
    """
    same_source = [
        [other for other in tables if source(other) == source(table)] if table.file else [table]
        for table in tables
    ]
    return [
        replace(table, label=_distinct_label(table, group)) if len(group) > 1 else table
        for table, group in zip(tables, same_source, strict=True)
    ]


def _distinct_label(table: Readings, group: Sequence[Readings]) -> str:
    """Return the label of a table among tables of files of one name; readings of legs and of the
    tool in one file are one table for messages.
    """
    parts = PurePath(table.file).parts
    others = [PurePath(other.file).parts for other in group if other.file != table.file]
    count = next(
        (k for k in range(1, len(parts)) if all(other[-k:] != parts[-k:] for other in others)),
        len(parts),
    )
    path = printable_path(PurePath(*parts[-count:]))
    names = {o.name for o in group if o.file == table.file and o.of_tool == table.of_tool}
    return f"{path} ({table.name})" if len(names) > 1 else path


def copied_files(tables: Sequence[Readings]) -> Iterator[str]:
    """Yield a sentence for each file whose readings all equal those of an earlier file."""
    tables = with_distinct_sources(tables)
    for k, table in enumerate(tables):
        for other in tables[:k]:
            if len(table) == len(other) and shared_fraction(table, other) == 1.0:
                yield (
                    f"the readings of {source(table)} are those of {source(other)} to the last "
                    f"digit: a copy adds no information, so leave one of them out"
                )
                break
