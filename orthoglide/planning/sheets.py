"""Measuring sheets of instruments, and the choice of the best few readings of several sheets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from orthoglide.errors import InputError, UnreachableError, check_choice, check_list
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

_DATUM_PRECISION = 1e-6  # precision of a datum, in readings: nearly unknown

MIN_READINGS = 6
"""Readings that are worth choosing: a plate's own height and slopes take three."""

_RING_POINTS = 12  # places on a circle: the lobes of a plate's shapes of three and four come out
_HALVINGS = 12  # of the workspace's size: to a few thousandths of it
_PLACE_DECIMALS = 4  # decimals of a metre: places that people can type


def sheets_by_kind(
    machine: Machine, kinds: Sequence[str], count: int | None = None
) -> dict[str, Readings]:
    """Return the sheets of instruments by kind, those at the tool in one sequence.

    Args:
        machine: as it is believed to be; its instruments say how well they read.
        kinds: of readings that can be taken: ``leg``, ``tcp``, ``plate`` ...
        count: readings of the tool to choose among all of these; all where absent.

    Raises:
        InputError: for a kind that there is not, or that this machine does not take; for a count
            that cannot be chosen.
    """
    check_list("kinds", kinds)
    for kind in kinds:
        check_choice("instrument", kind, OBSERVATIONS)
    sheets = {kind: instrument_sheet(machine, kind) for kind in dict.fromkeys(kinds)}
    of_tool = [sheet for sheet in sheets.values() if sheet.of_tool]
    if count is not None:
        of_tool = choose_from_sheets(machine, of_tool, count)
    in_sequence = {sheet.name: sheet for sheet in renumber_orders(of_tool)}
    return {
        k: in_sequence.get(k, s) for k, s in sheets.items() if k in in_sequence or not s.of_tool
    }


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
    sheets = sheets_by_kind(Machine.of(machine), kinds, count).values()
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


def choose_from_sheets(machine: Machine, sheets: Sequence[Readings], count: int) -> list[Readings]:
    """Return the ``count`` readings, of sheets of one instrument each, that determine all
    parameters of a machine best.

    The reading whose loss lowers the determinant of the information least is dropped, again and
    again. The information is on all parameters in their tolerances, with the nuisances of the
    setups (a plate's height and slopes, an instrument's frame) fitted besides.

    Returns:
        The readings kept of each sheet; sheets without any are left out.

    Raises:
        InputError: for too few readings.
    """
    available = sum(map(len, sheets))
    if not MIN_READINGS <= count <= available:
        raise InputError(
            f"there are {available} readings of the tool to choose from: ask for {MIN_READINGS} to "
            f"{available}, not {count}"
        )
    rows, parameters, prior = whitened_rows(machine, sheets)
    information = np.diag(prior) + rows.T @ rows
    precision = CombinationPrecision(information, np.eye(rows.shape[1])[:, :parameters])
    remaining = np.arange(available)
    while len(remaining) > count:
        ones = np.ones(len(remaining))
        removals = Steps(np.column_stack([-ones, remaining]), rows[remaining], -ones)
        cheapest = largest(precision.gains(removals), RELATIVE_MARGIN)
        precision = precision.with_step(removals, cheapest)
        remaining = np.delete(remaining, cheapest)
    ends = np.cumsum([len(sheet) for sheet in sheets])
    rows_by_sheet = np.split(remaining, np.searchsorted(remaining, ends[:-1]))
    return [
        sheet.subset(rows - end + len(sheet)).in_order()
        for sheet, end, rows in zip(sheets, ends, rows_by_sheet, strict=True)
        if len(rows)
    ]


def whitened_rows(machine: Machine, sheets: Sequence[Readings]) -> tuple[Array, int, Array]:
    """Return whitened rows ``(n, P + k)`` by parameters in tolerances and by datums, the number
    ``P`` of parameters, and the prior precision of each column.
    """
    estimate = solve(predicted_problem(machine, sheets), method="nested")
    problem = estimate.problem
    full = with_effects_freed(problem, [effect.name for effect in excited_effects(problem)])
    nuisance = estimate.nuisance
    weight = nuisance.weighing.weight[:, None]
    jacobian = linearise(full, full.zero_padded(estimate.x)).jacobian
    columns, datums = jacobian * full.tolerance * weight, nuisance.columns * weight
    size = np.linalg.norm(datums, axis=0)
    size[size == 0] = 1.0
    precision = np.maximum(nuisance.precision / size**2, _DATUM_PRECISION)
    prior = np.concatenate([np.ones(columns.shape[1]), precision])
    return np.hstack([columns, datums / size]), columns.shape[1], prior
