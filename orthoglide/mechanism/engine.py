"""Closed postures of three legs in numbers: many at once by six bars, one by one by Pinocchio.

Both engines take travel of the drives ``(n, 3)`` from mechanical zero and displacements of the
virtual joints ``(n, 30)``, metres and radians, and return the same outputs and sensitivities.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from orthoglide.errors import ClosureError, InputError
from orthoglide.geometry import Array
from orthoglide.mechanism import six_bars
from orthoglide.mechanism.mechanism import CLOSED, Mechanism, Posture
from orthoglide.mechanism.perfect_legs import SIDE_ROUNDING
from orthoglide.mechanism.rows import CompilableFunctions, InPlaceFunction
from orthoglide.mechanism.six_bars import INPUT_SIZE, LINES, OUTPUT_SIZE, ROTATION, TCP

# Bars off by less than this share of their length are closed to rounding.
_ROUNDING = 3e-15
# Trace of a rotation by 60 degrees: a platform that turned by more is in another assembly mode.
_SMALLEST_TRACE = 2.0
# Rounds of Newton's steps for postures that the first did not close: errors of centimetres.
_MAX_NEWTON_ROUNDS = 5
# Postures near mechanical zero, within that share of a bar's length from it, at which six bars are
# held against Pinocchio before they are used: any would show another machine.
_CHECKED_POSTURES, _CHECKED_REGION = 2, 0.01
# Interpreted closures that take as long as compiling does.
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


class Engine(Protocol):
    """Interface of what closes postures."""

    mechanism: Mechanism

    def outputs(self, travel: Array, moves: Array) -> Outputs:
        """Return what closed postures show.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        ...

    def tangent(self, travel: Array, moves: Array) -> tuple[Outputs, Array]:
        """Return what postures show, and the derivative ``(n, 48, 33)`` by travel and moves.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        ...


def batch_index(shape: tuple[int, ...], index: tuple[int, ...]) -> tuple[int, ...]:
    """Return the place in a batch of ``shape`` of a posture numbered after flattening it."""
    return tuple(int(k) for k in np.unravel_index(index[0], shape)) if index else ()


class PinocchioEngine:
    """Closes postures one by one with Pinocchio's constraint Jacobian: slow, and the definition.

    Args:
        mechanism: three legs with virtual joints.

    Attributes:
        worst: largest closure residual so far by loop, metres or radians.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.largest_residual = dict.fromkeys(mechanism.tree.rows, 0.0)

    def outputs(self, travel: Array, moves: Array) -> Outputs:
        """See :class:`Engine`."""
        return self._close_each(travel, moves, tangents=False)[0]

    def tangent(self, travel: Array, moves: Array) -> tuple[Outputs, Array]:
        """See :class:`Engine`."""
        return self._close_each(travel, moves, tangents=True)

    def _close_each(self, travel: Array, moves: Array, tangents: bool) -> tuple[Outputs, Array]:
        n = len(travel)
        values, by_given = (
            np.empty((n, OUTPUT_SIZE)),
            np.empty((n if tangents else 0, OUTPUT_SIZE, INPUT_SIZE)),
        )
        zero = self.mechanism.geometry.zero
        for k in range(n):
            with self.mechanism.lock:  # what is shown is read off Pinocchio's scratch data
                with _number_posture_in_errors(k, n):
                    posture = self.mechanism.close(zero + travel[k], moves[k].reshape(3, -1))
                values[k] = self._posture_outputs(posture)
                if tangents:
                    by_given[k] = self._posture_tangent(posture)
            self.largest_residual = {
                loop: max(v, posture.residual[loop]) for loop, v in self.largest_residual.items()
            }
        return Outputs(values), by_given

    @cached_property
    def _bar_ends(self) -> list[tuple[bool, int]]:
        """Whether each bar end is a frame, and its number or the joint's, in the order of LINES."""
        tree, found = self.mechanism.tree, list[tuple[bool, int]]()
        for leg in tree.leg_names:
            joints = [
                tree.model.getJointId(f"{leg}_{name}") for name in ("bar1", "knuckle", "bar2")
            ]
            found += [(False, j) for j in joints] + [(True, tree.frame(f"{leg}_bar2_tip"))]
        return found

    def _posture_outputs(self, posture: Posture) -> Array:
        """Outputs ``(48,)`` of the posture that was closed last."""
        model, data = self.mechanism.tree.model, self.mechanism.constraints.data
        places = [
            (pin.updateFramePlacement(model, data, k) if framed else data.oMi[k]).translation
            for framed, k in self._bar_ends
        ]
        return np.concatenate([posture.p, posture.R.ravel(), *places])

    def _posture_tangent(self, posture: Posture) -> Array:
        """Derivative ``(48, 33)`` of the outputs by travel and displacements."""
        tree, constraints = self.mechanism.tree, self.mechanism.constraints
        rates = self.mechanism.joint_rates(posture, np.concatenate([tree.drive, tree.virtual]))
        model, data, axes = tree.model, constraints.data, pin.LOCAL_WORLD_ALIGNED
        tool = pin.getFrameJacobian(model, data, self.mechanism.tool, axes) @ rates
        turned = np.cross(tool[3:].T[:, :, None], posture.R[None], axis=1).reshape(INPUT_SIZE, 9).T
        ends = [
            (
                pin.getFrameJacobian(model, data, k, axes)
                if framed
                else pin.getJointJacobian(model, data, k, axes)
            )[:3]
            @ rates
            for framed, k in self._bar_ends
        ]
        return np.concatenate([tool[:3], turned, *ends])


@contextmanager
def _number_posture_in_errors(index: int, count: int) -> Iterator[None]:
    """Let an error of one posture say which of a batch it is."""
    try:
        yield
    except ClosureError as error:
        which = f"posture {index + 1} of {count}: " if count > 1 else ""
        raise ClosureError(f"{which}{error}", residuals=error.residuals, index=(index,)) from None


class SixBars:
    """Closes many postures as a platform on six bars; Pinocchio closes what Newton leaves open.

    Args:
        mechanism: three legs with virtual joints, from whose tree the bars are read.
        compile: ``True`` to compile at once, ``False`` never, ``None`` once many postures have been
            asked for or an earlier run has left a compiled copy. Without a C compiler nothing
            changes but speed.
    """

    def __init__(self, mechanism: Mechanism, *, compile: bool | None = None) -> None:
        self.mechanism = mechanism
        self.constants = six_bars.constants(mechanism.tree)
        self._rounding = _ROUNDING * float(mechanism.spheres.lengths.max())
        worth = -1 if compile is False else _WORTH_COMPILING
        # Apart, as most runs need the closure first, and the tangent takes longest to compile.
        self._close = CompilableFunctions(
            ("close", "close_from"), _library_key("close"), six_bars.closing_functions, 1, worth
        )
        self._tangent = CompilableFunctions(
            ("tangent",), _library_key("tangent"), lambda: [six_bars.tangent_function()], 1, worth
        )
        if compile:
            self._close.compile()
            self._tangent.compile()
        self._check_derivation()

    def _check_derivation(self) -> None:
        """Refuse a tree that its closures do not make a platform on six bars.

        Raises:
            InputError: where Pinocchio closes it otherwise, near mechanical zero.
        """
        draws = np.random.default_rng(0)
        within = min(map(abs, self.mechanism.geometry.stroke)) / 2
        reach = min(_CHECKED_REGION * float(self.mechanism.spheres.lengths.max()), within)
        travel = reach * draws.uniform(-1, 1, (_CHECKED_POSTURES, 3))
        moves = np.zeros((_CHECKED_POSTURES, INPUT_SIZE - 3))
        try:
            apart = (
                self.outputs(travel, moves).values
                - PinocchioEngine(self.mechanism).outputs(travel, moves).values
            )
        except ClosureError as error:
            raise InputError(
                f"the machine does not close near mechanical zero ({error}): correct the joint "
                f"origins in the URDF, or the dimensions"
            ) from None
        worst = float(np.abs(apart).max())
        if worst > CLOSED:
            raise InputError(
                f"the closures of the URDF do not make it a platform on six bars: its tool or a "
                f"bar is {worst * 1e3:.3g} mm from where Pinocchio closes it. Close each "
                f"parallelogram by a point and tie the three platforms by two frames"
            )

    @property
    def compiled(self) -> bool:
        """Whether closures run compiled."""
        return self._close.compiled

    def single(self) -> InPlaceFunction:
        """Return the closure of one posture as an object that is evaluated in place, unchecked.

        Constants ``(106,)``, travel ``(3,)`` and displacements ``(30,)`` in, outputs ``(48,)`` and
        check ``(3,)`` out.
        """
        single = InPlaceFunction(self._close.rows("close").function)
        single.arguments[0][:] = self.constants
        return single

    def outputs(self, travel: Array, moves: Array) -> Outputs:
        """See :class:`Engine`."""
        if travel.shape != (len(moves), 3) or moves.shape[1:] != (INPUT_SIZE - 3,):
            raise InputError(
                f"travel (n, 3) and displacements (n, {INPUT_SIZE - 3}) are needed, not "
                f"{travel.shape} and {moves.shape}"
            )
        values, check = self._close("close", self.constants, travel, moves)
        # All postures are closed if the worst are; comparisons with NaN are false.
        off, side, turned = check[0] if len(check) == 1 else _worst_check(check)
        if not (off <= self._rounding and side < -SIDE_ROUNDING and turned > _SMALLEST_TRACE):
            self._close_remaining(values, check, travel, moves)
        return Outputs(values)

    def _close_remaining(self, values: Array, check: Array, travel: Array, moves: Array) -> None:
        """Close in place what the first round left open.

        What six bars close to ``CLOSED`` is taken. The rest is closed, or refused, by Pinocchio.
        """
        for _ in range(_MAX_NEWTON_ROUNDS):
            rows = np.flatnonzero(
                ~_is_closed(check, self._rounding) & np.isfinite(values).all(axis=1)
            )
            if not rows.size:
                break
            values[rows], check[rows] = self._close(
                "close_from", self.constants, travel[rows], moves[rows], values[rows, :12]
            )
        reference = PinocchioEngine(self.mechanism)
        for row in np.flatnonzero(~_is_closed(check, CLOSED)):
            with (
                _number_posture_in_errors(int(row), len(travel)),
                self._hint_at_travel(travel[row]),
            ):
                part = slice(row, row + 1)
                values[row] = reference.outputs(travel[part], moves[part]).values[0]

    @contextmanager
    def _hint_at_travel(self, travel: Array) -> Iterator[None]:
        """Let an error hint at commands that would be within the stroke if they were travel."""
        geometry = self.mechanism.geometry
        try:
            yield
        except ClosureError as error:
            zero = geometry.zero
            if zero.any() and geometry.in_stroke(travel + 2 * zero).all():
                message = f"{error}: at mechanical zero every command is {zero[0]:g} m, not 0"
                raise ClosureError(message, residuals=error.residuals) from None
            raise

    def tangent(self, travel: Array, moves: Array) -> tuple[Outputs, Array]:
        """See :class:`Engine`."""
        outputs = self.outputs(travel, moves)
        (by_given,) = self._tangent(
            "tangent", self.constants, travel, moves, outputs.values[:, :12]
        )
        return outputs, by_given


def _is_closed(check: Array, most: float) -> NDArray[np.bool_]:
    """Return which postures ``(n,)`` are closed in the machine's assembly mode."""
    return np.asarray(
        (check[:, 0] <= most) & (check[:, 1] < -SIDE_ROUNDING) & (check[:, 2] > _SMALLEST_TRACE)
    )


def _worst_check(check: Array) -> tuple[float, float, float]:
    """Return the largest misfit, the side nearest to the other mode and the smallest trace."""
    if not len(check):
        return 0.0, -1.0, 3.0
    off, side, _ = check.max(axis=0)
    return float(off), float(side), float(check[:, 2].min())


@cache
def _library_key(name: str) -> str:
    """Key of a compiled library: the functions depend on the text of their module alone."""
    text = Path(six_bars.__file__).read_bytes()
    return f"{name} {hashlib.sha256(text).hexdigest()}"
