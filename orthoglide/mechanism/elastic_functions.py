"""Elastic equilibrium of the closed mechanism as CasADi functions.

Springs stand along the six bars (stiffness k) and on the torsion of the three legs (K); a weight W
hangs at the TCP along base -z. With z the free joints, w = [drives; virtual] + E c t the joints
that are given, the bars' stretch c t under their tensions t included (c = 1/k), and the loop
closures g(z, w) = 0, the equilibrium is the least of 1/2 z'Kz + 1/2 t'ct + W p_z:

    K z + W dp_z/dz + (dg/dz)' lambda = 0,    t + E' (W dp_z/dw + (dg/dw)' lambda) = 0,    g = 0.

The closure Jacobian dg/dz is square and regular, so lambda is eliminated and 27 unknowns (z, t)
remain. Because tensions and not stretches are sought, rigid bars are c = 0, nothing special.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.geometry import LEGS
from orthoglide.mechanism.functions import ClosureFunctions, closing, closure_functions
from orthoglide.mechanism.tree import RELIEF_NAMES, VIRTUAL_NAMES, Tree

BARS = 2 * len(LEGS)
TENSION = 1e6
"""Newtons in one unit of an unknown tension: brings tensions to the size of joint angles."""

STRETCH = tuple(
    len(LEGS) + leg * len(VIRTUAL_NAMES) + VIRTUAL_NAMES.index(name)
    for leg in range(len(LEGS))
    for name in ("stretch1", "stretch2")
)
"""Places of the bars' stretch among ``[drives; virtual]``: leg by leg, bar 1 before bar 2."""


class ElasticFunctions:
    """The CasADi functions of a tree with relief and virtual joints, and what they share.

    An unknown is ``[free joints (21); tensions (6) in TENSION newtons]``, a condition ``[drives
    (3); virtual (30); load; compliance of a bar; torsional stiffness]``, SI.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.plain: ClosureFunctions = closure_functions(tree, tree.free)
        self.n, self.m = len(tree.free), len(LEGS) + len(tree.virtual)
        self.unknown = ca.MX.sym("unknown", self.n + BARS)
        self.condition = ca.MX.sym("condition", self.m + 3)
        self.z, self.tension = self.unknown[: self.n], TENSION * self.unknown[self.n :]
        self.load, self.compliance, torsion = ca.vertsplit(self.condition[self.m :])
        # The leg's torsion is the turn at bar 1's tip; the other relief joint only follows it.
        places = np.isin(tree.free, tree.relief[RELIEF_NAMES.index("relief_bar") :: 2])
        self.K = ca.DM(places.astype(float)) * torsion
        self.E = np.zeros((self.m, BARS))
        self.E[list(STRETCH), range(BARS)] = 1.0
        self.w = self.condition[: self.m] + self.compliance * (ca.DM(self.E) @ self.tension)

    def by_name(self) -> dict[str, Any]:
        """All of them, of (unknown, condition)."""
        step, residual = self._step()
        residual = self._function("residual", residual)
        side = self._function("side", self.plain.side(self.z, self.w))
        return {
            # (27,): closure residual, then how far each tension is from balance, in TENSION newtons
            # plus the metres that this stretches the bar
            "residual": residual,
            # from a guess: unknown at equilibrium, the residual that is left, and the side as of
            # the plain closure
            "close": closing(_rootfinder(self._function("step", step)), residual, side),
            # (48,), as of the plain closure
            "outputs": self._function("outputs", self.plain.outputs(self.z, self.w)),
            # outputs and their total derivative (48, 34) by `[drives; virtual; load]` along
            # equilibria
            "tangent": self._function("tangent", *self._tangent()),
            # (33,): generalised forces with which the machine pushes against the drives and virtual
            # joints, newtons and newton metres
            "force": self._function("force", self._force()),
        }

    def _function(self, name: str, *results: Any) -> Any:
        dense = [ca.densify(result) for result in results]
        return ca.Function(name, [self.unknown, self.condition], dense)

    def _first_order(self, places: Sequence[int]) -> tuple[Any, ...]:
        """g, dg/dz, dg/dw, dp_z/dz, dp_z/dw at the symbols, by those w only at ``places``."""
        z, w = ca.SX.sym("z", self.n), ca.SX.sym("w", self.m)
        g, height = self.plain.residual(z, w), self.plain.outputs(z, w)[2]
        by_z = [ca.jacobian(f, z) for f in (g, height)]
        by_w = [ca.jacobian(f, w)[:, list(places)] for f in (g, height)]
        results = [g, by_z[0], by_w[0], *map(ca.densify, (by_z[1], by_w[1]))]
        return tuple(ca.Function("first_order", [z, w], results)(self.z, self.w))

    def _step(self) -> tuple[Any, Any]:
        """Newton's step, and the residual in the same units.

        Second derivatives are left out of the matrix: bars are stiff, so that steps still settle in
        a few rounds, and each costs far less. The equilibrium is the same.
        """
        g, by_z, by_w, height_z, height_w = self._first_order(STRETCH)
        solved = ca.solve(by_z, ca.horzcat(g, by_w), "qr")
        closing, follow = -solved[:, 0], -solved[:, 1:]
        pulled = self.load * (height_z @ follow + height_w).T
        imbalance = self.tension + follow.T @ (self.K * self.z) + pulled  # newtons, each bar
        ahead = imbalance + follow.T @ (self.K * closing)
        matrix = ca.DM.eye(BARS) + follow.T @ (ca.repmat(self.K, 1, BARS) * follow) * (
            self.compliance
        )
        change = -ca.solve(matrix, ahead, "qr")
        moved = closing + self.compliance * (follow @ change)
        # Soft bars would hide metres in a small imbalance of forces: count what it stretches too.
        missing = (1 / TENSION + self.compliance) * imbalance
        return ca.vertcat(moved, change / TENSION), ca.vertcat(g, missing)

    def _multipliers(self, by_z: Any, height_z: Any) -> Any:
        return -ca.solve(by_z.T, self.K * self.z + self.load * height_z.T, "qr")

    def _force(self) -> Any:
        _, by_z, by_w, height_z, height_w = self._first_order(range(self.m))
        multipliers = self._multipliers(by_z, height_z)
        return -(by_w.T @ multipliers + self.load * height_w.T)

    def _tangent(self) -> tuple[Any, Any]:
        """Outputs and their derivative, the curvature of loops and load included."""
        _, by_z, by_w, height_z, height_w = self._first_order(range(self.m))
        multipliers = self._multipliers(by_z, height_z)
        ways = ca.vertcat(-ca.solve(by_z, by_w, "qr"), ca.DM.eye(self.m))  # d[z; w]/dw, loops kept
        point = [ca.repmat(v, 1, BARS) for v in (self.z, self.w, multipliers, self.load)]
        bent = self._curvature()(*point, ways[:, list(STRETCH)])
        spring = ca.repmat(self.K, 1, BARS) * ways[: self.n, list(STRETCH)]
        bent = bent + ca.vertcat(spring, ca.DM.zeros(self.m, BARS))
        height = ca.horzcat(height_z, height_w)
        tilted = ca.horzcat(bent.T @ ways, (height @ ways[:, list(STRETCH)]).T)
        matrix = ca.DM.eye(BARS) + self.compliance * tilted[:, list(STRETCH)]
        stretch = -self.compliance * ca.solve(matrix, tilted, "qr")
        value, out_z, out_w = self._output_derivatives()
        out = ca.horzcat(out_z, out_w) @ ways
        along = ca.horzcat(out, ca.DM.zeros(out.size1(), 1))
        return value, along + out[:, list(STRETCH)] @ stretch

    def _output_derivatives(self) -> tuple[Any, ...]:
        z, w = ca.SX.sym("z", self.n), ca.SX.sym("w", self.m)
        out = self.plain.outputs(z, w)
        parts = ca.Function("parts", [z, w], [out, ca.jacobian(out, z), ca.jacobian(out, w)])
        return tuple(parts(self.z, self.w))

    def _curvature(self) -> Any:
        """(z, w, lambda, load, directions ``(54, 6)``) -> Hessian of the Lagrangian times them."""
        z, w = ca.SX.sym("z", self.n), ca.SX.sym("w", self.m)
        multipliers, load = ca.SX.sym("multipliers", self.n), ca.SX.sym("load")
        direction = ca.SX.sym("direction", self.n + self.m)
        both = ca.vertcat(z, w)
        g, height = self.plain.residual(z, w), self.plain.outputs(z, w)[2]
        slope = ca.gradient(ca.dot(multipliers, g) + load * height, both)
        bent = ca.jtimes(slope, both, direction)
        one = ca.Function("curvature", [z, w, multipliers, load, direction], [ca.densify(bent)])
        return one.map(BARS)


def _rootfinder(step: Any) -> Any:
    """Repeat a step until it is nothing: a root of the step, with the identity for Jacobian."""
    size = step.size1_out(0)
    x, condition = ca.MX.sym("x", size), ca.MX.sym("condition", step.size1_in(1))
    down = ca.Function("down", [x, condition], [-step(x, condition)], ["x", "p"], ["r"])
    return ca.rootfinder(
        "root",
        "fast_newton",
        down,
        {
            "max_iter": 40,
            "abstol": 1e-13,
            "abstolStep": 1e-13,
            "error_on_fail": False,
            "jacobian_function": ca.Function(
                "identity", [x, condition], [ca.DM.eye(size), -step(x, condition)]
            ),
        },
    )
