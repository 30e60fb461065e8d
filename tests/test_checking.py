"""``check``: two states of an independently simulated machine, before and after a repair."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.delta_readings import measured
from benchmarks.delta_truth import machine as delta
from orthoglide.checking import Check, check
from orthoglide.checking.pages import changes_page, changes_text
from orthoglide.checking.states import with_distinct_names
from orthoglide.closing import build_result, compute_outcome
from orthoglide.effects import CATALOGUE
from orthoglide.errors import InputError
from orthoglide.explanation.change import Change
from orthoglide.firmware.klipper import import_printer
from orthoglide.fit import readings_of
from orthoglide.observations import Readings, source
from orthoglide.observations.tables import copied_files
from tests import rig_campaigns as rc
from tests.factors import campaign_of
from tests.klipper_files import DATA, imported, simulated_cfg
from tests.rig import Rig
from tests.rig_delta import DeltaRig
from tests.test_cli import run
from tests.test_report import opened

RIG = Path(__file__).parent / "data" / "rig"
WORN = {"joint_offset.x": 1.2e-3, "joint_offset.y": -0.8e-3, "leg_length.z": -6e-5}


def rows(seed: int, protocol: str = "standard", **errors: float) -> list[rc.Row]:
    """One machine, but for ``errors``; other dials, another day."""
    rig = Rig().with_errors(WORN | errors).with_background(np.random.default_rng(99), 0.02)
    return rc.simulate(rig, protocol, np.random.default_rng(seed))


def compared(machine: og.Machine, old: list[rc.Row], new: list[rc.Row]) -> Check:
    return check([campaign_of(old, machine)], [campaign_of(new, machine)], machine)


def test_faults_of_the_data_are_told_with_their_lines(machine: og.Machine) -> None:
    knocked, _ = rc.knocked_stand(rows(2), "yz-0.5", -0.5)
    found = compared(machine, rows(1), knocked)
    (fault,) = found.with_changes.blunders
    assert f"- data: {fault.message}" in changes_text(found)
    assert "line" in fault.message
    assert fault.message in unescape(changes_page(found))


def test_a_dial_that_counted_the_other_way_is_no_change_of_the_machine(
    machine: og.Machine,
) -> None:
    """Together with the old readings another label and other zeros explained them as well."""
    turned, _ = rc.swapped_sign(rows(2, "sweep", **{"joint_offset.z": -7e-4}), "yz-0.5")
    found = compared(machine, rows(1, "sweep", **{"joint_offset.z": -7e-4}), turned)
    assert [fault.kind for fault in found.with_changes.blunders] == ["sign"]
    assert not any(d.is_significant for d in found.differences), str(found)


def test_where_nothing_changed_it_says_how_sure_that_is(machine: og.Machine) -> None:
    found = compared(machine, rows(1), rows(2))
    assert not [d for d in found.differences if d.changed]
    (said,) = found.sentences
    assert said.startswith("nothing changed beyond its uncertainty: ")
    assert said.count("±") == len(found.differences)
    # Zeros and the readings that prove them are listed, but not where the verdict withholds them.
    assert "these readings prove their signs" in changes_text(found)
    closed = replace(compute_outcome(found.verdict.request), word="unexplained")
    unexplained = build_result(closed, og.Verdict)
    doubted = changes_text(replace(found, verdict=unexplained, with_changes=unexplained))
    assert "prove their signs" not in doubted
    assert "once the zeros are corrected" not in doubted


def test_an_advised_command_names_a_file_that_is_written(
    visited: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It named ``calibrated.toml`` where nothing was written, and without its folder."""
    words = "orthoglide compensate path.csv --machine calibrated.toml"
    monkeypatch.setattr("orthoglide.checking.pages.changes_text", lambda _: words)
    states = ("check", "old.csv", "new.csv", "--machine", RIG / "machine.toml")
    assert "(DIR/calibrated.toml is written with --out DIR.)" in run(*states).stdout
    assert "--machine out/calibrated.toml" in run(*states, "--out", "out").stdout


def test_both_sides_have_readings(machine: og.Machine) -> None:
    with pytest.raises(InputError, match="at least one file of readings"):
        check([], [campaign_of(rows(1), machine)], machine)


@pytest.fixture
def visited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with readings before and after a zero was entered."""
    monkeypatch.chdir(tmp_path)
    rc.write_csv(rows(1), "old.csv")
    rc.write_csv(rows(2, **{"joint_offset.x": 0.0}), "new.csv")
    return tmp_path


@pytest.mark.thorough
def test_from_results_and_files_to_words_and_a_page(visited: Path) -> None:
    options = ("--machine", RIG / "machine.toml")
    assert run("identify", "old.csv", *options, "--out", "before", "--quiet").exit_code == 0
    kept = run("check", "before/result.json", "new.csv", "--out", "out")
    assert kept.exit_code == 0, kept.output
    assert "- The joint offset of leg x changed from" in kept.stdout
    page = (visited / "out" / "check.html").read_text()
    assert "The joint offset of leg x changed from" in page
    assert "<svg" in page
    assert re.search(r"changed by 1\.\d+ mm inward", page)
    assert "Confirm the repair" in page
    assert "was moved the wrong way" in page
    assert "The report of new<" in page
    stored = og.Verdict.load("out")
    (change,) = stored.changed
    assert (change.parameter, change.files) == ("joint_offset.x", ("old.csv", "new.csv"))
    assert change.after - change.before == pytest.approx(-1.2, abs=0.1)
    assert stored.compared[0].startswith("the joint offset of leg x changed from")
    seen = opened(page, 390, visited)  # its table was wider than a phone
    assert (seen.inner, seen.out, seen.cut) == (390, [], [])
    table = list(csv.DictReader(io.StringIO((visited / "out" / "changes.csv").read_text())))
    by_name = {row["parameter"]: row for row in table}
    assert by_name["joint_offset.x"]["changed"] == "yes"
    assert float(by_name["joint_offset.x"]["difference"]) == pytest.approx(-1.2, abs=0.1)
    assert by_name["joint_offset.y"]["changed"] == "no"
    assert (visited / "out" / "report.html").exists()
    refused = run("check", "old.csv", "none.csv", "--out", "other")
    assert refused.exit_code == 2
    assert not (visited / "other").exists()


def probed(instrument: str, seed: int, **errors: float) -> Readings:
    """A linear delta that nobody calibrated, whose bed has three lobes, with a cause or without."""
    own = {"joint_offset.a": 4e-4, "axis_offset.b.radial": 3e-4, "plate_trefoil.bed.cos": 8e-5}
    rig = DeltaRig(errors={**own, **errors})
    return measured(rig, np.random.default_rng(seed), machine=delta(), instrument=instrument)


def plate_moved(higher: float, along: tuple[float, float], **errors: float) -> Check:
    """Two visits of one probe to a plate, raised and tilted between them, as in docs/files.md: a
    reading is the height of the tool above it.
    """
    old, new = probed("probe", 1), probed("probe", 1, **errors)  # of one plane
    p = delta().forward(new.command)
    noise = np.random.default_rng(5).normal(0, 1.8e-5, len(new))
    reading = new.reading - higher - p[:, :2] @ np.array(along) + noise
    return check([replace(old, name="old")], [replace(new, reading=reading, name="new")], delta())


def test_a_plate_that_lies_elsewhere_is_told_with_its_sign() -> None:
    """Height and slopes of each setup are free in every fit: nothing had changed."""
    said = (
        "lies 0.25 mm lower than before and is tilted against before: its rim rises by 0.24 mm "
        "toward 180 degrees"
    )
    found = plate_moved(-2.5e-4, (-2e-3, 0.0))
    first, rest, *_ = found.sentences
    numbers = r"(?<= )[\d.]+(?= (?:mm|degrees))"
    assert re.sub(numbers, "#", first).startswith(
        f"at equal commands the plate of bed {re.sub(numbers, '#', said)}"
    )
    for told, true in zip(re.findall(numbers, first), re.findall(numbers, said), strict=True):
        assert float(told) == pytest.approx(float(true), abs=2 if "." not in true else 0.015)
    assert first.endswith("these readings cannot tell which")
    # An arm or an endstop may have changed by as much, and was listed as unchanged to 0.07 mm.
    assert rest.startswith(
        "if only the plate or the probe was moved, nothing else changed beyond its uncertainty: "
    )
    assert found.line.startswith("Changed: where the plate lies. ")


def test_two_calibrations_that_a_printer_stores_are_compared() -> None:
    """A shape of the plate that neither sees was a cause without a part: a crash."""
    printer = import_printer(DATA / "v400-april.cfg")
    (old, *_), machine = printer.campaigns, og.Machine(printer.machine)
    moved = np.array([-5e-4, 0.0, 0.0])
    new = replace(old, command=old.command + moved, second=old.second + moved, name="later")
    found = check([old], [new], machine)
    (change,) = found.changes
    assert str(change.parameter) == "joint_offset.a"
    assert change.after - change.before == pytest.approx(5e-4, abs=3e-5)


def test_a_difference_beyond_its_sigma_is_never_said_to_be_within_it() -> None:
    """4.8 sigma were listed under "nothing else changed beyond its uncertainty"."""
    moved, still, apart = (
        Change({CATALOGUE.parameter(f"joint_offset.{leg}"): size}, CATALOGUE, before=0.0,
               after=size, sigma=1e-5, changed=size > 1e-4)
        for leg, size in (("x", 1e-3), ("y", 1e-5), ("z", 5e-5))
    )  # fmt: skip
    found = Check(("a",), ("b",), None, None, (moved, still, apart))  # type: ignore[arg-type]
    _, within, beyond = found.sentences
    assert within == (
        "nothing else changed beyond its uncertainty: joint offset of leg y +0.010 ± 0.010 mm"
    )
    assert "needs no change" in beyond
    assert "joint offset of leg z +0.050 ± 0.010 mm" in beyond


def test_numbers_that_hide_a_change_are_not_advised_beside_it(tmp_path: Path) -> None:
    """A check said "nothing else is wrong" of numbers that were fitted to a drive that moves too
    far, and offered these numbers and the repair of the drive.
    """
    states, sound = [], {"joint_offset.a": 2e-4, "axis_offset.b.radial": 1.5e-4}
    for name, errors in (("old", sound), ("new", sound | {"encoder_scale.a": 0.021})):
        (tmp_path / name).mkdir()
        states.append(imported(tmp_path / name, simulated_cfg(DeltaRig(errors=errors))))
    old, new = states
    found = check([*old.campaigns], [*new.campaigns], og.Machine(old.machine))
    assert [str(change.parameter) for change in found.changes] == ["encoder_scale.a"]
    text = changes_text(found)
    assert "do not show that the encoder scale of tower a changed" in text
    assert "enter no number before it is confirmed and corrected" in text
    assert "drive a moves 2 % more" in text
    assert "numbers are off" not in text
    assert [action.kind for action in found.with_changes.actions] == ["confirm"]
    assert "lists the numbers" not in text
    repaired = check([*new.campaigns], [*old.campaigns], og.Machine(old.machine))
    assert [str(change.parameter) for change in repaired.changes] == ["encoder_scale.a"]
    assert repaired.with_changes.contradicted == ""
    assert "Confirm the repair" in changes_text(repaired)


def test_no_warning_of_a_covariance_that_is_not_used(
    visited: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A calibrated machine whose npz was lost is compared as it was before the calibration."""
    calibrated = og.Machine.load(RIG / "machine.toml").with_parameters(
        {"joint_offset.x": 1e-3}, {"joint_offset.x": 1e-5}
    )
    for name, provenance in (("by-hand", {}), ("calibrated", {"verdict": "adequate"})):
        calibrated.with_provenance(provenance).save(f"{name}.toml")

    def refuse(*_: object, **__: object) -> None:
        raise InputError("both states were read")

    monkeypatch.setattr("orthoglide.checking.check", refuse)
    for name, used in (("by-hand", True), ("calibrated", False)):
        told = run("check", "old.csv", "new.csv", "--machine", f"{name}.toml").stderr
        assert "both states were read" in told
        assert ("sigmas are taken as independent" in told) == used


def test_copies_in_different_folders_are_called_by_their_folders(visited: Path) -> None:
    """Both files were called ``mesh.csv``: a reader could not tell which was meant."""
    files = [Path(name, "mesh.csv") for name in ("march", "may/one", "may/two", ".")]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(Path("old.csv").read_text())
    machine = og.Machine.load(RIG / "machine.toml")
    labels = ["march/mesh.csv", "one/mesh.csv", "two/mesh.csv", "mesh.csv"]
    tables = readings_of(files, machine)
    assert [source(table) for table in tables] == labels
    assert [source(table) for table in readings_of(["old.csv", "new.csv"], machine)] == [
        "old.csv", "new.csv",
    ]  # fmt: skip
    states = ([*readings_of(file, machine)] for file in files[:2])
    before, after = with_distinct_names(*states)
    assert [source(table) for table in (*before, *after)] == ["march/mesh.csv", "one/mesh.csv"]
    twice = with_distinct_names(tables[:1], tables[:1])
    assert [source(table) for (table,) in twice] == [
        "mesh.csv (old-1-mesh)", "mesh.csv (new-1-mesh)",
    ]  # fmt: skip
    refused = run("identify", *files[:2], "--machine", RIG / "machine.toml")
    assert "have the same name (march/mesh.csv, one/mesh.csv): leave" in refused.stderr
    (told,) = copied_files((*before, *after))
    assert told.startswith("the readings of one/mesh.csv are those of march/mesh.csv to")
