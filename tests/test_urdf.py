"""The URDF: not stale, read alike by two loaders, closed at zero and over the whole stroke."""

import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from orthoglide import urdf
from orthoglide.control.urdf import calibrated_urdf
from orthoglide.geometry import LEGS, Geometry
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.constraints import Constraints
from orthoglide.mechanism.tree import load
from tests.test_layout import DELTA, UNEVEN, freely

ROOT = Path(__file__).parents[1]
NOMINAL = Geometry()
OTHER = Geometry(L=0.5, d=0.11, r=0.047, stroke=(-0.12, 0.08))
GEOMETRIES = pytest.mark.parametrize("geometry", [NOMINAL, OTHER], ids=["nominal", "other"])
PARTS = ("slide", "theta", "bar1", "knuckle", "platform", "bar2")
FRAMES = ("bar2_tip", "knuckle_tip", "tcp")


def model_of(geometry: Geometry) -> pin.Model:
    return pin.buildModelFromXML(urdf.to_urdf(geometry))


def link_poses(model: pin.Model, q: np.ndarray) -> dict[str, np.ndarray]:
    """Pose (4, 4) of every link in the base."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    bodies = [i for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    return {model.frames[i].name: data.oMf[i].homogeneous.copy() for i in bodies}


def gaps(geometry: Geometry, poses: dict[str, np.ndarray]) -> dict[str, float]:
    """How far each closure is open: metres, and for a frame the entries of the rotation too."""
    result = {}
    for item in urdf.closures(geometry):
        difference = poses[item.frame_1] - poses[item.frame_2]
        rows = difference[:3, 3:] if item.kind == "point" else difference
        result[item.name] = float(np.abs(rows).max())
    return result


def tcp(geometry: Geometry, rho: np.ndarray) -> np.ndarray:
    """Where three spheres of radius L about the carriages meet, by Newton from p = 0."""
    p = np.zeros(3)
    for _ in range(20):
        arms = p - np.diag(rho)
        p = p - np.linalg.solve(2 * arms, (arms**2).sum(axis=1) - geometry.L**2)
    return p


def closed_configuration(geometry: Geometry, travel: np.ndarray, model: pin.Model) -> np.ndarray:
    """Joint positions of the assembled machine, leg by leg from where the TCP has to be."""
    p = tcp(geometry, geometry.L + travel)
    q = np.empty(model.nq)
    for leg, n in enumerate(LEGS):
        _, b, c = geometry.legs[leg].axes.argmax(axis=0)
        bars = np.arcsin(p[c] / geometry.L)
        theta = -np.arcsin(p[b] / (geometry.L * np.cos(bars)))
        values = (travel[leg], theta, bars, -bars, -theta, bars)
        for part, value in zip(PARTS, values, strict=True):
            q[model.joints[model.getJointId(f"{n}_{part}")].idx_q] = value
    return q


def test_checked_in_files_are_what_the_generator_writes() -> None:
    remedy = "run `python -m orthoglide.urdf` in the project's folder"
    checked_in = (ROOT / "urdf" / urdf.URDF_FILE).read_bytes().decode()
    assert checked_in == urdf.to_urdf(NOMINAL), remedy
    sidecar = (ROOT / "urdf" / urdf.CLOSURES_FILE).read_bytes().decode()
    assert sidecar == urdf.closures_text(urdf.closures(NOMINAL)), remedy


def test_module_writes_both_files_into_a_folder(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b"
    command = [sys.executable, "-m", "orthoglide.urdf", str(target)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    assert sorted(path.name for path in target.iterdir()) == [urdf.CLOSURES_FILE, urdf.URDF_FILE]
    assert (target / urdf.URDF_FILE).read_bytes().decode() == urdf.to_urdf(NOMINAL)


def test_names_of_joints_links_and_their_axes() -> None:
    robot = ET.fromstring(urdf.to_urdf(NOMINAL))
    moving = {j.get("name"): j for j in robot.iter("joint") if j.get("type") != "fixed"}
    assert set(moving) == {f"{n}_{part}" for n in LEGS for part in PARTS}
    links = {link.get("name") for link in robot.findall("link")}
    bodies = ("carriage", "fork", "bar1", "knuckle", "platform", "bar2", *FRAMES)
    assert links == {"base"} | {f"{n}_{body}" for n in LEGS for body in bodies}
    for name, joint in moving.items():
        part = str(name)[2:]
        slide = part == "slide"
        assert joint.get("type") == ("prismatic" if slide else "revolute")
        axis = {"slide": "1 0 0", "theta": "0 0 1", "platform": "0 0 1"}.get(part, "0 1 0")
        assert joint.find("axis").get("xyz") == axis  # type: ignore[union-attr]


def test_sidecar_says_what_closures_returns() -> None:
    tables = tomllib.loads(urdf.closures_text(urdf.closures(NOMINAL)))["closure"]
    assert tuple(urdf.Closure(**table) for table in tables) == urdf.closures(NOMINAL)
    rows = {"point": 3, "frame": 6}
    assert sum(rows[item.kind] for item in urdf.closures(NOMINAL)) == 21
    names = [item.name for item in urdf.closures(NOMINAL)]
    assert names == [*(f"{n}_parallelogram" for n in LEGS), "platform_xy", "platform_xz"]


@GEOMETRIES
def test_yourdfpy_and_pinocchio_agree_on_every_link(geometry: Geometry, tmp_path: Path) -> None:
    path, _ = urdf.write(tmp_path, geometry)
    robot, model = yourdfpy.URDF.load(str(path)), pin.buildModelFromUrdf(str(path))
    assert robot.validate()
    assert robot.base_link == "base"
    assert model.nq == 18
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
        poses = link_poses(model, q)
        assert set(poses) == set(robot.link_map)
        indices = [model.joints[model.getJointId(n)].idx_q for n in robot.actuated_joint_names]
        robot.update_cfg(q[indices])
        for link, pose in poses.items():
            np.testing.assert_allclose(robot.get_transform(link), pose, rtol=0, atol=1e-12)


@GEOMETRIES
def test_neutral_is_the_closed_machine_at_zero(geometry: Geometry) -> None:
    model = model_of(geometry)
    poses = link_poses(model, pin.neutral(model))
    assert max(gaps(geometry, poses).values()) < 1e-15
    for leg, n in enumerate(LEGS):
        np.testing.assert_allclose(poses[f"{n}_tcp"], np.eye(4), rtol=0, atol=1e-15)
        for part, along in (("carriage", geometry.L + geometry.r), ("platform", geometry.r)):
            pose = poses[f"{n}_{part}"]
            np.testing.assert_allclose(pose[:3, 3], along * np.eye(3)[leg], rtol=0, atol=1e-15)
            np.testing.assert_allclose(
                pose[:3, :3], np.roll(np.eye(3), -leg, axis=1), rtol=0, atol=1e-15
            )


@GEOMETRIES
def test_closes_within_the_limits_over_the_whole_stroke(geometry: Geometry) -> None:
    model = model_of(geometry)
    low, high = geometry.stroke
    corners = np.stack(np.meshgrid(*[[low, high]] * 3), axis=-1).reshape(-1, 3)
    inside = np.random.default_rng(2).uniform(low, high, (100, 3))
    limits = np.stack([model.lowerPositionLimit, model.upperPositionLimit])
    revolute = np.arange(model.nq) % 6 != 0
    for travel in np.vstack([corners, inside]):
        q = closed_configuration(geometry, travel, model)
        poses = link_poses(model, q)
        assert max(gaps(geometry, poses).values()) < 1e-14
        p = tcp(geometry, geometry.L + travel)
        np.testing.assert_allclose(poses["x_tcp"][:3, 3], p, rtol=0, atol=1e-14)
        assert (limits[0] <= q).all()
        assert (q <= limits[1]).all()
        # a margin on the pivots: they never stop what the drives can command
        assert (1.25 * np.abs(q[revolute]) < limits[1][revolute]).all()


TURN = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
EVERY = {
    "delta": DELTA,
    "uneven delta": UNEVEN,
    "free legs of a delta": freely(UNEVEN, turn=TURN),
    "free legs of an Orthoglide": freely(NOMINAL, turn=TURN),
}


# --- The convention of parallel robots ------------------------------------------------------


def constraints_of(robot: urdf.ParallelRobot, model: pin.Model) -> list[pin.RigidConstraintModel]:
    """As loaders of that convention build them."""
    found = []
    for loop in robot.closures:
        first, second = (model.frames[model.getFrameId(n)] for n in (loop.frame_1, loop.frame_2))
        kind = pin.ContactType.CONTACT_3D if loop.rows == 3 else pin.ContactType.CONTACT_6D
        found.append(
            pin.RigidConstraintModel(
                kind, model, first.parentJoint, first.placement, second.parentJoint,
                second.placement, pin.ReferenceFrame.LOCAL,
            )
        )  # fmt: skip
    return found


def exported(geometry: Geometry, folder: Path) -> pin.Model:
    """A machine written in that convention, and its tree as any loader reads it."""
    for name, text in urdf.parallel_robot_files(geometry).items():
        (folder / name).write_text(text)
    return pin.buildModelFromUrdf(str(folder / "robot.urdf"))


def residual_by_hand(
    model: pin.Model, data: pin.Data, constraints: list[pin.RigidConstraintModel], q: np.ndarray
) -> np.ndarray:
    """How far the loops are open, seen from each first frame: places, and twists where axes
    coincide too.
    """
    pin.framesForwardKinematics(model, data, q)
    rows = []
    for constraint in constraints:
        one = data.oMi[constraint.joint1_id] * constraint.joint1_placement
        other = data.oMi[constraint.joint2_id] * constraint.joint2_placement
        between = one.actInv(other)
        point = constraint.type == pin.ContactType.CONTACT_3D
        rows.append(between.translation if point else pin.log6(between).vector)
    return np.concatenate(rows)


@pytest.mark.parametrize("geometry", EVERY.values(), ids=EVERY)
def test_exported_loops_are_open_by_as_much_as_ours(geometry: Geometry, tmp_path: Path) -> None:
    """Far from closure, where a loop cut at another place would show another misfit."""
    model = exported(geometry, tmp_path)
    robot, data = urdf.read_parallel_robot(tmp_path), model.createData()
    constraints, foreign = constraints_of(robot, model), Mechanism.from_urdf(tmp_path)
    own = Constraints(load(geometry))
    assert robot.motors == own.tree.motors == foreign.tree.motors
    draws = np.random.default_rng(4)
    for _ in range(10):
        q = 0.4 * draws.standard_normal(model.nq)
        expected = own.residual(q)
        assert np.abs(expected).max() > 0.05
        assert np.abs(foreign.constraints.residual(q) - expected).max() < 1e-14
        assert np.abs(residual_by_hand(model, data, constraints, q) - expected).max() < 1e-13
        assert np.abs(foreign.constraints.jacobian(q) - own.jacobian(q)).max() < 1e-13


@pytest.mark.parametrize("geometry", EVERY.values(), ids=EVERY)
def test_a_calibrated_machine_loaded_back_closes_where_ours_does(
    geometry: Geometry, tmp_path: Path
) -> None:
    first, second, third = geometry.leg_names
    beside = geometry.layout.names.across[2][0]
    errors = {f"joint_offset.{first}": 3e-4, f"leg_length.{second}": 2e-4,
              f"axis_offset.{third}.{beside}": 5e-4}  # fmt: skip
    machine = Machine(MachineFile(geometry=geometry)).with_parameters(errors)
    for name, text in urdf.parallel_robot_files(geometry, calibrated_urdf(machine)).items():
        (tmp_path / name).write_text(text)
    robot = urdf.read_parallel_robot(tmp_path)
    assert robot.motors == tuple(f"{leg}_slide" for leg in geometry.leg_names)
    model = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"))
    assert sum(loop.rows for loop in robot.closures) == 21
    drives = [model.joints[model.getJointId(name)].idx_q for name in robot.motors]
    passive = np.setdiff1d(np.arange(model.nq), drives)
    constraints, data = constraints_of(robot, model), model.createData()
    for travel in np.random.default_rng(3).uniform(-0.03, 0.05, (3, 3)):
        q = pin.neutral(model)
        q[drives] = travel

        def gap(angles: np.ndarray, q: np.ndarray = q) -> np.ndarray:
            q[passive] = angles
            return residual_by_hand(model, data, constraints, q)

        found = least_squares(gap, q[passive], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.abs(found.fun).max() < 1e-10
        gap(found.x)
        expected = machine.forward(geometry.zero + travel)
        for leg in geometry.leg_names:
            place = data.oMf[model.getFrameId(f"{leg}_tcp")].translation
            assert np.abs(place - expected).max() < 1e-9


def test_other_spellings_of_the_convention_are_read(tmp_path: Path) -> None:
    urdf_text = urdf.to_urdf(NOMINAL)
    (tmp_path / "robot.urdf").write_text(urdf_text)
    (tmp_path / "robot.yaml").write_text(
        "# loops\nname_mot: ['x_slide',\n  'y_slide']\n"
        'closed_loop: [["x_tcp", "y_tcp"]]  # platform\ntype: ["6D"]\n'
    )
    robot = urdf.read_parallel_robot(tmp_path)
    assert robot.closures == (urdf.Closure("loop1", "frame", "x_tcp", "y_tcp"),)
    assert robot.motors == ("x_slide", "y_slide")
