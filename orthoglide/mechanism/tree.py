"""The kinematic tree: the URDF in Pinocchio, with the joints a real machine has besides.

Four kinds of joint, and nothing else: *drives* move by command, *passive* joints close the loops,
*relief* joints are the two a leg in which the PRPaR machine is overconstrained, *virtual* joints
are where machines go wrong. Neither relief nor virtual joints are in the URDF; they are inserted
here, from the tables below, so a new place for an error is one line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from orthoglide.geometry import Array, Geometry
from orthoglide.urdf import Closure, closures, to_urdf

Joint = Callable[[], Any]
"""Makes the Pinocchio model of a joint that the URDF lacks."""


def _slide(x: float, y: float, z: float) -> Joint:
    return lambda: pin.JointModelPrismaticUnaligned(np.array([x, y, z]))


# Joints that follow a URDF joint and carry all that is behind it; the leg's a, b, c = x, y, z.
BEHIND: dict[str, dict[str, Joint]] = {
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
BEFORE: dict[str, tuple[str, Joint]] = {
    "knuckle": ("relief_bar", pin.JointModelRX),
    "bar2": ("relief_link", pin.JointModelRZ),
}

# A joint between a body and one of its frames: here the short link's far end, so that the platform
# keeps to the middle of a link that is too wide.
BEFORE_FRAME: dict[str, tuple[str, Joint]] = {"knuckle_tip": ("width2", _slide(0, 0, -1))}

VIRTUAL_NAMES: tuple[str, ...] = (
    "travel", "lateral_b", "lateral_c", "turn_a", "turn_b", "turn_c",
    "stretch1", "stretch2", "width1", "width2",
)  # fmt: skip
"""The virtual joints of a leg, in the order in which displacements are given."""

PASSIVE_NAMES: tuple[str, ...] = ("theta", "bar1", "knuckle", "platform", "bar2")
RELIEF_NAMES: tuple[str, ...] = ("relief_bar", "relief_link")


@dataclass(frozen=True)
class Tree:
    """A Pinocchio model of the three legs with its joints sorted by who moves them."""

    geometry: Geometry  # the nominal dimensions
    model: pin.Model  # the tree. Never changed after it is built.
    loops: tuple[Closure, ...]  # the closures, naming frames of the model
    drive: NDArray[np.intp]  # positions in q of the drives, (3,), by leg
    passive: NDArray[np.intp]  # positions of the passive joints, (15,), five a leg
    relief: NDArray[np.intp]  # positions of the relief joints, (6,) or empty
    virtual: NDArray[np.intp]  # positions of the virtual joints, (30,), ten a leg, or empty

    @property
    def tool(self) -> str:
        """Name of the frame that is the tool."""
        return f"{self.geometry.leg_names[0]}_tcp"

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Positions of all joints that closure moves: passive, then relief."""
        return np.concatenate([self.passive, self.relief])

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Each loop's rows among the 21 of the closure residual."""
        ends = np.cumsum([loop.rows for loop in self.loops]).tolist()
        return {
            loop.name: slice(end - loop.rows, end)
            for loop, end in zip(self.loops, ends, strict=True)
        }

    def by_loop(self, residual: Array) -> dict[str, float]:
        """Largest entry of a closure residual ``(21,)`` by loop: metres, or radians for turns."""
        starts = [rows.start for rows in self.rows.values()]
        largest = np.maximum.reduceat(np.abs(residual), starts).tolist()
        return dict(zip(self.rows, largest, strict=True))


def nominal_tree(geometry: Geometry | None = None) -> Tree:
    """The URDF as it is: 18 joints, rigid PRPaR legs."""
    geometry = geometry or Geometry()
    return _sorted(geometry, _load(geometry))


def general_tree(geometry: Geometry | None = None) -> Tree:
    """The URDF with relief and virtual joints inserted: 54 joints."""
    geometry = geometry or Geometry()
    return _sorted(geometry, _with_extras(_load(geometry)))


def _load(geometry: Geometry) -> pin.Model:
    return pin.buildModelFromXML(to_urdf(geometry))


def _sorted(geometry: Geometry, model: pin.Model) -> Tree:
    def places(names: tuple[str, ...]) -> NDArray[np.intp]:
        full = [f"{leg}_{name}" for leg in geometry.leg_names for name in names]
        return np.array(
            [model.joints[model.getJointId(n)].idx_q for n in full if model.existJointName(n)],
            dtype=np.intp,
        )

    return Tree(
        geometry,
        model,
        closures(geometry),
        places(("slide",)),
        places(PASSIVE_NAMES),
        places(RELIEF_NAMES),
        places(VIRTUAL_NAMES),
    )


def _with_extras(source: pin.Model) -> pin.Model:
    """Copy the model joint by joint, putting the extra joints where the tables say."""
    model = pin.Model()
    model.name = source.name
    carrier = {0: 0}  # joint of the source -> joint of the copy that carries its bodies

    def add(parent: int, joint: Any, placement: pin.SE3, name: str) -> int:
        return int(model.addJoint(parent, joint, placement, name))

    for j in range(1, source.njoints):
        leg, _, name = source.names[j].partition("_")
        parent, placement = carrier[source.parents[j]], source.jointPlacements[j]
        if name in BEFORE:
            extra, joint = BEFORE[name]
            parent = add(parent, joint(), placement, f"{leg}_{extra}")
            placement = pin.SE3.Identity()
        here = add(parent, source.joints[j], placement, source.names[j])
        for extra, joint in BEHIND.get(name, {}).items():
            here = add(here, joint(), pin.SE3.Identity(), f"{leg}_{extra}")
        carrier[j] = here
        model.appendBodyToJoint(here, source.inertias[j], pin.SE3.Identity())
    for frame in source.frames[1:]:
        leg, _, name = frame.name.partition("_")
        parent = carrier[frame.parentJoint]
        if frame.type != pin.FrameType.BODY:
            continue
        if name in BEFORE_FRAME:
            extra, joint = BEFORE_FRAME[name]
            parent = add(parent, joint(), pin.SE3.Identity(), f"{leg}_{extra}")
        model.addFrame(pin.Frame(frame.name, parent, 0, frame.placement, pin.FrameType.OP_FRAME))
    return model
