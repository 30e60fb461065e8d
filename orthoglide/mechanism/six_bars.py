"""The closed machine as a platform on six bars: the fast engine.

With the relief joints every bar is a link between two ball joints, so closing the loops means
finding the pose (p, R) of the platform at which six distances equal six bar lengths. With
``start`` and the axes A of leg i's carriage at mechanical zero, its slide direction ``s``, travel
``t`` and virtual joints ``v``::

    root_k   = start + A (s t + (v_travel, v_b, v_c) + Rot(v_turns) root0_k)       base frame
    point_k  = point0_k + v_width_k width_k                                        platform frame
    length_k = length0_k + v_stretch_k

One Newton step on (dp, dw), ``e_k = p + R point_k - root_k``, solves

    e_k . dp + (R point_k x e_k) . dw = (length_k^2 - e_k . e_k) / 2

and then ``p += dp``, ``R = Cayley(dw) R``. Each leg has two bars k; the sum and difference of their
rows split the system into 3 x 3 blocks (block elimination by the Schur complement of the sums),
which are inverted by cofactors: elimination without pivoting would lose digits
on linear deltas, where a first pivot can vanish although the system is well conditioned.

The constants are read from the Pinocchio tree (:func:`constants`). They are inputs of the CasADi
functions, so one compiled library serves every machine.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.mechanism.perfect_legs import Spheres
from orthoglide.mechanism.tree import PASSIVE_NAMES, RELIEF_NAMES, VIRTUAL_NAMES, Tree

TCP, ROTATION, LINES = slice(0, 3), slice(3, 12), slice(12, 48)
"""Parts of an output vector: p, the platform's rotation row by row, and the ends of the bars
indexed (leg, bar, end, xyz), the carriage's end first."""
OUTPUT_SIZE = 48

VIRTUAL_PER_LEG = len(VIRTUAL_NAMES)
INPUT_SIZE = 3 + 3 * VIRTUAL_PER_LEG
"""Length of the input of a posture: travel of the drives, then virtual joints leg by leg."""

_START, _AXES, _SLIDE, _ROOTS, _POINTS, _WIDTHS, _LENGTHS, _SIZE = 0, 3, 12, 15, 21, 27, 33, 35
CONSTANTS_SIZE = 3 * _SIZE + 1
"""Length of a machine's constants: 35 a leg, and whether the platform hangs below its rails."""

# The start is some milliradians off. Three quadratic steps leave (5e-3)^8 < 1e-18. A fourth step
# with the matrix of the third (a chord step, at a third of the cost) removes its rounding error.
_NEWTON, _CHORD = 3, 1
_MAX_BAR_LENGTH = 10.0  # metres: longer bars were given in millimetres
# Metres a bar's end may move with the passive joints: rounding of a chain of five joints.
_BAR_END_TOLERANCE = 1e-12


def constants(tree: Tree) -> Array:
    """Return the constants ``(106,)`` of a machine's six bars, read from its Pinocchio tree.

    Raises:
        InputError: where the end of a bar moves with a passive joint (its pivots do not meet in a
            point), so that the legs are no bars between ball joints.
    """
    values = np.zeros(CONSTANTS_SIZE)
    for leg, name in enumerate(tree.leg_names):
        values[leg * _SIZE : (leg + 1) * _SIZE] = _leg_constants(tree, name)
    values[-1] = float(tree.hanging)
    return values


def _leg_constants(tree: Tree, leg: str) -> Array:
    """Return the constants of one leg: bar ends in the frames of carriage and platform, checked."""
    model, data = tree.model, tree.model.createData()
    carriage, tool = model.getJointId(f"{leg}_turn_c"), tree.frame(f"{leg}_tcp")
    bars = [model.getJointId(f"{leg}_bar{k}") for k in (1, 2)]
    knuckle = model.getJointId(f"{leg}_knuckle")
    knuckle_tip, bar2_tip = tree.frame(f"{leg}_knuckle_tip"), tree.frame(f"{leg}_bar2_tip")

    def evaluate(**joints: float) -> tuple[pin.SE3, list[Array], list[Array], list[float]]:
        q = np.zeros(model.nq)
        for joint, value in joints.items():
            q[model.joints[model.getJointId(f"{leg}_{joint}")].idx_q] = value
        pin.framesForwardKinematics(model, data, q)
        base_from_carriage, base_from_tool = data.oMi[carriage], data.oMf[tool]
        roots = [data.oMi[bar].translation for bar in bars]
        ends = [data.oMi[knuckle].translation, data.oMf[knuckle_tip].translation]
        lengths = [
            float(np.linalg.norm(end - root))
            for end, root in zip((ends[0], data.oMf[bar2_tip].translation), roots, strict=True)
        ]
        return (
            base_from_carriage.copy(),
            [base_from_carriage.actInv(root) for root in roots],
            [base_from_tool.actInv(end) for end in ends],
            lengths,
        )

    reference = evaluate()
    probes = [evaluate(slide=0.01), evaluate(width1=1.0), evaluate(width2=1.0)]
    names = (*PASSIVE_NAMES, *RELIEF_NAMES)
    draws = np.random.default_rng(0)
    for _ in range(3):  # any angles show whether the ends are constant
        turned = evaluate(**{joint: float(draws.uniform(-0.5, 0.5)) for joint in names})
        for k, quantity in enumerate(("carriage end", "platform end", "length"), start=1):
            change = float(np.abs(np.array(reference[k]) - np.array(turned[k])).max())
            if change > _BAR_END_TOLERANCE:
                raise InputError(
                    f"leg {leg}: the {quantity} of a bar changes by {change * 1e3:.3g} mm as the "
                    f"leg's pivots turn, so they do not meet in one point: correct the joint "
                    f"origins in the URDF"
                )
    base_from_carriage, roots, points, lengths = reference
    if not all(0 < length < _MAX_BAR_LENGTH for length in lengths):
        raise InputError(
            f"leg {leg}: the URDF has bars of {lengths[0]:.4g} and {lengths[1]:.4g} m: give their "
            f"lengths in metres"
        )
    slide = base_from_carriage.actInv(probes[0][0].translation) / 0.01
    widths = [probes[1][2][0] - points[0], probes[2][2][1] - points[1]]
    return np.concatenate(
        [base_from_carriage.translation, base_from_carriage.rotation.ravel(), slide, *roots,
         *points, *widths, lengths]
    )  # fmt: skip


def nominal_spheres(tree: Tree, zero: Array) -> Spheres:
    """Return the spheres on which the TCP lies while the platform is not turned, without errors;
    ``zero``: command at mechanical zero ``(3,)``, metres.
    """
    legs = constants(tree)[:-1].reshape(3, _SIZE)
    axes = legs[:, _AXES:_SLIDE].reshape(3, 3, 3)
    roots, points = (
        legs[:, start : start + 6].reshape(3, 2, 3).mean(axis=1) for start in (_ROOTS, _POINTS)
    )
    centres = legs[:, _START:_AXES] + np.einsum("lij,lj->li", axes, roots) - points
    slides = np.einsum("lij,lj->li", axes, legs[:, _SLIDE:_ROOTS])
    lengths = legs[:, _LENGTHS:].mean(axis=1)
    return Spheres(centres, slides, lengths, zero, tree.hanging, tree.leg_names)


class _Leg:
    """Symbols of one leg: its constants ``c`` (35,), travel, displacements ``v`` (10,)."""

    def __init__(self, c: Any, travel: Any, v: Any) -> None:
        self.axes = ca.reshape(c[_AXES:_SLIDE], 3, 3).T
        self.slide = c[_SLIDE:_ROOTS]
        turn_a, turn_b, turn_c = (_axis_rotation(axis, v[3 + axis]) for axis in range(3))
        turned, centre = turn_a @ turn_b @ turn_c, self.slide * travel + v[0:3]
        arms = [turned @ c[_ROOTS + 3 * k : _ROOTS + 3 * k + 3] for k in range(2)]
        self.roots = [c[_START:_AXES] + self.axes @ (centre + arm) for arm in arms]
        widths = [c[_WIDTHS + 3 * k : _WIDTHS + 3 * k + 3] for k in range(2)]
        tips = [c[_POINTS + 3 * k : _POINTS + 3 * k + 3] for k in range(2)]
        self.points = [tips[k] + v[8 + k] * widths[k] for k in range(2)]
        self.lengths = [c[_LENGTHS + k] + v[6 + k] for k in range(2)]
        self.tip = (tips[0] + tips[1]) / 2


def _axis_rotation(axis: int, angle: Any) -> Any:
    """Rotation about axis 0, 1 or 2."""
    cosine, sine = ca.cos(angle), ca.sin(angle)
    R = ca.SX.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R[j, j], R[k, k], R[j, k], R[k, j] = cosine, cosine, -sine, sine
    return R


class _Symbols:
    """Inputs of the functions, and the legs as functions of them."""

    def __init__(self) -> None:
        self.constants = ca.SX.sym("constants", CONSTANTS_SIZE)
        self.travel, self.moves = ca.SX.sym("travel", 3), ca.SX.sym("moves", 3 * VIRTUAL_PER_LEG)
        self.legs = [
            _Leg(
                self.constants[leg * _SIZE : (leg + 1) * _SIZE],
                self.travel[leg],
                self.moves[leg * VIRTUAL_PER_LEG : (leg + 1) * VIRTUAL_PER_LEG],
            )
            for leg in range(3)
        ]
        self.inputs = [self.constants, self.travel, self.moves]

    def centres(self) -> list[Any]:
        """Centres of the spheres on which the TCP lies while the platform is not turned."""
        return [(leg.roots[0] + leg.roots[1]) / 2 - leg.tip for leg in self.legs]

    def upward(self, normal: Any, centres: list[Any]) -> Any:
        """A number, positive where ``normal`` of the carriages' plane points to its far side.

        Below parallel rails the far side is up the rails; else it is away from the origin.
        """
        first, hanging = self.legs[0], self.constants[CONSTANTS_SIZE - 1]
        along_rail, outward = first.axes @ first.slide, centres[0] / first.lengths[0]
        return ca.dot(normal, hanging * along_rail + (1 - hanging) * outward)


def closing_functions() -> list[Any]:
    """Return CasADi functions that close the machine: from the three spheres, and from a pose.

    The first takes (constants, travel (3,), moves (30,)), the second also a pose (12,): p and R row
    by row. Both return (outputs (48,), check (3,)). The check contains the largest error of a bar's
    length, metres; a dimensionless number that is negative in the machine's own assembly mode and 0
    where the modes meet; and the trace of R.
    """
    symbols, pose = _Symbols(), ca.SX.sym("pose", 12)
    names = ["outputs", "check"]
    from_spheres = _closed(symbols, _spheres(symbols), ca.SX.eye(3))
    from_pose = _closed(symbols, pose[0:3], ca.reshape(pose[3:12], 3, 3).T)
    inputs = ["constants", "travel", "moves"]
    return [
        ca.Function("close", symbols.inputs, from_spheres, inputs, names),
        ca.Function("close_from", [*symbols.inputs, pose], from_pose, [*inputs, "pose"], names),
    ]


def _spheres(symbols: _Symbols) -> Any:
    """Return the TCP of an unrotated platform, where three spheres about the carriages meet."""
    centres = symbols.centres()
    squares = [((leg.lengths[0] + leg.lengths[1]) / 2) ** 2 for leg in symbols.legs]
    u, v = centres[1] - centres[0], centres[2] - centres[0]
    w = ca.cross(u, v)
    along_u = (ca.sumsqr(u) + squares[0] - squares[1]) / 2
    along_v = (ca.sumsqr(v) + squares[0] - squares[2]) / 2
    foot = (along_u * ca.cross(v, w) + along_v * ca.cross(w, u)) / ca.sumsqr(w)
    height = ca.sqrt(ca.fmax(squares[0] - ca.sumsqr(foot), 0) / ca.sumsqr(w))
    return centres[0] + foot - ca.sign(symbols.upward(w, centres)) * height * w


def _closed(symbols: _Symbols, p: Any, R: Any) -> list[Any]:
    """Return outputs and check after Newton's steps from a pose."""
    blocks = _blocks(_newton_rows(symbols, p, R)[0])
    for step in range(_NEWTON + _CHORD):
        rows, misses = _newton_rows(symbols, p, R)
        if step < _NEWTON:
            blocks = _blocks(rows)
        dp, dw = _solve_newton_rows(blocks, misses)
        p, half = p + dp, dw / 2
        # Cayley's map of a small turn, column by column: R + 2 / (1 + h.h) h x (R + h x R).
        factor, old = 2 / (1 + ca.sumsqr(half)), ca.horzsplit(R)
        R = ca.horzcat(*[c + factor * ca.cross(half, c + ca.cross(half, c)) for c in old])
    misfit = ca.SX(0)
    for leg in symbols.legs:
        for root, point, length in zip(leg.roots, leg.points, leg.lengths, strict=True):
            misfit = ca.fmax(misfit, ca.fabs(ca.norm_2(p + R @ point - root) - length))
    centres = symbols.centres()
    normal = ca.cross(centres[1] - centres[0], centres[2] - centres[0])
    side = ca.dot(normal, p - centres[0]) * symbols.upward(normal, centres)
    side /= symbols.legs[0].lengths[0] ** 5
    return ca.cse([_outputs(symbols, p, R), ca.vertcat(misfit, side, ca.trace(R))])


def _outputs(symbols: _Symbols, p: Any, R: Any) -> Any:
    """Return the outputs ``(48,)`` of a pose."""
    pairs = [pair for leg in symbols.legs for pair in zip(leg.roots, leg.points, strict=True)]
    lines = [end for root, point in pairs for end in (root, p + R @ point)]
    return ca.densify(ca.vertcat(p, ca.vec(R.T), *lines))


def _newton_rows(symbols: _Symbols, p: Any, R: Any) -> tuple[list[list[Any]], list[Any]]:
    """Return rows of the Newton system, ``[e, R point x e]`` of the six bars, and right sides."""
    rows, misses = [], []
    for leg in symbols.legs:
        for k in range(2):
            arm = R @ leg.points[k]
            e = p + arm - leg.roots[k]
            rows.append([*ca.vertsplit(e), *ca.vertsplit(ca.cross(arm, e))])
            misses.append((leg.lengths[k] ** 2 - ca.sumsqr(e)) / 2)
    return rows, misses


def _solve_newton_rows(blocks: _Blocks, right: list[Any]) -> tuple[Any, Any]:
    """Return (dp, dw) that solve six rows with given blocks."""
    shared, differences, inverse_sums, inverse_schur = blocks
    r_sum = ca.vertcat(*[right[2 * leg] + right[2 * leg + 1] for leg in range(3)])
    r_difference = ca.vertcat(*[right[2 * leg] - right[2 * leg + 1] for leg in range(3)])
    reduced = inverse_sums @ r_sum
    dw = inverse_schur @ (r_difference - differences @ reduced)
    return reduced - shared @ dw, dw


class _Blocks(NamedTuple):
    """Block factors of six rows: sums ``[S_p, S_w]`` and differences ``[D_p, D_w]`` of a leg's."""

    shared: Any  # S_p^-1 S_w
    differences: Any  # D_p
    inverse_sums: Any  # S_p^-1
    inverse_schur: Any  # (D_w - D_p S_p^-1 S_w)^-1


def _blocks(rows: list[list[Any]]) -> _Blocks:
    """Return the block factors of the six rows."""

    def block(sign: int, columns: range) -> Any:
        pairs = [(rows[2 * leg], rows[2 * leg + 1]) for leg in range(3)]
        return ca.vertcat(*[ca.horzcat(*[a[j] + sign * b[j] for j in columns]) for a, b in pairs])

    places, turns = range(3), range(3, 6)
    inverse_sums = _inverse(block(1, places))
    shared = inverse_sums @ block(1, turns)
    differences = block(-1, places)
    schur = block(-1, turns) - differences @ shared
    return _Blocks(shared, differences, inverse_sums, _inverse(schur))


def _inverse(M: Any) -> Any:
    """Inverse of a 3 x 3 matrix by cofactors."""
    cofactors = ca.horzcat(
        ca.cross(M[1, :], M[2, :]).T, ca.cross(M[2, :], M[0, :]).T, ca.cross(M[0, :], M[1, :]).T
    )
    return cofactors * (1 / ca.dot(M[0, :].T, cofactors[:, 0]))


def tangent_function() -> Any:
    """Return the CasADi function (constants, travel, moves, pose (12,)) -> d outputs / d given.

    The matrix is ``(48, 33)``: by the travel of the three drives, then by the virtual joints leg by
    leg. By the theorem on implicit functions the rows of Newton's method also give the velocity
    of the platform: ``rows (dp, dw) = d((length^2 - e . e) / 2) / d given``.
    """
    symbols, pose, twist = _Symbols(), ca.SX.sym("pose", 12), ca.SX.sym("twist", 6)
    p, R = pose[0:3], ca.reshape(pose[3:12], 3, 3).T
    given = ca.vertcat(symbols.travel, symbols.moves)
    rows, misses = _newton_rows(symbols, p, R)
    by_given = ca.jacobian(ca.vertcat(*misses), given)
    total, difference = (by_given[0::2, :] + sign * by_given[1::2, :] for sign in (1, -1))
    shared, differences, inverse_sums, inverse_schur = _blocks(rows)
    # Products of 3 x 3 matrices first: each of the 33 columns depends on two bars alone.
    turn_by_sum = -inverse_schur @ differences @ inverse_sums
    dw = turn_by_sum @ total + inverse_schur @ difference
    dp = (inverse_sums - shared @ turn_by_sum) @ total - shared @ inverse_schur @ difference
    turned = ca.horzcat(*[c + ca.cross(twist[3:6], c) for c in ca.horzsplit(R)])
    by_pose = ca.jacobian(_outputs(symbols, p + twist[0:3], turned), twist)
    tangent = ca.jacobian(_outputs(symbols, p, R), given) + by_pose @ ca.vertcat(dp, dw)
    return ca.Function(
        "tangent",
        [*symbols.inputs, pose],
        ca.cse([ca.densify(tangent)]),
        ["constants", "travel", "moves", "pose"],
        ["by_given"],
    )
