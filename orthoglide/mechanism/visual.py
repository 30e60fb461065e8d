"""The visual model of a machine: bars that fit their pivots, rails bent along the carriages' paths.

Pinocchio places the solids of a URDF as rigid bodies. Bars of another length and bent rails are
different solids, so these are adapted to the displacements of the virtual joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from orthoglide.geometry import Array
from orthoglide.mechanism.tree import VIRTUAL_NAMES, LoopedModel, Tree

_PIECES = 24  # of a rail: a bow of a tenth of its length bends by 2 degrees from piece to piece
_RAIL_SHARE_OF_STROKE = 0.4  # fraction of the stroke; shorter solids of the base are no rails
_PARALLEL_COSINE = 0.999  # least cosine between an edge of a rail and its slide


@dataclass(frozen=True, eq=False)
class RailPath:
    """The path of one carriage in the base frame."""

    origin: Array  # nominal place of the carriage at mechanical zero (3,), metres
    slide: Array  # nominal direction of the slide (3,), a unit vector
    travel: Array  # stations over the stroke (k,), increasing, metres from mechanical zero
    lateral: Array  # displacement of the carriage across the slide there (k, 3), metres

    def displacement_and_direction(self, travel: float) -> tuple[Array, Array]:
        """Return displacement ``(3,)``, metres, and direction ``(3,)`` of the path at a travel.

        Beyond the stroke the path goes on straight.
        """
        within = float(np.clip(travel, self.travel[0], self.travel[-1]))
        slopes = np.gradient(self.lateral, self.travel, axis=0)
        slope = np.array([np.interp(within, self.travel, column) for column in slopes.T])
        lateral = np.array([np.interp(within, self.travel, column) for column in self.lateral.T])
        return lateral + (travel - within) * slope, self.slide + slope


def visual_model(tree: Tree, looped: LoopedModel) -> Any:
    """Return the solids of a URDF as ``pin.GeometryModel``, attached to the joints of the tree that
    was made from it.
    """
    visual = pin.buildGeomFromUrdfString(looped.model, looped.text, pin.GeometryType.VISUAL)
    for item in visual.geometryObjects:
        link = looped.model.frames[item.parentFrame]
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


def bend_rails(visual: Any, paths: Sequence[RailPath], near: float) -> list[str]:
    """Replace the rails among the solids of the base by pieces along the carriages' paths.

    A rail is a long box or cylinder, parallel to the slide and near the carriage's path. The base
    of a foreign URDF may have none.

    Args:
        visual: the visual model, which is changed.
        paths: of the three carriages.
        near: largest distance of a rail from its path, metres.

    Returns:
        Names of the solids that were replaced.
    """
    replaced = []
    # Copies, as removing a solid moves the others in memory.
    for item in [pin.GeometryObject(o) for o in visual.geometryObjects if o.parentJoint == 0]:
        path = next((path for path in paths if _rail_length(item, path, near) > 0), None)
        if path is None or not path.lateral.any():
            continue
        replaced.append(str(item.name))
        visual.removeGeometryObject(item.name)
        for piece in _pieces(item, path, _rail_length(item, path, near)):
            visual.addGeometryObject(piece)
    return replaced


def _pieces(item: Any, path: RailPath, length: float) -> list[Any]:
    centre = float((item.placement.translation - path.origin) @ path.slide)
    axis = int(np.argmax(np.abs(item.placement.rotation.T @ path.slide)))
    pieces = []
    for k in range(_PIECES):
        step = length * ((k + 0.5) / _PIECES - 0.5)
        lateral, along = path.displacement_and_direction(centre + step)
        turn = pin.Quaternion.FromTwoVectors(path.slide, along).matrix()
        piece = pin.GeometryObject(item)
        piece.name = f"{item.name}_piece{k}"
        place = item.placement.translation + step * path.slide + lateral
        piece.placement = pin.SE3(turn @ item.placement.rotation, place)
        _scale(piece, axis, float(np.linalg.norm(along)) / _PIECES, turned=True)
        pieces.append(piece)
    return pieces


def _rail_length(item: Any, path: RailPath, near: float) -> float:
    """Return the length of a solid that is the rail of a path, metres; 0 for any other solid."""
    if isinstance(item.geometry, coal.Box):
        half = np.array(item.geometry.halfSide)
    elif isinstance(item.geometry, coal.Cylinder):
        half = np.array([item.geometry.radius] * 2 + [item.geometry.halfLength])
    else:
        return 0.0
    edges = np.abs(item.placement.rotation.T @ path.slide)
    axis, offset = int(np.argmax(edges)), item.placement.translation - path.origin
    across = float(np.linalg.norm(offset - (offset @ path.slide) * path.slide))
    length = 2 * float(half[axis])
    long_enough = length >= _RAIL_SHARE_OF_STROKE * float(path.travel[-1] - path.travel[0])
    return length if edges[axis] > _PARALLEL_COSINE and across < near and long_enough else 0.0


def _solids_of_joint(visual: Any, tree: Tree, joint: str) -> list[Any]:
    """Return the solids attached to a joint."""
    number = tree.model.getJointId(joint)
    return [item for item in visual.geometryObjects if item.parentJoint == number]


def _shift(item: Any, by: list[float]) -> None:
    item.placement = pin.SE3(item.placement.rotation, item.placement.translation + by)


def _scale(item: Any, axis: int, factor: float, turned: bool = False) -> None:
    """Scale a solid along an axis of its link, or of the solid itself if it is ``turned``."""
    own_axis = axis if turned else int(np.argmax(np.abs(item.placement.rotation[axis])))
    scale = np.array(item.meshScale)
    scale[own_axis] *= factor
    item.meshScale = scale
