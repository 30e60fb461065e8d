"""Measuring sheets of instruments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from orthoglide.arguments import public
from orthoglide.errors import UnreachableError, check_choice, check_list
from orthoglide.geometry import Array
from orthoglide.instruments import OBSERVATIONS, Observation
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, Setup, protocol, renumbered
from orthoglide.observations.approach import Moves, stroke_overshoot
from orthoglide.observations.checks import DECIMALS
from orthoglide.threads import on_one_thread

_RING_POINTS = 12  # places on a circle: the lobes of a plate's shapes of three and four come out
_HALVINGS = 12  # of the workspace's size: to a few thousandths of it
_PLACE_DECIMALS = 4  # decimals of a metre: places that people can type


def sheets_by_kind(machine: Machine, kinds: Sequence[str]) -> dict[str, Readings]:
    """Return the sheets of instruments by kind, those at the tool in one sequence.

    Args:
        machine: as it is believed to be.
        kinds: of readings that can be taken: ``leg``, ``tcp``, ``plate`` ...

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

    Args:
        machine: as it is believed to be.
        kind: of the readings.
        extra_length: by which the tool is longer than the machine's, metres; the platform stays
            higher by as much.

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
    size = _largest_size(machine, lambda r: r * outline + up)
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


def _largest_size(machine: Machine, points: Callable[[float], Array]) -> float:
    """Return nine tenths of the largest size at which all points are within reach, metres."""
    low, high = 0.0, machine.geometry.L
    for _ in range(_HALVINGS):
        size, fits = (low + high) / 2, False
        with suppress(UnreachableError):
            commands = machine.with_only({}).inverse(points(size))
            fits = bool(machine.geometry.in_stroke(commands).all())
        low, high = (size, high) if fits else (low, size)
    return 0.9 * low
