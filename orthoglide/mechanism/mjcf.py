"""A tree with its loop closures as MJCF, the format of MuJoCo, which describes loops."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from orthoglide.mechanism.tree import JOINTS_BEFORE, Tree
from orthoglide.urdf.tree import number, numbers

_STEP = "0.001"
"""Seconds of a simulation step: the rods of a small delta swing too fast for MuJoCo's 0.002."""

_LOOP = {"solref": "0.003 1", "solimp": "0.9999 0.9999 0.001"}
"""Loops close within three steps and deform by micrometres under the machine's weight; MuJoCo's
softer defaults let the machine fall apart."""

_SPINNING = "0.0001"
"""Armature of a passive joint, kg m^2, at most a tenth of a bar's inertia: a bar has little inertia
about its axis, and a joint without armature would need much smaller steps."""

_SCREW = "5"
"""Armature of a drive, kg: what a motor of 5e-5 kg m^2 on a screw of 20 mm pitch has."""

_DRIVE = {"kp": "1e6", "kv": "4e3", "forcerange": "-500 500"}
"""A drive's stiffness, N/m, that of a ball screw; its damping, N s/m, nearly critical for the
armature; and its force, N, beyond which a sudden command is followed slowly."""

_EQUALITY = {"point": "connect", "frame": "weld"}
_DIGITS = 15  # decimals of lengths and rotations: rounding errors of exact zeros are left out


def to_mjcf(tree: Tree, *, relief: bool = True, comment: str = "") -> str:
    """Return a tree as MJCF text, with its loops as equality constraints.

    Joints, bodies and sites have the names of the joints and links of the URDF. ``x_slide``,
    ``y_slide`` and ``z_slide`` (``a_slide`` ... of a delta) are the drives, with the limits of the
    stroke; every other joint is passive. A link that a fixed joint carries is a site: ``x_tcp`` is
    the tool. Each loop is an equality constraint with the name of its closure, ``connect`` where
    two origins coincide and ``weld`` where axes do too. Each drive has a position actuator with the
    name of its joint, which holds the travel given as its control, zero at first: loaded as it is,
    the machine stands under gravity. Nothing collides.

    Args:
        tree: as in its URDF, its joints of one degree of freedom; at zero it is the closed machine.
        relief: whether legs get relief joints, with which the constraints are not redundant and
            legs of any lengths close. Without them the joints are those of the URDF.
        comment: text for readers of the file.

    Returns:
        MJCF, in metres, kilograms and radians.
    """
    root = ET.Element("mujoco", model=tree.model.name)
    if comment:  # XML allows no double hyphen in comments
        root.append(ET.Comment(f" {re.sub('-(?=-)', '- ', comment)} "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", timestep=_STEP)
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "joint", armature=_SPINNING)
    ET.SubElement(default, "geom", contype="0", conaffinity="0")
    ET.SubElement(default, "site", size="0.002")
    _add_bodies(ET.SubElement(root, "worldbody"), tree, relief)
    equality = ET.SubElement(root, "equality")
    for loop in tree.loops:
        frames = {"site1": loop.frame_1, "site2": loop.frame_2}
        ET.SubElement(equality, _EQUALITY[loop.kind], {"name": loop.name, **frames, **_LOOP})
    drives = ET.SubElement(root, "actuator")
    for name in tree.motors:
        limits = {"ctrlrange": _limits(tree, name)}
        ET.SubElement(drives, "position", {"name": name, "joint": name, **limits, **_DRIVE})
    ET.indent(root)
    return f"{ET.tostring(root, encoding='unicode')}\n"


def _add_bodies(world: ET.Element, tree: Tree, relief: bool) -> None:
    """Add a body for each joint with its inertia, a site for each link, and the visible solids."""
    model, bodies = tree.model, [world]
    links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    for j in range(1, model.njoints):
        name = next(link.name for link in links if link.parentJoint == j)  # others are fixed to it
        placed = _placed(model.jointPlacements[j])
        bodies.append(ET.SubElement(bodies[model.parents[j]], "body", {"name": name} | placed))
        _add_joints(bodies[j], tree, j, relief)
        inertia = model.inertias[j]
        ET.SubElement(
            bodies[j], "inertial",
            pos=numbers(inertia.lever),
            mass=number(inertia.mass),
            fullinertia=numbers(inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
        )  # fmt: skip
    for link in links:
        attributes = {"name": link.name} | _placed(link.placement)
        ET.SubElement(bodies[link.parentJoint], "site", attributes)
    solids = pin.buildGeomFromUrdfString(model, tree.urdf, pin.GeometryType.VISUAL)
    for item in solids.geometryObjects:
        if shape := _shape(item.geometry):
            colour = {"rgba": numbers(np.round(item.meshColor, 6))}  # single precision
            attributes = shape | colour | _placed(item.placement)
            ET.SubElement(bodies[item.parentJoint], "geom", attributes)


def _add_joints(body: ET.Element, tree: Tree, j: int, relief: bool) -> None:
    """Add a joint of the tree to its body, and the relief joint before it."""
    name, joint = tree.model.names[j], tree.model.joints[j]
    leg, _, part = name.rpartition("_")
    if relief and leg and part in JOINTS_BEFORE:
        relief_name, factory = JOINTS_BEFORE[part]
        ET.SubElement(body, "joint", {"name": f"{leg}_{relief_name}"} | _type_and_axis(factory()))
    attributes = {"name": name} | _type_and_axis(joint)
    if attributes["type"] == "slide":
        attributes |= {"armature": _SCREW, "range": _limits(tree, name)}
    ET.SubElement(body, "joint", attributes)


def _type_and_axis(joint: Any) -> dict[str, str]:
    linear, angular = np.asarray(joint.createData().S).reshape(2, 3)
    kind, axis = ("hinge", angular) if angular.any() else ("slide", linear)
    return {"type": kind, "axis": numbers(axis)}


def _limits(tree: Tree, motor: str) -> str:
    k = tree.model.joints[tree.model.getJointId(motor)].idx_q
    return numbers([tree.model.lowerPositionLimit[k], tree.model.upperPositionLimit[k]])


def _shape(geometry: Any) -> dict[str, str]:
    """Return type and size of a box, a cylinder or a sphere; nothing for other shapes."""
    if isinstance(geometry, coal.Box):
        return {"type": "box", "size": numbers(geometry.halfSide)}
    if isinstance(geometry, coal.Cylinder):
        return {"type": "cylinder", "size": numbers([geometry.radius, geometry.halfLength])}
    if isinstance(geometry, coal.Sphere):
        return {"type": "sphere", "size": number(geometry.radius)}
    return {}


def _placed(placement: pin.SE3) -> dict[str, str]:
    """Return position and rotation of a placement, without zeros and their rounding errors."""
    position = np.round(placement.translation, _DIGITS)
    x, y, z, w = np.round(pin.Quaternion(placement.rotation).coeffs(), _DIGITS)
    placed = {"pos": numbers(position)} if position.any() else {}
    return placed | ({"quat": numbers((w, x, y, z))} if x or y or z else {})
