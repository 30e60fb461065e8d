"""The visual model of a machine, with bars that fit their pivots.

Pinocchio places the solids of a URDF as rigid bodies. Bars of another length are different solids,
so these are adapted to the displacements of the virtual joints.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from orthoglide.geometry import Array
from orthoglide.mechanism.tree import VIRTUAL_NAMES, Tree


def visual_model(tree: Tree, nominal: Tree) -> Any:
    """Return the solids of a tree's URDF as ``pin.GeometryModel``, attached to its joints.

    Args:
        tree: the general tree, or one reduced from it.
        nominal: the tree as it is in the URDF.
    """
    visual = pin.buildGeomFromUrdfString(nominal.model, nominal.urdf, pin.GeometryType.VISUAL)
    for item in visual.geometryObjects:
        link = nominal.model.frames[item.parentFrame]
        frame = tree.model.frames[tree.frame(link.name)]
        item.placement = frame.placement * link.placement.inverse() * item.placement
        item.parentJoint, item.parentFrame = frame.parentJoint, tree.frame(link.name)
    return visual


def fit_bars(visual: Any, tree: Tree, displacements: Array) -> None:
    """Lengthen the solids of bars and short links, so that they end at their pivots.

    Args:
        visual: the visual model of the general tree, which is changed.
        tree: the general tree.
        displacements: of the virtual joints ``(3, 10)``, metres and radians.
    """
    by_name = {name: displacements[:, k] for k, name in enumerate(VIRTUAL_NAMES)}
    for leg, name in enumerate(tree.leg_names):
        knuckle = tree.model.getJointId(f"{name}_relief_bar")
        length = float(np.linalg.norm(tree.model.jointPlacements[knuckle].translation))
        for bar in ("1", "2"):
            stretch = float(by_name[f"stretch{bar}"][leg])
            for item in _solids_of_joint(visual, tree, f"{name}_stretch{bar}"):
                share = -float(item.placement.translation[0]) / length
                if 0.1 < share < 0.9:  # the bar itself, and not the bearing at one of its ends
                    _scale(item, 0, 1 + stretch / length)
                # The joint moves all of them by the displacement of the bar's outer end.
                _shift(item, [(1 - share) * stretch, 0.0, 0.0])
        first, second = float(by_name["width1"][leg]), float(by_name["width2"][leg])
        for item in _solids_of_joint(visual, tree, f"{name}_width1"):
            width = 2 * abs(float(item.placement.translation[2]))
            if width > 0:
                _scale(item, 2, 1 + (first + second) / width)
                _shift(item, [0.0, 0.0, (first - second) / 2])


def _solids_of_joint(visual: Any, tree: Tree, joint: str) -> list[Any]:
    """Return the solids attached to a joint."""
    number = tree.model.getJointId(joint)
    return [item for item in visual.geometryObjects if item.parentJoint == number]


def _shift(item: Any, by: list[float]) -> None:
    item.placement = pin.SE3(item.placement.rotation, item.placement.translation + by)


def _scale(item: Any, axis: int, factor: float) -> None:
    """Scale a solid along an axis of its link."""
    scale = np.array(item.meshScale)
    scale[int(np.argmax(np.abs(item.placement.rotation[axis])))] *= factor
    item.meshScale = scale
