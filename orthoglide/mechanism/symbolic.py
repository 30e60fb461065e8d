"""A Pinocchio model as CasADi expressions.

The wheels of Pinocchio have no ``pinocchio.casadi``, so the kinematics are built here: every joint
is its placement followed by the exponential of its motion axis (a product of exponentials, Lynch
and Park 2017, chapter 4). Expressions are SX: cheap to evaluate, to differentiate and to compile.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from orthoglide.errors import InputError
from orthoglide.mechanism.tree import Tree, frame_number

# Placements are read from text: rounding errors of exact rotations would cost operations.
_ROUNDING = 1e-15


class Transform:
    """A rigid transform with symbolic rotation ``R`` (3, 3) and translation ``t`` (3,).

    Read by cancellation: ``base_from_tool = base_from_arm @ arm_from_tool``.
    """

    def __init__(self, R: Any, t: Any) -> None:
        self.R = R
        self.t = t

    @classmethod
    def identity(cls) -> Transform:
        """Return the identity."""
        return cls(ca.SX.eye(3), ca.SX.zeros(3))

    @classmethod
    def from_se3(cls, placement: pin.SE3) -> Transform:
        """Return a constant transform."""
        return cls(_constant(placement.rotation), _constant(placement.translation))

    def __matmul__(self, other: Transform) -> Transform:
        return Transform(self.R @ other.R, self.R @ other.t + self.t)

    def inverse(self) -> Transform:
        """Return the inverse transform."""
        return Transform(self.R.T, -(self.R.T @ self.t))


def _constant(values: Any) -> Any:
    values = np.array(values, dtype=float)
    nearest = np.round(values)
    values = np.where(np.abs(values - nearest) < _ROUNDING, nearest, values)
    return ca.sparsify(ca.SX(values))


def _rotation(axis: np.ndarray, cosine: Any, sine: Any) -> Any:
    """Rodrigues' formula about a unit axis."""
    x, y, z = axis
    K = _constant(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return ca.SX.eye(3) + sine * K + (1 - cosine) * (K @ K)


def _quaternion(q: Any) -> Any:
    """Rotation of a unit quaternion in Pinocchio's order x, y, z, w."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        ca.horzcat(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        ca.horzcat(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def joint_transform(joint: Any, q: Any) -> Transform:
    """Return the transform across an element of ``model.joints`` at coordinates, SX ``(nq,)``.

    Raises:
        InputError: for a kind of joint that is not supported.
    """
    kind = joint.shortname()
    # Also by name: helical and composite joints can have the same number of coordinates.
    single_axis = kind.startswith(("JointModelR", "JointModelP"))
    if (
        single_axis and joint.nv == 1 and joint.nq <= 2
    ):  # prismatic or revolute: its axis says which
        linear, angular = np.asarray(joint.createData().S).reshape(2, 3)
        if joint.nq == 2:  # without limits: (cos, sin)
            return Transform(_rotation(angular, q[0], q[1]), ca.SX(3, 1))
        if np.any(angular):
            return Transform(_rotation(angular, ca.cos(q), ca.sin(q)), ca.SX(3, 1))
        return Transform(ca.SX.eye(3), _constant(linear) * q)
    if joint.nq == 7 and "FreeFlyer" in kind:
        return Transform(_quaternion(q[3:7]), q[0:3])
    if joint.nq == 4 and joint.nv == 3 and "Spherical" in kind:
        return Transform(_quaternion(q), ca.SX(3, 1))
    raise InputError(f"joints of kind {kind} are not supported by the symbolic tree")


class SymbolicTree:
    """Transforms between the joints and frames of a Pinocchio model as expressions of ``q``.

    Args:
        model: any tree of revolute, prismatic, spherical and free-flyer joints.
        q: SX ``(nq,)``; a new symbol where absent.
    """

    def __init__(self, model: pin.Model, q: Any = None) -> None:
        self.model = model
        self.q = ca.SX.sym("q", model.nq) if q is None else q

    @cached_property
    def _joints(self) -> list[Transform]:
        """``base_from_joint`` for every joint of the model."""
        joints = [Transform.identity()]
        for j in range(1, self.model.njoints):
            joint = self.model.joints[j]
            placement = Transform.from_se3(self.model.jointPlacements[j])
            across = joint_transform(joint, self.q[joint.idx_q : joint.idx_q + joint.nq])
            joints.append(joints[self.model.parents[j]] @ placement @ across)
        return joints

    def joint(self, joint: int) -> Transform:
        """Return ``base_from_joint`` for a joint's number."""
        return self._joints[joint]

    def frame(self, name: str) -> Transform:
        """Return ``base_from_frame`` for a frame's name.

        Raises:
            InputError: where the model has no such frame.
        """
        frame = self.model.frames[frame_number(self.model, name)]
        return self.joint(int(frame.parentJoint)) @ Transform.from_se3(frame.placement)

    def relative(self, first: str, second: str) -> Transform:
        """Return ``first_from_second`` for two frames."""
        return self.frame(first).inverse() @ self.frame(second)


def rotation_error(R: Any) -> Any:
    """Return ``0.5 vee(R - R^T)`` (3,), which is regular at the identity, unlike an angle."""
    return 0.5 * ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])


def closure_functions(tree: Tree) -> tuple[Any, Any]:
    """Return the closure residual ``(21,)``, metres and sines, and the outputs ``(48,)``, as in
    `six_bars`, of a general tree as CasADi functions of its free joints and of [travel;
    displacements], for the nonlinear programme. They do not use the six bars.
    """
    x, given = ca.SX.sym("x", len(tree.free)), ca.SX.sym("given", 3 + len(tree.virtual))
    q = ca.SX.zeros(tree.model.nq)
    for k, place in enumerate(tree.free):
        q[int(place)] = x[k]
    for k, place in enumerate([*tree.drive, *tree.virtual]):
        q[int(place)] = given[k]
    walked = SymbolicTree(tree.model, q)
    parts = []
    for loop in tree.loops:
        between = walked.relative(loop.frame_1, loop.frame_2)
        parts += [between.t, rotation_error(between.R)] if loop.kind == "frame" else [between.t]
    arguments, names = [x, given], ["free", "given"]
    return (
        ca.Function("residual", arguments, [ca.vertcat(*parts)], names, ["residual"]),
        ca.Function("outputs", arguments, [_outputs(walked, tree)], names, ["outputs"]),
    )


def _outputs(walked: SymbolicTree, tree: Tree) -> Any:
    tcp = walked.frame(tree.tool)
    parts = [tcp.t, ca.vec(tcp.R.T)]
    for leg in tree.leg_names:
        joints = [tree.model.getJointId(f"{leg}_{name}") for name in ("bar1", "knuckle", "bar2")]
        parts += [*(walked.joint(joint).t for joint in joints), walked.frame(f"{leg}_bar2_tip").t]
    return ca.densify(ca.vertcat(*parts))
