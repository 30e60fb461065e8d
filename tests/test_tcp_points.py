"""Identification from TCP points, on a machine that is not this package's model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orthoglide as og
from orthoglide.cli import cli
from orthoglide.instruments import Frame
from tests.rig import Rig

RIG = Path(__file__).parent / "data" / "rig"
MACHINE = og.Machine.load(RIG / "machine.toml")
TRUTH = {
    "joint_offset.x": 4e-4,
    "joint_offset.y": -9e-4,
    "leg_length.z": 6e-5,
    "axis_tilt.z.x": 2e-3,
}


def measured(seed: int = 0, missing: bool = False) -> og.Readings:
    rng = np.random.default_rng(seed)
    rho = MACHINE.geometry.L + rng.uniform(*MACHINE.geometry.stroke, (40, 3))
    p = Rig(errors=TRUTH).pose(rho)[0] + rng.normal(0, 1e-6, (40, 3))
    if missing:
        left_out = rng.random((40, 3)) < 0.3
        p[left_out & ~left_out.all(axis=1, keepdims=True)] = np.nan
    n = len(rho)
    return og.Readings.from_points(rho, p, np.full(n, 1e-6), np.zeros((n, 3)), np.arange(2, n + 2))


@pytest.mark.thorough
@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("frame", ["none", "translation", "rigid"])
def test_a_planted_machine_is_recovered(frame: Frame, missing: bool) -> None:
    found = og.identify(
        measured(1, missing), MACHINE, ["joint_offset", "leg_length", "axis_tilt"], frame=frame
    )
    assert found.sigma_scale == 1.0
    for name, value in found.values.items():
        assert abs(value - TRUTH.get(name, 0.0)) < 4.5 * found.sigmas[name], name
    assert found.scores.rms < 2e-6 < found.nominal.rms
    assert found.method == "nested"
    again = og.identify(
        measured(1, missing),
        MACHINE,
        ["joint_offset", "leg_length", "axis_tilt"],
        frame=frame,
        method="nlp",
    )
    np.testing.assert_allclose(found.x, again.x, atol=1e-9)


def test_too_few_points_and_dials_are_refused() -> None:
    points = measured()
    few = points.subset(points.order < 2)
    with pytest.raises(og.InputError, match="too few"):
        og.identify(few, MACHINE)
    with pytest.raises(og.InputError, match="nothing is free"):
        og.identify(points, MACHINE, ["gauge_scale"])
    with pytest.raises(og.UnidentifiableError, match="do not determine"):
        og.identify(points, MACHINE, ["joint_offset", "axis_offset"], frame="rigid", priors=False)


def test_the_command_line(tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["identify", "--fit-tcp", str(RIG / "rig-1.tcp.csv"), "--out", str(out), "--json"]
    done = CliRunner().invoke(cli, [*arguments, "--machine", str(RIG / "machine.toml")])
    assert done.exit_code == 0, done.output
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    keys = json.loads((RIG / "keys.json").read_text(encoding="utf-8"))["rig-1"]
    for leg, value in zip("xyz", keys["joint_offset_mm"], strict=True):
        assert result["parameters"][f"joint_offset.{leg}"]["value"] == pytest.approx(
            value, abs=0.03
        )
    assert og.Machine.load(out / "calibrated.toml").values


@pytest.mark.thorough
def test_dials_and_points_close_the_loop_and_run_again(tmp_path: Path) -> None:
    out = tmp_path / "out"
    files = [str(RIG / "rig-2.csv"), "--fit-tcp", str(RIG / "rig-2.tcp.csv")]
    machine = ["--machine", str(RIG / "machine.toml")]
    done = CliRunner().invoke(cli, ["close-loop", *files, *machine, "--out", str(out), "--quiet"])
    assert done.exit_code == 0, done.output
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["effects"][0]["parameters"] == ["axis_tilt.y.z"]
    assert abs(result["effects"][0]["value"] - 2.5e-3) < 1e-4
    assert result["arguments"]["fit_tcp"] == ["rig-2.tcp.csv"]
    again = CliRunner().invoke(cli, ["rerun", str(out / "result.json"), "--quiet"])
    assert again.exit_code == 0, again.output


def test_points_that_judge_are_looked_at_as_well() -> None:
    """In another unit or a left-handed frame they would condemn a machine that is right."""
    dials, points = og.read_campaign(RIG / "rig-1.csv", MACHINE.spec), measured(30).points()
    for wrong, said in ((points.p / 25.4, "in inches"), (points.p * [1, -1, 1], "left-handed")):
        with pytest.raises(og.InputError, match=said):
            og.close_loop([dials], MACHINE, tcp=og.Readings.from_points(points.command, wrong))


def test_points_are_judged_by_what_they_are_known_to_themselves() -> None:
    """Noise of 20 um in the points is no error of a machine that is known to 1 um."""
    from orthoglide.closing.judging import points_contradiction, tcp_errors

    worn, rng = MACHINE.with_parameters(TRUTH), np.random.default_rng(2)
    rho = MACHINE.geometry.L + rng.uniform(*MACHINE.geometry.stroke, (40, 3))
    p = worn.forward(rho) + rng.normal(0, 2e-5, (40, 3))
    stated, lines = np.full((40, 3), 1e-6), np.arange(2, 42)

    def judged(sigma: float, after: dict[str, float]) -> tuple[float, str]:
        given = og.Readings.from_points(rho, p, np.full(40, sigma), np.zeros((40, 3)), lines)
        errors = tcp_errors(MACHINE, given, {}, after, stated)["translation"]
        return errors.inside, points_contradiction(errors, stated, given.points())

    assert judged(np.nan, worn.values)[0] < 0.2
    inside, said = judged(2e-5, worn.values)
    assert inside == pytest.approx(0.95, abs=0.06)
    assert not said
    _, said = judged(2e-5, {})
    assert said.startswith("the measured points fit this result neither with nor without what was")
    assert not judged(np.nan, {})[1]  # nobody knows how well they are known
