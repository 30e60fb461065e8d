"""A mesh as the firmware stores it, of an independent machine; and readings built by hand."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from orthoglide.firmware.klipper import Imported, import_printer
from tests.rig_delta import DeltaRig

DATA = Path(__file__).parent / "data" / "delta"
PROBE = 0.004


def simulated_cfg(
    rig: DeltaRig,
    noise: float = 1.2e-5,
    count: int = 9,
    seed: int = 0,
    *,
    lobes: float = 0.0,
    turned: Mapping[str, float] | None = None,
    middle: float = 0.0,
) -> str:
    """A ``printer.cfg`` with meshes of a machine whose plate is z = 0; the firmware knows no error.

    Args:
        rig: the machine.
        noise: of one touch, metres.
        count: touches along each axis.
        seed: of the noise.
        lobes: height of three lobes of the plate at the rim, one toward x, metres.
        turned: by profile how far the plate was turned counter-clockwise, degrees; one that was
            not where absent.
    """
    rng, radius, reach = np.random.default_rng(seed), rig.radius - rig.r, 0.12
    side, saved = np.linspace(-reach, reach, count), ""
    for name, angle in (turned or {"default": 0.0}).items():
        rows = []
        for y in side:
            row = []
            for x in side + middle:
                z, far = 0.0, np.hypot(x, y) / reach
                if np.hypot(x - middle, y) <= reach * (1 + 1e-9):
                    way = 3 * (np.arctan2(y, x) - np.deg2rad(angle))
                    plate = lobes * far**3 * np.cos(way)
                    z = _touched(rig, x, y, plate) + noise * rng.standard_normal()
                row.append(f"{z * 1e3:.6f}")
            rows.append("#*# \t" + ", ".join(row))
        saved += (
            f"#*# [bed_mesh {name}]\n#*# version = 1\n#*# points =\n" + "\n".join(rows) +
            f"\n#*# x_count = {count}\n#*# y_count = {count}\n"
            f"#*# min_x = {(middle - reach) * 1e3}\n#*# max_x = {(middle + reach) * 1e3}\n"
            f"#*# min_y = {-reach * 1e3}\n#*# max_y = {reach * 1e3}\n"
        )  # fmt: skip
    towers = "\n".join(
        f"[stepper_{name}]\nmicrosteps: 16\nrotation_distance: 40\nangle: {angle}\n"
        f"arm_length: {rig.L * 1e3:.6f}\nposition_endstop: 300\n"
        for name, angle in zip("abc", rig.angles, strict=True)
    )
    return (
        f"[printer]\nkinematics: delta\ndelta_radius: {radius * 1e3:.6f}\n{towers}\n"
        f"[probe]\nz_offset: {PROBE * 1e3:g}\n[bed_mesh]\nmesh_radius: {reach * 1e3:g}\n"
        f"#*# <------- SAVE_CONFIG ------->\n{saved}"
    )


def _touched(rig: DeltaRig, x: float, y: float, plate: float) -> float:
    """What the firmware stores: the height it believes at the touch, less the probe's."""
    told, z = np.array([x, y, PROBE]), PROBE
    for _ in range(4):
        place, _ = rig.pose(rig.inverse(np.array([x, y, z])), told)
        z += PROBE + plate - place[2]
    return z - PROBE


def imported(folder: Path, text: str) -> Imported:
    """Return what is imported of a printer's file of that text."""
    (folder / "printer.cfg").write_text(text)
    return import_printer(folder / "printer.cfg")
