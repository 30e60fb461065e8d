"""Files for other programs: the calibrated machine as URDF and MJCF, as far as constant geometry
can hold it, and the controller's numbers.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pinocchio as pin

from orthoglide.arguments import public
from orthoglide.control.numbers import controller_numbers
from orthoglide.effects.wording import grouped_by_effect
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.mjcf import to_mjcf
from orthoglide.mechanism.tree import VIRTUAL_NAMES, load
from orthoglide.prediction import Conditions
from orthoglide.urdf import closures_text, file_names, parallel_robot_files

_PROBE = 1e-2  # metres of travel over which a path's slope is taken; paths held are straight
_LATERAL = ("lateral_b", "lateral_c")


@public
def export_files(
    machine: MachineSource, *, zeros_only: bool = False, force: bool = False
) -> dict[str, str]:
    """Return the files for other programs by name.

    These are numbers for the controller, as text and as JSON; the calibrated URDF and its loop
    closures, in the package's form and as ``robot.urdf`` with ``robot.yaml``; and MJCF for MuJoCo.
    With ``zeros_only`` they are the zeros and nothing else.

    Args:
        machine: calibrated, or the path of its file.
        zeros_only: as for `controller_numbers`.
        force: as for `controller_numbers`.

    Raises:
        InputError: where the verdict says not to act on the machine's numbers.
    """
    machine = Machine.of(machine)
    numbers = controller_numbers(machine, zeros_only=zeros_only, force=force)
    numbers_files = {
        "controller.txt": numbers.text(),
        "controller.json": json.dumps(numbers.as_dict(), indent=2) + "\n",
    }
    if zeros_only:
        return numbers_files
    urdf, closures, mjcf = file_names(machine.geometry)
    tree = calibrated_urdf(machine)
    loops = load(machine.spec.urdf or machine.geometry).loops
    return {
        **numbers_files,
        urdf: tree,
        closures: closures_text(loops, urdf, constant_geometry(machine)),
        mjcf: calibrated_mjcf(machine),
        **parallel_robot_files(machine.geometry, tree, loops),
    }


@public
def calibrated_urdf(machine: MachineSource) -> str:
    """Return the URDF of a calibrated machine; joints and links are those of the nominal one.

    Slide q is the commanded travel from mechanical zero. Offsets move the slides' origins, tilts
    their axes, bar lengths the places of the knuckles and of bar 2's tip. A prismatic axis is a
    unit vector, so a path with slope t is shorter by ``q t^2 / 2`` than ``Machine`` has it. Where a
    machine has nothing that is constant the text is the nominal one but for its comment.

    Args:
        machine: calibrated, or the path of its file. What URDF cannot hold is left out and named
            in the comment.

    Returns:
        URDF, in metres and radians. The drawing stays nominal.
    """
    from scipy.spatial.transform import Rotation

    machine = Machine.of(machine)
    nominal = load(machine.spec.urdf or machine.geometry).urdf
    robot = ET.fromstring(nominal)
    joints = {str(joint.get("name")): joint for joint in robot.iter("joint")}
    for leg, (moves, slope) in _leg_displacements(machine).items():
        slide, carriage = joints[f"{leg}_slide"], joints[f"{leg}_theta"]
        path = np.array([moves["travel"], moves["lateral_b"], moves["lateral_c"]])
        _shift(slide, Rotation.from_euler("xyz", _numbers(slide, "origin", "rpy")).apply(path))
        if slope.any():
            direction = np.array([1.0, *slope])
            _set_numbers(slide, "axis", "xyz", direction / np.linalg.norm(direction))
        angles = [moves["turn_a"], moves["turn_b"], moves["turn_c"]]
        if any(angles):  # about a, the turned b, then the turned c
            tilt = Rotation.from_euler("xyz", _numbers(carriage, "origin", "rpy"))
            rotation = Rotation.from_euler("XYZ", angles) * tilt
            _set_numbers(carriage, "origin", "rpy", rotation.as_euler("xyz"))
        _shift(joints[f"{leg}_knuckle"], [-moves["stretch1"], 0, 0])
        _shift(joints[f"{leg}_bar2_tip_fixed"], [-moves["stretch2"], 0, 0])
        _shift(joints[f"{leg}_platform"], [0, 0, -moves["width1"]])
        _shift(joints[f"{leg}_knuckle_tip_fixed"], [0, 0, -moves["width1"] - moves["width2"]])
    ET.indent(robot)
    body = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- {_comment(machine)} -->\n{body}\n'


@public
def calibrated_mjcf(machine: MachineSource) -> str:
    """Return the MJCF of a calibrated machine, its loops closed by equality constraints.

    Joints, sites and constraints are those of ``orthoglide.mechanism.mjcf.to_mjcf``: ``x_slide``
    ... are the drives, whose position is the commanded travel, and actuators of these names hold
    them against gravity; the site ``x_tcp`` is the tool. Legs of any lengths close, as each has the
    two relief joints that URDF has no room for.

    Args:
        machine: calibrated, or the path of its file. What is no constant geometry is left out and
            named in the comment.

    Returns:
        MJCF, in metres, kilograms and radians.
    """
    machine = Machine.of(machine)
    nominal, text = load(machine.spec.urdf or machine.geometry), calibrated_urdf(machine)
    calibrated = replace(nominal, model=pin.buildModelFromXML(text), urdf=text)
    return to_mjcf(calibrated, comment=_comment(machine, "MJCF"))


def constant_geometry(machine: Machine) -> dict[str, float]:
    """Return the parameters that are constant geometry, SI: they displace joints by a constant, or
    tilt straight paths.
    """
    along = machine.geometry.zero + np.array([[-_PROBE], [0.0], [_PROBE]])
    conditions, lateral = Conditions.from_commands(along), np.isin(VIRTUAL_NAMES, _LATERAL)
    constant = {}
    for name, value in machine.values.items():
        if not machine.catalogue.effect_of(name).needs:
            moves = machine.model.displacements({name: 1.0}, conditions)
            low, middle, high = moves.reshape(3, 3, -1)
            curved = np.abs(low - 2 * middle + high) > 1e-12
            if not (curved | ((high != low) & ~lateral)).any():
                constant[name] = value
    return constant


def _leg_displacements(machine: Machine) -> dict[str, tuple[dict[str, float], Array]]:
    """Return, by leg, displacements of its virtual joints at mechanical zero, and slopes of its
    path.

    They come from the effects themselves, so that each has one definition.
    """
    at = Conditions.from_commands(machine.geometry.zero + np.array([[0.0], [_PROBE]]))
    by_place = machine.model.displacements(constant_geometry(machine), at).reshape(2, 3, -1)
    lateral = [VIRTUAL_NAMES.index(name) for name in _LATERAL]
    slopes = (by_place[1] - by_place[0])[:, lateral] / _PROBE
    moves = (dict(zip(VIRTUAL_NAMES, row, strict=True)) for row in by_place[0].tolist())
    return dict(zip(machine.geometry.leg_names, zip(moves, slopes, strict=True), strict=True))


def _comment(machine: Machine, of_format: str = "URDF") -> str:
    held_parameters, effect_of = constant_geometry(machine), machine.catalogue.effect_of
    names = machine.geometry.layout.names
    held_names = [n for n, v in held_parameters.items() if v]
    omitted = [n for n, v in machine.values.items() if v and n not in held_parameters]
    misfits = [n for n in held_names if not effect_of(n).urdf]
    lines = [
        f"Calibrated: {machine.spec.title}. Slide q is the commanded {names.travel}.",
        "Holds " + (", ".join(held_names) or "no correction") + ".",
        f"Left out, for {of_format} holds constant geometry only: "
        + (", ".join(grouped_by_effect(omitted)) or "nothing")
        + ".",
    ]
    if misfits and of_format == "URDF":
        lines.append(
            "Rigid legs cannot take up " + ", ".join(misfits) + ": to close the loops, free the "
            "bars' torsion at bar 1's tip and a turn about the short link at bar 2's root."
        )
    lines.append("The loops are those of the nominal machine; masses and shapes are nominal.")
    # XML allows no double hyphen in comments
    return re.sub("-(?=-)", "- ", "\n     ".join(lines))


def _numbers(joint: ET.Element, child: str, attribute: str) -> Array:
    element = joint.find(child)
    text = "" if element is None else element.get(attribute, "")
    return np.array(text.split(), dtype=float) if text else np.zeros(3)


def _set_numbers(joint: ET.Element, child: str, attribute: str, values: Array) -> None:
    element = joint.find(child)
    element = ET.SubElement(joint, child) if element is None else element
    element.set(attribute, " ".join(repr(float(v) + 0.0) for v in values))


def _shift(joint: ET.Element, displacement: Array | list[float]) -> None:
    if np.any(displacement):
        _set_numbers(joint, "origin", "xyz", _numbers(joint, "origin", "xyz") + displacement)
