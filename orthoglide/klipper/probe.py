"""The probe that a printer's file describes."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array, plane_columns
from orthoglide.klipper.config import Config
from orthoglide.klipper.entries import Section

PROBE = 1.8e-5
"""Repeatability of a touch, metres."""

_PROBES = (
    "probe", "bltouch", "smart_effector", "load_cell_probe", "probe_eddy_current", "beacon",
    "cartographer", "scanner", "dockable_probe",
)  # fmt: skip


def lies(p: Array, height: Array) -> tuple[float, float, float]:
    """By how much places ``(n, 3)`` are higher than ``(n,)`` in the middle, metres, and two slopes
    of that.
    """
    middle, x, y = np.linalg.lstsq(plane_columns(p), p[:, 2] - height, rcond=None)[0].tolist()
    return middle, x, y


def probe_section(config: Config) -> Section | None:
    """The section of the probe; ``None`` where there is none."""
    found = (s for s in config.named(*_PROBES) if s.name == "probe" or "z_offset" in s)
    return next(found, None)


def probe_offset(config: Config) -> tuple[float, Array]:
    """The probe's offset above the nozzle and beside it, metres."""
    if (section := probe_section(config)) is None:
        return 0.0, np.zeros(2)
    beside = [section.number(f"{axis}_offset", 0.0, -200, 200) for axis in "xy"]
    return section.number("z_offset", 0.0, -100, 100) * 1e-3, np.array(beside) * 1e-3
