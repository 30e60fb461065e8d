"""The closed mechanism as CasADi functions, for the NLP and for mapped or compiled batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from orthoglide.mechanism.symbolic import SymbolicTree, Transform, rotation_error
from orthoglide.mechanism.tree import Tree

_PLANAR, _PLACES = (0, 2, 3, 5, 6, 8), (9, 10, 11, 15, 16, 17)
_TURNS = (12, 13, 14, 18, 19, 20)

TCP, ROTATION, LINES = slice(0, 3), slice(3, 12), slice(12, 48)
"""Parts of an output vector: p, the platform's rotation row by row, and the ends of the bars
indexed (leg, bar, end, xyz) with the carriage's end first."""
OUTPUTS = 48


@dataclass(frozen=True)
class ClosureFunctions:
    """CasADi functions of one tree: ``n`` free joints, 3 drives, ``m`` virtual joints."""

    residual: Any  # (free, [drive; virtual]) -> (n,) closure residual, metres and sines of angles
    # (guess, [drive; virtual]) -> free joints that close the loops (Newton), the residual that is
    # left, and the side
    close: Any
    outputs: Any  # (free, [drive; virtual]) -> (48,), see `TCP`, `ROTATION`, `LINES`
    # (free, [drive; virtual]) -> outputs and their total derivative (48, 3 + m) with the loops kept
    # closed
    tangent: Any
    # (free, [drive; virtual]) -> a number that is negative in the machine's own assembly mode,
    # positive in the other and 0 where they meet, without a scale; and the sum of the squares of
    # the free joints' angles: Newton's method that jumped ends many turns away, and not always with
    # its bars parallel
    side: Any


def closure_functions(
    tree: Tree, free: NDArray[np.intp], rows: Sequence[int] | None = None
) -> ClosureFunctions:
    """Build the functions of a tree.

    Args:
        tree: nominal or general.
        free: positions in q of the joints that closure moves.
        rows: as many independent closure rows; all where absent.
    """
    x, given = ca.SX.sym("x", len(free)), ca.SX.sym("given", 3 + len(tree.virtual))
    q = ca.SX.zeros(tree.model.nq)
    for k, place in enumerate(free):
        q[int(place)] = x[k]
    for k, place in enumerate([*tree.drive, *tree.virtual]):
        q[int(place)] = given[k]
    walked = SymbolicTree(tree.model, q)
    parts = []
    for loop in tree.loops:
        between = walked.relative(loop.frame_1, loop.frame_2)
        parts += [between.t, rotation_error(between.R)] if loop.kind == "frame" else [between.t]
    residual = ca.vertcat(*parts)
    if rows is not None:
        residual = residual[list(rows)]
    outputs = _outputs(walked, tree)
    arguments, names = [x, given], ["guess", "given"]
    residual_f = ca.Function("residual", arguments, [residual], names, ["residual"])
    outputs_f = ca.Function("outputs", arguments, [outputs], names, ["outputs"])
    side_f = ca.Function("side", arguments, [_side(x, outputs, tree)], names, ["side"])
    root = ca.rootfinder(
        "root",
        "fast_newton",
        residual_f,
        {"max_iter": 25, "abstol": 1e-14, "abstolStep": 1e-13, "error_on_fail": False},
    )
    close_f, tangent_f = closing(root, residual_f, side_f), _tangent(x, given, residual, outputs)
    return ClosureFunctions(residual_f, close_f, outputs_f, tangent_f, side_f)


def closing(root: Any, residual: Any, side: Any) -> Any:
    """(guess, known) -> what a root finder ends at, the residual and the side there."""
    guess, known = ca.MX.sym("guess", root.size1_in(0)), ca.MX.sym("given", root.size1_in(1))
    x = root(guess, known)
    names = ["guess", "given"], ["x", "residual", "side"]
    found = [x, residual(x, known), side(x, known)]
    return ca.Function("close", [guess, known], found, *names)


def rigid_rows(tree: Tree) -> tuple[int, ...]:
    """Rows of the 21 that are independent while the legs are rigid, over the whole workspace.

    Of each parallelogram the two in its plane, all translations of the platform, and the three of
    the six relative rotations that hold best: a rigid leg lets the platform turn about its c alone.
    (Three rotations of one pair of legs are singular.)
    """
    c = np.stack([leg.axes[:, 2] for leg in tree.geometry.legs])
    of_pairs = np.zeros((6, 3))  # relative rotation of legs 1, 2 and 1, 3 by the turns about c
    of_pairs[:3, 0], of_pairs[:3, 1] = c[0], -c[1]
    of_pairs[3:, 0], of_pairs[3:, 2] = c[0], -c[2]
    size = {k: abs(np.linalg.det(of_pairs[list(k)])) for k in combinations(range(6), 3)}
    best = next(k for k, v in size.items() if v > max(size.values()) - 1e-9)
    return tuple(sorted((*_PLANAR, *_PLACES, *(_TURNS[k] for k in best))))


def _outputs(walked: SymbolicTree, tree: Tree) -> Any:
    tcp = walked.frame(tree.tool)
    parts = [tcp.t, ca.vec(tcp.R.T)]
    half = ca.SX([0, 0, tree.geometry.d / 2])
    for leg in tree.geometry.leg_names:
        fork = walked.joint(tree.model.getJointId(f"{leg}_theta"))
        knuckle = walked.joint(tree.model.getJointId(f"{leg}_knuckle"))
        ends = {1: knuckle, 2: walked.frame(f"{leg}_bar2_tip")}
        for bar, side in ((1, half), (2, -half)):
            carriage = fork @ Transform(ca.SX.eye(3), side)
            parts += [carriage.t, ends[bar].t]
    return ca.densify(ca.vertcat(*parts))


def _side(x: Any, outputs: Any, tree: Tree) -> Any:
    """Of the plane of the carriages, the platform's size taken out: where the tool is, times where
    the machine's side is not; and how far the joints are from neutral.

    A hanging platform is below; else the origin's side is the machine's, for the legs' order alone
    would point at the origin once a carriage has passed it.
    """
    geometry, starts = tree.geometry, LINES.start
    one, two, three = (
        (outputs[k : k + 3] + outputs[k + 6 : k + 9]) / 2 - ca.SX(leg.platform)
        for k, leg in zip(range(starts, OUTPUTS, 12), geometry.legs, strict=True)
    )
    normal = ca.cross(two - one, three - one)
    away = ca.SX(geometry.slides[0]) if geometry.layout.hanging else one
    below = ca.dot(normal, outputs[TCP] - one) * ca.dot(normal, away)
    return ca.vertcat(below, ca.sumsqr(x))


def _tangent(x: Any, given: Any, residual: Any, outputs: Any) -> Any:
    """Outputs and ``d outputs / d given`` where ``residual(x, given) = 0`` is kept."""
    parts = ca.Function(
        "parts",
        [x, given],
        [
            outputs,
            ca.jacobian(residual, x),
            ca.jacobian(residual, given),
            ca.jacobian(outputs, x),
            ca.jacobian(outputs, given),
        ],
    )
    X, G = ca.MX.sym("guess", x.numel()), ca.MX.sym("given", given.numel())
    value, by_x, by_given, out_x, out_given = parts(X, G)
    moved = -ca.solve(by_x, by_given, "qr")
    return ca.Function(
        "tangent",
        [X, G],
        [value, ca.densify(out_given + out_x @ moved)],
        ["guess", "given"],
        ["outputs", "by_given"],
    )
