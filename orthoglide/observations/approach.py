"""Which way each axis moved last, from the sequence of commands; and moves that see to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.geometry import Array

Ints = NDArray[np.int64]

MIN_MOVE = 1e-6
"""An axis counts as moved beyond this, in metres: sheets are rounded, encoders count microns."""

APPROACH_NOT_RECORDED = "the side of approach is not recorded (approach_* is empty)"
APPROACH_REMEDY = (
    "fill it in, or leave these columns out of a file that was gone through row by row"
)
"""What is lacking where nobody knows how a place was come to, and what to do, as clauses."""

_OVERSHOOT = 1e-3  # metres
_STROKE_DIVISOR = 4  # of the way to the nearer end: sheets go there in as many steps, or fewer


@dataclass(frozen=True, eq=False)
class Moves:
    """Commands that the machine goes through without a reading being taken."""

    # joint coordinates (m, 3), metres, r removed
    command: Array = field(default_factory=lambda: np.empty((0, 3)))
    # place in the sequence that readings and moves share (m,)
    order: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    # line in the file (m,), header line 1
    line: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    # how far moves that are planned go beyond a command to reach it from a side, metres
    overshoot: float = _OVERSHOOT

    def __post_init__(self) -> None:
        for values in (self.command, self.order, self.line):
            values.setflags(write=False)

    def __len__(self) -> int:
        return len(self.order)


def stroke_overshoot(stroke: tuple[float, float]) -> float:
    """How far beyond a command a machine goes to reach it from a side, metres.

    On a short stroke it is less than elsewhere: else there would be no room for it.

    Args:
        stroke: travel limits of the machine, metres.
    """
    low, high = stroke
    return min(_OVERSHOOT, min(-low, high) / _STROKE_DIVISOR)


def derive_approach(
    command: ArrayLike, order: ArrayLike, moves: Moves | None = None, min_move: float = MIN_MOVE
) -> Array:
    """Direction of each axis' last move, from the sequence of commands.

    An axis that has not moved since its last move keeps its direction; the first posture counts as
    reached in +.

    Args:
        command: commands of the readings ``(n, 3)``, metres.
        order: place in the sequence ``(n,)``; equal places are one visit.
        moves: commands gone through between the readings.
        min_move: beyond what an axis counts as moved, metres.

    Returns:
        +1 or -1, shape ``(n, 3)``.
    """
    own = np.asarray(command, dtype=float).reshape(-1, 3)
    moves = moves or Moves()
    rho = np.vstack([moves.command, own])
    sequence = np.argsort(np.concatenate([moves.order, np.asarray(order)]), kind="stable")
    approach = np.empty_like(rho)
    for k, places in enumerate(rho[sequence].T.tolist()):
        found, way, at = [], 1.0, places[0] if places else 0.0
        for place in places:  # a creep by less than it counts as moved adds up
            if abs(place - at) > min_move:
                way, at = math.copysign(1.0, place - at), place
            found.append(way)
        approach[sequence, k] = found
    return approach[len(moves) :]


def built_up_lost_motion(
    command: ArrayLike, order: ArrayLike, lengths: Sequence[float], moves: Moves | None = None
) -> Array:
    """Lost motion of each drive that builds up over a length after it turns round (Dahl 1968, *A
    solid friction model*, whose friction it follows): half its approach after a long way.

    Args:
        command: commands of the readings ``(n, 3)``, metres.
        order: place in the sequence ``(n,)``; equal places are one visit.
        lengths: of building up ``(K,)``, metres.
        moves: commands gone through between the readings.

    Returns:
        Between -1/2 and 1/2, shape ``(K, n, 3)``; before the first row all is built up.
    """
    own = np.asarray(command, dtype=float).reshape(-1, 3)
    moves = moves or Moves()
    rho, places = np.vstack([moves.command, own]), np.concatenate([moves.order, np.asarray(order)])
    sequence = np.argsort(places, kind="stable")
    goal = derive_approach(rho, places)[sequence] / 2
    step = np.abs(np.diff(rho[sequence], axis=0, prepend=rho[sequence][:1]))
    kept = np.exp(-step / np.reshape(lengths, (-1, 1, 1)))
    state = np.broadcast_to(goal, kept.shape).copy()
    for k in range(1, len(goal)):
        state[:, k] += (state[:, k - 1] - goal[k]) * kept[:, k]
    found = np.empty_like(state)
    found[:, sequence] = state
    return found[:, len(moves) :]


def impossible_approach(
    command: Array, approach: Array, order: ArrayLike, moves: Moves
) -> NDArray[np.bool_]:
    """Axes whose recorded direction cannot come from the sequence of commands.

    A gap in the order may hide a move, and so may what came before the first row: the direction
    recorded there is taken as it is.

    Args:
        command: commands of the readings ``(n, 3)``, metres.
        approach: recorded directions ``(n, 3)``, 0 where unknown.
        order: place in the sequence ``(n,)``.
        moves: commands gone through between the readings.

    Returns:
        Booleans ``(n, 3)``.
    """
    m = len(moves)
    rho = np.vstack([moves.command, command])
    recorded = np.vstack([np.zeros((m, 3)), approach])
    place = np.concatenate([moves.order, np.asarray(order)])
    wrong = np.zeros(rho.shape, dtype=bool)
    direction, before = np.zeros(3), -1
    for row in np.argsort(place, kind="stable"):
        if before < 0 or place[row] - place[before] > 1:
            direction = np.zeros(3)
        else:
            step = rho[row] - rho[before]
            direction = np.where(np.abs(step) > MIN_MOVE, np.sign(step), direction)
        wrong[row] = recorded[row] * direction < 0
        direction = np.where(direction == 0, recorded[row], direction)
        before = row
    return wrong[m:]


def planned_moves(
    command: Array, approach: Array, begins: ArrayLike, beyond: float
) -> tuple[Moves, Ints]:
    """Moves that let commands, gone through in their order, be reached as they ask for.

    A command that the one before does not lead to from the side asked for is preceded by a move
    beyond it; so is every row that begins a mounting, as nobody knows what the machine did
    while the dial was mounted.

    Args:
        command: commands ``(n, 3)``, metres, with room for an `overshoot` within the stroke.
        approach: directions to be reached from ``(n, 3)``; 0: either.
        begins: whether a row is the first of a mounting ``(n,)``.
        beyond: that overshoot, metres.

    Returns:
        The moves, and the place of each row in the sequence of all ``(n,)``.
    """
    before, direction = np.full(3, np.nan), np.zeros(3)
    gone: list[Array] = []
    places: list[int] = []
    order: list[int] = []
    for row, first in enumerate(np.asarray(begins, dtype=bool).tolist()):
        step = command[row] - before
        reached = np.where(np.abs(step) > MIN_MOVE, np.sign(step), direction)
        if first or ((reached != approach[row]) & (approach[row] != 0)).any():
            places.append(len(order) + len(places))
            gone.append(command[row] - beyond * approach[row])
            reached = approach[row]
        order.append(len(order) + len(places))
        before, direction = command[row], reached
    place = np.array(places, dtype=np.int64)
    moves = Moves(np.round(np.array(gone).reshape(-1, 3), 9), place, place + 2, beyond)
    return moves, np.array(order, dtype=np.int64)
