"""The closed mechanism in Pinocchio: a tree, its closures as constraint models, Newton's method."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from threading import RLock
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dgesv

from orthoglide.arguments import public
from orthoglide.errors import ClosureError, InputError, as_float_array, check_choice
from orthoglide.geometry import Array, Geometry, Mode
from orthoglide.mechanism.perfect_legs import Spheres, assembly_mode, free_joints, tool_position
from orthoglide.mechanism.six_bars import nominal_spheres
from orthoglide.mechanism.tree import VIRTUAL_NAMES, Tree, general_tree, load

# Zero singular values of the 21 rows are zero up to rounding; the smallest other one is 0.01.
_RANK_TOLERANCE = 1e-7


class Constraints:
    """Closure residual and constraint Jacobian of a tree, row by row in the order of its closures.

    Three rows a point closure (second frame's origin seen from the first), six a frame closure
    (``log6(c1Mc2)``). Holds Pinocchio's scratch data, ``models`` and ``datas`` of the constraints:
    use one object a thread.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.data = tree.model.createData()
        self.models = pin.StdVec_ConstraintModel()
        self.datas = pin.StdVec_ConstraintData()
        for loop in tree.loops:
            point = loop.kind == "point"
            anchor = pin.PointAnchorConstraintModel if point else pin.FrameAnchorConstraintModel
            self.models.append(pin.ConstraintModel(anchor(tree.model, *tree.loop_ends(loop))))
        for model in self.models:
            self.datas.append(model.createData())
        # The containers hold copies, so calculations must use their elements.
        self._pairs = [
            (self.models[k], self.datas[k], self.datas[k].extract()) for k in range(len(tree.loops))
        ]

    def residual(self, q: Array) -> Array:
        """Return the closure residual at ``q`` ``(nq,)``, metres and radians."""
        pin.computeJointJacobians(self.tree.model, self.data, q)
        # Without calc first, Pinocchio's constraint Jacobian is silently wrong.
        for model, data, _ in self._pairs:
            model.calc(self.tree.model, self.data, data)
        return np.concatenate([view.constraint_position_error for _, _, view in self._pairs])

    def newton_matrix(self) -> Array:
        """Return the constraint Jacobian ``(rows, nv)`` where the residual was last evaluated.

        It is exact where the loops are closed. Elsewhere the rows of frame closures are relative
        twists, without the factors ``Jlog6(M) M.actInv``: Newton's method converges all the same.
        """
        return np.asarray(
            pin.getConstraintsJacobian(self.tree.model, self.data, self.models, self.datas)
        )

    def jacobian(self, q: Array) -> Array:
        """Return the derivative ``(rows, nv)`` of the residual by the joints, closed or not."""
        self.residual(q)
        rows = self.newton_matrix()
        for loop, (_, _, view) in zip(self.tree.loops, self._pairs, strict=True):
            if loop.kind == "frame":
                loop_rows, placement = self.tree.rows[loop.name], view.c1Mc2
                rows[loop_rows] = (
                    pin.Jlog6(placement) @ placement.inverse().action @ rows[loop_rows]
                )
        return rows


@dataclass(frozen=True)
class Mobility:
    """How a machine with loops is constrained at one posture."""

    joints: int  # joints of the tree, drives included
    rows: int  # closure rows
    rank: int  # independent ones among them
    mobility: int  # degrees of freedom, `joints - rank`
    # conditions that the others imply, `rows - rank`: the machine is overconstrained, and errors
    # of the parts strain it
    redundant: int
    by_loop: dict[str, int]  # rank of each loop's rows alone

    def __str__(self) -> str:
        ranks = [rank for name, rank in self.by_loop.items() if "parallelogram" in name]
        planar = 3 * len(ranks) - sum(ranks)
        summary = (
            f"{self.joints} joints, {self.rows} closure rows of rank {self.rank}: mobility "
            f"{self.mobility}, {self.redundant} redundant rows."
        )
        if not ranks:
            return summary
        return (
            f"{summary} {planar} of them are in the parallelograms, whose planes already follow "
            f"from the other rows. The other {self.redundant - planar} repeat constraints on the "
            f"platform's rotation, because every leg resists torsion."
        )


def mobility(constraints: Constraints, q: Array) -> Mobility:
    """Return the mobility of the nominal tree at a closed posture ``q``."""

    def rank_of(rows: Array) -> int:
        return int(np.linalg.matrix_rank(rows, rtol=_RANK_TOLERANCE))

    rows = constraints.jacobian(q)
    by_loop = {name: rank_of(rows[part]) for name, part in constraints.tree.rows.items()}
    (count, joints), rank = rows.shape, rank_of(rows)
    return Mobility(joints, count, rank, joints - rank, count - rank, by_loop)


CLOSED = 1e-11
"""Largest closure residual, metres and radians, that counts as closed."""

_MAX_STEPS = 30  # within the stroke four to eight suffice
_LONGEST_STEP = 0.5  # radians; keeps a cold start from jumping to the other assembly mode


@dataclass(frozen=True)
class Posture:
    """One closed posture.

    Attributes:
        q: configuration of the tree ``(nq,)``, metres and radians: every passive joint is in it.
        p: tool ``(3,)``, metres, base frame.
        R: its rotation ``(3, 3)``.
        residual: largest closure residual by loop, metres or radians.
        iterations: Newton's steps taken.
    """

    q: Array
    p: Array
    R: Array
    residual: dict[str, float]
    iterations: int


@public
class Mechanism:
    """A machine with closed loops: a Pinocchio model and its constraint models.

    By default three PRPaR legs with relief joints: 21 unknowns for 21 rows, which close for any
    errors of the parts and equal the rigid PRPaR machine where the errors are compatible. A lock
    serialises threads.

    Args:
        geometry: nominal dimensions of the three legs, the published ones where absent.
        urdf: folder with a URDF of three such legs and the file with its closures, which define
            the joints; of the dimensions only the command at mechanical zero is used.
    """

    def __init__(
        self, geometry: Geometry | None = None, *, urdf: str | os.PathLike[str] = ""
    ) -> None:
        geometry = geometry or Geometry()
        nominal = load(urdf or geometry)
        self._build(geometry, nominal, general_tree(nominal))

    def _build(self, geometry: Geometry, nominal: Tree, tree: Tree) -> None:
        self.geometry, self.nominal, self.tree = geometry, nominal, tree
        self.constraints = Constraints(tree)
        self.lock = RLock()  # of Pinocchio's scratch data
        self.tool = tree.frame(tree.tool)
        by_velocity = {joint.idx_v: joint for joint in list(tree.model.joints)[1:]}
        self._drives = [by_velocity[int(v)] for v in tree.drive]

    @classmethod
    def from_urdf(cls, folder: str | os.PathLike[str], tool: str = "") -> Mechanism:
        """Return any machine with loops, from a folder with its URDF and its closures.

        The folder contains ``orthoglide.urdf`` with ``orthoglide.closures.toml``, or ``robot.urdf``
        with ``robot.yaml`` in the convention of Gepetto's parallel robots. No joints are added.

        Args:
            folder: with both files.
            tool: the link whose pose :meth:`close` reports; by default the first link of the last
                closure.

        Raises:
            FileError: where a file is missing or invalid.
            InputError: where the tree has no link ``tool``.
        """
        tree = load(folder)
        return _built(Geometry(), tree, replace(tree, tool=tool) if tool else tree)

    def __reduce__(self) -> tuple[Any, ...]:
        # Constraint objects do not pickle: another process builds its own.
        return _built, (self.geometry, self.nominal, self.tree)

    def __repr__(self) -> str:
        model, rows = self.tree.model, sum(loop.rows for loop in self.tree.loops)
        return (
            f"<Mechanism {model.name!r}: {model.njoints - 1} joints, {len(self.tree.motors)} of "
            f"them driven, {len(self.tree.loops)} loops of {rows} rows>"
        )

    @property
    def has_legs(self) -> bool:
        """Whether it is three PRPaR legs with relief and virtual joints."""
        return len(self.tree.virtual) > 0

    @cached_property
    def spheres(self) -> Spheres:
        """Legs without errors, from which the closure in a given assembly mode starts."""
        return nominal_spheres(self.tree, self._command_at_zero)

    @property
    def _command_at_zero(self) -> Array:
        """Command at which the drives' joints are at zero."""
        return self.geometry.zero if self.has_legs else np.zeros(len(self.tree.drive))

    def close(
        self,
        command: ArrayLike,
        displacements: ArrayLike | None = None,
        *,
        mode: Mode = "machine",
        legs: Literal["relieved", "rigid"] = "relieved",
        guess: Posture | None = None,
    ) -> Posture:
        """Close the loops by Newton's method on Pinocchio's constraint Jacobian.

        Args:
            command: of the drives ``(3,)``, metres: rho of an Orthoglide (2008, eq. 2). Of a
                foreign machine the positions ``(m,)`` of its driven joints.
            displacements: of the virtual joints ``(3, 10)``, as in ``VIRTUAL_NAMES``.
            mode: assembly mode of three legs.
            legs: ``"rigid"`` keeps the relief joints at zero: least squares on all rows, which
                fails for incompatible errors of the parts.
            guess: a nearby posture to start from.

        Raises:
            ClosureError: where the loops do not close, with the residual by loop.
            InputError: where the arguments have the wrong shape or are not finite.
        """
        check_choice("assembly mode", mode, get_args(Mode))
        check_choice("kind of legs", legs, ("relieved", "rigid"))
        if mode != "machine" and not self.has_legs:
            raise InputError("only three PRPaR legs have modes by name: give a guess to start from")
        with self.lock:
            q = self._start_configuration(command, displacements, guess)
            return self._close(q, mode, legs, guess)

    def _close(
        self, q: Array, mode: Mode, legs: Literal["relieved", "rigid"], guess: Posture | None
    ) -> Posture:
        moving = self.tree.passive if legs == "rigid" else self.tree.free
        if mode == "machine" or guess is not None:
            try:
                return self._check_posture(*self._newton(q, moving), mode, legs)
            except ClosureError:
                if guess is not None or not self.has_legs:
                    raise
        # For the other mode, and where Newton's method failed, start from legs without errors.
        travel = q[None, self.tree.drive]
        p = tool_position(self.spheres, travel, mode)
        if np.isfinite(p).all():
            q[self.tree.free] = free_joints(self.tree, self.spheres, travel, p)[0]
        return self._check_posture(*self._newton(q, moving), mode, legs)

    def _newton(self, q: Array, moving: NDArray[np.intp]) -> tuple[Array, int]:
        """Return the final configuration of Newton's method, and the number of steps."""
        step, steps = np.zeros(self.tree.model.nv), 0
        while steps < _MAX_STEPS:
            steps += 1
            residual = self.constraints.residual(q)
            jacobian = self.constraints.newton_matrix()[:, moving]
            change = _solve_least_squares(jacobian, residual)
            largest = float(np.abs(change).max(initial=0.0))
            if not np.isfinite(largest):
                break
            step[moving] = -change * (_LONGEST_STEP / max(largest, _LONGEST_STEP))
            q = pin.integrate(self.tree.model, q, step)
            if largest < 1e-8:  # quadratic convergence: the remaining error is its square
                break
        return q, steps

    def _start_configuration(
        self, command: ArrayLike, displacements: ArrayLike | None, guess: Posture | None
    ) -> Array:
        tree, positions = self.tree, as_float_array("the command", command)
        if positions.shape != tree.drive.shape or not np.isfinite(positions).all():
            raise InputError(f"close takes one command {tree.drive.shape} of finite numbers")
        if guess is not None and not (isinstance(guess, Posture) and len(guess.q) == tree.model.nq):
            raise InputError("a guess must be a posture of this mechanism")
        q = pin.neutral(tree.model) if guess is None else guess.q.copy()
        for joint, position in zip(self._drives, positions - self._command_at_zero, strict=True):
            # The configuration of a joint without limits is cosine and sine.
            continuous = joint.nq == 2
            part = slice(joint.idx_q, joint.idx_q + joint.nq)
            q[part] = (np.cos(position), np.sin(position)) if continuous else position
        if displacements is not None and not self.has_legs:
            raise InputError("this machine has no virtual joints, so it takes no displacements")
        if self.has_legs:
            moves = np.zeros((3, len(VIRTUAL_NAMES))) if displacements is None else displacements
            moves = as_float_array("displacements", moves)
            if moves.shape != (3, len(VIRTUAL_NAMES)) or not np.isfinite(moves).all():
                raise InputError("displacements must be finite numbers of shape (3, 10)")
            q[tree.virtual] = moves.ravel()
        return q

    def _check_posture(self, q: Array, iterations: int, mode: Mode, legs: str) -> Posture:
        residual = self.constraints.residual(q)
        by_loop = self.tree.by_loop(residual)
        if not float(np.abs(residual).max(initial=0.0)) <= CLOSED:
            loop, size = max(by_loop.items(), key=lambda item: np.nan_to_num(item[1], nan=np.inf))
            reason = (
                "rigid PRPaR legs cannot take up these errors of the parts"
                if legs == "rigid" and iterations < _MAX_STEPS
                else "the legs do not reach each other"
                if self.has_legs
                else "they cannot, or a nearer guess is needed"
            )
            raise ClosureError(
                f"the loops do not close: {reason}; the largest misfit is {size * 1e3:.3g} mm or "
                f"mrad at {loop}",
                residuals=by_loop,
            )
        placement = pin.updateFramePlacement(self.tree.model, self.constraints.data, self.tool)
        p, R = placement.translation.copy(), placement.rotation.copy()
        if self.has_legs:
            posture_mode = assembly_mode(self.spheres, q[self.tree.drive], p)
            if posture_mode != mode:
                place = (
                    f"in the {posture_mode} assembly mode"
                    if posture_mode
                    else "where the assembly modes meet"
                )
                raise ClosureError(
                    f"the loops close {place}, not in the {mode} assembly mode",
                    residuals=by_loop,
                )
        return Posture(q, p, R, by_loop, iterations)

    def velocity_jacobian(self, posture: Posture) -> Array:
        """Return dp/drho ``(3, m)`` at a posture (2008, eq. 5), from the constraint Jacobian."""
        return np.asarray(self.frame_velocities(posture, self.tree.drive, [self.tool])[0, :3])

    def frame_velocities(
        self, posture: Posture, by: NDArray[np.intp], frames: Sequence[int]
    ) -> Array:
        """Return velocities of frames ``(f, 6, k)`` in the base frame, linear and angular, for unit
        rates of joints while the loops stay closed.

        Args:
            posture: closed.
            by: indices of drives or virtual joints in the velocity vector ``(k,)``.
            frames: numbers of the frames ``(f,)``.
        """
        model, free, data = self.tree.model, self.tree.free, self.constraints.data
        with self.lock:
            rows = self.constraints.jacobian(posture.q)
            rates = np.zeros((model.nv, len(by)))
            rates[by, np.arange(len(by))] = 1.0
            rates[free] = -_solve_least_squares(rows[:, free], rows[:, by])
            axes = pin.LOCAL_WORLD_ALIGNED
            return np.stack(
                [pin.getFrameJacobian(model, data, frame, axes) @ rates for frame in frames]
            )

    def mobility(self, command: ArrayLike) -> Mobility:
        """Return mobility and redundancy of the machine with rigid legs at a command ``(m,)``."""
        if not self.has_legs:
            return mobility(self.constraints, self.close(command).q)
        posture = self.close(command, legs="rigid")
        q = np.zeros(self.nominal.model.nq)
        q[self.nominal.drive] = posture.q[self.tree.drive]
        q[self.nominal.passive] = posture.q[self.tree.passive]
        return mobility(Constraints(self.nominal), q)


def _built(geometry: Geometry, nominal: Tree, tree: Tree) -> Mechanism:
    mechanism = Mechanism.__new__(Mechanism)
    mechanism._build(geometry, nominal, tree)
    return mechanism


def _solve_least_squares(matrix: Array, right_side: Array) -> Array:
    """Return the least-squares solution of a linear system, by elimination where it is square.

    Some rows of a rigid mechanism are redundant (a planar loop closed in space): its system is
    consistent, and the rank is less than the number of rows.
    """
    if matrix.shape[0] == matrix.shape[1]:
        _, _, solution, info = dgesv(matrix, right_side)
        if info == 0:
            return np.asarray(solution)
    return np.asarray(np.linalg.lstsq(matrix, right_side, rcond=1e-9)[0])
