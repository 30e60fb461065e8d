"""The loop closures of a tree in Pinocchio: closure residual and constraint Jacobian."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from orthoglide.geometry import Array
from orthoglide.mechanism.tree import Tree


class Loops:
    """Closure residual and constraint Jacobian of a tree, row by row in the order of its closures.

    Three rows a point closure (second frame's origin seen from the first), six a frame closure
    (``log6(c1Mc2)``). Holds Pinocchio's scratch data: use one object a thread.

    Args:
        tree: as built by :func:`~orthoglide.mechanism.tree.nominal_tree` or ``general_tree``.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.data = tree.model.createData()
        self._models = pin.StdVec_ConstraintModel()
        self._datas = pin.StdVec_ConstraintData()
        for loop in tree.loops:
            first, second = (
                tree.model.frames[tree.model.getFrameId(name)]
                for name in (loop.frame_1, loop.frame_2)
            )
            anchor = (
                pin.PointAnchorConstraintModel
                if loop.kind == "point"
                else pin.FrameAnchorConstraintModel
            )
            places = (first.parentJoint, first.placement, second.parentJoint, second.placement)
            self._models.append(pin.ConstraintModel(anchor(tree.model, *places)))
        for model in self._models:
            self._datas.append(model.createData())
        # The containers hold copies: what is calculated with must be taken back from them.
        self._pairs = [
            (self._models[k], self._datas[k], self._datas[k].extract())
            for k in range(len(tree.loops))
        ]

    def update(self, q: Array) -> Array:
        """Evaluate the closures at ``q`` ``(nq,)``.

        Returns:
            Closure residual ``(21,)``, metres and radians.
        """
        pin.computeJointJacobians(self.tree.model, self.data, q)
        for model, data, _ in self._pairs:
            model.calc(self.tree.model, self.data, data)
        return np.concatenate([view.constraint_position_error for _, _, view in self._pairs])

    def newton_matrix(self) -> Array:
        """Constraint Jacobian ``(21, nq)`` at the last update, exact where the loops are closed.

        The rows of frame closures are relative twists; away from closure they lack the factor
        Jlog6, which a Newton step does not miss.
        """
        return np.asarray(
            pin.getConstraintsJacobian(self.tree.model, self.data, self._models, self._datas)
        )

    def jacobian(self, q: Array) -> Array:
        """Constraint Jacobian ``(21, nq)``: the exact derivative of :meth:`update` anywhere."""
        self.update(q)
        rows = self.newton_matrix()
        for loop, (_, _, view) in zip(self.tree.loops, self._pairs, strict=True):
            if loop.kind == "frame":
                own, placement = self.tree.rows[loop.name], view.c1Mc2
                rows[own] = pin.Jlog6(placement) @ placement.inverse().action @ rows[own]
        return rows
