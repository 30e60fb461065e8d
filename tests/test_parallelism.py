"""Two dials on one leg at one posture: the chapter's first technique (2008, section 3.1, Fig. 4a),
and the z offset from mechanical zero alone (2006, sections 2.3 and 2.5).

Neither paper prints readings of it, so the independent machine of `tests.rig` gives them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import FileError, InputError
from orthoglide.instruments import Setup
from orthoglide.machine import Machine
from orthoglide.observations import Readings, protocol, read_campaign
from orthoglide.planning import observability
from orthoglide.report.sheet import sheet_page
from tests.command_line import done
from tests.rig import Rig

Array = np.ndarray
MACHINE = Machine.nominal()
L = MACHINE.geometry.L
OFFSETS = {"joint_offset.x": 6e-4, "joint_offset.y": -4e-4, "joint_offset.z": 5e-4}
HEAD = "kind,setup,leg,direction,rho_x_mm,rho_y_mm,rho_z_mm,gauge_mm,gauge2_mm,reading_mm\n"
ZERO = "310.25,310.25,310.25"


def measured(sheet: Readings, errors: Mapping[str, float]) -> Readings:
    """A sheet filled in with what dials on the independent machine show."""
    rig = Rig(errors=errors)
    lines = rig.pose(sheet.command, sheet.approach).lines
    bar = np.array([s.bar for s in sheet.setups])[sheet.setup]

    def shown(places: Array) -> Array:
        return rig.readings(lines, sheet.leg, sheet.direction, places, bar)

    first, last = (np.array([s.gauges[k] for s in sheet.setups])[sheet.setup] for k in (0, -1))
    pairs = sheet.of_kind("parallelism")
    return sheet.with_readings(np.where(pairs, shown(last) - shown(first), shown(first)))


def at_zero(*setups: Setup) -> Readings:
    """One reading of each setup at mechanical zero."""
    sheet, n = protocol("parallelism"), len(setups)
    zero = sheet.subset(np.zeros(n, dtype=int))
    order = np.arange(n)
    return replace(zero, setups=setups, setup=order, order=order + 1, line=order + 2,
                   axis=None, sign=None, moves=type(zero.moves)())  # fmt: skip


def along_z(leg: int, **more: float) -> Setup:
    """The leg against the base surface: two dials along z."""
    return Setup(f"{'xyz'[leg]}z", leg, 2, 1, 0.35 * L, 0, "parallelism", 0.65 * L, **more)


# -- the papers ------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["nlp", "nested", "pinocchio"])
def test_mechanical_zero_alone_gives_the_z_offset(method: str) -> None:
    """2006, section 2.5: at (L, L, L) dp = d rho, so that legs x and y stand off the base surface
    by the z offset at the tool and by none at the carriage; other offsets are of second order.
    """
    sheet = at_zero(along_z(0), along_z(1))
    for errors, allowed in (({"joint_offset.z": 5e-4}, 2e-6), (OFFSETS, 4e-6)):
        readings = measured(sheet, errors)
        assert readings.reading == pytest.approx(-0.3 * errors["joint_offset.z"], abs=1e-6)
        found = og.identify(readings, MACHINE, ["joint_offset.z"], priors=False, method=method)  # type: ignore[arg-type]
        assert abs(found.values["joint_offset.z"] - errors["joint_offset.z"]) < allowed
        # A leg's reading has 20 um x sqrt(2), and its dials stand 0.3 of it apart.
        one = 2e-5 * np.sqrt(2) / 0.3
        dial = np.hypot(2e-5 * np.sqrt(2), 1e-5 / np.sqrt(12)) / 0.3
        assert found.sigmas["joint_offset.z"] == pytest.approx(dial / np.sqrt(2), rel=0.01)
        assert dial == pytest.approx(one, rel=0.01)


def test_xmax_gives_the_x_offset_once_the_z_offset_is_known() -> None:
    """2006, (6): at XMax leg x shows dp_z = tan(alpha) d rho_x + d rho_z against the base."""
    sheet = at_zero(along_z(0), along_z(1))
    farthest = MACHINE.geometry.command_on_axis(0, 0.06)
    at_max = replace(at_zero(replace(along_z(0), name="xz at XMax")), command=farthest[None])
    both = og.observations.concatenated([sheet, at_max])
    tangent = 0.06 / np.sqrt(L**2 - 0.06**2)
    errors = {"joint_offset.x": 6e-4, "joint_offset.z": 5e-4}
    readings = measured(both, errors)
    moved = tangent * 6e-4 + 5e-4
    assert readings.reading[2] == pytest.approx(-0.3 * moved, abs=2e-6)
    found = og.identify(readings, MACHINE, [*errors], priors=False)
    for name, value in errors.items():
        assert abs(found.values[name] - value) < 1e-9
    with pytest.raises(og.UnidentifiableError, match=r"joint_offset\.y"):
        og.identify(readings, MACHINE, ["joint_offset"], priors=False)


# -- the surface -----------------------------------------------------------------------------------


def with_slope(slope: float) -> Machine:
    return Machine(replace(MACHINE.spec, surface_slope=slope))


def test_a_surface_that_may_slope_widens_the_offset() -> None:
    """By L times its slope, as a leg at mechanical zero leans by offset / L."""
    readings = measured(at_zero(along_z(0)), {"joint_offset.z": 5e-4})
    exact, sloped = (
        og.identify(readings, machine, ["joint_offset.z"], priors=False).sigmas["joint_offset.z"]
        for machine in (MACHINE, with_slope(1e-3))
    )
    assert sloped == pytest.approx(np.hypot(exact, 1e-3 * L), rel=1e-3)


def test_simulated_surfaces_slope_as_the_machine_file_says() -> None:
    """Of every setup by itself, dials with a datum beside them or not."""
    pairs, dials = protocol("parallelism"), protocol("standard")
    named = tuple(replace(s, name=f"{s.name} alone") for s in dials.setups)
    sheet = og.observations.concatenated([pairs, replace(dials, setups=named)])
    machine, rows = with_slope(1e-3), np.unique(sheet.setup, return_index=True)[1][:6]
    for given in (pairs, sheet):
        shown = np.array(
            [og.simulate(machine, given, noise=0.0, seed=k).reading[rows] for k in range(60)]
        )
        spread = np.sqrt(np.mean(shown**2))
        assert spread == pytest.approx(1e-3 * 0.3 * L, rel=0.15)


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (f"parallelism,s,x,z,{ZERO},90,90,0.1", r"line 2: .*two dials stand at one place"),
        (f"parallelism,s,x,z,{ZERO},90,400,0.1", r"line 2: the gauge at 400 mm is off the leg.*gau"
         "ge2_mm"),
        (f"parallelism,s,x,z,{ZERO},-5,200,0.1", r"line 2: the gauge at −5 mm is off .*gauge_mm"),
        (f"parallelism,s,x,z,{ZERO},90,0.2,0.1", r"line 2: gauge2_mm is in metres"),
        (f"parallelism,s,x,z,{ZERO},90,,0.1", r"line 2: gauge2_mm is empty"),
        (f"parallelism,s,x,x,{ZERO},90,200,0.1", r"line 2: direction is the leg's own axis"),
        (f"parallelism,s,x,z,{ZERO},90,200,-210", r"line 2: .*span 210 mm from 0"),
        (f"parallelism,s,x,z,{ZERO},90,200,", r"no readings yet"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused(rows: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text(f"{HEAD}{rows}\n")
    with pytest.raises(FileError, match=told):
        read_campaign(tmp_path / "c.csv")


def test_the_protocol_reads_both_dials_at_zero_max_and_min() -> None:
    sheet = protocol("parallelism")
    assert len(sheet) == 54
    assert set(sheet.kind) == {"parallelism"}
    assert {s.name for s in sheet.setups} == {
        f"{leg}{axis}-0.35-0.65" for leg in "xyz" for axis in "xyz" if leg != axis
    }
    assert np.allclose([s.gauges for s in sheet.setups], [[0.35 * L, 0.65 * L]], atol=1e-9)
    assert set(sheet.posture) == {"zero", "max", "min"}
    page = sheet_page(sheet, MACHINE, "sheet.csv")
    assert "less what the one at 108.6 mm shows" in page
    assert "Set both dials of a pair to zero against the surface" in page
    assert "do not zero it in between" not in page
    with pytest.raises(InputError, match=r"only readings of single dials.*kind parallelism"):
        observability(MACHINE, sheet, ["joint_offset"])


# -- for a user ------------------------------------------------------------------------------------


def test_a_user_goes_from_the_sheet_to_the_report(tmp_path: Path) -> None:
    machine, sheet, campaign = (tmp_path / name for name in ("m.toml", "sheet.csv", "c.csv"))
    with_slope(5e-5).save(machine)
    done("protocol", "--kind", "parallelism", "--machine", machine, "--out", sheet)
    assert (tmp_path / "sheet.html").exists()
    done("simulate", "--machine", machine, "--sheet", sheet, "--out", campaign, "--seed", 3,
        "--error", "joint_offset.x=0.6,joint_offset.y=-0.4,joint_offset.z=0.5")  # fmt: skip
    told = done("close-loop", campaign, "--machine", machine, "--out", tmp_path / "closed").text
    assert "two dials on a leg" in told
    result = json.loads((tmp_path / "closed" / "result.json").read_text())
    assert list(result["noise_of"]) == ["parallelism"]
    for name, value in OFFSETS.items():
        one = result["parameters"][name]
        assert abs(one["value"] - value * 1e3) < 4 * one["sigma"]
    rows = (tmp_path / "closed" / "residuals.csv").read_text().splitlines()
    names = rows[0].split(",")
    assert names[names.index("gauge_mm") + 1] == "gauge2_mm"
    first = dict(zip(names, rows[1].split(","), strict=True))
    assert (first["gauge2_mm"], first["kind"]) == ("201.662500", "parallelism")
    page = unescape((tmp_path / "closed" / "report.html").read_text())
    assert "Fitted with every setup: slope of the reference surface" in page
    assert "zero is arbitrary" not in page
