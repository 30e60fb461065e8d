"""Readings and TCP points of a machine that exists as a model only."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

import numpy as np

from orthoglide.accuracy import wanted_points
from orthoglide.errors import ClosureError, InputError, check_integer
from orthoglide.fit.factors import Factor
from orthoglide.fit.noise import check_noise, instrument_of
from orthoglide.geometry import Array
from orthoglide.instruments import InstrumentPose, Setup
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.perfect_legs import Spheres, commands as commands_of
from orthoglide.numerals import compact
from orthoglide.observations import Readings, from_points, protocol, split_legs_and_tool
from orthoglide.observations.protocols import ProtocolName
from orthoglide.prediction import MeasurementModel, ReadingPoses

__all__ = ["TCP_POINTS", "invisible_parameters", "missing_conditions", "simulate", "simulate_tcp"]

TCP_POINTS = 60
"""Points over the workspace that are enough to judge a calibration by."""

_CONDITION_COLUMNS = {"time": "time_s", "temperature": "temperature_C", "load": "load_N",
            "approach": "approach_x, _y and _z"}  # fmt: skip

_ABSURD_TOLERANCES = 100.0  # tolerances: so large is a value in another unit

Seed = int | np.random.Generator

_MIXED_POINTS = 4  # points of the workspace between which a point is drawn
_DATUM_RANGE = 1e-3  # metres or radians: where an instrument's zero, or its frame, may lie


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
    if not isinstance(sheet, Readings):
        raise InputError(
            f"a {type(sheet).__name__} is no sheet: give one campaign, readings of the tool, or a "
            f"kind of protocol"
        )
    draw = _random_generator(seed)
    sd = None if noise is None else check_noise(noise, 0.0)
    filled = [
        _fill_in(machine, part, sd, None if exact else draw) for part in split_legs_and_tool(sheet)
    ]
    if len(filled) == 1:
        return filled[0]
    reading = np.empty(len(sheet))
    reading[sheet.on_legs], reading[~sheet.on_legs] = (one.reading for one in filled)
    return sheet.with_readings(reading)


def _fill_in(
    machine: Machine, sheet: Readings, noise: float | None, draw: np.random.Generator | None
) -> Readings:
    """A sheet of legs or of the tool, filled in; exact where nothing is drawn."""
    with _refusing_absurd_values(machine):
        factor = Factor.from_planned(sheet, machine)
        at = factor.linearise(machine.model, machine.values, ())
        if draw is None:
            return sheet.with_readings(np.round(at.value, 15))
        drawn = (
            _draw_dial_nuisances(factor, draw)
            if factor.on_legs
            else _draw_tool_nuisances(factor, at.reading_poses, draw)
        )
        each = zip(sheet.setups, factor.instrument_poses, drawn, strict=True)
        stands, brought = zip(*(_displaced_stand(*one) for one in each), strict=True)
        placed = MeasurementModel(sheet, stands, factor.normalized_plate_xy, np.stack(brought))
        shown = placed.predict(machine.model, machine.values)
    level, steps = sheet.sigma.copy(), np.zeros(len(sheet))
    for observation, rows in sheet.observations:
        own = instrument_of(machine.spec, observation)
        steps[rows] = own.resolution or 0.0
        usual = observation.repeatability if own.repeatability is None else own.repeatability
        level[rows] = np.where(np.isfinite(level[rows]), level[rows], usual)
    shown = shown + draw.normal(scale=level if noise is None else noise, size=len(sheet))
    return sheet.with_readings(np.round(_rounded(shown, steps), 12))


def _draw_dial_nuisances(factor: Factor, draw: np.random.Generator) -> Array:
    """What dials on legs bring ``(setups, K)``: where they stand, and where their zeros lie."""
    known = _nuisance_sigmas(factor)
    free = np.isinf(known)
    count = len(known)
    found = np.zeros_like(known)
    for k in range(known.shape[1] - 1, -1, -1):
        if free[:, k].any():
            found[:, k] = draw.uniform(-_DATUM_RANGE, _DATUM_RANGE, count) * free[:, k]
        if not free[:, k].all():
            found[:, k] += draw.normal(scale=np.where(free[:, k], 0.0, known[:, k]), size=count)
    return found


def _draw_tool_nuisances(factor: Factor, seen: ReadingPoses, draw: np.random.Generator) -> Array:
    """What instruments at the tool bring ``(setups, K)`` that stand somewhere near the place that
    their sheet says: datum, plane, scale, frame.
    """
    known = _nuisance_sigmas(factor)
    found = np.zeros_like(known)
    for k in range(len(known)):
        own = seen.nuisance_jacobian[factor.setup == k].any(axis=0) & (known[k] > 0)
        found[k, own] = draw.normal(scale=np.minimum(known[k, own], _DATUM_RANGE))
    return found


def _displaced_stand(
    setup: Setup, stand: InstrumentPose, drawn: Array
) -> tuple[InstrumentPose, Array]:
    """Where an instrument stands, and what of its nuisances ``(K,)`` that leaves."""
    count = setup.observation.nuisance_count
    stand, left = setup.observation.apply_pose_nuisances(stand, drawn[:count])
    return stand, np.pad(left, (0, len(drawn) - count))


def _nuisance_sigmas(factor: Factor) -> Array:
    """Standard deviations of the nuisances of all setups ``(setups, K)``; 0 of those that are
    none.
    """
    each = [factor.nuisance_sd(k) for k in range(len(factor.readings.setups))]
    found = np.zeros((len(each), max(map(len, each), default=0)))
    for row, own in zip(found, each, strict=True):
        row[: len(own)] = own
    return found


def simulate_tcp(machine: MachineSource, count: int = TCP_POINTS, *, seed: Seed = 0) -> Readings:
    """Exact TCP points at commands drawn over the workspace, in the middle of any dead band.

    On the Orthoglide that is the whole stroke; elsewhere they lie between points of the workspace.

    Args:
        machine: with its errors as parameters, or the path of its file.
        count: points.
        seed: of all random draws, or where to draw from.

    Raises:
        InputError: for no count of points, or a negative seed.
    """
    machine, count = Machine.of(machine), check_integer("count", count, 1)
    geometry, draw = machine.geometry, _random_generator(seed)
    if geometry.dialled:
        rho = geometry.zero + draw.uniform(*geometry.stroke, (count, 3))
    else:
        places = wanted_points(machine)
        shares = draw.dirichlet(np.full(_MIXED_POINTS, 0.5), count)
        chosen = draw.integers(len(places), size=(count, _MIXED_POINTS))
        rho = commands_of(
            Spheres.of_geometry(geometry), np.einsum("nk,nkx->nx", shares, places[chosen])
        )
    rho = np.round(rho, 9)
    with _refusing_absurd_values(machine):
        p = machine.forward(rho)
    return from_points(rho, p, legs=geometry.layout.names)


def missing_conditions(needs: Collection[str]) -> str:
    """What is missing where conditions are not there that an effect needs, as a clause."""
    if "pitch" in needs:
        return "the machine file says no screw_pitch_mm"
    columns = [_CONDITION_COLUMNS[n] for n in sorted(needs) if n in _CONDITION_COLUMNS]
    return f"the sheet does not vary {' and '.join(columns)}"


def invisible_parameters(machine: Machine, *sheets: Readings) -> dict[str, str]:
    """Parameters of a machine that change no reading of sheets, each with what is missing."""
    given = {"approach"}
    given |= set() if machine.spec.screw_pitch is None else {"pitch"}
    for sheet in sheets:
        given |= {"load"} if sheet.load.any() else set()
        given |= {"time"} if np.nan_to_num(sheet.time).any() else set()
        given |= {"temperature"} if np.nan_to_num(sheet.temperature_rise).any() else set()
    of, found = machine.catalogue.effect_of, dict[str, str]()
    for name, value in machine.values.items():
        missing = of(name).needs - given
        if value and missing:
            found[name] = missing_conditions(missing)
    return found


@contextmanager
def _refusing_absurd_values(machine: Machine) -> Iterator[None]:
    """A machine that does not close for a value in another unit is refused by that value."""
    try:
        yield
    except ClosureError:
        off = {n: abs(v) / machine.tolerance(n) for n, v in machine.values.items()}
        worst = max(off, key=lambda n: off[n], default="")
        if not worst or off[worst] < _ABSURD_TOLERANCES:
            raise
        unit, value = machine.catalogue.effect_of(worst).unit, machine.values[worst]
        raise InputError(
            f"{worst} = {compact(value / unit.si, 6)}{unit.behind} is {off[worst]:.0f} times its "
            f"tolerance of {machine.tolerance(worst) / unit.si:g}{unit.behind}, and the machine "
            f"does not close with it: is it meant in another unit?"
        ) from None


def _rounded(shown: Array, steps: Array | float) -> Array:
    return np.where(np.greater(steps, 0), np.round(shown / np.maximum(steps, 1e-12)) * steps, shown)


def _random_generator(seed: Seed) -> np.random.Generator:
    if isinstance(seed, np.random.Generator):
        return seed
    return np.random.default_rng(check_integer("seed", seed, 0))
