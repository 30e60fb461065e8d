"""Readings that can be taken: the pool of dials, and sheets of instruments."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np

from orthoglide import reduction
from orthoglide.arguments import public
from orthoglide.errors import UnreachableError, check_choice, check_list
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.instruments import OBSERVATIONS, Observation
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Moves, Readings, Setup, protocol
from orthoglide.observations.approach import stroke_overshoot
from orthoglide.observations.checks import DECIMALS
from orthoglide.observations.protocols import dial_setup, require_dial_layout
from orthoglide.observations.tables import renumbered
from orthoglide.threads import on_one_thread

DIAL_TRAVEL = 5e-3
"""Metres that the touched line may move sideways at the dial; see :func:`dial_scale`."""

_GAUGES = (0.25, 0.35, 0.5, 0.65, 0.75)  # places of dials: fractions of the leg from the platform
_STEPS_UP, _STEPS_DOWN = 3, 4  # of the upper and the lower half stroke
_OFF_AXIS = 6e-3  # metres off the axis
_CLEARANCE = 5e-3  # metres that a dial keeps from either end of the leg
_COMMAND_DECIMALS = 9  # decimals of a metre that fit on a sheet
_RING_POINTS = 12  # places on a circle: the lobes of a plate's shapes of three and four come out
_HALVINGS = 12  # of the workspace's size: to a few thousandths of it
_PLACE_DECIMALS = 4  # decimals of a metre: places that people can type


def dial_scale(geometry: Geometry) -> float:
    """Return the relative size of a dial with its stand, at most that in a workshop."""
    return min(geometry.scale, 1.0)


def reading_pool(geometry: Geometry, *, load: float = 0.0) -> Readings:
    """Return every reading that can be chosen, under a load in newtons, as a campaign without
    readings: a setup for every leg, direction, place and bar, one row a station at which the dial
    stays on its leg and within its travel.
    """
    require_dial_layout(geometry)
    setups: list[Setup] = []
    rows: list[tuple[int, str, Array, float]] = []
    scale = dial_scale(geometry)
    for leg in range(3):
        labels, command, p, approach = _stations(leg, geometry)
        axes = map(LEGS.index, geometry.layout.names.across[leg])
        for axis, gauge, bar in product(axes, _GAUGES, (0, 1, 2)):  # 0: the leg's median line
            setup = dial_setup(geometry, leg, axis, gauge, bar)
            carriage, platform = command[:, leg], p[:, leg]
            clearance = _CLEARANCE * scale
            on_leg = (platform + clearance <= setup.gauge) & (setup.gauge <= carriage - clearance)
            # The touched point moves by this share of the platform's motion.
            share = (carriage - setup.gauge) / (carriage - platform)
            sideways = np.abs(np.delete(p, leg, axis=1)).max(axis=1) * share
            visible = np.flatnonzero(on_leg & (sideways <= DIAL_TRAVEL * scale))
            rows += [(len(setups), labels[k], command[k], approach[k]) for k in visible]
            setups.append(replace(setup, name=f"next-{setup.name}"))
    setup_rows, posture, commands, sides = zip(*rows, strict=True)
    return Readings(
        "next", tuple(setups), np.array(setup_rows), np.array(commands),
        np.full(len(posture), np.nan), np.repeat(np.array(sides)[:, None], 3, axis=1),
        load=np.array(load), posture=posture,
        moves=Moves(overshoot=stroke_overshoot(geometry.stroke)),
    )  # fmt: skip


def _stations(leg: int, geometry: Geometry) -> tuple[list[str], Array, Array, Array]:
    """Return labels, commands ``(n, 3)``, nominal TCP ``(n, 3)`` and approaches ``(n,)`` of all
    axes, at which a leg's dials can be read, within the stroke with the approaches.

    On the leg's own axis: steps of the stroke, reached with all axes moving in + and in -. Off it:
    6 mm to either side, at mechanical zero and in the middle of both half strokes, reached in +.
    """
    low, high = geometry.stroke
    down = low * np.arange(_STEPS_DOWN, 0, -1) / _STEPS_DOWN
    travels = [*down, *(high * np.arange(_STEPS_UP + 1) / _STEPS_UP)]
    # Label, places along the axes, and the direction from which it is reached.
    planned: list[tuple[str, dict[int, float], int]] = [
        (f"{travel * 1e3:+.6g}", {leg: travel}, side) for travel in travels for side in (1, -1)
    ]
    offset, others = _OFF_AXIS * dial_scale(geometry), [axis for axis in range(3) if axis != leg]
    for travel, axis, side in product((low / 2, 0.0, high / 2), others, (1, -1)):
        label = f"{travel * 1e3:+.6g} {LEGS[axis]}{side * offset * 1e3:+.6g}"
        planned.append((label, {leg: travel, axis: side * offset}, 1))
    p = np.array([[point.get(axis, 0.0) for axis in range(3)] for _, point, _ in planned])
    approach = np.array([float(side) for *_, side in planned])
    rho = np.round(reduction.inverse(p, geometry=geometry), _COMMAND_DECIMALS)
    before = rho - approach[:, None] * stroke_overshoot(geometry.stroke)
    in_stroke = geometry.in_stroke(np.stack([rho, before], axis=1)).all(axis=(1, 2))
    reachable = np.flatnonzero(in_stroke)
    labels = [planned[k][0] for k in reachable]
    return labels, rho[reachable], p[reachable], approach[reachable]


def sheet_from_pool(pool: Readings, chosen: Sequence[int], name: str = "next") -> Readings:
    """Return chosen rows of a pool, with repetitions where a station is visited again, mounting by
    mounting, visits numbered, with their moves.
    """
    rows = np.array(sorted(chosen, key=lambda k: (pool.setup[k], k)), dtype=np.int64)
    repeat = np.array([int(np.sum(rows[:i] == k)) + 1 for i, k in enumerate(rows)], dtype=np.int64)
    # All stations once, then again: successive repeats would hide creep of the stand.
    order = np.lexsort([rows, repeat, pool.setup[rows]])
    return replace(pool.subset(rows[order]), name=name, repeat=repeat[order]).with_moves()


# -- sheets of instruments -------------------------------------------------------------------------


def sheets_by_kind(machine: Machine, kinds: Sequence[str]) -> dict[str, Readings]:
    """Return the sheets of instruments by kind, ``leg``, ``tcp``, ``plate`` ..., those at the tool
    in one sequence.

    Raises:
        InputError: for an unknown kind, or one that this machine does not take.
    """
    check_list("kinds", kinds)
    for kind in kinds:
        check_choice("instrument", kind, OBSERVATIONS)
    sheets = {kind: instrument_sheet(machine, kind) for kind in dict.fromkeys(kinds)}
    of_tool = renumbered([sheet for sheet in sheets.values() if sheet.of_tool], "order")
    return sheets | {sheet.name: sheet for sheet in of_tool}


@public
@on_one_thread
def tool_sheets(machine: MachineSource, kinds: Sequence[str]) -> list[Readings]:
    """Return sheets of instruments at the tool to be filled in, one after the other.

    Args:
        machine: as it is believed to be.
        kinds: of readings that can be taken: ``tcp``, ``plate``, ``distance`` ...; those of dials
            on legs are left out, as :func:`protocol` has sheets for them.

    Raises:
        InputError: as of ``sheets_by_kind``.
    """
    sheets = sheets_by_kind(Machine.of(machine), kinds).values()
    return [sheet for sheet in sheets if sheet.of_tool]


def instrument_sheet(machine: Machine, kind: str, extra_length: float = 0.0) -> Readings:
    """Return the readings that an instrument would take of a machine, without their values.

    With an ``extra_length`` of the tool, metres, the platform stays higher by as much.

    Raises:
        InputError: where dials cannot be set against the machine's legs.
    """
    instrument = OBSERVATIONS[kind]
    if instrument.on_leg:
        return protocol(instrument.protocol, machine.geometry)
    up = np.array([0.0, 0.0, extra_length])
    points, other_ends = _instrument_points(machine, instrument, up)
    axes = np.array(instrument.axes or (0,))
    n = len(points) * len(axes)
    command = np.repeat(_controller_commands(machine, points + up), len(axes), axis=0)
    second = np.full((n, 3), np.nan)
    if other_ends is not None:
        second = _controller_commands(machine, other_ends + up)
    labels = (" ".join(f"{v * 1e3 + 0.0:.0f}" for v in p) for p in points)
    return Readings(
        name=kind,
        setups=(Setup(kind, kind=kind, beside=(0.0, 0.0, -extra_length)),),
        setup=np.zeros(n, dtype=np.int64),
        command=command,
        reading=np.full(n, np.nan),
        axis=np.tile(axes, len(points)),
        second=second,
        posture=tuple(label for label in labels for _ in axes),
        legs=machine.geometry.layout.names,
        moves=Moves(overshoot=stroke_overshoot(machine.geometry.stroke)),
    ).in_order()


def _instrument_points(
    machine: Machine, instrument: Observation, up: Array
) -> tuple[Array, Array | None]:
    """Return points and, of pairs, other ends ``(n, 3)`` within reach ``up`` above."""
    angle, centre = np.arange(_RING_POINTS) * 2 * np.pi / _RING_POINTS, np.zeros(3)
    outline = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points, other_ends = instrument.sheet_points(outline)
    if points[:, 2].any():
        if machine.geometry.layout.hanging:
            centre = np.array([0.0, 0.0, 1.0])
        outline = points + centre
    # Nine tenths of the largest size at which all points are within reach.
    perfect, low, high = machine.with_only({}), 0.0, machine.geometry.L
    for _ in range(_HALVINGS):
        middle, fits = (low + high) / 2, False
        with suppress(UnreachableError):
            commands = perfect.inverse(middle * outline + up)
            fits = bool(machine.geometry.in_stroke(commands).all())
        low, high = (middle, high) if fits else (low, middle)
    size = 0.9 * low
    if other_ends is not None:
        other_ends = np.round(size * other_ends, _PLACE_DECIMALS)
    return np.round(size * (points + centre), _PLACE_DECIMALS) + 0.0, other_ends


def _controller_commands(machine: Machine, p: Array) -> Array:
    """Return commands ``(n, 3)`` by which the controller sends the tool to places ``(n, 3)``.

    They are rounded as in files, so that a second visit to a place is a repeat.
    """
    kinematics = machine.spec.kinematics
    commands = machine.with_only({}).inverse(p) if kinematics is None else kinematics.travel(p)
    return np.asarray(np.round(commands, DECIMALS))
