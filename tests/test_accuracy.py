"""What is stated of the TCP's accuracy, its covariance's file, and what mending is said to gain."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks import gains
from benchmarks.public import machine
from orthoglide.accuracy import expected_error, workspace_grid
from orthoglide.errors import FileError
from orthoglide.explanation.budget import _Controller
from orthoglide.machine_file import Posterior
from orthoglide.verdict import Verdict, close_loop
from tests.factors import campaign_of
from tests.rig import Array, Rig
from tests.rig_campaigns import simulate

PLANTED = {
    "joint_offset.x": 3.5e-4, "joint_offset.y": 8.2e-4, "joint_offset.z": 3.3e-4,
    "leg_length.x": -6.5e-5, "leg_length.y": 4.5e-5, "leg_length.z": 2.2e-5,
}  # fmt: skip
# Name: what is planted besides, and the share of their tolerances that all others have.
MACHINES: dict[str, tuple[dict[str, float], float]] = {
    "tilted": ({"axis_tilt.y.z": 1.5e-3}, 0.0),
    "sound": ({}, 0.0),
    "rough": ({}, 0.3),
}


@cache
def rig_of(which: str) -> Rig:
    more, background = MACHINES[which]
    rig = Rig(errors={**PLANTED, **more})
    return rig.with_background(np.random.default_rng(8), background) if background else rig


@cache
def verdict_of(which: str, protocol: str = "standard") -> Verdict:
    rows = simulate(rig_of(which), protocol, np.random.default_rng(18))
    return close_loop(campaign_of(rows))


def parts(error: Array) -> tuple[float, float]:
    """Mean shape and place of an error over the workspace ``(g, 3)``."""
    place = error.mean(axis=0)
    return float(np.linalg.norm(error - place, axis=1).mean()), float(np.linalg.norm(place))


# -- the covariance beside the machine file ------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("which", MACHINES)
def test_what_is_stated_is_what_is_achieved(which: str) -> None:
    rig, machine = rig_of(which), verdict_of(which, "sweep").machine
    wanted = og.Machine.nominal().forward(workspace_grid(machine.geometry))
    middle = np.zeros_like(wanted)
    for settings in (machine.values, {}):
        commands = machine.with_only(settings).inverse(wanted)
        shape, place = parts(rig.pose(commands, middle).p - wanted)
        stated = expected_error(machine, settings)
        assert abs(shape - stated.shape) < 3 * stated.shape_sigma + 1e-6
        assert stated.shape < 10 * shape
        assert place < stated.place + 3 * stated.place_sigma
    # Known to the tolerance alone: two carriages' paths, 0.3 mm each, along each of three axes.
    compensated = expected_error(machine, machine.values)
    assert compensated.place > 0.3e-3
    assert compensated.shape < 0.2 * expected_error(machine, {}).shape


NAMES = ("joint_offset.x", "axis_offset.y.x", "axis_tilt.y.z")
ROOT = np.array([[1e-3, 0, 0], [0.9e-3, 1e-5, 0], [0, 1e-4, 1e-4]])


def calibrated() -> og.Machine:
    values = {"joint_offset.x": 1e-3, "axis_tilt.y.z": 5e-4}
    mean = np.array([values.get(n, 0.0) for n in NAMES])
    return og.Machine.nominal().with_posterior(values, Posterior(NAMES, mean, ROOT @ ROOT.T))


def test_the_covariance_survives_the_files(tmp_path: Path) -> None:
    machine = calibrated()
    machine.save(tmp_path / "calibrated.toml")
    assert {p.name for p in tmp_path.iterdir()} == {"calibrated.toml", "calibrated.npz"}
    again = og.Machine.load(tmp_path / "calibrated.toml")
    assert not again.warnings
    assert again.posterior.names == NAMES
    assert np.array_equal(again.posterior.covariance, ROOT @ ROOT.T)
    assert np.array_equal(again.posterior.mean, machine.posterior.mean)
    assert again.spec.parameters["axis_tilt.y.z"].sigma == pytest.approx(np.sqrt(2) * 1e-4)
    sha = np.load(tmp_path / "calibrated.npz")["sha256"]
    assert str(sha) == again.spec.sha256
    content = (tmp_path / "calibrated.npz").read_bytes()
    again.save(tmp_path / "calibrated.toml", overwrite=True)
    assert (tmp_path / "calibrated.npz").read_bytes() == content
    dates = {i.date_time for i in zipfile.ZipFile(tmp_path / "calibrated.npz").infolist()}
    assert dates == {(1980, 1, 1, 0, 0, 0)}


def test_without_its_covariance_the_parameters_are_independent(tmp_path: Path) -> None:
    file = tmp_path / "calibrated.toml"
    calibrated().save(file)
    (tmp_path / "calibrated.npz").unlink()
    machine = og.Machine.load(file)
    (warning,) = machine.warnings
    assert "no calibrated.npz" in warning
    assert "independent" in warning
    known = machine.posterior
    assert np.array_equal(known.covariance, np.diag(np.diag(known.covariance)))
    assert known.sigmas["joint_offset.x"] == pytest.approx(1e-3)
    # A machine whose parameters changed has no covariance any more.
    assert calibrated().with_parameters({"joint_offset.y": 1e-3}).spec.posterior is None


def test_a_covariance_of_another_machine_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "calibrated.toml"
    calibrated().save(file)
    file.write_text(file.read_text().replace("value = 1.0,", "value = 1.5,"))
    with pytest.raises(FileError, match="belongs to another machine file"):
        og.Machine.load(file)
    (tmp_path / "calibrated.npz").write_bytes(b"PK no")
    with pytest.raises(FileError, match="is damaged"):
        og.Machine.load(file)
    # Saving without one leaves none of another machine beside it.
    with pytest.raises(FileError, match="not overwritten"):
        og.Machine.nominal().save(tmp_path / "calibrated.toml")
    og.Machine.nominal().save(file, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["calibrated.toml"]
    (tmp_path / "new.npz").write_bytes(b"mine")
    with pytest.raises(FileError, match="not overwritten"):
        calibrated().save(tmp_path / "new.toml")
    assert not (tmp_path / "new.toml").exists()


def test_zeros_of_parallel_slides_leave_the_tool_at_its_height_above_the_plate() -> None:
    """No reading tells that height, and no zero may pay for shape with it."""
    from orthoglide.accuracy import best_zeros
    from tests.engines import DELTA

    worn = og.Machine(replace(og.Machine.nominal().spec, geometry=DELTA)).with_parameters(
        {"axis_tilt.a.radial": 4e-3, "mount_tilt.b.a": 8e-3, "joint_offset.c": -4e-4}
    )
    zeros = best_zeros(worn)
    assert expected_error(worn, zeros).shape <= expected_error(worn, {}).shape + 1e-6
    where = worn.with_only({}).forward(workspace_grid(DELTA))
    now, then = (worn.forward(worn.with_only(v).inverse(where)) for v in ({}, zeros))
    assert np.abs((then - now).mean(axis=0)[2]) < 2e-5


def test_zeros_of_parallel_slides_take_what_is_wrong_with_zeros() -> None:
    """All but the height; a tower's zero tilts the plate and shifts it, and had been left alone for
    the shift: the shape fell from 0.54 to 0.47 mm.
    """
    from orthoglide.accuracy import best_zeros
    from tests.engines import DELTA

    off = {"joint_offset.a": 0.7e-3, "joint_offset.b": -1.1e-3, "leg_length.c": 4e-5}
    worn = og.Machine(replace(og.Machine.nominal().spec, geometry=DELTA)).with_parameters(off)
    zeros = best_zeros(worn)
    assert expected_error(worn, {}).shape > 4e-4
    assert expected_error(worn, zeros).shape < 2e-5
    apart = zeros["joint_offset.a"] - zeros["joint_offset.b"]
    assert apart == pytest.approx(1.8e-3, abs=1e-5)


# -- the error budget ------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_cause_gains_what_was_said() -> None:
    record = gains.run((1, "two-gauges", 1), 1)
    (item,) = [i for i in record["items"] if i["named"]]
    for how in ("repaired", "compensated"):
        gain, sigma = item["said"][how]
        assert gain == pytest.approx(item[how], rel=0.1)
        assert abs(gain - item[how]) <= 1.96 * sigma + gains.LEAST
    assert "| repaired | causes named | 1 |" in gains.tables([record])[0].markdown()


def test_the_best_zeros_and_lengths_leave_nothing_of_zeros_and_lengths() -> None:
    worn = machine().with_parameters({"joint_offset.x": 2e-3, "bar_mismatch.z": 2e-3})
    controller = _Controller.of(worn)
    plain = {"joint_offset.x": 4e-3, "joint_offset.y": -3e-3, "leg_length.z": 2e-4}
    assert np.abs(controller.residual_of(plain)).max() < 1e-6  # of millimetres
    left = np.linalg.norm(controller.residual_of(dict(worn.values)).reshape(-1, 3), axis=1).mean()
    other = gains.Tool().error(gains.Rig(errors=dict(worn.values)))
    assert 1e3 * left == pytest.approx(other, rel=1e-3)
