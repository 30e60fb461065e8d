"""What a firmware stored: imported, closed, corrected; and what is no such file."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import orthoglide as og
from orthoglide.errors import FileError
from orthoglide.firmware.klipper import Imported, import_printer
from orthoglide.firmware.klipper.new_numbers import plate_heights
from orthoglide.firmware.klipper.numbers import Numbers
from orthoglide.machine import Machine
from orthoglide.machine_file import machine_text, parse_machine_file
from orthoglide.numerals import MINUS
from orthoglide.observations import campaign_text, read_readings
from orthoglide.verdict import close_loop
from tests.klipper_files import DATA, imported, simulated_cfg
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_cli import run

CONFIGS = sorted(DATA.glob("*.cfg"))
V400 = DATA / "v400-april.cfg"


@cache
def plain() -> Imported:
    """The stored file as it is."""
    return import_printer(V400)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_every_stored_file_imports_and_reads_back(path: Path, tmp_path: Path) -> None:
    found = import_printer(path)
    spec = parse_machine_file(machine_text(found.machine))
    assert spec.geometry == found.machine.geometry
    for campaign in found.campaigns:
        file = tmp_path / f"{campaign.name}.csv"
        file.write_text(campaign_text(campaign, found.machine))
        (again,) = read_readings(file, spec)
        assert again.setups == campaign.setups
        for name in ("command", "second", "reading", "sigma", "approach"):
            one, other = getattr(again, name), getattr(campaign, name)
            assert np.array_equal(one, other, equal_nan=True), name


def test_what_the_importer_assumed_is_corrected_together() -> None:
    """The docs said to correct r; alone it moved the zero of travel by four millimetres."""
    text = machine_text(plain().machine)
    assert "r = 32.0" in text
    with pytest.raises(FileError, match=r"radius_mm less r must stay .* put 187\.820595 three"):
        parse_machine_file(text.replace("r = 32.0", "r = 25.0"))
    with pytest.raises(FileError, match="L must stay the mean of the firmware's arms"):
        parse_machine_file(text.replace("L = 345.561", "L = 346.0"))
    both = text.replace("r = 32.0", "r = 25.0").replace("194.820595", "187.820595")
    assert parse_machine_file(both).geometry.r == 0.025


def test_corrections_bring_the_independent_machine_to_the_plate(tmp_path: Path) -> None:
    """Six true errors that the firmware can hold: its new numbers put the nozzle on the plate."""
    truth = {"joint_offset.a": 4e-4, "joint_offset.b": -3e-4, "joint_offset.c": 1e-4,
             "axis_offset.a.radial": 5e-4, "axis_offset.b.radial": 5e-4,
             "axis_offset.c.radial": 5e-4}  # fmt: skip
    rig = DeltaRig(errors=truth)
    found = imported(tmp_path, simulated_cfg(rig, noise=0.0))
    machine = Machine(found.machine)
    estimate = og.identify(list(found.campaigns), machine)
    old = Numbers.from_table(found.machine.provenance["klipper"])
    made = found.machine.printer.corrections(estimate.machine, found.campaigns)
    assert made is not None
    nominal = np.sqrt(rig.L**2 - (rig.radius - rig.r) ** 2)

    def heights(firmware: Numbers) -> np.ndarray:
        t = np.arange(6) * np.pi / 3
        p = np.stack([0.1 * np.cos(t), 0.1 * np.sin(t), 0 * t], axis=1)
        # Endstops stay where they are.
        travel = firmware.heights(p) - firmware.at_endstop + old.at_endstop - nominal
        return np.array([rig.pose(s, q)[0][2] for s, q in zip(travel, p, strict=True)])

    assert np.abs(heights(made.old)).max() > 1e-4
    assert np.abs(heights(made.new)).max() < 5e-6
    assert np.abs(made.new.heights(np.zeros((1, 3)))).max() > 0


@pytest.mark.thorough
def test_a_mesh_of_the_turned_plate_decides(tmp_path: Path) -> None:
    """Lobes of the plate go with it, and a machine's stay where they are."""
    file, meshes = tmp_path / "printer.cfg", {"default": 0.0, "at = 60": 60.0}
    errors = {f"rail_tilt.{leg}.tangential": 5e-3 for leg in "abc"}
    for what, rig, lobes in (("plate", DeltaRig(), 1e-4), ("rails", DeltaRig(errors=errors), 0.0)):
        file.write_text(simulated_cfg(rig, lobes=lobes, turned=meshes))
        out = tmp_path / what
        done = run("import", "klipper", file, "--out", out, "--turned", "at = 60=60")
        assert done.exit_code == 0
        assert "must not all go together" not in done.output
        files = sorted(map(str, out.glob("*.csv")))
        verdict = studied(files, out / "machine.toml")
        every = {name for c in verdict.effects for one in c.explanations for name in one.parameters}
        assert ("plate_trefoil" in str(every)) == (what == "plate")
        assert ("rail_tilt.tangential.common" in every) == (what == "rails")
    for wrong, why in (
        ("at = 60", "no mesh 'at'"), ("x=60", "no mesh 'x'"), ("60", "takes NAME=DEGREES"),
        ("default=nan", "takes NAME=DEGREES"),
    ):  # fmt: skip
        out = tmp_path / "wrong"
        done = run("import", "klipper", file, "--out", out, "--turned", wrong)
        assert (done.exit_code, out.exists()) == (2, False)
        assert why in done.output


def test_a_printer_without_readings_of_its_plate_is_given_no_numbers() -> None:
    """Zeros by a model that no touch of the plate tied to it would drive the nozzle into it."""
    machine = Machine(plain().machine).with_parameters({"axis_tilt.a.radial": 4e-3})
    numbers = og.controller_numbers(machine)
    assert "There are none" in numbers.text()
    assert "zero" not in numbers.text().replace("z = 0", "")
    assert set(numbers.as_dict()["firmware"]) == {"old", "missing"}


BROKEN = {
    "no printer": ("[printer]", "[prnter]", "no section [printer]"),
    "cartesian": ("kinematics: delta", "kinematics: cartesian", "not 'delta'"),
    "a word for a number": ("angle = 210.211440", "angle = north", "must be a number, not 'north'"),
    "no section": ("[", "> [", "none of the sections of a printer.cfg"),
    "a unit": ("delta_radius = 162.820595", "delta_radius = 162.820595 mm", "and no unit"),
    "a broken header": ("[stepper_b]", "[stepper_b", "has no section [stepper_b]"),
    "another arm": ("arm_length = 345.924580", "arm_length = 394.5", "arms of one machine"),
    "arm too short": ("arm_length = 345.283908", "arm_length = 45.2", "exchanged"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_file_is_told_with_its_line(kind: str, tmp_path: Path) -> None:
    old, new, phrase = BROKEN[kind]
    text = V400.read_text()
    assert old in text
    file = tmp_path / "printer.cfg"
    file.write_text(text.replace(old, new))
    with pytest.raises(FileError) as caught:
        import_printer(file)
    assert phrase in str(caught.value)
    assert "printer.cfg" in str(caught.value)
    refused = run("import", "klipper", file, "--out", tmp_path / "o")
    assert refused.exit_code == 2
    assert not (tmp_path / "o").exists()


def said_of(text: str, folder: Path) -> str:
    """What the import says of a file, whether it fails or lacks something."""
    (folder / "printer.cfg").write_text(text)
    try:
        return "\n".join(import_printer(folder / "printer.cfg").notes)
    except FileError as error:
        return str(error)


@pytest.mark.parametrize("broken", ["[{}", "{}]", "{}", "({})"])
def test_a_stored_header_without_its_brackets_is_named(broken: str, tmp_path: Path) -> None:
    for name in ("printer", "delta_calibrate"):
        before, header, after = V400.read_text().partition(f"#*# [{name}]")
        assert header
        said = said_of(f"{before}#*# {broken.format(name)}{after}", tmp_path)
        at = f"printer.cfg, line {before.count(chr(10)) + 1}: '{broken.format(name)}'"
        assert at in said, said
        assert f"must be [{name}]" in said


@pytest.mark.parametrize(
    "name", ["printer", "stepper_b", "delta_calibrate", "bed_mesh default_25Probe"]
)
def test_a_stored_header_that_is_lost_is_named(name: str, tmp_path: Path) -> None:
    """Seven heights and all distances vanished without a word."""
    before, header, after = V400.read_text().partition(f"#*# [{name}]\n")
    assert header
    said = said_of(before + after, tmp_path)
    assert "so the header above it was lost: write" in said, said
    assert "or remove the line if you added it" in said


def without(text: str, start: str) -> str:
    """Return a file without the lines that begin so."""
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith(start))


SAID = {
    "heights of another time": (
        lambda t: re.sub(r"(#\*# height[0-4]_pos = )(\d+)", r"\g<1>1\g<2>", t),
        "left out: all 7 heights", 1, 12),
    "steps of one tower": (
        lambda t: t.replace("[stepper_a]\n", "[stepper_a]\nfull_steps_per_rotation: 400\n", 1),
        "0.5 times the microsteps of now, on tower a alone: correct its", 2, 19),
    "a gap": (lambda t: without(t, "#*# distance2 ="), "distance2 is missing", 1, 18),
    "half of one": (lambda t: without(t, "#*# height3_pos"), "height3_pos is missing", 1, 18),
    "another offset of the probe": (
        lambda t: t.replace("#*# z_offset = 18.024", "#*# z_offset = 17.624"),
        "were stored with a z_offset of", 1, 19),
    "distances in inches": (
        lambda t: re.sub(r"(#\*# distance\d+ = )(\S+)", lambda m: f"{m[1]}{float(m[2]) / 25.4}", t),
        "left out: all 12 distances", 1, 7),
    "distances above the plate": (
        lambda t: re.sub(r"(#\*# distance\d+_pos[12] = )", r"\g<1>-", t),
        "left out: all 12 distances", 1, 7),
    "one distance above the plate": (
        lambda t: t.replace("33994.155,33460.943,33523.056", "32994.155,32460.943,32523.056"),
        "distance3 is at z = 0 mm, where", 1, 18),
    "a height out of reach": (
        lambda t: re.sub(r"(#\*# height3_pos = )\d+", r"\g<1>99999", t),
        "mm, where the arms do not reach its stored position", 1, 18),
    "a gear without a ratio": (
        lambda t: t.replace("[stepper_a]\n", "[stepper_a]\ngear_ratio: 80\n", 1),
        "gear_ratio must be a list of ratios such as 80:16", 1, 0),
    "steps of older firmware": (
        lambda t: t.replace("rotation_distance: 40", "step_distance: 0.0125"), "steps", 0, 19),
    "steps of another time": (
        lambda t: t.replace("31752.000,42168.000,31693.000", "31752.000,32168.000,31693.000"),
        "different times", 1, 18),
    "distance in another place": (
        lambda t: t.replace("distance0 = 97.4598", "distance0 = 41.2"), "DELTA_ANALYZE", 1, 18),
    "two of three steps": (
        lambda t: t.replace("31752.000,42168.000,31693.000", "31752.000,42168.000"),
        "has 2 numbers where 3 belong", 1, 18),
    "no key": (
        lambda t: t.replace("#*# angle = 210.211440", "#*# angle = 210.211440\n#*# so it is"),
        "'so it is'", 1, 19),
}  # fmt: skip


@pytest.mark.parametrize("kind", SAID)
def test_what_becomes_of_stored_heights_and_distances(kind: str, tmp_path: Path) -> None:
    edit, phrase, times, count = SAID[kind]
    text = edit(V400.read_text())
    assert text != V400.read_text()
    (tmp_path / "printer.cfg").write_text(text)
    found, whole = import_printer(tmp_path / "printer.cfg"), plain().campaigns[0]
    assert sum(phrase in note for note in found.notes) == times
    if phrase == "left out: all 7 heights":  # and numbers of a mesh alone were advised
        assert found.machine.provenance["klipper"]["calibrate_again"] is True
    if not count:
        assert "calibration" not in [c.name for c in found.campaigns]
        return
    kept, *meshes = found.campaigns
    assert len(kept) == count
    assert [len(c) for c in meshes] == [len(c) for c in plain().campaigns[1:]]
    if kind in ("steps of another time", "distance in another place", "no key"):
        (note,) = (n for n in found.notes if "left out" in n)
        assert re.search(r"printer\.cfg, line \d+: ", note)
    before = dict(zip(whole.posture, whole.command, strict=True))
    off = [c - before[label] for label, c in zip(kept.posture, kept.command, strict=True)]
    assert np.abs(off).max() < 1e-9


KEYS = {
    "probe": ("z_offset", "far"),
    "bed_mesh": ("mesh_radius", "-1"),
    "printer": ("print_radius", "x"),
}


@pytest.mark.parametrize("section", KEYS)
def test_a_key_that_may_be_missing_is_left_out(section: str, tmp_path: Path) -> None:
    key, value = KEYS[section]
    lines = re.sub(rf"(?m)^{key}.*\n", "", V400.read_text())
    found = imported(tmp_path, f"[{section}]\n{key}: {value}\n{lines}")
    assert len(found.campaigns) == 3
    (note,) = (n for n in found.notes if f"line 2: [{section}] {key} " in n)
    assert note.endswith("; 0 is taken")


def _apart(text: str) -> tuple[str, str]:
    """What the owner wrote, and what the firmware saved."""
    own, mark, saved = text.partition("#*#")
    return own, mark + saved


ODD = {
    "Windows": lambda t: t.replace("\n", "\r\n"),
    "comments": lambda t: t.replace("delta_radius = 162.820595", "delta_radius=162.820595#was: 1"),
    "pasted flat": lambda t: t.replace("#*# \t", "#*# ").replace("#*#   ", "#*# "),
    "other probe": lambda t: t.replace("[probe]", "[bltouch]"),
    "no general mesh": lambda t: t.replace("[bed_mesh]", "[bed_mush]"),
    "macro": lambda t: "[gcode_macro X]\ngcode:\n  {% set a = 1 %}\n\n  M117 [x]: y\n" + t,
    "capitals": lambda t: t.replace("[printer]", "[Printer]").replace("arm_length", "Arm_Length"),
    "copied from a page": lambda t: t.replace("= -", "= \u2212").replace(
        "[printer]", "\u200b[printer]"
    ),
    "include": lambda t: "[include parts/*.cfg]\n" + _apart(t)[1],
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_files_say_what_the_plain_one_says(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "printer.cfg"
    file.write_bytes(b"# gr\xfc\xdf\n" + ODD[kind](V400.read_text()).encode() + b"\n \n")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "own.cfg").write_text(_apart(V400.read_text())[0])
    found = import_printer(file)
    assert [c.name for c in found.campaigns] == [c.name for c in plain().campaigns]
    for one, other in zip(found.campaigns, plain().campaigns, strict=True):
        assert np.abs(one.command - other.command).max() < 1e-12
        assert np.array_equal(one.reading, other.reading)


def test_what_stands_above_the_saved_block_counts_and_both_lines_are_told(tmp_path: Path) -> None:
    """As in the firmware's configfile.py: its saved block gives way to the file and includes."""
    text = V400.read_text()
    stored = Numbers.from_table(plain().machine.provenance["klipper"])
    saved = text.splitlines().index("#*# delta_radius = 162.820595") + 1
    (tmp_path / "own.cfg").write_text("[printer]\ndelta_radius: 162.5\n")
    for own, value, where in (
        ("[printer]\ndelta_radius: 162.5\n", 162.5, "162.5 (line 2)"),
        ("[include own.cfg]\n[nothing]\n", 162.5, "162.5 (line 2 of "),
        ("[printer]\ndelta_radius: 162.8205950\n", 162.820595, ""),
    ):
        found = imported(tmp_path, own + text)
        now = Numbers.from_table(found.machine.provenance["klipper"])
        assert now == replace(stored, delta_radius=pytest.approx(value * 1e-3, abs=1e-12))
        notes = [n for n in found.notes if "above the header of SAVE_CONFIG" in n]
        assert len(notes) == bool(where)
        if where:
            assert f"[printer] delta_radius: {where}" in notes[0]
            assert f"below 162.820595 (line {saved + 2})" in notes[0]


def test_what_the_firmware_would_not_read_below_its_header_is_refused(tmp_path: Path) -> None:
    file, text = tmp_path / "printer.cfg", V400.read_text()
    own, header = _apart(text)
    last = len(text.splitlines())
    for more, told in (
        ("[printer]\ndelta_radius: 160\n", "the whole block out: put #.# before it"),
        ("# a remark\n", "else move it above the header"),
        (header, "a second header stands below .* keep the newer of the two blocks"),
    ):
        file.write_text(text.rstrip("\n") + "\n" + more)
        with pytest.raises(FileError, match=told) as caught:
            import_printer(file)
        assert caught.value.line == last + 1
    file.write_text(own + "#*#delta_radius = 150\n" + header)  # a comment, above
    kept = import_printer(file).machine.provenance["klipper"]["delta_radius_mm"]
    assert kept == 162.820595


def test_files_of_elsewhere_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.cfg").write_text("[printer]\nsecret\n")
    file = tmp_path / "in" / "printer.cfg"
    for name in ("../secret.cfg", str(tmp_path / "secret.cfg"), "printer.cfg"):
        file.write_text(f"[include {name}]\n" + V400.read_text())
        assert len(import_printer(file).campaigns) == 3
    for own, lacks in (("delta_radius: 160", "stepper_a"), ("kinematics: delta", "delta_radius")):
        file.write_text(f"[include towers.cfg]\n[printer]\n{own}\n")
        with pytest.raises(FileError, match=rf"{lacks}.*towers\.cfg"):
            import_printer(file)
    own = V400.read_text().replace("[probe]", "[prober]")
    for text, told in ((own, False), ("[include probe.cfg]\n" + own, True)):
        file.write_text(text)
        assert told == any("'probe.cfg' is not where" in n for n in import_printer(file).notes)


def test_what_the_probe_did_not_touch_is_left_out(tmp_path: Path) -> None:
    region = "faulty_region_1_min: -20, -20\nfaulty_region_1_max: 20, 20\n"
    text = V400.read_text().replace("[bed_mesh]\n", f"[bed_mesh]\n{region}")
    (tmp_path / "printer.cfg").write_text(text)
    found = import_printer(tmp_path / "printer.cfg")
    assert any("9 of the 625 values of the mesh 'default_25Probe'" in note for note in found.notes)
    mesh = found.campaigns[2]
    at = np.array([[float(v) for v in label.split()] for label in mesh.posture])
    assert len(mesh) == 441 - 9
    assert np.abs(at).max(axis=1).min() > 20


def test_a_mesh_radius_that_was_changed_since_leaves_out_no_touch(tmp_path: Path) -> None:
    """Touches were dropped without a word; a profile has its own radius."""
    for name, touches, told in (("v400-april", [49, 441], 0), ("t1-stock", [29], 1)):
        text = (DATA / f"{name}.cfg").read_text()
        for radius in (60, 1000):
            found = imported(
                tmp_path, re.sub(r"(?m)^mesh_radius:.*", f"mesh_radius: {radius}", text)
            )
            assert [len(c) for c in found.campaigns[1:]] == touches
            assert sum("20 of the 49 values" in note for note in found.notes) == told


def test_a_fine_scan_is_thinned_and_a_scanty_mesh_told(tmp_path: Path) -> None:
    file = tmp_path / "printer.cfg"
    rows = "\n".join("#*#   " + ", ".join(["0.01"] * 81) for _ in range(81))
    text = V400.read_text().partition("#*# [bed_mesh")[0] + (
        f"#*# [bed_mesh scan]\n#*# version = 1\n#*# points =\n{rows}\n"
        f"#*# min_x = -100\n#*# max_x = 100\n#*# min_y = -100\n"
        f"#*# max_y = 100\n"
    )
    found = imported(tmp_path, text)
    assert len(found.campaigns[1]) < 1000
    assert any("one in 3" in note for note in found.notes)
    file.write_text(text.partition("#*# [bed_mesh")[0])
    assert any("7 touches" in note for note in import_printer(file).notes)


@pytest.mark.parametrize("moved", [-0.46])
def test_where_the_owner_set_the_nozzle_stays(tmp_path: Path, moved: float) -> None:
    """Z_OFFSET_APPLY_ENDSTOP moves all endstops: heights of before tell all else as they did."""
    file, text = tmp_path / "printer.cfg", (DATA / "t1-stock.cfg").read_text()

    def set_by(value: float) -> Imported:
        file.write_text(re.sub(
            r"(#\*# position_endstop = )([0-9.]+)",
            lambda m: f"{m[1]}{float(m[2]) + value:.6f}", text,
        ))  # fmt: skip
        return import_printer(file)

    before, after = set_by(0.0), set_by(moved)
    assert not any("moved after the touches" in note for note in before.notes)
    (note,) = (note for note in after.notes if "moved after the touches" in note)
    assert f"{'+' if moved > 0 else MINUS}{abs(moved):.2f} mm away" in note
    assert ("another machine" in note) == (abs(moved) > 3)
    height = []
    for found in (before, after):
        made = studied([found.campaigns[0]], Machine(found.machine)).corrections
        assert made is not None
        carriage = made.old.heights(np.zeros((1, 3))) - made.old.at_endstop
        height.append(made.new.points(carriage + made.new.at_endstop)[0, 2])
    assert height[1] == pytest.approx(height[0], abs=max(3e-6, 2e-6 * abs(moved)))
    # A mesh of before or after bends and leans as it did, and lies at z = 0.
    lies = []
    for found in (before, after):
        firmware, mesh = found.machine.printer.numbers, found.campaigns[1]
        assert firmware is not None
        p = firmware.points(mesh.command + firmware.zero)
        plane = np.column_stack([np.ones(len(p)), p[:, :2]])
        lies.append(np.linalg.lstsq(plane, p[:, 2] - mesh.reading, rcond=None)[0])
    assert lies[1] == pytest.approx([0.0, *lies[0][1:]], abs=1e-7)
    assert [c.name for c in after.campaigns] == list(after.together)


def test_a_mesh_that_is_none_and_one_saved_twice_are_left_out(tmp_path: Path) -> None:
    text = simulated_cfg(DeltaRig())
    block = text.partition("#*# [bed_mesh default]")[2]
    zeros = re.sub(r"-?0\.\d{6}", "0.000000", block)
    found = imported(tmp_path, f"{text}#*# [bed_mesh 80 bed]{block}#*# [bed_mesh stock]{zeros}")
    assert [c.name for c in found.campaigns] == ["mesh-default"]
    assert any("'80 bed' is 'default' to the last digit" in note for note in found.notes)
    assert any("'stock'" in note and "nothing but zeros" in note for note in found.notes)


def test_meshes_that_are_relative_are_not_told_apart_by_their_height(tmp_path: Path) -> None:
    """Neither when they are imported nor when the loop is closed with what was."""
    file, text = tmp_path / "printer.cfg", simulated_cfg(DeltaRig(), count=5)
    block = text.partition("#*# [bed_mesh default]")[2]
    higher = re.sub(r"-?0\.\d{6}", lambda m: f"{float(m[0]) + 0.5:.6f}", block)
    for key, apart in (("", True), ("zero_reference_position: 0, 0\n", False)):
        file.write_text(
            text.replace("[bed_mesh]\n", f"[bed_mesh]\n{key}") + f"#*# [bed_mesh higher]{higher}"
        )
        found = import_printer(file)
        assert bool(found.apart) == apart
        closed = studied(list(found.campaigns), Machine(found.machine))
        assert any("one plate" in text for text in closed.cautions) == apart


def test_the_middle_of_a_plate_alone_gives_no_numbers(tmp_path: Path) -> None:
    text = simulated_cfg(DeltaRig(), count=5)
    found = imported(tmp_path, re.sub(r"(min_[xy] = -|max_[xy] = )120.0", r"\g<1>15.0", text))
    verdict = close_loop(list(found.campaigns), Machine(found.machine))
    assert verdict.firmware.corrections is None
    assert any("out to its rim" in action.words for action in verdict.actions)


@pytest.mark.parametrize("rolls", [0.0, 0.02, -0.02])
def test_a_probe_beside_the_nozzle_leaves_the_middle_where_it_is(
    rolls: float, tmp_path: Path
) -> None:
    """Its offset was set in the middle, with the platform as it is tilted there."""
    rig, text = DeltaRig(errors={"mount_tilt.a.a": rolls}), simulated_cfg(DeltaRig(), count=5)
    (tmp_path / "printer.cfg").write_text(text)
    spec = import_printer(tmp_path / "printer.cfg").machine
    machine = Machine(spec).with_parameters({"mount_tilt.a.a": rolls})
    beside, old = np.array([0.03, -0.01, 0.0]), spec.printer.numbers
    nominal = np.sqrt(rig.L**2 - (rig.radius - rig.r) ** 2)
    middle, there = old.heights(np.stack([np.zeros(3), beside])) - nominal
    (p, turned), (q, _) = rig.pose(middle, np.zeros(3)), rig.pose(there, beside)
    places = np.array([[0.1, 0.0, 0.0], [-0.05, 0.08, 0.0], [-0.02, -0.09, 0.0]])
    touches = old.heights(places) - nominal
    every = [rig.pose(s, near) for s, near in zip(touches, places, strict=True)]
    higher = [at[2] + Rotation.from_rotvec(turn).apply(beside)[2] for at, turn in every]
    lies = np.linalg.solve(np.column_stack([np.ones(3), places[:, :2]]), higher)
    lifted = q[2] - p[2] - Rotation.from_rotvec(turned).apply(beside)[2]
    mesh = import_printer(tmp_path / "printer.cfg").campaigns[0].subset([0, 1, 2])
    mesh = replace(mesh, command=touches, reading=np.zeros(3),
                   setups=(replace(mesh.setups[0], beside=tuple(beside)),))  # fmt: skip
    machine_pose = machine.pose(touches)
    assert np.abs(machine_pose.p[:, 2] - [at[2] for at, _ in every]).max() < 1e-6

    def pose(travel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = machine.pose(travel)
        return found.p, found.R[:, 2]

    _, height = plate_heights(pose, spec.printer.numbers, mesh)
    plane = np.linalg.solve(np.column_stack([np.ones(3), places[:, :2]]), height)
    assert plane[0] == pytest.approx(lies[0] + lifted, abs=2e-6)
    assert (abs(lies[0] + lifted) > 2e-5) == (rolls != 0)


def test_an_endstop_in_inches_is_told_by_its_line(tmp_path: Path) -> None:
    one = simulated_cfg(DeltaRig()).replace("position_endstop: 300", "position_endstop: 11.81", 1)
    stored = (DATA / "t1-stock.cfg").read_text()
    every = re.sub(
        r"(position_endstop *[:=] *)([\d.]+)",
        lambda found: f"{found[1]}{float(found[2]) / 25.4:.5f}", stored,
    )  # fmt: skip
    for text in (one, every):
        with pytest.raises(FileError, match=r"line \d+: \[stepper_[ab]\] position_endstop .*milli"):
            imported(tmp_path, text)
