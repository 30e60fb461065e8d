"""Measuring sheets of instruments: the readings that each would take of a machine, and the few of
several sheets that together tell most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from orthoglide.errors import InputError, UnreachableError, check_word
from orthoglide.fit import excited_effects, linearise, solve, with_others
from orthoglide.geometry import Array
from orthoglide.instruments import OBSERVATIONS, Observation
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, Setup, in_sequence, protocol
from orthoglide.observations.approach import Moves, overshoot
from orthoglide.observations.checks import DECIMALS
from orthoglide.ordering import EQUAL, largest
from orthoglide.planning.choosing import Narrowing
from orthoglide.planning.linear import Steps, foreseen
from orthoglide.threads import on_one_thread

KINDS = tuple(sorted(OBSERVATIONS, key=lambda kind: not OBSERVATIONS[kind].on_leg))
"""Kinds of readings, those of dials on legs first."""

TAKEN_BY = {kind: OBSERVATIONS[kind].words for kind in KINDS}
"""Kinds of readings, and what takes them."""

_LOOSE = 1e-6  # precision of a datum, in readings: one of which nothing is known

LEAST = 6
"""Readings that are worth choosing: a plate's own height and slopes take three."""

_AROUND = 12  # places on a circle: the lobes of a plate's shapes of three and four come out
_HALVINGS = 12  # of the workspace's size: to a few thousandths of it
_PLACED = 4  # decimals of a metre: places that people can type


def sheets_of(
    machine: Machine, kinds: Sequence[str], count: int | None = None
) -> dict[str, Readings]:
    """Return the readings that instruments would take of a machine, by kind, a sheet each.

    Args:
        machine: as it is believed to be; its instruments say how well they read.
        kinds: of readings that can be taken: ``leg``, ``tcp``, ``plate`` ...
        count: readings of the tool to choose among all of these; all where absent.

    Raises:
        InputError: for a kind that there is not, or that this machine does not take; for a count
            that cannot be chosen.
    """
    for kind in kinds:
        check_word("instrument", kind, KINDS)
    sheets = {kind: sheet_of(machine, kind) for kind in dict.fromkeys(kinds)}
    if count is None:
        return sheets
    of_tool = [sheet for sheet in sheets.values() if sheet.of_tool]
    chosen = {sheet.name: sheet for sheet in mixed_sheet(machine, of_tool, count)}
    return {k: chosen.get(k, s) for k, s in sheets.items() if k in chosen or not s.of_tool}


@on_one_thread
def tool_sheets(
    machine: MachineSource, kinds: Sequence[str], count: int | None = None
) -> list[Readings]:
    """Return sheets of instruments at the tool to be filled in, one after the other.

    Args:
        machine: as it is believed to be; its instruments say how well they read.
        kinds: of readings that can be taken: ``tcp``, ``plate``, ``distance`` ...; those of dials
            on legs are left out, as :func:`protocol` has sheets for them.
        count: readings that together tell most; all where absent.

    Raises:
        InputError: as of ``sheets_of``.
    """
    return to_fill_in(sheets_of(Machine.of(machine), kinds, count).values())


def to_fill_in(sheets: Iterable[Readings]) -> list[Readings]:
    """Return the sheets of instruments at the tool without their readings, in one sequence."""
    of_tool = [sheet for sheet in sheets if sheet.of_tool]
    return in_sequence([replace(s, reading=np.full(len(s), np.nan)) for s in of_tool])


def sheet_of(machine: Machine, kind: str) -> Readings:
    """Return the readings that an instrument would take of a machine.

    Raises:
        InputError: where dials cannot be set against the machine's legs.
    """
    instrument = OBSERVATIONS[kind]
    if instrument.on_leg:
        return protocol(instrument.protocol, machine.geometry)
    return tool_sheet(machine, instrument)


def tool_sheet(machine: Machine, instrument: Observation, longer: float = 0.0) -> Readings:
    """Return the readings that an instrument at the tool would take of a machine.

    Args:
        machine: as it is believed to be.
        instrument: that reads.
        longer: by how much the tool is than the machine's, metres; the platform stays so much
            higher.
    """
    up = np.array([0.0, 0.0, longer])
    points, others, ball = _places(machine, instrument, up)
    axes = np.array(instrument.axes or (0,))
    n = len(points) * len(axes)
    command = np.repeat(_sent(machine, points + up), len(axes), axis=0)
    second = np.full((n, 3), np.nan) if others is None else _sent(machine, others + up)
    reading = np.full(n, np.nan)
    if instrument.about_ball:  # where the ball stands is said by its distance
        reading = np.linalg.norm(points - ball, axis=1)
    labels = (" ".join(f"{v * 1e3 + 0.0:.0f}" for v in p) for p in points)
    return Readings(
        name=instrument.kind,
        setups=(Setup(instrument.kind, kind=instrument.kind, beside=(0.0, 0.0, -longer)),),
        setup=np.zeros(n, dtype=np.int64),
        command=command,
        reading=reading,
        axis=np.tile(axes, len(points)),
        second=second,
        posture=tuple(label for label in labels for _ in axes),
        legs=machine.geometry.layout.names,
        moves=Moves(beyond=overshoot(machine.geometry.stroke)),
    ).in_order()


def _places(
    machine: Machine, instrument: Observation, up: Array
) -> tuple[Array, Array | None, Array]:
    """Return points ``(n, 3)``, the other ends of distances, and the centre of a ball; the tool of
    the machine must reach ``up`` above each.
    """
    t, high = np.arange(_AROUND) * 2 * np.pi / _AROUND, np.zeros(3)
    ring = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    points, others = instrument.places(ring)
    outline = ring
    if points[:, 2].any():
        high = np.array([0.0, 0.0, 1.0]) if machine.geometry.layout.hanging else high
        outline = points + high
    size = _widest(machine, lambda r: r * outline + up)
    ball, others = size * high, None if others is None else np.round(size * others, _PLACED)
    return np.round(size * (points + high), _PLACED) + 0.0, others, ball


def _sent(machine: Machine, p: Array) -> Array:
    """Return commands ``(n, 3)`` by which the controller sends the tool to places ``(n, 3)``.

    They are rounded as in files, so that a second visit to a place is a repeat.
    """
    kinematics = machine.spec.kinematics
    found = machine.with_only({}).inverse(p) if kinematics is None else kinematics.travel(p)
    return np.asarray(np.round(found, DECIMALS))


def _widest(machine: Machine, points: Callable[[float], Array]) -> float:
    """Return nine tenths of the largest size at which all points are within reach, metres."""
    low, high = 0.0, machine.geometry.L
    for _ in range(_HALVINGS):
        size, fits = (low + high) / 2, False
        with suppress(UnreachableError):
            commands = machine.with_only({}).inverse(points(size))
            fits = bool(machine.geometry.in_stroke(commands).all())
        low, high = (size, high) if fits else (low, size)
    return 0.9 * low


def mixed_sheet(machine: Machine, sheets: Sequence[Readings], count: int) -> tuple[Readings, ...]:
    """Return the ``count`` readings, of sheets of one instrument each, that together tell most of
    everything that could be wrong with a machine.

    From all of them the one is dropped, again and again, without which the determinant of the
    information falls least: of all parameters in their tolerances, what belongs to the setups
    (a plate's height and slopes, an instrument's frame) fitted besides.

    Returns:
        What is kept of each sheet; sheets of which nothing is are left out.

    Raises:
        InputError: for too few readings.
    """
    most = sum(map(len, sheets))
    if not LEAST <= count <= most:
        raise InputError(
            f"there are {most} readings of the tool to choose from: ask for {LEAST} to {most}, not "
            f"{count}"
        )
    rows, parameters, prior = whitened(machine, sheets)
    known = Narrowing(np.diag(prior) + rows.T @ rows, np.eye(rows.shape[1])[:, :parameters])
    kept = np.arange(most)
    while len(kept) > count:
        gone = Steps(np.column_stack([-np.ones(len(kept)), kept]), rows[kept], -np.ones(len(kept)))
        least = largest(known.gains(gone), EQUAL)
        known = known.after(gone, least)
        kept = np.delete(kept, least)
    owner = np.repeat(np.arange(len(sheets)), [len(s) for s in sheets])
    first = np.cumsum([0, *(len(s) for s in sheets)])
    chosen = [kept[owner[kept] == k] - first[k] for k in range(len(sheets))]
    return tuple(s.subset(at).in_order() for s, at in zip(sheets, chosen, strict=True) if len(at))


def whitened(machine: Machine, sheets: Sequence[Readings]) -> tuple[Array, int, Array]:
    """Return rows ``(n, P + k)`` by parameters in tolerances and by datums, ``P``, and precisions
    before any reading.
    """
    estimate = solve(foreseen(machine, sheets), method="nested")
    problem = estimate.problem
    wide = with_others(problem, [effect.name for effect in excited_effects(problem)])
    nuisance = estimate.nuisance
    weight = nuisance.weighing.weight[:, None]
    columns = linearise(wide, wide.padded(estimate.x)).jacobian * wide.tolerance * weight
    datums = nuisance.columns * weight
    size = np.linalg.norm(datums, axis=0)
    size[size == 0] = 1.0
    known = nuisance.precision / size**2
    prior = np.concatenate([np.ones(columns.shape[1]), np.maximum(known, _LOOSE)])
    return np.hstack([columns, datums / size]), columns.shape[1], prior
