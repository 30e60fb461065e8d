"""The firmware's numbers that serve a calibrated machine best, and what its own points miss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.accuracy import tcp_slopes
from orthoglide.effects.effect import Shape
from orthoglide.fit import Estimate
from orthoglide.geometry import Array, plane_columns
from orthoglide.klipper import Corrections
from orthoglide.klipper.firmware import refitted
from orthoglide.machine import Machine
from orthoglide.machine_file import Firmware
from orthoglide.parameters import Parameter
from orthoglide.prediction import Conditions

PROBED = (0.95, 0.90, 0.85, 0.70, 0.75, 0.80)
"""Radii of the firmware's own seven points, one in the centre, over its calibration radius; on rays
at 90, 150 ... degrees."""

_WIDE = 0.8
"""Of the widest plate, how far another one of more touches has to reach in its place."""

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

    The plate is the firmware's z = 0: its height and slopes, as fitted, go into the endstops. Where
    distances were read, the old numbers were fitted to them, and prints have the size that was
    measured; as a part's shrinkage is not known, the readings know no better, and it is kept.
    """
    plate = _plate(fit)
    if plate is None or plate.radius < _SPAN * old.delta_radius:
        return None
    wanted = _points(plate.radius)
    higher = plane_columns(wanted) @ plate.plane + _of_the_probe(old, machine, plate)
    lifted = wanted + np.outer(higher, [0.0, 0.0, 1.0])
    geometry, commands = machine.geometry, machine.inverse(lifted)
    at_zero = _at_zero(machine)
    below = commands + at_zero - old.at_endstop
    lengths = machine.catalogue.held_as("bar_length")
    longer = [
        sum(machine.values.get(f"{name}.{leg}", 0.0) for name in lengths)
        for leg in geometry.leg_names
    ]
    a, b, c = (geometry.L + v for v in longer)
    start = replace(old, arm=(a, b, c))
    sized = any(s.instrument.paired for tool in fit.problem.tool_campaigns for s in tool.setups)
    kept = _past_moves(wanted, sized)
    level, along = _spread(machine, plate, wanted, commands, kept)
    goal = _of_size(wanted, old.points(below + old.at_endstop)) if sized else wanted
    # Where the plate was touched is known; what a cause that was guessed does far above it is not.
    above = np.where(wanted[:, 2] > 0, _ABOVE, 1.0)
    weight = above / np.sqrt(plate.sigma**2 + level)
    new, _ = refitted(start, goal, below, weight, _past_moves(wanted, False), arms=sized)
    errors = [f.points(below + f.at_endstop) - goal for f in (old, new)]
    on = wanted[:, 2] == 0
    before, after = (float(np.sqrt(np.mean(e[on, 2] ** 2 + level[on]))) for e in errors)
    one, other = (
        float(np.sqrt(np.sum((kept @ e[:, :2].ravel()) ** 2) / len(e) + along)) for e in errors
    )
    return Corrections(old, new, (before, after), (one, other))


def _at_zero(machine: Machine) -> Array:
    """Heights of the carriages at mechanical zero ``(3,)``, metres."""
    return np.array([leg.carriage[2] - leg.platform[2] for leg in machine.geometry.legs])


def _of_the_probe(old: Firmware, machine: Machine, plate: _Plate) -> float:
    """By how much the plate lies higher than a probe beside the nozzle says, metres.

    Readings are about the mean of what the platform's turns lift the probe by. But its offset was
    set in the middle: it touched with the tool there, and then the nozzle touched the same place.
    """
    beside = plate.beside * [1, 1, 0]
    if not beside.any():
        return 0.0
    places = np.stack([np.zeros(3), beside])
    (middle, there), at_zero = old.heights(places), _at_zero(machine)
    pose = machine.pose(np.vstack([middle - at_zero, plate.commands]))
    lifted = (pose.R @ beside)[:, 2]
    higher = machine.forward(there - at_zero)[2] - pose.p[0, 2]
    return float(higher - lifted[0] + lifted[1:].mean())


def _spread(
    machine: Machine, plate: _Plate, points: Array, commands: Array, kept: Array
) -> tuple[Array, float]:
    """Variances of the tool's height over the plate as it was touched ``(g,)``, and along it, the
    mean, of what is kept of errors there ``(2 g, 2 g)``, square metres, at points ``(g, 3)`` with
    their commands ``(g, 3)``.
    """
    known = machine.posterior
    here = tcp_slopes(machine, known.names, Conditions.at(commands))
    touched = tcp_slopes(machine, known.names, Conditions.at(plate.commands))[:, 2]
    columns = plane_columns(plate.places)
    level = here[:, 2] - plane_columns(points) @ np.linalg.lstsq(columns, touched, rcond=None)[0]
    along = kept @ here[:, :2].reshape(-1, len(known.names))
    noise = plate.sigma**2 * np.linalg.pinv(columns.T @ columns)
    heights, ways = (
        np.einsum("gp,pq,gq->g", rows, known.covariance, rows) for rows in (level, along)
    )
    touches = np.einsum("gp,pq,gq->g", plane_columns(points), noise, plane_columns(points))
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
    touched = _plate(fit)
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


@dataclass(frozen=True, eq=False)
class _Plate:
    """A plate as it was touched."""

    radius: float  # that was touched
    plane: Array  # height and slopes (3,)
    commands: Array  # of the touches (n, 3)
    places: Array  # where they were (n, 2)
    sigma: float  # of one
    beside: Array  # where the probe is, from the nozzle (3,)


def _plate(fit: Estimate) -> _Plate | None:
    """The plate that was touched out to its rim by most touches; ``None`` where none was."""
    found, problem = list[_Plate](), fit.problem
    for k, factor, number, setup in problem.mounted:
        own = np.flatnonzero(factor.setup == number)
        if not setup.instrument.touches or len(own) < 3:
            continue
        rows, places = problem.factor_rows[k], fit.at.slopes[k][own, :2]
        rest = (problem.measured - fit.at.value)[rows][own]
        plane = np.asarray(-np.linalg.lstsq(plane_columns(places), rest, rcond=None)[0])
        found.append(_Plate(
            float(np.hypot(*places.T).max()), plane, factor.points.command[own], places,
            float(np.median(problem.sigma[rows][own])), np.array(setup.beside),
        ))  # fmt: skip
    widest = max((one.radius for one in found), default=0.0)
    wide = (one for one in found if one.radius >= _WIDE * widest)
    return max(wide, key=lambda one: len(one.places), default=None)


def _points(radius: float) -> Array:
    angle = np.arange(_RAYS) * 2 * np.pi / _RAYS
    found = [
        [ring * radius * np.cos(t), ring * radius * np.sin(t), z]
        for z in _HEIGHTS
        for ring in _RINGS
        for t in (angle if ring else angle[:1])
    ]
    return np.array(found)
