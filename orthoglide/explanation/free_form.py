"""Columns of the free-form errors of machine, dials and plates that readings could show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.bumps_and_jumps import (
    DIAL_BUMP_WIDTHS,
    may_jump,
    travel_bumps,
    with_dial_bump,
    with_jump,
)
from orthoglide.effects.dials import common_dial_form, dial_free_forms
from orthoglide.effects.free_form import BUILD_UP, FreeForm, Session, free_forms
from orthoglide.effects.kernels import Level
from orthoglide.effects.plates import residual_plate_shapes
from orthoglide.fit import Problem
from orthoglide.fit.excitation import axes_approached_from_both_sides
from orthoglide.fit.problem import Factor
from orthoglide.geometry import LEGS, Array
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, descending, largest
from orthoglide.prediction import Model

_LARGEST_BUMP_SHARE = 0.2  # of the readings at a travel for which a bump is considered
_MOST_BUMP_TRAVELS = 40  # travels of a leg: with more, each has too few readings for a bump
_MOST_DIAL_BUMPS = 2  # bumps considered for each dial, at the readings that they explain best
_MOST_JUMPS = 8  # jumps considered for each part, at the moments that explain most
_LEAST_READINGS_BESIDE_JUMP = 6  # readings on either side of a jump: fewer are slips
_LEAST_SIGNAL = 0.1  # sigmas: least effect on a reading that counts as visible
_LEAST_DIAL_MOVE = 1e-6  # metres: a smaller move does not move a dial
_CLEAR_DIAL_MOVE = 5e-6  # metres: a larger move has a certain direction
_DIRECTION_SEPARATION = 3.0  # least mean difference of both directions' residuals, in scatters


def only_surface_readings(problem: Problem) -> bool:
    """True if only plates, and distances on them, were measured."""
    return all((f.readings.touching | f.readings.paired).all() for f in problem.factors)


def only_plate_readings(problem: Problem) -> bool:
    """True if only plates were measured."""
    return all(f.readings.touching.all() for f in problem.factors)


def visible_free_form_errors(problem: Problem) -> tuple[FreeForm, ...]:
    """Return the free-form errors of the machine that these readings could show.

    The tuple is empty if only plates, or distances on them, were measured: the shape of the plate
    is then unknown, and a free-form error of any part could produce the same readings.
    """
    if only_surface_readings(problem):
        return ()
    machine = problem.machine
    geometry = machine.geometry
    session = _session(problem)
    if session is not None and not (session.timed and problem.campaigns):
        session = None  # the order tells no rate of a change, and instruments at the tool drift too
    errors = free_forms(session, machine.catalogue.legs, geometry.stroke, geometry.scale)
    if len(problem.campaigns) < len(problem.factors):
        # Only readings of legs distinguish a moved bar end from a moved carriage.
        errors = tuple(e for e in errors if not e.moves_bar_ends)
    travels = bump_travels(problem)
    errors += travel_bumps(travels, machine.catalogue.legs, geometry.stroke, geometry.scale)
    approach = np.concatenate([f.conditions().approach for f in problem.factors])
    one_sided = ~axes_approached_from_both_sides(approach)  # lost motion is invisible
    hidden = {"approach": one_sided, "reversal": one_sided | bool(problem.tool_factors)}
    return tuple(e for e in errors if e.against not in hidden or not hidden[e.against][e.leg])


def _session(problem: Problem) -> Session | None:
    """Return the session of a campaign; ``None`` of several, and of distances between two places,
    which were reached at two moments.
    """
    if len(problem.factors) != 1 or problem.factors[0].readings.paired.any():
        return None
    moments, timed = _moments(problem.factors[0].readings)
    return Session(float(moments.min()), float(moments.max()), timed) if np.ptp(moments) else None


def _moments(readings: Readings) -> tuple[Array, bool]:
    """Return the seconds of readings ``(n,)``, and true; their order, and false, if any has no
    time.
    """
    timed = bool(np.isfinite(readings.time).all())
    return (readings.time if timed else readings.order.astype(float)), timed


def bump_travels(problem: Problem) -> list[list[float]]:
    """Return the travels of each leg, metres, at which a bump is considered.

    A travel at which the leg stands in many readings is left out, as an error there is no local
    one. A travel without repeated readings is left out too, as a slip of the reading is likelier
    there.
    """
    travels: list[list[float]] = [[] for _ in LEGS]
    if not problem.leg_factors:
        return travels
    station = problem.station[: problem.leg_rows[-1].stop]
    repeated = np.bincount(station)[station] > 1
    legs = [problem.machine.model.leg_conditions({}, f.conditions()) for f in problem.leg_factors]
    for leg, leg_travels in enumerate(travels):
        travel = np.round(np.concatenate([c[leg].nominal_travel for c in legs]), 4)
        levels, count = np.unique(travel, return_counts=True)
        rare = (count <= _LARGEST_BUMP_SHARE * len(travel)) & np.isin(levels, travel[repeated])
        if rare.sum() <= _MOST_BUMP_TRAVELS:
            leg_travels += levels[rare].tolist()
    return travels


def free_form_columns(
    problem: Problem,
    x: Array,
    residual: Array,
    fitted: Array,
    first: NDArray[np.intp] | None = None,
) -> tuple[Iterator[Array], tuple[FreeForm, ...]]:
    """Return the columns ``(n, K)`` of each free-form error, in its unit, and these errors; if
    ``first`` is given, only its rows of those that depend on the present conditions alone.

    Args:
        problem: the readings.
        x: its unknowns ``(P,)``, SI.
        residual: of the readings there ``(n,)``, SI.
        fitted: orthonormal columns of everything fitted, in sigmas ``(n, q)``.
        first: first reading of each group under equal conditions, ascending.
    """
    errors = visible_free_form_errors(problem)
    if not errors:
        return iter(()), ()
    machine, stroke = problem.machine, problem.machine.geometry.stroke
    forms = free_forms(_session(problem), machine.catalogue.legs, stroke, machine.geometry.scale)
    if jumping := [form for form in forms if may_jump(form)]:
        errors += tuple(_jump_candidates(problem, x, residual, jumping, fitted))
    if first is None or len(first) == len(residual):
        return _columns_of_factors(problem, x, errors, problem.factors), errors
    parts = [first[(first >= p.start) & (first < p.stop)] - p.start for p in problem.factor_rows]
    few = [factor.subset(rows) for factor, rows in zip(problem.factors, parts, strict=True)]
    of_past = [error.against in ("time", "reversal") for error in errors]
    blocks = {
        past: _columns_of_factors(problem, x, [*compress(errors, selected)], factors)
        for past, factors, selected in (
            (True, problem.factors, of_past), (False, few, np.logical_not(of_past))
        )
    }  # fmt: skip
    return (next(blocks[past]) for past in of_past), errors


def _columns_of_factors(
    problem: Problem, x: Array, errors: Sequence[FreeForm], factors: Sequence[Factor]
) -> Iterator[Array]:
    """Yield the columns ``(n, K)`` of each free-form error in some factors, in its unit."""
    model = problem.machine.model
    by_factor = [free_form_columns_of_factor(factor, model, problem.values(k, x), errors)
            for k, factor in enumerate(factors)]  # fmt: skip
    for rows in zip(*by_factor, strict=True):
        yield np.vstack(rows)


def _jump_candidates(
    problem: Problem, x: Array, residual: Array, errors: Sequence[FreeForm], fitted: Array
) -> Iterator[FreeForm]:
    """Yield free-form errors with a jump, at the moments that explain most of the residuals.

    With r and s the residual and the step in sigmas, and V all that is fitted, a step explains
    ``(s^T (1 - V V^T) r)^2 / (s^T (1 - V V^T) s)`` of chi2. A step between two mountings of a
    dial, for example, is mostly explained by their datums.
    """
    moments = np.concatenate([_moments(f.readings)[0] for f in problem.factors])
    order = np.argsort(moments, kind="stable")
    whitened = residual / problem.sigma
    whitened = (whitened - fitted @ (fitted.T @ whitened))[order]
    moments, fitted = moments[order], fitted[order]
    cuts = np.flatnonzero(np.diff(moments) > 0)
    levels = [replace(p, kernel=Level()) for p in errors]
    columns = _columns_of_factors(problem, x, levels, problem.factors)
    for error, rows in zip(errors, columns, strict=True):
        step = (rows[:, 0] / problem.sigma)[order]
        visible_count = np.cumsum(np.abs(step) > _LEAST_SIGNAL)
        fewer = np.minimum(visible_count[cuts], visible_count[-1] - visible_count[cuts])
        allowed = cuts[fewer >= _LEAST_READINGS_BESIDE_JUMP]
        if not len(allowed):
            continue
        products, squares = np.cumsum(step * whitened), np.cumsum(step**2)
        explained = np.cumsum(step[:, None] * fitted, axis=0)[allowed]
        remaining = squares[allowed] - np.sum(explained**2, axis=1)
        gain = products[allowed] ** 2 / np.maximum(remaining, _LEAST_SIGNAL**2)
        order_of_gain = descending(gain, LOG_ODDS_MARGIN)
        between = (moments[allowed] + moments[allowed + 1])[order_of_gain] / 2
        # One for each full second, or reading, which names a jump.
        names = np.rint(between) if error.timed else np.floor(between)
        _, first = np.unique(names, return_index=True)
        for moment in between[np.sort(first)[:_MOST_JUMPS]].tolist():
            yield replace(with_jump(error, moment), chance=1 / len(first))


def free_form_columns_of_factor(
    factor: Factor, model: Model, values: Mapping[str, float], errors: Sequence[FreeForm]
) -> Iterator[Array]:
    """Yield the columns ``(n, K)`` of each free-form error in one factor, in its unit.

    They are linearised about the parameters ``values``, SI.
    """
    response = factor.joint_response(model, values)
    conditions = factor.conditions()
    if any(error.against == "time" for error in errors):
        conditions = conditions.with_time(_moments(factor.readings)[0])
    legs = model.leg_conditions(values, conditions)
    if factor.on_legs and any(p.against == "reversal" for p in errors):
        half = np.ptp(model.geometry.stroke) / 2
        built_up = factor.readings.built_up([half * length for length in BUILD_UP.lengths])
        legs = tuple(replace(c, built_up=tuple(built_up[:, :, k])) for k, c in enumerate(legs))
    for error in errors:
        functions = error.prior_sd * np.stack(error.functions(legs[error.leg]), axis=1)
        rows = response(_joint_shares(error), functions)
        if error.moves_bar_ends and factor.on_legs:
            rows += _carriage_shift_at_dials(error, factor.readings)[:, None] * functions
        yield rows


def plate_shape_columns(problem: Problem) -> tuple[Array, Array]:
    """Return the columns ``(n, F)`` of plate shapes that no effect names, and their prior sd."""
    columns, sd = [np.zeros((len(problem.measured), 0))], list[float]()
    for k, factor, number, setup in problem.iter_tool_setups():
        if setup.observation.touches:
            rows = np.flatnonzero(factor.setup == number)
            for shape, shape_sd in residual_plate_shapes(
                factor.normalized_plate_xy[rows], problem.machine.geometry.scale
            ):
                column = np.zeros((len(problem.measured), 1))
                column[problem.factor_rows[k].start + rows, 0] = shape * shape_sd
                columns.append(column)
                sd.append(shape_sd)
    return np.hstack(columns), np.array(sd)


def _joint_shares(error: FreeForm) -> Array:
    """Return the share of every virtual joint in a free-form error ``(30,)``."""
    names = VIRTUAL_NAMES
    shares = np.zeros(len(LEGS) * len(names))
    for leg in [error.leg] if error.leg >= 0 else range(len(LEGS)):
        for joint, share in error.joints:
            shares[leg * len(names) + names.index(joint)] = share
    return shares


def _carriage_shift_at_dials(error: FreeForm, campaign: Readings) -> Array:
    """Return the dial readings ``(n,)`` of a unit shift of the whole carriage along the error."""
    shift_by_setup = [s.sign * (s.leg == error.leg and LEGS[s.axis] == error.direction)
            for s in campaign.setups]  # fmt: skip
    return np.take(np.asarray(shift_by_setup, dtype=float), campaign.setup)


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
