"""The closed-loop mechanism: drives and virtual joints in, everything else out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgesv

from orthoglide.errors import ClosureError, InputError
from orthoglide.geometry import Array, Geometry, vectors
from orthoglide.mechanism import seed
from orthoglide.mechanism.batch import CLOSED, JUMPED, BatchClosure, placed
from orthoglide.mechanism.loops import Loops
from orthoglide.mechanism.mobility import Mobility, mobility
from orthoglide.mechanism.seed import Mode
from orthoglide.mechanism.tree import VIRTUAL_NAMES, general_tree, nominal_tree

VIRTUAL_COUNT = 3 * len(VIRTUAL_NAMES)
_NONE = np.zeros((3, len(VIRTUAL_NAMES)))  # displacements
_STEPS = 30
_LONGEST_STEP = 0.5  # radians; keeps a cold start from jumping over to the other assembly mode


@dataclass(frozen=True)
class Posture:
    """One closed posture."""

    q: Array  # joints of the tree (nq,), metres and radians
    p: Array  # TCP (3,), metres
    R: Array  # rotation of the platform (3, 3)
    residual: dict[str, float]  # closure residual by loop
    iterations: int  # Newton steps taken


class Mechanism:
    """Three PRPaR legs of any layout with their loops closed at the TCP.

    By default the closure includes the relief joints: 21 unknowns for 21 rows, which close for any
    errors of the parts and equal the rigid PRPaR machine where the errors fit together. One object
    serves one thread.

    Args:
        geometry: nominal dimensions.
        compile: see :class:`~orthoglide.mechanism.batch.BatchClosure`.
    """

    def __init__(self, geometry: Geometry | None = None, *, compile: bool | None = None) -> None:
        self.geometry = geometry or Geometry()
        self.tree = general_tree(self.geometry)
        self.loops = Loops(self.tree)
        self._compile = compile
        self._tcp = self.tree.model.getFrameId(self.tree.tool)
        self._given = np.concatenate([self.tree.drive, self.tree.virtual])

    def __reduce__(self) -> tuple[Any, tuple[Geometry]]:
        # Constraint objects do not pickle: another process builds its own.
        return partial(Mechanism, compile=self._compile), (self.geometry,)

    @cached_property
    def batch(self) -> BatchClosure:
        """Closure of many postures with all virtual joints."""
        return BatchClosure(self.tree, compile=self._compile)

    @cached_property
    def nominal_batch(self) -> BatchClosure:
        """Closure of many postures of the nominal machine, rigid legs: smaller and faster."""
        return BatchClosure(nominal_tree(self.geometry), compile=self._compile)

    # One posture, by Pinocchio -------------------------------------------------------------

    def close(
        self,
        command: ArrayLike,
        displacements: ArrayLike | None = None,
        *,
        mode: Mode = "machine",
        legs: Literal["relieved", "rigid"] = "relieved",
        guess: Posture | None = None,
    ) -> Posture:
        """Direct kinematics: from the drives to every joint, by Newton on the constraint Jacobian.

        By compiled code where there is some, else, and where that does not close, by Pinocchio.

        Args:
            command: rho ``(3,)``, metres (2008, eq. 2).
            displacements: of the virtual joints ``(3, 10)``, as in ``VIRTUAL_NAMES``.
            mode: assembly mode.
            legs: ``"rigid"`` keeps the relief joints at zero: least squares on all rows, which
                refuses errors of the parts that do not fit together.
            guess: a nearby posture to start from.

        Raises:
            ClosureError: where the loops do not close, with the residual by loop.
            InputError: where the arguments have the wrong shape or are not finite.
        """
        q = self._start(command, displacements, guess)
        if guess is None and mode == "machine":  # from the neutral posture, which is quicker
            try:
                return self._closed(q.copy(), mode, legs)
            except ClosureError:
                pass
        if guess is None:
            travel = q[None, self.tree.drive]
            p = seed.tool(self.geometry, travel, mode)
            if np.isfinite(p).all():
                q[self.tree.free] = seed.free_joints(self.tree, travel, p)[0]
        return self._closed(q, mode, legs)

    def _closed(self, q: Array, mode: Mode, legs: Literal["relieved", "rigid"]) -> Posture:
        """The posture that is reached from ``q``, which changes."""
        if legs == "relieved" and self._compile is not False:
            found = self._by_compiled_code(q, mode)
            if found is not None:
                return found
        moving = self.tree.passive if legs == "rigid" else self.tree.free
        iterations, info = 0, 0
        while iterations < _STEPS:
            iterations += 1
            residual = self.loops.update(q)
            jacobian = self.loops.newton_matrix()[:, moving]
            if legs == "rigid":
                change = np.linalg.lstsq(jacobian, residual, rcond=1e-9)[0]
            else:
                _, _, change, info = dgesv(jacobian, residual)
            largest = float(np.abs(change).max())
            if info != 0 or not np.isfinite(largest):
                break
            q[moving] -= change * min(1.0, _LONGEST_STEP / max(largest, _LONGEST_STEP))
            if largest < 1e-8:  # quadratic: the step just made leaves its square
                break
        return self._checked(q, iterations, mode, legs)

    def _by_compiled_code(self, q: Array, mode: Mode) -> Posture | None:
        """The posture that is reached from ``q``; ``None`` where that is not closed in the mode."""
        found = self.batch.single(q[self.tree.free], q[self._given])
        if found is None:
            return None
        x, residual, steps, shown = found
        by_loop, p = self.tree.by_loop(residual), shown.p
        if not all(v <= CLOSED for v in by_loop.values()) or x @ x > JUMPED:
            return None
        if self._mode(q, p) != mode:
            return None
        closed = q.copy()
        closed[self.tree.free] = x
        return Posture(closed, p, shown.R, by_loop, steps)

    def _mode(self, q: Array, p: Array) -> Mode:
        # Far from any plausible error of the parts the nominal plane of the carriages will do.
        below = seed.below_carriages(self.geometry, q[self.tree.drive], p)
        return "machine" if below else "other"

    def _start(
        self, command: ArrayLike, displacements: ArrayLike | None, guess: Posture | None
    ) -> Array:
        rho = np.asarray(command, dtype=float)
        moves = _NONE if displacements is None else np.asarray(displacements, dtype=float)
        if rho.shape != (3,) or moves.shape != _NONE.shape:
            raise InputError("close takes one command (3,) and displacements (3, 10)")
        if not (np.isfinite(rho).all() and (moves is _NONE or np.isfinite(moves).all())):
            raise InputError("the command and the displacements must be finite numbers")
        q = np.zeros(self.tree.model.nq) if guess is None else guess.q.copy()
        q[self.tree.drive] = rho - self.geometry.zero
        q[self.tree.virtual] = moves.ravel()
        return q

    def _checked(self, q: Array, iterations: int, mode: Mode, legs: str) -> Posture:
        import pinocchio as pin

        residual = self.loops.update(q)
        by_loop = self.tree.by_loop(residual)
        if not float(np.abs(residual).max()) <= CLOSED:
            worst, size = max(by_loop.items(), key=lambda item: item[1])
            reason = (
                "rigid PRPaR legs cannot take up these errors of the parts"
                if legs == "rigid" and iterations < _STEPS
                else "the legs do not reach each other"
            )
            raise ClosureError(
                f"the loops do not close: {reason}; the largest misfit is {size * 1e3:.3g} mm or "
                f"mrad at {worst}",
                residuals=by_loop,
            )
        pin.updateFramePlacement(self.tree.model, self.loops.data, self._tcp)
        placement = self.loops.data.oMf[self._tcp]
        p, R = placement.translation.copy(), placement.rotation.copy()
        found = self._mode(q, p)
        if found != mode:
            raise ClosureError(
                f"closure ended in the {found} assembly mode instead of {mode}", residuals=by_loop
            )
        return Posture(q, p, R, by_loop, iterations)

    def velocity_jacobian(self, posture: Posture) -> Array:
        """dp/drho ``(3, 3)`` at a posture (2008, eq. 5), from the constraint Jacobian."""
        import pinocchio as pin

        rows = self.loops.jacobian(posture.q)
        tcp = pin.getFrameJacobian(
            self.tree.model, self.loops.data, self._tcp, pin.LOCAL_WORLD_ALIGNED
        )[:3]
        free, drive = self.tree.free, self.tree.drive
        moved = -np.linalg.solve(rows[:, free], rows[:, drive])
        return np.asarray(tcp[:, drive] + tcp[:, free] @ moved)

    def mobility(self, command: ArrayLike) -> Mobility:
        """Mobility and redundancy of the rigid PRPaR machine at a command ``(3,)``."""
        posture = self.close(command, legs="rigid")
        nominal = self.nominal_batch.tree
        q = np.zeros(nominal.model.nq)
        q[nominal.drive] = posture.q[self.tree.drive]
        q[nominal.passive] = posture.q[self.tree.passive]
        return mobility(Loops(nominal), q)

    # Batches, by CasADi --------------------------------------------------------------------

    def given(self, commands: Array, displacements: ArrayLike | None = None) -> Array:
        """``[drives; virtual]`` ``(..., 33)`` for ``commands`` ``(..., 3)`` and ``displacements``
        ``(..., 3, 10)`` or ``(..., 30)``, zero where absent.
        """
        given = np.zeros((*commands.shape[:-1], 3 + VIRTUAL_COUNT))
        given[..., :3] = commands - self.geometry.zero
        if displacements is not None:
            moves = np.asarray(displacements)
            if moves.shape[-1] != VIRTUAL_COUNT:
                moves = moves.reshape(*moves.shape[:-2], VIRTUAL_COUNT)
            given[..., 3:] = moves
        return given

    def _closing(
        self, commands: Array, displacements: ArrayLike | None
    ) -> tuple[BatchClosure, Array]:
        """The smallest closure that will do, and what is given of it ``(N, 3 or 33)``."""
        given = self.given(commands, displacements).reshape(-1, 3 + VIRTUAL_COUNT)
        return (self.nominal_batch, given[:, :3]) if displacements is None else (self.batch, given)

    def forward(
        self, commands: ArrayLike, displacements: ArrayLike | None = None, *, mode: Mode = "machine"
    ) -> Array:
        """TCP ``(..., 3)`` for commands rho ``(..., 3)``, metres.

        Args:
            commands: rho, metres.
            displacements: of the virtual joints ``(..., 3, 10)``; a nominal machine where absent.
            mode: assembly mode.

        Raises:
            ClosureError: naming the first posture that does not close.
        """
        rho = self.geometry.commands(commands, "commands")
        batch, given = self._closing(rho, displacements)
        with placed(rho.shape[:-1]):
            return batch.outputs(batch.close(given, mode=mode), given).p.reshape(rho.shape)

    def inverse(self, p: ArrayLike, displacements: ArrayLike | None = None) -> Array:
        """Commands rho ``(..., 3)`` that bring the TCP to ``p`` ``(..., 3)``, metres.

        Newton on the closed mechanism with its velocity Jacobian, under ``displacements`` as for
        :meth:`given`.

        Raises:
            UnreachableError: naming the leg that is too short, and by how much.
            ClosureError: where the drives do not converge.
        """
        target = vectors(p, "the wanted points")
        goal = target.reshape(-1, 3)
        with placed(target.shape[:-1]):
            start = seed.commands(self.geometry, goal)
            batch, given = self._closing(start.reshape(target.shape), displacements)
            return self._inverse(goal, batch, given).reshape(target.shape)

    def _inverse(self, goal: Array, batch: BatchClosure, given: Array) -> Array:
        given = given.copy()
        x = seed.free_joints(batch.tree, given[:, :3], goal)
        for _ in range(_STEPS):
            x = batch.close(given, x)
            out, by_given = batch.tangent(x, given)
            miss = goal - out.p
            largest = np.abs(miss).max(initial=0.0)
            if largest < 1e-13:
                break
            given[:, :3] += np.linalg.solve(by_given[:, :3, :3], miss[..., None])[..., 0]
        if largest < 1e-12:
            return given[:, :3] + self.geometry.zero
        raise ClosureError("the drives do not converge on the wanted points")
