"""A URDF tree with loop closures as MJCF, the format of MuJoCo, which describes loops."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from orthoglide.geometry import Array
from orthoglide.urdf.solids import number, numbers
from orthoglide.urdf.tree import Closure

RELIEF: Mapping[str, tuple[str, str]] = {
    "knuckle": ("relief_bar", "1 0 0"),
    "bar2": ("relief_link", "0 0 1"),
}
"""Relief joints before a leg's joint, which are not in the URDF: the torsion of bar 1 at its tip,
and a rotation about the short link at the root of bar 2. Legs with unequal bars need them to close.
"""

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

_XYZ = "xyz"  # the name of an attribute of URDF, and the axes that its angles turn about in order

_JOINTS = {"prismatic": "slide", "revolute": "hinge", "continuous": "hinge"}
_EQUALITY = {"point": "connect", "frame": "weld"}


def to_mjcf(urdf: str, loops: Sequence[Closure], *, relief: bool = True, comment: str = "") -> str:
    """Return a URDF tree as MJCF text, with its loops as equality constraints.

    Joints, bodies and sites have the names of the joints and links of the URDF. ``x_slide``,
    ``y_slide`` and ``z_slide`` (``a_slide`` ... of a delta) are the drives, with the limits of the
    stroke; every other joint is passive. A link that a fixed joint carries is a site: ``x_tcp`` is
    the tool. Each loop is an equality constraint with the name of its closure, ``connect`` where
    two origins coincide and ``weld`` where axes do too. Each drive has a position actuator with the
    name of its joint, which holds the travel given as its control, zero at first: loaded as it is,
    the machine stands under gravity. Nothing collides.

    Args:
        urdf: text of the tree, whose joints at zero are the closed machine.
        loops: closures of the tree.
        relief: whether legs get the joints of `RELIEF`, with which the constraints are not
            redundant and legs of any lengths close. Without them the joints are those of the URDF.
        comment: text for readers of the file.

    Returns:
        MJCF, in metres, kilograms and radians.
    """
    robot = ET.fromstring(urdf)
    root = ET.Element("mujoco", model=robot.get("name", "machine"))
    if comment:  # XML allows no double hyphen in comments
        root.append(ET.Comment(f" {re.sub('-(?=-)', '- ', comment)} "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", timestep=_STEP)
    ET.SubElement(ET.SubElement(root, "default"), "joint", armature=_SPINNING)
    asset = ET.SubElement(root, "asset")
    for material in robot.findall("material"):
        color = material.find("color")
        rgba = "0.5 0.5 0.5 1" if color is None else color.get("rgba", "")
        ET.SubElement(asset, "material", name=material.get("name", ""), rgba=rgba)
    world = ET.SubElement(root, "worldbody")
    links = {str(link.get("name")): link for link in robot.findall("link")}
    joints_of: defaultdict[str, list[ET.Element]] = defaultdict(list)
    for joint in robot.findall("joint"):
        joints_of[_link(joint, "parent")].append(joint)
    children = {_link(joint, "child") for joints in joints_of.values() for joint in joints}
    for name in links.keys() - children:  # one: a tree has one root
        _add_link(world, links[name], links, joints_of, relief)
    equality = ET.SubElement(root, "equality")
    for loop in loops:
        frames = {"site1": loop.frame_1, "site2": loop.frame_2}
        ET.SubElement(equality, _EQUALITY[loop.kind], {"name": loop.name, **frames, **_LOOP})
    drives = ET.SubElement(root, "actuator")
    for joint in world.iter("joint"):
        if joint.get("type") == "slide":
            name = joint.get("name", "")
            limits = {"ctrlrange": joint.get("range", "")} if "range" in joint.attrib else {}
            ET.SubElement(drives, "position", {"name": name, "joint": name, **limits, **_DRIVE})
    ET.indent(root)
    return f"{ET.tostring(root, encoding='unicode')}\n"


def _link(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _add_link(
    body: ET.Element,
    link: ET.Element,
    links: Mapping[str, ET.Element],
    joints_of: Mapping[str, Sequence[ET.Element]],
    relief: bool,
) -> None:
    """Add inertia and shape of a link to its body, and the bodies of its children."""
    if (inertial := link.find("inertial")) is not None:
        _add_inertial(body, inertial)
    for visual in link.findall("visual"):
        _add_geom(body, visual)
    for joint in joints_of.get(str(link.get("name")), ()):
        child = _link(joint, "child")
        kind = joint.get("type", "fixed")
        if kind == "fixed" and child not in joints_of and links[child].find("inertial") is None:
            ET.SubElement(body, "site", {"name": child, "size": "0.002"} | _placed(joint))
            continue
        inner = ET.SubElement(body, "body", {"name": child} | _placed(joint))
        if kind != "fixed":
            _add_joints(inner, joint, relief)
        ET.SubElement(inner, "site", name=child, size="0.002")
        _add_link(inner, links[child], links, joints_of, relief)


def _add_joints(body: ET.Element, joint: ET.Element, relief: bool) -> None:
    name = str(joint.get("name"))
    leg, _, part = name.rpartition("_")
    part = part or name
    if relief and leg and part in RELIEF:
        relief_name, axis = RELIEF[part]
        ET.SubElement(body, "joint", name=f"{leg}_{relief_name}", type="hinge", axis=axis)
    axis_element, limit = joint.find("axis"), joint.find("limit")
    attributes = {"name": name, "type": _JOINTS.get(joint.get("type", ""), "hinge")}
    attributes["axis"] = "1 0 0" if axis_element is None else axis_element.get(_XYZ, "1 0 0")
    if attributes["type"] == "slide":
        attributes["armature"] = _SCREW
        if limit is not None:
            attributes["range"] = f"{limit.get('lower', '0')} {limit.get('upper', '0')}"
    ET.SubElement(body, "joint", attributes)


def _add_inertial(body: ET.Element, inertial: ET.Element) -> None:
    """Add mass, centre and inertia, rotated to the axes of the body as in MJCF."""
    tensor, mass = inertial.find("inertia"), inertial.find("mass")
    if tensor is None or mass is None:
        return
    entries = {key: float(value) for key, value in tensor.attrib.items()}
    inertia = np.array([[entries[f"i{min(j, k)}{max(j, k)}"] for k in _XYZ] for j in _XYZ])
    rotation = _rotation(inertial)
    inertia = rotation @ inertia @ rotation.T
    upper = (inertia[j, k] for j, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    ET.SubElement(
        body, "inertial",
        pos=numbers(_attribute(inertial, _XYZ)),
        mass=mass.get("value", "0"),
        fullinertia=numbers(upper),
    )  # fmt: skip


def _add_geom(body: ET.Element, visual: ET.Element) -> None:
    """Draw a box, a cylinder or a sphere; other shapes are left out."""
    shape, material = next(iter(visual.find("geometry") or ()), None), visual.find("material")
    if shape is None or shape.tag not in ("box", "cylinder", "sphere"):
        return
    if shape.tag == "box":
        size = numbers(float(edge) / 2 for edge in shape.get("size", "").split())
    else:
        half_length = (number(float(shape.get("length", "0")) / 2),) * (shape.tag == "cylinder")
        size = " ".join((shape.get("radius", "0"), *half_length))
    attributes = {"type": shape.tag, "size": size, "contype": "0", "conaffinity": "0"}
    if material is not None:
        attributes["material"] = material.get("name", "")
    ET.SubElement(body, "geom", attributes | _placed(visual))


def _placed(element: ET.Element) -> dict[str, str]:
    """Return position and rotation of a URDF element's ``origin``, without zeros."""
    from scipy.spatial.transform import Rotation

    xyz, rpy = (_attribute(element, name) for name in (_XYZ, "rpy"))
    placement = {"pos": numbers(xyz)} if xyz.any() else {}
    if rpy.any():
        x, y, z, w = Rotation.from_euler(_XYZ, rpy).as_quat()
        placement["quat"] = numbers((w, x, y, z))
    return placement


def _rotation(element: ET.Element) -> Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler(_XYZ, _attribute(element, "rpy")).as_matrix())


def _attribute(element: ET.Element, name: str) -> Array:
    origin = element.find("origin")
    text = "" if origin is None else origin.get(name, "")
    return np.array(text.split(), dtype=float) if text else np.zeros(3)
