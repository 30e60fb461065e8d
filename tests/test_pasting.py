"""Which numbers a printer's owner is told to enter, and where z = 0 is with them."""

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.closing import Verdict, close_loop
from orthoglide.diagnosis.rest import rest_by_setup
from orthoglide.klipper import AGAIN, Imported, import_printer
from orthoglide.klipper.corrections import Corrections
from orthoglide.klipper.left import Left, left_of
from orthoglide.machine import Machine
from orthoglide.machine_file import Firmware, machine_text, parse_machine_file
from orthoglide.planning.suggestions import repeating
from orthoglide.report import report_files
from tests.klipper_files import DATA, simulated_cfg
from tests.rig_delta import DeltaRig

NUMBERS = Firmware(0.163, (210.0, 330.0, 90.0), (0.345,) * 3, (0.3,) * 3)
OFF = {"joint_offset.a": 4e-4, "joint_offset.b": -3e-4}


def imported(folder: Path, text: str) -> Imported:
    (folder / "printer.cfg").write_text(text)
    return import_printer(folder / "printer.cfg")


def made_of(verdict: Verdict) -> Corrections:
    assert verdict.firmware is not None
    assert verdict.firmware.corrections is not None
    return verdict.firmware.corrections


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
        made_of(close_loop(list(every), machine))
        for every in (found.campaigns, found.campaigns[::-1])
    )
    assert one.new.endstop == pytest.approx(other.new.endstop, abs=2e-6)
    assert one.height == pytest.approx(other.height, abs=2e-6)
    assert one.height[1] > 0.8e-4
    first, second = (left for left in one.left if left.kind == "heights")
    assert first.new == pytest.approx(second.new, abs=1e-5)  # in the middle of the two
    assert first.new == pytest.approx(0.9e-4, abs=2e-5)


def test_z_0_belongs_to_the_heights_that_the_firmware_set_it_by() -> None:
    found = import_printer(DATA / "t1-stock.cfg")
    for every in (found.campaigns, found.campaigns[::-1]):
        made = made_of(close_loop(list(every), Machine(found.machine)))
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
        (left,) = left_of(old, new, [mesh], relative)
        for firmware, told in ((old, left.old), (new, left.new)):
            h = mesh.command + old.zero - old.at_endstop + firmware.at_endstop
            off = firmware.points(h)[:, 2] - mesh.reading
            off -= off.mean() if relative else 0.0
            assert told == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
    calibration = import_printer(DATA / "v400-april.cfg").campaigns[0]
    firmware = import_printer(DATA / "v400-april.cfg").machine.printer
    assert firmware is not None
    one, other = (
        next(x for x in left_of(firmware, firmware, [c], relative=False) if x.kind == "distances")
        for c in (calibration, replace(calibration, reading=calibration.reading * 1.003))
    )
    assert other.old == pytest.approx(one.old, rel=0.01)  # a part's shrinkage does not count
    assert one.count == 12


@pytest.mark.parametrize(
    ("height", "left", "said"),
    [
        ((1e-4, 5e-5), (9e-5, 4e-5), ""),
        ((1e-4, 9.7e-5), (9e-5, 4e-5), "by what is known the new ones are hardly better"),
        ((1e-4, 5e-5), (9e-5, 9.5e-5), "leave 0.095 mm rms with the new ones, and 0.090 mm with"),
        ((1e-4, 5e-5), (9e-5, 8.8e-5), "leave 0.088 mm rms with the new ones"),
    ],
)
def test_numbers_must_do_better_by_the_firmware_too(
    height: tuple[float, float], left: tuple[float, float], said: str
) -> None:
    own = (Left("mesh", "heights", 25, *left),)
    made = Corrections(NUMBERS, NUMBERS, height, (1e-4, 1e-4), own)
    assert said in made.keep
    assert bool(made.keep) == bool(said)


@pytest.mark.thorough(except_for=["v400-april"])
@pytest.mark.parametrize(
    "name", ["t1-stock", "v400-april", pytest.param("flight505", marks=pytest.mark.thorough)]
)
def test_heights_that_the_numbers_were_fitted_to_give_no_new_ones(name: str) -> None:
    """With distances or without."""
    found = import_printer(DATA / f"{name}.cfg")
    verdict = close_loop([found.campaigns[0]], Machine(found.machine))
    assert made_of(verdict).keep
    assert not [action for action in verdict.actions if action.kind == "zeros"]
    if verdict.stands:
        assert "Keep the stored numbers: " in " ".join(str(verdict).split())


@pytest.mark.thorough
def test_what_is_left_stands_on_the_page_and_in_the_file(tmp_path: Path) -> None:
    found = imported(tmp_path, simulated_cfg(DeltaRig(errors=OFF), count=5))
    verdict = close_loop(list(found.campaigns), Machine(found.machine))
    files = report_files(verdict)
    made = made_of(verdict)
    (row,) = made.left_rows
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
    kept = {**found.machine.provenance["klipper"], AGAIN: True}
    spec = parse_machine_file(machine_text(replace(found.machine, provenance={"klipper": kept})))
    verdict = close_loop(list(found.campaigns), Machine(spec))
    assert verdict.actions[0].words.startswith("Run DELTA_CALIBRATE and SAVE_CONFIG")
    assert not [action for action in verdict.actions if action.kind == "zeros"]
    text = " ".join(str(verdict).split())
    assert text.startswith("Run DELTA_CALIBRATE")
    assert "Do not enter these numbers yet: DELTA_CALIBRATE comes first" in text
    assert "To paste" not in str(report_files(verdict)["report.html"])


@pytest.mark.thorough
@pytest.mark.parametrize("beside", [0.0, 25.5])
def test_a_probe_beside_the_nozzle_is_calibrated_after_new_numbers(
    beside: float, tmp_path: Path
) -> None:
    """A radius that is wrong bends the plate between the probe and the nozzle."""
    errors = {f"axis_offset.{leg}.radial": 2e-3 for leg in "abc"}
    text = simulated_cfg(DeltaRig(errors=errors), count=7)
    found = imported(tmp_path, text.replace("z_offset:", f"x_offset: {beside}\nz_offset:"))
    verdict = close_loop(list(found.campaigns), Machine(found.machine))
    made = made_of(verdict)
    (action,) = (action for action in verdict.actions if action.kind == "zeros")
    assert ("before a new mesh, run PROBE_CALIBRATE" in action.words) == (beside > 0)
    assert ("RESTART, run PROBE_CALIBRATE and SAVE_CONFIG, as" in made.where) == (beside > 0)
    assert (abs(made.offset) > 2e-5) == (beside > 0)


def test_places_to_read_again_are_the_firmware_s() -> None:
    """Arms that differ by 2.6 mm put them elsewhere than alike ones, and below the bed."""
    found = import_printer(DATA / "v400-april.cfg")
    estimate = og.identify([found.campaigns[0]], Machine(found.machine))
    firmware = found.machine.printer
    assert firmware is not None
    for one in rest_by_setup(estimate):
        words = repeating(one).reason
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
