"""The commands as the owner of a linear delta uses them, from what a firmware stored."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from orthoglide.cli import cli
from orthoglide.machine import Machine
from orthoglide.planning import owned_instruments
from tests.klipper_files import DATA


def run(*args: object, code: int = 0) -> str:
    done = CliRunner().invoke(cli, [str(a) for a in args])
    assert done.exit_code == code, done.output
    return " ".join(done.output.split())


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("delta") / "in"
    run("import", "klipper", DATA / "electrocally.cfg", "--out", folder)
    return folder


def test_heights_judge_what_a_mesh_gave(imported: Path, tmp_path: Path) -> None:
    common = ("close-loop", imported / "mesh-default.csv", "--machine", imported / "machine.toml")
    run(*common, "--holdout", imported / "calibration.csv", "--out", tmp_path / "one", "--quiet")
    told = json.loads((tmp_path / "one" / "result.json").read_text())
    assert told["arguments"]["holdout"] == "calibration.csv"
    assert 0 < told["holdout"]["after_rms_mm"] < 0.1
    assert "same numbers" in run("rerun", tmp_path / "one" / "result.json")
    run(*common, "--holdout", imported / "mesh-default.csv", "--out", tmp_path / "two", "--quiet")
    assert "they judge nothing" in (tmp_path / "two" / "report.html").read_text()


def test_two_visits_are_compared(imported: Path, tmp_path: Path) -> None:
    rows = (imported / "mesh-default.csv").read_text()
    (tmp_path / "later.csv").write_text(rows)
    common = ("--machine", imported / "machine.toml")
    told = run("check", imported / "mesh-default.csv", tmp_path / "later.csv", *common)
    assert "Nothing changed" in told


def test_every_command_works_or_says_why_not(imported: Path, tmp_path: Path) -> None:
    machine = imported / "machine.toml"
    for command in (
        ("protocol", "--out", tmp_path / "s.csv"),
        ("simulate", "--out", tmp_path / "c.csv"),
    ):
        assert "linear-delta" in run(*command, "--machine", machine, code=2)
    told = run("compare", "--machine", machine, "--out", tmp_path / "cmp", code=2)
    assert "simplified model" in told
    run("identify", imported / "mesh-default.csv", "--machine", machine, "--out", tmp_path / "id")
    calibrated = tmp_path / "id" / "calibrated.toml"
    (tmp_path / "path.csv").write_text("p_x_mm,p_y_mm,p_z_mm\n0,0,10\n30,-20,5\n")
    run("compensate", tmp_path / "path.csv", "--machine", calibrated, "--out", tmp_path / "to.csv")
    run("export", "--machine", calibrated, "--out", tmp_path / "exported")
    text = (tmp_path / "exported" / "controller.txt").read_text()
    assert "too far down" in text or "too far up" in text
    assert "origin" not in text
    assert not list(tmp_path.glob("[sc].csv"))


def test_absurd_rods_are_told_whatever_is_asked(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    run("import", "klipper", DATA / "v400-april.cfg", "--out", folder)
    for command in (("forward", 0, 0, 0), ("inverse", 0, 0, 1)):
        assert run(*command, "--machine", folder / "machine.toml").startswith("warning: The arms")


def test_instruments_that_one_owns_and_others(imported: Path, tmp_path: Path) -> None:
    machine, sheet = imported / "machine.toml", tmp_path / "sheet.csv"
    told = run("design", "--owns", "plate,incline", "--machine", machine, "--out", sheet)
    assert "with a probe on a plate (29), a level on the platform (26):" in told
    assert "not visible, which is not absent: encoder_scale.a" in told
    assert re.search(r"- a tracker at the tool would show encoder_scale, ", told)
    assert "dials on the legs would" not in told
    assert sheet.read_text().count("\n") == 1 + 29 + 26
    told = run("close-loop", sheet, "--machine", machine, "--out", tmp_path / "o", code=2)
    assert "the reading is empty" in told
    assert "is one of leg, tcp" in run("design", "--owns", "ruler", "--machine", machine, code=2)
    assert "linear-delta" in run("design", "--owns", "leg", "--machine", machine, code=2)


def test_a_ball_bar_tells_what_dials_cannot() -> None:
    found = owned_instruments(Machine.nominal(), ["leg"])
    assert "encoder_scale.x" in found.tells.invisible
    gains = {gain.kind: gain for gain in found.gains}
    assert "encoder_scale" in gains["ballbar"].shown
    assert not gains["plate"].shown
    assert "mount_tilt.x.a" in gains["incline"].shown
