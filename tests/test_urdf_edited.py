"""A copy of the URDF with one length or one joint origin changed: everything follows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import orthoglide as og
from orthoglide.errors import FileError
from orthoglide.explanation.identifying import identify
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.mechanism.engine import PinocchioEngine, SixBars
from orthoglide.mechanism.symbolic import closure_functions
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import protocol
from orthoglide.urdf import CLOSURES_FILE, URDF_FILE, shipped_folder
from tests.engines import NOMINAL, commands, edited, outputs
from tests.rig import _solve, rotation
from tests.test_mechanism import parts

RHO = commands(15, 1)
TRAVEL = RHO - NOMINAL.L
L, d, r = NOMINAL.L, NOMINAL.d, NOMINAL.r


@dataclass(frozen=True)
class Edit:
    """One origin of the URDF, and what it makes of the six bars.

    Attributes:
        joint, xyz, rpy: the joint, and its new origin; "about b" leans a slide by 4 mrad.
        change: of the bars' ends on the carriages and on the platform ``(n, 3, 2, 3)`` by leg and
            bar, and of their lengths ``(n, 3, 2)``; in place.
    """

    joint: str
    xyz: tuple[float, float, float]
    change: Callable[[Array, Array, Array], None]
    rpy: str = ""


LEG = dict(zip("xyz", range(3), strict=True))
AXES = {name: leg.axes for name, leg in zip("xyz", NOMINAL.legs, strict=True)}


def shifted(
    leg: str,
    *,
    root: Array | None = None,
    point: Array | None = None,
    bar: int | slice = slice(None),
) -> Callable[[Array, Array, Array], None]:
    """Ends of a leg's bars moved on the carriage (root) or the platform (point), by leg axes."""

    def change(A: Array, b: Array, length: Array) -> None:
        if root is not None:
            A[:, LEG[leg], bar] += AXES[leg] @ root
        if point is not None:
            b[:, LEG[leg], bar] += AXES[leg] @ point

    return change


def longer(leg: str, bar: int, by: float) -> Callable[[Array, Array, Array], None]:
    def change(A: Array, b: Array, length: Array) -> None:
        length[:, LEG[leg], bar] += by

    return change


def turned(leg: str, vector: Array, *, rail: bool) -> Callable[[Array, Array, Array], None]:
    """The short link turned about the carriage's middle, with the rail or without."""

    def change(A: Array, b: Array, length: Array) -> None:
        k, start = LEG[leg], NOMINAL.legs[LEG[leg]].carriage
        R = rotation(AXES[leg] @ vector)
        middle = start if rail else A[:, k].mean(axis=1, keepdims=True)
        A[:, k] = middle + (A[:, k] - middle) @ R.T

    return change


V = np.array
EDITS = {
    "x slide along its rail": Edit(
        "x_slide", (L + r + 2e-3, 0, 0), shifted("x", root=V([2e-3, 0, 0]))
    ),
    "x slide aside": Edit("x_slide", (L + r, 1e-3, -3e-3), shifted("x", root=V([0, 1e-3, -3e-3]))),
    "z slide leaning": Edit(
        "z_slide", (0, 0, L + r), turned("z", V([0, 4e-3, 0]), rail=True), rpy="about b",
    ),
    "y bar 1 longer": Edit("y_knuckle", (-L - 7e-4, 0, 0), longer("y", 0, 7e-4)),
    "z bar 2 shorter": Edit("z_bar2_tip_fixed", (-L + 5e-4, 0, 0), longer("z", 1, -5e-4)),
    "x knuckle off its bar": Edit(
        "x_knuckle", (-L, 2e-2, 0), longer("x", 0, np.hypot(L, 2e-2) - L),
    ),
    "x short link wider on the carriage": Edit(
        "x_bar1", (0, 0, d / 2 + 8e-4), shifted("x", root=V([0, 0, 8e-4]), bar=0)
    ),
    "y short link wider on the carriage": Edit(
        "y_bar2", (0, 0, -d / 2 - 6e-4), shifted("y", root=V([0, 0, -6e-4]), bar=1)
    ),
    "z short link wider on the platform": Edit(
        "z_knuckle_tip_fixed", (0, 0, -d - 9e-4), shifted("z", point=V([0, 0, -9e-4]), bar=1),
    ),
    "y platform off its link": Edit(
        "y_platform", (0, 0, -d / 2 - 1e-3), shifted("y", point=V([0, 0, 1e-3])),
    ),
    "y joint farther from the tool": Edit(
        "y_tcp_fixed", (-r - 2e-3, 5e-4, 3e-4), shifted("y", point=V([2e-3, -5e-4, -3e-4]))
    ),
    "x pivot turned about the rail": Edit(
        "x_theta", (0, 0, 0), turned("x", V([3e-3, 0, 0]), rail=False),
        rpy="0.003 0 0",
    ),
}  # fmt: skip
EVERY = pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)


def folder_of(edit: Edit, folder: Path) -> Path:
    """A copy of the shipped files with that one origin changed."""
    rpy = edit.rpy
    if rpy == "about b":
        R = AXES[edit.joint[0]] @ rotation(np.array([0, 4e-3, 0]))
        rpy = " ".join(f"{angle:.17g}" for angle in pin.rpy.matrixToRpy(R))
    return edited(folder, edit.joint, " ".join(map(str, edit.xyz)), rpy)


def expected(edit: Edit) -> tuple[Array, Array]:
    """TCP and rotation of the six bars with what the edit makes of them."""
    n = len(RHO)
    A, b, length = parts(RHO, np.zeros((n, 3, len(VIRTUAL_NAMES))))
    A, b, length = A.reshape(n, 3, 2, 3), b.reshape(n, 3, 2, 3), length.reshape(n, 3, 2)
    edit.change(A, b, length)
    return _solve(A.reshape(n, 6, 3), b.reshape(n, 6, 3), length.reshape(n, 6), TRAVEL)


@EVERY
def test_closure_engine_and_programme_follow_the_file(edit: Edit, tmp_path: Path) -> None:
    machine, (p, R) = Machine.from_urdf(folder_of(edit, tmp_path)), expected(edit)
    assert np.abs(p - outputs(RHO).p).max() > 1e-6
    pose = machine.pose(RHO)
    assert np.abs(pose.p - p).max() < 1e-12
    assert np.abs(pose.R - R).max() < 1e-11
    assert np.abs(machine.by_pinocchio().forward(RHO) - p).max() < 1e-12
    assert isinstance(machine.model.engine, SixBars)
    assert isinstance(machine.by_pinocchio().model.engine, PinocchioEngine)
    tree = machine.model.mechanism.tree
    functions = closure_functions(tree)
    for command, place in zip(RHO[:5], p, strict=False):
        posture = machine.close(command)
        assert np.abs(posture.p - place).max() < 1e-12
        known = np.concatenate([command - NOMINAL.L, np.zeros(30)])
        assert np.abs(functions.residual(posture.q[tree.free], known).full()).max() < 1e-12
        shown = functions.outputs(posture.q[tree.free], known).full()[:3, 0]
        assert np.abs(shown - place).max() < 1e-12
    assert np.abs(machine.inverse(p) - RHO).max() < 1e-12


@pytest.mark.parametrize(
    ("name", "method"),
    [("x slide along its rail", "nlp"), ("y bar 1 longer", "nested"),
     ("y joint farther from the tool", "pinocchio")],
)  # fmt: skip
def test_identification_and_its_verification_follow_the_file(
    name: str, method: str, tmp_path: Path
) -> None:
    machine = Machine.from_urdf(folder_of(EDITS[name], tmp_path))
    sheet = protocol("standard")
    readings = sheet.with_readings(machine.readings(sheet))
    found = identify(readings, machine, method=method, noise=1e-6)
    assert max(abs(value) for value in found.values.values()) < 1e-9
    assert found.verification is not None
    assert found.verification.tcp < 1e-12
    assert found.verification.sensitivity < 1e-10
    assert found.verification.postures > 0
    nominal = identify(readings, Machine.nominal(), method="nested", noise=1e-6)
    assert max(abs(value) for value in nominal.values.values()) > 1e-5


@pytest.mark.parametrize("beside", [True, False], ids=["beside the machine file", "elsewhere"])
def test_a_machine_file_names_the_folder(beside: bool, tmp_path: Path) -> None:
    edit = EDITS["y bar 1 longer"]
    folder = folder_of(edit, tmp_path / "machine" / "model")
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


def test_a_machine_file_whose_folder_is_missing_says_so(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    Machine.nominal().save(path)
    path.write_text(path.read_text().replace("schema = 1\n", 'schema = 1\nurdf = "gone"\n'))
    with pytest.raises(FileError, match="no such file"):
        Machine.load(path).forward(RHO)


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
