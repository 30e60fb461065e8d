"""Identification from TCP points, on a machine that is not this package's model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from orthoglide.fit.from_tcp import Frame, identify_tcp

import orthoglide as og
from orthoglide.cli import cli
from orthoglide.fit import from_tcp
from tests.rig import Rig

RIG = Path(__file__).parent / "data" / "rig"
MACHINE = og.Machine.load(RIG / "machine.toml")
TRUTH = {
    "joint_offset.x": 4e-4,
    "joint_offset.y": -9e-4,
    "leg_length.z": 6e-5,
    "axis_tilt.z.x": 2e-3,
}


def measured(seed: int = 0, missing: bool = False) -> og.TcpPoints:
    rng = np.random.default_rng(seed)
    rho = MACHINE.geometry.L + rng.uniform(*MACHINE.geometry.stroke, (40, 3))
    p = Rig(errors=TRUTH).pose(rho)[0] + rng.normal(0, 1e-6, (40, 3))
    if missing:
        p[rng.random((40, 3)) < 0.3] = np.nan
    n = len(rho)
    return og.TcpPoints(rho, p, np.full(n, 1e-6), np.zeros((n, 3)), np.arange(2, n + 2))


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("frame", ["none", "translation", "rigid"])
def test_a_planted_machine_is_recovered(frame: Frame, missing: bool) -> None:
    found = identify_tcp(
        measured(1, missing), MACHINE, ["joint_offset", "leg_length", "axis_tilt"], frame=frame
    )
    assert found.sigma_scale == 1.0
    for name, value in found.values.items():
        assert abs(value - TRUTH.get(name, 0.0)) < 4.5 * found.sigmas[name], name
    assert found.after < 3e-6 < found.before


def test_the_instruments_frame_does_not_matter() -> None:
    points = measured(2)
    angle, shift = 3e-3, np.array([0.01, -0.02, 0.03])
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    moved = og.TcpPoints(
        points.command, points.p @ turn.T + shift, points.sigma, points.approach, points.line
    )
    free = ["joint_offset", "leg_length", "axis_tilt.z.x"]
    here, there = (identify_tcp(p, MACHINE, free, frame="rigid") for p in (points, moved))
    # The frame's turn is taken as small: its square is left, some micrometres at 3 mrad.
    np.testing.assert_allclose(here.x, there.x, atol=2e-5)


def test_derivatives_are_those_of_the_residual() -> None:
    fit, tolerance = from_tcp._fit(
        MACHINE, measured(), ["joint_offset", "axis_tilt"], "rigid", None
    )
    rng = np.random.default_rng(3)
    at = np.concatenate([tolerance * rng.standard_normal(9), 1e-3 * rng.standard_normal(6)])
    _, jacobian = fit.at(at[:9], at[9:])
    for k in range(15):
        step = np.zeros(15)
        step[k] = 1e-6
        high, low = (fit.at(v[:9], v[9:])[0] for v in (at + step, at - step))
        np.testing.assert_allclose(
            (low - high) / 2e-6, jacobian[:, k], atol=1e-6 * np.abs(jacobian).max()
        )


def test_too_few_points_and_dials_are_refused() -> None:
    points = measured()
    few = og.TcpPoints(
        points.command[:2], points.p[:2], points.sigma[:2], points.approach[:2], points.line[:2]
    )
    with pytest.raises(og.InputError, match="too few"):
        identify_tcp(few, MACHINE)
    with pytest.raises(og.InputError, match="nothing of a dial"):
        identify_tcp(points, MACHINE, ["gauge_scale"])
    with pytest.raises(og.UnidentifiableError, match="do not determine"):
        identify_tcp(points, MACHINE, ["joint_offset", "axis_offset"], frame="rigid", priors=False)


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
    refused = CliRunner().invoke(cli, [*arguments[:-1], "--own", "joint_offset"])
    assert refused.exit_code == 2
