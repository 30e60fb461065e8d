"""Closed postures of three legs in numbers: many at once by six bars, one by one by Pinocchio.

Both engines take travel of the drives ``(n, 3)`` from mechanical zero and displacements of the
virtual joints ``(n, 30)``, metres and radians, and return the same outputs and sensitivities.
"""

from __future__ import annotations

import hashlib
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from orthoglide.errors import ClosureError, InputError
from orthoglide.geometry import Array
from orthoglide.mechanism import six_bars
from orthoglide.mechanism.compiled import CompilableFunctions
from orthoglide.mechanism.mechanism import CLOSED, Mechanism, Posture
from orthoglide.mechanism.perfect_legs import SIDE_ROUNDING
from orthoglide.mechanism.six_bars import INPUT_SIZE, LINES, OUTPUT_SIZE, ROTATION, TCP

# Bars are closed to rounding where their length is off by less than this fraction.
_ROUNDING = 3e-15
# Trace of a rotation by 60 degrees: a platform turned by more is in another assembly mode.
_SMALLEST_TRACE = 2.0
# Rounds of Newton's steps after the first, for postures with errors of centimetres.
_MAX_NEWTON_ROUNDS = 5
# Postures, within that fraction of a bar's length from mechanical zero, at which six bars are
# compared with Pinocchio before they are used: any posture would show a different machine.
_CHECKED_POSTURES, _CHECKED_REGION = 2, 0.01
# Number of interpreted closures that take as long as compiling.
_WORTH_COMPILING = 50_000


class Outputs:
    """Outputs of closed postures (tool, rotation, bar ends): views into an array ``(..., 48)``.

    Attributes:
        values: the array itself.
    """

    def __init__(self, values: Array) -> None:
        self.values = values

    @property
    def p(self) -> Array:
        """TCP ``(..., 3)``, metres."""
        return self.values[..., TCP]

    @property
    def R(self) -> Array:
        """Rotation of the platform ``(..., 3, 3)``."""
        return self.values[..., ROTATION].reshape(*self.values.shape[:-1], 3, 3)

    @property
    def lines(self) -> Array:
        """Ends of the bars ``(..., leg, bar, end, 3)``, carriage's end first, metres."""
        return self.values[..., LINES].reshape(*self.values.shape[:-1], 3, 2, 2, 3)


def batch_index(shape: tuple[int, ...], index: tuple[int, ...]) -> tuple[int, ...]:
    """Return the index in a batch of ``shape`` of a posture numbered in the flattened batch."""
    return tuple(int(k) for k in np.unravel_index(index[0], shape)) if index else ()


class PinocchioEngine:
    """Closes postures one by one with Pinocchio's constraint Jacobian: slow, and the definition.

    Attributes:
        largest_residual: largest closure residual so far by loop, metres or radians.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.largest_residual = dict.fromkeys(mechanism.tree.rows, 0.0)

    def outputs(self, travel: Array, moves: Array) -> Outputs:
        """Return the outputs of closed postures.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        return self._close_each(travel, moves, tangents=False)[0]

    def tangent(self, travel: Array, moves: Array) -> tuple[Outputs, Array]:
        """Return the outputs and their derivative ``(n, 48, 33)`` by travel and moves.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        return self._close_each(travel, moves, tangents=True)

    def _close_each(self, travel: Array, moves: Array, tangents: bool) -> tuple[Outputs, Array]:
        n = len(travel)
        values = np.empty((n, OUTPUT_SIZE))
        by_given = np.empty((n if tangents else 0, OUTPUT_SIZE, INPUT_SIZE))
        zero = self.mechanism.geometry.zero
        for k in range(n):
            with self.mechanism.lock:  # the outputs are read from Pinocchio's scratch data
                try:
                    posture = self.mechanism.close(zero + travel[k], moves[k].reshape(3, -1))
                except ClosureError as error:
                    raise _numbered(error, k, n) from None
                values[k] = self._posture_outputs(posture)
                if tangents:
                    by_given[k] = self._posture_tangent(posture)
            self.largest_residual = {
                loop: max(v, posture.residual[loop]) for loop, v in self.largest_residual.items()
            }
        return Outputs(values), by_given

    @cached_property
    def _bar_ends(self) -> list[int]:
        """Frames at the ends of the bars, in the order of ``LINES``."""
        tree, joint = self.mechanism.tree, pin.FrameType.JOINT
        return [
            number
            for leg in tree.leg_names
            for number in (
                *(tree.model.getFrameId(f"{leg}_{n}", joint) for n in ("bar1", "knuckle", "bar2")),
                tree.frame(f"{leg}_bar2_tip"),
            )
        ]

    def _posture_outputs(self, posture: Posture) -> Array:
        """Outputs ``(48,)`` of the posture that was closed last."""
        model, data = self.mechanism.tree.model, self.mechanism.constraints.data
        ends = [pin.updateFramePlacement(model, data, k).translation for k in self._bar_ends]
        return np.concatenate([posture.p, posture.R.ravel(), *ends])

    def _posture_tangent(self, posture: Posture) -> Array:
        """Derivative ``(48, 33)`` of the outputs by travel and displacements."""
        tree, frames = self.mechanism.tree, [self.mechanism.tool, *self._bar_ends]
        by = np.concatenate([tree.drive, tree.virtual])
        tool, *ends = self.mechanism.frame_velocities(posture, by, frames)
        rotation = np.cross(tool[3:].T[:, :, None], posture.R[None], axis=1)
        by_end = [end[:3] for end in ends]
        return np.concatenate([tool[:3], rotation.reshape(INPUT_SIZE, 9).T, *by_end])


def _numbered(error: ClosureError, index: int, count: int, hint: str = "") -> ClosureError:
    """Return a closure error with the number of the posture in its batch, and a hint."""
    prefix = f"posture {index + 1} of {count}: " if count > 1 else ""
    return ClosureError(f"{prefix}{error}{hint}", residuals=error.residuals, index=(index,))


class SixBars:
    """Closes many postures as a platform on six bars, and the remaining ones with Pinocchio.

    Args:
        mechanism: three legs with virtual joints, from whose tree the bars are read.
        compile: ``True`` to compile at once, ``False`` never, ``None`` after many postures or where
            an earlier run has left a compiled copy. It only affects speed.
    """

    def __init__(self, mechanism: Mechanism, *, compile: bool | None = None) -> None:
        self.mechanism = mechanism
        self.constants = six_bars.constants(mechanism.tree)
        self._rounding = _ROUNDING * float(mechanism.spheres.lengths.max())
        # Two libraries, as most runs need the closure first, and the tangent compiles slowly.
        library = partial(CompilableFunctions, shared=1, worth=_WORTH_COMPILING, compile=compile)
        self._close = library(
            ("close", "close_from"), _library_key("close"), six_bars.closing_functions
        )
        self._tangent = library(
            ("tangent",), _library_key("tangent"), lambda: [six_bars.tangent_function()]
        )
        self._check_derivation()

    def _check_derivation(self) -> None:
        """Raise an `InputError` for a tree that is no platform on six bars.

        This is the case where Pinocchio closes it differently near mechanical zero.
        """
        draws = np.random.default_rng(0)
        stroke_limit = min(map(abs, self.mechanism.geometry.stroke)) / 2
        reach = min(_CHECKED_REGION * float(self.mechanism.spheres.lengths.max()), stroke_limit)
        travel = reach * draws.uniform(-1, 1, (_CHECKED_POSTURES, 3))
        moves = np.zeros((_CHECKED_POSTURES, INPUT_SIZE - 3))
        reference = PinocchioEngine(self.mechanism)
        try:
            values, expected = (e.outputs(travel, moves).values for e in (self, reference))
        except ClosureError as error:
            raise InputError(
                f"the machine does not close near mechanical zero ({error}): correct the joint "
                f"origins in the URDF, or the dimensions"
            ) from None
        largest = float(np.abs(values - expected).max())
        if largest > CLOSED:
            raise InputError(
                f"the closures of the URDF do not make it a platform on six bars: its tool or a "
                f"bar is {largest * 1e3:.3g} mm from where Pinocchio closes it. Close each "
                f"parallelogram by a point and tie the three platforms by two frames"
            )

    @property
    def compiled(self) -> bool:
        """Whether closures run compiled."""
        return self._close.compiled

    def outputs(self, travel: Array, moves: Array) -> Outputs:
        """Return the outputs of closed postures; see :meth:`PinocchioEngine.outputs`."""
        if travel.shape != (len(moves), 3) or moves.shape[1:] != (INPUT_SIZE - 3,):
            raise InputError(
                f"travel (n, 3) and displacements (n, {INPUT_SIZE - 3}) are needed, not "
                f"{travel.shape} and {moves.shape}"
            )
        values, check = self._close("close", self.constants, travel, moves)
        # All postures are closed if the worst ones are; comparisons with NaN are false.
        misfit, side, trace = check[0] if len(check) == 1 else _worst_check(check)
        if not (misfit <= self._rounding and side < -SIDE_ROUNDING and trace > _SMALLEST_TRACE):
            self._close_remaining(values, check, travel, moves)
        return Outputs(values)

    def _close_remaining(self, values: Array, check: Array, travel: Array, moves: Array) -> None:
        """Close in place the postures that the first round of Newton's steps did not close.

        Six bars are accepted at a residual of ``CLOSED``; Pinocchio closes or refuses the others.
        """
        for _ in range(_MAX_NEWTON_ROUNDS):
            open_rows = ~_is_closed(check, self._rounding) & np.isfinite(values).all(axis=1)
            rows = np.flatnonzero(open_rows)
            if not rows.size:
                break
            values[rows], check[rows] = self._close(
                "close_from", self.constants, travel[rows], moves[rows], values[rows, :12]
            )
        reference = PinocchioEngine(self.mechanism)
        for row in np.flatnonzero(~_is_closed(check, CLOSED)):
            part = slice(row, row + 1)
            try:
                values[row] = reference.outputs(travel[part], moves[part]).values[0]
            except ClosureError as error:
                hint = self._travel_hint(travel[row])
                raise _numbered(error, int(row), len(travel), hint) from None

    def _travel_hint(self, travel: Array) -> str:
        """Return a hint at a command that was probably meant as travel; empty for others."""
        geometry, zero = self.mechanism.geometry, self.mechanism.geometry.zero
        meant_as_travel = zero.any() and geometry.in_stroke(travel + 2 * zero).all()
        hint = f": at mechanical zero every command is {zero[0]:g} m, not 0"
        return hint if meant_as_travel else ""

    def tangent(self, travel: Array, moves: Array) -> tuple[Outputs, Array]:
        """Return outputs and derivative; see :meth:`PinocchioEngine.tangent`."""
        outputs = self.outputs(travel, moves)
        poses = outputs.values[:, :12]
        (by_given,) = self._tangent("tangent", self.constants, travel, moves, poses)
        return outputs, by_given


Engine = SixBars | PinocchioEngine
"""Closes postures."""


def _is_closed(check: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return which postures ``(n,)`` are closed in the machine's assembly mode."""
    misfit, side, trace = check.T
    return np.asarray((misfit <= tolerance) & (side < -SIDE_ROUNDING) & (trace > _SMALLEST_TRACE))


def _worst_check(check: Array) -> tuple[float, float, float]:
    """Return the largest misfit, the largest side and the smallest trace of all postures."""
    if not len(check):
        return 0.0, -1.0, 3.0
    misfit, side, _ = check.max(axis=0)
    return float(misfit), float(side), float(check[:, 2].min())


@cache
def _library_key(name: str) -> str:
    """Return the key of a compiled library: the functions depend only on their module's text."""
    text = Path(six_bars.__file__).read_bytes()
    return f"{name} {hashlib.sha256(text).hexdigest()}"
