"""The closures of the tree as CasADi functions, for the nonlinear programme.

They are built from the same Pinocchio model as the constraint models, without the six bars.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from orthoglide.mechanism.symbolic import SymbolicTree, rotation_error
from orthoglide.mechanism.tree import Tree


@dataclass(frozen=True)
class ClosureFunctions:
    """CasADi functions of one tree: 21 free joints, 3 drives, 30 virtual joints.

    Attributes:
        residual: (free, [travel; displacements]) -> closure residual ``(21,)``, metres and sines.
        outputs: (free, [travel; displacements]) -> ``(48,)``, as in
            :mod:`~orthoglide.mechanism.six_bars`.
    """

    residual: Any
    outputs: Any


def closure_functions(tree: Tree) -> ClosureFunctions:
    """Return the functions of a general tree."""
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
    return ClosureFunctions(
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
