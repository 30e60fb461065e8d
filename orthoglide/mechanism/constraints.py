"""The loop closures of a tree as Pinocchio constraint models: residual, Jacobian and mobility."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from orthoglide.geometry import Array
from orthoglide.mechanism.tree import Tree

# Zero singular values of the 21 rows are zero up to rounding; the smallest other one is 0.01.
_RANK_TOLERANCE = 1e-7


class Constraints:
    """Closure residual and constraint Jacobian of a tree, row by row in the order of its closures.

    Three rows a point closure (second frame's origin seen from the first), six a frame closure
    (``log6(c1Mc2)``). Holds Pinocchio's scratch data: use one object a thread.

    Args:
        tree: from :func:`~orthoglide.mechanism.tree.load` or ``general_tree``.

    Attributes:
        models, datas: Pinocchio's containers of constraint models and data.
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
    rows = constraints.jacobian(q)
    by_loop = {name: _rank(rows[part]) for name, part in constraints.tree.rows.items()}
    (count, joints), rank = rows.shape, _rank(rows)
    return Mobility(joints, count, rank, joints - rank, count - rank, by_loop)


def _rank(rows: Array) -> int:
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(values > _RANK_TOLERANCE * values[0]))
