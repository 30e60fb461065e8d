"""Readings and TCP points of a machine that exists as a model only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from orthoglide.accuracy import wanted_points
from orthoglide.arguments import public
from orthoglide.errors import ClosureError, check_integer, check_type
from orthoglide.fit.factors import Factor
from orthoglide.fit.noise import check_noise, instrument_of
from orthoglide.geometry import Array
from orthoglide.instruments import InstrumentPose
from orthoglide.machine import Machine, MachineSource
from orthoglide.machine_file.values import check_magnitudes
from orthoglide.mechanism.perfect_legs import Spheres, commands as commands_of
from orthoglide.observations import Readings, from_points, protocol, split_legs_and_tool
from orthoglide.observations.protocols import ProtocolName
from orthoglide.prediction import MeasurementModel, ReadingPoses

__all__ = ["TCP_POINTS", "invisible_parameters", "simulate", "simulate_tcp"]

TCP_POINTS = 60
"""Points over the workspace that are enough to judge a calibration by."""

_CONDITION_COLUMNS = {"time": "time_s", "temperature": "temperature_C", "load": "load_N",
            "approach": "approach_x, _y and _z"}  # fmt: skip

Seed = int | np.random.Generator

_MIXED_POINTS = 4  # points of the workspace between which a point is drawn
_DATUM_RANGE = 1e-3  # metres or radians: where an instrument's zero, or its frame, may lie


@public
def simulate(
    machine: MachineSource,
    sheet: Readings | ProtocolName = "standard",
    *,
    noise: float | None = None,
    seed: Seed = 0,
    exact: bool = False,
) -> Readings:
    """Fill in a measuring sheet with what instruments on this machine would show.

    Each dial has its own datum and stands up to some placement error off its place; each instrument
    at the tool has its own datum, frame, plane or scale. Readings are noisy and rounded to the
    instrument's resolution.

    Args:
        machine: with its errors as parameters, or the path of its file.
        sheet: readings whose values do not count, or a kind of protocol for dials.
        noise: standard deviation of one reading, metres; where absent that of the sheet's rows,
            else the machine file's, else what is usual of the kind.
        seed: of all random draws, or where to draw from.
        exact: no noise, no rounding, dials exactly in place, datums zero.

    Raises:
        InputError: for a noise that is no standard deviation, a negative seed, or an error so large
            that it must be in another unit.
    """
    machine = Machine.of(machine)
    if isinstance(sheet, str):
        sheet = protocol(sheet, machine.geometry)
    check_type("the sheet", sheet, Readings, "one table of readings, or a kind of protocol")
    generator = _random_generator(seed)
    sd = None if noise is None else check_noise(noise, 0.0)
    rng = None if exact else generator
    parts = [_fill_in(machine, part, sd, rng) for part in split_legs_and_tool(sheet)]
    if len(parts) == 1:
        return parts[0]
    reading = np.empty(len(sheet))
    reading[sheet.on_legs], reading[~sheet.on_legs] = (part.reading for part in parts)
    return sheet.with_readings(reading)


def _fill_in(
    machine: Machine, sheet: Readings, noise: float | None, rng: np.random.Generator | None
) -> Readings:
    """Return a sheet of legs or of the tool, filled in; exact without a random generator."""
    with _refusing_absurd_values(machine):
        factor = Factor.from_planned(sheet, machine)
        predicted = factor.linearise(machine.model, machine.values, ())
        if rng is None:
            return sheet.with_readings(np.round(predicted.value, 15))
        if factor.on_legs:
            drawn = _draw_dial_nuisances(factor, rng)
        else:
            drawn = _draw_tool_nuisances(factor, predicted.reading_poses, rng)
        displaced, nuisances = list[InstrumentPose](), np.zeros_like(drawn)
        for setup, stand, row, drawn_row in zip(
            sheet.setups, factor.instrument_poses, nuisances, drawn, strict=True
        ):
            columns = slice(setup.observation.nuisance_count)
            pose, row[columns] = setup.observation.apply_pose_nuisances(stand, drawn_row[columns])
            displaced.append(pose)
        model = MeasurementModel(sheet, tuple(displaced), factor.normalized_plate_xy, nuisances)
        readings = model.predict(machine.model, machine.values)
    sigma, resolution = sheet.sigma.copy(), np.zeros(len(sheet))
    for observation, rows in sheet.observations:
        instrument = instrument_of(machine.spec, observation)
        resolution[rows] = instrument.resolution or 0.0
        usual = instrument.repeatability
        usual = observation.repeatability if usual is None else usual
        sigma[rows] = np.where(np.isfinite(sigma[rows]), sigma[rows], usual)
    readings = readings + rng.normal(scale=sigma if noise is None else noise, size=len(sheet))
    rounded = np.round(readings / np.maximum(resolution, 1e-12)) * resolution
    readings = np.where(resolution > 0, rounded, readings)
    return sheet.with_readings(np.round(readings, 12))


def _draw_dial_nuisances(factor: Factor, rng: np.random.Generator) -> Array:
    """Return nuisances of dials on legs ``(setups, K)``: displaced stands, and datums."""
    sigmas = _nuisance_sigmas(factor)
    count, free = len(sigmas), np.isinf(sigmas)
    nuisances = np.zeros_like(sigmas)
    for k in range(sigmas.shape[1] - 1, -1, -1):
        if free[:, k].any():
            nuisances[:, k] = rng.uniform(-_DATUM_RANGE, _DATUM_RANGE, count) * free[:, k]
        if not free[:, k].all():
            scale = np.where(free[:, k], 0.0, sigmas[:, k])
            nuisances[:, k] += rng.normal(scale=scale, size=count)
    return nuisances


def _draw_tool_nuisances(factor: Factor, poses: ReadingPoses, rng: np.random.Generator) -> Array:
    """Return nuisances of instruments at the tool ``(setups, K)``, near their stated poses."""
    sigmas = _nuisance_sigmas(factor)
    nuisances = np.zeros_like(sigmas)
    for k, sigma in enumerate(sigmas):
        visible = poses.nuisance_jacobian[factor.setup == k].any(axis=0) & (sigma > 0)
        nuisances[k, visible] = rng.normal(scale=np.minimum(sigma[visible], _DATUM_RANGE))
    return nuisances


def _nuisance_sigmas(factor: Factor) -> Array:
    """Return standard deviations of the nuisances of all setups ``(setups, K)``, padded by 0."""
    by_setup = [factor.nuisance_sd(k) for k in range(len(factor.readings.setups))]
    sigmas = np.zeros((len(by_setup), max(map(len, by_setup), default=0)))
    for row, setup_sigmas in zip(sigmas, by_setup, strict=True):
        row[: len(setup_sigmas)] = setup_sigmas
    return sigmas


@public
def simulate_tcp(machine: MachineSource, count: int = TCP_POINTS, *, seed: Seed = 0) -> Readings:
    """Return exact TCP points at commands drawn over the workspace, in the middle of any dead band.

    On the Orthoglide that is the whole stroke; elsewhere they lie between points of the workspace.

    Args:
        machine: with its errors as parameters, or the path of its file.
        count: points.
        seed: of all random draws, or where to draw from.

    Raises:
        InputError: for no count of points, or a negative seed.
    """
    machine, count = Machine.of(machine), check_integer("count", count, 1)
    geometry, generator = machine.geometry, _random_generator(seed)
    if geometry.dialled:
        rho = geometry.zero + generator.uniform(*geometry.stroke, (count, 3))
    else:
        places = wanted_points(machine)
        shares = generator.dirichlet(np.full(_MIXED_POINTS, 0.5), count)
        corners = generator.integers(len(places), size=(count, _MIXED_POINTS))
        points = np.einsum("nk,nkx->nx", shares, places[corners])
        rho = commands_of(Spheres.of_geometry(geometry), points)
    rho = np.round(rho, 9)
    with _refusing_absurd_values(machine):
        p = machine.forward(rho)
    return from_points(rho, p, legs=geometry.layout.names)


def varied_conditions(machine: Machine, sheet: Readings) -> set[str]:
    """Return the conditions of effects that a sheet varies, or that the machine file states."""
    time, warming = np.nan_to_num(sheet.time), np.nan_to_num(sheet.temperature_rise)
    columns = {"load": sheet.load, "time": time, "temperature": warming}
    stated = {"approach"} | (set() if machine.spec.screw_pitch is None else {"pitch"})
    return stated | {name for name, values in columns.items() if values.any()}


def invisible_parameters(machine: Machine, sheet: Readings) -> dict[str, str]:
    """Return the parameters of a machine that change no reading of a sheet, each with the reason as
    a clause.
    """
    varied, reasons = varied_conditions(machine, sheet), dict[str, str]()
    for name, value in machine.values.items():
        missing = machine.catalogue.effect_of(name).needs - varied
        columns = [_CONDITION_COLUMNS[n] for n in sorted(missing) if n in _CONDITION_COLUMNS]
        if value and missing:
            reasons[name] = f"the sheet does not vary {' and '.join(columns)}"
        if value and "pitch" in missing:
            reasons[name] = "the machine file gives no screw_pitch_mm"
    return reasons


@contextmanager
def _refusing_absurd_values(machine: Machine) -> Iterator[None]:
    """Name the value in another unit because of which a machine does not close."""
    try:
        yield
    except ClosureError:
        check_magnitudes(machine.spec, machine.values)
        raise


def _random_generator(seed: Seed) -> np.random.Generator:
    if isinstance(seed, np.random.Generator):
        return seed
    return np.random.default_rng(check_integer("seed", seed, 0))
