"""What owners' files have that firmware's examples have not: told in a sentence, and taken so."""

import io
import json
import re
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import FileError
from orthoglide.firmware.klipper import import_printer
from orthoglide.machine import Machine
from orthoglide.verdict import close_loop
from tests.klipper_files import DATA, imported, simulated_cfg
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_cli import run
from tests.tiers import in_turn

ENDSTOP = re.compile(r"(#\*# position_endstop = )([0-9.]+)")
V400, T1 = (DATA / name for name in ("v400-april.cfg", "t1-stock.cfg"))


def moved(text: str, by: float) -> str:
    """A file of which all endstops were moved together, millimetres."""
    return ENDSTOP.sub(lambda m: f"{m[1]}{float(m[2]) + by:.6f}", text)


def higher(text: str, by: float) -> str:
    """A file of which the last mesh lies so much higher, millimetres."""
    head, key, mesh = text.rpartition("[bed_mesh default]")
    return head + key + re.sub(r"-?\d\.\d{6}", lambda m: f"{float(m[0]) + by:.6f}", mesh)


# What import says, in results ---------------------------------------------------------------------


@pytest.mark.thorough
def test_what_import_says_is_said_of_results(tmp_path: Path) -> None:
    """Heights six millimetres off: "run DELTA_CALIBRATE again" was said once, and never again."""
    (tmp_path / "printer.cfg").write_text(moved(T1.read_text(), 6.0))
    folder, out = tmp_path / "in", tmp_path / "out"
    told = run("import", "klipper", tmp_path / "printer.cfg", "--out", folder)
    machine = Machine.load(folder / "machine.toml")
    stored = machine.spec.provenance["klipper"]
    (far,) = (text for text in stored["warnings"] if "run DELTA_CALIBRATE again" in text)
    assert far in told.output
    assert stored["calibrate_again"] is True
    assert not any("taken as probed" in text for text in stored["warnings"])
    verdict = close_loop([folder / "calibration.csv"], machine)
    assert [w for w in verdict.warnings if w.kind == "imported"] == stored["warnings"]
    assert " ".join(far.split()) in " ".join(str(verdict).split()).replace(
        "The heights", "the heights"
    )
    verdict.report(out)
    assert far in json.loads((out / "result.json").read_text())["warnings"]
    assert far in og.identify([folder / "calibration.csv"], machine).warnings
    assert far in verdict.machine.spec.provenance["klipper"]["warnings"]


@pytest.mark.parametrize("names", [["calibration", "mesh-default"], ["calibration"]])
def test_endstops_that_moved_since_the_calibration_are_the_finding(
    names: list[str], tmp_path: Path
) -> None:
    """It was a note beside "Nothing is wrong", and numbers were advised."""
    found = imported(tmp_path, higher(T1.read_text(), 0.5))
    assert found.together == ("calibration", "mesh-default")  # of one shape
    (note,) = found.apart
    assert re.search(r"the plate of mesh-default.csv lies 0\.\d+ mm higher than", note)
    read = [c for c in found.campaigns if c.name in names]
    verdict = close_loop(read, Machine(found.machine))
    assert str(verdict).split()[:2] == note.split()[:2]
    assert " ".join(str(verdict).split()).count(note[:-30]) == 1 + (len(names) == 1)
    assert "Nothing is wrong" not in str(verdict)
    assert verdict.actions[0].words.startswith("Run DELTA_CALIBRATE")
    assert not any(action.kind == "zeros" for action in verdict.actions)


@pytest.mark.parametrize(
    ("leg", "size"), in_turn("abc", [(0.28, 0.14), (0.345, 0.163), (0.42, 0.2)])
)
def test_an_endstop_that_moved_between_two_meshes_is_told(
    leg: str, size: tuple[float, float], tmp_path: Path
) -> None:
    """Of 0.3 mm, on machines of two sizes out of three it was not."""
    arm, radius = size
    rig = DeltaRig(L=arm, radius=radius + 0.032)
    moved_rig = replace(rig, errors={f"joint_offset.{leg}": 3e-4})
    later = simulated_cfg(moved_rig, seed=1).partition("#*# [bed_mesh default]")[2]
    found = imported(tmp_path, f"{simulated_cfg(rig)}#*# [bed_mesh later]{later}")
    (note,) = found.apart
    assert note.kind == "moved"
    toward = float(re.search(r"toward (\d+) degrees", note)[1])
    assert toward == pytest.approx((rig.angles["abc".index(leg)] + 180) % 360, abs=5)
    assert found.together == ()


@pytest.mark.parametrize(
    ("order", "told"),
    [
        (lambda table: table[:, ::-1], "mirrored in x"),
        (lambda table: table[::-1], "mirrored in y"),
        # At seven touches the same as turned by a quarter.
        (lambda table: table.T, "turned by 270 degrees"),
        (lambda table: table[::-1, ::-1], "turned by 180 degrees"),
        (lambda table: -table.astype(float), "taken with heights of the other sign"),
        (lambda table: table, ""),
    ],
)
def test_a_mesh_in_another_order_of_rows_is_told(
    order: Callable[[Any], Any], told: str, tmp_path: Path
) -> None:
    """It was taken as it stands, as its heights differ by less than those of other plates."""
    rows = re.compile(r"(#\*# points =.*\n)((?:#\*# \s+-?[\d.]+, .*\n)+)")

    def ordered(match: re.Match[str]) -> str:
        table = np.array([line[3:].split(",") for line in match[2].splitlines()])
        return match[1] + "".join(f"#*# \t{','.join(map(str, row))}\n" for row in order(table))

    text, count = rows.subn(ordered, (DATA / "held" / "sr-cupsster.cfg").read_text(), count=1)
    assert count == 1
    found = [str(note) for note in imported(tmp_path, text).apart]
    assert bool(found) == bool(told)
    for note in found:
        (ways,) = re.findall(r"0\.0\d\d mm if \S+\.csv is (.*)\. Correct", note)
        assert told in ways.split(" or ")


def test_a_noisy_probe_moves_no_endstop(tmp_path: Path) -> None:
    text, moves = T1.read_text(), 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        noisy = re.sub(
            r"(#\*# height\d = )(.*)",
            lambda m, rng=rng: f"{m[1]}{float(m[2]) + 0.05 * rng.standard_normal():.6f}",
            text,
        )
        moves += bool(imported(tmp_path, noisy).apart)
    assert moves == 0


@pytest.mark.parametrize("by", [pytest.param(-1.6, marks=pytest.mark.thorough), 1.6])
def test_lists_that_contradict_each_other_accuse_no_touch(by: float, tmp_path: Path) -> None:
    """The radius was changed by hand after both: a touch of the middle was named as a slip."""
    text = re.sub(
        r"(#\*# delta_radius = )(.*)",
        lambda m: f"{m[1]}{float(m[2]) + by:.6f}",
        (DATA / "flight505.cfg").read_text(),
    )
    found = imported(tmp_path, text)
    verdict = studied(found.campaigns, Machine(found.machine))
    assert [note.kind for note in found.apart] == ["apart"]
    assert verdict.blunders == ()


@pytest.mark.parametrize(
    ("file", "share", "told", "tower"),
    [
        (T1, 0.98, "heights of", ""),
        (V400, 0.995, "heights and distances of", ""),
        (V400, 1.25, "heights", ""),
        (T1, 0.99, "heights of", "c"),
        (V400, 1.01, "heights and distances of", "b"),
        (V400, 0.8, "heights and distances of", "a"),
    ],
)
def test_a_rotation_distance_that_was_changed_since_is_told(
    file: Path, share: float, told: str, tower: str, tmp_path: Path
) -> None:
    """It was told as endstops that moved, and the distances made other rods of it; of one tower
    alone the heights were left out, and numbers of the mesh were advised.
    """
    turn = re.compile(rf"((?s:\[stepper_{tower}.*?)rotation_distance *[:=] *)([\d.]+)")
    text = turn.sub(
        lambda m: f"{m[1]}{float(m[2]) * share:.6f}", file.read_text(), count=len(tower)
    )
    sound, found = imported(tmp_path, file.read_text()), imported(tmp_path, text)
    (note,) = (n for n in found.notes if n.kind == "changed")
    assert note.startswith(f"the {told}")
    assert (f"with steps of tower {tower} that" in note) == bool(tower)
    size, was = re.search(r"are (\S+) % .* of (\S+) mm:", note).groups()
    assert float(size) == pytest.approx(abs(1 / share - 1) * 100, abs=0.011)
    assert float(was) == pytest.approx(float(turn.search(file.read_text())[2]), rel=2e-4)
    assert not any("Z_OFFSET_APPLY_ENDSTOP" in n for n in found.notes)
    command = found.campaigns[0].command
    assert command == pytest.approx(sound.campaigns[0].command, abs=5e-5)
    assert found.machine.provenance["klipper"]["calibrate_again"] is True


@pytest.mark.parametrize(("arms", "fitted"), [(r"\g<0>", True), ("arm_length = 303.0", False)])
def test_arms_that_the_firmware_fitted_are_no_knowledge_of_the_rods(
    arms: str, fitted: bool, tmp_path: Path
) -> None:
    """What a slip of a distance did to them was told as rods that are longer than nominal."""
    text = re.sub(r"arm_length = [0-9.]+", arms, V400.read_text())
    spec = imported(tmp_path, text).machine
    free = [sd for weights, sd in spec.shared_errors if "leg_length.a" in weights]
    assert [*spec.fitted] == ["leg_length"] * fitted
    assert (min(free, default=0.0) > 1e-3) == fitted
    assert [*spec.entered] == ["leg_length"] * (not fitted)  # equal ones may be entered wrong


# Lines above the header of SAVE_CONFIG ------------------------------------------------------------


def test_an_override_that_makes_another_machine_is_named_with_its_remedy(tmp_path: Path) -> None:
    """It was refused as mistyped, or as given in inches, where the saved numbers are right."""
    text = f"[stepper_a]\nposition_endstop: 110\n{T1.read_text()}"
    told = r"stop at about one height.*position_endstop: 110 \(line 2\), below .*Remove the lines"
    with pytest.raises(FileError, match=told):
        imported(tmp_path, text)


# Heights by the nozzle itself ---------------------------------------------------------------------


def test_heights_by_hand_are_touches_of_the_nozzle(tmp_path: Path) -> None:
    """METHOD=manual stores 0; z_offset is a probe's that had no part in it."""
    text = re.sub(r"(#\*# height\d = ).*", r"\g<1>0.0", moved(T1.read_text(), 0.24))
    text = text.replace("z_offset: -0.24", "x_offset: 20\nz_offset: 18.01")
    found = imported(tmp_path, text)
    (note,) = (n for n in found.notes if "[delta_calibrate]" in n and "z_offset of 0" in n)
    assert "taken as touches of the nozzle itself" in note
    assert not found.campaigns[0].beside.any()
    # Of a probe whose offset was 0 then, meshes lie as far below as it hangs.
    (apart,) = imported(tmp_path, higher(text, -18.0)).apart
    assert "their heights differ by 18" in apart
    # A nozzle that is its own probe.
    small = imported(tmp_path, text.replace("z_offset: 18.01", "z_offset: -0.2"))
    assert any("0.2 mm too high or too low" in note for note in small.notes)


# Meshes -------------------------------------------------------------------------------------------

SPOILT = {
    "ragged": (", 0.014937, 0.014937, 0.014937, 0.014937, 0.014937, 0.014937\n", "\n", "rows of 9"),
    "turned round": ("max_x = 147.0", "max_x = -148.0", "not above min_x"),
    "beyond": ("max_x = 147.0", "max_x = 600.0", "beyond the arms: probe the mesh again"),
    "of 2019": ("version = 1\n", "x_offset = 0\n", "as in meshes of before December 2019"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_mesh_that_cannot_be_read_is_left_out_alone(kind: str, tmp_path: Path) -> None:
    old, new, why = SPOILT[kind]
    text = V400.read_text()
    mesh = text.index("[bed_mesh default_9Probe]")
    spoilt = text[:mesh] + text[mesh:].replace(old, new, 1)
    assert spoilt != text
    found = imported(tmp_path, spoilt)
    assert [c.name for c in found.campaigns] == ["calibration", "mesh-default_25Probe"]
    (note,) = (n for n in found.notes if "left out: mesh 'default_9Probe': " in n)
    assert why in note
    assert "printer.cfg, line " in note
    head, _, saved = spoilt.partition("#*# <-")
    alone = re.sub(r"#\*# (height|distance)\d+(_pos\d?)? =.*\n", "", f"{head}#*# <-{saved}")
    last = alone.index("#*# [bed_mesh default_25Probe]")
    with pytest.raises(FileError, match=re.escape(why[:12])):
        imported(tmp_path, alone[:last])


def test_a_mesh_that_is_shifted_is_told(tmp_path: Path) -> None:
    """It was left out as 0.3 mm higher before its owner set the nozzle, and shifted silently
    after.
    """
    told = [
        [
            n
            for n in imported(tmp_path, moved(higher(T1.read_text(), 0.5), by)).notes
            if "shifted" in n
        ]
        for by in (0.0, 0.2)
    ]
    assert not told[0]
    size = re.search(r"'default' is shifted by (\S+) mm, to z = 0 .* were moved", told[1][0])
    assert size is not None
    assert float(size[1].replace("\N{MINUS SIGN}", "-")) == pytest.approx(-0.5, abs=0.1)


# Files that one includes --------------------------------------------------------------------------


def test_includes_go_up_within_the_folder(tmp_path: Path) -> None:
    """As the firmware reads them: from where the including file stands."""
    own, header, saved = V400.read_text().partition("#*# <-")
    towers = own.index("[stepper_a]")
    for folder in ("config/base", "config/hard [1] ware", "other"):
        (tmp_path / folder).mkdir(parents=True)
    top = tmp_path / "config" / "printer.cfg"
    top.write_text(f"[include base/base.cfg]\n{header}{saved}")
    base = tmp_path / "config" / "base" / "base.cfg"
    base.write_text("[include ../hard*/*.cfg]\n" + own[:towers])
    (tmp_path / "config" / "hard [1] ware" / "towers.cfg").write_text(
        "[include ../printer.cfg]\n[include more.cfg]\n"
    )
    (tmp_path / "config" / "hard [1] ware" / "more.cfg").write_text(own[towers:])
    assert len(import_printer(top).campaigns) == 3
    base.write_text("[include ../../other/*.cfg]\n" + own[:towers])
    (tmp_path / "other" / "more.cfg").write_text(own[towers:])
    (note,) = (n for n in import_printer(top).notes if "left out: heights and distances" in n)
    assert re.search(r"stepper_a.*may stand in '\.\./\.\./other/\*\.cfg'", note)


def test_files_that_are_missing_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"it may stand in '0\.cfg', '1\.cfg': put that beside"):
        imported(tmp_path, "[include 0.cfg]\n[include 1.cfg]\n[printer]\nkinematics: delta\n")


# What is no printer.cfg ---------------------------------------------------------------------------

OTHERS = {
    "Configuration.h": (b"/**\n * Marlin\n */\n#pragma once\n#define DELTA\n",
                        "Marlin's configuration"),
    "m503.txt": (b"Send: M503\nRecv: echo: M92 X80.00 Y80.00\nRecv: echo:  M665 L280 R142\n",
                 "Marlin's M503 prints"),
    "m503.g": (b"echo:  G21    ; mm\necho:  M569 S1 X Y Z\necho:  M666 X-0.3 Y-1 Z0\n",
               "Marlin's M503 prints"),
    "config.g": (b"; Configuration\nG90\nM550 P\"Kossel\"\nM665 R105.6 L215\n", "RepRapFirmware's"),
    "config-override.g": (b"; config-override.g file generated by M500\nM665 L315:315\n",
                          "RepRapFirmware's"),
    "klippy.log": (b"Starting Klippy...\n===== Config file =====\n[printer]\nkinematics: delta\n"
                   + b"Stats 1.0\n" * 200000, "Klipper's log"),
    "config.zip": (b"PK\x03\x04" + bytes(30), "unpack it"),
    "rotary.cfg": (b"[printer]\nkinematics: rotary_delta\n", "arms that turn about shoulders"),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_no_such_file_is_told_as_what_it_is(name: str, tmp_path: Path) -> None:
    content, told = OTHERS[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError, match=re.escape(told)) as caught:
        import_printer(tmp_path / name)
    assert ("docs/linear-deltas.md" in str(caught.value)) == name.endswith((".h", ".g", ".txt"))


def test_a_folder_with_a_printer_s_file_and_one_packed(tmp_path: Path) -> None:
    (tmp_path / "printer.cfg").write_text(T1.read_text())
    assert import_printer(tmp_path).machine == import_printer(tmp_path / "printer.cfg").machine
    with tarfile.open(tmp_path / "config.tar.gz", "w:gz") as packed:
        packed.addfile(tarfile.TarInfo("printer.cfg"), io.BytesIO(b""))
    with pytest.raises(FileError, match="unpack it"):
        import_printer(tmp_path / "config.tar.gz")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match=r"empty: this folder holds no printer\.cfg: give"):
        import_printer(tmp_path / "empty")
