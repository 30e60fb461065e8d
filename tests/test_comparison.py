"""The comparison of mechanism and reduction: against the independent machine, by optimality of its
fits, and the numbers that the documentation prints.
"""

import re
import runpy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orthoglide import Machine, reduction
from orthoglide.comparison import Row, compare_effects, compare_machine
from orthoglide.comparison.comparing import PITCH, Comparison, cube, markdown_table, micrometres
from orthoglide.errors import InputError
from orthoglide.geometry import Geometry
from orthoglide.layout import FreeLeg, FreeLegs
from tests.engines import DELTA
from tests.rig import Array, Rig
from tests.test_cli import done, run

ROOT = Path(__file__).parents[1]
SOME = ("joint_offset.y", "axis_offset.x.y", "axis_tilt.z.y", "bar_mismatch.y", "backlash.x")
FEW = 4


@cache
def row(name: str) -> Row:
    return compare_effects(names=(name,), points=FEW)[0]


@cache
def comparison() -> Comparison:
    return Comparison(Machine.nominal(), FEW)


def rig_tcp(errors: dict[str, float]) -> tuple[Array, Array]:
    seen = comparison().conditions
    rig = Rig(errors=errors, screw_pitch=PITCH)
    pose = rig.pose(seen.command, seen.approach, seen.time, seen.warming, seen.load)
    return pose.p, pose.R


@pytest.mark.parametrize("stroke", [(-0.1, 0.06), (-0.05, 0.06), (-0.02, 0.09)])
def test_the_cube_fills_the_stroke_and_no_more(stroke: tuple[float, float]) -> None:
    geometry = Geometry(stroke=stroke)
    side = np.linspace(*cube(geometry), 21)
    p = np.stack(np.meshgrid(side, side, side), -1).reshape(-1, 3)
    travel = reduction.inverse(p, geometry=geometry) - geometry.L
    # The grid need not hold p = 0 across the axis, where the outer end is touched.
    outer = reduction.inverse([side[-1], 0.0, 0.0], geometry=geometry)[0] - geometry.L
    assert travel.min() == pytest.approx(stroke[0], abs=1e-12)
    assert outer == pytest.approx(stroke[1], abs=1e-12)
    assert travel.max() <= stroke[1] + 1e-12


@pytest.mark.parametrize("name", [*SOME, "rail_tilt.x.z", "mount_tilt.z.b", "thermal_growth.y"])
def test_the_effect_itself_is_that_of_the_independent_machine(name: str) -> None:
    found, value = row(name), Machine.nominal().tolerance(name)
    p, R = rig_tcp({name: value})
    apart = np.linalg.norm(p - comparison().p, axis=1)
    assert found.value == value
    assert found.nominal.mean == pytest.approx(apart.mean(), abs=1e-9)
    assert found.nominal.max == pytest.approx(apart.max(), abs=1e-9)
    turn = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert found.rotation == pytest.approx(turn.max(), abs=1e-7)


@pytest.mark.parametrize("name", ["axis_tilt.z.y", "bar_mismatch.y", "backlash.x"])
def test_no_six_parameters_come_nearer_to_the_readings(name: str) -> None:
    c = comparison().campaign
    axes, gauges = ([getattr(c.setups[k], f) for k in c.setup] for f in ("axis", "gauge"))
    rig = Rig(errors={name: row(name).value})
    pose = rig.pose(c.command, c.approach, c.time, c.temperature - c.temperature[0], c.load)
    shown = rig.readings(pose.lines, c.leg, [c.setups[k].direction for k in c.setup], gauges)
    columns = np.hstack(
        [
            reduction.predict_readings(c.command, c.leg, axes, gauges).gradient,
            np.eye(len(c.setups))[c.setup],
        ]
    )
    linear = shown - columns @ np.linalg.lstsq(columns, shown, rcond=None)[0]
    rms = np.sqrt(np.mean(linear**2))
    assert row(name).reading_rms == pytest.approx(rms, rel=0.02)
    assert row(name).reading_rms < row(name).reading_change
    assert row(name).reading_max >= row(name).reading_rms


def test_structured_members_and_dials() -> None:
    common, gain = compare_effects(names=("axis_offset.common", "gauge_drift"), points=FEW)
    assert common.fitted.max > 1e-4
    assert gain.name.startswith("gauge_drift.")
    assert gain.nominal.max < 1e-14
    assert gain.reading_change > 1e-6
    with pytest.raises(InputError, match="no effect"):
        compare_effects(names=("axis_ofset",), points=FEW)


# -- other layouts ------------------------------------------------------------------------------


def test_tables_hold_the_rows() -> None:
    rows = (*compare_machine(Machine.nominal().with_parameters({"backlash.x": 1e-5}), FEW),)
    head, rule, *lines = markdown_table(rows).splitlines()
    assert {line.count("|") for line in (head, rule, *lines)} == {8}
    cells = [line.split(" | ") for line in lines]
    assert [row[:2] for row in cells] == [["| `machine`", "all"], ["| `backlash.x`", "0.01 mm"]]
    assert cells[1][2] == micrometres(rows[1].fitted.max)


_AXES = ("x", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ("y", (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
# The legs of an Orthoglide in another order: the platform is on the other side of the carriages.
MIRRORED = FreeLegs(
    tuple(
        FreeLeg(name, tuple(0.34125 * a for a in slide), slide, link)
        for name, slide, link in (("z", (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), _AXES[1], _AXES[0])
    )
)  # type: ignore[arg-type]
LAYOUTS = {"linear delta": DELTA, "free legs": Geometry(layout=MIRRORED)}


def other(kind: str) -> Machine:
    return Machine(replace(Machine.nominal().spec, geometry=LAYOUTS[kind]))


@pytest.mark.parametrize("kind", LAYOUTS)
def test_three_spheres_hold_offsets_and_lengths_of_any_layout(kind: str) -> None:
    names = LAYOUTS[kind].leg_names
    for k, family in enumerate(("joint_offset", "leg_length")):
        for leg in range(3):
            (found,) = compare_effects(other(kind), (f"{family}.{names[leg]}",), FEW)
            planted = np.zeros(6)
            planted[3 * k + leg] = found.value
            assert np.abs(found.six - planted).max() < 1e-10
            assert found.fitted.max < 1e-11
            assert found.nominal.max > 1e-5
            assert found.good_enough
            assert not found.read


def test_dials_of_other_layouts_are_refused() -> None:
    with pytest.raises(InputError, match=r"gauge_scale\.any: dials are set against"):
        compare_effects(other("free legs"), ("gauge_scale.any",), FEW)


# -- the documentation --------------------------------------------------------------------------

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")


def test_the_page_has_the_numbers_that_the_example_prints() -> None:
    example = runpy.run_path(str(ROOT / "docs" / "tables" / "compare_models.py"))
    printed = example["markdown"]()
    text = (ROOT / "docs" / "simplified-model.md").read_text(encoding="utf-8")
    shown = text.partition("<!-- tables: begin -->")[2].partition("<!-- tables: end -->")[0]
    assert _NUMBER.sub("#", shown.strip()) == _NUMBER.sub("#", printed.strip())
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(printed), strict=True)
    for old, new in pairs:
        # One in the last of three digits: another computer may round the other way.
        assert float(old) == pytest.approx(float(new), rel=0.02, abs=0.011), (old, new)


# -- the command --------------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_command_writes_tables_and_figures(tmp_path: Path) -> None:
    file, out = tmp_path / "calibrated.toml", tmp_path / "out"
    Machine.nominal().with_parameters({"bar_mismatch.y": 1e-4}).save(file)
    told = done("compare", "--machine", file, "--effects", "mount_tilt.x.b", "--out", out)
    assert "mount_tilt.x.b" in told
    files = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert files == {"table.md", "figures/machine.svg", "figures/mount_tilt.x.b.svg"}
    shown = re.findall(r"^\| `(.*?)`", (out / "table.md").read_text(), re.MULTILINE)
    assert shown == ["machine", "bar_mismatch.y", "mount_tilt.x.b"]
    again = run("compare", "--effects", "mount_tilt.x.b", "--out", out)
    assert again.exit_code == 2
    assert "overwritten" in again.output
