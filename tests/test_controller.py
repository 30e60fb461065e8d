"""Compensation and exports, judged by machines of their own: ``rig.py`` and Pinocchio."""

import csv
import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from orthoglide import Machine, UnreachableError
from orthoglide.accuracy import tcp_slopes, workspace_commands
from orthoglide.control import (
    RULE,
    calibrated_urdf,
    commands_text,
    compensate,
    constant_geometry,
    controller_numbers,
    export_files,
    read_path,
)
from orthoglide.effects import CATALOGUE
from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Geometry
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import Controller, Posterior
from orthoglide.prediction import Conditions
from orthoglide.urdf import read_looped_urdf
from tests.rig import Array, Rig
from tests.test_cli import done, run

PITCH = 0.02
L = Geometry().L
ONES = np.ones((3, 3))


def machine(values: dict[str, float], **changes: object) -> Machine:
    spec = replace(Machine.nominal().spec, screw_pitch=PITCH, **changes)  # type: ignore[arg-type]
    return Machine(spec).with_parameters(values)


def circle(points: int = 40) -> Array:
    angle = np.linspace(0, 2 * np.pi, points)
    return np.stack([0.04 * np.cos(angle), 0.035 * np.sin(angle), 0.02 * np.sin(angle)], 1)


@cache
def everything() -> dict[str, float]:
    """An error of every kind, each a share of its tolerance; lost motion is positive."""
    rng, plain = np.random.default_rng(5), Machine.nominal()
    drawn = {
        n: 0.7 * plain.tolerance(n) * float(rng.standard_normal()) for n in CATALOGUE.parameters
    }
    return {n: abs(v) if n.startswith("backlash") else v for n, v in drawn.items()}


def misses(p: Array, goal: Array) -> Array:
    return np.linalg.norm(p - goal, axis=1)


def directions(rho: Array) -> Array:
    """Direction of each axis' last move, + for the first."""
    way = np.ones_like(rho)
    for k in range(1, len(rho)):
        step = rho[k] - rho[k - 1]
        way[k] = np.where(np.abs(step) > 1e-6, np.sign(step), way[k - 1])
    return way


# -- compensation -------------------------------------------------------------------------------


def test_compensated_commands_bring_the_independent_machine_to_the_points() -> None:
    goal, rig = circle(), Rig(errors=everything(), screw_pitch=PITCH)
    plain = compensate(Machine.nominal(), goal)
    plan = compensate(machine(everything()), goal)
    before = misses(rig.pose(plain.rho, directions(plain.rho)).p, goal)
    after = misses(rig.pose(plan.rho, directions(plan.rho)).p, goal)
    assert before.min() > 0.5e-3
    assert after.max() < 5e-9  # the commands are rounded to a nanometre
    assert np.array_equal(plan.approach, directions(plan.rho))
    assert plan.error_before == pytest.approx(before, abs=5e-9)


@pytest.mark.parametrize("step", [2e-3, 2e-5])
def test_a_drive_that_creeps_turns_all_the_same(step: float) -> None:
    """Across the middle of a line in x, where the other drives turn, in steps however fine."""
    lost, half = {"backlash.z": 1.2e-4}, min(0.03, 4000 * step)
    count = round(2 * half / step) + 1
    line = np.linspace([-half, 0.0, 0.01], [half, 0.0, 0.01], count)
    plan = compensate(machine(lost), line)
    # Which way each drive moved last, if by a tenth of a nanometre.
    way = np.ones(3)
    for k in range(count):
        moved = plan.rho[k] - plan.rho[max(k - 1, 0)]
        way = np.where(np.abs(moved) > 1e-8, np.sign(moved), way)
        assert way[2] == plan.approach[k, 2] or abs(moved[2]) < 1e-8
    assert misses(Rig(errors=lost).pose(plan.rho, plan.approach).p, line).max() < 1e-8
    assert {-1.0, 1.0} == set(plan.approach[:, 2])


@pytest.mark.parametrize(
    ("point", "leg", "words"),
    [
        ((0.0, 0.25, 0.25), "x", "too short"),
        ((0.065, 0.0, 0.0), "x", "beyond its stroke"),
        ((0.0, 0.0, 0.3), "x", "beyond its stroke"),
        ((0.0, -0.12, 0.0), "y", "beyond its stroke"),
        ((0.12, 0.12, 0.12), "", "row 3 of the path"),
    ],
)
def test_points_out_of_reach_name_their_row(
    point: tuple[float, float, float], leg: str, words: str
) -> None:
    path = np.zeros((4, 3))
    path[2] = point
    with pytest.raises(UnreachableError, match=words) as caught:
        compensate(machine(everything()), path)
    assert caught.value.index == (2,)
    assert "row 3" in str(caught.value)
    assert caught.value.leg == leg or not leg


# -- expected accuracy --------------------------------------------------------------------------


def tcp_sigma(machine: Machine, rho: np.ndarray, **conditions: float) -> np.ndarray:
    """Standard deviation of the TCP along each axis ``(n, 3)``, where the machine sits in it."""
    known = machine.posterior
    slopes = tcp_slopes(machine, known.names, Conditions.from_commands(rho, **conditions))  # type: ignore[arg-type]
    variance = np.einsum("...p,pq,...q->...", slopes, known.covariance, slopes)
    return np.sqrt(np.maximum(variance, 0.0))


def test_sigmas_are_those_of_finite_differences() -> None:
    sigmas = {"joint_offset.x": 2e-5, "axis_tilt.y.z": 3e-4, "backlash.z": 1e-5}
    values = {name: 3 * sigma for name, sigma in sigmas.items()}
    seen = machine({}).with_parameters(values, sigmas)
    rho, approach = L + np.array([[0.01, -0.05, 0.03], [-0.08, 0.02, 0.05]]), -1.0
    variance = np.zeros((2, 3))
    for name, sigma in sigmas.items():
        ends = [
            seen.with_parameters({name: values[name] + way * sigma}).forward(rho, approach=approach)
            for way in (1, -1)
        ]
        variance += ((ends[0] - ends[1]) / 2) ** 2
    assert tcp_sigma(seen, rho, approach=approach) == pytest.approx(np.sqrt(variance), rel=1e-4)
    # Known values have no sigma.
    assert tcp_sigma(machine(values), rho).max() == 0


def test_a_covariance_replaces_independence() -> None:
    """An offset with the two carriages' shifts the same way is a translation of the machine."""
    names = ["joint_offset.y", "axis_offset.x.y", "axis_offset.z.y"]
    seen = machine({}).with_parameters(dict.fromkeys(names, 0.0), dict.fromkeys(names, 1e-4))
    rho = L + np.random.default_rng(0).uniform(-0.08, 0.05, (5, 3))
    known = seen.with_posterior(seen.values, Posterior(tuple(names), np.zeros(3), ONES * 1e-8))
    together = tcp_sigma(known, rho)
    assert together == pytest.approx(np.tile([0, 1e-4, 0], (5, 1)), abs=1e-12)
    assert np.all(tcp_sigma(seen, rho)[:, [0, 2]] > 1e-7)
    plan = compensate(known, circle(4))
    assert plan.accuracy == pytest.approx(np.full(4, 1e-4), rel=1e-3)
    assert plan.place == pytest.approx(1e-4, rel=1e-6)
    assert plan.shape.max() < 5e-9
    assert "covariance" in str(plan)
    assert "independent" in str(compensate(seen, circle(4)))
    with pytest.raises(InputError, match="rows and columns"):
        Posterior(tuple(names), np.zeros(3), np.eye(2))
    with pytest.raises(InputError, match="must be of single parameters"):
        seen.with_posterior({}, Posterior(("axis_tilt.common",), np.zeros(1), np.eye(1)))


# -- numbers for a controller -------------------------------------------------------------------

DRIVES = {
    "joint_offset.x": 1.2e-3, "joint_offset.y": -0.6e-3, "encoder_scale.x": 2e-4,
    "encoder_scale.z": -1e-4, "backlash.x": 5e-5, "backlash.z": 3e-5,
}  # fmt: skip
COUNTING = Controller(zero=(0.5, -0.02, 0.1), sign=(-1, 1, -1))


@pytest.mark.parametrize("way", [1, -1])
def test_the_rules_as_they_are_written_put_the_drives_right(way: int) -> None:
    """By the exported numbers alone: zero, scale factor, backlash on both sides or on one."""
    exported = controller_numbers(machine(DRIVES, controller=COUNTING)).as_dict()["drives"]
    wanted = np.array([0.03, -0.05, 0.02])
    goal = Rig().pose(L + wanted).p[0]
    both, one = [], []
    for leg, s in zip(LEGS, wanted, strict=True):
        n = exported[leg]
        half = way * n["backlash_mm"] / 2
        whole = -n["backlash_mm"] if way < 0 else 0.0
        # Commanded in a corrected counting, then what an uncorrected controller would call it.
        for shift, zero, found in (
            (half, n["new_zero_mm"], both), (whole, n["new_zero_one_sided_mm"], one),
        ):  # fmt: skip
            corrected = zero + n["sign"] * (s * 1e3 + shift)
            raw = n["old_zero_mm"] + (corrected - n["old_zero_mm"]) * n["scale_factor"]
            found.append(raw * 1e-3)
    for shown in (both, one):
        p = Rig(errors=DRIVES).pose(COUNTING.to_rho(shown, Geometry()), float(way)).p[0]
        assert np.abs(p - goal).max() < 1e-9


def number(printed: str) -> float:
    """A number of a sentence, which has a true minus sign."""
    return float(printed.replace("−", "-"))


def test_the_sign_rule_is_worked_out_in_words() -> None:
    text = controller_numbers(machine(DRIVES, controller=COUNTING)).text()
    said = " ".join(text.split())
    (worked,) = re.findall(r"new zero = (\S+) − \((\S+)\) × \((\S+)\) = (\S+) mm", said)
    zero, sign, offset, result = map(number, worked)
    assert (zero, sign, offset) == (500.0, -1.0, 1.2)
    assert result == zero - sign * offset == 501.2
    assert "too far out" in said
    assert "toward the origin" in said
    table = [line.split() for line in text.splitlines() if re.match(r" +[xyz] ", line)][:2]
    assert table == [["x", "500.000", "501.200"], ["y", "-20.000", "-19.400"]]
    assert "Axis z: the zero stays as it is." in said
    nominal = controller_numbers(Machine.nominal()).text()
    assert "Axis x, y and z: the zero stays as it is." in nominal
    assert "old zero" not in nominal
    assert "correct all of it" in text
    more = controller_numbers(machine({**DRIVES, "axis_tilt.y.z": 1e-3}))
    assert more.left_over == ("axis_tilt.y.z",)
    assert "no other error that was identified (axis tilt)" in more.text()


def test_a_controller_that_takes_zeros_alone_reads_of_nothing_else(tmp_path: Path) -> None:
    errors = {**DRIVES, "axis_tilt.y.z": 1e-3}
    whole, alone = (controller_numbers(machine(errors), zeros_only=z) for z in (False, True))
    for word in ("Scale", "backlash", "one-sided", "bar length"):
        assert word in whole.text()
        assert word not in alone.text().partition("no other error")[0]
    assert set(alone.as_dict()["drives"]["x"]) == {
        "sign", "offset_mm", "old_zero_mm", "new_zero_mm", "add_to_command_mm",
    }  # fmt: skip
    machine(errors).save(tmp_path / "m.toml")
    out = tmp_path / "zeros"
    done("export", "--machine", tmp_path / "m.toml", "--zeros-only", "--out", out)
    assert {p.name for p in out.iterdir()} == {"controller.txt", "controller.json"}


def proved(exported: dict[str, Any], counting: Controller, rig: Rig) -> None:
    """What each check says is what the independent machine reads."""
    old, sign = np.array(counting.zero), np.array(counting.sign)
    new = np.array([exported["drives"][k]["new_zero_mm"] for k in LEGS]) * 1e-3
    for drive, check in exported["checks"].items():
        entered = {"expected_mm": new, "expected_if_wrong_mm": new.copy()}
        k = LEGS.index(drive)
        entered["expected_if_wrong_mm"][k] = 2 * old[k] - new[k]  # the other side of the old zero
        travel = {"zero": 0.0, "max": 0.06, "min": -0.1}[check["posture"]]
        wanted = [Geometry().zero, Geometry().command_on_axis(LEGS.index(check["leg"]), travel)]
        for key, zero in entered.items():
            shown = zero + sign * (np.array(wanted) - L)
            if key == "expected_mm":  # the right zeros are those that the check speaks of
                assert shown[0] * 1e3 == pytest.approx(check["shown_at_zero_mm"], abs=1e-6)
                assert shown[1] * 1e3 == pytest.approx(check["shown_at_posture_mm"], abs=1e-6)
            lines = rig.pose(counting.to_rho(shown, Geometry()), np.ones((2, 3))).lines
            leg, gauge = [LEGS.index(check["leg"])] * 2, np.full(2, check["gauge_mm"] * 1e-3)
            first, then = rig.readings(
                lines, leg, [check["direction"]] * 2, gauge, [0, 0], ["s"] * 2, np.zeros(2)
            )
            assert (then - first) * 1e3 == pytest.approx(check[key], abs=1e-5)
        assert abs(check["expected_mm"] - check["expected_if_wrong_mm"]) > 0.2


@pytest.mark.parametrize("sign", [(-1, 1, -1)])
def test_the_check_tells_a_zero_entered_the_wrong_way(sign: tuple[int, int, int]) -> None:
    """What each check says is read on the independent machine, zeros entered right and wrong."""
    offsets = np.array([1.2e-3, -0.6e-3, 0.9e-3])
    errors = {**dict(zip((f"joint_offset.{k}" for k in LEGS), offsets, strict=True)),
              "axis_tilt.y.z": 1e-3}  # fmt: skip
    old = np.array([0.5, -0.02, 0.1])
    counting = Controller(zero=tuple(old), sign=sign)  # type: ignore[arg-type]
    numbers = controller_numbers(machine(errors, controller=counting))
    exported = numbers.as_dict()
    new = np.array([exported["drives"][k]["new_zero_mm"] for k in LEGS]) * 1e-3
    fitted = np.array([drive.offset for drive in numbers.drives])
    assert fitted == pytest.approx(offsets, abs=1e-5)  # the tilt takes a little of them
    assert new == pytest.approx(old - np.array(sign) * fitted, abs=1e-9)
    proved(exported, counting, Rig(errors=errors))
    assert list(exported["checks"]) == ["x", "y", "z"]
    for said in numbers.check[1]:
        check = exported["checks"][said.split()[1][0]]
        zero, then = (np.array(check[f"shown_at_{where}_mm"]) for where in ("zero", "posture"))
        assert zero == pytest.approx(new * 1e3, abs=1e-6)
        moves = re.search(r"move x, y, z by (\S+), (\S+), (\S+) mm", said)
        assert moves
        assert [*map(number, moves.groups())] == pytest.approx(then - zero, abs=6e-4)
        read = re.search(r"Expect (\S+) mm; (\S+) mm says that the zero", said)
        assert read
        expected = [check["expected_mm"], check["expected_if_wrong_mm"]]
        assert [*map(number, read.groups())] == pytest.approx(expected, abs=6e-4)
    assert exported["rule"].startswith("new zero = old zero − sign × offset: what the controller")
    assert "come to both" not in numbers.text()
    lost = controller_numbers(machine({**errors, "backlash.z": 1e-4}, controller=counting))
    arriving = "come to both with all axes moving away from the origin. Expect"
    assert arriving in " ".join(lost.text().split())
    proved(lost.as_dict(), counting, Rig(errors={**errors, "backlash.z": 1e-4}))
    offsets_alone = {name: value for name, value in errors.items() if name != "axis_tilt.y.z"}
    plain = controller_numbers(machine(offsets_alone, controller=counting))
    assert RULE in " ".join(plain.text().split())
    assert [drive.offset for drive in plain.drives] == pytest.approx(offsets, abs=1e-9)


def test_zeros_alone_are_fitted_to_the_whole_machine() -> None:
    values = {"joint_offset.x": 1e-3, "axis_offset.z.x": 4e-4, "encoder_scale.y": 3e-4}
    whole, rig = machine(values), Rig(errors=values)
    numbers = controller_numbers(whole, zeros_only=True)
    wanted = workspace_commands(whole)
    goal, middle = Rig().pose(wanted, np.zeros_like(wanted)).p, np.zeros_like(wanted)

    def shape(offsets: Array) -> float:
        apart = rig.pose(wanted - offsets, middle).p - goal
        return float(np.sqrt(np.mean(np.sum((apart - apart.mean(axis=0)) ** 2, axis=1))))

    best = np.array([d.offset for d in numbers.drives])
    identified = np.array([1e-3, 0.0, 0.0])
    assert shape(best) < 0.9 * shape(identified)
    for axis in range(3):
        for by in (-2e-5, 2e-5):
            assert shape(best + by * np.eye(3)[axis]) > shape(best)
    assert numbers.zeros_only == pytest.approx(-best)
    # They are what is entered, and no drive's joint offset.
    first = " ".join(numbers.text().split())
    assert "Axis x: at the old zero 0.000 carriage x stands on average" in first
    assert f"{best[0] * 1e3:.3f} mm too far out" in first
    assert "joint" not in first
    assert [d.scale for d in numbers.drives] == [0, 0, 0]
    assert set(numbers.left_over) == {"axis_offset.z.x", "encoder_scale.y"}
    both = controller_numbers(whole)
    assert both.zeros_only == pytest.approx(-best)
    # The whole table, entered on the independent machine, is no worse than these zeros.
    scale = np.array([d.scale_factor for d in both.drives])
    shift = np.array([d.offset for d in both.drives])
    entered = L + (wanted - L - shift) * scale
    apart = rig.pose(entered, middle).p - goal
    left = apart - apart.mean(axis=0)
    assert np.sqrt(np.mean(np.sum(left**2, axis=1))) < shape(best)
    assert np.linalg.norm(left, axis=1).mean() == pytest.approx(
        both.expected["numbers"].shape, rel=1e-3
    )
    expected = both.expected
    assert expected["compensated"].shape < 1e-9 < expected["zeros"].shape < expected["now"].shape


@pytest.mark.parametrize(
    "kept", [{"verdict": "partial"}, {"verdict": "explained", "cautions": ["do not act on it"]}]
)
def test_numbers_not_to_be_acted_on_are_withheld(kept: dict[str, object], tmp_path: Path) -> None:
    plain = machine({"joint_offset.x": 1e-3})
    doubtful = plain.with_provenance(kept)
    asked: tuple[Callable[..., object], ...] = (
        controller_numbers, export_files, lambda m, **o: compensate(m, circle(3), **o),
    )  # fmt: skip
    for ask in asked:
        with pytest.raises(InputError, match=r"withheld: .*--force, force=True"):
            ask(doubtful)
        assert ask(doubtful, force=True)
        assert ask(plain.with_provenance({"verdict": "ambiguous"}))
    doubtful.save(tmp_path / "m.toml")
    path = write_path(tmp_path / "path.csv", circle(3))
    common = ("--machine", tmp_path / "m.toml", "--out")
    for first, out in ((("export",), "a"), (("compensate", path), "b.csv")):
        refused = run(*first, *common, tmp_path / out)
        assert refused.exit_code == 2
        assert "withheld" in refused.stderr
        assert not (tmp_path / out).exists()
        done(*first, *common, tmp_path / out, "--force")


# -- URDF ---------------------------------------------------------------------------------------


def test_the_comment_says_what_is_left_out() -> None:
    named = replace(machine({"backlash.x": 1e-5, "bar_mismatch.y": 1e-5}).spec, name="A--b")
    text = calibrated_urdf(Machine(named))
    comment = text.partition("<!--")[2].partition("-->")[0]
    assert re.search(r"Left out, [^.]*: backlash\.x\.", comment)
    assert re.search(r"cannot take up bar_mismatch\.y:", comment)
    assert "Holds bar_mismatch.y." in comment
    ET.fromstring(text)
    assert pin.buildModelFromXML(text).nq == 18


COMMANDS_RHO = L + np.random.default_rng(7).uniform(-0.08, 0.05, (6, 3))


def test_an_exported_urdf_has_all_constant_geometry_and_is_not_given_it_twice(
    tmp_path: Path,
) -> None:
    """With the calibrated machine every error counted twice, without a word."""
    values = constant_geometry(machine(everything()))
    assert len(values) > 30
    calibrated = machine(values)
    for name, text in export_files(calibrated).items():
        (tmp_path / name).write_text(text)
    exported = Machine.from_urdf(tmp_path)
    # A drive of the file moves along the path of its carriage, which is longer than its travel.
    lateral = [
        [
            sum(values[f"{f}.{leg}.{j}"] for f in ("axis_tilt", "rail_tilt"))
            for j in LEGS
            if j != leg
        ]
        for leg in LEGS
    ]
    along = L + (COMMANDS_RHO - L) * np.sqrt(1 + np.sum(np.square(lateral), axis=1))
    expected = calibrated.forward(COMMANDS_RHO)
    assert np.abs(exported.forward(along) - expected).max() < 1e-9
    assert np.abs(exported.by_pinocchio().forward(along) - expected).max() < 1e-9
    with pytest.raises(InputError, match="count twice: give it with the nominal machine"):
        Machine.from_urdf(tmp_path, calibrated)
    # What is found later, of the machine that the URDF describes, is added.
    later = Machine.from_urdf(tmp_path, machine({"joint_offset.x": 1e-4}))
    assert later.forward(along)[0, 0] - expected[0, 0] == pytest.approx(1e-4, rel=0.1)


# -- files and commands -------------------------------------------------------------------------


def write_path(path: Path, points: Array) -> Path:
    lines = ["p_x_mm,p_y_mm,p_z_mm", *(",".join(f"{x * 1e3:.4f}" for x in p) for p in points)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_path_in_metres_is_doubted(tmp_path: Path) -> None:
    circle_mm = circle(8) * 1e3
    for scale, told in ((1.0, 0), (1e-3, 1)):
        path = write_path(tmp_path / f"path{told}.csv", circle_mm * scale * 1e-3)
        assert sum("are they metres?" in str(note) for note in read_path(path).warnings) == told


def test_a_path_that_was_read_is_one_to_compensate(tmp_path: Path) -> None:
    """``og.compensate`` refused what ``og.read_path`` had returned."""
    machine = Machine.nominal().with_parameters({"joint_offset.x": 1e-3})
    path = read_path(write_path(tmp_path / "path.csv", circle(4)))
    found = compensate(machine, path)
    assert np.array_equal(found.rho, compensate(machine, path.p).rho)
    assert np.array_equal(machine.inverse(path), machine.inverse(path.p))
    assert len(path) == 4
    assert repr(path) == f"<PathPoints of {tmp_path / 'path.csv'}: 4 points>"


def test_a_delta_is_called_what_it_is(tmp_path: Path) -> None:
    """In what Python shows, in the names of files, and in the table of its zeros."""
    geometry = Geometry(
        0.27, 0.05, 0.032, (-0.05, 0.4), LinearDelta((0.14,) * 3, tool=(0, 0, -0.04))
    )
    bare = Machine(replace(Machine.nominal().spec, geometry=geometry))
    assert repr(bare) == "<Machine 'Linear delta, arms of 270 mm': no errors>"
    found = bare.with_parameters({"joint_offset.a": 1e-3, "leg_length.b": 1e-4})
    files = export_files(found)
    assert {name for name in files if not name.startswith(("controller", "robot"))} == {
        "linear-delta.urdf", "linear-delta.closures.toml", "linear-delta.xml",
    }  # fmt: skip
    text = files["controller.txt"]
    assert "tower    old zero" in text
    assert "rod length" in text
    assert not re.search(r"\b(axis|bars?|legs?|dials?)\b", text)
    for name in ("linear-delta.urdf", "linear-delta.closures.toml"):
        (tmp_path / name).write_text(files[name])
    robot = read_looped_urdf(tmp_path)
    assert [loop.name for loop in robot.closures][:2] == ["a_parallelogram", "b_parallelogram"]


def test_a_file_without_a_calibration_promises_nothing() -> None:
    found = compensate(Machine.nominal(), circle(4))
    assert "the accuracy of these commands is unknown" in str(found)
    assert "expect" not in str(found)
    rows = list(csv.DictReader(io.StringIO(commands_text(found))))
    assert {row["expected_mm"] for row in rows} == {""}
    text = controller_numbers(Machine.nominal()).text()
    assert "The machine file contains no calibration" in " ".join(text.split())
    assert "Nothing else was identified" not in text
    assert "Enter each" not in text  # no zero changes, and so no sign is to be checked
    assert "signs" not in text
