"""The machine file: read strictly, written exactly, never overwritten unasked."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from orthoglide.effects import CATALOGUE
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Geometry
from orthoglide.machine_file import (
    Controller,
    Dial,
    Instrument,
    MachineFile,
    ParameterValue,
    Stiffness,
    machine_text,
    parse_machine_file,
    read_machine_file,
    schema,
    write_machine_file,
)

GOOD = """\
schema = 1
name = "the one in the cellar"

[geometry_mm]
L = 310.25
d = 80
r = 31.0
stroke = [-100.0, 60.0]

[dial_mm]
resolution = 0.002
repeatability = 0.005
placement = 1.5

[drive]
screw_pitch_mm = 20

[controller]
zero_mm = [0.5, -0.25, 100]
sign = [1, -1, 1]

[tolerance]
joint_offset = 1.5
axis_tilt = 2e-3
gauge_drift = 5e-5

[stiffness]
torsion_Nmm_per_rad = 5e6
bar_N_per_mm = 4e4

[parameters]
"joint_offset.x" = { value = 0.25, sigma = 0.01, unit = "mm" }
"axis_tilt.y.z" = { value = -1e-3, sigma = 0, unit = "rad" }

[provenance]
version = "0.1.0"
campaigns = [{ file = "a.csv", sha256 = "00" }]
"""


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_everything_arrives_in_si(tmp_path: Path) -> None:
    machine = read_machine_file(write(tmp_path / "m.toml", GOOD))
    assert machine.geometry == Geometry()
    assert machine.dial == Dial(2e-6, 5e-6, 1.5e-3)
    assert machine.screw_pitch == 0.02
    assert machine.controller == Controller((5e-4, -2.5e-4, 0.1), (1, -1, 1))
    assert machine.stiffness == Stiffness(5e3, 4e7)
    assert machine.tolerance["joint_offset"] == 1.5e-3
    assert machine.tolerance["gauge_drift"] == 5e-8
    assert machine.tolerance["leg_length"] == 5e-5  # the default
    assert machine.parameters["joint_offset.x"] == ParameterValue(2.5e-4, 1e-5, "mm")
    assert machine.parameters["axis_tilt.y.z"] == ParameterValue(-1e-3, 0.0, "rad")
    assert machine.provenance["campaigns"] == [{"file": "a.csv", "sha256": "00"}]
    assert machine.file.endswith("m.toml")
    assert len(machine.sha256) == 64


def test_the_least_machine_file(tmp_path: Path) -> None:
    text = GOOD[: GOOD.index("[dial_mm]")].replace('name = "the one in the cellar"', "")
    machine = read_machine_file(write(tmp_path / "m.toml", text))
    assert machine == MachineFile(name="")
    assert machine.dial == Dial(resolution=1e-5, repeatability=None, placement=1e-3)
    assert dict(machine.tolerance) == CATALOGUE.default_tolerance


# The contract of files: unit and default tolerance of every family, whatever the catalogue says.
CONTRACT = {
    "joint_offset": ("mm", 2), "leg_length": ("mm", 0.05), "axis_tilt": ("rad", 1e-3),
    "axis_offset": ("mm", 0.3), "mount_tilt": ("rad", 2e-3), "bar_mismatch": ("mm", 0.05),
    "parallelogram_width": ("mm", 0.1), "rail_bow": ("mm", 0.02), "rail_tilt": ("rad", 1e-3),
    "encoder_scale": ("1", 1e-4), "screw_error": ("mm", 0.01), "backlash": ("mm", 0.02),
    "thermal_growth": ("1/K", 5e-6), "gauge_scale": ("1", 0.01), "gauge_direction": ("rad", 0.02),
    "gauge_drift": ("mm/s", 2e-5),
}  # fmt: skip


def test_the_catalogue_keeps_the_contract_of_files() -> None:
    for family, (unit, value) in CONTRACT.items():
        assert (CATALOGUE[family].unit.name, CATALOGUE[family].tolerance) == (unit, value)


# (replace this, with that, phrase, line)
MALFORMED: dict[str, tuple[str, str, str, int | None]] = {
    "no schema": ("schema = 1\n", "", "the machine file has no 'schema'", None),
    "another schema": ("schema = 1", "schema = 2", "schema must be 1", 1),
    "name as number": ('"the one in the cellar"', "7", "must be text", 2),
    "unknown key": ("name =", "owner =", "no key 'owner'", 2),
    "misspelt key": ("name =", "nmae =", "did you mean 'name'", 2),
    "unknown table": ("[drive]", "[driver]", "did you mean 'drive'", 15),
    "key missing": ("r = 31.0\n", "", "geometry_mm has no 'r'", 4),
    "L in metres": ("L = 310.25", "L = 0.31025", "is it in metres?", 5),
    "r negative": ("r = 31.0", "r = -31", "must be above 1", 7),
    "d and L exchanged": ("L = 310.25\nd = 80", "L = 80\nd = 310.25", "are they exchanged?", 6),
    "L as text": ("L = 310.25", 'L = "310.25"', "must be a number", 5),
    "L infinite": ("L = 310.25", "L = inf", "finite", 5),
    "stroke reversed": ("[-100.0, 60.0]", "[60, -100]", "reversed: give the lower", 8),
    "stroke as rho": ("[-100.0, 60.0]", "[210.25, 370.25]", "from mechanical zero", 8),
    "stroke in metres": ("[-100.0, 60.0]", "[-0.1, 0.06]", "not metres", 8),
    "stroke beyond a bar": ("[-100.0, 60.0]", "[-400, 60]", "stay within L", 8),
    "resolution of zero": ("resolution = 0.002", "resolution = 0", "must be above", 11),
    "negative placement": ("placement = 1.5", "placement = -1", "must be at least 0", 13),
    "zero of two numbers": ("[0.5, -0.25, 100]", "[0.5, 1]", "list of 3 numbers", 19),
    "zero far away": ("[0.5, -0.25, 100]", "[0.5, 1e9, 1]", "no more than", 19),
    "sign of zero": ("sign = [1, -1, 1]", "sign = [1, 0, 1]", "at place 2 must be 1 or -1", 20),
    "tolerance of no family": ("axis_tilt = 2e-3", "axis_tlit = 2e-3", "mean 'axis_tilt'", 24),
    "negative stiffness": ("= 4e4", "= -4e4", "must be above 0", 29),
    "stiffness in SI": ("bar_N_per_mm", "bar_N_per_m", "did you mean 'bar_N_per_mm'", 29),
    "parameter of no family": ("joint_offset.x", "joint_ofset.x", "mean 'joint_offset'", 32),
    "parameter of no leg": ("joint_offset.x", "joint_offset.w", "names no parameter", 32),
    "structured member": ("joint_offset.x", "joint_offset.common", "names no parameter", 32),
    "step reversed": ("joint_offset.x", "drive_x_travel_20to10.x.1", "no parameter", 32),
    "step without width": ("joint_offset.x", "drive_x_travel_10to10.x.1", "no parameter", 32),
    "step beyond the stroke": ("joint_offset.x", "drive_x_travel_90to95.x.1", "no parameter", 32),
    "parameter along its own leg": ("tilt.y.z", "tilt.y.y", "names no parameter", 33),
    "parameter of the dial": ("joint_offset.x", "gauge_scale.x", "no parameter", 32),
    "parameter without sigma": (", sigma = 0.01", "", "has no 'sigma'", 32),
    "parameter with more": ("sigma = 0.01", "sigma = 0.01, sd = 1", "no key 'sd'", 32),
    "parameter as a number": (
        '{ value = 0.25, sigma = 0.01, unit = "mm" }', "0.25", "must be a table", 32),
    "parameter in another unit": ('unit = "mm"', 'unit = "m"', "must be mm, not 'm'", 32),
    "not TOML": ("L = 310.25", "L 310.25", "is not TOML", 5),
    "key twice": ("d = 80", "L = 80", "is not TOML, cannot overwrite a value", 6),
    "text not closed": ('"0.1.0"', '"0.1.0', "is not TOML", 36),
    "number beyond all": ("L = 310.25", "L = 1e99999999999999999999", "out of all range", None),
    "digits without end": ("L = 310.25", f"L = {'1' * 5000}", "out of all range", None),
    "schema without end": ("schema = 1", f"schema = {'1' * 5000}", "out of all range", None),
    "hexadecimal digits, deep": (
        'version = "0.1.0"', f"x = [[{{ y = 0x{'f' * 5000} }}]]", "out of all range", None),
    "repeatability near zero": ("= 0.005", "= 1e-320", "must be above 1e-07", 12),
    "key of a page": ("name =", f"{'n' * 50_000} =", "has no key 'nnn", 2),
    "unit of a page": ('unit = "mm"', f'unit = "{"m" * 50_000}"', "must be mm, not 'mmm", 32),
    "line of a page": ("schema = 1", f"schema {'=' * 50_000} 1", "is not TOML", 1),
}  # fmt: skip


@pytest.mark.parametrize("kind", MALFORMED)
def test_malformed_machine_files_are_refused(kind: str, tmp_path: Path) -> None:
    old, new, phrase, line = MALFORMED[kind]
    assert GOOD.count(old) >= 1
    file = write(tmp_path / "bad.toml", GOOD.replace(old, new, 1))
    with pytest.raises(FileError) as caught:
        read_machine_file(file)
    error = caught.value
    assert phrase in error.reason
    assert (error.file, error.line) == (str(file), line)
    assert "\n" not in str(error)
    assert len(str(error)) < 500


@settings(max_examples=40, deadline=None)
@given(st.integers(0, len(GOOD) - 1), st.integers(0, 5), st.text(max_size=4))
def test_no_text_brings_more_than_a_file_error(at: int, gone: int, new: str) -> None:
    with contextlib.suppress(FileError):
        parse_machine_file(GOOD[:at] + new + GOOD[at + gone :], "m.toml")


@pytest.mark.parametrize(
    ("content", "phrase"),
    [(b"", "is empty"), (b"schema\0", "not text"), (b"name = '\xfc'", "not UTF-8")],
)
def test_broken_machine_files_are_refused(content: bytes, phrase: str, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=phrase):
        read_machine_file(write(tmp_path / "bad.toml", content))
    with pytest.raises(FileError, match="no such file"):
        read_machine_file(tmp_path / "none.toml")


# --- The schema -----------------------------------------------------------------------------

DELTA = """\
[layout]
kind = "linear-delta"
radius_mm = 135
angles_deg = [210, 330.5, 90]
tool_mm = [0, 0, -20]
"""
LEGS = """\
[layout]
kind = "legs"
tool_mm = [0, 0, 0]
[layout.leg.x]
origin_mm = [341.25, 0, 0]
slide = [1, 0, 0]
link = [0, 0, 1]
[layout.leg.y]
origin_mm = [0, 341.25, 0]
slide = [0, 1, 0]
link = [1, 0, 0]
[layout.leg.z]
origin_mm = [0, 0, 341.25]
slide = [0, 0, 1]
link = [0, 1, 0]
"""
FURTHER = """\
[instrument.parallelism]
resolution = 0.001
repeatability = 0.002

[measured]
rods_mm = [310.5, 0.1]
travel_of_100_mm = [100.1, 0.05]
"""


def of_layout(layout: str) -> str:
    """The good file with a layout of its own and other instruments."""
    text = GOOD[: GOOD.index("[parameters]")].replace("gauge_drift", "surface_slope")
    return text.replace('cellar"\n', 'cellar"\nurdf = "here"\n') + layout + FURTHER


@pytest.mark.parametrize("layout", [DELTA, LEGS], ids=["delta", "legs"])
def test_every_key_is_read_and_written(layout: str) -> None:
    text = of_layout(layout)
    machine = parse_machine_file(text)
    again = machine_text(machine)
    assert parse_machine_file(again) == machine
    placed = schema.LEG if layout is LEGS else schema.LAYOUTS["linear-delta"]
    for section in (schema.TOP, schema.GEOMETRY, schema.DRIVE, schema.INSTRUMENT, placed,
                    *schema.SECTIONS_BY_ATTRIBUTE.values()):  # fmt: skip
        for key in section.keys:
            assert key is schema.LAYOUT_R or f"\n{key.name} = " in f"\n{again}"


@pytest.mark.parametrize("layout", [DELTA, LEGS], ids=["delta", "legs"])
def test_a_misspelt_key_is_named_with_its_line(layout: str) -> None:
    lines = of_layout(layout).splitlines()
    keys = [k for k, line in enumerate(lines) if " = " in line]
    assert len(keys) > 20
    for k in keys:
        name = lines[k].partition(" = ")[0]
        wrong = [*lines[:k], lines[k].replace(name, f"{name}x", 1), *lines[k + 1 :]]
        with pytest.raises(FileError) as caught:
            parse_machine_file("\n".join(wrong))
        if "has no key" in caught.value.reason:
            assert (f"did you mean {name!r}?" in caught.value.reason, caught.value.line) == (
                True, k + 1)  # fmt: skip
        else:  # the kind of a layout says which keys there are
            assert f"has no {name!r}: add it" in caught.value.reason


def test_a_reference_surface_has_a_slope() -> None:
    assert parse_machine_file(GOOD).surface_slope is None
    text = of_layout("")
    machine = parse_machine_file(text)
    assert (machine.surface_slope, machine.instruments["parallelism"]) == (
        5e-5, Instrument(1e-6, 2e-6))  # fmt: skip
    assert "surface_slope" not in machine.tolerance
    assert parse_machine_file(machine_text(machine)).surface_slope == 5e-5
    for slope, told in (("-1e-4", "must be above 0 and below 1"), ('"1e-4"', "must be a number")):
        with pytest.raises(FileError, match=rf"line 26: tolerance.surface_slope {told}"):
            parse_machine_file(text.replace("surface_slope = 5e-5", f"surface_slope = {slope}"))


# --- Writing --------------------------------------------------------------------------------

NAMES = ("joint_offset.x", "rail_bow.z.y", "screw_error.y.sin", "mount_tilt.x.b",
         "thermal_growth.z", "drive_compliance.x")  # fmt: skip
LENGTH = st.floats(1e-3, 1e-1)


@st.composite
def machines(draw: st.DrawFn) -> MachineFile:
    value = st.floats(-1.0, 1.0)
    return MachineFile(
        name=draw(st.sampled_from(["", 'a "quoted" ü\nname', "plain"])),
        geometry=Geometry(
            L=draw(st.floats(0.2, 1.0)),
            d=draw(st.floats(0.01, 0.1)),
            r=draw(st.floats(0.01, 0.1)),
            stroke=(draw(st.floats(-0.1, -1e-3)), draw(st.floats(1e-3, 0.1))),
        ),
        dial=Dial(draw(st.floats(1e-6, 1e-4)), draw(st.none() | st.floats(1e-7, 1e-4)), 0.0),
        screw_pitch=draw(st.none() | LENGTH),
        controller=Controller(zero=(draw(value), draw(value), draw(value)), sign=(1, -1, 1)),
        tolerance={"joint_offset": draw(LENGTH), "thermal_growth": draw(LENGTH)},
        stiffness=Stiffness(draw(st.none() | st.floats(0, 1e6)), draw(st.none() | LENGTH)),
        parameters={
            name: ParameterValue(draw(value), abs(draw(value)), CATALOGUE.effect_of(name).unit.name)
            for name in draw(st.lists(st.sampled_from(NAMES), unique=True))
        },
        provenance={"campaigns": [{"file": "a.csv", "weight": draw(value)}]},
    )


@settings(deadline=None, max_examples=30)
@given(machines())
def test_a_machine_survives_its_file(tmp_path_factory: pytest.TempPathFactory, machine) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path_factory.mktemp("machine") / "m.toml"
    write_machine_file(machine, file)
    again = read_machine_file(file)
    assert again == machine
    first = file.read_bytes()
    write_machine_file(again, file, overwrite=True)
    assert file.read_bytes() == first


@pytest.mark.parametrize(
    "machine",
    [
        MachineFile(parameters={"joint_offset.x": ParameterValue(np.nan, 0.0, "mm")}),
        MachineFile(parameters={"joint_offset.x": ParameterValue(0.0, np.inf, "mm")}),
        MachineFile(parameters={"joint_offset.x": ParameterValue(0.0, 0.0, "m")}),
        MachineFile(parameters={"wobble.x": ParameterValue(0.0, 0.0, "mm")}),
        MachineFile(parameters={"joint_offset.x@file": ParameterValue(0.0, 0.0, "mm")}),
        MachineFile(tolerance={"joint_offset": -1.0}),
        MachineFile(provenance={"none": None}),
    ],
)
def test_what_could_not_be_read_back_is_not_written(machine: MachineFile, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        write_machine_file(machine, tmp_path / "m.toml")
    assert os.listdir(tmp_path) == []
