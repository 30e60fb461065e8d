"""Readings and TCP points of a machine that exists as a model only."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

from orthoglide.accuracy import wanted_points
from orthoglide.errors import ClosureError, InputError, check_whole
from orthoglide.fit.factors import Block
from orthoglide.fit.noise import PUBLISHED_REPEATABILITY, check_noise
from orthoglide.fit.tool import ToolReadings
from orthoglide.fit.tool_noise import expected_sigma
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.perfect_legs import Spheres, commands as commands_of
from orthoglide.observations import Campaign, Readings, TcpPoints, ToolCampaign, protocol
from orthoglide.observations.protocols import Kind

__all__ = ["TCP_POINTS", "lacks", "simulate", "simulate_tcp", "unshown"]

TCP_POINTS = 60
"""Points over the workspace that are enough to judge a calibration by."""

_RECORDS = {"time": "time_s", "temperature": "temperature_C", "load": "load_N",
            "approach": "approach_x, _y and _z"}  # fmt: skip

_ABSURD = 100.0  # tolerances: so large is a value in another unit

Seed = int | np.random.Generator

_BETWEEN = 4  # points of the workspace between which a point is drawn
_DATUM = 1e-3  # metres or radians: where an instrument's zero, or its frame, may lie


@overload
def simulate(
    machine: MachineSource,
    sheet: Campaign | Kind = "standard",
    *,
    noise: float | None = None,
    seed: Seed = 0,
    exact: bool = False,
) -> Campaign: ...


@overload
def simulate(
    machine: MachineSource,
    sheet: ToolCampaign,
    *,
    noise: float | None = None,
    seed: Seed = 0,
    exact: bool = False,
) -> ToolCampaign: ...


def simulate(
    machine: MachineSource,
    sheet: Readings | Kind = "standard",
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
        noise: standard deviation of one reading, metres; the machine file's where absent, else
            the published one.
        seed: of all random draws, or where to draw from.
        exact: no noise, no rounding, dials exactly in place, datums zero.

    Raises:
        InputError: for a noise that is no standard deviation, a negative seed, or an error so large
            that it must be in another unit.
    """
    machine = Machine.of(machine)
    if isinstance(sheet, ToolCampaign):
        return _at_the_tool(machine, sheet, noise, seed, exact)
    if isinstance(sheet, str):
        sheet = protocol(sheet, machine.geometry)
    if not isinstance(sheet, Campaign):
        raise InputError(
            f"a {type(sheet).__name__} is no sheet: give one campaign, readings of the tool, or a "
            f"kind of protocol"
        )
    draw, own = _draws(seed), machine.spec.dial.repeatability
    usual = PUBLISHED_REPEATABILITY if own is None else own
    sd = usual if noise is None else check_noise(noise, 0.0)
    if exact:
        with _closing(machine):
            return sheet.with_readings(np.round(machine.readings(sheet), 15))
    dial, count = machine.spec.dial, len(sheet.setups)
    off = draw.normal(scale=dial.placement, size=count)
    placed = (replace(s, gauge=s.gauge + o) for s, o in zip(sheet.setups, off, strict=True))
    with _closing(machine):
        shown = machine.readings(replace(sheet, setups=tuple(placed)))
    shown = shown + draw.uniform(-_DATUM, _DATUM, count)[sheet.setup]
    shown = shown + draw.normal(scale=sd, size=len(sheet))
    return sheet.with_readings(np.round(_rounded(shown, dial.resolution), 12))


def _at_the_tool(
    machine: Machine, sheet: ToolCampaign, noise: float | None, seed: Seed, exact: bool
) -> ToolCampaign:
    """A sheet of the tool's readings filled in; arguments as of :func:`simulate`."""
    blank = replace(sheet, reading=np.nan_to_num(sheet.reading))
    with _closing(machine):
        factor = ToolReadings.of(blank, machine)
        at = factor.linearise(machine.model, machine.values, ())
    if exact:
        return replace(blank, reading=at.value)
    draw = _draws(seed)
    own = machine.spec.instruments
    level = expected_sigma(sheet, own) if noise is None else check_noise(noise, 0.0)
    shown, block = at.value.copy(), factor.nuisances(at.slopes)
    for k in range(len(sheet.setups)):
        rows = np.flatnonzero(sheet.setup == k)
        shown[rows] = _misplaced(factor, at.slopes, block, k, rows, draw)
    shown = shown + draw.normal(scale=level, size=len(sheet))
    steps = np.array([(own[k].resolution or 0.0) if k in own else 0.0 for k in sheet.kind])
    return replace(blank, reading=np.round(_rounded(shown, steps), 12))


def _misplaced(
    factor: ToolReadings,
    slopes: Array,
    block: Block,
    k: int,
    rows: NDArray[np.intp],
    draw: np.random.Generator,
) -> Array:
    """What an instrument shows ``(m,)`` that stands somewhere near the place its sheet says.

    What its nuisances do not say (a ball that stands elsewhere, a frame that is turned) the
    instrument does; datum, plane and scale are linear.

    Args:
        factor: the sheet's readings.
        slopes: places of the tool and readings of the instrument in place ``(n, 4)``.
        block: what datum, plane and scale draw.
        k: the setup.
        rows: its rows ``(m,)``.
        draw: where to draw from.
    """
    instrument = factor.points.setups[k].instrument
    shown = instrument.displaced(
        slopes[rows, :3], factor.mounting_at(slopes[:, :3]).at(rows), draw, _DATUM
    )
    if shown is not None:
        return shown
    own = block.columns[rows].any(axis=0)
    off = draw.normal(scale=np.minimum(block.sd[own], _DATUM))
    return np.asarray(slopes[rows, 3] + block.columns[np.ix_(rows, own)] @ off)


def simulate_tcp(machine: MachineSource, count: int = TCP_POINTS, *, seed: Seed = 0) -> TcpPoints:
    """Exact TCP points at commands drawn over the workspace, in the middle of any dead band.

    On the Orthoglide that is the whole stroke; elsewhere they lie between points of the workspace.

    Args:
        machine: with its errors as parameters, or the path of its file.
        count: points.
        seed: of all random draws, or where to draw from.

    Raises:
        InputError: for no count of points, or a negative seed.
    """
    machine, count = Machine.of(machine), check_whole("count", count, 1)
    geometry, draw = machine.geometry, _draws(seed)
    if geometry.dialled:
        rho = geometry.zero + draw.uniform(*geometry.stroke, (count, 3))
    else:
        places = wanted_points(machine)
        shares = draw.dirichlet(np.full(_BETWEEN, 0.5), count)
        chosen = draw.integers(len(places), size=(count, _BETWEEN))
        rho = commands_of(Spheres.of(geometry), np.einsum("nk,nkx->nx", shares, places[chosen]))
    rho = np.round(rho, 9)
    with _closing(machine):
        p = machine.forward(rho)
    return TcpPoints(
        command=rho,
        p=p,
        sigma=np.full(count, np.nan),
        approach=np.zeros((count, 3)),
        line=np.arange(2, count + 2),
        legs=geometry.layout.names,
    )


def lacks(needs: Collection[str]) -> str:
    """What is missing where conditions are not there that an effect needs, as a clause."""
    if "pitch" in needs:
        return "the machine file says no screw_pitch_mm"
    columns = [_RECORDS[n] for n in sorted(needs) if n in _RECORDS]
    return f"the sheet does not vary {' and '.join(columns)}"


def unshown(machine: Machine, *sheets: Readings) -> dict[str, str]:
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
            found[name] = lacks(missing)
    return found


@contextmanager
def _closing(machine: Machine) -> Iterator[None]:
    """A machine that does not close for a value in another unit is refused by that value."""
    try:
        yield
    except ClosureError:
        off = {n: abs(v) / machine.tolerance(n) for n, v in machine.values.items()}
        worst = max(off, key=lambda n: off[n], default="")
        if not worst or off[worst] < _ABSURD:
            raise
        unit, value = machine.catalogue.effect_of(worst).unit, machine.values[worst]
        raise InputError(
            f"{worst} = {value / unit.si:g}{unit.behind} is {off[worst]:.0f} times its tolerance "
            f"of {machine.tolerance(worst) / unit.si:g}{unit.behind}, and the machine does not "
            f"close with it: is it meant in another unit?"
        ) from None


def _rounded(shown: Array, steps: Array | float) -> Array:
    return np.where(np.greater(steps, 0), np.round(shown / np.maximum(steps, 1e-12)) * steps, shown)


def _draws(seed: Seed) -> np.random.Generator:
    if isinstance(seed, np.random.Generator):
        return seed
    return np.random.default_rng(check_whole("seed", seed, 0))
