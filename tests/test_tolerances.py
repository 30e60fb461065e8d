"""Tolerances that a wanted error of the tool needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orthoglide as og
from orthoglide.accuracy import mean_length, without_place, workspace
from orthoglide.cli import cli
from orthoglide.effects import CATALOGUE
from orthoglide.machine_file import MachineFile
from orthoglide.planning.tolerances import NeededTolerances, Sources
from tests.test_layout import DELTA

MACHINE = Path(__file__).parent / "data" / "rig" / "machine.toml"
WANTED = 5e-5


@pytest.fixture(scope="module")
def sheet(machine: og.Machine) -> og.Campaign:
    return og.protocol("sweep", machine.geometry)


@pytest.fixture(scope="module")
def bare(machine: og.Machine) -> NeededTolerances:
    return og.needed_tolerances(machine, WANTED)


@pytest.fixture(scope="module")
def calibrated(machine: og.Machine, sheet: og.Campaign) -> NeededTolerances:
    return og.needed_tolerances(machine, WANTED, sheet)


def test_mean_length_of_normal_vectors() -> None:
    assert mean_length(np.eye(3)[None]) == pytest.approx(np.sqrt(8 / np.pi), rel=1e-6)
    assert mean_length(4 * np.diag([1.0, 0, 0])[None]) == pytest.approx(
        2 * np.sqrt(2 / np.pi), rel=1e-6
    )
    assert mean_length(np.zeros((2, 3, 3))) == 0
    mixed = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 0.05]]) * 1e-10
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(3), mixed, 200_000)
    assert mean_length(mixed[None]) == pytest.approx(np.linalg.norm(drawn, axis=1).mean(), rel=5e-3)


@pytest.mark.parametrize("factor", [2.0, 0.1])
def test_twice_the_error_allows_twice_the_tolerances(
    machine: og.Machine, bare: NeededTolerances, factor: float
) -> None:
    other = og.needed_tolerances(machine, factor * WANTED)
    assert other.scale == pytest.approx(factor * bare.scale)
    for one, two in zip(bare.effects, other.effects, strict=True):
        assert two.effect == one.effect
        assert two.share == pytest.approx(one.share)
        assert two.scaled == pytest.approx(factor * one.scaled)
        assert two.equal == pytest.approx(factor * one.equal)


@pytest.mark.parametrize("column", ["scaled", "equal"])
def test_machines_at_the_needed_tolerances_have_that_error(
    machine: og.Machine, bare: NeededTolerances, column: str
) -> None:
    """Simulated in full, not linearised."""
    rng, commands = np.random.default_rng(1), workspace(machine.geometry)
    sd = {e.effect: getattr(e, column) for e in bare.effects}
    nominal, errors = machine.forward(commands), []
    names = [n for n in machine.catalogue.parameters if n.effect in sd]
    for _ in range(100):
        values = {str(n): sd[n.effect] * float(rng.standard_normal()) for n in names}
        apart = without_place(machine.with_only(values).forward(commands) - nominal)
        errors.append(np.linalg.norm(apart, axis=1).mean())
    assert abs(np.mean(errors) - WANTED) < 3 * np.std(errors) / np.sqrt(len(errors))


def test_calibrated_machines_at_the_needed_tolerances_have_that_error(
    machine: og.Machine, sheet: og.Campaign, calibrated: NeededTolerances
) -> None:
    """Parameters estimated by least squares from drawn readings."""
    sources = Sources.of(machine, sheet, None)
    assert sources.rows is not None
    rng, count = np.random.default_rng(2), sources.slopes.shape[2]
    sd = np.ones(sources.rows.shape[1])
    sd[:count] = calibrated.scale
    true = sd[:, None] * rng.standard_normal((len(sd), 400))
    read = sources.rows @ true + rng.standard_normal((len(sources.rows), 400))
    both = np.vstack([sources.rows, np.diag(1 / sd)])
    found = np.linalg.lstsq(both, np.vstack([read, np.zeros_like(true)]), rcond=None)[0]
    field = sources.slopes @ (true - found)[:count]
    errors = np.linalg.norm(field, axis=1).mean(axis=0)
    assert abs(errors.mean() - WANTED) < 3 * errors.std() / np.sqrt(400)


def test_a_calibration_allows_more(bare: NeededTolerances, calibrated: NeededTolerances) -> None:
    assert calibrated.now < bare.now
    assert calibrated.scale > bare.scale
    assert 0 < calibrated.noise < 1
    assert bare.noise == 0
    for found in (bare, calibrated):
        assert sum(e.share for e in found.effects) + found.noise == pytest.approx(1)
        shares = [e.share for e in found.effects]
        assert shares == sorted(shares, reverse=True)
    before = {e.effect: e.share for e in bare.effects}
    after = {e.effect: e.share for e in calibrated.effects}
    assert before["joint_offset"] > 0.5 > 0.1 > after["joint_offset"]  # zeros are identified


def test_what_makes_no_error_at_rest_is_not_counted(bare: NeededTolerances) -> None:
    passing = {"approach", "load", "temperature", "time"}
    known = {"backlash", "drive_compliance", "thermal_growth", "thermal_drift"}
    more = {n for n, e in CATALOGUE.items() if e.needs & passing and not e.of_dial}
    assert set(bare.left_out) == known | more
    assert "screw_error" in og.needed_tolerances(og.Machine.nominal(), WANTED).left_out


def test_a_printer_has_needed_tolerances_too() -> None:
    found = og.needed_tolerances(og.Machine(MachineFile(name="delta", geometry=DELTA)), 1e-4)
    assert 0 < found.scale < np.inf


def test_the_result_is_said(bare: NeededTolerances, calibrated: NeededTolerances) -> None:
    assert str(bare).startswith("Not calibrated: 0.952 mm at the tolerances of the machine file; ")
    assert "needs all of them times 0.0525" in str(bare)
    assert "the readings" in str(calibrated)
    assert "the readings" not in str(bare)
    assert bare.to_frame().loc["leg_length", "tolerance"] == pytest.approx(0.1)
    assert "<table>" in bare._repr_html_()
    loose = og.needed_tolerances(og.Machine.nominal(), 0.005)
    assert "allows all of them times" in str(loose)


def test_what_is_no_error_is_refused(machine: og.Machine, tmp_path: Path) -> None:
    for wanted in (0.0, -1e-5, float("nan"), 2.0):
        with pytest.raises(og.InputError, match="positive length"):
            og.needed_tolerances(machine, wanted)
    for options, said in (
        *(
            (["--tcp", wrong], "--tcp must be a positive number of millimetres from 1e-06 to 1000")
            for wrong in ("0", "-1", "nan", "1e-300", "1e300")
        ),
        (["--tcp", "0.05", "--calibrated-by", str(tmp_path / "no.csv")], "there is no such file"),
    ):
        result = CliRunner().invoke(cli, ["tolerances", *options])
        assert result.exit_code == 2
        assert said in result.output


def test_the_command_prints_both(machine: og.Machine, sheet: og.Campaign, tmp_path: Path) -> None:
    og.write_campaign(sheet, tmp_path / "sheet.csv")
    line = ["tolerances", "--tcp", "0.05", "--machine", str(MACHINE)]
    result = CliRunner().invoke(cli, [*line, "--calibrated-by", str(tmp_path / "sheet.csv")])
    assert result.exit_code == 0, result.output
    assert "Not calibrated" in result.stdout
    assert "Calibrated by sheet" in result.stdout
