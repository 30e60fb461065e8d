"""The kinematic tree: a URDF in Pinocchio, with additional joints for errors of real machines.

There are four kinds of joints: *drives* move by command, *passive* joints close the loops,
*relief* joints (two a leg) remove the overconstraints of the PRPaR machine, and *virtual* joints
carry the errors. Relief and virtual joints are not in the URDF: they are inserted from the tables
below, where a new virtual joint is one line.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.text import printable_path
from orthoglide.urdf import Closure, read_looped_urdf, shipped_folder
from orthoglide.urdf.parallel import generated_files

JointFactory = Callable[[], Any]
"""Returns the Pinocchio model of a joint that is not in the URDF."""


def _slide(x: float, y: float, z: float) -> JointFactory:
    return lambda: pin.JointModelPrismaticUnaligned(np.array([x, y, z]))


# Joints that follow a URDF joint and carry all its descendants; the leg's a, b, c = x, y, z.
JOINTS_AFTER: dict[str, dict[str, JointFactory]] = {
    "slide": {
        "travel": pin.JointModelPX, "lateral_b": pin.JointModelPY, "lateral_c": pin.JointModelPZ,
        "turn_a": pin.JointModelRX, "turn_b": pin.JointModelRY, "turn_c": pin.JointModelRZ,
    },
    "bar1": {"stretch1": _slide(-1, 0, 0)},
    "bar2": {"stretch2": _slide(-1, 0, 0)},
    "knuckle": {"width1": _slide(0, 0, -1)},
}  # fmt: skip

# Relief joints precede a URDF joint: the bar's torsion at bar 1's tip, and a revolute about the
# short link at bar 2's root. A torsion nearer to the carriage would be a different mechanism.
JOINTS_BEFORE: dict[str, tuple[str, JointFactory]] = {
    "knuckle": ("relief_bar", pin.JointModelRX),
    "bar2": ("relief_link", pin.JointModelRZ),
}

# A joint between a body and one of its frames: the short link's far end, so that the platform stays
# in the middle of a link that is too wide.
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

# 1 less the cosine of the largest angle, 2.6 degrees, between rails that count as parallel: those
# of a calibrated delta lean by some milliradians.
_PARALLEL = 1e-3


def frame_number(model: pin.Model, name: str) -> int:
    """Return the number of a frame; where a joint and a link share a name, that of the link.

    Raises:
        InputError: where the model has no such frame.
    """
    if model.existFrame(name, pin.FrameType.BODY):
        return int(model.getFrameId(name, pin.FrameType.BODY))
    if not model.existFrame(name):
        raise InputError(f"the model has no frame {name!r}")
    return int(model.getFrameId(name))


@dataclass(frozen=True)
class Tree:
    """A Pinocchio model with its loop closures, and its joints by kind as positions in the velocity
    vector.
    """

    model: pin.Model  # the tree; never changed after it is built
    loops: tuple[Closure, ...]  # the closures, naming frames of the model
    motors: tuple[str, ...]  # names of the driven joints, one degree of freedom each
    drive: NDArray[np.intp]  # the drives
    passive: NDArray[np.intp]  # those that close the loops: five a PRPaR leg, then all others
    relief: NDArray[np.intp]  # the relief joints (6,), or empty
    virtual: NDArray[np.intp]  # the virtual joints (30,), ten a leg, or empty
    tool: str  # name of the frame that is the tool
    urdf: str = ""  # text of the URDF from which the model was read

    @classmethod
    def of_model(
        cls, model: pin.Model, loops: tuple[Closure, ...], motors: tuple[str, ...], urdf: str = ""
    ) -> Tree:
        """Return the tree of a model, its joints sorted by kind; arguments are the attributes."""
        legs = [motor.removesuffix("_slide") for motor in motors]

        def positions(names: Iterable[str]) -> NDArray[np.intp]:
            joints = [model.getJointId(name) for name in names if model.existJointName(name)]
            return np.array([model.joints[j].idx_v for j in joints], dtype=np.intp)

        drive = positions(motors)
        passive, relief, virtual = (
            positions(f"{leg}_{name}" for leg in legs for name in names)
            for names in (PASSIVE_NAMES, RELIEF_NAMES, VIRTUAL_NAMES)
        )
        others = np.setdiff1d(np.arange(model.nv), [*drive, *passive, *relief, *virtual])
        tool = loops[-1].frame_1 if loops else model.frames[-1].name
        passive = np.concatenate([passive, others])
        return cls(model, loops, motors, drive, passive, relief, virtual, tool, urdf)

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Positions of all joints that closing the loops moves: passive, then relief."""
        return np.concatenate([self.passive, self.relief])

    @cached_property
    def leg_names(self) -> tuple[str, ...]:
        """Names of the legs: the names of the drives without ``_slide``."""
        return tuple(motor.removesuffix("_slide") for motor in self.motors)

    @cached_property
    def slides(self) -> Array:
        """Directions of the three rails ``(3, 3)``, by leg, where all joints are at zero."""
        data = self.model.createData()
        pin.computeJointJacobians(self.model, data, pin.neutral(self.model))
        return np.stack([data.J[:3, k] for k in self.drive])

    @cached_property
    def hanging(self) -> bool:
        """Whether the rails are parallel, as of a linear delta, whose platform hangs below."""
        return bool((self.slides @ self.slides[0] > 1 - _PARALLEL).all())

    def frame(self, name: str) -> int:
        """Return the number of a link's frame.

        Raises:
            InputError: where the model has no such frame.
        """
        return frame_number(self.model, name)

    def loop_ends(self, loop: Closure) -> tuple[int, pin.SE3, int, pin.SE3]:
        """Return joint and placement of both frames of a loop, as Pinocchio's constraints take."""
        frame_1, frame_2 = (
            self.model.frames[self.frame(name)] for name in (loop.frame_1, loop.frame_2)
        )
        return frame_1.parentJoint, frame_1.placement, frame_2.parentJoint, frame_2.placement

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Rows of each loop in the closure residual."""
        ends = np.cumsum([loop.rows for loop in self.loops]).tolist()
        loops = zip(self.loops, ends, strict=True)
        return {loop.name: slice(end - loop.rows, end) for loop, end in loops}

    def by_loop(self, residual: Array) -> dict[str, float]:
        """Return the largest entry of a closure residual by loop: metres, or radians for turns."""
        starts = [rows.start for rows in self.rows.values()]
        largest = np.maximum.reduceat(np.abs(residual), starts).tolist()
        return dict(zip(self.rows, largest, strict=True))


def load(source: Geometry | str | os.PathLike[str] | None = None) -> Tree:
    """Return a machine's tree as it is in its URDF and the closures file beside it, without
    additional joints: 18 joints for three rigid PRPaR legs.

    Args:
        source: a folder with both files; or dimensions, from which they are generated. For those of
            the published machine, and where absent, the files that the package ships are read.

    Raises:
        FileError: where a file is missing or invalid.
    """
    if isinstance(source, Geometry) and source != Geometry():
        files = generated_files(source)
    elif source is None or isinstance(source, Geometry):
        files = read_looped_urdf(shipped_folder())
    else:
        files = read_looped_urdf(source)
    try:
        model = pin.buildModelFromXML(files.urdf)
    except (ValueError, RuntimeError):
        raise FileError(
            "Pinocchio finds no tree of links and joints in this file, and prints why: correct it",
            file=printable_path(files.path),
        ) from None
    if fixed := [n for n, kind in files.replaced.items() if kind == "FIXED"]:
        model = pin.buildReducedModel(model, [*map(model.getJointId, fixed)], pin.neutral(model))
    if spherical := [n for n, kind in files.replaced.items() if kind == "SPHERICAL"]:
        model = _copied(model, spherical=spherical)
    for motor in files.motors:
        if not model.existJointName(motor) or model.joints[model.getJointId(motor)].nv != 1:
            raise FileError(
                f"the closures must drive joints of one degree of freedom, not {motor}",
                file=printable_path(files.path),
            )
    return Tree.of_model(model, files.closures, files.motors, files.urdf)


def general_tree(nominal: Tree) -> Tree:
    """Return the tree of three PRPaR legs with relief and virtual joints inserted: 54 joints.

    Raises:
        InputError: where the URDF lacks joints of three PRPaR legs.
    """
    legs = nominal.leg_names
    required = [f"{leg}_{name}" for leg in legs for name in ("slide", *PASSIVE_NAMES)]
    missing = [name for name in required if not nominal.model.existJointName(name)]
    if len(legs) != 3 or missing:
        finding = f"no joint {missing[0]}" if missing else f"{len(legs)} driven slides"
        raise InputError(
            f"a machine of this package has three PRPaR legs, and this URDF has {finding}"
        )
    model = _copied(nominal.model, extra_joints=True)
    return Tree.of_model(model, nominal.loops, nominal.motors, nominal.urdf)


def visual_model(tree: Tree, nominal: Tree) -> Any:
    """Return the solids of a tree's URDF as ``pin.GeometryModel``, attached to the joints of the
    general tree, or of one reduced from it.
    """
    visual = pin.buildGeomFromUrdfString(nominal.model, nominal.urdf, pin.GeometryType.VISUAL)
    for item in visual.geometryObjects:
        link = nominal.model.frames[item.parentFrame]
        frame = tree.model.frames[tree.frame(link.name)]
        item.placement = frame.placement * link.placement.inverse() * item.placement
        item.parentJoint, item.parentFrame = frame.parentJoint, tree.frame(link.name)
    return visual


def _copied(
    source: pin.Model, spherical: Collection[str] = (), extra_joints: bool = False
) -> pin.Model:
    """Return a copy of a model with some of its joints spherical, and with the additional joints of
    the tables above.
    """
    model = pin.Model()
    model.name = source.name
    copy_of = {0: 0}  # joint of the source -> joint of the copy that carries its bodies

    def add(parent: int, joint: Any, placement: pin.SE3, name: str) -> int:
        number = int(model.addJoint(parent, joint, placement, name))
        model.addJointFrame(number)  # Pinocchio's algorithms on models need it
        return number

    for j in range(1, source.njoints):
        leg, _, name = source.names[j].partition("_")
        parent, placement = copy_of[source.parents[j]], source.jointPlacements[j]
        if extra_joints and name in JOINTS_BEFORE:
            extra, joint = JOINTS_BEFORE[name]
            parent = add(parent, joint(), placement, f"{leg}_{extra}")
            placement = pin.SE3.Identity()
        kind = pin.JointModelSpherical() if source.names[j] in spherical else source.joints[j]
        last_joint = add(parent, kind, placement, source.names[j])
        if extra_joints:
            for extra, joint in JOINTS_AFTER.get(name, {}).items():
                last_joint = add(last_joint, joint(), pin.SE3.Identity(), f"{leg}_{extra}")
        copy_of[j] = last_joint
        model.appendBodyToJoint(last_joint, source.inertias[j], pin.SE3.Identity())
    for frame in source.frames[1:]:
        if frame.type != pin.FrameType.BODY:
            continue  # frames of joints were added with their joints
        leg, _, name = frame.name.partition("_")
        parent = copy_of[frame.parentJoint]
        if extra_joints and name in JOINTS_BEFORE_FRAMES:
            extra, joint = JOINTS_BEFORE_FRAMES[name]
            parent = add(parent, joint(), pin.SE3.Identity(), f"{leg}_{extra}")
        model.addFrame(pin.Frame(frame.name, parent, 0, frame.placement, frame.type))
    return model
