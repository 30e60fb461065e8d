"""A mesh as the firmware stores it, of an independent machine; and readings built by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.rig_delta import DeltaRig

DATA = Path(__file__).parent / "data" / "delta"
PROBE = 0.004


def simulated_cfg(rig: DeltaRig, noise: float = 1.2e-5, count: int = 9, seed: int = 0) -> str:
    """A ``printer.cfg`` with a mesh of a machine whose plate is z = 0; the firmware knows no error.

    Args:
        rig: the machine.
        noise: of one touch, metres.
        count: touches along each axis.
        seed: of the noise.
    """
    rng, radius, reach = np.random.default_rng(seed), rig.radius - rig.r, 0.12
    side, rows = np.linspace(-reach, reach, count), []
    for y in side:
        row = []
        for x in side:
            z = 0.0
            if np.hypot(x, y) <= reach * (1 + 1e-9):
                z = _touched(rig, x, y) + noise * rng.standard_normal()
            row.append(f"{z * 1e3:.6f}")
        rows.append("#*# \t" + ", ".join(row))
    towers = "\n".join(
        f"[stepper_{name}]\nmicrosteps: 16\nrotation_distance: 40\nangle: {angle}\n"
        f"arm_length: {rig.L * 1e3:.6f}\nposition_endstop: 300\n"
        for name, angle in zip("abc", rig.angles, strict=True)
    )
    saved = "\n".join(rows)
    return (
        f"[printer]\nkinematics: delta\ndelta_radius: {radius * 1e3:.6f}\n{towers}\n"
        f"[probe]\nz_offset: {PROBE * 1e3:g}\n[bed_mesh]\nmesh_radius: {reach * 1e3:g}\n"
        f"#*# <------- SAVE_CONFIG ------->\n#*# [bed_mesh default]\n#*# version = 1\n"
        f"#*# points =\n{saved}\n#*# x_count = {count}\n#*# y_count = {count}\n"
        f"#*# min_x = {-reach * 1e3}\n#*# max_x = {reach * 1e3}\n"
        f"#*# min_y = {-reach * 1e3}\n#*# max_y = {reach * 1e3}\n"
    )


def _touched(rig: DeltaRig, x: float, y: float) -> float:
    """What the firmware stores: the height it believes at the touch, less the probe's."""
    told, z = np.array([x, y, PROBE]), PROBE
    for _ in range(4):
        place, _ = rig.pose(rig.inverse(np.array([x, y, z])), told)
        z += PROBE - place[2]
    return z - PROBE
