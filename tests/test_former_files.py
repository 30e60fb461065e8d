"""Files that earlier versions wrote load, predict the same TCP, and serve the commands of today.

They and their origin are listed in ``data/former/SOURCE.md``.
"""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from tests.command_line import done, run

HERE = Path(__file__).parent
FORMER = HERE / "data" / "former"
RIG = HERE / "data" / "rig"
INPUTS = HERE / "golden" / "inputs"
PREDICTED = json.loads((FORMER / "predicted.json").read_text(encoding="utf-8"))
SAME_TCP = 1e-9  # metres
SAME_CHI2 = 1e-3  # of itself

RERUN = [f"schema-2/{name}" for name in ("dials", "identify", "located", "tool", "delta")]
OLDER = [
    "early-schema-2/dials",
    "schema-2/check",
    *(f"schema-1/{n}" for n in ("dials", "identify", "two-campaigns")),
]


def quick(names: list[str], *few: str) -> list[Any]:
    """Mark all but a few cases as thorough."""
    return [n if n in few else pytest.param(n, marks=pytest.mark.thorough) for n in names]


def result_in(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


def machine_of(campaign: str) -> Path:
    """The machine file of one of the campaigns, whose name begins with its own."""
    if campaign == "measure.csv":
        return RIG / "machine.toml"
    return FORMER / "campaigns" / f"{campaign.replace('.', '-').partition('-')[0]}.toml"


# --- Calibrated machines ----------------------------------------------------------------------


def test_every_former_machine_is_predicted() -> None:
    found = {str(p.parent.relative_to(FORMER)) for p in FORMER.glob("*/*/calibrated.toml")}
    assert found == set(PREDICTED["tcp"])


@pytest.mark.parametrize("name", PREDICTED["tcp"])
def test_a_calibrated_machine_moves_as_it_did(name: str) -> None:
    machine = og.Machine.load(FORMER / name / "calibrated.toml")
    rows = np.array(PREDICTED["tcp"][name]) * 1e-3
    command, unknown, sided = rows[:, :3], rows[:, 3:6], rows[:, 6:]
    np.testing.assert_allclose(machine.forward(command), unknown, rtol=0, atol=SAME_TCP)
    moved = machine.forward(command, approach=[1.0, -1.0, 1.0])
    np.testing.assert_allclose(moved, sided, rtol=0, atol=SAME_TCP)


@pytest.mark.parametrize("name", PREDICTED["compensated_mm"])
def test_a_calibrated_machine_is_compensated_as_it_was(name: str, tmp_path: Path) -> None:
    machine, out = FORMER / name / "calibrated.toml", tmp_path / "commands.csv"
    done("compensate", FORMER / "path.csv", "--machine", machine, "--out", out)
    with out.open(newline="", encoding="utf-8") as file:
        found = [[float(row[f"rho_{leg}_mm"]) for leg in "xyz"] for row in csv.DictReader(file)]
    np.testing.assert_allclose(found, PREDICTED["compensated_mm"][name], rtol=0, atol=2e-6)


def test_a_missing_covariance_is_a_warning_and_another_one_an_error(tmp_path: Path) -> None:
    machine = og.Machine.load(FORMER / "schema-1" / "dials" / "calibrated.toml")
    assert any("calibrated.npz" in warning for warning in machine.warnings)
    shutil.copy(FORMER / "schema-2" / "dials" / "calibrated.toml", tmp_path)
    shutil.copy(FORMER / "schema-2" / "located" / "calibrated.npz", tmp_path)
    with pytest.raises(og.FileError):
        og.Machine.load(tmp_path / "calibrated.toml")


@pytest.mark.parametrize(
    ("name", "campaign"),
    [
        ("schema-2/dials", RIG / "rig-2.csv"),
        ("schema-2/located", INPUTS / "s-curve.csv"),
        *(
            pytest.param(*case, marks=pytest.mark.thorough)
            for case in (
                ("schema-1/dials", RIG / "rig-2.csv"),
                ("early-schema-2/dials", RIG / "rig-2.csv"),
                ("schema-2/delta", INPUTS / "delta.csv"),
            )
        ),
    ],
)
def test_a_calibrated_machine_that_did_not_change_is_adequate(
    name: str, campaign: Path, tmp_path: Path
) -> None:
    """Its own readings again: nothing is to be found beside what the file knows."""
    machine, out = FORMER / name / "calibrated.toml", tmp_path / "out"
    done("close-loop", campaign, "--machine", machine, "--out", out, "--quiet")
    result = result_in(out)
    assert result["verdict"] == "adequate"
    assert not result["changed"]
    assert not result["effects"]


# --- Campaigns --------------------------------------------------------------------------------


def test_every_former_campaign_is_predicted() -> None:
    found = {path.name for path in (FORMER / "campaigns").glob("*.csv")}
    assert found == set(PREDICTED["campaigns"])


@pytest.mark.parametrize("name", PREDICTED["campaigns"])
def test_a_campaign_reads_as_it_did(name: str) -> None:
    file, machine = FORMER / "campaigns" / name, machine_of(name)
    points = name.endswith(".tcp.csv")
    read = [og.read_tcp(file, machine).points().p] if points else og.read_readings(file, machine)
    assert sum(map(len, read)) == PREDICTED["campaigns"][name]["readings"]


@pytest.mark.parametrize(
    "name", quick(list(PREDICTED["campaigns"]), "orthoglide-leg.csv", "delta-plate.csv")
)
def test_a_campaign_is_predicted_as_it_was(name: str, tmp_path: Path) -> None:
    """Readings, noise and nuisances of every kind: chi2 of the nominal and of the base model."""
    file, machine, out = FORMER / "campaigns" / name, machine_of(name), tmp_path / "out"
    given = ("--fit-tcp", file) if name.endswith(".tcp.csv") else (file,)
    done("identify", *given, "--machine", machine, "--out", out, "--quiet")
    result, expected = result_in(out), PREDICTED["campaigns"][name]
    for fit in ("nominal", "before"):
        assert result[fit]["chi2"] == pytest.approx(expected[f"{fit}_chi2"], rel=SAME_CHI2)


@pytest.mark.thorough
def test_a_measurement_that_was_stopped_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "measure.csv"
    shutil.copy(FORMER / "campaigns" / "measure.csv", file)
    kept = file.read_text(encoding="utf-8")
    found = run("measure", "--out", file, "--machine", machine_of(file.name), stdin="quit\n")
    assert found.code in (0, 130)  # stopped again
    assert "40 readings" in found.text
    assert file.read_text(encoding="utf-8").startswith(kept)


def test_a_rehearsal_that_was_finished_is_not_done_again(tmp_path: Path) -> None:
    out = tmp_path / "rehearsal"
    shutil.copytree(FORMER / "rehearsal", out)
    journal = (out / "campaigns.jsonl").read_text(encoding="utf-8")
    given = ("--machine", RIG / "machine.toml", "--sheet", RIG / "rig-2.csv")
    found = done("rehearse", *given, "--campaigns", 4, "--seed", 7, "--jobs", 1, "--out", out)
    assert (out / "campaigns.jsonl").read_text(encoding="utf-8") == journal
    assert "4 campaigns" in found.text


# --- Results ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", quick(RERUN, "schema-2/identify"))
def test_a_result_is_run_again(name: str, tmp_path: Path) -> None:
    out = tmp_path / "again"
    done("rerun", FORMER / name / "result.json", "--out", out)
    assert result_in(out)["verdict"] == result_in(FORMER / name)["verdict"]
    assert (out / "report.html").exists()


@pytest.mark.parametrize("name", quick(OLDER, "schema-1/identify"))
def test_a_result_of_an_earlier_version_is_run_again(name: str, tmp_path: Path) -> None:
    """Its numbers are no longer those of today to the last digit, which is no failure."""
    out = tmp_path / "again"
    found = run("rerun", FORMER / name / "result.json", "--out", out)
    assert "version 0.1.0 (schema " in found.text
    if name == "schema-1/dials":  # two causes of one rail, of which one is now told apart
        assert found.code == 3
        assert "version 0.1.0 (schema 1) wrote it: keep it as a record" in found.text
        assert "give rig-2.csv to orthoglide close-loop" in found.text
        assert "the verdict was 'ambiguous' and is 'explained'" in found.text
    elif name == "schema-2/check":  # p = 1e-4 of the base model is *diffuse* as defined today
        assert found.code == 3
        assert "the verdict was 'adequate' and is 'diffuse'" in found.text
    else:
        assert found.code == 0, found.text
        assert "to 0.2 sigma, as an earlier state of the program" in found.text
        assert (out / "report.html").exists()


@pytest.mark.parametrize("name", ["schema-1/identify", "early-schema-2/dials"])
def test_a_result_of_an_earlier_version_is_refused_by_name(name: str) -> None:
    schema = result_in(FORMER / name)["schema"]
    told = rf"version 0\.1\.0 \(schema {schema}\), wrote it.*orthoglide rerun \S+ --out DIR"
    with pytest.raises(og.FileError, match=told):
        og.Verdict.load(FORMER / name)


def test_a_result_that_kept_no_rows_is_refused_in_a_sentence() -> None:
    found = run("rerun", FORMER / "schema-1" / "tcp" / "result.json")
    assert found.code == 2
    assert found.errors.count("\n") == 1


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("old", "new"),
    [
        (FORMER / "schema-1" / "dials", FORMER / "schema-2" / "dials" / "result.json"),
        (FORMER / "early-schema-2" / "dials", RIG / "rig-2.csv"),
        (FORMER / "schema-2" / "delta", INPUTS / "delta.csv"),
    ],
    ids=lambda path: str(path.relative_to(HERE)),
)
def test_results_serve_a_check(old: Path, new: Path, tmp_path: Path) -> None:
    """The same readings in both states: nothing changed."""
    out = tmp_path / "out"
    done("check", old, new, "--out", out)
    with (out / "changes.csv").open(newline="", encoding="utf-8") as file:
        assert {row["changed"] for row in csv.DictReader(file)} == {"no"}
