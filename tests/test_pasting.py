"""Which numbers a printer's owner is told to enter, and where z = 0 is with them."""

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.add_ons import Corrections
from orthoglide.closing import RunOutcome, build_result
from orthoglide.explanation.lack_of_fit import residual_by_setup
from orthoglide.firmware.klipper import Imported, Printer, import_printer
from orthoglide.firmware.klipper.corrections import ResidualChange, make_paste
from orthoglide.firmware.klipper.new_numbers import rejection_reason, residual_changes
from orthoglide.firmware.klipper.numbers import Numbers
from orthoglide.firmware.klipper.provenance import CALIBRATE_AGAIN_KEY
from orthoglide.machine import Machine
from orthoglide.machine_file import machine_text, parse_machine_file
from orthoglide.planning import suggest_repeating
from orthoglide.report import report_files
from orthoglide.verdict import Verdict, close_loop
from tests.klipper_files import DATA, imported, simulated_cfg
from tests.rig_delta import DeltaRig
from tests.studied import studied

FIELD = Path(__file__).parent / "data" / "field"
NUMBERS = Numbers(0.163, (210.0, 330.0, 90.0), (0.345,) * 3, (0.3,) * 3)
OFF = {"joint_offset.a": 4e-4, "joint_offset.b": -3e-4}


def made_of(closed: RunOutcome) -> Corrections:
    assert closed.corrections is not None
    return closed.corrections


def two_meshes(folder: Path, higher: float) -> Imported:
    """The second lies higher, metres, and is the same otherwise."""
    one = simulated_cfg(DeltaRig(errors=OFF), count=5)
    block = simulated_cfg(DeltaRig(errors=OFF), count=5, seed=1)
    block = block.partition("#*# [bed_mesh default]")[2]
    block = re.sub(r"-?\d\.\d{6}", lambda m: f"{float(m[0]) + higher * 1e3:.6f}", block)
    return imported(folder, f"{one}#*# [bed_mesh other]{block}")


def test_z_0_does_not_hang_on_the_order_of_files(tmp_path: Path) -> None:
    """Of two meshes that lie 0.18 mm apart nobody knows which is right, and that is promised."""
    found = two_meshes(tmp_path, 1.8e-4)
    assert not found.apart
    machine = Machine(found.machine)
    one, other = (
        made_of(studied(list(every), machine)) for every in (found.campaigns, found.campaigns[::-1])
    )
    assert one.new.endstop == pytest.approx(other.new.endstop, abs=2e-6)
    assert one.height == pytest.approx(other.height, abs=2e-6)
    first, second = (float(new) for _, _, new in one.left)
    assert first == pytest.approx(second, abs=0.01)  # in the middle of the two
    assert first == pytest.approx(0.09, abs=0.02)


def test_z_0_belongs_to_the_heights_that_the_firmware_set_it_by() -> None:
    found = import_printer(DATA / "t1-stock.cfg")
    for every in (found.campaigns, found.campaigns[::-1]):
        made = made_of(studied(list(every), Machine(found.machine)))
        heights = found.campaigns[0]
        old = made.old
        travel = heights.command + old.zero - old.at_endstop + made.new.at_endstop
        off = made.new.points(travel)[:, 2] - heights.reading
        assert abs(off.mean()) < 1e-5


def test_what_the_firmware_makes_of_the_readings(tmp_path: Path) -> None:
    """By its equations, as they stand in `Firmware`: heights, and the same of relative meshes."""
    found = two_meshes(tmp_path, 1e-4)
    old, mesh = NUMBERS, found.campaigns[1]
    new = replace(old, delta_radius=old.delta_radius + 2e-4, endstop=(0.3003, 0.3003, 0.3003))
    for relative in (False, True):
        (left,) = residual_changes(old, new, [mesh], relative)
        for firmware, told in ((old, left.old), (new, left.new)):
            h = mesh.command + old.zero - old.at_endstop + firmware.at_endstop
            off = firmware.points(h)[:, 2] - mesh.reading
            off -= off.mean() if relative else 0.0
            assert told == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
    stored = import_printer(DATA / "v400-april.cfg")
    printer, (calibration, *_) = stored.machine.printer, stored.campaigns
    assert isinstance(printer, Printer)
    heights, apart = residual_changes(printer.numbers, printer.numbers, [calibration], False)
    assert (heights.kind, heights.count, apart.kind, apart.count) == ("heights", 7, "distances", 12)
    wrong = replace(calibration, reading=calibration.reading * 1.003)
    (_, larger) = residual_changes(printer.numbers, printer.numbers, [wrong], False)
    assert larger.old > 1.5 * apart.old  # rods that are too short make all distances too short


@pytest.mark.parametrize(
    ("left", "said"),
    [
        ([("heights", 25, 9e-5, 4e-5)], ""),
        ([("heights", 25, 9e-5, 9.5e-5)], "heights of mesh rises from 0.090 to 0.095 mm rms"),
        ([("heights", 400, 9e-5, 8.8e-5)], "too little, from 0.090 to 0.088 mm rms"),
        ([("heights", 13, 1.6e-5, 1.1e-5)], "too little, from 0.016 to 0.011 mm"),  # less by chance
        (
            [("heights", 25, 9e-5, 4e-5), ("heights", 7, 9e-5, 1e-4)],
            "rises from 0.090 to 0.100 mm rms",
        ),
        ([("heights", 25, 9e-5, 4e-5), ("heights", 7, 9e-5, 9e-5)], ""),
        ([("heights", 25, 9e-5, 4e-5), ("distances", 12, 9e-5, 1e-4)], "of the distances of mesh"),
    ],
)
def test_numbers_must_do_better_by_the_firmware_in_every_file(
    left: list[tuple[str, int, float, float]], said: str
) -> None:
    found = rejection_reason([ResidualChange("mesh", *one) for one in left])
    assert said in found
    assert bool(found) == bool(said)


@pytest.mark.parametrize(
    "name", ["printer", pytest.param("printer-with-mesh", marks=pytest.mark.thorough)]
)
def test_rods_that_were_entered_too_short_are_found_by_distances(name: str) -> None:
    """Rods of 272 mm entered as 268, and twelve distances that are all one per cent too long."""
    found = import_printer(FIELD / "rods-entered-4mm-short" / f"{name}.cfg")
    made = made_of(studied(list(found.campaigns), Machine(found.machine)))
    assert not made.keep
    assert np.abs(np.array(made.new.arm) - 0.272).max() < 6e-4
    (size,) = re.findall(r"most of all arm_length of tower b by \+(\d\.\d{3}) mm", made.words)
    assert float(size) == pytest.approx((made.new.arm[1] - made.old.arm[1]) * 1e3, abs=1e-3)
    assert re.search(r"they have longer rods, as distances say.*: measure a rod first", made.words)
    mesh = import_printer(FIELD / "rods-entered-4mm-short" / "printer-with-mesh.cfg").campaigns[1]
    (unused,) = residual_changes(found.machine.printer.numbers, made.new, [mesh], False)
    assert unused.new < 0.7 * unused.old


def test_numbers_that_an_earlier_version_kept_are_pasted() -> None:
    kept = {"new": NUMBERS.as_dict(), "height_rms_mm": [0.1, 0.05], "keep_old_because": ""}
    found = make_paste(NUMBERS, kept)
    assert found.facts == {"old": NUMBERS.as_dict(), **kept}
    assert any("delta_radius: 163.000000" in text for text in found.paragraphs)
    for edited in (None, {}, {"new": "x"}, {**kept, "left_of_readings": [{"file": "mesh"}]}):
        assert "missing" in make_paste(NUMBERS, edited).facts


@pytest.mark.thorough(except_for=["v400-april"])
@pytest.mark.parametrize(
    "name", ["t1-stock", "v400-april", pytest.param("flight505", marks=pytest.mark.thorough)]
)
def test_heights_that_the_numbers_were_fitted_to_give_no_new_ones(name: str) -> None:
    """With distances or without."""
    found = import_printer(DATA / f"{name}.cfg")
    verdict = close_loop([found.campaigns[0]], Machine(found.machine))
    assert verdict.corrections is not None
    assert verdict.corrections.keep
    assert not [action for action in verdict.actions if action.kind == "zeros"]
    if verdict.stands:
        assert "Do not enter new numbers: with them the residual of" in " ".join(
            str(verdict).split()
        )


@pytest.mark.thorough
def test_what_is_left_stands_on_the_page_and_in_the_file(tmp_path: Path) -> None:
    found = imported(tmp_path, simulated_cfg(DeltaRig(errors=OFF), count=5))
    closed = studied(list(found.campaigns), Machine(found.machine))
    made, verdict = made_of(closed), build_result(closed, Verdict)
    files = report_files(verdict)
    (row,) = made.left
    assert row[0] == "mesh-default, heights"
    page = re.sub(r"<[^>]*>", " ", unescape(str(files["report.html"])))
    for text in (" ".join(str(verdict).split()), " ".join(page.split())):
        assert " ".join(row) in text
    told = json.loads(files["result.json"])["firmware"]
    assert told["keep_old_because"] == ""
    (left,) = told["left_of_readings"]
    assert left["file"] == "mesh-default"
    assert left["old_rms_mm"] > 5 * left["new_rms_mm"] > 0
    assert made.new.arm == made.old.arm  # which nothing speaks against


def test_the_firmware_s_own_calibration_comes_first(tmp_path: Path) -> None:
    found = imported(tmp_path, simulated_cfg(DeltaRig(errors=OFF), count=5))
    kept = {**found.machine.provenance["klipper"], CALIBRATE_AGAIN_KEY: True}
    spec = parse_machine_file(machine_text(replace(found.machine, provenance={"klipper": kept})))
    verdict = close_loop(list(found.campaigns), Machine(spec))
    assert verdict.actions[0].words.startswith("Run DELTA_CALIBRATE and SAVE_CONFIG")
    assert not [action for action in verdict.actions if action.kind == "zeros"]
    text = " ".join(str(verdict).split())
    assert text.startswith("Run DELTA_CALIBRATE")
    assert "Do not enter these numbers yet: DELTA_CALIBRATE comes first" in text
    assert "To paste" not in str(report_files(verdict)["report.html"])


def test_places_to_read_again_are_the_firmware_s() -> None:
    """Arms that differ by 2.6 mm put them elsewhere than alike ones, and below the bed."""
    found = import_printer(DATA / "v400-april.cfg")
    estimate = og.identify([found.campaigns[0]], Machine(found.machine))
    firmware = found.machine.printer.numbers
    assert firmware is not None
    for one in residual_by_setup(estimate):
        words = suggest_repeating(one).reason
        assert "either side" not in words
        place = firmware.points(one.command[None] + firmware.zero)[0]
        x, y, *z = one.where[0].partition(" to ")[0].replace("−", "-").split(", ")
        assert float(x[2:]) == pytest.approx(place[0] * 1e3, abs=0.51)
        assert float(y[2:]) == pytest.approx(place[1] * 1e3, abs=0.51)
        if one.kind == "plate":
            assert not z
        else:
            assert float(z[0][2:]) == pytest.approx(place[2] * 1e3, abs=0.51)
            assert " to x " in one.where[0]


@pytest.mark.thorough
def test_nothing_is_judged_where_nothing_is_left_over() -> None:
    """It was said that nothing significant is left, below that it cannot be judged."""
    found = import_printer(DATA / "t1-stock.cfg")
    text = " ".join(str(close_loop([found.campaigns[0]], Machine(found.machine))).split())
    assert "too few readings are left over to judge that" in text
    assert "Verdict adequate: no single cause was added, and too few readings are left" in text
    assert "nothing significant is left" not in text
