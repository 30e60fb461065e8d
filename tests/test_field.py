"""Small inputs after public reports on which an earlier version was wrong: see data/field."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.add_ons import Corrections
from orthoglide.firmware.klipper import Imported
from orthoglide.firmware.klipper.new_numbers import distances_ask_for_rods
from orthoglide.machine_file import Controller, machine_text, parse_machine_file
from orthoglide.report.claims import claims
from orthoglide.report.sentences import headline
from tests.klipper_files import imported, simulated_cfg
from tests.rig_delta import DeltaRig
from tests.studied import studied

FIELD = Path(__file__).parent / "data" / "field"


def closed(folder: str, file: str) -> og.Verdict:
    """The readings that a printer's file holds, closed."""
    found = og.import_printer(FIELD / folder / file)
    return og.close_loop(found.campaigns, og.Machine(found.machine))


def arms_of(corrections: Corrections) -> list[float]:
    """The new arms, millimetres."""
    return [float(new) for name, _, new in corrections.rows if "arm_length" in name]


@pytest.mark.parametrize(
    "file", ["real.cfg", pytest.param("crumb-0.8mm.cfg", marks=pytest.mark.thorough)]
)
def test_seven_touches_far_beyond_their_noise_are_unexplained(file: str) -> None:
    verdict = closed("seven-touches-false-adequate", file)
    assert verdict.before.scores.lack_of_fit_p < 1e-6
    assert verdict.word == "unexplained"
    assert "read it again" in verdict.actions[0].words


def test_a_mistyped_distance_is_a_slip() -> None:
    """The arms that the firmware fitted to it were the prior of the rods, so that drives that move
    1.9 % less stood for them.
    """
    verdict = closed("distance-mistyped", "printer.cfg")
    assert not verdict.effects
    (slip,) = verdict.blunders
    assert (slip.kind, slip.setups) == ("outlier", ("rim",))
    assert "63.9 mm is −1.1" in slip.message
    assert re.search(r"calibration, line \d+, setup 'rim', distance 11: ", slip.message)
    assert "command" not in slip.message


def mistyped(folder: Path, distance: str, typed: str) -> Imported:
    """A printer's file without its mesh, one of its distances written as another number."""
    text = (FIELD / "distance-mistyped" / "printer.cfg").read_text(encoding="utf-8")
    text = re.sub(r"#\*# \[bed_mesh default\].*?(?=#\*# \[delta_calibrate\])", "", text, flags=re.S)
    text = text.replace("distance11 = 63.9", "distance11 = 65.0")
    text = re.sub(rf"distance{distance} = [0-9.]+", f"distance{distance} = {typed}", text)
    return imported(folder, text)


@pytest.mark.parametrize(
    ("distance", "typed", "off"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.thorough)
            for case in (("11", "63.9", -1.0), ("3", "73.0", 8.0))
        ),
        ("8", "63.8", -1.0),
    ],
)
def test_a_mistyped_distance_is_a_slip_without_a_mesh(
    distance: str, typed: str, off: float, tmp_path: Path
) -> None:
    found = mistyped(tmp_path, distance, typed)
    (slip,) = og.close_loop(found.campaigns, og.Machine(found.machine)).blunders
    assert slip.kind == "outlier"
    (readings,) = found.campaigns
    assert readings.posture[readings.line.tolist().index(slip.rows[0])] == distance
    (size,) = re.findall(r"mm is ([−+0-9.]+) mm off", slip.message)
    assert float(size.replace("−", "-")) == pytest.approx(off, abs=0.3)


def test_two_mistyped_distances_do_not_accuse_a_sound_one() -> None:
    """Two opposite errors of a millimetre were taken for an error of a distance between them."""
    found = og.import_printer(FIELD / "two-distances-mistyped" / "printer.cfg")
    first, second = studied(found.campaigns, og.Machine(found.machine)).blunders
    assert re.search(r"distance 0: the reading 63.77 mm is −1\.0\d mm off", first.message)
    assert re.search(r"distance 8: the reading 65.83 mm is \+1\.0\d mm off", second.message)


@pytest.mark.parametrize(
    "pillars",
    [*(pytest.param((k,), marks=pytest.mark.thorough) for k in (0, 1, 3, 5)), (2,), (4,), (1, 4)],
)
def test_a_pillar_that_leans_is_one_fault_of_its_three_distances(
    pillars: tuple[int, ...], tmp_path: Path
) -> None:
    """One of them was a slip, and shorter arms took the others; of two pillars none was named, as
    half of all distances would have been slips.
    """
    text = (FIELD / "distance-mistyped" / "printer.cfg").read_text(encoding="utf-8")
    text = text.replace("distance11 = 63.9", "distance11 = 65.0")
    off = {k: {k: 0.8, 6 + k: 0.4, 6 + (k - 1) % 6: 0.4} for k in pillars}
    of_all = {number: by for each in off.values() for number, by in each.items()}
    leaning = re.sub(
        r"(distance(\d+) = )([0-9.]+)",
        lambda m: f"{m[1]}{float(m[3]) + of_all.get(int(m[2]), 0.0):.3f}",
        text,
    )
    found = imported(tmp_path, leaning)
    faults = studied(found.campaigns, og.Machine(found.machine)).blunders
    readings = next(c for c in found.campaigns if c.paired.any())
    posture = dict(zip(readings.line.tolist(), readings.posture, strict=True))
    labels = [{posture[row] for row in fault.rows} for fault in faults]
    assert sorted(map(sorted, labels)) == sorted(sorted(map(str, off[k])) for k in pillars)
    for fault in faults:
        (size,) = re.findall(
            r"end at one place, and fit with it ([0-9.]+) mm elsewhere", fault.message
        )
        assert float(size) == pytest.approx(0.8, abs=0.35)


def test_a_slip_that_is_likelier_than_a_cause_is_told_before_it(tmp_path: Path) -> None:
    """The first sentence was of a cause of 5 %, and nothing was to be read again."""
    found = mistyped(tmp_path, "5", "64.5")
    verdict = og.close_loop(found.campaigns, og.Machine(found.machine))
    (cause,) = verdict.effects
    assert verdict.word == "ambiguous"
    assert cause.data[0].probability > cause.together
    assert not verdict.blunders
    line = cause.data[0].rows[0]
    (claim,) = claims(verdict)
    what = "A fault of the data: a slip of the reading"
    assert claim.first.brief == f"{what} in calibration, line {line}."
    assert claim.first.brief in headline(verdict)
    assert f"line {line} of calibration once more" in verdict.actions[0].words


def test_a_slip_that_is_only_likely_is_kept_and_told(tmp_path: Path) -> None:
    found = mistyped(tmp_path, "8", "65.8")
    verdict = og.close_loop(found.campaigns, og.Machine(found.machine))
    assert not verdict.blunders
    (told,) = (w for w in verdict.warnings if w.kind == "slip")
    assert re.match(
        r"possible data fault \(probability [5-8]\d %, .*\): .*distance 8: the reading 65.8 mm",
        told,
    )


@pytest.mark.parametrize(
    ("off", "said"),
    [
        (3e-4, "below the surface of all others, as a dent in the plate"),
        (-3e-4, "above the surface of all others, as a speck on the plate"),
    ],
)
def test_a_touch_off_its_surface_is_told_on_its_side(off: float, said: str) -> None:
    """It does not count. Below it was a speck, too: a reading is what the nozzle hangs above it."""
    found = og.import_printer(FIELD.parent / "delta" / "flight505.cfg")
    _, readings = found.campaigns  # the mesh
    row = int(np.argmin(np.linalg.norm(readings.command, axis=1)))
    spoilt = readings.with_readings(readings.reading + off * (np.arange(len(readings)) == row))
    fit = og.identify([spoilt], og.Machine(found.machine))
    (told,) = (w for w in fit.warnings if f"line {readings.line[row]}," in w)
    assert said in told
    assert readings.line[row] not in fit.problem.tool_factors[0].readings.line


@pytest.mark.parametrize(("off", "said"), [(-4e-4, "above"), (4e-4, "below")])
def test_neighbouring_touches_that_stand_up_alike_are_told_as_one(off: float, said: str) -> None:
    """Each hid the other in the plate's roughness, and numbers were fitted to both."""
    found = og.import_printer(FIELD.parent / "delta" / "flight505.cfg")
    _, readings = found.campaigns
    far = np.linalg.norm(readings.command - readings.command[[12, 13]].mean(axis=0), axis=1)
    rows = np.isin(np.arange(len(readings)), np.argsort(far)[:2])
    spoilt = readings.with_readings(readings.reading + off * rows)
    warnings = og.identify([spoilt], og.Machine(found.machine)).warnings
    (told,) = (w for w in warnings if "neighbouring touches" in w)
    first, second = readings.line[rows].tolist()
    assert f"lines {first} and {second}, setup" in told
    size = re.search(rf"2 neighbouring touches at .* mm are (\S+) mm {said} the surface of", told)
    assert size is not None, told
    assert float(size[1]) == pytest.approx(abs(off) * 1e3, abs=0.06)
    sound = og.identify([readings], og.Machine(found.machine)).warnings
    assert not any("neighbouring" in w for w in sound)


def test_a_hot_plate_that_bows_does_not_drift() -> None:
    """Slopes that change evenly, row by row of a mesh, bend a plate as heat does, and they were
    certain.
    """
    found = og.import_printer(FIELD.parent / "delta" / "flight505.cfg")
    (*_, cold), machine = found.campaigns, og.Machine(found.machine)
    assert machine.spec.kinematics is not None
    x, y, _ = machine.spec.kinematics.places(cold.command).T
    bowl = 1.2e-4 * (x**2 + y**2) / np.max(x**2 + y**2)
    noise = 1e-5 * np.random.default_rng(1).standard_normal(len(x))
    setups = (replace(cold.setups[0], name="hot"),)
    hot = replace(cold, name="hot", setups=setups, reading=cold.reading - bowl + noise)
    assert not studied([*found.campaigns, hot], machine).blunders


def test_a_speck_under_a_touch_of_the_calibration_is_shown_by_the_mesh() -> None:
    """Seven touches have no surface of their own: nothing was certain, the verdict was unexplained,
    and numbers that the firmware had bent to the speck were kept.
    """
    verdict = closed("speck-under-calibration", "printer.cfg")
    assert verdict.word == "adequate"
    (told,) = (w for w in verdict.warnings if w.kind == "stray")
    assert "calibration, line 5, setup 'heights'" in told
    assert "0.23 mm above the surface of all others, as a speck on the plate" in told
    assert verdict.corrections is not None
    assert not verdict.corrections.keep
    new = {name: float(value) for name, _, value in verdict.corrections.rows}
    assert new["[printer] delta_radius"] == pytest.approx(140.3, abs=0.1)
    assert new["[stepper_a] angle"] == pytest.approx(210.4, abs=0.05)


def test_a_quiet_mesh_makes_no_slips_of_sound_distances() -> None:
    verdict = closed("quiet-mesh", "printer.cfg")
    assert verdict.word == "adequate"
    assert not verdict.blunders
    # Distances that scatter made arms of three lengths of rods of one set, 1 mm apart.
    corrections = verdict.corrections
    assert corrections is not None
    assert not corrections.keep
    assert np.ptp(arms_of(corrections)) < 0.5


def test_drives_of_three_per_cent_are_told_of_the_drives() -> None:
    folder = FIELD / "drives-3-percent-called-dome"
    machine = og.Machine.load(folder / "machine.toml")
    verdict = studied(og.read_readings(folder / "plate.csv", machine.spec), machine)
    (cause, *_) = verdict.effects
    assert cause.name == "encoder_scale.common"
    assert cause.chosen.value == pytest.approx(0.033, abs=0.002)
    assert "measure 100 mm of the carriage's travel" in cause.chosen.look_at


@pytest.mark.parametrize("by_hand", [False, True])
def test_a_radius_that_was_fitted_with_wrong_drives_does_not_speak_for_them(by_hand: bool) -> None:
    """The firmware's radius, 2.7 mm too small, was the drives' alibi: carriage paths out of square
    and a part printed too large were certain. So they were in a machine file written by hand.
    """
    found = og.import_printer(FIELD / "drives-5-percent" / "printer.cfg")
    spec = replace(found.machine, provenance={}) if by_hand else found.machine
    (cause,) = og.close_loop(found.campaigns, og.Machine(spec)).effects
    assert cause.name == "encoder_scale.common"
    assert cause.chosen.value == pytest.approx(0.05, abs=0.003)


def test_what_is_more_probable_than_not_is_told_and_tested() -> None:
    """Nothing was said to be wrong while the table of the page had the drive at 0.56."""
    verdict = closed("one-drive-3-percent", "printer.cfg")
    assert verdict.word == "adequate"
    said = headline(verdict)
    assert re.match(
        r"Perhaps drive b moves [23]\.\d % more than commanded: its probability is 0\.[5-8]\d?,",
        said,
    )
    (test,) = (a for a in verdict.actions if a.kind == "confirm")
    assert "carriage b" in test.options[0].confirm


def test_travel_that_is_counted_down_is_told() -> None:
    folder = FIELD / "travel-counted-down"
    machine = og.Machine.load(folder / "machine.toml")
    readings = og.read_readings(folder / "plate.csv", machine.spec)
    with pytest.raises(
        og.InputError, match=r"fit a plane to 0\.00\d mm: set sign = \[-1, -1, -1\]"
    ):
        og.close_loop(readings, machine)
    right = og.Machine(replace(machine.spec, controller=Controller(sign=(-1, -1, -1))))
    again = og.read_readings(folder / "plate.csv", right.spec)
    assert studied(again, right).word == "adequate"


@pytest.mark.parametrize(
    ("factors", "remedy"),
    [
        ((1, -1, 1), "the other way by b they fit a plane to 0.00N mm: set sign = [1, -1, 1]"),
        ((0.5, 0.5, 0.5), "multiplied by 2 they fit a plane to 0.00N mm: look at microsteps"),
        ((0.1, 0.1, 0.1), "multiplied by 10 they fit a plane to 0.00N mm: look at"),
        ((0.625,) * 3, "multiplied by 1.6 they fit a plane to 0.00N mm: look at"),
        ((0.75,) * 3, "multiplied by 1.333 they fit a plane to 0.00N mm: look at"),
        (
            (1e-3,) * 3,
            "the heights are of places within 0.09 mm; with travel multiplied by 1000 they fit a "
            "plane to 0.00N mm: look at microsteps, pulleys and the unit of travel",
        ),
        (
            (-0.5, -0.5, -0.5),
            "counted the other way and multiplied by 2 they fit a plane to 0.00N mm: set sign = "
            "[-1, -1, -1] under [controller]; look at microsteps",
        ),
    ],
)
def test_travel_in_another_unit_or_sign_is_told(factors: tuple[float, ...], remedy: str) -> None:
    folder = FIELD / "travel-counted-down"
    machine = og.Machine.load(folder / "machine.toml")
    (readings,) = og.read_readings(folder / "plate.csv", machine.spec)
    wrong = replace(readings, command=-readings.command * factors)
    with pytest.raises(og.InputError, match=re.escape(remedy).replace("N", r"\d")):
        og.close_loop(wrong, machine)


@pytest.mark.parametrize(
    "file", ["printer.cfg", pytest.param("printer-with-mesh.cfg", marks=pytest.mark.thorough)]
)
def test_rods_that_were_entered_short_stand_first_in_the_class(file: str) -> None:
    """Rods of 272 mm entered as 268: no print shrinks so that its distances become longer."""
    verdict = closed("rods-entered-4mm-short", file)
    (cause, *_) = verdict.effects
    assert cause.name == "leg_length.common"
    assert 2.0 < cause.chosen.value < 6.0
    assert "longer than nominal" in cause.chosen.words
    (size,) = (str(w) for w in verdict.warnings if "% longer than the tool's moves" in str(w))
    assert "distances are 1.01 ± 0.22 % longer" in size
    assert "measure a rod" in size


def test_rods_that_were_measured_are_no_cause_any_more() -> None:
    found = og.import_printer(FIELD / "rods-entered-4mm-short" / "printer.cfg")
    file = machine_text(found.machine) + "\n[measured]\nrods_mm = [272.0, 0.1]\n"
    machine = og.Machine(parse_machine_file(file))
    verdict = studied(found.campaigns, machine)
    assert verdict.word == "adequate"
    lengths = [verdict.machine.values[f"leg_length.{leg}"] for leg in "abc"]
    assert np.mean(lengths) == pytest.approx(4e-3, abs=2e-4)
    with pytest.raises(og.InputError, match=r"rods_mm at place 2 must be above 0"):
        parse_machine_file(file.replace("[272.0, 0.1]", "[272.0, 0.0]"))
    with pytest.raises(og.InputError, match="rods_mm is 2720 mm, where the machine has 268 mm"):
        parse_machine_file(file.replace("[272.0, 0.1]", "[2720.0, 0.1]"))


@pytest.mark.parametrize("rods", [pytest.param(268.0, marks=pytest.mark.thorough), 272.0])
def test_new_numbers_keep_to_rods_that_were_measured(rods: float) -> None:
    found = og.import_printer(FIELD / "rods-entered-4mm-short" / "printer-with-mesh.cfg")
    file = machine_text(found.machine) + f"\n[measured]\nrods_mm = [{rods}, 0.05]\n"
    verdict = og.close_loop(found.campaigns, og.Machine(parse_machine_file(file)))
    corrections = verdict.corrections
    assert corrections is not None
    assert "measure a rod" not in corrections.words
    assert np.mean(arms_of(corrections)) == pytest.approx(rods, abs=0.3)


def measured(folder: str, lengths: str, table: str = "klipper") -> og.Verdict:
    """The readings of a printer's file closed, with lengths under [measured]."""
    found = og.import_printer(FIELD / folder / "printer.cfg")
    kept = {k: v for k, v in found.machine.provenance.items() if k == table}
    file = machine_text(replace(found.machine, provenance=kept)) + f"\n[measured]\n{lengths}\n"
    return og.close_loop(found.campaigns, og.Machine(parse_machine_file(file)))


def test_measured_rods_change_all_numbers_of_the_firmware() -> None:
    """They were believed, and that the firmware has others was never said: nothing was wrong."""
    verdict = measured("print-shrunk-with-mesh", "rods_mm = [215.0, 0.1]")
    said, corrections = headline(verdict), verdict.corrections
    assert said.startswith("The rods measure 215.0 mm, the controller has 213.1 mm: all its sizes")
    assert "Nothing is wrong" not in said
    assert corrections is not None
    assert not corrections.keep  # though the distances of the part that shrank fit worse
    assert arms_of(corrections) == pytest.approx([215.0] * 3, abs=0.05)
    assert "make the rods longer, 215.0 mm, as was measured" in corrections.words
    (size,) = (str(w) for w in verdict.warnings if "than the tool's moves" in str(w))
    assert "by the measured rods, distances are 0.77 ± 0.22 % shorter" in size


def test_sizes_that_were_measured_leave_the_radius_free() -> None:
    """The radius was fitted with the rods that were entered, and errs as they do."""
    found = og.import_printer(FIELD / "rods-entered-4mm-short" / "printer.cfg")
    radial = {f"axis_offset.{leg}.radial" for leg in "abc"}

    def common_sd(machine: og.MachineFile) -> float:
        problem = og.identify(found.campaigns, og.Machine(machine)).problem
        matrix, _ = problem.prior_rows
        columns = [n in radial for n in problem.names]
        covariance = np.linalg.inv(matrix.T @ matrix)[np.ix_(columns, columns)]
        return float(np.sqrt(covariance.mean()))

    file = machine_text(found.machine) + "\n[measured]\nrods_mm = [272.0, 0.1]\n"
    assert common_sd(parse_machine_file(file)) == pytest.approx(common_sd(found.machine), rel=0.02)


def test_travel_that_was_measured_comes_before_all_numbers() -> None:
    verdict = measured("print-shrunk-with-mesh", "travel_of_100_mm = [101.2, 0.05]")
    said = "Carriages move 101.20 mm at a command of 100 mm: first multiply rotation_distance by 1"
    assert headline(verdict).startswith(said)
    assert verdict.actions[0].words.startswith(said)
    assert "Run DELTA_CALIBRATE" in verdict.actions[0].words
    assert not [action for action in verdict.actions if action.kind == "zeros"]


def test_measured_lengths_that_contradict_the_controller_are_noted_without_a_firmware() -> None:
    verdict = measured("rods-entered-4mm-short", "rods_mm = [272.0, 0.1]", table="")
    (note,) = (str(w) for w in verdict.warnings if "rods measure" in str(w))
    assert "the rods measure 272.0 mm, the controller has 268.0 mm" in note.lower()


def test_a_part_that_shrank_does_not_turn_the_rods_the_wrong_way() -> None:
    """Its distances had made the arms 1.9 mm too short, and made the new ones shorter still."""
    verdict = closed("print-shrunk-with-mesh", "printer.cfg")
    corrections = verdict.corrections
    assert corrections is not None
    assert [new == old for name, old, new in corrections.rows if "arm_length" in name] == [True] * 3
    assert re.search(
        r"the heights alone ask for rods of 214\.\d mm, or the plate has lobes: arm_length stays "
        r"until a rod is measured",
        corrections.words,
    )


@pytest.mark.parametrize(
    ("file", "asked"),
    [("rods-entered-4mm-short", True), ("print-shrunk-with-mesh", False),
     ("distance-mistyped", False), ("sound-with-distances", False)],
)  # fmt: skip
def test_distances_ask_for_rods_beyond_the_usual_shrinkage(file: str, asked: bool) -> None:
    found = og.import_printer(FIELD / file / "printer.cfg")
    numbers = found.machine.printer.numbers
    assert distances_ask_for_rods(numbers, found.campaigns) == asked


def test_a_part_of_metal_says_how_long_the_rods_are() -> None:
    """Its size is known, so distances decide between the rods and the part."""
    found = og.import_printer(FIELD / "rods-entered-4mm-short" / "printer.cfg")
    (readings,) = found.campaigns
    metal = replace(
        readings, setups=tuple(replace(s, material="metal" if s.observation.paired else "")
                               for s in readings.setups),
    )  # fmt: skip
    verdict = studied(metal, og.Machine(found.machine))
    names = {n for e in verdict.effects for n in (e.name, *e.indistinguishable_from)}
    assert "leg_length.common" in names
    assert "part_size.common" not in names


def test_distances_of_other_microsteps_are_taken_so() -> None:
    found = og.import_printer(FIELD / "distances-in-other-microsteps" / "printer.cfg")
    assert any("0.5 times the microsteps of now" in str(note) for note in found.notes)
    (readings,) = found.campaigns
    assert int(readings.paired.sum()) == 12
    assert int(readings.touching.sum()) == 7


@pytest.mark.parametrize("times", [1.6, 1.25, 0.625, 4 / 3, 1.2])
def test_distances_of_another_pulley_or_motor_are_converted(times: float, tmp_path: Path) -> None:
    """They were left out, as of different times or with a wrong number of one tower."""
    text = (FIELD / "rods-entered-4mm-short" / "printer.cfg").read_text()
    other = re.sub(
        r"(distance\d+_pos\d = )(.*)",
        lambda m: m[1] + ",".join(f"{float(v) * times:.6f}" for v in m[2].split(",")),
        text,
    )
    found, sound = imported(tmp_path, other), imported(tmp_path, text)
    (told,) = (n for n in found.notes if "microsteps" in n)
    assert f"stored with {times:.4g} times the microsteps of now, and are converted" in told
    assert "the motor's steps or the pulley's teeth were others" in told
    (readings,), (same,) = found.campaigns, sound.campaigns
    assert readings.second == pytest.approx(same.second, abs=1e-8, nan_ok=True)


def test_a_part_that_was_scaled_is_the_part() -> None:
    """All parts of the machine off by three tolerances were, and the verdict was *adequate*: the
    size, forty standard deviations from its prior, was no lack of fit.
    """
    found = og.import_printer(FIELD / "distances-in-other-microsteps" / "printer.cfg")
    (readings,) = found.campaigns
    scaled = np.where(readings.paired, 1.15, 1.0) * readings.reading
    verdict = og.close_loop(readings.with_readings(scaled), og.Machine(found.machine))
    assert verdict.word in ("explained", "ambiguous")
    assert verdict.before.scores.lack_of_fit_p < 1e-6
    (cause,) = verdict.effects
    assert cause.name.startswith("part_size")
    assert cause.chosen.value == pytest.approx(0.15, abs=0.01)
    assert re.search("distances 15 % longer", " ".join(str(verdict).split()))


@pytest.mark.parametrize(
    ("folder", "off"),
    [
        ("distances-in-other-microsteps", 9.0),
        pytest.param("distances-in-other-microsteps", -9.0, marks=pytest.mark.thorough),
        pytest.param("quiet-mesh", -9.0, marks=pytest.mark.thorough),  # none of them was imported
    ],
)
def test_distances_over_pillars_are_told_as_their_width(
    folder: str, off: float, tmp_path: Path
) -> None:
    """Rim distances measured outside the pillars: no cause, or no distances, and *adequate*."""
    text = re.sub(
        r"(distance(\d+) = )(\S+)",
        lambda m: f"{m[1]}{float(m[3]) + off * (int(m[2]) >= 6):.4f}",
        (FIELD / folder / "printer.cfg").read_text(),
    )
    found = imported(tmp_path, text)
    verdict = studied(found.campaigns, og.Machine(found.machine))
    (cause,) = verdict.effects
    assert cause.name.startswith("pillar_width.rim")
    assert cause.chosen.value == pytest.approx(off, abs=0.5)
    way = "long" if off > 0 else "short"
    assert re.search(rf"distances in rim are all .* mm too {way}", cause.chosen.words)


def test_many_slips_are_none() -> None:
    """Tower b's angle was changed by hand after the readings: seven of eighteen were set aside as
    slips, and the rest fitted.
    """
    found = og.import_printer(FIELD / "angle-mistyped-by-ten-degrees" / "printer.cfg")
    verdict = studied(found.campaigns, og.Machine(found.machine))
    assert not any(fault.excluded for fault in verdict.blunders)
    assert verdict.word in ("unexplained", "partial")
    (note,) = (note for note in verdict.after.warnings if "too many for slips" in note)
    wrong, of = map(int, re.findall(r"(\d+) of (\d+) readings would have to be wrong", note)[0])
    assert of in (7, 12)
    assert 4 * wrong > of


def test_heights_of_other_microsteps_of_one_tower_are_taken_so() -> None:
    """The present steps gave most heights too, but at places outside the towers."""
    found = og.import_printer(FIELD / "steps-of-one-tower" / "printer.cfg")
    assert any("2 times the microsteps of now, on tower b alone" in str(n) for n in found.notes)
    assert len(found.campaigns[0]) == 7


def test_distances_in_centimetres_are_no_other_microsteps(tmp_path: Path) -> None:
    text = (FIELD / "distances-in-other-microsteps" / "printer.cfg").read_text()
    scaled = re.sub(r"(distance\d+ = )([0-9.]+)", lambda m: f"{m[1]}{float(m[2]) / 10:.4f}", text)
    assert scaled != text
    (tmp_path / "printer.cfg").write_text(scaled)
    found = og.import_printer(tmp_path / "printer.cfg")
    assert any("left out: all 12 distances" in str(note) for note in found.notes)
    assert not any("positions of distances" in str(note) for note in found.notes)
    assert not any(readings.paired.any() for readings in found.campaigns)


def test_distances_in_another_unit_are_told_so(tmp_path: Path) -> None:
    """They were of different times, or a number of one tower was wrong."""
    text = (FIELD / "rods-entered-4mm-short" / "printer.cfg").read_text()
    scaled = re.sub(r"(distance\d+ = )([0-9.]+)", lambda m: f"{m[1]}{float(m[2]) / 10:.4f}", text)
    (told,) = (n for n in imported(tmp_path, scaled).notes if "all 12 distances" in n)
    assert "they are 0.101 times as long as their positions are apart: look at their unit" in told


@pytest.mark.parametrize(
    ("slipped", "by", "kept"),
    [(5, 9.0, (0, 4, 5, 6, 8, 11)), (1, -9.0, (0, 1, 2, 9, 10, 11))],
)
def test_a_slip_of_many_millimetres_among_few_distances_is_told(
    slipped: int, by: float, kept: tuple[int, ...], tmp_path: Path
) -> None:
    """It drove the fit to arms 24 mm longer, where it was none of the readings' or another's."""
    text = (FIELD / "sound-with-distances" / "printer.cfg").read_text()
    for k in {*range(12)} - {*kept}:
        text = re.sub(rf"#\*# distance{k}(_pos[12])? = .*\n", "", text)
    text = re.sub(rf"(distance{slipped} = )(\S+)", lambda m: f"{m[1]}{float(m[2]) + by:.3f}", text)
    found = imported(tmp_path, text)
    (fault,) = studied(list(found.campaigns), og.Machine(found.machine)).blunders
    assert fault.kind == "outlier"
    ((_, row),) = fault.rows_in_request
    assert found.campaigns[0].posture[row] == str(slipped)


OTHER = FIELD / "other-firmware-words"


@pytest.mark.parametrize(("file", "count"), [("heightmap.csv", 13), ("g29.txt", 3)])
def test_lists_of_touches_are_readings_of_the_plate(file: str, count: int) -> None:
    (readings,) = og.import_plates(OTHER / file, OTHER / "machine.toml").campaigns
    assert int(readings.touching.sum()) == len(readings) == count
    with pytest.raises(og.FileError, match=f"import plates {OTHER / file} --machine FILE"):
        og.read_readings(OTHER / file, OTHER / "machine.toml")


def test_a_probe_that_moved_is_one_rival_wherever_it_began(tmp_path: Path) -> None:
    """Of nine explanations of an owner's mesh, seven were one move that began at other lines."""
    found = imported(tmp_path, simulated_cfg(DeltaRig(), noise=1.5e-5, lobes=5e-5))
    (readings,) = found.campaigns
    x = np.array([float(place.split()[0]) for place in readings.posture]) / 120
    late = np.arange(len(x)) >= len(x) // 3
    moved = replace(readings, reading=readings.reading - late * 4e-5 * (1 + x))
    (cause,) = studied([moved], og.Machine(found.machine)).effects
    (rival,) = [rival for rival in cause.data if rival.data == "moved"]
    assert re.search(r"it may begin at any line from 1\d to 1\d$", rival.words)
    assert "or the plate is bent along a line there" in rival.words


def test_a_touch_off_a_small_mesh_is_told_by_its_side(tmp_path: Path) -> None:
    """An owner was sent to notes that no firmware keeps, for a reading that no file shows."""
    found = imported(tmp_path, simulated_cfg(DeltaRig(), count=5))
    (readings,) = found.campaigns
    row = readings.posture.index("120 0")
    reading = readings.reading - np.where(np.arange(len(readings)) == row, 7e-4, 0.0)
    verdict = studied([replace(readings, reading=reading)], og.Machine(found.machine))
    text = " ".join([str(fault) for fault in verdict.blunders] + [
        rival.words for cause in verdict.effects for rival in cause.data
    ])  # fmt: skip
    assert re.search(r"the touch here is 0\.[67]\d* mm above the surface of all others", text)
    assert "notes" not in text


@pytest.mark.parametrize("seed", range(2))
def test_a_plate_with_a_turned_up_rim_is_no_machine_out_of_square(
    seed: int, tmp_path: Path
) -> None:
    """Carriage paths 11 mrad out of square explained it, and short links of 12 tolerances an
    owner's, whose rods were to be entered 4 mm longer: neither has a rival of the plate.
    """
    rng, radius, step = np.random.default_rng(seed), 185.0, np.arange(-180.0, 181.0, 20.0)
    x, y = (v.ravel() for v in np.meshgrid(step, step))
    x, y = (v[np.hypot(x, y) < radius] for v in (x, y))
    share, lobe = (x**2 + y**2) / radius**2, np.exp(-3j * np.deg2rad(79.0))
    z = 0.12 * 4 * share * (share - 1) + 0.11 * (((x + 1j * y) / radius) ** 3 * lobe).real
    table = np.column_stack([x, y, z + rng.normal(0, 0.02, len(z))])
    file = tmp_path / "bed.csv"
    np.savetxt(file, table, "%.3f", ",", header="x,y,z", comments="")
    layout = "kind = 'linear-delta'\nradius_mm = [259.0, 259.0, 259.0]\n"
    machine = parse_machine_file(
        "schema = 1\n[geometry_mm]\nL = 440.0\nd = 50.0\nr = 32.0\nstroke = [-250.0, 450.0]\n"
        f"[layout]\n{layout}tool_mm = [0.0, 0.0, -40.0]\n"
    )
    verdict = og.close_loop(og.import_plates(file, machine).campaigns, og.Machine(machine))
    assert not [c.name for c in verdict.effects if not c.name.startswith("plate_")]
    assert "a hollow 0.1" in str(verdict)
    assert {action.kind for action in verdict.actions} <= {"measure", "confirm", "mend"}


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("rrf.g", "RepRapFirmware.*L = 269.5"),
        ("smoothie.txt", "Smoothie.*L = 215"),
        ("repetier.txt", "Repetier.*L = 215 and radius_mm less r_mm = 105.6"),
        ("smoothie-override.txt", "Smoothie.*L = 215 and radius_mm less r_mm = 105.6"),
    ],
)
def test_configurations_of_others_are_answered_with_what_to_write(file: str, said: str) -> None:
    for read in (og.import_printer, lambda path: og.import_plates(path, OTHER / "machine.toml")):
        with pytest.raises(og.FileError, match=said):
            read(OTHER / file)


def test_decimal_commas_of_a_configuration_are_read(tmp_path: Path) -> None:
    """A radius of 105,600 was told as 105."""
    text = (OTHER / "repetier.txt").read_text()
    (tmp_path / "repetier.txt").write_text(re.sub(r"(\d)\.(\d)", r"\1,\2", text))
    with pytest.raises(og.FileError, match=r"L = 215 and radius_mm less r_mm = 105\.6,"):
        og.import_printer(tmp_path / "repetier.txt")


def test_temperatures_that_were_recorded_are_kept(tmp_path: Path) -> None:
    log = ["Recv: ok T:24.1 /0.0 B:60.2 /60.0 @:0 B@:0"]
    log += [f"Recv: Bed X: {x} Y: {y} Z: 0.01" for x, y in ((0, 0), (50, 0), (0, 50))]
    (tmp_path / "g29.log").write_text("\n".join([*log, "T:24.1 /0.0 B:60.6 /60.0", log[-1]]))
    (readings,) = og.import_plates(tmp_path / "g29.log", OTHER / "machine.toml").campaigns
    assert readings.temperature.tolist() == [60.2, 60.2, 60.2, 60.6]
