"""The firmware's numbers that serve a calibrated machine best, and what its own points miss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from orthoglide.accuracy import tcp_slopes
from orthoglide.effects.effect import Shape
from orthoglide.fit import Estimate
from orthoglide.geometry import Array, plane_columns
from orthoglide.klipper import AGAIN, RELATIVE, Corrections, doubted_rods
from orthoglide.klipper.firmware import refitted
from orthoglide.klipper.left import Left, fitted_already, larger_offset, left_of
from orthoglide.klipper.rods import SPREAD
from orthoglide.machine import Machine
from orthoglide.machine_file import Firmware
from orthoglide.machine_file.firmware import Triple
from orthoglide.parameters import Parameter
from orthoglide.prediction import Conditions
from orthoglide.result.plates import (
    Plate,
    far_out,
    for_zero,
    mean_of,
    plane_of,
    plane_slopes,
    plates,
    widest,
)

PROBED = (0.95, 0.90, 0.85, 0.70, 0.75, 0.80)
"""Radii of the firmware's own seven points, one in the centre, over its calibration radius; on rays
at 90, 150 ... degrees."""

_SPAN = 1 / 3
"""Of the radius of the towers, how far a plate has to be touched: numbers that fit its middle alone
may do anything at its rim."""

_RINGS, _RAYS, _HEIGHTS = (0.0, 0.5, 1.0), 12, (0.0, 0.05)
_ABOVE = 0.2
"""Weight of a height over the plate against one on it: a first layer is a fifth of a millimetre
high and must stick, further up a print takes such errors along."""


def corrections(old: Firmware, machine: Machine, fit: Estimate) -> Corrections | None:
    """New numbers for a machine's firmware in place of old ones; ``None`` where the fit's readings
    do not touch the plate, or its middle alone.

    The plate is the firmware's z = 0: its height and slopes, as touched, go into the endstops.
    Where distances were read, the old numbers were fitted to them, and prints have the size that
    was measured; as a part's shrinkage is not known, the readings know no better, and it is kept.
    """
    every = plates(fit)
    plate = widest(every)
    if plate is None or plate.radius < _SPAN * old.delta_radius:
        return None
    setting = for_zero(every)
    lies = mean_of((one, plane_of(one, old, machine)) for one in setting)
    wanted = _points(plate.radius)
    columns = plane_columns(wanted)
    commands = machine.inverse(wanted + np.outer(columns @ lies, [0.0, 0.0, 1.0]))
    below = commands + _at_zero(machine) - old.at_endstop
    sized = any(s.instrument.paired for tool in fit.problem.tool_campaigns for s in tool.setups)
    kept = _past_moves(wanted, sized)
    level, along = _spread(old, machine, setting, wanted, commands, kept)
    goal = _of_size(wanted, old.points(below + old.at_endstop)) if sized else wanted
    # Where the plate was touched is known; what a cause that was guessed does far above it is not.
    above = np.where(wanted[:, 2] > 0, _ABOVE, 1.0)
    weight = above / np.sqrt(plate.sigma**2 + level)
    start = replace(old, arm=_arms(old, machine))
    new, _ = refitted(start, goal, below, weight, _past_moves(wanted, False), arms=sized)
    errors = [f.points(below + f.at_endstop) - goal for f in (old, new)]
    on = wanted[:, 2] == 0
    apart = _apart(every, setting, lies, old, machine) @ columns[on].T
    before, after = (
        float(np.sqrt(np.mean((e[on, 2] + apart) ** 2) + level[on].mean())) for e in errors
    )
    one, other = (
        float(np.sqrt(np.sum((kept @ e[:, :2].ravel()) ** 2) / len(e) + along)) for e in errors
    )
    return Corrections(old, new, (before, after), (one, other), *_by_readings(old, new, fit))


def _by_readings(
    old: Firmware, new: Firmware, fit: Estimate
) -> tuple[tuple[Left, ...], float, str]:
    """What the firmware makes of the readings, how much larger the probe's offset will be, and why
    new numbers are not to be entered whatever they gain.
    """
    machine, read = fit.problem.machine, fit.problem.tool_campaigns
    kept = machine.spec.provenance["klipper"]
    why = ""
    if kept.get(AGAIN):
        why = "DELTA_CALIBRATE comes first, as is said at the top"
    elif doubted_rods(machine) and (spread := np.ptp(new.arm)) > SPREAD:
        why = (
            f"their arms differ by {spread * 1e3:.2f} mm, more than rods of one set do, as those "
            f"of the firmware do: measure the rods first"
        )
    elif fitted_already(old, read):
        why = (
            "DELTA_CALIBRATE has fitted those to these very readings, which tell no more than "
            "that: probe a mesh"
        )
    return (
        tuple(left_of(old, new, read, bool(kept.get(RELATIVE)))),
        larger_offset(old, new, read),
        why,
    )


def _apart(
    every: list[Plate], setting: list[Plate], lies: Array, old: Firmware, machine: Machine
) -> Array:
    """By how much each plate that tells of z = 0 lies otherwise than it was taken ``(k, 3)``,
    metres: none of them is known to be the right one.
    """
    told = [one for one in every if one in setting or one in far_out(every)]
    found = np.array([plane_of(one, old, machine) - lies for one in told])
    found[[one.relative for one in told], 0] = 0.0
    return found


def _at_zero(machine: Machine) -> Array:
    """Heights of the carriages at mechanical zero ``(3,)``, metres."""
    return np.array([leg.carriage[2] - leg.platform[2] for leg in machine.geometry.legs])


def _arms(old: Firmware, machine: Machine) -> Triple:
    """Of the calibrated machine; those that are stored where all are known no better, metres."""
    lengths, known = machine.catalogue.held_as("bar_length"), machine.posterior
    sd = dict(zip(known.names, np.sqrt(np.diag(known.covariance)), strict=True))
    names = [[f"{name}.{leg}" for name in lengths] for leg in machine.geometry.leg_names]
    a, b, c = (machine.geometry.L + sum(machine.values.get(n, 0.0) for n in own) for own in names)
    off = np.abs(np.subtract((a, b, c), old.arm))
    unsure = [np.linalg.norm([sd.get(n, 0.0) for n in own]) for own in names]
    return old.arm if (off <= unsure).all() else (a, b, c)


def _spread(
    old: Firmware,
    machine: Machine,
    setting: list[Plate],
    points: Array,
    commands: Array,
    kept: Array,
) -> tuple[Array, float]:
    """Variances of the tool's height over the plate as it was touched ``(g,)``, and along it, the
    mean, of what is kept of errors there ``(2 g, 2 g)``, square metres, at points ``(g, 3)`` with
    their commands ``(g, 3)``.
    """
    known, columns = machine.posterior, plane_columns(points)
    here = tcp_slopes(machine, known.names, Conditions.at(commands))
    lies = mean_of((one, plane_slopes(one, old, machine)) for one in setting)
    level = here[:, 2] - columns @ lies
    along = kept @ here[:, :2].reshape(-1, len(known.names))
    noise = sum(one.sigma**2 * one.taken @ one.taken.T for one in setting) / len(setting) ** 2
    heights, ways = (
        np.einsum("gp,pq,gq->g", rows, known.covariance, rows) for rows in (level, along)
    )
    touches = np.einsum("gp,pq,gq->g", columns, noise, columns)
    return heights + touches, float(ways.sum()) / len(points)


def _of_size(points: Array, believed: Array) -> Array:
    """Points ``(g, 3)`` as much larger along the plate as they are believed to be ``(g, 3)``."""
    own, other = (p[:, 0] + 1j * p[:, 1] for p in (points, believed))
    own, other = own - own.mean(), other - other.mean()
    larger = abs(np.vdot(own, other)) / np.vdot(own, own).real
    return points * [larger, larger, 1.0]


def _past_moves(points: Array, sized: bool) -> Array:
    """Takes a shift and a turn along the plate, and what is ``sized`` otherwise, out of errors
    there, as ``(2 g, 2 g)``.
    """
    moves = np.zeros((len(points), 2, 4))
    moves[:, 0, 0] = moves[:, 1, 1] = 1.0
    moves[:, :, 2] = np.column_stack([-points[:, 1], points[:, 0]])
    moves[:, :, 3] = points[:, :2]
    turn = np.linalg.qr(moves.reshape(-1, 4)[:, : 3 + sized])[0]
    return np.asarray(np.eye(len(turn)) - turn @ turn.T)


def unseen_by_firmware(
    machine: Machine, fit: Estimate, values: Mapping[Parameter, float], plate: Mapping[Shape, float]
) -> tuple[float, float]:
    """What a cause of this size changes the firmware's seven heights by, over a touch.

    Args:
        machine: nominal or calibrated.
        fit: whose readings touched the plate.
        values: elementary parameters of the machine, SI.
        plate: shapes of the plate with their sizes, metres.

    Returns:
        The largest change that its six numbers do not take up, and the largest before they do, in
        sigmas of a touch; nan where no plate was touched.
    """
    touched = widest(plates(fit))
    if touched is None:
        return float("nan"), float("nan")
    radius = touched.radius
    angle = np.deg2rad(90.0 + 60.0 * np.arange(6))
    ring = np.array(PROBED) * radius
    points = np.zeros((7, 3))
    points[1:, 0], points[1:, 1] = ring * np.cos(angle), ring * np.sin(angle)
    at = Conditions.at(machine.with_only({}).inverse(points))
    known = machine.catalogue.held_as("zero", "place")  # in the catalogue's order
    every = [*machine.catalogue.expand(known), *values]
    _, by_name = machine.with_only({}).model.sensitivities({}, at, every)
    by_z = by_name[:, 2]
    out = by_z[:, 3:9]
    outward, tangential = out[:, 0::2].sum(axis=1), out[:, 1::2]
    six = np.column_stack([by_z[:, :3], outward, tangential[:, :2]])
    shift = by_z[:, 9:] @ np.array(list(values.values()))
    x, y = points[:, :2].T / radius
    shift -= sum(size * shape(x, y) for shape, size in plate.items())
    left = shift - six @ np.linalg.lstsq(six, shift, rcond=1e-9)[0]
    sigma = float(np.median(fit.problem.sigma))
    return float(np.abs(left).max() / sigma), float(np.abs(shift).max() / sigma)


def _points(radius: float) -> Array:
    angle = np.arange(_RAYS) * 2 * np.pi / _RAYS
    found = [
        [ring * radius * np.cos(t), ring * radius * np.sin(t), z]
        for z in _HEIGHTS
        for ring in _RINGS
        for t in (angle if ring else angle[:1])
    ]
    return np.array(found)
