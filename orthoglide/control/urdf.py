"""The calibrated machine as URDF and as MJCF, as far as constant geometry can hold it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np

from orthoglide.effects import Effect, LegConditions, Motion
from orthoglide.effects.wording import grouped_by_effect
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.tree import VIRTUAL_NAMES, load
from orthoglide.prediction import Conditions
from orthoglide.urdf import to_mjcf

_PROBE = 1e-2  # metres of travel over which a path's slope is taken; paths held are straight
_LATERAL = ("lateral_b", "lateral_c")


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
    nominal = load(machine.spec.urdf or machine.geometry).text
    robot = ET.fromstring(nominal)
    origins = {j.get("name"): j.find("origin") for j in robot.iter("joint")}
    axes = {j.get("name"): j.find("axis") for j in robot.iter("joint")}
    for leg, (moves, slope) in zip(
        machine.geometry.leg_names, _leg_displacements(machine), strict=True
    ):
        slide = origins[f"{leg}_slide"]
        turn = Rotation.from_euler("xyz", _attribute(slide, "rpy"))
        path = np.array([moves["travel"], moves["lateral_b"], moves["lateral_c"]])
        _shift(slide, turn.apply(path))
        tilted = np.array([1.0, *slope])
        axis = axes[f"{leg}_slide"]
        if axis is not None and slope.any():
            axis.set("xyz", _numbers_text(tilted / np.linalg.norm(tilted)))
        turned = [moves["turn_a"], moves["turn_b"], moves["turn_c"]]
        carriage = origins[f"{leg}_theta"]
        if carriage is not None and any(turned):  # about a, the turned b, then the turned c
            lean = Rotation.from_euler("xyz", _attribute(carriage, "rpy"))
            both = Rotation.from_euler("XYZ", turned) * lean
            carriage.set("rpy", _numbers_text(both.as_euler("xyz")))
        wider = moves["width1"] + moves["width2"]
        _shift(origins[f"{leg}_knuckle"], [-moves["stretch1"], 0, 0])
        _shift(origins[f"{leg}_bar2_tip_fixed"], [-moves["stretch2"], 0, 0])
        _shift(origins[f"{leg}_platform"], [0, 0, -moves["width1"]])
        _shift(origins[f"{leg}_knuckle_tip_fixed"], [0, 0, -wider])
    ET.indent(robot)
    body = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- {_comment(machine)} -->\n{body}\n'


def calibrated_mjcf(machine: MachineSource) -> str:
    """Return the MJCF of a calibrated machine, its loops closed by equality constraints.

    Joints, sites and constraints are those of ``orthoglide.urdf.to_mjcf``: ``x_slide`` ... are
    the drives, whose position is the commanded travel, and actuators of these names hold them
    against gravity; the site ``x_tcp`` is the tool. Legs of any lengths close, as each has the two
    relief joints that URDF has no room for.

    Args:
        machine: calibrated, or the path of its file. What is no constant geometry is left out and
            named in the comment.

    Returns:
        MJCF, in metres, kilograms and radians.
    """
    machine = Machine.of(machine)
    loops = load(machine.spec.urdf or machine.geometry).loops
    return to_mjcf(calibrated_urdf(machine), loops, comment=_comment(machine, "MJCF"))


def constant_geometry(machine: Machine) -> dict[str, float]:
    """Return the parameters that are constant geometry, SI: places and directions of joints."""
    of = machine.catalogue.effect_of
    return {n: v for n, v in machine.values.items() if _is_constant(of(n), machine)}


def _is_constant(effect: Effect, machine: Machine) -> bool:
    """Whether an effect shifts or turns joints by the same everywhere, or tilts straight paths."""
    if effect.of_dial or effect.needs:
        return False
    length, stroke = machine.geometry.L, machine.geometry.stroke
    zero = machine.geometry.layout.zero(length)

    def moved(motion: Motion, s: float) -> float:
        command = zero + s
        at = LegConditions(command, length, stroke, None, 0, 0, 0, 0, s, zero, (command,) * 3)
        return float(motion.basis(at))

    for _, motions in effect.motions.values():
        for motion in motions:
            low, middle, high = (moved(motion, s) for s in (-_PROBE, 0.0, _PROBE))
            bent = abs(low - 2 * middle + high) > 1e-12
            if bent or (high != low and motion.joint not in _LATERAL):
                return False
    return True


def _leg_displacements(machine: Machine) -> list[tuple[dict[str, float], Array]]:
    """Return for each leg displacements of its virtual joints at mechanical zero, and slopes of its
    path.

    Taken from the effects themselves, so that there is one definition of each.
    """
    at = Conditions.from_commands(machine.geometry.zero + np.array([[0.0], [_PROBE]]))
    here, there = machine.model.displacements(constant_geometry(machine), at).reshape(2, 3, -1)
    lateral = [VIRTUAL_NAMES.index(name) for name in _LATERAL]
    return [
        (
            dict(zip(VIRTUAL_NAMES, here[leg].tolist(), strict=True)),
            (there[leg] - here[leg])[lateral] / _PROBE,
        )
        for leg in range(3)
    ]


def _comment(machine: Machine, of_format: str = "URDF") -> str:
    constant, of = constant_geometry(machine), machine.catalogue.effect_of
    names = machine.geometry.layout.names
    held = [n for n, v in constant.items() if v]
    left = [n for n, v in machine.values.items() if v and n not in constant]
    misfit = [n for n in held if not of(n).urdf]
    lines = [
        f"Calibrated: {machine.spec.title}. Slide q is the commanded {names.travel}.",
        "Holds " + (", ".join(held) or "no correction") + ".",
        f"Left out, for {of_format} holds constant geometry only: "
        + (", ".join(grouped_by_effect(left)) or "nothing")
        + ".",
    ]
    if misfit and of_format == "URDF":
        lines.append(
            "Rigid legs cannot take up " + ", ".join(misfit) + ": to close the loops, free the "
            "bars' torsion at bar 1's tip and a turn about the short link at bar 2's root."
        )
    lines.append("The loops are those of the nominal machine; masses and shapes are nominal.")
    # XML allows no double hyphen in comments
    return re.sub("-(?=-)", "- ", "\n     ".join(lines))


def _attribute(element: ET.Element | None, name: str) -> Array:
    text = "" if element is None else element.get(name, "")
    return np.array(text.split(), dtype=float) if text else np.zeros(3)


def _numbers_text(values: Array) -> str:
    return " ".join(repr(float(v) + 0.0) for v in values)


def _shift(origin: ET.Element | None, by: Array | list[float]) -> None:
    if origin is not None and np.any(by):
        origin.set("xyz", _numbers_text(_attribute(origin, "xyz") + by))
