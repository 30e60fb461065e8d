"""Waves of a drive that the stations of a sheet cannot tell from a smooth curve."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings

_SHORTEST_WAVE = 5e-3
"""Metres: the shortest wave that matters where the machine file states no lead of the screws; it is
the smallest common lead of a ball screw."""

_CURVE_DEGREE = 2  # degree of the polynomial that a wave is taken for: a bow
_MIN_STATIONS = _CURVE_DEGREE + 3  # stations: fewer show no curve that could be compensated
_MIN_VISIBLE_SHARE = 0.05  # of a wave's size: 5 um of a wave of 0.1 mm are the noise of a dial
_PERIODS_PER_CYCLE = 10  # periods that are tried while the stroke takes one more cycle


def aliasing(machine: MachineSource, sheet: Readings) -> tuple[str, ...]:
    """Return a warning for each drive of which a sheet cannot tell a short wave from a curve.

    Waves are tried from the lead of the screws (5 mm where the machine file states none) to twice
    the largest distance of neighbouring stations; longer ones are sampled twice a cycle.

    Args:
        machine: stroke and lead of the screws.
        sheet: readings of dials on legs; their values do not count.
    """
    machine, found = Machine.of(machine), list[str]()
    shortest = machine.spec.screw_pitch or _SHORTEST_WAVE
    for leg, name in enumerate(machine.geometry.leg_names):
        travel = np.unique(np.round(sheet.command[sheet.on_legs & (sheet.leg == leg), leg], 6))
        if len(travel) < _MIN_STATIONS:
            continue
        period, seen = hidden_wave(travel, shortest)
        if seen < _MIN_VISIBLE_SHARE:
            found.append(
                f"at the {len(travel)} stations of drive {name} a wave of {period * 1e3:.3g} mm "
                f"looks like a smooth curve, so that a compensation from this sheet may make the "
                f"tool worse between the stations: choose other, unequal distances, or "
                f"stations less than {shortest * 1e3 / 2:.2g} mm apart"
            )
    return tuple(found)


_ROUNDING = 1e-6  # of a period: stations are rounded to a micrometre


def hidden_wave(travel: Array, shortest: float) -> tuple[float, float]:
    """Return the period of the wave that the stations show least, metres, and the share of it that
    no parabola takes, at the phase at which that is least.

    Args:
        travel: of the stations ``(n,)``, different, metres.
        shortest: period to begin with, metres.
    """
    span, longest = float(np.ptp(travel)), 2 * float(np.diff(np.sort(travel)).max())
    if longest <= shortest * (1 + _ROUNDING):
        return longest, 1.0
    cycles = np.arange(span / longest, span / shortest, 1 / _PERIODS_PER_CYCLE)
    u = (travel - travel.min()) / span
    smooth, _ = np.linalg.qr(np.polynomial.legendre.legvander(2 * u - 1, _CURVE_DEGREE))
    turn = 2 * np.pi * cycles[:, None] * u
    waves = np.stack([np.sin(turn), np.cos(turn)], axis=2)
    beside = waves - smooth @ (smooth.T @ waves)
    # A sine over many stations has the norm sqrt(n / 2).
    seen = np.linalg.svd(beside, compute_uv=False)[:, -1] / np.sqrt(len(travel) / 2)
    least = int(np.argmin(seen))
    return float(span / cycles[least]), float(seen[least])
