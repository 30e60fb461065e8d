"""The URDF: not stale, read alike by two loaders, closed over the stroke; a changed copy counts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import orthoglide as og
from orthoglide import urdf
from orthoglide.control.urdf import calibrated_urdf
from orthoglide.geometry import LEGS, Geometry
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.engine import PinocchioEngine, SixBars
from orthoglide.mechanism.mechanism import Constraints
from orthoglide.mechanism.symbolic import closure_functions
from orthoglide.mechanism.tree import load
from orthoglide.urdf import CLOSURES_FILE, URDF_FILE, shipped_folder
from tests.engines import NOMINAL, OTHER, commands, edited, outputs
from tests.rig import rotation
from tests.test_layout import DELTA, UNEVEN, freely

ROOT = Path(__file__).parents[1]
GEOMETRIES = pytest.mark.parametrize("geometry", [NOMINAL, OTHER], ids=["nominal", "other"])
PARTS = ("slide", "theta", "bar1", "knuckle", "platform", "bar2")


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


# -- a copy with one origin changed ----------------------------------------------------------------


RHO = commands(15, 1)
L, d, r = NOMINAL.L, NOMINAL.d, NOMINAL.r
LONGER = np.hypot(L, 2e-2) - L
_TURN = NOMINAL.legs[2].axes @ rotation(np.array([0, 4e-3, 0]))
LEANING = " ".join(f"{angle:.17g}" for angle in pin.rpy.matrixToRpy(_TURN))
Errors = dict[str, float]
# A joint, its new origin and turn, and the errors that are the same machine where there are such.
EDITS: dict[str, tuple[str, tuple[float, float, float], str, Errors]] = {
    "x slide along its rail": ("x_slide", (L + r + 2e-3, 0, 0), "", {"joint_offset.x": 2e-3}),
    "x slide aside": ("x_slide", (L + r, 1e-3, -3e-3), "",
                      {"axis_offset.x.y": 1e-3, "axis_offset.x.z": -3e-3}),
    "z slide leaning": ("z_slide", (0, 0, L + r), LEANING, {}),
    "y bar 1 longer": ("y_knuckle", (-L - 7e-4, 0, 0), "",
                       {"leg_length.y": 3.5e-4, "bar_mismatch.y": 7e-4}),
    "z bar 2 shorter": ("z_bar2_tip_fixed", (-L + 5e-4, 0, 0), "",
                        {"leg_length.z": -2.5e-4, "bar_mismatch.z": 5e-4}),
    "x knuckle off its bar": ("x_knuckle", (-L, 2e-2, 0), "",
                              {"leg_length.x": LONGER / 2, "bar_mismatch.x": LONGER}),
    "x short link wider on the carriage": ("x_bar1", (0, 0, d / 2 + 8e-4), "", {}),
    "z short link wider on the platform": ("z_knuckle_tip_fixed", (0, 0, -d - 9e-4), "", {}),
    "y platform off its link": ("y_platform", (0, 0, -d / 2 - 1e-3), "",
                                {"axis_offset.y.x": -1e-3}),
    "y joint farther from the tool": (
        "y_tcp_fixed", (-r - 2e-3, 5e-4, 3e-4), "",
        {"joint_offset.y": -2e-3, "axis_offset.y.z": 5e-4, "axis_offset.y.x": 3e-4}),
    "x pivot turned about the rail": ("x_theta", (0, 0, 0), "0.003 0 0", {"mount_tilt.x.a": 3e-3}),
}  # fmt: skip


def folder_of(kind: str, folder: Path) -> Path:
    """A copy of the shipped files with that one origin changed."""
    joint, xyz, rpy, _ = EDITS[kind]
    return edited(folder, joint, " ".join(map(str, xyz)), rpy)


@pytest.mark.parametrize("kind", EDITS)
def test_closure_engine_and_programme_follow_the_file(kind: str, tmp_path: Path) -> None:
    machine = Machine.from_urdf(folder_of(kind, tmp_path))
    pose, judged = machine.pose(RHO), machine.by_pinocchio().pose(RHO)
    assert np.abs(pose.p - outputs(RHO).p).max() > 1e-6
    assert np.abs(judged.p - pose.p).max() < 1e-12
    assert np.abs(judged.R - pose.R).max() < 1e-11
    if errors := EDITS[kind][-1]:
        same = Machine.nominal().with_parameters(errors).pose(RHO)
        assert np.abs(same.p - pose.p).max() < 1e-11
        assert np.abs(same.R - pose.R).max() < 1e-11
    assert isinstance(machine.model.engine, SixBars)
    assert isinstance(machine.by_pinocchio().model.engine, PinocchioEngine)
    tree = machine.model.mechanism.tree
    residual, by_programme = closure_functions(tree)
    for command, place in zip(RHO[:5], pose.p, strict=False):
        posture = machine.close(command)
        assert np.abs(posture.p - place).max() < 1e-12
        known = np.concatenate([command - NOMINAL.L, np.zeros(30)])
        assert np.abs(residual(posture.q[tree.free], known).full()).max() < 1e-12
        shown = by_programme(posture.q[tree.free], known).full()[:3, 0]
        assert np.abs(shown - place).max() < 1e-12
    assert np.abs(machine.inverse(pose.p) - RHO).max() < 1e-12


@pytest.mark.parametrize("beside", [True, False], ids=["beside the machine file", "elsewhere"])
def test_a_machine_file_names_the_folder(beside: bool, tmp_path: Path) -> None:
    folder = folder_of("y bar 1 longer", tmp_path / "machine" / "model")
    path = tmp_path / "machine" / "machine.toml"
    machine = Machine.from_urdf(folder).with_parameters({"joint_offset.x": 3e-4})
    machine.save(path)
    text = path.read_text()
    assert "urdf = " in text
    if beside:
        lines = ['urdf = "model"' if line.startswith("urdf") else line for line in text.split("\n")]
        path.write_text("\n".join(lines))
    again = Machine.load(path)
    assert np.array_equal(again.forward(RHO), machine.forward(RHO))
    again.save(tmp_path / "copy.toml")
    assert np.array_equal(Machine.load(tmp_path / "copy.toml").forward(RHO), machine.forward(RHO))


# -- what was accepted and is wrong ----------------------------------------------------------


def shipped(folder: Path, closures: Callable[[str], str] = str) -> Path:
    """A copy of the shipped files, its closures edited."""
    folder.mkdir(exist_ok=True)
    for name in (URDF_FILE, CLOSURES_FILE):
        text = (shipped_folder() / name).read_text(encoding="utf-8")
        edited_text = closures(text) if name == CLOSURES_FILE else text
        (folder / name).write_text(edited_text, encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    "closures",
    [
        lambda text: text[: text.rindex("[[closure]]")],
        lambda text: text.replace('kind = "frame"', 'kind = "point"'),
        lambda text: text.replace('frame_2 = "x_knuckle_tip"', 'frame_2 = "x_knuckle"'),
    ],
    ids=["one is missing", "axes are not tied", "another link"],
)
def test_closures_of_another_machine_are_refused(
    closures: Callable[[str], str], tmp_path: Path
) -> None:
    """Pinocchio closes them as they are, and six bars would be another machine."""
    with pytest.raises(og.InputError, match=r"do not make it a platform|does not close near"):
        og.Machine.from_urdf(shipped(tmp_path / "urdf", closures))


def test_what_is_exported_has_the_joints_of_ones_own_urdf(tmp_path: Path) -> None:
    folder = shipped(tmp_path / "urdf")
    file = folder / URDF_FILE
    moved = file.read_text(encoding="utf-8").replace('"0.34125 0 0"', '"0.34225 0.0005 0"')
    file.write_text(moved, encoding="utf-8")
    machine = og.Machine.from_urdf(folder)
    rho = [0.30, 0.31, 0.32]
    assert np.abs(machine.forward(rho) - og.Machine.nominal().forward(rho)).max() > 5e-4
    out = tmp_path / "out"
    out.mkdir()
    for name, text in og.export_files(machine).items():
        (out / name).write_text(text, encoding="utf-8")
    assert np.abs(og.Machine.from_urdf(out).forward(rho) - machine.forward(rho)).max() < 1e-14


def test_bars_in_millimetres_are_refused(tmp_path: Path) -> None:
    folder = shipped(tmp_path / "urdf")
    file = folder / URDF_FILE
    text = file.read_text(encoding="utf-8").replace("-0.31025 0 0", "-310.25 0 0")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(og.InputError, match=r"bars of 310\.2 and 310\.2 m: give their lengths in"):
        og.Machine.from_urdf(folder)
