"""A machine as Pinocchio's own objects, for users of Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from orthoglide.arguments import public
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.mechanism import Constraints
from orthoglide.mechanism.tree import Tree, visual_model


@dataclass(frozen=True)
class PinocchioModel:
    """A machine with closed loops in Pinocchio's terms.

    Attributes:
        model: ``pin.Model`` of the tree: 3 driven slides and 21 free joints, 15 passive and 6
            relief joints that take up errors of the parts. Metres, kilograms, radians.
        constraint_models: ``pin.StdVec_ConstraintModel``, one a loop: point anchors for the
            parallelograms, frame anchors for the platform.
        constraint_datas: the data of these models. Call ``calc(model, data, its_data)`` of each
            constraint before asking for a constraint Jacobian.
        rigid_models: the same loops as ``RigidConstraintModel``, which Pinocchio's constrained
            dynamics (``constraintDynamics``, ``lcaba``) still asks for.
        rigid_datas: the data of these models.
        visual_model: ``pin.GeometryModel`` for Pinocchio's viewers.
        q: configuration ``(nq,)`` at mechanical zero with all loops closed.
        drives: indices of the driven slides in the velocity vector ``(3,)``.
        tool: number of the frame that is the tool.
    """

    model: Any
    constraint_models: Any
    constraint_datas: Any
    rigid_models: Any
    rigid_datas: Any
    visual_model: Any
    q: Array
    drives: NDArray[np.intp]
    tool: int


@public
def pinocchio_model(machine: MachineSource | None = None) -> PinocchioModel:
    """Return a machine as model, constraint models, visual model and a closed configuration.

    Errors of the parts are frozen into joint placements as they are at mechanical zero. Errors that
    depend on the command (a bent rail, a drive's scale) are not included: ``Machine`` maps a
    command to displacements.

    Args:
        machine: nominal or calibrated, or the path of its file; the published one where absent.

    Raises:
        ClosureError: where the machine does not close at mechanical zero.
    """
    machine = Machine.of(machine)
    tree = machine.model.mechanism.tree
    posture = machine.close(machine.geometry.zero)
    locked = [k for k in range(1, tree.model.njoints) if tree.model.joints[k].idx_v in tree.virtual]
    solids = [visual_model(tree, machine.model.mechanism.nominal)]
    model, (visual,) = pin.buildReducedModel(tree.model, solids, locked, posture.q)
    reduced = Tree.of_model(model, tree.loops, tree.motors)
    constraints = Constraints(reduced)
    rigid_models, rigid_datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for loop in reduced.loops:
        kind = pin.ContactType.CONTACT_3D if loop.kind == "point" else pin.ContactType.CONTACT_6D
        ends = reduced.loop_ends(loop)
        rigid_models.append(pin.RigidConstraintModel(kind, model, *ends, pin.LOCAL))
        rigid_datas.append(rigid_models[-1].createData())
    return PinocchioModel(
        model, constraints.models, constraints.datas, rigid_models, rigid_datas, visual,
        np.delete(posture.q, tree.virtual), reduced.drive, reduced.frame(tree.tool),
    )  # fmt: skip
