"""Which numbers a printer's owner is told to enter, and where z = 0 is with them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.add_ons import Corrections
from orthoglide.closing import RunOutcome
from orthoglide.control.delta_numbers import Gain, PlateErrors
from orthoglide.firmware.klipper import Imported, Printer, import_printer
from orthoglide.firmware.klipper.new_numbers import rejection_reason, residual_changes
from orthoglide.firmware.klipper.numbers import (
    Numbers,
    ResidualChange,
    corrections_of,
    make_paste,
    make_record,
)
from orthoglide.machine import Machine
from orthoglide.machine_file import machine_text, parse_machine_file
from orthoglide.planning.instrument_choice import _proposals
from orthoglide.report import report_files
from orthoglide.result import Result
from orthoglide.verdict import close_loop
from tests.klipper_files import DATA, imported, simulated_cfg
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_cli import run

FIELD = Path(__file__).parent / "data" / "field"
NUMBERS = Numbers(0.163, (210.0, 330.0, 90.0), (0.345,) * 3, (0.3,) * 3)
Share = tuple[float, float]
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
        ([("heights", 25, 9e-5, 1.2e-4)], "heights of mesh rises from 0.090 to 0.120 mm rms"),
        ([("heights", 25, 9e-5, 9.5e-5)], "rises from 0.090 to 0.095 mm rms"),  # 18 um of noise
        (
            [("heights", 25, 9e-5, 9.2e-5)],
            "goes from 0.090 to 0.092 mm rms, which is less than 5 % or no more than",
        ),
        (
            [("heights", 400, 9e-5, 8.8e-5)],
            "goes from 0.090 to 0.088 mm rms, which is less than 5 % or no more than",
        ),
        (
            [("heights", 13, 1.6e-5, 1.1e-5)],
            "goes from 0.016 to 0.011 mm rms, which is less than 5 % or no more than",
        ),
        ([("heights", 6, 3e-4, 0.0)], "6 numbers fit any 6 touches of the plate, right or wrong"),
        # Seven heights that six numbers were fitted to have a residual below their noise.
        ([("heights", 25, 9e-5, 4e-5), ("heights", 7, 3e-6, 1.7e-5)], ""),
        ([("heights", 7, 2e-5, 2e-5), ("distances", 12, 2e-3, 4e-5)], ""),
        (
            [("heights", 25, 9e-5, 4e-5), ("heights", 7, 3e-5, 1e-4)],
            "rises from 0.030 to 0.100 mm rms",
        ),
        ([("heights", 25, 9e-5, 4e-5), ("heights", 7, 9e-5, 9e-5)], ""),
        ([("heights", 25, 9e-5, 4e-5), ("distances", 12, 6e-5, 2e-4)], "of the distances of mesh"),
    ],
)
def test_numbers_must_do_better_by_the_firmware_in_every_file(
    left: list[tuple[str, int, float, float]], said: str
) -> None:
    found = rejection_reason([ResidualChange("mesh", *one) for one in left])
    assert said in found
    assert bool(found) == bool(said)


def test_numbers_that_are_not_expected_to_be_better_are_not_offered() -> None:
    """Of a sound printer: they fitted distances of a part that shrank, and with them the nozzle was
    0.024 mm rms off over the plate, against 0.011 mm. Now they leave such distances as they are.
    """
    found = import_printer(FIELD / "sound-with-distances" / "printer.cfg")
    made = made_of(studied(list(found.campaigns), Machine(found.machine)))
    (_, before, after) = next(row for row in made.left if "distances" in row[0])
    assert float(after) == pytest.approx(float(before), abs=0.01)
    assert "no more than chance" in made.keep
    tried = Numbers.from_table(made.kept["tried"])
    assert tried.arm == made.old.arm


@pytest.mark.parametrize(
    ("weighted", "height", "along", "said"),
    [
        ((3e-5, 1e-6), (3e-5, 1e-6), (1e-4, 2e-5), ""),
        ((3e-5, 1e-6), (3e-5, 1e-6), (-1e-5, 6e-5), ""),  # within its standard deviation
        ((3e-5, 1e-6), (3e-5, 1e-6), (-2e-4, 2e-5), "0.200 ± 0.020 mm more along the plate"),
        ((3e-5, 1e-6), (-4e-5, 3e-6), (8e-4, 1e-4), "0.0400 ± 0.0030 mm more in height"),
        ((1e-6, 8e-6), (1e-6, 8e-6), (0.0, 4e-5), "the expected gain, "),
        ((1e-5, 1e-6), (0.0, 2e-6), (8e-4, 1e-4), ""),  # along the plate alone
    ],
)
def test_numbers_must_improve_the_tool_of_the_posterior(
    weighted: Share, height: Share, along: Share, said: str
) -> None:
    found = Gain(weighted, height, along, 1e-4).lack
    assert said in found
    assert bool(found) == bool(said)


def test_a_gain_along_the_plate_counts_what_touches_do_not_show() -> None:
    """Rods of another length and a bowl of the plate: of a firmware's numbers as of sizes, and rods
    that were measured leave the bowl alone.
    """
    found = import_printer(DATA / "t1-stock.cfg")
    numbers, machine = found.machine.printer.numbers, Machine(found.machine)
    angle = np.arange(12) * np.pi / 6
    places = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    places = np.concatenate([places, places / 2])

    def computes(change: np.ndarray, commands: np.ndarray) -> np.ndarray:
        return numbers.changed(change).points(commands + numbers.zero)

    def sigma(arms_seen: bool) -> float:
        errors = PlateErrors(machine, computes, places, 0 * places[:, 0], 0.03, True, arms_seen)
        wider = places * [1.002, 1.002, 1.0]
        return errors.gain(wider - places, 0 * places).along[1]

    assert sigma(arms_seen=True) > 1e-5
    assert sigma(arms_seen=False) > 1.5 * sigma(arms_seen=True)


def test_a_printed_part_is_judged_without_its_size() -> None:
    """How far it shrank is not known, so numbers of another scale are not rejected for it."""
    stored = import_printer(DATA / "v400-april.cfg")
    numbers, (calibration, *_) = stored.machine.printer.numbers, stored.campaigns
    wrong = replace(
        calibration, reading=calibration.reading * np.where(calibration.paired, 1.01, 1)
    )
    metal = replace(
        wrong, setups=tuple(replace(s, material="metal" if s.observation.paired else "")
                            for s in wrong.setups),
    )  # fmt: skip
    for readings, limit in ((calibration, 1e-4), (wrong, 1e-4), (metal, 1e-2)):
        (_, apart) = residual_changes(numbers, numbers, [readings], False, free_size=True)
        assert limit / 100 < apart.new < limit
    assert apart.new > 5e-4  # of metal, whose size is known


def test_the_reading_that_rejects_numbers_is_named() -> None:
    """A crumb under one touch of the calibration had vetoed numbers without a word on it."""
    change = ResidualChange("calibration", "heights", 7, 2.5e-5, 4.7e-5, "line 3, +0.081 mm")
    assert "largest at line 3, +0.081 mm: take that reading again" in rejection_reason([
        ResidualChange("mesh", "heights", 81, 6e-5, 1e-5), change
    ])  # fmt: skip
    stored = import_printer(DATA / "v400-april.cfg")
    numbers, (calibration, *_) = stored.machine.printer.numbers, stored.campaigns
    reading = calibration.reading.copy()
    reading[2] -= 2e-3
    (heights, _) = residual_changes(
        numbers, numbers, [replace(calibration, reading=reading)], False
    )
    assert heights.largest.startswith(f"line {calibration.line[2]}, +")


def test_one_reading_or_a_noisy_probe_rejects_no_numbers() -> None:
    """Six numbers fit seven touches however noisy, and a speck under one of them too."""
    gain = ResidualChange("mesh", "heights", 81, 6e-5, 3e-5)
    rise = ResidualChange("calibration", "heights", 7, 1.3e-5, 4e-5)
    assert "calibration rises from 0.013 to 0.040 mm" in rejection_reason([gain, rise])
    assert not rejection_reason([gain, rise], touch_noise=5e-5)
    assert not rejection_reason([gain, replace(rise, others=(1.3e-5, 1.4e-5))])


def test_numbers_that_are_advised_are_the_finding(tmp_path: Path) -> None:
    """A mesh has a plane of its own, beside which an endstop leaves no residual: nothing was wrong,
    and then numbers were advised.
    """
    found = imported(tmp_path, simulated_cfg(DeltaRig(errors={"joint_offset.b": 2.4e-4}), count=5))
    verdict = close_loop(list(found.campaigns), Machine(found.machine))
    assert verdict.actions[0].words.startswith("Enter the numbers")
    assert str(verdict).startswith("The firmware's numbers are off, above all position_endstop")


def test_the_warning_on_unequal_arms_is_given_once(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    for command in (
        ("import", "klipper", DATA / "v400-april.cfg", "--out", folder),
        ("identify", folder / "calibration.csv", "--machine", folder / "machine.toml", "--out",
         tmp_path / "out"),
    ):  # fmt: skip
        text = " ".join(run(*command).output.split())
        assert text.count("The arms that the firmware stores") == 1


def test_owners_of_distances_are_asked_for_more_of_them() -> None:
    found = import_printer(FIELD / "print-shrunk-with-mesh" / "printer.cfg")
    machine = Machine(found.machine)
    for campaigns, more in ((found.campaigns, True), (found.campaigns[1:], False)):
        briefs = [p.brief for p in _proposals(og.identify(list(campaigns), machine).problem)]
        assert ("more distances between holes or pillars" in briefs) == more
        assert ("distances between holes or pillars" in briefs) != more


@pytest.mark.parametrize(
    ("arms", "warned"), [((0.345, 0.345, 0.3458), True), ((0.3458,) * 3, False)]
)
def test_new_arms_that_differ_are_to_be_measured(arms: tuple[float, ...], warned: bool) -> None:
    """Import would say that rods of one set are not so: what offers the numbers says it too."""
    left = [ResidualChange("mesh", "heights", 25, 9e-5, 4e-5)]
    for rods_measured in (False, True):
        record = make_record(NUMBERS, replace(NUMBERS, arm=arms), left, "", rods_measured)
        words = corrections_of(NUMBERS, record).words
        said = "the new arms differ by 0.80 mm, more than rods of one set do: measure the rods"
        assert (said in words) == (warned and not rods_measured)


def test_numbers_that_an_earlier_version_kept_are_pasted() -> None:
    kept = {"new": NUMBERS.as_dict(), "height_rms_mm": [0.1, 0.05], "keep_old_because": ""}
    found = make_paste(NUMBERS, kept)
    assert found.facts == {"old": NUMBERS.as_dict(), **kept}
    assert any("delta_radius: 163.000000" in text for text in found.paragraphs)
    for edited in (None, {}, {"new": "x"}, {**kept, "left_of_readings": [{"file": "mesh"}]}):
        assert "missing" in make_paste(NUMBERS, edited).facts


def words_with_shorter_rods(*changes: ResidualChange) -> str:
    """What is said of new numbers with shorter rods that change residuals so."""
    new = replace(NUMBERS, arm=(0.344,) * 3)
    return corrections_of(NUMBERS, make_record(NUMBERS, new, [*changes], "", False)).words


def test_what_new_numbers_gain_is_told_of_the_readings_that_they_fit_better() -> None:
    """Of heights alone, numbers that distances asked for were offered as slightly worse ones."""
    heights = ResidualChange("calibration", "heights", 7, 3e-6, 1.6e-5)
    distances = ResidualChange("calibration", "distances", 12, 2.56e-4, 3.4e-5)
    words = words_with_shorter_rods(heights, distances)
    assert "residual of the distances of calibration changes from 0.256 to 0.034 mm rms" in words
    assert "the new numbers make the rods shorter, as the distances say" in words
    words = words_with_shorter_rods(replace(heights, new=2e-6), distances)
    assert "the residual of heights over the plate changes from 0.003 to 0.002 mm rms" in words


@pytest.mark.parametrize(("rods", "said"), [(0.3419, True), (0.3452, False), (0.0, False)])
def test_rods_that_heights_alone_ask_for_are_to_be_measured(rods: float, said: bool) -> None:
    left = [ResidualChange("mesh-default", "heights", 61, 3.7e-5, 2.6e-5)]
    record = make_record(NUMBERS, NUMBERS, left, "", False, (), rods)
    words = corrections_of(NUMBERS, record).words
    assert ("the heights alone ask for rods of 341.9 mm, or the plate has lobes" in words) == said


def test_the_firmware_s_own_calibration_comes_first(tmp_path: Path) -> None:
    found = imported(tmp_path, simulated_cfg(DeltaRig(errors=OFF), count=5))
    kept = {**found.machine.provenance["klipper"], "calibrate_again": True}
    spec = parse_machine_file(machine_text(replace(found.machine, provenance={"klipper": kept})))
    verdict = close_loop(list(found.campaigns), Machine(spec))
    assert verdict.actions[0].words.startswith("Run DELTA_CALIBRATE and SAVE_CONFIG")
    assert not [action for action in verdict.actions if action.kind == "zeros"]
    text = " ".join(str(verdict).split())
    assert text.startswith("Run DELTA_CALIBRATE")
    assert "Do not enter these numbers yet: the firmware's own calibration" in text
    assert "To paste" not in str(report_files(verdict)["report.html"])


def test_numbers_that_the_verdict_forbids_are_not_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of an unexplained residual they stood as *new*, above the sentence that forbids them."""
    found = imported(tmp_path, simulated_cfg(DeltaRig(errors=OFF), count=5))
    verdict = close_loop(list(found.campaigns), Machine(found.machine))
    assert "[printer] delta_radius" in str(verdict)
    monkeypatch.setattr(Result, "stands", False)
    said, page = str(verdict), str(report_files(verdict)["report.html"])
    assert "Do not enter these numbers yet: a residual remains" in said
    for text in (said, page):
        assert "[printer] delta_radius" not in text
        assert "tried" in text
