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


def nominal_spheres(values: Array) -> tuple[Array, Array, Array]:
    """Return the spheres on which the TCP lies while the platform is not turned: centres and slide
    directions ``(3, 3)``, radii ``(3,)``, at mechanical zero and without errors; metres.
    """
    legs = values[:-1].reshape(3, _SIZE)
    axes = legs[:, _AXES:_SLIDE].reshape(3, 3, 3)
    roots, points = (
        legs[:, start : start + 6].reshape(3, 2, 3).mean(axis=1) for start in (_ROOTS, _POINTS)
    )
    centres = legs[:, _START:_AXES] + np.einsum("lij,lj->li", axes, roots) - points
    slides = np.einsum("lij,lj->li", axes, legs[:, _SLIDE:_ROOTS])
    return centres, slides, legs[:, _LENGTHS:].mean(axis=1)


class _Leg:
    """Symbols of one leg: its constants ``c`` (35,), travel, displacements ``v`` (10,)."""

    def __init__(self, c: Any, travel: Any, v: Any) -> None:
        self.axes = ca.reshape(c[_AXES:_SLIDE], 3, 3).T
        self.slide = c[_SLIDE:_ROOTS]
        turn_a, turn_b, turn_c = (_axis_rotation(axis, v[3 + axis]) for axis in range(3))
        turned = turn_a @ turn_b
        # Axes of the three rotations, in the frame of the unrotated carriage.
        self.spins = (ca.SX([1, 0, 0]), turn_a[:, 1], turned[:, 2])
        turned = turned @ turn_c
        self.arms = [turned @ c[_ROOTS + 3 * k : _ROOTS + 3 * k + 3] for k in range(2)]
        centre = self.slide * travel + v[0:3]
        self.roots = [c[_START:_AXES] + self.axes @ (centre + arm) for arm in self.arms]
        self.widths = [c[_WIDTHS + 3 * k : _WIDTHS + 3 * k + 3] for k in range(2)]
        tips = [c[_POINTS + 3 * k : _POINTS + 3 * k + 3] for k in range(2)]
        self.points = [tips[k] + v[8 + k] * self.widths[k] for k in range(2)]
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
    lines, misfit = [], ca.SX(0)
    for leg in symbols.legs:
        for k in range(2):
            end = p + R @ leg.points[k]
            lines += [leg.roots[k], end]
            misfit = ca.fmax(misfit, ca.fabs(ca.norm_2(end - leg.roots[k]) - leg.lengths[k]))
    outputs = ca.densify(ca.vertcat(p, ca.vec(R.T), *lines))
    centres = symbols.centres()
    normal = ca.cross(centres[1] - centres[0], centres[2] - centres[0])
    side = ca.dot(normal, p - centres[0]) * symbols.upward(normal, centres)
    side /= symbols.legs[0].lengths[0] ** 5
    return ca.cse([outputs, ca.vertcat(misfit, side, ca.trace(R))])


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
    leg. With the bars closed, ``e . dp + (R point x e) . dw = length dlength + e . droot - e . R
    dpoint``; the ends of the bars follow.
    """
    symbols, pose = _Symbols(), ca.SX.sym("pose", 12)
    p, R = pose[0:3], ca.reshape(pose[3:12], 3, 3).T
    rows, _ = _newton_rows(symbols, p, R)
    shared, differences, inverse_sums, inverse_schur = _blocks(rows)
    # Columns of the inverse of all six rows, by the sum and the difference of each leg's.
    turn_by_sum = -inverse_schur @ differences @ inverse_sums
    point_by_sum, point_by_difference = inverse_sums - shared @ turn_by_sum, -shared @ inverse_schur
    solution = (point_by_sum, point_by_difference, turn_by_sum, inverse_schur)
    arms = [[R @ point for point in leg.points] for leg in symbols.legs]
    columns: list[Any] = [None] * INPUT_SIZE
    for number in range(3):
        for place, column in _leg_columns(symbols, number, R, arms, rows, solution).items():
            columns[place] = column
    return ca.Function(
        "tangent",
        [*symbols.inputs, pose],
        ca.cse([ca.densify(ca.horzcat(*columns))]),
        ["constants", "travel", "moves", "pose"],
        ["by_given"],
    )


def _leg_columns(
    symbols: _Symbols, number: int, R: Any, arms: list[list[Any]], rows: list[list[Any]],
    solution: tuple[Any, ...],
) -> dict[int, Any]:  # fmt: skip
    """Return derivatives of the outputs by a drive and its leg's virtual joints, by input index."""
    leg, zero = symbols.legs[number], ca.SX(3, 1)
    virtual = 3 + VIRTUAL_PER_LEG * number
    # By input index: derivatives of the bars' roots (base frame), points (rotated) and lengths.
    moved: dict[int, tuple[list[Any], list[Any], list[Any]]] = {
        number: ([leg.axes @ leg.slide] * 2, [zero] * 2, [0, 0])
    }
    for axis in range(3):
        moved[virtual + axis] = ([leg.axes[:, axis]] * 2, [zero] * 2, [0, 0])
        turned_roots = [leg.axes @ ca.cross(leg.spins[axis], arm) for arm in leg.arms]
        moved[virtual + 3 + axis] = (turned_roots, [zero] * 2, [0, 0])
    for k in range(2):
        lengthened = [1 if k == bar else 0 for bar in range(2)]
        widened = [R @ leg.widths[k] if k == bar else zero for bar in range(2)]
        moved[virtual + 6 + k] = ([zero] * 2, [zero] * 2, lengthened)
        moved[virtual + 8 + k] = ([zero] * 2, widened, [0, 0])
    columns = {}
    for place, (roots, points, lengths) in moved.items():
        right = []
        for k in range(2):
            e = ca.vertcat(*rows[2 * number + k][:3])
            right.append(leg.lengths[k] * lengths[k] + ca.dot(e, roots[k] - points[k]))
        total, difference = right[0] + right[1], right[0] - right[1]
        by_sum, by_difference, turn_by_sum, turn_by_difference = solution
        dp = by_sum[:, number] * total + by_difference[:, number] * difference
        dw = turn_by_sum[:, number] * total + turn_by_difference[:, number] * difference
        turned = ca.horzcat(*[ca.cross(dw, column) for column in ca.horzsplit(R)])
        parts = [dp, ca.vec(turned.T)]
        for other in range(3):
            for k in range(2):
                end = dp + ca.cross(dw, arms[other][k])
                same_leg = other == number
                parts += [roots[k] if same_leg else zero, end + points[k] if same_leg else end]
        columns[place] = ca.vertcat(*parts)
    return columns
