"""The symbolic tree against Pinocchio: this machine's two trees, and robots of other makers."""

from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from orthoglide.errors import InputError
from orthoglide.geometry import Geometry
from orthoglide.mechanism.symbolic import SymbolicTree
from orthoglide.mechanism.tree import Tree, general_tree, load

# Name of the file, kind of root, and the kinds of joint for which it was chosen.
ROBOTS = [
    ("panda.urdf", None),
    ("ur5_robot.urdf", None),
    ("double_pendulum_continuous.urdf", None),
    ("kinova.urdf", None),
    ("tiago.urdf", None),
    ("talos_left_arm.urdf", None),
    ("solo12.urdf", pin.JointModelFreeFlyer),
    ("allegro_left_hand.urdf", None),
    ("anymal-kinova.urdf", pin.JointModelFreeFlyer),
    ("romeo_small.urdf", pin.JointModelFreeFlyer),
    ("double_pendulum.urdf", pin.JointModelSpherical),
]


@cache
def urdf_path(name: str) -> Path:
    """A URDF of the data package, by the name of its file."""
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    found = sorted(str(f.locate()) for f in files if f.name == name)
    assert found, f"example-robot-data has no {name} any more: choose another robot"
    return Path(found[0])


def robot(name: str, root: type | None) -> pin.Model:
    path = str(urdf_path(name))
    return pin.buildModelFromUrdf(path) if root is None else pin.buildModelFromUrdf(path, root())


def configurations(model: pin.Model, n: int, seed: int = 0) -> list[np.ndarray]:
    """Random configurations, far beyond any limits; quaternions and circles are normalised."""
    rng = np.random.default_rng(seed)
    neutral = pin.neutral(model)
    return [pin.integrate(model, neutral, 2.0 * rng.standard_normal(model.nv)) for _ in range(n)]


def largest_difference(model: pin.Model, n: int = 5) -> float:
    """Largest entry by which any frame of any configuration differs from Pinocchio's, metres."""
    tree, places = SymbolicTree(model), {}
    for k, frame in enumerate(model.frames):
        # A joint and a link may share a name: then the link is meant.
        if frame.name not in places or frame.type == pin.FrameType.BODY:
            places[frame.name] = k
    transforms = [tree.frame(name) for name in places]
    every = ca.Function(
        "every", [tree.q], [ca.horzcat(*(ca.horzcat(t.R, t.t) for t in transforms))]
    )
    data, worst = model.createData(), 0.0
    for q in configurations(model, n):
        pin.framesForwardKinematics(model, data, q)
        expected = np.hstack([data.oMf[k].homogeneous[:3] for k in places.values()])
        worst = max(worst, float(np.abs(every(q).full() - expected).max()))
    return worst


@pytest.mark.parametrize("tree", [load, lambda geometry: general_tree(load(geometry))])
@pytest.mark.parametrize("geometry", [Geometry(), Geometry(L=0.5, d=0.11, r=0.047)])
def test_this_machine(tree: Callable[[Geometry], Tree], geometry: Geometry) -> None:
    assert largest_difference(tree(geometry).model, 20) < 1e-12


@pytest.mark.parametrize(("name", "root"), ROBOTS)
def test_other_robots(name: str, root: type | None) -> None:
    model = robot(name, root)
    assert model.nframes > 3
    assert largest_difference(model) < 1e-12


def test_the_robots_cover_every_kind_of_joint() -> None:
    kinds = {
        joint.shortname() for name, root in ROBOTS for joint in list(robot(name, root).joints)[1:]
    }
    assert {"JointModelFreeFlyer", "JointModelSpherical", "JointModelRX", "JointModelRZ"} <= kinds
    assert any("RUB" in kind for kind in kinds)  # without limits: (cos, sin)
    assert any("RevoluteUnaligned" in kind for kind in kinds)
    assert any(kind.startswith("JointModelP") for kind in kinds)


def chain(*joints: Any) -> pin.JointModelComposite:
    """One composite joint of several."""
    composite = pin.JointModelComposite()
    for joint in joints:
        composite.addJoint(joint, pin.SE3.Random())
    return composite


@pytest.mark.parametrize(
    "kind",
    [
        pin.JointModelPlanar,
        pin.JointModelTranslation,
        pin.JointModelSphericalZYX,
        lambda: pin.JointModelUniversal(np.array([1.0, 0, 0]), np.array([0, 1.0, 0])),
        lambda: pin.JointModelHX(0.01),
        lambda: pin.JointModelHelicalUnaligned(np.array([0.0, 0.6, 0.8]), 0.01),
        lambda: chain(pin.JointModelRX(), pin.JointModelRY()),
        lambda: chain(pin.JointModelRX()),
        lambda: chain(pin.JointModelRUBX()),
        lambda: chain(pin.JointModelTranslation(), pin.JointModelSpherical()),
    ],
    ids=["planar", "translation", "zyx", "universal", "helical", "oblique-helical"]
    + [f"composite-{k}" for k in ("two", "revolute", "unbounded", "flyer")],
)
def test_unsupported_joints_are_refused(kind: Callable[[], Any]) -> None:
    model = pin.Model()
    model.addJoint(0, kind(), pin.SE3.Identity(), "odd")
    model.addFrame(pin.Frame("tip", 1, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    tree = SymbolicTree(model)
    with pytest.raises(InputError, match="not supported"):
        tree.frame("tip")
