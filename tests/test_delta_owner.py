"""The commands as the owner of a linear delta uses them, from what a firmware stored."""

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.delta_readings import measured
from benchmarks.delta_truth import machine as nominal
from orthoglide.errors import InputError
from orthoglide.machine import Machine
from orthoglide.verdict import Verdict, close_loop
from tests.klipper_files import DATA
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_cli import run as run_plainly


def run(*args: object, code: int = 0) -> str:
    done = run_plainly(*args)
    assert done.exit_code == code, done.output
    return " ".join(done.output.split())


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("delta") / "in"
    run("import", "klipper", DATA / "electrocally.cfg", "--out", folder)
    return folder


def test_two_visits_are_compared(imported: Path, tmp_path: Path) -> None:
    rows = (imported / "mesh-default.csv").read_text()
    (tmp_path / "later.csv").write_text(rows)
    common = ("--machine", imported / "machine.toml")
    told = run("check", imported / "mesh-default.csv", tmp_path / "later.csv", *common)
    assert "Nothing changed" in told
    assert "Enter the numbers for the firmware, " not in told  # which are good to two microns
    assert "close-loop lists the numbers for the firmware, from the new readings alone" in told


def _other_numbers(tmp_path: Path) -> None:
    """The same readings imported with another radius of the firmware, into ``two``."""
    text = (DATA / "electrocally.cfg").read_text()
    old = re.search(r"delta_radius = ([0-9.]+)", text)
    assert old is not None
    (tmp_path / "printer.cfg").write_text(
        text.replace(old[0], f"delta_radius = {float(old[1]) + 0.1}")
    )
    run("import", "klipper", tmp_path / "printer.cfg", "--out", tmp_path / "two")


@pytest.mark.thorough
def test_campaigns_of_other_numbers_are_refused(imported: Path, tmp_path: Path) -> None:
    """Their commands count from other numbers; a file that does not say so is read as ever."""
    _other_numbers(tmp_path)
    first, second = imported / "calibration.csv", tmp_path / "two" / "mesh-default.csv"
    both = ("--machine", tmp_path / "two" / "machine.toml", "--out", tmp_path / "o")
    told = run("close-loop", first, second, *both, code=2)
    assert "calibration.csv, line 2: was imported with other numbers of the firmware" in told
    assert "take the machine.toml of its own import" in told
    assert "other numbers" in run("check", first, second, *both[:2], code=2)
    plain = tmp_path / "plain.csv"
    rows = [line.split(",") for line in first.read_text().splitlines()]
    assert rows[0][-1] == "firmware"
    plain.write_text("\n".join(",".join(row[:-1]) for row in rows))
    run("identify", plain, second, *both)
    result = tmp_path / "o" / "result.json"
    assert "same numbers" in run("rerun", result)
    calibrated = tmp_path / "o" / "calibrated.toml"
    run("identify", second, "--machine", calibrated, "--out", tmp_path / "again")
    run("identify", first, "--machine", calibrated, "--out", tmp_path / "no", code=2)


def test_every_command_works_or_says_why_not(imported: Path, tmp_path: Path) -> None:
    machine = imported / "machine.toml"
    for command in (
        ("protocol", "--out", tmp_path / "s.csv"),
        ("simulate", "--out", tmp_path / "c.csv"),
        ("measure", "--out", tmp_path / "m.csv"),
        ("design",),
    ):
        told = run(*command, "--machine", machine, code=2)
        assert "linear-delta" in told
        advised = f"orthoglide design --owns plate --machine {machine} --out SHEET.csv writes"
        assert advised in told
    kinds = ("--effects", "leg_length,rail_tilt", "--no-figures")
    run("compare", "--machine", machine, *kinds, "--out", tmp_path / "cmp")
    assert "Readings are not compared" in (tmp_path / "cmp" / "table.md").read_text()
    run("identify", imported / "mesh-default.csv", "--machine", machine, "--out", tmp_path / "id")
    calibrated = tmp_path / "id" / "calibrated.toml"
    (tmp_path / "path.csv").write_text("p_x_mm,p_y_mm,p_z_mm\n0,0,10\n30,-20,5\n")
    run("compensate", tmp_path / "path.csv", "--machine", calibrated, "--out", tmp_path / "to.csv")
    run("export", "--machine", calibrated, "--out", tmp_path / "exported")
    alone = ("export", "--machine", calibrated, "--zeros-only", "--out", tmp_path / "alone")
    assert "all its numbers or none" in run(*alone, code=2)
    text = (tmp_path / "exported" / "controller.txt").read_text()
    assert (
        "Do not enter new numbers: with them the residual of the heights of" in text
    )  # those tried fit no better
    assert re.search(r"rms, mm +old +tried", text)
    assert "position_endstop" not in text  # a table of "new" numbers, which were the old ones
    assert "To paste" not in text
    assert "zero" not in text.replace("z = 0", "")
    assert "origin" not in text
    assert not list(tmp_path.glob("[sc].csv"))


def test_absurd_rods_are_told_whatever_is_asked(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    run("import", "klipper", DATA / "v400-april.cfg", "--out", folder)
    for command in (("forward", 0, 0, 0), ("inverse", 0, 0, 1)):
        assert run(*command, "--machine", folder / "machine.toml").startswith("warning: The arms")


@pytest.fixture(scope="module")
def v400(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("v400") / "in"
    run("import", "klipper", DATA / "v400-april.cfg", "--out", folder)
    return folder


@pytest.fixture(scope="module")
def mesh_closed(v400: Path) -> tuple[str, Path]:
    """What closing the loop on a mesh prints, and the folder of its result."""
    mesh, out = v400 / "mesh-default_25Probe.csv", v400.parent / "closed"
    return run("close-loop", mesh, "--machine", v400 / "machine.toml", "--out", out), out


def test_a_mesh_is_told_in_the_owners_words(mesh_closed: tuple[str, Path]) -> None:
    told, out = mesh_closed
    left = re.search(r"residuals, rms, mm ([\d.]+) ([\d.]+) ([\d.]+)", told)
    assert left is not None
    assert float(left[2]) == 0.05 > 0.032 > float(left[3])
    assert "the towers lean and their carriages with them, all by" in told
    result = json.loads((out / "result.json").read_text())
    page = (out / "report.html").read_text()
    text = " ".join(re.sub(r"<(style|script|svg).*?</\1>|<[^>]+>", " ", page, flags=re.S).split())
    assert "- Test each of the other causes above in the same way." in told
    rivals = [rival["words"] for effect in result["effects"] for rival in effect["rivals"]]
    assert len(rivals) == 7
    assert all(text.count(words[1:]) > 1 for words in rivals)  # among causes, and to be looked at
    assert "imported with --turned NAME=60" in told
    sheet = "orthoglide design --owns distance --machine {} --out distance.csv"
    assert sheet.format("machine.toml") in text  # whose folder nobody knows later
    assert "Readings of a probe on a plate cannot detect, even at three times the tolerance" in told
    bars = "two rods of each tower differ in length"
    for unshown in (bars, "towers are bent"):
        assert unshown in told
        assert unshown in text
    for false in ("outward", "dial’s", "the dial", "two-gauges", "leg reading"):
        assert false not in told
        assert false not in text, false


def test_a_mesh_ends_in_a_class_and_in_numbers_for_the_firmware(
    mesh_closed: tuple[str, Path],
) -> None:
    """FLSUN V400: seven numbers leave 0.05 mm; tilted towers and the bed share what is left."""
    _, done = mesh_closed
    told = json.loads((done / "result.json").read_text())
    assert told["before"]["rms_mm"] == pytest.approx(0.0497, abs=0.002)
    assert told["after"]["rms_mm"] < 0.032
    assert told["verdict"] == "ambiguous"
    names = {n for e in told["effects"] for n in (e["name"], *e["indistinguishable_from"])}
    assert {"plate_trefoil.default_25Probe", "rail_tilt.tangential.common",
            "axis_tilt.tangential.common"} <= names  # fmt: skip
    firmware = told["firmware"]
    assert "Measure the rods" in firmware["first"]
    assert firmware["old"]["delta_radius_mm"] == 162.820595
    assert firmware["height_rms_mm"][1] < firmware["height_rms_mm"][0]
    first, second = (s["reason"] for s in told["next_measurements"][:2])
    assert "turned by 60 degrees" in first  # the likeliest is the plate's own
    assert "measure distances" in second  # a level turns neither of the paths' errors
    sheet = "orthoglide design --owns distance --machine machine.toml --out distance.csv"
    assert sheet in second
    page = (done / "report.html").read_text()
    assert sheet in unescape(page)
    assert "To undo" in page
    assert "Numbers for the firmware" in page
    before_verdict, _, rest = page.partition("<main>")[2].partition('<p class="word')
    assert "The arms that the firmware stores" in before_verdict
    assert rest
    assert "The arms that the firmware stores" not in rest.partition("<section")[0]
    calibrated = Machine.load(done / "calibrated.toml")
    assert calibrated.spec.provenance["klipper"]["delta_radius_mm"] == 162.820595
    exported = og.controller_numbers(calibrated)
    kept = {"old", "new", "height_rms_mm", "keep_old_because", "left_of_readings",
            "gain_along_mm", "rods_by_heights_mm"} & set(firmware)  # fmt: skip
    assert exported.as_dict()["firmware"] == {key: firmware[key] for key in kept}
    assert exported.to_frame().loc["[stepper_a] position_endstop", "new"] == pytest.approx(
        firmware["new"]["position_endstop_mm"][0], abs=1e-6
    )
    for told_there in (exported.text(), page):
        assert f"delta_radius: {firmware['new']['delta_radius_mm']:.6f}" in told_there
        assert "below the header of SAVE_CONFIG (#*#)" in unescape(told_there)
        assert "zeros" not in told_there.split("Numbers for the firmware")[1].split("To undo")[0]


@pytest.mark.thorough
def test_what_most_probably_decides_is_asked_for_first() -> None:
    """A level was, by which neither lobes nor paths that all lean to one side turn the platform."""
    rig, lobes = DeltaRig(errors={"plate_trefoil.bed.cos": 1.5e-4}), "plate_trefoil.bed"

    def told(instrument: str) -> tuple[Verdict, set[str]]:
        rng = np.random.default_rng(3)
        readings = measured(rig, rng, machine=nominal(), instrument=instrument)
        verdict = close_loop([readings], nominal())
        return verdict, {one.name for cause in verdict.effects for one in cause.explanations}

    mesh, names = told("mesh")
    assert {lobes, "axis_tilt.tangential.common", "rail_tilt.tangential.common"} <= names
    plate = '"the plate of bed has three high and three low sides"'
    paths = '"the paths of the carriages are out of square, all alike in tangential direction"'
    reasons = [s.reason for s in mesh.next_measurements]
    turned, distances, level = (
        next(r for r in reasons if word in r)
        for word in ("turned by 60 degrees", "measure distances between", "measure a level")
    )
    assert reasons[:2] == [turned, distances]
    assert "it does not separate" not in distances
    assert f"it does not separate {plate} from {paths}, for that take a mesh" in level
    assert told("mesh, distances")[1] == {lobes}
    left = told("mesh, level")[1]
    assert {lobes, "axis_tilt.tangential.common"} <= left
    assert "rail_tilt.tangential.common" not in left


def test_a_tower_almost_two_degrees_out_of_plumb_is_that_tower() -> None:
    """Sizes beyond six tolerances were left out of a credible set, whatever their probability: all
    towers were named instead, with 0.06.
    """
    rig, rng = DeltaRig(errors={"rail_tilt.c.tangential": 0.03}), np.random.default_rng(8)
    readings = measured(rig, rng, machine=nominal(), instrument="mesh, distances")
    (cause,) = studied([readings], nominal()).effects
    assert cause.name == "rail_tilt.c.tangential"
    assert cause.chosen.value == pytest.approx(0.03, abs=0.003)


@pytest.mark.parametrize("seed", range(3))
def test_a_saddle_is_the_plate_and_not_the_hinges(seed: int) -> None:
    """Turned hinges and short links of different widths were named with up to 0.8, and a saddle
    between the axes was two findings, or none.
    """
    rng = np.random.default_rng([seed, 71])
    size, ridge = 2.5e-4, float(rng.uniform(0, 180))
    saddle = size * np.exp(2j * np.deg2rad(ridge))
    parts = {"plate_saddle.bed.cos": saddle.real, "plate_saddle.bed.sin": saddle.imag}
    rig = DeltaRig(errors=parts | {"axis_offset.a.radial": 4e-4})
    readings = measured(rig, rng, machine=nominal(), instrument="mesh, distances")
    verdict = close_loop([readings], nominal())
    (cause,) = verdict.effects
    assert cause.name == "plate_saddle.bed"
    assert cause.parameters == tuple(parts)
    assert cause.chosen.value == pytest.approx(size * 1e3, abs=0.05)
    assert cause.probability > 0.9
    (effect,) = verdict.as_dict(summary=False)["effects"]
    assert abs((effect["high_side_deg"] - ridge + 90) % 180 - 90) < 5
    toward = f"high toward {effect['high_side_deg']:.0f} degrees"
    assert toward in str(verdict)
    assert toward in effect["words"]
    assert f"toward {effect['high_side_deg']:.0f} degrees: expect a gap" in effect["confirm"]
    # A pair and its parts may be active together: the sum of their probabilities exceeds one.
    assert verdict.candidates[0].probability <= 1.0


def test_a_plate_that_was_found_bent_is_no_change_at_the_next_visit(tmp_path: Path) -> None:
    """The calibrated file keeps no plate; half of its lobes were told as hinges that had turned."""
    rig = DeltaRig(errors={"plate_trefoil.bed.cos": -2.6e-4, "plate_trefoil.bed.sin": 1.5e-4})

    def touched(seed: int) -> og.Readings:
        rng = np.random.default_rng(seed)
        return measured(rig, rng, machine=nominal(), instrument="mesh")

    first = close_loop([touched(5)], nominal())
    assert [cause.name for cause in first.effects] == ["plate_trefoil.bed"]
    first.report(tmp_path / "first")
    again = close_loop([touched(6)], tmp_path / "first" / "calibrated.toml")
    assert again.changed == ()
    assert [cause.name for cause in again.effects] == ["plate_trefoil.bed"]


def test_a_pair_is_one_name_where_it_is_freed_and_where_it_is_run_again(tmp_path: Path) -> None:
    rig, pair = DeltaRig(errors={"plate_trefoil.bed.cos": -2.6e-4}), "plate_trefoil.bed"
    mesh = measured(rig, np.random.default_rng(5), machine=nominal(), instrument="mesh")
    og.write_campaign(mesh, tmp_path / "mesh.csv", nominal())
    nominal().save(tmp_path / "machine.toml")
    given = (tmp_path / "mesh.csv", "--machine", tmp_path / "machine.toml")
    run("identify", *given, "--free", f"joint_offset,{pair}", "--out", tmp_path / "out")
    file = tmp_path / "out" / "result.json"
    result = json.loads(file.read_text())
    assert {n for n in result["parameters"] if pair in n} == {f"{pair}.cos", f"{pair}.sin"}
    assert "same numbers" in run("rerun", file)


@pytest.mark.thorough
def test_a_cause_beside_a_place_is_reported_whole(tmp_path: Path) -> None:
    """Rivals of the cause are machines on which the place goes wrong as well; and the machine is
    there for the next visit, of which its file could not be read.
    """
    rig = DeltaRig(
        errors={"axis_tilt.a.tangential": 2e-3},
        bends={"b": lambda s: (0.0, 0.0, 6e-5 * np.sin(2 * np.pi * s / 0.15))},
    )
    rng = np.random.default_rng(3)
    points = measured(rig, rng, machine=nominal(), instrument="tool coordinates")
    verdict = close_loop(points, nominal())
    assert verdict.word == "ambiguous"  # what may be in the cause's place moves the tool otherwise
    (cause,) = verdict.effects
    assert cause.name == "axis_tilt.a.tangential"
    assert [rival.name for rival in cause.rivals] == ["rail_tilt.a.tangential"]
    (found,) = verdict.located
    assert found.name.startswith("drive.b/waves@14")  # a sine of 150 mm, about half the stroke
    assert "a level at the tool" in verdict.next_measurements[0].reason
    verdict.report(tmp_path / "out")
    (place,) = json.loads((tmp_path / "out" / "result.json").read_text())["located"]
    assert [place["leg"], *(member["leg"] for member in place["class"])] == ["b"] * (
        1 + len(place["class"])
    )
    kept = Machine.load(tmp_path / "out" / "calibrated.toml")
    travel = points.command
    assert np.abs(kept.forward(travel) - verdict.machine.forward(travel)).max() < 1e-6
    later = measured(
        rig, np.random.default_rng(4), machine=nominal(), instrument="tool coordinates"
    )
    again = studied(later, kept)
    assert (again.word, again.changed) == ("adequate", ())
    upright = replace(rig, errors={})
    rows = measured(upright, np.random.default_rng(5), machine=nominal(),
                    instrument="tool coordinates")  # fmt: skip
    (change,) = studied(rows, kept).changed
    assert change.parameter in ("axis_tilt.a.tangential", "rail_tilt.a.tangential")
    assert change.after - change.before == pytest.approx(-2e-3, abs=3e-4)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        ("none", ""), ("x", "sign about x"), ("degrees", "as degrees"),
        ("both", "with the opposite sign: look"), ("exchanged", "with x and y exchanged"),
    ],
)  # fmt: skip
def test_a_level_that_means_something_else(mistake: str, said: str) -> None:
    """Rails twisted by 9 mrad and carriages that turn were found for it, and nothing left."""
    rig = DeltaRig(errors={"joint_offset.a": 6e-4, "mount_tilt.b.b": 1.2e-2})
    rng = np.random.default_rng(6)
    tool = measured(rig, rng, machine=nominal(), instrument="tool coordinates")
    read = measured(rig, rng, machine=nominal(), instrument="probe and level")
    level = read.of_kind("incline")
    reading, axis = read.reading.copy(), read.axis.copy()
    match mistake:
        case "both":
            reading[level] *= -1
        case "x":
            reading[level & (axis == 0)] *= -1
        case "exchanged":
            axis[level] = 1 - axis[level]
        case "degrees":
            reading[level] = np.round(np.rad2deg(reading[level]), 3) * 1e-3
    spoilt = [replace(tool, name="tool"), replace(read, reading=reading, axis=axis)]
    if not said:
        verdict = studied(spoilt, nominal())
        assert verdict.word in ("explained", "ambiguous")
        assert "mount_tilt.b.b" in {n for c in verdict.effects for e in c.explanations
                                    for n in e.parameters}  # fmt: skip
        return
    with pytest.raises(InputError, match=f"of the level are far likelier .*{said}"):
        close_loop(spoilt, nominal())
