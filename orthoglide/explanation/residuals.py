"""The residual of a fit by setup: its size, and the stations where it is largest."""

from __future__ import annotations

import numpy as np

from orthoglide.fit import Estimate
from orthoglide.geometry import LEGS, Array
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import Readings
from orthoglide.observations.approach import Ints
from orthoglide.ordering import descending, ranked
from orthoglide.result import SetupResidual

_MOST_STATIONS = 3  # stations with the largest residuals
_CLEAR_RATIO = 1.05  # least ratio of the largest residual to the next, for its posture to be named
_ROUNDING = 1e-6  # root mean square of a residual that is rounding, in sigmas


def residual_by_setup(estimate: Estimate) -> tuple[SetupResidual, ...]:
    """Return the residual of each setup of a dial and each axis of an instrument at the tool.

    The largest share of chi2 comes first. TCP points have no setup.
    """
    problem, found = estimate.problem, list[SetupResidual]()
    squares = problem.weighing.whiten(estimate.residuals) ** 2
    total = float(squares.sum())
    # The residual of readings without noise is rounding, which has no location.
    residuals = estimate.residuals * (total > len(squares) * _ROUNDING**2)
    squares = squares / total if residuals.any() else np.zeros_like(squares)
    for factor, rows in zip(problem.factors, problem.factor_rows, strict=True):
        if (readings := factor.readings).by_point:
            continue
        parts = np.column_stack([readings.setup, readings.axis])
        for part in np.unique(parts, axis=0):
            in_file = np.flatnonzero((parts == part).all(axis=1))
            in_problem = rows.start + in_file
            setup, residual = readings.setups[part[0]], residuals[in_problem]
            stations = problem.station[in_problem]
            _, first_rows, station = np.unique(stations, return_index=True, return_inverse=True)
            means = np.bincount(station, readings.sign[in_file] * residual) / np.bincount(station)
            order = descending(np.abs(means))
            by_size = in_file[first_rows[order]]
            _, at_command = np.unique(readings.command[by_size], axis=0, return_index=True)
            worst = by_size[np.sort(at_command)[:_MOST_STATIONS]]
            # With only two stations and a free datum, both residuals are equal.
            first, *others = np.abs(means[order]).tolist()
            is_clear = first > _CLEAR_RATIO * max(others[:1], default=0.0)
            positions = (
                _tool_positions(problem.machine, readings, worst) if readings.of_tool else ()
            )
            setup_residual = SetupResidual(
                setup=setup.name,
                kind=setup.kind,
                leg=setup.leg,
                axis=int(part[1]),
                share=float(squares[in_problem].sum()),
                rms=float(np.sqrt(np.mean(residual**2))),
                most=float(means[order[0]]),
                posture=readings.posture[worst[0]] if is_clear else "",
                command=readings.command[worst[0]],
                where=positions,
            )
            found.append(setup_residual)
    return tuple(ranked(found, lambda setup_residual: setup_residual.share))


def _tool_positions(machine: Machine, campaign: Readings, rows: Ints) -> tuple[str, ...]:
    """Return the tool's positions in rows ``(n,)``, as text; without the height if it probes a
    plate.

    For a distance between two points, both positions are given.
    """
    kinematics = machine.spec.kinematics
    observation = campaign.setups[campaign.setup[rows[0]]].observation
    forward = machine.with_only({}).forward if kinematics is None else kinematics.places
    axes = LEGS[:2] if observation.touches else LEGS

    def words(point: Array) -> str:
        pairs = zip(axes, point, strict=False)
        return ", ".join(f"{axis} {plain(value * 1e3, 0)}" for axis, value in pairs)

    commands = (campaign.command, campaign.second) if observation.paired else (campaign.command,)
    ends = [map(words, forward(command[rows])) for command in commands]
    return tuple(" to ".join(points) for points in zip(*ends, strict=True))
