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
from orthoglide import units
from orthoglide.checking import Check, Difference, check
from orthoglide.checking.pages import changes_text
from orthoglide.effects import CATALOGUE
from orthoglide.errors import InputError
from orthoglide.firmware.klipper import import_printer
from orthoglide.geometry import Geometry
from orthoglide.machine_file import Instrument, MachineFile
from orthoglide.observations import Readings, campaign_text
from orthoglide.planning.sheets import instrument_sheet
from orthoglide.simulation import simulate
from tests import rig_campaigns as rc
from tests.factors import factor_of
from tests.klipper_files import DATA
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


def campaign(machine: og.Machine, name: str, measured: list[rc.Row]) -> og.Campaign:
    columns = {key: [row[key] for row in measured] for key in measured[0]}
    return og.Campaign.from_frame(columns, name=name, machine_file=machine.spec)


def compared(machine: og.Machine, old: list[rc.Row], new: list[rc.Row]) -> Check:
    return check([campaign(machine, "c", old)], [campaign(machine, "c", new)], machine)


@pytest.mark.thorough
def test_zeros_that_were_entered_are_seen_and_nothing_else(machine: og.Machine) -> None:
    new = {"joint_offset.x": 0.0, "joint_offset.y": 0.1e-3}
    found = compared(machine, rows(1), rows(2, **new))
    by_name = {str(d.parameter): d for d in found.differences}
    assert {n for n, d in by_name.items() if d.changed} == set(new)
    for name, value in new.items():
        d = by_name[name]
        assert abs(d.after - d.before - (value - WORN[name])) < 4 * d.sigma
        assert 0 < d.sigma < 0.2e-3
    assert found.old != found.new  # though both files have one name
    assert "changed from" in found.sentences[0]
    assert found.sentences[-1].startswith("nothing else changed beyond its uncertainty: ")
    assert found.sentences[-1].count("±") == len(by_name) - 2
    frame = found.to_frame()
    assert list(frame.index) == list(by_name)
    assert frame["new"]["joint_offset.x"] == by_name["joint_offset.x"].after * 1e3
    assert set(frame.index[frame["changed"]]) == set(new)
    assert found.line in unescape(found._repr_html_())


def test_where_nothing_changed_it_says_how_sure_that_is(machine: og.Machine) -> None:
    found = compared(machine, rows(1), rows(2))
    assert not [d for d in found.differences if d.changed]
    (said,) = found.sentences
    assert said.startswith("nothing changed beyond its uncertainty: ")
    assert said.count("±") == len(found.differences)
    # Zeros and the readings that prove them are listed, but not where the verdict withholds them.
    assert "these readings prove their signs" in changes_text(found)
    doubted = changes_text(replace(found, closed=replace(found.closed, word="unexplained")))
    assert "prove their signs" not in doubted
    assert "once the zeros are right" not in doubted


@pytest.mark.thorough
def test_a_bump_that_came_is_told_though_it_may_be_a_wrong_command(machine: og.Machine) -> None:
    before = Rig().with_errors(WORN).with_background(np.random.default_rng(99), 0.02)
    after = replace(before, extra=(rc.bump(0, 2, 1.5e-4, -0.05, 0.008),))
    old, new = (
        rc.simulate(rig, "sweep", np.random.default_rng(k)) for k, rig in enumerate((before, after))
    )
    found = compared(machine, old, new)
    assert found.line == "Changed: what is located. Verdict ambiguous."
    (told,) = found.places
    assert "travel −50 mm" in told
    assert told.endswith("(or a fault of the readings)")


def test_both_sides_have_readings(machine: og.Machine) -> None:
    with pytest.raises(InputError, match="at least one file of readings"):
        check([], [campaign(machine, "c", rows(1))], machine)


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
    assert "- Joint offset of leg x changed from" in kept.stdout
    page = (visited / "out" / "check.html").read_text()
    assert "Joint offset of leg x changed from" in page
    assert "<svg" in page
    assert re.search(r"changed by 1\.\d+ mm inward", page)
    assert "Confirm the repair" in page
    assert "was moved the wrong way" in page
    assert "The report of new<" in page
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


@pytest.mark.thorough
def test_dials_and_the_tool_are_compared_in_one_go() -> None:
    """Zeros corrected between two visits, each with dials on the legs and a tracker at the tool."""
    told = {"joint_offset.x": 1.2e-3, "axis_tilt.y.z": 2e-3}

    def visit(seed: int, **changed: float) -> list[Readings]:
        machine = og.Machine.nominal().with_parameters(told | changed)
        sheet = instrument_sheet(machine, "tcp")
        exact = factor_of(sheet, machine).predict(machine.model, machine.values)
        noise = 5e-6 * np.random.default_rng(seed).standard_normal(len(sheet))
        tracker = replace(sheet, reading=exact + noise, sigma=np.full(len(sheet), 5e-6))
        return [simulate(machine, seed=seed), tracker]

    found = check(visit(1), visit(2, **{"joint_offset.x": 0.2e-3}), og.Machine.nominal())
    changed = {str(d.parameter): d for d in found.differences if d.changed}
    assert list(changed) == ["joint_offset.x"]
    by = changed["joint_offset.x"]
    assert by.after - by.before == pytest.approx(-1e-3, abs=4 * by.sigma)
    alone = check(visit(1)[1:], visit(2, **{"joint_offset.x": 0.2e-3})[:1], og.Machine.nominal())
    (only,) = (d for d in alone.differences if str(d.parameter) == "joint_offset.x")
    assert only.after - only.before == pytest.approx(-1e-3, abs=4 * only.sigma)
    assert by.sigma < only.sigma


def probed(instrument: str, seed: int, **errors: float) -> Readings:
    """A linear delta that nobody calibrated, whose bed has three lobes, with a cause or without."""
    own = {"joint_offset.a": 4e-4, "axis_offset.b.radial": 3e-4, "plate_trefoil.bed.cos": 8e-5}
    rig = DeltaRig(errors={**own, **errors})
    return measured(rig, np.random.default_rng(seed), machine=delta(), instrument=instrument)


@pytest.mark.thorough
def test_a_tower_set_upright_between_two_visits_of_a_tracker(tmp_path: Path) -> None:
    """Independent machines, files and the command line: what changed, and by how much."""
    delta().save(tmp_path / "machine.toml")
    for name, error in (("old", 4e-3), ("new", 0.0)):
        read = probed("tool coordinates", 1 if error else 2, **{"axis_tilt.c.radial": error})
        (setup,) = read.setups  # called as one likes at each visit
        read = replace(read, setups=(replace(setup, name=name),))
        (tmp_path / f"{name}.csv").write_text(campaign_text(read, delta().spec))
    files = (tmp_path / "old.csv", tmp_path / "new.csv")
    told = run("check", *files, "--machine", tmp_path / "machine.toml", "--out", tmp_path / "out")
    assert told.exit_code == 0, told.output
    first = " ".join(told.stdout.split()).partition(" - ")[0]
    assert first.startswith("- Axis tilt of leg c toward the outside (or the rail tilt of leg c")
    table = csv.DictReader(io.StringIO((tmp_path / "out" / "changes.csv").read_text()))
    changed = {
        row["parameter"]: float(row["difference"]) for row in table if row["changed"] == "yes"
    }
    assert changed == {"axis_tilt.c.radial": pytest.approx(-4e-3, abs=3e-4)}
    assert "The report of new<" in (tmp_path / "out" / "check.html").read_text()


@pytest.mark.thorough
def test_a_frame_squared_between_two_meshes_ends_in_a_class() -> None:
    twist = {f"rail_tilt.{leg}.tangential": 5e-3 for leg in "abc"}
    old, new = probed("probe", 1, **twist), probed("probe", 2)
    found = check([replace(old, name="old")], [replace(new, name="new")], delta())
    told = found.sentences[0]
    assert "changed" in told
    for member, size in (("plate trefoil of setup bed", 0.075), ("rail tilt", 5.0)):
        by = re.search(rf"{member}[^()]*? by \N{{MINUS SIGN}}([\d.]+) (?:mm|mrad)", told)
        assert by is not None, told
        assert float(by[1]) == pytest.approx(size, rel=0.3)
    # Each of the class is on the drawing, on its own parts, beside what is left.
    drawn = [o for o in found.told.picture.options if o.marks[0].label.startswith("changed by ")]
    assert len(drawn) == len(found.changes[0].members) == told.count("or the ") + 1
    assert {"rail", "plate"} <= {mark.part for o in drawn for mark in o.marks}
    # The lobes of the bed are there still: of the new readings alone.
    every = {one.name for cause in found.verdict.effects for one in cause.explanations}
    assert "plate_trefoil.bed.cos" in every
    same = check([replace(new, name="old")], [replace(probed("probe", 3), name="new")], delta())
    assert same.changes == ()
    (move,) = same.moves  # its stand tilts the plate anew
    one, other = (np.random.default_rng(seed).normal(0, 1e-3, 3)[:2] for seed in (2, 3))
    along = np.deg2rad(move.toward)
    rise = move.rise * np.array([np.cos(along), np.sin(along)])
    assert rise == pytest.approx(0.12 * (other - one), abs=1.5e-5)
    assert same.sentences[1].startswith("nothing else changed")


def plate_moved(higher: float, along: tuple[float, float], **errors: float) -> Check:
    """Two visits of one probe to a plate, raised and tilted between them, as in docs/files.md: a
    reading is the height of the tool above it.
    """
    old, new = probed("probe", 1), probed("probe", 1, **errors)  # of one plane
    p = delta().forward(new.command)
    noise = np.random.default_rng(5).normal(0, 1.8e-5, len(new))
    reading = new.reading - higher - p[:, :2] @ np.array(along) + noise
    return check([replace(old, name="old")], [replace(new, reading=reading, name="new")], delta())


@pytest.mark.thorough(except_for=["-0.00025-along1-said1"])
@pytest.mark.parametrize(
    ("higher", "along", "said"),
    [
        (5e-4, (0.0, 3e-3), "lies 0.50 mm higher than before and is tilted against before: its rim "
         "rises by 0.36 mm toward 90 degrees"),
        (-2.5e-4, (-2e-3, 0.0), "lies 0.25 mm lower than before and is tilted against before: its "
         "rim rises by 0.24 mm toward 180 degrees"),
        (3e-4, (0.0, 0.0), "lies 0.30 mm higher than before: an endstop"),
    ],
)  # fmt: skip
def test_a_plate_that_lies_elsewhere_is_told_with_its_sign(
    higher: float, along: tuple[float, float], said: str
) -> None:
    """Height and slopes of each setup are free in every fit: nothing had changed."""
    found = plate_moved(higher, along)
    first, rest, *_ = found.sentences
    numbers = r"(?<= )[\d.]+(?= (?:mm|degrees))"
    assert re.sub(numbers, "#", first).startswith(
        f"at equal commands the plate of bed {re.sub(numbers, '#', said)}"
    )
    for told, true in zip(re.findall(numbers, first), re.findall(numbers, said), strict=True):
        assert float(told) == pytest.approx(float(true), abs=2 if "." not in true else 0.015)
    assert first.endswith("these readings cannot tell which")
    assert rest.startswith("nothing else changed")
    assert found.line.startswith("Changed: where the plate lies. ")


@pytest.mark.thorough
def test_a_plate_that_lies_where_it_lay_is_not_told() -> None:
    assert plate_moved(8e-5, (5e-4, 0.0)).moves == ()
    (move,) = plate_moved(0.0, (0.0, 0.0), **{"leg_length.b": 3e-4}).moves
    assert move.higher
    assert move.rise


@pytest.mark.thorough
def test_a_plate_of_a_small_machine_moves_by_less() -> None:
    """Half the thickness of paper, of bars of 31 mm."""
    spec = MachineFile(
        geometry=Geometry(0.031, 0.008, 0.0031, (-0.01, 0.006)),
        instruments={"plate": Instrument(1e-7, 1e-6)},
    )
    stage = og.Machine(spec)
    sheet = instrument_sheet(stage, "plate")
    old = simulate(stage, sheet, seed=1)
    new = replace(old, reading=old.reading - 5e-5)
    (move,) = check([replace(old, name="old")], [replace(new, name="new")], stage).moves
    assert "lies 0.05 mm higher" in move.words


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
    unit = units.MM
    parameters = [CATALOGUE.parameter(f"joint_offset.{leg}") for leg in "xyz"]
    moved = Difference(parameters[0], 0.0, 1e-3, 1e-5, unit, True)
    still = Difference(parameters[1], 0.0, 1e-5, 1e-5, unit, False)
    apart = Difference(parameters[2], 0.0, 5e-5, 1e-5, unit, False)
    found = Check(("a",), ("b",), None, (moved, still, apart))  # type: ignore[arg-type]
    _, within, beyond = found.sentences
    assert within == (
        "nothing else changed beyond its uncertainty: joint offset of leg y +0.010 ± 0.010 mm"
    )
    assert "need no change" in beyond
    assert "joint offset of leg z +0.050 ± 0.010 mm" in beyond


def visit(seed: int, *kinds: str, **changed: float) -> list[Readings]:
    """A delta read by one instrument after the other, a file each."""
    true, rng = delta().with_parameters(ENDSTOPS | changed), np.random.default_rng(seed)
    read = []
    for kind in kinds:
        sheet = instrument_sheet(delta(), kind)
        near = replace(sheet, reading=np.where(np.isfinite(sheet.reading), sheet.reading, 0.0))
        read.append(og.simulate(true, near, seed=int(rng.integers(1 << 20))))
    return read


ENDSTOPS = {"joint_offset.a": 7e-4, "joint_offset.b": -4e-4}


@pytest.mark.thorough
def test_visits_with_other_instruments_are_compared_by_what_each_leaves_open() -> None:
    """A link that was exchanged was told as three lengths: what changed is not searched for where
    other instruments see other errors.
    """
    for changed in ({}, {"parallelogram_width.a": 6e-4}):
        now = visit(2, "tcp", **changed)
        found = check(visit(1, "plate", "incline"), now, delta())
        assert [str(d.parameter) for d in found.differences if d.changed] == list(changed)
        for one in found.differences:
            if one.changed:
                assert one.after - one.before == pytest.approx(6e-4, abs=3 * one.sigma)


@pytest.mark.thorough
@pytest.mark.parametrize("kinds", [("tcp",), ("plate", "tcp")], ids="-".join)
def test_a_visit_may_stand_in_several_files(kinds: tuple[str, ...]) -> None:
    """Where one file of a visit had another instrument than the other, nothing had changed: sigmas
    were those of two fits that leave all open.
    """
    found = check(visit(1, "tcp", "plate"), visit(2, *kinds, **{"joint_offset.a": 1.2e-3}), delta())
    (moved,) = (d for d in found.differences if d.changed)
    assert str(moved.parameter) == "joint_offset.a"
    assert moved.after - moved.before == pytest.approx(5e-4, abs=3 * moved.sigma)
    assert moved.sigma < 5e-5
