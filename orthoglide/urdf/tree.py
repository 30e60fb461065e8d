"""The tree of joints and links as URDF text, its loop closures, and plausible shapes and masses."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from orthoglide.geometry import LEGS, Array, Geometry

Vector = tuple[float, float, float]

_ZERO: Vector = (0.0, 0.0, 0.0)
# Rotations of a cylinder, which URDF draws along z, to x, y or z.
_LAY: tuple[Vector, Vector, Vector] = ((0.0, math.pi / 2, 0.0), (math.pi / 2, 0.0, 0.0), _ZERO)
_RAIL = 0.95  # distance of a rail from its carriage's path, toward b, as a fraction of d

# Colour (red, green, blue) and density in kg/m^3.
MATERIALS: dict[str, tuple[Vector, float]] = {
    "aluminium": ((0.80, 0.82, 0.85), 2700.0),
    "steel": ((0.45, 0.47, 0.50), 7850.0),
    "frame": ((0.25, 0.28, 0.33), 7200.0),
    "table": ((0.62, 0.62, 0.58), 7200.0),
    "tool": ((0.90, 0.70, 0.15), 7850.0),
    "carriage_x": ((0.78, 0.27, 0.23), 2700.0),
    "carriage_y": ((0.27, 0.58, 0.32), 2700.0),
    "carriage_z": ((0.22, 0.40, 0.72), 2700.0),
}


@dataclass(frozen=True)
class Solid:
    """A box or cylinder with its edges along the axes of its link."""

    # extent along the link's axes, metres; a cylinder's is its length and its diameters
    size: Vector
    centre: Vector  # in the link, metres
    material: str  # key of `MATERIALS`
    along: int | None = None  # axis of a cylinder, 0, 1 or 2; `None` for a box

    def in_base(self, axes: Array) -> Solid:
        """Return the solid in the base's axes; the columns of ``axes`` ``(3, 3)`` are its own."""
        along = None if self.along is None else int(np.argmax(np.abs(axes[:, self.along])))
        return Solid(vector(axes @ self.size), vector(axes @ self.centre), self.material, along)

    def mass(self) -> float:
        """Mass, kg."""
        fill = 1.0 if self.along is None else math.pi / 4
        return fill * math.prod(self.size) * MATERIALS[self.material][1]

    def inertia(self) -> Array:
        """Inertia ``(3, 3)`` about its own centre, kg m^2."""
        squares = np.square(self.size) / 12
        if self.along is not None:
            squares[np.arange(3) != self.along] *= 0.75  # a disc's second moment is D^2 / 16
        return self.mass() * np.diag(squares.sum() - squares)


def leg_solids(geometry: Geometry, leg: int) -> dict[str, tuple[Solid, ...]]:
    """Return the solids of a leg's moving links; cross-sections are fractions of d and r."""
    L, d, r = geometry.L, geometry.d, geometry.r
    name, material = geometry.leg_names[leg], f"carriage_{LEGS[leg]}"
    rail = _RAIL * d
    bar = (
        Solid((L, 0.16 * d, 0.16 * d), (-L / 2, 0.0, 0.0), "aluminium", along=0),
        Solid((0.24 * d, 0.36 * d, 0.24 * d), _ZERO, "steel", along=1),
        Solid((0.24 * d, 0.36 * d, 0.24 * d), (-L, 0.0, 0.0), "steel", along=1),
    )
    link_size = (0.22 * d, 0.22 * d, 0.9 * d)
    platform = [Solid((0.28 * d, 0.28 * d, 0.36 * d), _ZERO, "steel", along=2)]
    if geometry.layout.hanging:
        platform += [Solid((0.3 * r, 0.9 * r, 0.5 * r), (0.0, -0.45 * r, 0.0), "aluminium")]
    else:
        platform += [Solid((0.75 * r, 0.5 * r, 0.5 * r), (-0.375 * r, 0.0, 0.0), "aluminium")]
    if leg == 0 and geometry.dialled:  # what legs share is drawn and weighed once
        platform += [
            Solid((0.9 * r, 0.9 * r, 0.9 * r), (-r, 0.0, 0.0), "aluminium"),
            Solid((0.7 * r, 0.7 * r, 0.8 * r), (-r, 0.0, -0.85 * r), "frame", along=2),
            Solid((0.25 * r, 0.25 * r, r), (-r, 0.0, -1.75 * r), "tool", along=2),
        ]
    return {
        f"{name}_carriage": (
            Solid((d, 0.3 * d, 0.7 * d), (0.35 * d, rail - 0.25 * d, 0.0), material),
            Solid((0.4 * d, rail - 0.3 * d, 0.5 * d), (0.4 * d, 0.45 * rail, 0.0), material),
            Solid((0.5 * d, 0.3 * d, 0.36 * d), (0.25 * d, 0.0, 0.0), material),
        ),
        f"{name}_fork": (Solid(link_size, _ZERO, "steel", along=2),),
        f"{name}_bar1": bar,
        f"{name}_bar2": bar,
        f"{name}_knuckle": (Solid(link_size, (0.0, 0.0, -d / 2), "steel", along=2),),
        f"{name}_platform": tuple(platform),
    }


def base_solids(geometry: Geometry) -> tuple[Solid, ...]:
    """Return rails, drives and a frame that joins them at a corner, on a table under the tool."""
    if geometry.layout.hanging:
        return _towers(geometry)
    if not geometry.dialled:
        return _blocks(geometry)
    L, d, r = geometry.L, geometry.d, geometry.r
    low, high = geometry.stroke
    rail, beam = _RAIL * d, 0.4 * d
    rail_start, rail_end = L + r + low - 0.4 * d, L + r + high + 1.1 * d
    corner = rail_end + beam / 2
    middle, length = (rail_start + rail_end) / 2, rail_end - rail_start
    reach = corner - rail + beam
    solids = []
    for leg in geometry.legs:
        leg_parts = (
            Solid((length, 0.2 * d, 0.4 * d), (middle, rail, 0.0), "steel"),
            Solid((length, 0.3 * d, 0.7 * d), (middle, rail + 0.25 * d, 0.0), "frame"),
            Solid((0.8 * d, 0.5 * d, 0.5 * d), (corner + 0.6 * d, rail, 0.0), "frame", along=0),
            Solid((beam, reach, beam), (corner, (corner + rail) / 2, 0.0), "frame"),
            Solid((beam, beam, corner), (corner, corner, corner / 2), "frame"),
        )
        solids += [solid.in_base(leg.axes) for solid in leg_parts]
    floor, table_size = low - 4 * r, corner + beam / 2 - 1.5 * low
    centre = (corner + beam / 2 + 1.5 * low) / 2
    solids += [
        Solid((beam, beam, -floor), (corner, corner, floor / 2), "frame"),
        Solid((table_size, table_size, 0.25 * d), (centre, centre, floor - 0.125 * d), "table"),
    ]
    return tuple(solids)


def _towers(geometry: Geometry) -> tuple[Solid, ...]:
    """Return towers on a plate: round, as boxes are parallel to the base axes."""
    d, (low, high) = geometry.d, geometry.stroke
    solids, reach = [], 0.0
    for leg in geometry.legs:
        bottom, top = min(0.0, leg.carriage[2] + low), leg.carriage[2] + high + d
        x, y, _ = leg.carriage + _RAIL * d * leg.axes[:, 1]
        reach = max(reach, float(np.hypot(x, y)))
        middle = (float(x), float(y), (bottom + top) / 2)
        solids.append(Solid((0.4 * d, 0.4 * d, top - bottom), middle, "frame", along=2))
    plate = (1.2 * reach, 1.2 * reach, 0.1 * d)
    return (*solids, Solid(plate, (0.0, 0.0, -0.05 * d), "table", along=2))


def _blocks(geometry: Geometry) -> tuple[Solid, ...]:
    """Return a block behind each carriage, as boxes are parallel to the base axes."""
    d, size = geometry.d, (0.6 * geometry.d,) * 3
    places = (leg.carriage + _RAIL * d * leg.axes[:, 1] for leg in geometry.legs)
    return tuple(Solid(size, vector(place), "frame") for place in places)


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def number(value: float) -> str:
    """Return the shortest text of a number that is exact to its last bit or two."""
    short = f"{value + 0.0:.15g}"  # + 0.0 turns -0 into 0
    return short if math.isclose(float(short), value, rel_tol=4e-16) else repr(float(value))


def numbers(values: Iterable[float]) -> str:
    """Return numbers as text, in the format of URDF."""
    return " ".join(number(value) for value in values)


def _micrometres(values: Iterable[float]) -> str:
    """Return lengths as text, rounded to micrometres."""
    return numbers(round(float(value), 6) for value in values)


def add_inertial(link: ET.Element, solids: tuple[Solid, ...]) -> None:
    """Add mass, centre and inertia of several solids, about their common centre."""
    masses = np.array([solid.mass() for solid in solids])
    centres = np.array([solid.centre for solid in solids])
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for solid, mass, arm in zip(solids, masses, centres - centre, strict=True):
        inertia += solid.inertia() + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=_micrometres(centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=f"{masses.sum():.6g}")
    entries = {
        f"i{LEGS[j]}{LEGS[k]}": f"{inertia[j, k] + 0.0:.6g}" for j in range(3) for k in range(j, 3)
    }
    ET.SubElement(element, "inertia", entries)


def add_visual(link: ET.Element, solid: Solid) -> None:
    """Add the shape of a solid."""
    visual = ET.SubElement(link, "visual")
    angles = _ZERO if solid.along is None else _LAY[solid.along]
    ET.SubElement(visual, "origin", xyz=_micrometres(solid.centre), rpy=numbers(angles))
    shape = ET.SubElement(visual, "geometry")
    if solid.along is None:
        ET.SubElement(shape, "box", size=_micrometres(solid.size))
    else:
        length, diameter = solid.size[solid.along], solid.size[solid.along - 1]
        sizes = {"radius": _micrometres([diameter / 2]), "length": _micrometres([length])}
        ET.SubElement(shape, "cylinder", sizes)
    ET.SubElement(visual, "material", name=solid.material)


URDF_FILE = "orthoglide.urdf"
CLOSURES_FILE = "orthoglide.closures.toml"
CLOSURES_ENDING = ".closures.toml"

_GENERATED = "Generated by `python -m orthoglide.urdf`: change the generator, not this file."
_LOOPS = f"URDF holds no loops: what closes them stands in {CLOSURES_FILE}."
_LOCAL_AXES = {"a": (1.0, 0.0, 0.0), "b": (0.0, 1.0, 0.0), "c": (0.0, 0.0, 1.0)}

# N, m/s: plausible for a small machine tool; N m, rad/s: a passive joint has no motor.
_LIMITS = ("lower", "upper", "effort", "velocity")
_EFFORT_AND_VELOCITY = {"prismatic": (1000.0, 1.0), "revolute": (0.0, 10.0)}


@dataclass(frozen=True)
class Closure:
    """Two frames of the tree that coincide where the machine is assembled."""

    name: str  # of the loop, such as `"x_parallelogram"`
    # `"point"`, the origins coincide (3 rows), or `"frame"`, the axes too (6 rows)
    kind: Literal["point", "frame"]
    frame_1: str  # link of the tree
    frame_2: str  # link of the tree

    @property
    def rows(self) -> int:
        """Number of conditions: 3 or 6."""
        return 3 if self.kind == "point" else 6


@dataclass(frozen=True)
class _Joint:
    """A joint of a leg; ``axis`` is a, b or c of the leg, or ``""`` for a fixed joint."""

    name: str
    parent: str
    child: str
    xyz: Vector = _ZERO
    rpy: Vector = _ZERO
    axis: str = ""
    limits: tuple[float, float] = (0.0, 0.0)


def pivot_limit(geometry: Geometry) -> float:
    """Return the limit of every revolute, radians: ``2 asin(stroke / L)``, or pi if slides are
    parallel, as the stroke then does not limit the angles.

    A leg at full stroke leans by asin(stroke / L), and by more where the others are at their ends
    too, so the limit is twice that. It has three digits, to be the same on all computers.
    """
    sine = 1.0 if geometry.layout.hanging else max(map(abs, geometry.stroke)) / geometry.L
    return float(f"{2 * math.asin(sine):.3g}")


def roll_pitch_yaw(R: Array) -> Vector:
    """Return the angles of ``R = Rz(yaw) Ry(pitch) Rx(roll)`` for URDF; a free yaw is 0."""
    if abs(R[2, 0]) > 1 - 1e-12:
        pitch = -math.copysign(math.pi / 2, R[2, 0])
        return vector((math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0))
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    return vector((math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])))


def _joints(geometry: Geometry, leg: int) -> tuple[_Joint, ...]:
    """Return the joints of a leg from the base to the platform, then the closures' frames."""
    L, d, pose = geometry.L, geometry.d, geometry.legs[leg]
    name = pose.name
    swing = (-pivot_limit(geometry), pivot_limit(geometry))
    carriage, fork, knuckle, platform = (
        f"{name}_{part}" for part in ("carriage", "fork", "knuckle", "platform")
    )
    bar1, bar2 = f"{name}_bar1", f"{name}_bar2"
    carriage_rpy, platform_rpy = roll_pitch_yaw(pose.axes), roll_pitch_yaw(pose.axes.T)
    lean = pose.lean  # built into the pivots, so that joints at zero are the closed machine
    tool = vector(-pose.platform @ pose.axes)
    slide = vector(pose.carriage), carriage_rpy, "a", geometry.stroke
    return (
        _Joint(f"{name}_slide", "base", carriage, *slide),
        _Joint(f"{name}_theta", carriage, fork, rpy=(0.0, 0.0, lean), axis="c", limits=swing),
        _Joint(bar1, fork, bar1, (0.0, 0.0, d / 2), axis="b", limits=swing),
        _Joint(knuckle, bar1, knuckle, (-L, 0.0, 0.0), axis="b", limits=swing),
        _Joint(platform, knuckle, platform, (0.0, 0.0, -d / 2), (0.0, 0.0, -lean), "c", swing),
        _Joint(bar2, fork, bar2, (0.0, 0.0, -d / 2), axis="b", limits=swing),
        _Joint(f"{name}_bar2_tip_fixed", bar2, f"{name}_bar2_tip", (-L, 0.0, 0.0)),
        _Joint(f"{name}_knuckle_tip_fixed", knuckle, f"{name}_knuckle_tip", (0.0, 0.0, -d)),
        _Joint(f"{name}_tcp_fixed", platform, f"{name}_tcp", tool, platform_rpy),
    )


def to_urdf(geometry: Geometry) -> str:
    """Return the URDF text of the nominal tree, metres, kilograms and radians, whose joints at zero
    are the closed machine at mechanical zero.

    Slide q is travel from mechanical zero, within the stroke. The base has no inertia, as it stands
    on the floor, and there is no collision geometry: links that share a pivot overlap there.
    """
    robot = ET.Element("robot", name=geometry.layout.kind)
    for name, (colour, _) in MATERIALS.items():
        element = ET.SubElement(robot, "material", name=name)
        ET.SubElement(element, "color", rgba=numbers((*colour, 1.0)))
    base = ET.SubElement(robot, "link", name="base")
    for solid in base_solids(geometry):
        add_visual(base, solid)
    for leg in range(3):
        solids = leg_solids(geometry, leg)
        for joint in _joints(geometry, leg):
            link = ET.Element("link", name=joint.child)
            if joint.child in solids:
                add_inertial(link, solids[joint.child])
                for solid in solids[joint.child]:
                    add_visual(link, solid)
            kind = {"": "fixed", "a": "prismatic"}.get(joint.axis, "revolute")
            element = ET.SubElement(robot, "joint", name=joint.name, type=kind)
            ET.SubElement(element, "origin", xyz=numbers(joint.xyz), rpy=numbers(joint.rpy))
            ET.SubElement(element, "parent", link=joint.parent)
            ET.SubElement(element, "child", link=joint.child)
            if joint.axis:
                ET.SubElement(element, "axis", xyz=numbers(_LOCAL_AXES[joint.axis]))
                limits = map(number, (*joint.limits, *_EFFORT_AND_VELOCITY[kind]))
                ET.SubElement(element, "limit", dict(zip(_LIMITS, limits, strict=True)))
            robot.append(link)
    ET.indent(robot)
    text = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- {_GENERATED}\n     {_LOOPS} -->\n{text}\n'


def closures(geometry: Geometry) -> tuple[Closure, ...]:
    """Return the closures of a machine: three parallelograms and the platform, 21 rows in all.

    Their names are ``x_parallelogram``, ``y_...``, ``z_...``, ``platform_xy``, ``platform_xz``.
    """
    names = geometry.leg_names
    first, *others = names
    parallelograms = (
        Closure(f"{name}_parallelogram", "point", f"{name}_bar2_tip", f"{name}_knuckle_tip")
        for name in names
    )
    platforms = (
        Closure(f"platform_{first}{name}", "frame", f"{first}_tcp", f"{name}_tcp")
        for name in others
    )
    return (*parallelograms, *platforms)


def file_names(geometry: Geometry) -> tuple[str, str, str]:
    """Return the file names of a layout's URDF, closures and MJCF: ``linear-delta.urdf`` ..."""
    kind = geometry.layout.kind
    return f"{kind}.urdf", f"{kind}{CLOSURES_ENDING}", f"{kind}.xml"


def closures_text(
    loops: Sequence[Closure], urdf: str = URDF_FILE, held: Mapping[str, float] | None = None
) -> str:
    """Return the closures in TOML: one table ``[[closure]]`` for each loop of the file ``urdf``.

    ``held``: parameters of a calibrated machine whose values, SI, the URDF contains; they stand in
    the table ``[held]``.
    """
    head = (
        f"# {_GENERATED}\n"
        f"# Frames of {urdf} that coincide in the assembled machine:\n"
        '# kind "point", their origins; kind "frame", origins and axes.\n'
    )
    tables = (
        f'\n[[closure]]\nname = "{loop.name}"\nkind = "{loop.kind}"\n'
        f'frame_1 = "{loop.frame_1}"\nframe_2 = "{loop.frame_2}"\n'
        for loop in loops
    )
    lines = [f'"{name}" = {value!r}\n' for name, value in (held or {}).items()]
    of_machine = ["\n# Errors that the URDF contains, SI.\n[held]\n", *lines] if lines else []
    return head + "".join([*tables, *of_machine])


def write(folder: str | Path, geometry: Geometry | None = None) -> tuple[Path, Path]:
    """Write the URDF and the closures of a machine, by default the published one, into a folder;
    return their paths.
    """
    geometry, target = geometry or Geometry(), Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    paths = target / URDF_FILE, target / CLOSURES_FILE
    texts = to_urdf(geometry), closures_text(closures(geometry))
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8", newline="\n")
    return paths


def shipped_folder() -> Path:
    """Return the folder with the two files of the published machine that the package ships."""
    package = Path(__file__).parents[1]
    installed = package / "_urdf"
    return installed if installed.is_dir() else package.parent / "urdf"
