"""Columns of the free-form errors of dials: curves over their range, creep, reversal and bumps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.bumps_and_jumps import DIAL_BUMP_WIDTHS, with_dial_bump
from orthoglide.effects.dials import common_dial_form, dial_free_forms
from orthoglide.effects.free_form import FreeForm
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, descending, largest

_MOST_DIAL_BUMPS = 2  # for each dial, at the readings that they explain best: 4 changed no result
_LEAST_DIAL_MOVE = 1e-6  # metres: the finest step of dials
_CLEAR_DIAL_MOVE = 5e-6  # metres: less is within the repeatability of dials
_DIRECTION_SEPARATION = 3.0
"""Least mean difference of both directions' residuals, in scatters: the nearer direction is then
the true one of 93 % of the readings, which lie within 1.5 scatters."""


def dial_curve_columns(
    problem: Problem, predicted: Array, residual: Array
) -> tuple[list[Array], tuple[FreeForm, ...]]:
    """Return the columns ``(n, K)`` of each free-form error of dials, in its unit, and these
    errors.

    Args:
        problem: the readings.
        predicted: readings ``(n,)``, metres.
        residual: that bumps may explain ``(n,)``, metres.
    """
    columns, errors = list[Array](), list[FreeForm]()
    direction_halves, reversing_count = np.zeros(len(predicted)), 0
    scale = problem.machine.geometry.scale
    for campaign, part in zip(problem.campaigns, problem.leg_rows, strict=True):
        for k, setup in enumerate(campaign.setups):
            rows = part.start + np.flatnonzero(campaign.setup == k)
            time, setup_predicted = campaign.time[rows - part.start], predicted[rows]
            if np.ptp(setup_predicted) <= 0:
                continue
            name = setup.name if len(problem.campaigns) == 1 else f"{setup.name}@{campaign.name}"
            has_time = np.isfinite(time).all() and np.ptp(time) > 0
            span = (float(time.min()), float(time.max())) if has_time else None
            offsets = problem.measured[rows] - setup_predicted
            direction = _plunger_direction(campaign, rows - part.start, setup_predicted, offsets)
            reading_range = (float(setup_predicted.min()), float(setup_predicted.max()))
            both_ways = bool((direction > 0).any() and (direction < 0).any())
            setup_errors = dial_free_forms(name, setup.leg, span, reading_range, both_ways, scale)
            # Predictions at the commands as written, so that no bump explains a corrected command.
            written, whitened = problem.measured[rows] - residual[rows], residual / problem.sigma
            bumps = [bump for e in setup_errors if e.against == "reading"
                     for bump in _dial_bumps(e, written, whitened[rows])]  # fmt: skip
            for error in (*setup_errors, *bumps):
                low, high = error.span or (0.0, 1.0)
                abscissa = written if error.is_local else setup_predicted
                if error.against == "time":
                    abscissa = time
                functions = error.kernel.functions(2 * (abscissa - low) / (high - low) - 1)
                block = np.zeros((len(predicted), len(functions)))
                block[rows] = np.stack(functions, axis=1) * error.prior_sd
                if error.against == "approach":
                    block[rows] *= direction[:, None] / 2
                    direction_halves[rows], reversing_count = direction / 2, reversing_count + 1
                columns.append(block)
                errors.append(error)
    if reversing_count > 1:
        reversing = predicted[direction_halves != 0]
        errors.append(common_dial_form((float(reversing.min()), float(reversing.max())), scale))
        columns.append((direction_halves * errors[-1].prior_sd)[:, None])
    return columns, tuple(errors)


def _dial_bumps(error: FreeForm, predicted: Array, residual: Array) -> Iterator[FreeForm]:
    """Yield a dial's error with a bump, at the readings where it explains most of the residual.

    Args:
        error: the dial's curve by its reading.
        predicted: readings of the dial ``(k,)``, metres.
        residual: of these ``(k,)``, in sigmas; their median is attributed to the datum.
    """
    centres = np.unique(np.round(predicted, 5))  # hundredths of a millimetre, which name a bump
    residual = residual - np.median(residual)
    gain = np.empty((len(centres), len(DIAL_BUMP_WIDTHS)))
    for k, width in enumerate(DIAL_BUMP_WIDTHS):
        bump = np.exp(-0.5 * ((predicted - centres[:, None]) / width) ** 2)
        gain[:, k] = (bump @ residual) ** 2 / np.maximum(np.sum(bump**2, axis=1), 1.0)
    for centre in descending(gain.max(axis=1), LOG_ODDS_MARGIN)[:_MOST_DIAL_BUMPS]:
        width = DIAL_BUMP_WIDTHS[largest(gain[centre], LOG_ODDS_MARGIN)]
        yield with_dial_bump(error, float(centres[centre]), width, len(centres))


def _means_at(predicted: Array, residual: Array) -> tuple[Array, Array]:
    """Return distinct predicted readings ``(q,)``, to a micrometre, and their mean residuals."""
    at, group = np.unique(np.round(predicted, 6), return_inverse=True)
    return at, np.bincount(group, residual) / np.bincount(group)


def _plunger_direction(
    campaign: Readings, rows: NDArray[np.int64], predicted: Array, residual: Array
) -> Array:
    """Return the direction in which a dial's plunger came to each reading ``(k,)``.

    It is 1 if the reading grew and -1 if it fell; without a move the previous direction is kept; 0
    is unknown. If the direction is unknown or the last move was under 5 um, the reading is given
    the direction whose residual, interpolated to its predicted reading, is nearer to its own: what
    else is wrong with the machine is the same from both. This is done only if both directions
    differ by more than three times their scatter.

    Args:
        campaign: of the readings.
        rows: of one setup within it ``(k,)``.
        predicted: readings there ``(k,)``, metres.
        residual: measured less predicted ``(k,)``, metres.
    """
    order = np.argsort(campaign.order[rows], kind="stable")
    moves = np.diff(predicted[order], prepend=predicted[order][:1])
    move_sign = np.where(np.abs(moves) > _LEAST_DIAL_MOVE, np.sign(moves), 0.0)
    index = np.arange(len(moves))
    last = np.maximum.accumulate(np.where(move_sign != 0, index, 0))
    visits = np.hstack([campaign.command, campaign.approach])[rows[order]]
    stayed = np.append(False, (np.diff(visits, axis=0) == 0).all(axis=1))
    last_visit = np.maximum.accumulate(np.where(stayed, 0, index))
    direction, size = np.empty(len(moves)), np.empty(len(moves))
    direction[order], size[order] = move_sign[last], np.abs(moves)[last_visit]
    # Moves that were not recorded came between.
    direction *= (campaign.approach == campaign.derived_approach).all(axis=1)[rows]
    clear = (direction != 0) & (size > _CLEAR_DIAL_MOVE)
    groups = [clear & (direction == move_sign) for move_sign in (1, -1)]
    if min(map(np.sum, groups)) < 2:
        return direction
    grown, fallen = (
        np.interp(predicted, *_means_at(predicted[group], residual[group])) for group in groups
    )
    difference = (grown - fallen)[clear]
    from_own = (residual - np.where(direction > 0, grown, fallen))[clear]
    scatter = np.hypot(difference.std(), np.sqrt(np.mean(from_own**2)))
    if abs(difference.mean()) <= _DIRECTION_SEPARATION * scatter:
        return direction
    nearest = np.where(np.abs(residual - grown) < np.abs(residual - fallen), 1.0, -1.0)
    return np.where(clear, direction, nearest)
