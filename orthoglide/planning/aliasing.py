"""Waves of a drive that the stations of a sheet cannot tell from a smooth curve."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings

_SHORTEST_WAVE = 5e-3
"""Metres: the smallest common lead of a ball screw, where the machine file states none."""

_CURVE_DEGREE = 2  # degree of the polynomial that a wave looks like: a bow
_MIN_STATIONS = _CURVE_DEGREE + 3  # stations: fewer show no curve that could be compensated
_MIN_VISIBLE_SHARE = 0.05  # of a wave's size: 5 um of a wave of 0.1 mm are the noise of a dial
_PERIODS_PER_CYCLE = 10  # periods that are tried while the stroke takes one more cycle


def aliasing(machine: MachineSource, sheet: Readings) -> tuple[str, ...]:
    """Return a warning for each drive on which a sheet cannot tell a short wave from a curve.

    Waves are tried from the lead of the screws (5 mm where the machine file states none) to twice
    the largest distance of neighbouring stations; longer ones are sampled twice a cycle.

    Args:
        machine: stroke and lead of the screws.
        sheet: readings of dials on legs; their values do not count.
    """
    machine, warnings = Machine.of(machine), list[str]()
    shortest = machine.spec.screw_pitch or _SHORTEST_WAVE
    for leg, name in enumerate(machine.geometry.leg_names):
        positions = np.unique(np.round(sheet.command[sheet.on_legs & (sheet.leg == leg), leg], 6))
        if len(positions) < _MIN_STATIONS:
            continue
        period, visible_share = hidden_wave(positions, shortest)
        if visible_share < _MIN_VISIBLE_SHARE:
            warnings.append(
                f"at the {len(positions)} stations of drive {name} a wave of {period * 1e3:.3g} mm "
                f"looks like a smooth curve, so that a compensation from this sheet may make the "
                f"tool worse between the stations: choose other, unequal distances, or "
                f"stations less than {shortest * 1e3 / 2:.2g} mm apart"
            )
    return tuple(warnings)


_ROUNDING = 1e-6  # of a period: stations are rounded to a micrometre


def hidden_wave(positions: Array, shortest: float) -> tuple[float, float]:
    """Return the period of the wave that the stations show least, metres, and its visible share.

    The visible share of a wave is what no parabola fits, at the least visible phase.

    Args:
        positions: of the stations ``(n,)``, different, metres.
        shortest: period to begin with, metres.
    """
    span, longest = float(np.ptp(positions)), 2 * float(np.diff(np.sort(positions)).max())
    if longest <= shortest * (1 + _ROUNDING):
        return longest, 1.0
    cycles = np.arange(span / longest, span / shortest, 1 / _PERIODS_PER_CYCLE)
    u = (positions - positions.min()) / span
    curves, _ = np.linalg.qr(np.polynomial.legendre.legvander(2 * u - 1, _CURVE_DEGREE))
    phase = 2 * np.pi * cycles[:, None] * u
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=2)
    residuals = waves - curves @ (curves.T @ waves)
    # A sine over many stations has the norm sqrt(n / 2).
    visible_shares = np.linalg.svd(residuals, compute_uv=False)[:, -1] / np.sqrt(len(positions) / 2)
    worst = int(np.argmin(visible_shares))
    return float(span / cycles[worst]), float(visible_shares[worst])
