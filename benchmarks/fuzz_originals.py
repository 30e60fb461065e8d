"""The sound files that ``fuzz.py`` spoils, by kind."""

from __future__ import annotations

import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

from click.testing import CliRunner

import orthoglide as og
from benchmarks.public import campaign_text, command_line, machine_text, tcp_text

_ERRORS = {"joint_offset.x": 0.8e-3, "leg_length.z": 0.06e-3, "axis_tilt.y.z": 1e-3}
_LEGS = """schema = 1
name = "three legs"
[geometry_mm]
L = 310.25
d = 80.0
r = 31.0
stroke = [-100.0, 60.0]
[tolerance]
joint_offset = 1.0
[instrument.plate]
resolution = 0.01
repeatability = 0.005
[layout]
kind = "legs"
tool_mm = [0.0, 0.0, 0.0]
[layout.leg.p]
origin_mm = [-310.25, 0.0, 0.0]
slide = [-1.0, 0.0, 0.0]
link = [0.0, 1.0, 0.0]
[layout.leg.q]
origin_mm = [0.0, -310.25, 0.0]
slide = [0.0, -1.0, 0.0]
link = [0.0, 0.0, 1.0]
[layout.leg.s]
origin_mm = [0.0, 0.0, -310.25]
slide = [0.0, 0.0, -1.0]
link = [1.0, 0.0, 0.0]
"""
_TOOL_HEAD = (
    "kind,setup,direction,travel_p_mm,travel_q_mm,travel_s_mm,travel_p2_mm,travel_q2_mm,"
    "travel_s2_mm,reading_mm,reading_mrad,sigma_mm,sigma_mrad"
)
_TOOL_KINDS = ("plate", "tcp", "distance", "ballbar", "incline")
_STORED = Path(__file__).parents[1] / "tests" / "data" / "delta" / "v400-april.cfg"
_PRINTER = """[printer]
kinematics: delta
delta_radius: 174.75
[stepper_a]
position_endstop: 297.05
arm_length: 333.0
rotation_distance: 40
microsteps: 16
[stepper_b]
rotation_distance: 40
microsteps: 16
[stepper_c]
rotation_distance: 40
microsteps: 16
[probe]
z_offset: 1.5
#*# [bed_mesh default]
#*# version = 1
#*# points =
#*#   0.05, 0.02, -0.01, 0.03
#*#   0.01, 0.00, 0.03, -0.02
#*#   -0.02, 0.04, 0.06, 0.01
#*#   -0.03, 0.01, 0.02, 0.04
#*# x_count = 4
#*# y_count = 4
#*# min_x = -50
#*# max_x = 50
#*# min_y = -50
#*# max_y = 50
"""


def _tool() -> str:
    """Readings of the tool of all kinds, ten of each, on the machine of three legs."""
    lines = [_TOOL_HEAD]
    for n, kind in enumerate(_TOOL_KINDS):
        for k in range(10):
            travel = [round(20 * ((7 * k + 3 * n + 5 * axis) % 11 / 5 - 1), 2) for axis in range(3)]
            other = [-v if kind == "distance" else "" for v in travel]
            told = "xyz"[k % 3] if kind in ("tcp", "incline") else ""
            shown = ["", "0", "", "0.02"] if kind == "incline" else ["9", "", "0.01", ""]
            lines.append(",".join(map(str, [kind, kind, told, *travel, *other, *shown])))
    with tempfile.TemporaryDirectory() as folder:
        (machine := Path(folder, "legs.toml")).write_text(_LEGS)
        (sheet := Path(folder, "tool.csv")).write_text("\n".join(lines) + "\n")
        legs = og.Machine.load(machine)
        (campaign,) = og.read_readings(sheet, legs.spec)
    wrong = legs.with_parameters({"joint_offset.p": 3e-4})
    return campaign_text(og.simulate(wrong, campaign, exact=True), legs)


@cache
def originals() -> dict[str, str]:
    """The sound files, by kind."""
    data = files("orthoglide") / "data"
    campaign = (data / "experiment2.csv").read_text()
    small = "\n".join(campaign.splitlines()[:7]) + "\n"
    machine = og.Machine.nominal().with_parameters(_ERRORS)
    points = tcp_text(og.simulate_tcp(machine, seed=0))
    tcp = "\n".join(points.splitlines()[:13]) + "\n"
    with tempfile.TemporaryDirectory() as folder:
        sound, out = Path(folder, "small.csv"), Path(folder, "out")
        sound.write_text(small)
        CliRunner().invoke(command_line(), ["identify", str(sound), "--quiet", "--out", str(out)])
        result = (out / "result.json").read_text()
    with tempfile.TemporaryDirectory() as folder:
        stored, out = Path(folder, "printer.cfg"), Path(folder, "out")
        stored.write_text(_PRINTER)
        CliRunner().invoke(command_line(), ["import", "klipper", str(stored), "--out", str(out)])
        delta, mesh = ((out / n).read_text() for n in ("machine.toml", "mesh-default.csv"))
    with tempfile.TemporaryDirectory() as folder:
        CliRunner().invoke(command_line(), ["protocol", "--out", str(Path(folder, "sheet.csv"))])
        sheet = Path(folder, "sheet.csv").read_text()
    path = "p_x_mm,p_y_mm,p_z_mm\n0,0,0\n10,0,-5\n-20,15,3\n"
    travel = "travel_a_mm,travel_b_mm,travel_c_mm\n0,0,0\n5,-3,2.5\n"
    rho = "rho_x_mm,rho_y_mm,rho_z_mm\n310.25,310.25,310.25\n300,305,309\n"
    return {
        "campaign": campaign, "small": small, "machine": machine_text(machine), "tcp": tcp,
        "result": result, "path": path, "rho": rho, "printer": _PRINTER,
        "calibrated printer": _STORED.read_text(), "delta": delta, "mesh": mesh,
        "simulated": campaign_text(og.simulate(machine, seed=0)), "travel": travel,
        "legs": _LEGS, "tool": _tool(), "travel of legs": travel.replace("_a_", "_p_")
        .replace("_b_", "_q_").replace("_c_", "_s_"), "sheet": sheet,
    }  # fmt: skip
