"""The command line: what it makes, what it refuses and how; nothing is left half done."""

from __future__ import annotations

import csv
import io
import json
import os
import re
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import orthoglide as og
from orthoglide.cli import cli
from orthoglide.explanation.identifying import identify
from orthoglide.machine_file import MachineFile, machine_text

EXPERIMENT_2 = (files("orthoglide") / "data" / "experiment2.csv").read_text()
EXPERIMENT_3 = (files("orthoglide") / "data" / "experiment3.csv").read_text()
ROOT = Path(__file__).parents[1]
NEVER = {"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/"), "PYTHONPATH": str(ROOT)}


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def done(*arguments: str | Path) -> str:
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return result.stdout


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of one's own with the published campaign, to work in."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiment2.csv").write_text(EXPERIMENT_2)
    return tmp_path


PLANTED = {"joint_offset.x": 0.8e-3, "joint_offset.y": -0.4e-3, "leg_length.z": 0.06e-3}


def planted_machine(folder: Path) -> Path:
    machine = og.Machine.nominal().with_parameters(PLANTED)
    machine.save(folder / "planted.toml")
    return folder / "planted.toml"


def a_folder(here: Path) -> list[str]:
    """A command that writes a folder of several files, and computes little."""
    return ["export", "--machine", planted_machine(here).name, "--force", "--out", "out"]


# --- What is refused ------------------------------------------------------------------------

Edit = Callable[[list[list[str]]], object]


def rows(edit: Edit) -> str:
    """The published campaign, spoilt."""
    table = list(csv.reader(io.StringIO(EXPERIMENT_2)))
    edit(table)
    stream = io.StringIO(newline="")
    csv.writer(stream, lineterminator="\n").writerows(table)
    return stream.getvalue()


TOML = machine_text(MachineFile())


# What is asked, and the words of the one sentence with which it is refused.
OPTIONS = [
    (("identify", "--free", "joint_ofset"), "there is no effect 'joint_ofset'"),
    (("identify", "--free", ""), "--free takes NAME,..., not ''"),
    (("identify", "--free", "joint_offset.w"), "there is no parameter 'joint_offset.w'"),
    (("identify", "--free", "joint_offset", "--own", "leg_length"),
     "own to each campaign but not free"),
    (("identify", "--noise", "0"), "--noise must be a number of millimetres"),
    (("identify", "--noise", "nan"), "--noise must be a number of millimetres"),
    (("identify", "--noise", "1e-300"), "from 1e-06 to 1, not 1e-300"),
    (("identify", "--noise", "5"), "from 1e-06 to 1, not 5"),
    (("identify", "--noise", "1e300"), "from 1e-06 to 1, not 1e+300"),
    (("identify", "--reduced", "--free", "axis_tilt"), "free nothing else"),
    (("identify", "--no-priors", "--free", "joint_offset,leg_length,axis_tilt,axis_offset"),
     "do not determine"),
    (("identify", "experiment2.csv"), "two campaigns have the same name"),
    (("identify", "."), "cannot be read"),
    (("design", "--owns", "leg", "--free", "nonsense"), "--owns and --free exclude each other"),
    (("design", "--owns", "leg", "--want", "TCP=1"), "--owns and --want exclude each other"),
    (("design", "--owns", "leg", "--noise", "0.01"), "--owns and --noise exclude each other"),
    (("design", "--owns", "leg", "--detect"), "--owns and --detect exclude each other"),
    (("design", "sheet.csv", "--owns", "leg"), "--owns and SHEET.csv exclude each other"),
    (("simulate", "--sheet", "a.csv", "--kind", "sweep"), "--sheet and --kind exclude"),
    (("simulate", "--exact", "--noise", "0.5"), "--exact and --noise exclude each other"),
    (("simulate", "--noise", "-1"), "--noise must be a number of millimetres from 0 to 1, not -1"),
    (("simulate", "--tcp", "out"), "give each a name of its own"),
    (("simulate", "--tcp", "no/where.csv"), "no/where.csv: cannot be written"),
    (("simulate", "--error", "joint_offset.x=1,joint_offset.x=2"),
     "--error has joint_offset.x twice: give it once"),
    (("simulate", "--error", "=3"), "--error takes NAME=NUMBER, a finite number, not '=3'"),
    (("simulate", "--error", "joint_offset.x=inf"), "--error takes NAME=NUMBER, a finite number"),
    (("simulate", "--error", "gauge_scale.nope=0.01"),
     "takes the name of a setup behind the dot, one of xy-0.5, xz-0.5"),
    (("rehearse", "--sheet", "a.csv", "--owns", "leg"), "--owns and --sheet exclude each other"),
    (("rehearse", "--jobs", "0"), "jobs must be a number of processes"),
    (("view", "--no-open"), "--out and --no-open exclude each other"),
]  # fmt: skip
NEEDED = {"identify": ("experiment2.csv",), "close-loop": ("experiment2.csv",),
          "simulate": ("--machine", "m.toml")}  # fmt: skip
PLACES = [
    (("forward", "1", "2"), "exactly three"),
    (("forward",), "either three numbers in mm"),
    (("forward", "nan", "300", "300"), "finite"),
    (("forward", "0.31", "0.31", "0.31"), "in metres"),
    (("forward", "310", "310", "400"), "axis z is outside its stroke"),
    (("inverse", "500", "0", "0"), "leg y is 189.750 mm too short: move the point towards"),
    (("inverse", "0", "0", "1e301"), "leg x is 1e+301 mm too short"),
    (("inverse", "--csv", "long.csv", "--out", "out.csv"), "point 2: leg y is"),
    (("inverse", "70", "0", "0"), "outside its stroke of 210.25 to 370.25"),
    (("forward", "--csv", "far.csv"), "far.csv, line 3"),
    (("forward", "1", "2", "3", "--out", "out.csv"), "or --csv with the rows"),
    (("forward", "--csv", "far.csv", "--out", "out.csv"), "far.csv, line 3"),
    (("inverse", "--csv", "far.csv", "--out", "out.csv"), "p_x_mm"),
    (("compensate", "long.csv", "--machine", "m.toml", "--out", "out.csv"), "long.csv, line 3"),
    (("compensate", "long.csv", "planted"), "found 'planted'"),
    (("export", "planted"), "found 'planted'"),
    (("identify",), "name at least one campaign"),
    (("check", "far.csv"), "give OLD and NEW"),
    (("check", "m.toml", "far.csv"), "a machine file has no readings"),
]
WRITING = ("protocol", "simulate", "design", "identify", "close-loop", "compare")
REFUSED = [
    *(((*a, *NEEDED.get(a[0], ()), "--out", "out"), words) for a, words in OPTIONS),
    *PLACES,
    *(
        ((name, *NEEDED.get(name, ()), "--out", "a" * 300), "a: cannot be written (file name too")
        for name in WRITING
    ),
]


@pytest.mark.parametrize(
    ("arguments", "words"), REFUSED, ids=[" ".join(a)[:60] for a, _ in REFUSED]
)
def test_what_cannot_be_asked(arguments: tuple[str, ...], words: str, here: Path) -> None:
    og.Machine.nominal().save("m.toml")
    (here / "far.csv").write_text("rho_x_mm,rho_y_mm,rho_z_mm\n300,300,300\n300,300,500\n")
    (here / "long.csv").write_text("p_x_mm,p_y_mm,p_z_mm\n0,0,0\n500,0,0\n")
    before = tree(here)
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert result.stderr.startswith("orthoglide: ")
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert tree(here) == before


def test_a_command_is_a_number() -> None:
    result = run("forward", "300", "300", "ten")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "'ten' is not a number" in result.stderr


def test_what_has_an_effect_is_taken(here: Path) -> None:
    og.Machine.nominal().save("m.toml")
    made = ("simulate", "--machine", "m.toml", "--exact")
    done(*made, "--seed", "5", "--tcp", "t.csv", "--out", "a.csv")
    done(*made, "--seed", "6", "--tcp", "u.csv", "--out", "b.csv")
    assert (here / "a.csv").read_bytes() == (here / "b.csv").read_bytes()
    assert (here / "t.csv").read_bytes() != (here / "u.csv").read_bytes()
    done("simulate", "--machine", "m.toml", "--sheet", "a.csv", "--seed", "1", "--out", "c.csv")
    done("design", "--owns", "leg", "--seed", "1", "--quiet")


def test_a_sound_machine_is_told_that_nothing_is_advised(here: Path) -> None:
    """And a machine whose residual needs a search is not told that no cause explains it."""
    og.Machine.nominal().save("m.toml")
    done("simulate", "--machine", "m.toml", "--seed", "1", "--out", "sound.csv")
    assert "No correction is advised" in done("identify", "sound.csv", "--machine", "m.toml")
    worn = ("--error", "axis_tilt.x.z=0.005", "--out", "worn.csv")
    done("simulate", "--machine", "m.toml", "--seed", "1", *worn)
    said = done("identify", "worn.csv", "--machine", "m.toml")
    assert "no cause was searched for" in said
    assert "No correction is advised" not in said


@pytest.mark.parametrize("made", ["mkdir", "open"])
def test_interrupted_the_moment_something_stands(
    here: Path, monkeypatch: pytest.MonkeyPatch, made: str
) -> None:
    """The system had made the folder, or the file, and the signal came before it was noted."""
    real = getattr(Path, made)

    def interrupt(path: Path, *arguments: Any, **options: Any) -> Any:
        done = real(path, *arguments, **options)
        if path.name.startswith(".orthoglide-"):
            raise KeyboardInterrupt
        return done

    command = a_folder(here) if made == "mkdir" else ["protocol", "--out", "sheet.csv"]
    before = os.listdir(here)
    monkeypatch.setattr(Path, made, interrupt)
    assert run(*command).exit_code == 130
    assert os.listdir(here) == before


def test_a_disk_that_fails(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    command = a_folder(here)
    monkeypatch.setattr(Path, "write_bytes", full)
    result = run(*command)
    assert result.exit_code == 2
    assert "out: cannot be written (no space left on device)" in result.stderr
    assert sorted(os.listdir(here)) == ["experiment2.csv", "planted.toml"]


# --- What is made ---------------------------------------------------------------------------


def test_json_is_the_file_and_a_calibrated_machine_is_a_machine(here: Path) -> None:
    text = done("identify", "experiment2.csv", "--out", "out", "--json")
    assert text.encode() == (here / "out" / "result.json").read_bytes()
    result = json.loads(text)
    assert result["verdict"] == "unexplained"
    assert result["parameters"]["joint_offset.z"]["value"] == pytest.approx(-1.723, abs=1e-3)
    estimate = identify(og.read_campaign("experiment2.csv"))
    machine = og.Machine.load("out/calibrated.toml")
    assert machine.values == estimate.machine.values
    assert machine.spec.provenance["campaigns"][0]["file"] == "experiment2.csv"
    shown = done("inverse", "10", "-20", "5", "--machine", "out/calibrated.toml").split()
    goal = done("forward", *shown, "--machine", "out/calibrated.toml").split()
    np.testing.assert_allclose(np.array(goal, float), [10, -20, 5], atol=2e-6)
    # What it predicts is what the report calls the prediction: no residual gets worse by the file.
    again = og.read_campaign("experiment2.csv")
    np.testing.assert_allclose(
        machine.readings(again), estimate.machine.readings(again), rtol=0, atol=1e-15
    )


# --- Sheets, simulated campaigns and kinematics ---------------------------------------------


def test_errors_that_change_no_reading_are_said(here: Path) -> None:
    og.Machine.nominal().save("nominal.toml")
    errors = "joint_offset.x=0.5,gauge_scale.xy-0.5=0.01,screw_error.x.sin=0.5"
    errors += ",drive_compliance.y=1e-4,thermal_growth.z=1e-5"
    result = run("simulate", "--machine", "nominal.toml", "--error", errors, "--out", "a.csv")
    assert result.exit_code == 0
    lines = result.stderr.splitlines()
    assert [line.partition(" changes no reading, as ")[::2] for line in lines] == [
        ("warning: screw_error.x.sin", "the machine file gives no screw_pitch_mm"),
        ("warning: drive_compliance.y", "the sheet does not vary load_N"),
        ("warning: thermal_growth.z", "the sheet does not vary temperature_C"),
    ]


def test_no_number_is_cut_on_a_narrow_terminal(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = dict[int, str]()
    for columns in (60, 100):
        monkeypatch.setenv("COLUMNS", str(columns))
        told[columns] = done("identify", "experiment2.csv", "--free", "joint_offset,axis_tilt")
        assert max(map(len, told[columns].splitlines())) <= columns
    narrow, wide = (re.findall(r"[+−]?\d[\d.]*", told[columns]) for columns in (60, 100))
    assert sorted(narrow) == sorted(wide)


@pytest.mark.parametrize(
    ("out", "words"), [((), ""), (("--out", "kept"), "; the same command goes on from what --out")]
)
def test_an_interrupted_rehearsal_goes_on_from_a_folder_only(
    out: tuple[str, ...], words: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("orthoglide.rehearsal.rehearse", interrupt)
    result = run("rehearse", *out)
    assert result.exit_code == 130
    said = "orthoglide: interrupted: nothing is left half written"
    assert result.stderr.strip().startswith(said + words)
    assert ("goes on" in result.stderr) == bool(out)


def test_what_a_design_sees_fits_the_terminal(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = ("--detect", "--count", "6")
    monkeypatch.setenv("COLUMNS", "80")
    whole = done("design", *options).splitlines()
    assert 55 < max(map(len, whole)) <= 80
    assert " is most like " in " ".join(" ".join(whole).split())
    monkeypatch.setenv("COLUMNS", "60")
    assert max(map(len, done("design", *options).splitlines())) <= 60


def test_a_design_in_one_line_answers_what_was_asked(here: Path) -> None:
    """``--quiet`` did not say whether the wanted accuracy is reached."""
    plain = ("design", "--count", "6", "--quiet")
    shown = "6 readings show 4 of 6 unknowns"
    assert done(*plain).strip() == f"{shown}."
    (line,) = done(*plain, "--want", "TCP=0.5,joint_offset.x=0.0001").splitlines()
    reached, not_reached = line.removeprefix(f"{shown}; ").split("; ")
    assert reached.startswith("design, sigma 0.5 mm of TCP")
    assert "takes 1 visit to every station" in reached
    assert not_reached.startswith("design, sigma 0.0001 mm of joint_offset.x")
    assert "is out of reach of repeats" in not_reached
    done("protocol", "--out", "sheet.csv")
    (line,) = done(*plain, "sheet.csv", "--want", "TCP=0.5", "--detect").splitlines()
    named = [re.match(r"\w+", part)[0] for part in line.split("; ")[1:]]  # type: ignore[index]
    assert named == ["sheet", "sheet", "design", "design"]
    assert line.count(" effects are seen, ") == 2


def test_forward_and_inverse_on_a_csv(here: Path) -> None:
    machine = ("--machine", planted_machine(here))
    (here / "goal.csv").write_text("name,p_x_mm,p_y_mm,p_z_mm\na,1,2,3\n\nb,-20,10,5\n")
    done("inverse", "--csv", "goal.csv", "--out", "rho.csv", *machine)
    found = list(csv.DictReader((here / "rho.csv").open()))
    assert [row["name"] for row in found] == ["a", "b"]
    keep = ["name,rho_x_mm,rho_y_mm,rho_z_mm"]
    keep += [",".join([r["name"], *(r[f"rho_{leg}_mm"] for leg in "xyz")]) for r in found]
    (here / "command.csv").write_text("\n".join(keep) + "\n")
    done("forward", "--csv", "command.csv", "--out", "again.csv", *machine)
    again = list(csv.DictReader((here / "again.csv").open()))
    for row, goal in zip(again, [(1, 2, 3), (-20, 10, 5)], strict=True):
        reached = [float(row[f"p_{leg}_mm"]) for leg in "xyz"]
        np.testing.assert_allclose(reached, goal, atol=2e-6)
    # Commands of a path are stated in two ways that agree, and with the sides of their approach.
    done("compensate", "goal.csv", "--out", "commands.csv", *machine)
    done("forward", "--csv", "commands.csv", "--out", "reached.csv", *machine)
    for row in csv.DictReader((here / "reached.csv").open()):
        for leg in "xyz":
            reached, goal = (float(row[f"{name}_{leg}_mm"]) for name in ("computed_p", "p"))
            assert reached == pytest.approx(goal, abs=2e-6)
    (here / "travel.csv").write_text("travel_x_mm,travel_y_mm,travel_z_mm\n0,0,0\n")
    done("forward", "--csv", "travel.csv", "--out", "zero.csv")
    assert (here / "zero.csv").read_text().splitlines()[1] == "0,0,0,0.000000,0.000000,0.000000"


def test_columns_that_are_copied_are_said_to_be(here: Path) -> None:
    """A user took copied columns for results."""
    more, cells = "load_N,shape_mm", "100,about 2"
    (here / "forward.csv").write_text(
        f"travel_x_mm,travel_y_mm,travel_z_mm,p_x_mm,{more}\n0,0,0,7,{cells}\n"
    )
    (here / "inverse.csv").write_text(f"p_x_mm,p_y_mm,p_z_mm,{more}\n0,0,0,{cells}\n")
    for command, first, value in (
        ("forward", "computed_p_x_mm", 0.0), ("inverse", "rho_x_mm", 310.25),
    ):  # fmt: skip
        told = done(command, "--csv", f"{command}.csv", "--out", f"{command}-out.csv")
        (row,) = csv.DictReader((here / f"{command}-out.csv").open())
        assert float(row[first]) == value
        assert (row["load_N"], row["shape_mm"]) == ("100", "about 2")
        told = " ".join(told.split())
        assert f"1 row, computed: {first}, " in told
        assert told.endswith("others are copied")
        text = " ".join(done(command, "--help").split())
        assert "Computed columns come last in the CSV" in text
        assert "copied as they are and have no effect" in text


def test_forward_and_inverse_of_another_layout(here: Path) -> None:
    """Commands are travel under the legs' own names, counted as the controller does."""
    layout = '\n[layout]\nkind = "linear-delta"\nradius_mm = 200\nangles_deg = [210, 330, 90]\n'
    spec = TOML.replace("zero_mm = [\n    0.0,\n    0.0,\n    0.0,", "zero_mm = [\n    5, 0, -5,")
    assert spec != TOML
    (here / "delta.toml").write_text(spec + layout)
    (here / "t.csv").write_text("travel_a_mm,travel_b_mm,travel_c_mm\n5,0,-5\n9,-3,-2.5\n")
    options = ("--machine", "delta.toml", "--csv")
    done("forward", *options, "t.csv", "--out", "p.csv")
    points = list(csv.DictReader((here / "p.csv").open()))
    assert [float(points[0][f"p_{axis}_mm"]) for axis in "xyz"] == [0, 0, 0]
    (here / "only.csv").write_text(
        "p_x_mm,p_y_mm,p_z_mm\n"
        + "".join(f"{p['p_x_mm']},{p['p_y_mm']},{p['p_z_mm']}\n" for p in points)
    )
    done("inverse", *options, "only.csv", "--out", "again.csv")
    again = list(csv.DictReader((here / "again.csv").open()))
    for row, point in zip(again, points, strict=True):
        for leg in "abc":
            assert float(row[f"travel_{leg}_mm"]) == pytest.approx(
                float(point[f"travel_{leg}_mm"]), abs=2e-6
            )
