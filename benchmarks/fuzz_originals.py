"""The sound files that ``fuzz.py`` spoils, by kind."""

from __future__ import annotations

import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from click.testing import CliRunner

import orthoglide as og
from benchmarks.public import campaign_text, command_line, machine_text

DATA = Path(__file__).parents[1] / "tests" / "data"
_ERRORS = {"joint_offset.x": 0.8e-3, "leg_length.z": 0.06e-3, "axis_tilt.y.z": 1e-3}


def _legs() -> og.Machine:
    """Three legs under names of their own, on the negative axes."""
    legs = [
        og.FreeLeg(name, tuple(-0.31025 * axis), tuple(-axis), tuple(np.roll(axis, 1)))
        for name, axis in zip("pqs", np.eye(3), strict=True)
    ]
    return og.Machine.of(og.Geometry(layout=og.FreeLegs((legs[0], legs[1], legs[2]))))


def _written(*command: str | Path, **given: str) -> dict[str, str]:
    """Return what a command writes into ``--out``, by name; files are given by name."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in given.items():
            Path(folder, name).write_text(text)
        words = [str(Path(folder, w)) if w in given else str(w) for w in command]
        out = Path(folder, "out")
        CliRunner().invoke(command_line(), [*words, "--out", str(out)])
        return {path.name: path.read_text("utf-8") for path in out.iterdir()
                if path.suffix in (".json", ".toml", ".csv")}  # fmt: skip


@cache
def originals() -> dict[str, str]:
    """The sound files, by kind."""
    machine, legs = og.Machine.nominal().with_parameters(_ERRORS), _legs()
    campaign = (files("orthoglide") / "data" / "experiment2.csv").read_text()
    small = "".join(campaign.splitlines(True)[:7])
    points = (DATA / "former" / "campaigns" / "orthoglide.tcp.csv").read_text()
    printer = DATA / "delta" / "electrocally.cfg"
    imported = _written("import", "klipper", printer)
    sheets = og.tool_sheets(legs, ["plate", "tcp", "distance", "ballbar", "incline"])
    tool = [og.simulate(legs.with_parameters({"joint_offset.p": 3e-4}), sheet, exact=True)
            for sheet in sheets]  # fmt: skip
    travel = "travel_a_mm,travel_b_mm,travel_c_mm\n0,0,0\n5,-3,2.5\n"
    return {
        "campaign": campaign, "small": small, "machine": machine_text(machine),
        "tcp": "".join(points.splitlines(True)[:13]),
        "result": _written("identify", "small", "--quiet", small=small)["result.json"],
        "path": (DATA / "former" / "path.csv").read_text(),
        "rho": "rho_x_mm,rho_y_mm,rho_z_mm\n310.25,310.25,310.25\n300,305,309\n",
        "printer": printer.read_text(),
        "calibrated printer": (DATA / "delta" / "v400-april.cfg").read_text(),
        "delta": imported["machine.toml"], "mesh": imported["mesh-default.csv"],
        "simulated": campaign_text(og.simulate(machine, seed=0)), "travel": travel,
        "legs": machine_text(legs), "tool": campaign_text(tool, legs),
        "travel of legs": travel.replace("_a_", "_p_").replace("_b_", "_q_").replace("_c_", "_s_"),
        "sheet": campaign_text(og.protocol("standard")),
    }  # fmt: skip
