"""Tables of readings made of others: points of the tool, several in one, parts of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError
from orthoglide.instruments import Coordinate, Setup
from orthoglide.observations.approach import Moves
from orthoglide.observations.arrays import READING_ARRAYS
from orthoglide.observations.readings import Readings


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
    m = len(measured)
    if measured.shape != (m, 3):
        raise InputError(f"{name}: p must have shape (m, 3), not {measured.shape}")
    try:
        shown: dict[str, Any] = {
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
        reading=measured[point, axis], by_point=True, **{k: v[point] for k, v in shown.items()},
        **more,
    )  # fmt: skip


Readings.from_points = staticmethod(from_points)


def concatenated(several: Sequence[Readings], name: str = "") -> Readings:
    """Return one table of several, in their order, which keep their sequences one behind the other.

    Args:
        several: with setups of different names.
        name: of the table; that of the first where absent.

    Raises:
        InputError: where two setups have one name, or the readings are of different machines.
    """
    if not several:
        raise InputError("there are no readings: give at least one table of them")
    if len({one.legs for one in several}) > 1:
        raise InputError(
            "one table is of one machine, and these call their legs otherwise: keep readings of "
            "different machines apart"
        )
    given = _renumber_lines(renumber_orders(several))
    first = np.cumsum([0, *(len(one.setups) for one in given)])
    each = zip(given, first, strict=False)
    arrays: dict[str, Any] = {
        key: np.concatenate([getattr(one, key) for one in given]) for key in READING_ARRAYS
    }
    arrays["setup"] = np.concatenate([one.setup + shift for one, shift in each])
    gone: dict[str, Any] = {
        key: np.concatenate([getattr(one.moves, key) for one in given])
        for key in ("command", "order", "line")
    }
    moves = replace(given[0].moves, **gone)
    return replace(
        given[0],
        **arrays,
        name=name or given[0].name,
        setups=tuple(s for one in given for s in one.setups),
        posture=tuple(label for one in given for label in one.posture),
        warnings=tuple(dict.fromkeys(w for one in given for w in one.warnings)),
        moves=moves,
        by_point=all(one.by_point for one in given),
    )


Readings.concatenated = staticmethod(concatenated)


def renumber_orders(given: Sequence[Readings]) -> list[Readings]:
    """Return the same readings, the order of each behind that of the one before."""
    found, last = list[Readings](), 0
    for one in given:
        order = np.concatenate([one.order, one.moves.order])
        shift = last + 1 - order.min(initial=last + 1) if found else 0
        moves = replace(one.moves, order=one.moves.order + shift)
        found.append(replace(one, order=one.order + shift, moves=moves))
        last = (order + shift).max(initial=last)
    return found


def _renumber_lines(given: Sequence[Readings]) -> list[Readings]:
    """Return the same readings, the lines of those that are of no file behind all before them."""
    found, last = list[Readings](), 0
    for one in given:
        lines = np.concatenate([one.line, one.moves.line])
        shift = 0 if one.file else max(last + 1 - lines.min(initial=last + 1), 0)
        moves = replace(one.moves, line=one.moves.line + shift)
        found.append(replace(one, line=one.line + shift, moves=moves))
        last = max(last, lines.max(initial=0) + shift)
    return found


def split_legs_and_tool(given: Readings) -> tuple[Readings, ...]:
    """Return readings of legs and of the tool apart, the latter called ``NAME-tool`` where there
    are both; the moves go with those of legs.
    """
    on_legs = given.on_legs
    if on_legs.all() or not on_legs.any():
        return (given,)
    legs, tool = given.subset(on_legs), given.subset(~on_legs)
    return legs, replace(tool, name=f"{given.name}-tool", moves=Moves(), warnings=())
