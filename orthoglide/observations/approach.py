"""Direction of each axis' last move, from the sequence of commands, and moves that ensure it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.geometry import Array

Ints = NDArray[np.int64]

MIN_MOVE = 1e-6
"""Smallest move of an axis that counts, metres: sheets are rounded, encoders count microns."""

APPROACH_NOT_RECORDED = "the side of approach is not recorded (approach_* is empty)"
APPROACH_REMEDY = (
    "fill in the approach_* columns, or omit them if the rows are in the order in which they were "
    "measured"
)
"""Clauses for missing approaches: what is missing, and what to do."""

_OVERSHOOT = 1e-3  # metres
_STROKE_DIVISOR = 4  # sheets go to the nearer end of the stroke in this many steps or fewer


@dataclass(frozen=True, eq=False)
class Moves:
    """Commands at which nothing is read, between those of the readings."""

    # mechanical joint coordinates minus the offset r of equation (2) of the 2008 paper (see
    # layout/orthoglide.py) (m, 3), metres
    command: Array = field(default_factory=lambda: np.empty((0, 3)))
    # position in the sequence that readings and moves share (m,)
    order: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    # line in the file (m,), header line 1
    line: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    # distance of a planned move from the command before which it is made, metres
    overshoot: float = _OVERSHOOT

    def __post_init__(self) -> None:
        for values in (self.command, self.order, self.line):
            values.setflags(write=False)

    def __len__(self) -> int:
        return len(self.order)


def stroke_overshoot(stroke: tuple[float, float]) -> float:
    """Return the distance by which a machine passes a command to reach it from a side, metres; it
    is smaller on a short stroke, which has no room for more.
    """
    low, high = stroke
    return min(_OVERSHOOT, min(-low, high) / _STROKE_DIVISOR)


def derive_approach(
    command: ArrayLike, order: ArrayLike, moves: Moves | None = None, min_move: float = MIN_MOVE
) -> Array:
    """Return the direction of each axis' last move, +1 or -1 ``(n, 3)``, from commands ``(n, 3)``,
    metres, their positions in the sequence ``(n,)``, equal ones being one visit, and the moves
    between them.

    An axis keeps its direction until it moves again; before its first move it has the direction +1.
    """
    moves = moves or Moves()
    all_commands, _, sequence = _with_moves(command, order, moves)
    approach = np.empty_like(all_commands)
    for axis, coordinates in enumerate(all_commands[sequence].T.tolist()):
        directions, direction, turning_point = [], 1.0, coordinates[0] if coordinates else 0.0
        for coordinate in coordinates:  # moves too small to count add up
            if abs(coordinate - turning_point) > min_move:
                direction = math.copysign(1.0, coordinate - turning_point)
                turning_point = coordinate
            directions.append(direction)
        approach[sequence, axis] = directions
    return approach[len(moves) :]


def built_up_lost_motion(
    command: ArrayLike, order: ArrayLike, lengths: Sequence[float], moves: Moves | None = None
) -> Array:
    """Return the lost motion of each drive as a fraction of its backlash, between -1/2 and 1/2
    ``(K, n, 3)``; arguments as of `derive_approach`, and lengths ``(K,)``, metres.

    After a reversal it approaches +-1/2, the sign of the approach, exponentially over each length
    (Dahl 1968, *A solid friction model*). At the first row it is half the approach.
    """
    moves = moves or Moves()
    all_commands, positions, sequence = _with_moves(command, order, moves)
    settled = derive_approach(all_commands, positions)[sequence] / 2
    step = np.abs(np.diff(all_commands[sequence], axis=0, prepend=all_commands[sequence][:1]))
    decay = np.exp(-step / np.reshape(lengths, (-1, 1, 1)))
    state = np.broadcast_to(settled, decay.shape).copy()
    for k in range(1, len(settled)):
        state[:, k] += (state[:, k - 1] - settled[k]) * decay[:, k]
    lost_motion = np.empty_like(state)
    lost_motion[:, sequence] = state
    return lost_motion[:, len(moves) :]


def _with_moves(command: ArrayLike, order: ArrayLike, moves: Moves) -> tuple[Array, Ints, Ints]:
    """Return commands ``(m + n, 3)`` and positions of moves and readings, and the indices that
    sort them by position.
    """
    all_commands = np.vstack([moves.command, np.asarray(command, dtype=float).reshape(-1, 3)])
    positions = np.concatenate([moves.order, np.asarray(order)])
    return all_commands, positions, np.argsort(positions, kind="stable")


def planned_moves(
    command: Array, approach: Array, first_of_mounting: ArrayLike, overshoot: float
) -> tuple[Moves, Ints]:
    """Return the moves by which commands, in their order, are reached from the required sides.

    A command that would be reached from the wrong side is preceded by a move to
    ``command - overshoot * approach``. So is the first command of each mounting, because the
    machine may have been moved while the dial was mounted.

    Args:
        command: commands ``(n, 3)``, metres, with room for the overshoot within the stroke.
        approach: required directions ``(n, 3)``; 0 if either direction will do.
        first_of_mounting: whether a row is the first of a mounting ``(n,)``.
        overshoot: distance of the moves from their commands, metres.

    Returns:
        The moves, and the position of each row in the common sequence ``(n,)``.
    """
    previous_command, direction = np.full(3, np.nan), np.zeros(3)
    move_commands: list[Array] = []
    move_orders: list[int] = []
    order: list[int] = []
    for row, first in enumerate(np.asarray(first_of_mounting, dtype=bool).tolist()):
        step = command[row] - previous_command
        arrival = np.where(np.abs(step) > MIN_MOVE, np.sign(step), direction)
        if first or ((arrival != approach[row]) & (approach[row] != 0)).any():
            move_orders.append(len(order) + len(move_orders))
            move_commands.append(command[row] - overshoot * approach[row])
            arrival = approach[row]
        order.append(len(order) + len(move_orders))
        previous_command, direction = command[row], arrival
    position = np.array(move_orders, dtype=np.int64)
    moves = Moves(
        np.round(np.array(move_commands).reshape(-1, 3), 9), position, position + 2, overshoot
    )
    return moves, np.array(order, dtype=np.int64)
