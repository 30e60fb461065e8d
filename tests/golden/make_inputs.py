"""Simulate the campaigns in ``inputs`` by the independent machines of the tests.

The files are frozen. A golden result belongs to the file, so this program is not run again when a
simulator changes. ``python -m tests.golden.make_inputs DIR`` writes them to another folder.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tests import rig_campaigns as rc
from tests.rig import Rig
from tests.rig_delta import DeltaRig

OFFSETS = {"joint_offset.x": 8e-4, "joint_offset.y": -5e-4, "leg_length.z": 5e-5}


def measured(protocol: str, repeats: int, seed: int, **changes: Any) -> list[rc.Row]:
    """Rows of a protocol on a sound machine with joint offsets and the given fields of `Rig`."""
    errors = OFFSETS | changes.pop("errors", {})
    rig = Rig(errors=errors, **changes)
    rows = rc.protocol_rows(protocol, rig, repeats)
    return rc.simulate(rig, rows, np.random.default_rng(seed), background=0.015)


def dial_campaigns() -> Iterator[tuple[str, list[rc.Row]]]:
    """Name and rows of the campaigns of an Orthoglide."""
    leaning = measured("standard", 3, 11, errors={"axis_tilt.y.z": 3e-3})
    yield "knocked-stand", rc.knocked_stand(leaning, "zx-0.5", 0.08).rows
    leaning = measured("sweep", 2, 12, errors={"axis_tilt.x.z": 4e-3})
    yield "swapped-sign", rc.swapped_sign(leaning, "xz-0.5").rows
    lagging = measured("sweep", 1, 13, errors={"backlash.x": 1e-4})
    yield "outlier", rc.outlier(lagging, 61, 0.2).rows
    yield "s-curve", measured("sweep", 2, 14, extra=(rc.s_curve(0, 2, 1.5e-4),))
    yield "drive-step", measured("sweep", 2, 15, extra=(rc.drive_step(1, 3e-4),))
    yield "visit-1", measured("sweep", 1, 16, errors={"axis_tilt.y.z": 3e-3})
    corrected = {"axis_tilt.y.z": 3e-4, "joint_offset.x": 0.0}
    yield "visit-2", measured("sweep", 1, 17, errors=corrected)
    yield "carriage-play", measured("sweep", 2, 18, extra=(carriage_play(2, 0, 2e-4),))


def carriage_play(leg: int, axis: int, value: float) -> Any:
    """A carriage that lags half of a value sideways, behind the last move of its drive."""

    def effect(travel: Any, approach: Any, time: Any) -> Any:
        out = np.zeros((len(travel), 3, 3))
        out[:, leg, axis] = -value / 2 * approach[:, leg]
        return out

    return effect


def delta_campaigns() -> Iterator[tuple[str, list[rc.Row]]]:
    """A probe on the plate of a linear delta, and distances between places of its tool."""
    errors = {"joint_offset.a": 4e-4, "joint_offset.b": -3e-4, "axis_offset.c.tangential": 2e-4}
    rig = DeltaRig(errors=errors | {"rail_tilt.b.tangential": 6e-3})
    rng = np.random.default_rng(21)
    side = np.linspace(-0.12, 0.12, 7)
    places = [(x, y) for x in side for y in side if np.hypot(x, y) <= 0.1201]
    rows: list[rc.Row] = []
    for x, y in places:
        command = np.array([x, y, 0.0])
        p = rig.pose(rig.inverse(command), command)[0]
        value = p[2] - rig.plate(p[0], p[1], 0.12) + rng.normal(0, 1.8e-5)
        rows.append(row("plate", "bed", rig.inverse(command), value))
    angle = np.arange(12) * np.pi / 6
    ring = 0.09 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    for step in (2, 4, 6):
        for k in range(12 if step < 6 else 6):
            ends = [ring[k], ring[(k + step) % 12]]
            one, other = (rig.pose(rig.inverse(p), p)[0] for p in ends)
            value = 1.0015 * np.linalg.norm(other - one) + rng.normal(0, 5e-5)
            rows.append(row("distance", "print", rig.inverse(ends[0]), value, rig.inverse(ends[1])))
    yield "delta", rows


def row(kind: str, setup: str, travel: Any, value: float, second: Any = None) -> rc.Row:
    """A row of readings of the tool."""
    cells: rc.Row = {"kind": kind, "setup": setup}
    for k, leg in enumerate("abc"):
        cells[f"travel_{leg}_mm"] = round(travel[k] * 1e3, 6)
    for k, leg in enumerate("abc"):
        cells[f"travel_{leg}2_mm"] = "" if second is None else round(second[k] * 1e3, 6)
    return cells | {"reading_mm": round(float(value) * 1e3, 4)}


def main(folder: Path) -> None:
    """Write every campaign into a folder."""
    for name, rows in (*dial_campaigns(), *delta_campaigns()):
        rc.write_csv(rows, folder / f"{name}.csv")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
