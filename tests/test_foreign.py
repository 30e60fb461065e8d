"""Robots of other makers with loops, written by hand: closed, against closed forms, refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orthoglide.errors import ClosureError, FileError, InputError
from orthoglide.geometry import Array
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.mechanism import Constraints, Posture
from orthoglide.mechanism.tree import Tree, general_tree, load
from orthoglide.reduction.spheres import intersect_spheres
from orthoglide.urdf import CLOSURES_FILE, write

FOREIGN = Path(__file__).parent / "data" / "foreign"
FOUR_BAR, DELTA = FOREIGN / "four_bar", FOREIGN / "rotary_delta"

CRANK, COUPLER, ROCKER = 0.1, np.hypot(0.4, 0.2), 0.3
PIVOT = np.array([0.4, 0.0])


@cache
def robot(folder: Path, tool: str = "") -> Mechanism:
    return Mechanism.from_urdf(folder, tool)


def copied(source: Path, to: Path, *edits: tuple[str, str, str]) -> Path:
    """A copy of a robot's folder with texts replaced: file, old, new."""
    folder = to / "robot"
    shutil.copytree(source, folder)
    for file, old, new in edits:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new))
    return folder


# -- a four-bar ------------------------------------------------------------------------------


def coupler_end(angle: float) -> Array:
    """Where coupler and rocker meet: two circles, the point on the neutral posture's side."""
    crank = CRANK * np.array([-np.sin(angle), np.cos(angle)])  # at zero it stands along y
    span = PIVOT - crank
    length = float(np.hypot(*span))
    along = (length**2 + COUPLER**2 - ROCKER**2) / (2 * length)
    up = np.array([-span[1], span[0]]) / length
    return crank + along * span / length + np.sqrt(COUPLER**2 - along**2) * up


def swept(mechanism: Mechanism, angles: Array) -> list[Posture]:
    """Postures of commands one after the other, each from the one before."""
    postures: list[Posture] = []
    for angle in angles:
        guess = postures[-1] if postures else None
        postures.append(mechanism.close([angle], guess=guess))
    return postures


def test_a_four_bar_is_two_circles_over_a_whole_turn() -> None:
    mechanism, angles = robot(FOUR_BAR), np.linspace(0.0, 2 * np.pi, 91)
    for angle, posture in zip(angles, swept(mechanism, angles), strict=True):
        assert np.abs(posture.p - [*coupler_end(angle), 0.02]).max() < 1e-12
        assert max(posture.residual.values()) < 1e-11


@pytest.mark.parametrize("joint", ["crank_joint", "elbow", "rocker_joint"])
def test_joints_without_limits_are_turned_all_the_same(joint: str, tmp_path: Path) -> None:
    """Pinocchio holds them as cosine and sine."""
    old = f'name="{joint}" type="revolute"'
    folder = copied(FOUR_BAR, tmp_path, ("robot.urdf", old, old.replace("revolute", "continuous")))
    endless, plain = Mechanism.from_urdf(folder), robot(FOUR_BAR)
    assert endless.tree.model.nq == 4
    for one, other in zip(
        swept(endless, np.linspace(0, 6, 61)), swept(plain, np.linspace(0, 6, 61)), strict=True
    ):
        assert np.abs(one.p - other.p).max() < 1e-12
        slopes = [m.velocity_jacobian(k) for m, k in ((endless, one), (plain, other))]
        assert np.abs(slopes[0] - slopes[1]).max() < 1e-10


def test_a_four_bar_has_one_freedom_and_says_so() -> None:
    found = robot(FOUR_BAR).mobility([0.3])
    assert (found.joints, found.rows, found.rank, found.mobility) == (3, 3, 2, 1)
    assert str(found).endswith("mobility 1, 1 redundant rows.")


def test_a_crank_that_does_not_reach_is_a_closure_error(tmp_path: Path) -> None:
    """With a longer crank the linkage no longer turns round."""
    folder = copied(FOUR_BAR, tmp_path, ("robot.urdf", 'xyz="0 0.1 0.02"', 'xyz="0 0.6 0.02"'))
    mechanism = Mechanism.from_urdf(folder)
    with pytest.raises(ClosureError, match=r"misfit is .* at loop1") as caught:
        mechanism.close([1.5])
    assert caught.value.residuals["loop1"] > 0.01


# -- a rotary delta --------------------------------------------------------------------------


def delta_tool(angles: Array) -> Array:
    """Tool of a delta: its middle lies on three spheres about the arms' ends, brought inward."""
    around = 2 * np.pi * np.arange(3) / 3
    out = 0.1 + 0.15 * np.cos(angles) - 0.05
    centres = np.stack([out * np.cos(around), out * np.sin(around), -0.15 * np.sin(angles)], axis=1)
    ends = [
        intersect_spheres(centres[None], np.sqrt(0.13), mode)[0] for mode in ("machine", "other")
    ]
    return min(ends, key=lambda p: p[2]) - [0.0, 0.0, 0.02]


def test_a_rotary_delta_with_ball_joints_is_three_spheres() -> None:
    mechanism = robot(DELTA, "tool")
    kinds = [joint.shortname() for joint in mechanism.tree.model.joints]
    assert kinds.count("JointModelSpherical") == 7
    for angles in np.random.default_rng(0).uniform(-0.4, 0.7, (40, 3)):
        posture = mechanism.close(angles)
        assert np.abs(posture.p - delta_tool(angles)).max() < 1e-11
        assert np.abs(posture.R - np.eye(3)).max() < 1e-10


@pytest.mark.parametrize(
    ("folder", "tool"), [(FOUR_BAR, ""), (DELTA, "tool")], ids=["bars", "delta"]
)
def test_velocity_jacobian_is_a_central_difference(folder: Path, tool: str) -> None:
    mechanism, h = robot(folder, tool), 1e-5
    count = len(mechanism.tree.motors)
    for angles in np.random.default_rng(1).uniform(-0.3, 0.5, (5, count)):
        own = mechanism.velocity_jacobian(mechanism.close(angles))
        numeric = np.stack(
            [(mechanism.close(angles + h * e).p - mechanism.close(angles - h * e).p) / (2 * h)
             for e in np.eye(count)], axis=1,
        )  # fmt: skip
        assert own.shape == (3, count)
        assert np.abs(own - numeric).max() < 1e-8


@pytest.mark.parametrize(
    "tree_of",
    [lambda: robot(FOUR_BAR).tree, lambda: robot(DELTA).tree, load, lambda: general_tree(load())],
    ids=["bars", "delta", "Orthoglide", "with virtual joints"],
)
def test_constraint_jacobian_is_a_central_difference_anywhere(tree_of: Callable[[], Tree]) -> None:
    import pinocchio as pin

    tree, h = tree_of(), 1e-6
    constraints, draws = Constraints(tree), np.random.default_rng(2)
    for _ in range(10):
        step = 0.4 * draws.standard_normal(tree.model.nv)
        q = pin.integrate(tree.model, pin.neutral(tree.model), step)
        numeric = np.stack(
            [(constraints.residual(pin.integrate(tree.model, q, h * e))
              - constraints.residual(pin.integrate(tree.model, q, -h * e))) / (2 * h)
             for e in np.eye(tree.model.nv)], axis=1,
        )  # fmt: skip
        assert np.abs(constraints.residual(q)).max() > 0.01
        assert np.abs(constraints.jacobian(q) - numeric).max() < 1e-8


# -- what cannot be meant --------------------------------------------------------------------

URDF, YAML = "robot.urdf", "robot.yaml"
WRONG = {
    "a motor that is fixed": ((YAML, "['crank_joint']", "['camera_joint']"), URDF, None),
    "a motor that is a link": ((YAML, "['crank_joint']", "['crank']"), URDF, None),
    "a replaced link": ((YAML, "['camera_joint']", "['camera']"), YAML, 4),
    "a replaced joint that is fixed": ((YAML, "['camera_joint']", "['rocker_end_fixed']"), YAML, 4),
    "another kind": ((YAML, "['FIXED']", "['PLANAR']"), YAML, 5),
    "a kind too few": ((YAML, "['FIXED']", "[]"), YAML, 5),
    "an unknown frame": ((YAML, "'rocker_end'", "'rocker_tip'"), YAML, 1),
    "no loop": ((YAML, "[['coupler_end', 'rocker_end']]\ntype: ['3d']", "[]\ntype: []"), YAML, 1),
    "no list": ((YAML, "['crank_joint']", "crank_joint"), YAML, 3),
    "no closures": ((YAML, "closed_loop", "closed_loops"), YAML, None),
    "cut short": ((URDF, "</robot>", ""), URDF, None),
    "a joint to nowhere": ((URDF, '<child link="crank"/>', '<child link="nobody"/>'), URDF, None),
    "no number": ((URDF, 'xyz="0 0.1 0.02"', 'xyz="0 abc 0.02"'), URDF, None),
    "two roots": ((URDF, "</robot>", '<link name="apart"/></robot>'), URDF, None),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "file", "line"), WRONG.values(), ids=WRONG)
def test_files_that_cannot_be_meant_are_named(
    edit: tuple[str, str, str], file: str, line: int | None, tmp_path: Path
) -> None:
    folder = copied(FOUR_BAR, tmp_path, edit)
    with pytest.raises(FileError) as caught:
        Mechanism.from_urdf(folder)
    assert caught.value.file.endswith(file)
    assert caught.value.line == line
    assert re.search(rf"{file}(, line {line})?: ", str(caught.value))
    assert len(caught.value.reason) < 200


@pytest.mark.parametrize(
    ("old", "new", "phrase"),
    [
        ('"x_tcp"', '"x_nose"', "must name two frames of"),
        ('"point"', '"line"', "point"),
        ("[[closure]]", "[[closure]", "must be TOML"),
    ],
)
def test_closures_that_cannot_be_meant_are_refused(
    old: str, new: str, phrase: str, tmp_path: Path
) -> None:
    write(tmp_path)
    path = tmp_path / CLOSURES_FILE
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(FileError, match=phrase) as caught:
        Mechanism.from_urdf(tmp_path)
    assert caught.value.file.endswith(CLOSURES_FILE)


def test_what_only_three_legs_have_is_refused() -> None:
    four_bar = robot(FOUR_BAR)
    with pytest.raises(InputError, match="no virtual joints"):
        four_bar.close([0.1], np.zeros((3, 10)))
    with pytest.raises(InputError, match="modes by name"):
        four_bar.close([0.1], mode="other")
    for wrong in ([0.1, 0.2], [np.nan], 0.1):
        with pytest.raises(InputError, match=r"one command \(1,\)"):
            four_bar.close(wrong)
    with pytest.raises(InputError, match="no frame 'nose'"):
        Mechanism.from_urdf(FOUR_BAR, "nose")
    with pytest.raises(InputError, match="three PRPaR legs"):
        Mechanism(urdf=FOUR_BAR)
