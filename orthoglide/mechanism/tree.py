"""The kinematic tree: a URDF in Pinocchio, with the joints a real machine has besides.

Four kinds of joint, and nothing else: *drives* move by command, *passive* joints close the loops,
*relief* joints are the two a leg in which the PRPaR machine is overconstrained, *virtual* joints
are where machines go wrong. Neither relief nor virtual joints are in the URDF; they are inserted
here, from the tables below, so a new place for an error is one line.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.text import printable_path
from orthoglide.urdf import Closure, read_looped_urdf, shipped_folder, write

JointFactory = Callable[[], Any]
"""Makes the Pinocchio model of a joint that the URDF lacks."""


def _slide(x: float, y: float, z: float) -> JointFactory:
    return lambda: pin.JointModelPrismaticUnaligned(np.array([x, y, z]))


# Joints that follow a URDF joint and carry all that is behind it; the leg's a, b, c = x, y, z.
JOINTS_AFTER: dict[str, dict[str, JointFactory]] = {
    "slide": {
        "travel": pin.JointModelPX, "lateral_b": pin.JointModelPY, "lateral_c": pin.JointModelPZ,
        "turn_a": pin.JointModelRX, "turn_b": pin.JointModelRY, "turn_c": pin.JointModelRZ,
    },
    "bar1": {"stretch1": _slide(-1, 0, 0)},
    "bar2": {"stretch2": _slide(-1, 0, 0)},
    "knuckle": {"width1": _slide(0, 0, -1)},
}  # fmt: skip

# Relief joints stand before a URDF joint: the bar's torsion at bar 1's tip, and a revolute about
# the short link at bar 2's root. A torsion placed nearer to the carriage gives another machine.
JOINTS_BEFORE: dict[str, tuple[str, JointFactory]] = {
    "knuckle": ("relief_bar", pin.JointModelRX),
    "bar2": ("relief_link", pin.JointModelRZ),
}

# A joint between a body and one of its frames: here the short link's far end, so that the platform
# keeps to the middle of a link that is too wide.
JOINTS_BEFORE_FRAMES: dict[str, tuple[str, JointFactory]] = {
    "knuckle_tip": ("width2", _slide(0, 0, -1))
}

VIRTUAL_NAMES: tuple[str, ...] = (
    "travel", "lateral_b", "lateral_c", "turn_a", "turn_b", "turn_c",
    "stretch1", "stretch2", "width1", "width2",
)  # fmt: skip
"""The virtual joints of a leg, in the order in which displacements are given."""

PASSIVE_NAMES: tuple[str, ...] = ("theta", "bar1", "knuckle", "platform", "bar2")
RELIEF_NAMES: tuple[str, ...] = ("relief_bar", "relief_link")

# Cosine of the angle between rails, less than 1 by this, that still counts as parallel: rails of a
# calibrated delta lean by some milliradians.
_PARALLEL = 1e-3


@dataclass(frozen=True)
class Tree:
    """A Pinocchio model with its loop closures, its joints sorted by who moves them.

    Attributes:
        model: the tree. Never changed after it is built.
        loops: the closures, naming frames of the model.
        motors: names of the driven joints, one degree of freedom each.
        drive: positions in the velocity vector of the drives.
        passive: positions of the passive joints; of three legs five each, leg by leg.
        relief: positions of the relief joints ``(6,)``, or empty.
        virtual: positions of the virtual joints ``(30,)``, ten a leg, or empty.
        tool: name of the frame that is the tool.
    """

    model: pin.Model
    loops: tuple[Closure, ...]
    motors: tuple[str, ...]
    drive: NDArray[np.intp]
    passive: NDArray[np.intp]
    relief: NDArray[np.intp]
    virtual: NDArray[np.intp]
    tool: str

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Positions of all joints that closure moves: passive, then relief."""
        return np.concatenate([self.passive, self.relief])

    @cached_property
    def leg_names(self) -> tuple[str, ...]:
        """Names of the legs: what stands before ``_slide`` in the names of the drives."""
        return tuple(motor.removesuffix("_slide") for motor in self.motors)

    @cached_property
    def slides(self) -> Array:
        """Directions of the three rails ``(3, 3)``, by leg, where all joints are at zero."""
        data = self.model.createData()
        pin.computeJointJacobians(self.model, data, pin.neutral(self.model))
        return np.stack([data.J[:3, k] for k in self.drive])

    @cached_property
    def hanging(self) -> bool:
        """Return whether the platform hangs below parallel rails."""
        return bool((self.slides @ self.slides[0] > 1 - _PARALLEL).all())

    def frame(self, name: str) -> int:
        """Return the number of a link's frame.

        Raises:
            InputError: where the model has no such frame.
        """
        # A joint and a link may share a name: then the link is meant.
        named = [k for k, frame in enumerate(self.model.frames) if frame.name == name]
        if not named:
            raise InputError(f"the URDF has no link {name!r}")
        return next(
            (k for k in named if self.model.frames[k].type != pin.FrameType.JOINT), named[0]
        )

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Each loop's rows in the closure residual."""
        ends = np.cumsum([loop.rows for loop in self.loops]).tolist()
        return {
            loop.name: slice(end - loop.rows, end)
            for loop, end in zip(self.loops, ends, strict=True)
        }

    def by_loop(self, residual: Array) -> dict[str, float]:
        """Return the largest entry of a closure residual by loop: metres, or radians for turns."""
        starts = [rows.start for rows in self.rows.values()]
        largest = np.maximum.reduceat(np.abs(residual), starts).tolist()
        return dict(zip(self.rows, largest, strict=True))


@dataclass(frozen=True)
class LoopedModel:
    """A Pinocchio model as its URDF has it, its text, what closes its loops, and its motors."""

    model: pin.Model
    loops: tuple[Closure, ...]
    motors: tuple[str, ...]
    text: str = ""


def load(source: Geometry | str | os.PathLike[str] | None = None) -> LoopedModel:
    """Return a machine's model and closures, read from its URDF and the file beside it.

    Args:
        source: dimensions, whose files the generator writes first; or a folder with both files;
            the published machine's files, which the package ships, where absent.

    Raises:
        FileError: where a file is missing or says what cannot be.
    """
    if isinstance(source, Geometry) and source != Geometry():
        with tempfile.TemporaryDirectory() as folder:
            write(folder, source)
            return load(folder)
    folder_of = shipped_folder() if source is None or isinstance(source, Geometry) else source
    found = read_looped_urdf(folder_of)
    try:
        model = pin.buildModelFromUrdf(str(found.path))
    except (ValueError, RuntimeError):
        raise FileError(
            "Pinocchio finds no tree of links and joints in it, and prints why: correct it",
            file=printable_path(found.path),
        ) from None
    model = _replace_joints(model, found.replaced)
    for motor in found.motors:
        if not model.existJointName(motor) or model.joints[model.getJointId(motor)].nv != 1:
            raise FileError(
                f"{motor} is driven and no joint of one degree of freedom",
                file=printable_path(found.path),
            )
    return LoopedModel(model, found.closures, found.motors, found.urdf)


def nominal_tree(looped: LoopedModel) -> Tree:
    """Return the tree as its URDF has it; of three PRPaR legs 18 joints, the legs rigid."""
    return _classify_joints(looped, looped.model)


def general_tree(looped: LoopedModel) -> Tree:
    """Return the tree of three PRPaR legs with relief and virtual joints inserted: 54 joints.

    Raises:
        InputError: where the URDF has not the joints of three PRPaR legs.
    """
    legs = [motor.removesuffix("_slide") for motor in looped.motors]
    wanted = [f"{leg}_{name}" for leg in legs for name in ("slide", *PASSIVE_NAMES)]
    missing = [name for name in wanted if not looped.model.existJointName(name)]
    if len(legs) != 3 or missing:
        what = f"no joint {missing[0]}" if missing else f"{len(legs)} driven slides"
        raise InputError(
            f"a machine of this package has three PRPaR legs, and this URDF has {what}"
        )
    return _classify_joints(looped, _insert_extra_joints(looped.model))


def _classify_joints(looped: LoopedModel, model: pin.Model) -> Tree:
    legs = [motor.removesuffix("_slide") for motor in looped.motors]

    def places(names: tuple[str, ...]) -> list[int]:
        full = [f"{leg}_{name}" for leg in legs for name in names]
        return [model.joints[model.getJointId(n)].idx_v for n in full if model.existJointName(n)]

    def array(positions: list[int]) -> NDArray[np.intp]:
        return np.array(positions, dtype=np.intp)

    drive = [model.joints[model.getJointId(motor)].idx_v for motor in looped.motors]
    relief, virtual, passive = places(RELIEF_NAMES), places(VIRTUAL_NAMES), places(PASSIVE_NAMES)
    sorted_already = {*drive, *relief, *virtual, *passive}
    passive += [k for k in range(model.nv) if k not in sorted_already]
    tool = looped.loops[-1].frame_1 if looped.loops else model.frames[-1].name
    drives, loose, reliefs, virtuals = (array(k) for k in (drive, passive, relief, virtual))
    return Tree(model, looped.loops, looped.motors, drives, loose, reliefs, virtuals, tool)


def _replace_joints(source: pin.Model, replaced: Mapping[str, str]) -> pin.Model:
    """Return the model with some joints made spherical or fixed."""
    fixed = [source.getJointId(name) for name, kind in replaced.items() if kind == "FIXED"]
    if fixed:
        source = pin.buildReducedModel(source, fixed, pin.neutral(source))
    if "SPHERICAL" not in replaced.values():
        return source
    model = pin.Model()
    model.name = source.name
    for j in range(1, source.njoints):
        name = source.names[j]
        joint = pin.JointModelSpherical() if replaced.get(name) == "SPHERICAL" else source.joints[j]
        model.addJoint(source.parents[j], joint, source.jointPlacements[j], name)
        model.appendBodyToJoint(j, source.inertias[j], pin.SE3.Identity())
    for frame in source.frames[1:]:
        if frame.type == pin.FrameType.BODY:
            model.addFrame(pin.Frame(frame.name, frame.parentJoint, 0, frame.placement, frame.type))
    return model


def _insert_extra_joints(source: pin.Model) -> pin.Model:
    """Copy the model joint by joint, putting the extra joints where the tables say."""
    model = pin.Model()
    model.name = source.name
    carrier = {0: 0}  # joint of the source -> joint of the copy that carries its bodies

    def add(parent: int, joint: Any, placement: pin.SE3, name: str) -> int:
        number = int(model.addJoint(parent, joint, placement, name))
        model.addJointFrame(number)  # which Pinocchio's own algorithms on models look for
        return number

    for j in range(1, source.njoints):
        leg, _, name = source.names[j].partition("_")
        parent, placement = carrier[source.parents[j]], source.jointPlacements[j]
        if name in JOINTS_BEFORE:
            extra, joint = JOINTS_BEFORE[name]
            parent = add(parent, joint(), placement, f"{leg}_{extra}")
            placement = pin.SE3.Identity()
        here = add(parent, source.joints[j], placement, source.names[j])
        for extra, joint in JOINTS_AFTER.get(name, {}).items():
            here = add(here, joint(), pin.SE3.Identity(), f"{leg}_{extra}")
        carrier[j] = here
        model.appendBodyToJoint(here, source.inertias[j], pin.SE3.Identity())
    for frame in source.frames[1:]:
        leg, _, name = frame.name.partition("_")
        parent = carrier[frame.parentJoint]
        if frame.type != pin.FrameType.BODY:
            continue
        if name in JOINTS_BEFORE_FRAMES:
            extra, joint = JOINTS_BEFORE_FRAMES[name]
            parent = add(parent, joint(), pin.SE3.Identity(), f"{leg}_{extra}")
        model.addFrame(pin.Frame(frame.name, parent, 0, frame.placement, pin.FrameType.OP_FRAME))
    return model
