"""The firmware's numbers that serve a calibrated machine best, and what its own points miss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from orthoglide.effects.effect import Shape
from orthoglide.fit import Estimate
from orthoglide.fit.tool import ToolReadings
from orthoglide.geometry import Array
from orthoglide.klipper import Corrections, Firmware
from orthoglide.klipper.firmware import refitted
from orthoglide.machine import Machine
from orthoglide.parameters import Parameter
from orthoglide.prediction import Conditions

PROBED = (0.95, 0.90, 0.85, 0.70, 0.75, 0.80)
"""Radii of the firmware's own seven points, one in the centre, over its calibration radius; on rays
at 90, 150 ... degrees."""

_RINGS, _RAYS, _HEIGHTS = (0.0, 0.5, 1.0), 12, (0.0, 0.05)


def corrections(old: Firmware, machine: Machine, fit: Estimate) -> Corrections | None:
    """New numbers for a machine's firmware.

    The plate is the firmware's z = 0: its height and slopes, as fitted, go into the endstops.

    Args:
        old: its present numbers.
        machine: calibrated.
        fit: whose readings touched the plate; without any there is nothing to say.
    """
    plate = _plate(fit)
    if plate is None:
        return None
    radius, plane = plate
    wanted = _points(radius)
    lifted = wanted + np.outer(np.column_stack([np.ones(len(wanted)), wanted[:, :2]]) @ plane,
                               [0.0, 0.0, 1.0])  # fmt: skip
    geometry = machine.geometry
    at_zero = np.array([leg.carriage[2] - leg.platform[2] for leg in geometry.legs])
    below = machine.inverse(lifted) + at_zero - old.at_endstop
    lengths = machine.catalogue.held_as("bar_length")
    longer = [
        sum(machine.values.get(f"{name}.{leg}", 0.0) for name in lengths)
        for leg in geometry.leg_names
    ]
    a, b, c = (geometry.L + v for v in longer)
    start = replace(old, arm=(a, b, c))
    new, _ = refitted(start, wanted, below)
    errors = [f.points(below + f.at_endstop) - wanted for f in (old, new)]
    before, after = (float(np.sqrt(np.mean(e[:, 2] ** 2))) for e in errors)
    one, other = (float(np.sqrt(np.mean(np.sum(e[:, :2] ** 2, axis=1)))) for e in errors)
    return Corrections(old, new, (before, after), (one, other))


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
    radius, _ = touched
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


def _plate(fit: Estimate) -> tuple[float, Array] | None:
    """Radius that was touched, and the plate's height and slopes ``(3,)``; of most touches."""
    best: tuple[int, float, Array] | None = None
    problem = fit.problem
    for k, factor in enumerate(problem.points):
        if not isinstance(factor, ToolReadings):
            continue
        rows = problem.factor_rows[len(problem.campaigns) + k]
        slopes = fit.at.slopes[len(problem.campaigns) + k]
        rest = problem.measured[rows] - fit.at.value[rows]
        for place, setup in enumerate(factor.points.setups):
            own = np.flatnonzero(factor.setup == place)
            if setup.kind != "plate" or len(own) < 3:
                continue
            columns = np.column_stack([np.ones(len(own)), slopes[own, :2]])
            plane = np.asarray(-np.linalg.lstsq(columns, rest[own], rcond=None)[0], dtype=float)
            radius = float(np.hypot(*slopes[own, :2].T).max())
            if best is None or len(own) > best[0]:
                best = (len(own), radius, plane)
    return None if best is None else best[1:]


def _points(radius: float) -> Array:
    angle = np.arange(_RAYS) * 2 * np.pi / _RAYS
    found = [
        [ring * radius * np.cos(t), ring * radius * np.sin(t), z]
        for z in _HEIGHTS
        for ring in _RINGS
        for t in (angle if ring else angle[:1])
    ]
    return np.array(found)
