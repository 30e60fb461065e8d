"""Measuring sheets of instruments: the readings that each would take of a machine, and the few of
several sheets that together tell most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from orthoglide.errors import InputError, UnreachableError, check_choice
from orthoglide.fit import excited_effects, linearise, solve, with_effects_freed
from orthoglide.geometry import Array
from orthoglide.instruments import OBSERVATIONS, Observation
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, Setup, protocol, renumber_orders
from orthoglide.observations.approach import Moves, stroke_overshoot
from orthoglide.observations.checks import DECIMALS
from orthoglide.ordering import RELATIVE_MARGIN, largest
from orthoglide.planning.choosing import CombinationPrecision
from orthoglide.planning.linear import Steps, predicted_problem
from orthoglide.threads import on_one_thread

KINDS = tuple(sorted(OBSERVATIONS, key=lambda kind: not OBSERVATIONS[kind].on_leg))
"""Kinds of readings, those of dials on legs first."""

INSTRUMENT_WORDS = {kind: OBSERVATIONS[kind].instrument_phrase for kind in KINDS}
"""Kinds of readings, and what takes them."""

_DATUM_PRECISION = 1e-6  # precision of a datum, in readings: one of which nothing is known

MIN_READINGS = 6
"""Readings that are worth choosing: a plate's own height and slopes take three."""

_RING_POINTS = 12  # places on a circle: the lobes of a plate's shapes of three and four come out
_HALVINGS = 12  # of the workspace's size: to a few thousandths of it
_PLACE_DECIMALS = 4  # decimals of a metre: places that people can type


def sheets_by_kind(
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
        check_choice("instrument", kind, KINDS)
    sheets = {kind: instrument_sheet(machine, kind) for kind in dict.fromkeys(kinds)}
    if count is None:
        return sheets
    of_tool = [sheet for sheet in sheets.values() if sheet.of_tool]
    chosen = {sheet.name: sheet for sheet in choose_from_sheets(machine, of_tool, count)}
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
        InputError: as of ``sheets_by_kind``.
    """
    return blank_tool_sheets(sheets_by_kind(Machine.of(machine), kinds, count).values())


def blank_tool_sheets(sheets: Iterable[Readings]) -> list[Readings]:
    """Return the sheets of instruments at the tool without their readings, in one sequence."""
    of_tool = [sheet for sheet in sheets if sheet.of_tool]
    return renumber_orders([replace(s, reading=np.full(len(s), np.nan)) for s in of_tool])


def instrument_sheet(machine: Machine, kind: str) -> Readings:
    """Return the readings that an instrument would take of a machine.

    Raises:
        InputError: where dials cannot be set against the machine's legs.
    """
    instrument = OBSERVATIONS[kind]
    if instrument.on_leg:
        return protocol(instrument.protocol, machine.geometry)
    return tool_sheet(machine, instrument)


def tool_sheet(machine: Machine, instrument: Observation, extra_length: float = 0.0) -> Readings:
    """Return the readings that an instrument at the tool would take of a machine.

    Args:
        machine: as it is believed to be.
        instrument: that reads.
        extra_length: by how much the tool is than the machine's, metres; the platform stays so much
            higher.
    """
    up = np.array([0.0, 0.0, extra_length])
    points, others, ball = _instrument_points(machine, instrument, up)
    axes = np.array(instrument.axes or (0,))
    n = len(points) * len(axes)
    command = np.repeat(_controller_commands(machine, points + up), len(axes), axis=0)
    second = (
        np.full((n, 3), np.nan) if others is None else _controller_commands(machine, others + up)
    )
    reading = np.full(n, np.nan)
    if instrument.about_ball:  # where the ball stands is said by its distance
        reading = np.linalg.norm(points - ball, axis=1)
    labels = (" ".join(f"{v * 1e3 + 0.0:.0f}" for v in p) for p in points)
    return Readings(
        name=instrument.kind,
        setups=(Setup(instrument.kind, kind=instrument.kind, beside=(0.0, 0.0, -extra_length)),),
        setup=np.zeros(n, dtype=np.int64),
        command=command,
        reading=reading,
        axis=np.tile(axes, len(points)),
        second=second,
        posture=tuple(label for label in labels for _ in axes),
        legs=machine.geometry.layout.names,
        moves=Moves(overshoot=stroke_overshoot(machine.geometry.stroke)),
    ).in_order()


def _instrument_points(
    machine: Machine, instrument: Observation, up: Array
) -> tuple[Array, Array | None, Array]:
    """Return points ``(n, 3)``, the other ends of distances, and the centre of a ball; the tool of
    the machine must reach ``up`` above each.
    """
    t, high = np.arange(_RING_POINTS) * 2 * np.pi / _RING_POINTS, np.zeros(3)
    ring = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    points, others = instrument.places(ring)
    outline = ring
    if points[:, 2].any():
        high = np.array([0.0, 0.0, 1.0]) if machine.geometry.layout.hanging else high
        outline = points + high
    size = _largest_size(machine, lambda r: r * outline + up)
    ball, others = size * high, None if others is None else np.round(size * others, _PLACE_DECIMALS)
    return np.round(size * (points + high), _PLACE_DECIMALS) + 0.0, others, ball


def _controller_commands(machine: Machine, p: Array) -> Array:
    """Return commands ``(n, 3)`` by which the controller sends the tool to places ``(n, 3)``.

    They are rounded as in files, so that a second visit to a place is a repeat.
    """
    kinematics = machine.spec.kinematics
    found = machine.with_only({}).inverse(p) if kinematics is None else kinematics.travel(p)
    return np.asarray(np.round(found, DECIMALS))


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


def choose_from_sheets(
    machine: Machine, sheets: Sequence[Readings], count: int
) -> tuple[Readings, ...]:
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
    if not MIN_READINGS <= count <= most:
        raise InputError(
            f"there are {most} readings of the tool to choose from: ask for {MIN_READINGS} to {most}, not "
            f"{count}"
        )
    rows, parameters, prior = whitened_rows(machine, sheets)
    known = CombinationPrecision(
        np.diag(prior) + rows.T @ rows, np.eye(rows.shape[1])[:, :parameters]
    )
    kept = np.arange(most)
    while len(kept) > count:
        gone = Steps(np.column_stack([-np.ones(len(kept)), kept]), rows[kept], -np.ones(len(kept)))
        least = largest(known.gains(gone), RELATIVE_MARGIN)
        known = known.with_step(gone, least)
        kept = np.delete(kept, least)
    owner = np.repeat(np.arange(len(sheets)), [len(s) for s in sheets])
    first = np.cumsum([0, *(len(s) for s in sheets)])
    chosen = [kept[owner[kept] == k] - first[k] for k in range(len(sheets))]
    return tuple(s.subset(at).in_order() for s, at in zip(sheets, chosen, strict=True) if len(at))


def whitened_rows(machine: Machine, sheets: Sequence[Readings]) -> tuple[Array, int, Array]:
    """Return rows ``(n, P + k)`` by parameters in tolerances and by datums, ``P``, and precisions
    before any reading.
    """
    estimate = solve(predicted_problem(machine, sheets), method="nested")
    problem = estimate.problem
    wide = with_effects_freed(problem, [effect.name for effect in excited_effects(problem)])
    nuisance = estimate.nuisance
    weight = nuisance.weighing.weight[:, None]
    columns = linearise(wide, wide.zero_padded(estimate.x)).jacobian * wide.tolerance * weight
    datums = nuisance.columns * weight
    size = np.linalg.norm(datums, axis=0)
    size[size == 0] = 1.0
    known = nuisance.precision / size**2
    prior = np.concatenate([np.ones(columns.shape[1]), np.maximum(known, _DATUM_PRECISION)])
    return np.hstack([columns, datums / size]), columns.shape[1], prior
