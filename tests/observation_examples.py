"""An example of every kind of reading: a sheet, and its readings of a pose, by hand.

Nothing of a kind's formula comes from the package here. What a kind reads of a pose is written down
once more, from the pose and the bars of an independent machine (`tests.rig`, `tests.rig_delta`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from orthoglide.geometry import LEGS
from orthoglide.instruments import OBSERVATIONS, InstrumentPose, Setup
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings, derive_approach
from tests import engines
from tests.rig import Rig
from tests.rig_delta import DeltaRig

Array = np.ndarray
BALL = np.array([0.02, -0.03, -0.25])
ORTHOGLIDE = Machine.nominal()
DELTA = Machine(MachineFile(geometry=engines.DELTA))
MACHINES = {"orthoglide": ORTHOGLIDE, "delta": DELTA}
TRUE = {
    "orthoglide": {
        "joint_offset.x": 6e-4, "joint_offset.y": -4e-4, "joint_offset.z": 3e-4,
        "leg_length.x": 4e-5, "leg_length.z": -6e-5, "axis_tilt.y.z": 1e-3, "rail_tilt.x.y": 8e-4,
        "bar_mismatch.x": 5e-5, "mount_tilt.z.a": 1e-3, "encoder_scale.z": 1e-4, "backlash.y": 3e-5,
    },
    "delta": {
        "joint_offset.a": 3e-4, "joint_offset.b": -2e-4, "leg_length.b": 5e-5,
        "axis_offset.b.radial": 4e-4, "axis_tilt.c.tangential": 1e-3,
        "rail_tilt.a.tangential": 2e-3, "bar_mismatch.b": 5e-5, "mount_tilt.b.a": 2e-3,
        "encoder_scale.a": 1e-4, "backlash.c": 3e-5,
    },
}  # fmt: skip
"""Errors of every sort, in names of each layout, that change what every kind reads."""


@dataclass(frozen=True)
class Poses:
    """What an instrument may look at: the tool, and bars where it reads a leg."""

    p: Array  # (n, 3)
    R: Array  # (n, 3, 3)
    other: Array  # place beside the tool at the second command (n, 3)
    dial: Callable[[Array], Array]  # crossing of each row's leg with a plane at places along it

    def at(self, readings: Readings) -> Array:
        """Return the place beside the tool ``(n, 3)``."""
        return self.p + np.einsum("nij,nj->ni", self.R, readings.beside)


@dataclass(frozen=True)
class Example:
    """One kind's example."""

    setups: Sequence[Setup]
    # what it reads of poses, instruments at the base frame without any nuisance
    by_hand: Callable[[Poses, Readings], Array]
    # the stand that goes with a machine moved by (R, t), and nuisances beside these of a setup
    carried: Callable[[InstrumentPose, Array, Array, Array], tuple[InstrumentPose, Array]]
    signed: bool = False  # rows count against their axes in turn
    one_way: Sequence[str] = ()  # setups that read along z alone


def _dialled(kind: str, **more: Any) -> list[Setup]:
    L = ORTHOGLIDE.geometry.L
    return [
        Setup(f"{LEGS[leg]}{LEGS[axis]}", leg, axis, (-1) ** axis, 0.35 * L, (leg + axis) % 3, kind,
              **more)
        for leg in range(3) for axis in range(3) if axis != leg
    ]  # fmt: skip


def _at_tool(kind: str, *beside: tuple[float, float, float], **more: Any) -> list[Setup]:
    return [Setup("plain", kind=kind)] + [
        Setup(f"beside {k}", kind=kind, beside=b, **more) for k, b in enumerate(beside)
    ]


def _dial(poses: Poses, r: Readings) -> Array:
    return r.sign * np.take_along_axis(poses.dial(r.gauge), r.axis[:, None], 1)[:, 0]


def _two_dials(poses: Poses, r: Readings) -> Array:
    second = np.array([s.gauge2 for s in r.setups])[r.setup]
    apart = poses.dial(second) - poses.dial(r.gauge)
    return r.sign * np.take_along_axis(apart, r.axis[:, None], 1)[:, 0]


def _coordinate(poses: Poses, r: Readings) -> Array:
    return r.sign * np.take_along_axis(poses.at(r), r.axis[:, None], 1)[:, 0]


def _height(poses: Poses, r: Readings) -> Array:
    """Of the place above z = 0, less what its place beside the tool lifts it in the mean."""
    above = poses.at(r)[:, 2]
    lift = above - poses.p[:, 2]
    for k in range(len(r.setups)):
        above[r.setup == k] -= lift[r.setup == k].mean()
    return above


def _turn(poses: Poses, r: Readings) -> Array:
    """The sine of the angle times the axis."""
    turned = Rotation.from_matrix(poses.R).as_rotvec()
    angle = np.linalg.norm(turned, axis=1, keepdims=True)
    sine = turned * np.sinc(angle / np.pi)
    return r.sign * np.take_along_axis(sine, r.axis[:, None], 1)[:, 0]


def _stay(
    stand: InstrumentPose, nuisance: Array, R: Array, t: Array
) -> tuple[InstrumentPose, Array]:
    return stand, nuisance


def _frame(
    stand: InstrumentPose, nuisance: Array, R: Array, t: Array
) -> tuple[InstrumentPose, Array]:
    """Axes turn with the machine; a point moved by t reads more by that along each of them."""
    turn = stand.rotation @ R.T
    moved = nuisance.copy()
    # The small turn of the frame is about the base's axes: it turns with them.
    moved[3:] = R @ nuisance[3:]
    moved[:3] -= turn @ t + turn @ np.cross(moved[3:], t)
    return replace(stand, rotation=turn), moved


def _plane(
    stand: InstrumentPose, nuisance: Array, R: Array, t: Array
) -> tuple[InstrumentPose, Array]:
    """A plane z = h + s . (x, y) about z turned and moved."""
    slope = R[:2, :2] @ nuisance[1:]
    return stand, np.array([nuisance[0] + t[2] - slope @ t[:2], *slope])


def _sphere(
    stand: InstrumentPose, nuisance: Array, R: Array, t: Array
) -> tuple[InstrumentPose, Array]:
    return replace(stand, ball_centre=R @ stand.ball_centre + t), np.append(
        R @ nuisance[:3], nuisance[3]
    )


def _level(
    stand: InstrumentPose, nuisance: Array, R: Array, t: Array
) -> tuple[InstrumentPose, Array]:
    """A level turned about z past its datum: that of a platform that lay flat, (0, 0, sine)."""
    return stand, nuisance - [0.0, 0.0, R[1, 0]]


EXAMPLES: dict[str, Example] = {
    "leg": Example(_dialled("leg"), _dial, _stay),
    "parallelism": Example(
        _dialled("parallelism", gauge2=0.65 * ORTHOGLIDE.geometry.L), _two_dials, _stay
    ),
    "tcp": Example(
        [*_at_tool("tcp", (0.01, -0.02, 0.03)), Setup("held", kind="tcp")], _coordinate, _frame,
        signed=True, one_way=("held",),
    ),
    "plate": Example(_at_tool("plate", (-0.02, 0.01, 0.0), turned=30.0), _height, _plane),
    "distance": Example(
        _at_tool("distance", (0.0, 0.0, -0.04)),
        lambda poses, r: np.linalg.norm(poses.at(r) - poses.other, axis=1), _stay,
    ),
    "ballbar": Example(
        _at_tool("ballbar", (0.01, 0.02, -0.02)),
        lambda poses, r: np.linalg.norm(poses.at(r) - BALL, axis=1), _sphere,
    ),
    "incline": Example(_at_tool("incline"), _turn, _level, signed=True),
}  # fmt: skip

CASES = [
    (kind, layout)
    for kind, observation in OBSERVATIONS.items()
    for layout in MACHINES
    if layout == "orthoglide" or not observation.on_leg
]


def sheet_of(kind: str, layout: str = "orthoglide", count: int = 36, repeats: int = 1) -> Readings:
    """An example sheet, every setup read throughout the workspace; nothing is read yet."""
    machine, example = MACHINES[layout], EXAMPLES[kind]
    observation = OBSERVATIONS[kind]
    rng = np.random.default_rng(7)
    setups = tuple(example.setups)
    if observation.on_leg:
        each = np.array([0.0, 0.06, -0.1, 0.03, -0.05, 0.045])
        legs = [s.leg for s in setups]
        command = np.array([machine.geometry.command_on_axis(leg, t) for leg in legs for t in each])
        setup = np.repeat(np.arange(len(setups)), len(each))
    else:
        setup = np.sort(np.arange(count) % len(setups))
        command = machine.inverse(places(layout, count, rng))
    n = len(command)
    second = machine.inverse(places(layout, n, rng)) if observation.paired else None
    axes = np.array(observation.axes or (0,))
    again = np.repeat(np.arange(n), repeats)
    command = np.round(command, 9)[again]
    n = len(command)
    nothing, order = np.full(n, np.nan), np.arange(1, n + 1)
    held = np.array([s.name in example.one_way for s in setups])[setup][again]
    made = Readings(
        name=kind, setups=setups, setup=setup[again], command=command,
        approach=derive_approach(command, order) if observation.on_leg
        else rng.integers(-1, 2, (n, 3)).astype(float),
        time=nothing, temperature=nothing, load=np.zeros(n),
        repeat=np.tile(np.arange(1, repeats + 1), n // repeats), order=order, posture=("",) * n,
        reading=nothing, sigma=nothing, line=order + 1,
        axis=np.where(held, 2, axes[again % len(axes)]),
        sign=(-1.0) ** (again // 3) if example.signed else np.ones(n),
        second=None if second is None else np.round(second, 9)[again],
        legs=machine.geometry.layout.names,
    )  # fmt: skip
    if repeats > 1 and not observation.on_leg:  # visits from one side
        made = replace(made, approach=made.approach[::repeats][again])
    if observation.about_ball:  # a ball's place is said by its distances
        p = machine.forward(made.command) + made.beside
        made = made.with_readings(np.linalg.norm(p - BALL, axis=1))
    return made


def places(layout: str, count: int, rng: np.random.Generator) -> Array:
    """Places of the tool over the workspace ``(count, 3)``."""
    if layout == "orthoglide":
        return rng.uniform(-0.05, 0.035, (count, 3))
    r, t = 0.1 * np.sqrt(rng.random(count)), rng.random(count) * 7
    return np.stack([r * np.cos(t), r * np.sin(t), 0.02 + 0.1 * rng.random(count)], axis=1)


def poses_of(layout: str, readings: Readings, errors: dict[str, float]) -> Poses:
    """What an instrument may look at of an independent machine."""
    second = np.where(np.isfinite(readings.second), readings.second, readings.command)
    if layout == "orthoglide":
        rig = Rig(errors=errors)
        one, two = rig.pose(readings.command, readings.approach), rig.pose(second)
        bar = np.array([s.bar for s in readings.setups])[readings.setup]

        def dial(place: Array) -> Array:
            lines = [rig.readings(one.lines, readings.leg, [axis] * len(readings), place, bar)
                     for axis in "xyz"]  # fmt: skip
            return np.stack(lines, axis=1)

        p, R = one.p, one.R
        other = two.p + np.einsum("nij,nj->ni", two.R, readings.beside)
        return Poses(p, R, other, dial)
    rig, way = DeltaRig(errors=errors), readings.approach
    near = DELTA.forward(readings.command), DELTA.forward(second)
    one = [rig.pose(c, q, approach=w)
           for c, q, w in zip(readings.command, near[0], way, strict=True)]  # fmt: skip
    two = [rig.pose(c, q) for c, q in zip(second, near[1], strict=True)]

    def beside(poses: list[tuple[Array, Array]]) -> tuple[Array, Array, Array]:
        p, turn = (np.array(of) for of in zip(*poses, strict=True))
        return p, turn, p + Rotation.from_rotvec(turn).apply(readings.beside)

    p, turn, _ = beside(one)
    nothing = np.full((len(p), 3), np.nan)
    return Poses(p, Rotation.from_rotvec(turn).as_matrix(), beside(two)[2], lambda place: nothing)
