"""Firmware as an add-on: how one is found, and lists of plate points as readings of a machine."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide import add_ons
from orthoglide.errors import FileError, InputError
from orthoglide.firmware.klipper import import_printer
from orthoglide.firmware.plate_lists import import_plates
from orthoglide.geometry import fit_plane
from orthoglide.machine_file import (
    DeltaKinematics,
    machine_text,
    parse_machine_file,
    read_machine_file,
)
from orthoglide.observations import read_readings
from orthoglide.observations.touched_plates import _note, disagreements
from tests.command_line import run as call
from tests.klipper_files import DATA

FIELD = Path(__file__).parent / "data" / "field"
WORDS = FIELD / "other-firmware-words"
MACHINE = read_machine_file(WORDS / "machine.toml")
SPOTS = np.array([(x, y) for x in np.linspace(-0.09, 0.09, 9) for y in np.linspace(-0.09, 0.09, 9)
                  if np.hypot(x, y) < 0.0901]).T  # fmt: skip


# How an add-on is found ---------------------------------------------------------------------------


class Other:
    """An add-on that somebody else wrote."""

    def stored(self, table: Any) -> None:
        return None


def test_the_add_ons_of_the_package_need_no_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    add_ons._entry_points.cache_clear()
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: ())
    found = add_ons.add_on("klipper").read(DATA / "electrocally.cfg")
    assert len(found.campaigns) == 2
    assert found.machine.firmware == found.machine.provenance["klipper"]["numbers"]
    with pytest.raises(InputError, match=r"no firmware 'other': it is one of klipper"):
        add_ons.add_on("other")
    add_ons._entry_points.cache_clear()


def test_another_add_on_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = replace(og.MachineFile(), provenance={"other": {"numbers": "other-1"}})
    assert parse_machine_file(machine_text(spec)).firmware == ""  # a table of nobody
    add_ons._entry_points.cache_clear()
    mine = EntryPoint("other", "tests.test_firmware:Other", add_ons.ENTRY_POINT_GROUP)
    broken = EntryPoint("broken", "tests.nowhere:Other", add_ons.ENTRY_POINT_GROUP)
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: (mine, broken))
    assert add_ons.add_on("other").__name__ == "Other"
    assert spec.firmware == "other-1"
    with pytest.raises(InputError, match="for the firmware broken cannot be loaded"):
        add_ons.add_on("broken")
    add_ons._entry_points.cache_clear()


# Files of other firmware --------------------------------------------------------------------------


def test_a_printer_s_file_is_sent_to_its_own_command() -> None:
    with pytest.raises(FileError, match=f"import klipper {DATA / 'electrocally.cfg'} --out DIR"):
        import_plates(DATA / "electrocally.cfg", MACHINE)


@pytest.mark.parametrize(
    ("name", "text", "angles"),
    [
        ("m503.txt", "echo:  M665 L218.00 R100.50 H230 X-0.25 Y0.50 Z0\necho:  M666 X0 Y0 Z-1\n",
         "209.75, 330.5, 90"),
        ("config.g", "M574 X2 S1\nM665 R100.5 L218:218:218 B85 H230 X0.3 Y-0.2 Z0 ; sizes\n",
         "210.3, 329.8, 90"),
        ("Configuration.h", "#define DELTA\n#define DELTA_DIAGONAL_ROD 218.0\n#define DELTA_RADIUS "
         "100.5\n#define DELTA_TOWER_ANGLE_TRIM { 0.1, -0.2, 0 }\n", "210.1, 329.8, 90"),
        ("eeprom.txt", "EPR:3 881 218 Rod\nEPR:3 885 100.5 Radius\nEPR:3 901 210.1 A\n"
         "EPR:3 905 329.9 B\nEPR:3 909 90 C\n", "210.1, 329.9, 90"),
    ],
)  # fmt: skip
def test_angles_of_towers_are_named_with_the_sizes(
    name: str, text: str, angles: str, tmp_path: Path
) -> None:
    """Without them the places of a printer with trims were computed for other towers."""
    (tmp_path / name).write_text(text)
    said = rf"L = 218, radius_mm less r_mm = 100\.5 and angles_deg = \[{angles}\],"
    with pytest.raises(FileError, match=said):
        import_plates(tmp_path / name, MACHINE)


# Lists of plate points ----------------------------------------------------------------------------


def listed(folder: Path, text: str, name: str = "points.csv") -> og.Imported:
    """A list of that text, imported."""
    (folder / name).write_text(text)
    return import_plates(folder / name, MACHINE)


def points(found: og.Imported, k: int = 0) -> np.ndarray:
    """Where the firmware had the nozzle at the touches of a list ``(n, 3)``, millimetres."""
    kinematics = found.machine.kinematics
    assert kinematics is not None
    return np.round(kinematics.places(found.campaigns[k].command) * 1e3, 6) + 0.0


def test_a_height_map_is_read_where_it_was_touched(tmp_path: Path) -> None:
    (campaign,) = import_plates(WORDS / "heightmap.csv", MACHINE).campaigns
    assert len(campaign) == 13
    assert set(campaign.kind) == {"plate"}
    p = points(import_plates(WORDS / "heightmap.csv", MACHINE))
    assert p[:4].tolist() == [[0, -80, 0.105], [-40, -40, 0.031], [0, -40, 0.022], [40, -40, 0.045]]
    assert (campaign.approach == -1).all()
    run = call("import", "plates", WORDS / "heightmap.csv", "--machine", WORDS / "machine.toml",
               "--out", tmp_path / "in")  # fmt: skip
    assert run.code == 0, run.output
    assert f"close-loop {tmp_path}/in/*.csv --machine {WORDS}/machine.toml" in run.output
    assert [file.name for file in (tmp_path / "in").iterdir()] == ["heightmap.csv"]
    (again,) = read_readings(tmp_path / "in" / "heightmap.csv", MACHINE)
    assert np.array_equal(again.command, campaign.command)


PLAIN = [(0, 0, 0.1), (50, 0, -0.25), (0, 50.5, 1.5)]
TABLES = {
    "commas": "0,0,0.1\n50,0,-0.25\n0,50.5,1.5\n",
    "semicolons": "X [mm];Y [mm];Z [mm]\n0;0;0,1\n50;0;-0,25\n0;50,5;1,5\n",
    "decimal commas": "0 0 0,1\n50 0 -0,25\n0 50,5 1,5\n",
    "another order": "n,z_um,y_mm,x_mm\n1,100,0,0\n2,-250,0,50\n3,1500,50.5,0\n",
    "metres": "x_m,y_m,z_m\n0,0,0.0001\n0.05,0,-0.00025\n0,0.0505,0.0015\n",
    "comments": "# bed of May\n0, 0, 0.1\n\n50, 0, -0.25\n// again\n0, 50.5, 1.5\n",
    "labels": "X:0 Y:0 Z:0.1\nX:50 Y:0 Z:-0.25\nX=0 Y=50.5 Z=1.5\n",
    "Repetier": "Z-probe:0.1 X:0.00 Y:0.00\nZ-probe:-0.25 X:50 Y:0\nZ-probe:1.5 X:0 Y:50.5\n",
    "Smoothieware": "Recv: Probe start ht is 19.7 mm, grid size is 3x3\n"
    "Recv: probe at 0,0 is 0.1 mm\n"
    "Recv: DEBUG: X50.0000, Y0.0000, Z-0.2500\nRecv: DEBUG: X0.0000, Y50.5000, Z1.5000\n",
    "names in a comment": "# z x y\n0.1 0 0\n-0.25 50 0\n1.5 0 50.5\n",
    "Windows": "0,0,0.1\r\n50,0,-0.25\r\n0,50.5,1.5\r\n",
}


@pytest.mark.parametrize("kind", TABLES)
def test_plain_tables_in_whatever_form(kind: str, tmp_path: Path) -> None:
    assert points(listed(tmp_path, TABLES[kind])).tolist() == [list(p) for p in PLAIN]


CUT_OFF = {
    "Bed X: {:.2f} Y: {:.2f} Z: {:.3f}": ("Z: ", "Y: ", ": 30"),
    "// probe: at {:.3f},{:.3f} bed will contact at z={:.6f}": ("will", ",", "0.000"),
    "X:{:.2f} Y:{:.2f} Z-probe:{:.3f}": ("probe",),
}


@pytest.mark.parametrize(
    ("touch", "end"), [(k, end) for k, ends in CUT_OFF.items() for end in ends]
)
def test_a_line_that_was_cut_off_is_named(touch: str, end: str, tmp_path: Path) -> None:
    lines = [touch.format(*point) for point in (*PLAIN, (30, 30, 5.1))]
    lines[-1] = lines[-1][: lines[-1].index(end) + len(end)]
    found = listed(tmp_path, "\n".join(lines))
    assert points(found).tolist() == [list(p) for p in PLAIN]
    told = f"left out: line {len(lines)}: not all of x, y and z, as of a line cut off"
    assert any(told in note and repr(lines[-1].strip()[:40]) in note for note in found.notes)
    if touch.startswith("//"):  # of Klipper's console
        with pytest.raises(FileError, match="import plates"):
            import_printer(tmp_path / "points.csv")


def test_a_log_gives_its_touches_alone(tmp_path: Path) -> None:
    """Two probings, one point touched twice, positions reported between them."""
    touch = "Recv: Bed X: {} Y: {} Z: {}\n".format
    grid = [(0, 0, 5.1), (40, 0, 5.2), (0, 40, 5.3), (-40, 0, 5.25)]
    text = (
        "Send: G28\nRecv: X:0.00 Y:0.00 Z:200.00 E:0.00 Count X:0 Y:0 Z:0\nSend: G29\n"
        + "".join(touch(*p) for p in grid[:2]) + touch(40, 0, 5.21) + "Recv: echo:busy\n"
        + "".join(touch(*p) for p in grid[2:])
        + "Send: G29\n" + touch(20, 20, "nan")
        + "".join(touch(x - 20, y, z + 0.01) for x, y, z in grid)
        + touch(10, 10, "nan") + "ok\n"
    )  # fmt: skip
    found = listed(tmp_path, text, "octo print.log")
    assert [c.name for c in found.campaigns] == ["octo-print-1", "octo-print-2"]
    first, second = found.campaigns
    assert first.repeat.tolist() == [1, 1, 2, 1, 1]
    assert points(found)[2].tolist() == [40, 0, 5.21]
    assert points(found, 1)[0].tolist() == [-20, 0, 5.11]
    assert any("left out: lines 11, 16: not touched ('x 20, y 20')" in n for n in found.notes)
    assert len(second) == 4


@pytest.mark.parametrize(
    ("radius", "tilt", "told"),
    [(0.0, 0.0, ""), (5.0, 0.0, "are not of one plate"), (0.0, 8e-3, "its rim rises by 0.4")],
)
def test_lists_that_contradict_each_other_are_told(
    radius: float, tilt: float, told: str, tmp_path: Path
) -> None:
    """Of another firmware's lists nothing was said; their heights have no common zero."""
    spec = MACHINE.kinematics
    assert spec is not None
    other = replace(spec, sphere_centres_at_zero=spec.sphere_centres_at_zero * (1 + radius / 105))
    side = np.linspace(-0.05, 0.05, 5)
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    noise = np.random.default_rng(0).normal(0, 2e-5, (2, 25))
    travel = spec.travel(np.column_stack([x, y, 0 * x]))
    bent = other.places(travel)[:, 2]
    lists = ("", "G29\n")
    heights = (noise[0], 0.02 + bent + tilt * x + noise[1])
    lines = "".join(
        head + "".join(
            f"Bed X: {a * 1e3:.3f} Y: {b * 1e3:.3f} Z: {c * 1e3:.4f}\n"
            for a, b, c in zip(x, y, z, strict=True)
        ) for head, z in zip(lists, heights, strict=True)
    )  # fmt: skip
    found = listed(tmp_path, lines)
    assert len(found.campaigns) == 2
    assert bool(found.together) == (not told)
    verdict = og.close_loop(list(found.campaigns), og.Machine(MACHINE))
    for texts in (found.apart, verdict.cautions):
        assert [told in text for text in texts] == [True] * bool(told)
    assert str(verdict).startswith("points-2.csv and points-1.csv are not of" if told else "")
    assert ("Nothing is wrong" in str(verdict)) == (not told)


@pytest.mark.parametrize(("off", "seeds"), [(-2.0, 1), (0.0, 3)])
def test_a_wrong_radius_of_another_firmware_is_corrected_by_its_value(
    off: float, seeds: int, tmp_path: Path
) -> None:
    """Nothing was wrong, and nothing advised but compensated commands."""
    nominal = MACHINE.kinematics
    assert nominal is not None
    scale = np.array([1 + off / 105, 1 + off / 105, 1.0])
    true = replace(nominal, sphere_centres_at_zero=nominal.sphere_centres_at_zero * scale)
    side = np.linspace(-0.09, 0.09, 9)
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    x, y = np.array([x, y])[:, np.hypot(x, y) < 0.0901]
    believed = nominal.places(true.travel(np.column_stack([x, y, 0 * x])))
    for seed in range(seeds):
        noise = np.random.default_rng(seed).normal(0, 1.8e-5, len(x))
        rows = (believed + np.outer(noise, [0, 0, 1])) * 1e3
        found = listed(
            tmp_path, "x,y,z\n" + "".join("{:.4f},{:.4f},{:.4f}\n".format(*r) for r in rows)
        )
        verdict = og.close_loop(list(found.campaigns), og.Machine(MACHINE))
        told = re.findall(
            r"\(radius (\S+) mm, to (\S+) mm", "".join(a.words for a in verdict.actions)
        )
        assert len(told) == bool(off)
        for change, radius in told:
            # A plate that is a bowl of some hundredths would explain part of it.
            assert float(change.replace("−", "-")) == pytest.approx(off, abs=0.5)
            assert float(radius) - 105 == pytest.approx(float(change.replace("−", "-")), abs=0.006)
            assert "computes with wrong sizes" in str(verdict)


def delta(
    radius: float = 0.0, turn: tuple[float, ...] = (0, 0, 0), arms: float = 0.0,
    higher: tuple[float, ...] = (0, 0, 0),
) -> DeltaKinematics:  # fmt: skip
    """The machine with other sizes, mm and degrees, and carriages that stand higher, mm."""
    assert MACHINE.kinematics is not None
    x, y, z = MACHINE.kinematics.sphere_centres_at_zero.T
    at = (np.hypot(x, y) + radius * 1e-3) * np.exp(1j * (np.arctan2(y, x) + np.deg2rad(turn)))
    length = MACHINE.kinematics.arm_lengths + arms * 1e-3
    level = z + np.sqrt(length**2 - np.abs(at) ** 2) - np.sqrt(0.215**2 - np.hypot(x, y) ** 2)
    return DeltaKinematics(
        np.column_stack([at.real, at.imag, level + np.array(higher) * 1e-3]), length
    )


def advised(
    true: DeltaKinematics, tmp_path: Path, bowl: float = 0.0, measured: str = ""
) -> og.Verdict:
    """What is said of touches of a plate, a bowl by so many mm at its rim, by a true machine."""
    assert MACHINE.kinematics is not None
    x, y = SPOTS
    plate = np.column_stack([x, y, bowl * 1e-3 * (x**2 + y**2) / 0.09**2])
    believed = MACHINE.kinematics.places(true.travel(plate))
    believed[:, 2] += np.random.default_rng(5).normal(0, 1.5e-5, len(x)) - believed[:, 2].mean()
    rows = "".join("{:.4f},{:.4f},{:.4f}\n".format(*r) for r in believed * 1e3)
    text = (WORDS / "machine.toml").read_text()
    (tmp_path / "machine.toml").write_text(text + measured)
    (tmp_path / "points.csv").write_text(f"x,y,z\n{rows}")
    found = import_plates(tmp_path / "points.csv", tmp_path / "machine.toml")
    return og.close_loop(list(found.campaigns), og.Machine(found.machine))


def errors(true: DeltaKinematics, numbers: DeltaKinematics) -> tuple[float, float]:
    """How far off a controller with some numbers is in height, its endstops calibrated, and along
    the plate, beside a shift and a turn, rms, mm.
    """
    points = np.column_stack([*SPOTS, 0 * SPOTS[0]])
    error = (true.places(numbers.travel(points)) - points) * 1e3
    at, along = (p[:, 0] + 1j * p[:, 1] for p in (points, error))
    along = along - along.mean()
    along -= 1j * at * (along * (1j * at).conj()).real.sum() / (np.abs(at) ** 2).sum()
    return float(fit_plane(points, error[:, 2])[1].std()), float(
        np.sqrt(np.mean(np.abs(along) ** 2))
    )


def sizes_told(verdict: og.Verdict) -> dict[str, float]:
    """Changes of sizes that are advised, mm and degrees."""
    words = "".join(a.words for a in verdict.actions if "computes (" in a.words).replace("−", "-")
    found = re.findall(r"(radius|L|tower \w) ([-+][\d.]+)", words)
    return {name: float(value) for name, value in found}


def test_a_hot_and_a_cold_plate_are_no_list_of_the_other_sign(tmp_path: Path) -> None:
    """A bowl against a dome of equal height is explained by either."""
    lists = []
    for name, bowl, seed in (("hot", 0.1, 1), ("cold", -0.1, 2)):
        x, y = SPOTS
        z = bowl * (x**2 + y**2) / 0.09**2 + np.random.default_rng(seed).normal(0, 0.008, len(x))
        rows = "".join(
            "{:.4f},{:.4f},{:.4f}\n".format(*r) for r in zip(x * 1e3, y * 1e3, z, strict=True)
        )
        (tmp_path / f"{name}.csv").write_text(f"x,y,z\n{rows}")
        lists += import_plates(tmp_path / f"{name}.csv", MACHINE).campaigns
    ((*_, note),) = disagreements(MACHINE.kinematics, lists, relative=True)
    assert re.search(r"cold.csv is a dome of 0\.(19|20|21) mm .* a hot and a\s+cold one", note)
    assert "counts its heights downward, correct their sign" in note


@pytest.mark.parametrize("tower", range(3))
@pytest.mark.parametrize("off", [0.8, pytest.param(-0.8, marks=pytest.mark.thorough)])
def test_whichever_tower_of_another_firmware_is_off_its_angle_is_advised(
    tower: int, off: float, tmp_path: Path
) -> None:
    """Of mirrored machines one got half of the angle, and the other was to be left as it is."""
    turn = tuple(off * (k == tower) for k in range(3))
    told = sizes_told(advised(delta(turn=turn), tmp_path))
    assert told.keys() == {f"tower {'abc'[tower]}"}
    new = delta(turn=tuple(told.get(f"tower {leg}", 0.0) for leg in "abc"))
    before, after = errors(delta(turn=turn), delta()), errors(delta(turn=turn), new)
    assert max(np.divide(after, before)) < 0.35


def test_an_endstop_of_another_firmware_is_told(tmp_path: Path) -> None:
    """The plate lay tilted by half a millimetre, and no correction was advised."""
    verdict = advised(delta(higher=(0, 0.8, 0)), tmp_path)
    (told,) = [a for a in verdict.actions if a.kind == "zeros"]
    off = re.search(r"\(carriage b stands ([\d.]+) mm higher than it counts\)", told.words)
    assert off is not None
    assert float(off[1]) == pytest.approx(0.8, abs=0.08)
    assert not sizes_told(verdict)


@pytest.mark.parametrize(
    ("true", "bowl"),
    [(delta(arms=3.0, radius=1.8), 0.0), (delta(), 0.2),
     pytest.param(delta(arms=-2.0, radius=-1.2), 0.0, marks=pytest.mark.thorough),
     pytest.param(delta(), -0.2, marks=pytest.mark.thorough)],
)  # fmt: skip
def test_what_touches_cannot_tell_from_a_radius_changes_no_size(
    true: DeltaKinematics, bowl: float, tmp_path: Path
) -> None:
    """A radius for rods that were entered short made the tool worse along the plate, and so did
    compensated commands, which were advised all the same.
    """
    verdict = advised(true, tmp_path, bowl)
    assert not sizes_told(verdict)
    assert "compensate" not in [a.kind for a in verdict.actions]
    first = verdict.actions[0]
    assert first.kind == "measure"
    assert re.search("measure a rod .* and how far .* lay a straight edge across", first.words)


def test_a_plate_that_a_straight_edge_shows_flat_gives_the_radius(tmp_path: Path) -> None:
    """It was asked for, and no entry of the machine file could take what it showed."""
    true, rods = delta(radius=0.5), "\n[measured]\nrods_mm = [215.0, 0.1]\n"
    first = advised(true, tmp_path, measured=rods).actions[0]
    assert "plate_bow under [tolerance]" in first.words
    flat = f"{rods}\n[tolerance]\nplate_bow = 0.02\n"
    told = sizes_told(advised(true, tmp_path, measured=flat))
    assert told["radius"] == pytest.approx(0.5, abs=0.1)


def test_measured_rods_come_with_their_radius(tmp_path: Path) -> None:
    """Nothing was wrong, and no correction advised: with a measured length, the radius of wrong
    rods was less probable than a bowl.
    """
    true = delta(arms=3.0, radius=1.8)
    told = sizes_told(advised(true, tmp_path, measured="\n[measured]\nrods_mm = [218.0, 0.1]\n"))
    assert told.keys() == {"radius", "L"}
    new = delta(radius=told["radius"], arms=told["L"])
    assert told["L"] == pytest.approx(3.0, abs=0.1)
    assert max(np.divide(errors(true, new), errors(true, delta()))) < 0.2


def test_measured_travel_leaves_wrong_rods_among_the_causes(tmp_path: Path) -> None:
    """They vanished: the machine had lost the error that the towers' radius shares."""
    travel = "\n[measured]\ntravel_of_100_mm = [100.0, 0.05]\n"
    verdict = advised(delta(arms=4.0, radius=2.3), tmp_path, measured=travel)
    names = [e.name for cause in verdict.effects for e in cause.explanations]
    assert "leg_length.common" in names


def test_the_calibrated_machine_is_averaged_over_all_its_causes(tmp_path: Path) -> None:
    """Equal scales of free functions, of which touches have none, filled the average, and causes of
    less weight were lost from it, or counted half as much again.
    """
    verdict = advised(delta(arms=3.0, radius=1.2), tmp_path)
    explanations = [e for cause in verdict.effects for e in cause.explanations]
    (rods,) = [e.probability for e in explanations if e.name == "leg_length.common"]
    posterior = verdict.machine.posterior
    longer = [posterior.mean[k] for k, n in enumerate(posterior.names) if "leg_length" in n]
    assert np.mean(longer) == pytest.approx(rods * 3e-3, abs=1e-4)


@pytest.mark.parametrize("bowl", [0.2, -0.2])
def test_a_plate_that_is_a_bowl_against_another_is_told(bowl: float, tmp_path: Path) -> None:
    """To probe again, or to state a turn, helps nobody who has two plates."""
    x, y = SPOTS * 1e3
    lists = [0 * x, bowl * (x**2 + y**2) / 90**2]
    noise = np.random.default_rng(1).normal(0, 0.015, (2, len(x)))
    heights = zip(("", "G29\n"), lists, noise, strict=True)
    text = ""
    for head, z, e in heights:
        rows = zip(x, y, z + e, strict=True)
        text += head + "".join(f"Bed X: {a} Y: {b} Z: {c:.4f}\n" for a, b, c in rows)
    (told,) = listed(tmp_path, text).apart
    shape = re.search(r"plate of points-2.csv is a (\w+) of ([\d.]+) mm against the other", told)
    assert shape is not None
    assert shape[1] == ("bowl" if bowl > 0 else "dome")
    assert float(shape[2]) == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("spots", [SPOTS[:, :7], SPOTS / 5, SPOTS * [[1.0], [1e-3]]])
def test_touches_of_a_part_of_the_plate_give_no_sizes(spots: np.ndarray, tmp_path: Path) -> None:
    """Seven touches, of the middle or along a line, fit sizes that are far off elsewhere."""
    assert MACHINE.kinematics is not None
    true = delta(turn=(0, 0, 1.5), higher=(0.5, 0, 0))
    places = MACHINE.kinematics.places(true.travel(np.column_stack([*spots, 0 * spots[0]]))) * 1e3
    rows = "".join("{:.4f},{:.4f},{:.4f}\n".format(*place) for place in places)
    verdict = og.close_loop(list(listed(tmp_path, f"x,y,z\n{rows}").campaigns), og.Machine(MACHINE))
    assert not [a for a in verdict.actions if a.kind in ("zeros", "mend")]


def test_towers_may_be_numbered_clockwise() -> None:
    """The tool was sought above the carriages."""
    true = delta(turn=(1.0, -0.5, 0.0))
    centres, arms = true.sphere_centres_at_zero[::-1], true.arm_lengths
    points = np.column_stack([*SPOTS, 0 * SPOTS[0]])
    clockwise = DeltaKinematics(centres, arms)
    assert clockwise.places(clockwise.travel(points)) == pytest.approx(points, abs=1e-9)


def test_height_maps_of_older_versions_and_with_gaps(tmp_path: Path) -> None:
    head = "RepRapFirmware height map file v1 generated at 2017-04-09 17:01, mean error 0.1\n"
    sizes = (
        "xmin,xmax,ymin,ymax,radius,spacing,xnum,ynum\n-30.00,31.00,-30.00,31.00,-1.00,30.00,3,3\n"
    )
    rows = "  0.100,  0.000,  0.200\n      0,    nan,  0.300\n  0.400,  0.500,  0.600\n"
    found = listed(tmp_path, head + sizes + rows)
    assert points(found)[:3].tolist() == [[-30, -30, 0.1], [0, -30, 0], [30, -30, 0.2]]
    assert len(found.campaigns[0]) == 7
    assert any("left out: line 5: not touched" in n for n in found.notes)
    twice = listed(tmp_path, (head + sizes + rows) * 2 + head + sizes + rows.replace("0.6", "0.7"))
    assert len(twice.campaigns) == 2
    assert any("line 10: a copy of the list of line 4" in n for n in twice.notes)
    short = listed(tmp_path, head + sizes + rows.replace("  0.100,", ""))
    assert len(short.campaigns[0]) == 4
    assert any("line 4: the number of heights is 2, not 3" in n for n in short.notes)
    cut = listed(tmp_path, head + sizes + rows.partition("  0.400")[0])
    assert any("2 rows of 3; more are missing below" in n for n in cut.notes)
    long = listed(tmp_path, f"{head}{sizes}{rows}  0.700,  0.800,  0.900\n")
    assert any("line 7: more than the 3 rows of the height map" in n for n in long.notes)


def test_a_height_map_of_a_spreadsheet(tmp_path: Path) -> None:
    """Semicolons and decimal commas; the axes may be named the other way round."""
    head = "RepRapFirmware height map file v2 generated at 2024-01-01 10:00, min error -0.1\n"
    sizes = "axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1\n".replace(",", ";")
    told = "{};{};-40,0;40,0;-20,0;20,0;-1;40,0;20,0;3;3\n".format
    rows = "0,1;0,2;0,3\n0,4;0;0,6\n0,7;0,8;0,000\n"
    p = points(listed(tmp_path, head + sizes + told("X", "Y") + rows))
    assert p[[0, 1, -1]].tolist() == [[-40, -20, 0.1], [0, -20, 0.2], [40, 20, 0]]
    assert len(p) == 8
    q = points(listed(tmp_path, head + sizes + told("Y", "X") + rows))
    assert np.array_equal(q, p[:, [1, 0, 2]])


def test_heights_in_another_unit_are_told(tmp_path: Path) -> None:
    micrometres = "0,0,4\n50,0,-9\n0,50,7\n-50,0,2\n0,-50,-8\n"
    assert any("off a plane" in note for note in listed(tmp_path, micrometres).notes)
    with pytest.raises(FileError, match="give millimetres"):
        listed(tmp_path, micrometres.replace("\n", "0\n"))


def test_what_no_plate_has_is_left_out_by_its_line(tmp_path: Path) -> None:
    text = TABLES["commas"] + "20,20,0.3\n30,30,400\n900,0,0.1\nten,0,0.1\n-40,0,\n"
    found = listed(tmp_path, text)
    assert len(found.campaigns[0]) == 4
    told = " ".join(found.notes)
    for why in (
        "5: more than 20 mm from the height of most; give millimetres ('z 400')",
        "6: beyond the arms of the machine file ('x 900, y 0')",
        "7: no row of x, y and z ('ten,0,0.1')",
        "8: not touched ('x -40, y 0')",
    ):
        assert f"left out: line {why}" in told, why


REFUSED = {
    "nothing": ("# none\n", "has no list of plate points"),
    "two points": ("0,0,0.1\n50,0,0.2\n", "fewer than 3 places"),
    "metres": ("0,0,0.0001\n0.05,0,0.0002\n0,0.05,0.0003\n", "give millimetres"),
    "a map of nothing": ("RepRapFirmware height map file v2\nX\n", "give the whole file"),
    "unknown sizes": ("RepRapFirmware height map file v9\na,b\n1,2\n0.1\n", "not understood"),
    "unprobed": ("x,y,z\n0,0,nan\n1,1,nan\n2,2,\n", "not touched"),
    "Marlin's grid": ("Recv: Bilinear Leveling Grid:\nRecv:  0 +0.1 -0.1\n",
                      "grid of heights without the places"),
    "Klipper's grid": ("// Mesh Leveling Probed Z positions:\n// 0.1 0.2\n",
                       "grid of heights without the places"),
    "brackets": ("[[0.105, 0.022, -0.01],\n [0.03, 0.0, 0.01]]\n",
                 "grid of heights without the places"),
    "a calibration": ("Recv: G33 Auto Calibrate\nRecv: Calibration OK\n",
                      "what a calibration prints"),
    "numbers of a calibration": ("19:31:12 | G32Calibrated 9 factors using 11 points\n",
                                 "what a calibration prints"),
    "heights of a calibration": ("Bed probe heights: -0.134 0.027 -0.062, mean -0.030\n",
                                 "what a calibration prints"),
    # Numbers with decimal commas between commas were read as other numbers.
    "commas": ("x,y,z\n-20,000,0,000,0,120\n0,5,0,5,0,1\n9,5,0,5,0,1\n",
               "more numbers than names"),
    "four columns": ("0.1,0.2,0.1,0.3\n0.2,0.1,0.0,0.1\n", "numbers without names, as of a grid"),
    "three columns": ("0.1,0.2,0.1\n0.2,0.1,0.0\n0.1,0.0,0.3\n", "give each with its x and y"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_list_is_refused(kind: str, tmp_path: Path) -> None:
    text, why = REFUSED[kind]
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(FileError, match=re.escape(why)) as caught:
        import_plates(tmp_path / "points.csv", MACHINE)
    assert "points.csv" in str(caught.value)
    run = call("import", "plates", tmp_path / "points.csv", "--machine", WORDS / "machine.toml",
               "--out", tmp_path / "o")  # fmt: skip
    assert run.code == 2


def test_lists_are_of_a_linear_delta() -> None:
    with pytest.raises(FileError, match="layout orthoglide: lists of plate points are read for a"):
        import_plates(WORDS / "g29.txt", og.Machine.nominal())


@pytest.mark.parametrize("sd", [0.19e-3, 0.25e-3])
def test_scatter_between_lists_is_no_move_of_a_plate(sd: float) -> None:
    """It was one by nothing: 'the plate of a.csv . An endstop ... was moved'."""
    kinds = Counter[str]()
    for seed in range(20):
        rng = np.random.default_rng(seed)
        places, difference = rng.uniform(-0.1, 0.1, (60, 2)), sd * rng.standard_normal(60)
        if note := _note("a", "b", places, difference):
            kinds[note.kind] += 1
            assert (" lies " in note or " is tilted " in note) == (note.kind == "moved")
    assert kinds["apart"] > 5


def test_a_small_tilt_between_lists_is_no_bowl() -> None:
    """'The plate is a bowl of 0.00 mm against the other', of an owner's mesh and touches."""
    places = np.array([[0.0, 0.0], [0.09, 0.0], [0.0, 0.09], [-0.08, 0.0]])
    note = _note("a", "b", places, places @ [8e-4, 0.0])
    assert note is not None
    assert "bowl" not in note
    assert "Leave the older of the two out" in note
