"""Columns of the free-form errors of machine and plates that readings could show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import chain, compress

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.bumps_and_jumps import jumping, travel_bumps, with_jump, with_period
from orthoglide.effects.free_form import FreeForm, Session, free_forms
from orthoglide.effects.kernels import BUILD_UP, Level, Wave
from orthoglide.effects.plates import residual_plate_shapes
from orthoglide.fit import Problem
from orthoglide.fit.assembling import axes_approached_from_both_sides
from orthoglide.fit.least_squares import project_out
from orthoglide.fit.problem import Factor
from orthoglide.geometry import LEGS, Array
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, descending
from orthoglide.prediction import Model

_LARGEST_BUMP_SHARE = 0.2  # of the readings at a travel: on fewer than five, a bump is a curve
_MOST_BUMP_TRAVELS = 40  # travels of a leg: with more, each has too few readings for a bump
_BUMP_STEP, _BUMP_REACH = 4e-3, 16e-3  # metres: half and twice the width of the narrowest bump
_LEAST_BUMP_STATIONS = 3  # stations on a bump of readings at the tool: fewer are slips
_MOST_BUMPS = 4  # bumps considered for each part, at the travels that explain most
_MOST_JUMPS = 8  # for each part, at the moments that explain most: 16 changed no result
_LEAST_VISITS_BESIDE_JUMP = 2  # on either side, as of a knocked stand: a single one is a slip
_LEAST_WAVE = 5e-3  # metres: shortest period of a wave, the smallest common lead of a screw
_LEAST_CYCLES = 2.0  # over the stroke: a longer wave is a curve
_CYCLE_STEP = 0.1  # between the periods that are tried: a tenth of a peak's width
_LEAST_CYCLE_DISTANCE = 0.002  # of two frequencies: an eightieth of a radian from end to end
_LEAST_WAVE_STATIONS = 6  # travels: fewer fit any wave with its level and a slope
_MOST_WAVES = 3  # for each part, of the periods that explain most
_DECIMALS = 4  # of travels, metres, and of moments, seconds, that count as different
_LEAST_SIGNAL = 0.1  # sigmas: less adds under a hundredth to the chi2 of a reading


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
    if session is not None and not session.timed:
        session = None  # the order tells no rate of a change
    errors = free_forms(session, machine.catalogue.legs, geometry.stroke, geometry.scale)
    if problem.tool_factors:
        # Readings at the tool do not distinguish a moved bar end from a moved carriage.
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
    """Return the times of readings ``(n,)``, or their order if any has no time, and whether they
    are times.
    """
    timed = bool(np.isfinite(readings.time).all())
    return (readings.time if timed else readings.order.astype(float)), timed


def bump_travels(problem: Problem) -> list[list[float]]:
    """Return the travels of each leg, metres, at which a bump is considered.

    A travel of many readings is left out, as an error there is no local one. So is a travel near
    which no direction is read twice, as a slip is likelier there.
    """
    travels: list[list[float]] = [[] for _ in LEGS]
    if not (dials := problem.leg_factors):
        return travels
    reach = _BUMP_REACH * problem.machine.geometry.scale
    leg_and_axis = np.concatenate([len(LEGS) * f.readings.leg + f.readings.axis for f in dials])
    legs = [problem.machine.model.leg_conditions({}, f.conditions()) for f in dials]
    for leg, leg_travels in enumerate(travels):
        travel = np.round(np.concatenate([c[leg].nominal_travel for c in legs]), _DECIMALS)
        levels, count = np.unique(travel, return_counts=True)
        near = (np.bincount(leg_and_axis[abs(travel - level) < reach]).max() for level in levels)
        rare = (count <= _LARGEST_BUMP_SHARE * len(travel)) & (np.array([*near]) > 1)
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
    """Return the columns ``(n, K)`` of each free-form error, scaled by its prior standard
    deviation, and all of these errors.

    Readings under equal conditions have equal columns, except of errors that depend on time or on
    the reading before. With ``first``, only the columns of such errors have all rows; all others
    have the rows of ``first``.

    Args:
        problem: the readings.
        x: its unknowns ``(P,)``, SI.
        residual: of the readings there ``(n,)``, SI.
        fitted: rows of the readings of orthonormal columns that span everything fitted, priors
            included, in sigmas ``(n, q)``; see :func:`~orthoglide.fit.least_squares.fitted_basis`.
        first: first reading of each group under equal conditions, ascending.
    """
    errors = visible_free_form_errors(problem)
    if not errors:
        return iter(()), ()
    machine, stroke = problem.machine, problem.machine.geometry.stroke
    forms = free_forms(_session(problem), machine.catalogue.legs, stroke, machine.geometry.scale)
    paired = any(f.readings.paired.any() for f in problem.factors)  # at two travels
    slow = [e for e in forms if e.against == "time" or (e in errors and not paired)]
    if sudden := [*chain(*map(jumping, slow))]:
        errors += tuple(_jump_candidates(problem, x, residual, sudden, fitted))
    if not (problem.leg_factors or paired):
        errors += tuple(_bump_candidates(problem, x, residual, fitted))
    if not paired:
        waves = [error for error in errors if error.short_waves]
        errors += tuple(_wave_candidates(problem, x, residual, waves, fitted))
    if first is None or len(first) == len(residual):
        return _columns_of_factors(problem, x, errors, problem.factors), errors
    parts = [first[(first >= p.start) & (first < p.stop)] - p.start for p in problem.factor_rows]
    few = [factor.subset(rows) for factor, rows in zip(problem.factors, parts, strict=True)]
    needs_all_rows = [error.against in ("time", "reversal") for error in errors]
    blocks = {
        every: _columns_of_factors(problem, x, [*compress(errors, selected)], factors)
        for every, factors, selected in (
            (True, problem.factors, needs_all_rows), (False, few, np.logical_not(needs_all_rows))
        )
    }  # fmt: skip
    return (next(blocks[every]) for every in needs_all_rows), errors


def _columns_of_factors(
    problem: Problem, x: Array, errors: Sequence[FreeForm], factors: Sequence[Factor]
) -> Iterator[Array]:
    """Yield the columns ``(n, K)`` of each free-form error in some factors, in its unit."""
    model = problem.machine.model
    by_factor = [free_form_columns_of_factor(factor, model, problem.values(k, x), errors)
            for k, factor in enumerate(factors)]  # fmt: skip
    for rows in zip(*by_factor, strict=True):
        yield rows[0] if len(rows) == 1 else np.vstack(rows)  # without a copy


def _jump_candidates(
    problem: Problem, x: Array, residual: Array, errors: Sequence[FreeForm], fitted: Array
) -> Iterator[FreeForm]:
    """Yield free-form errors with a jump, at the moments or travels that explain most of the
    residuals.

    A step between two mountings of a dial, for example, is mostly explained by their datums.
    """
    stroke = problem.machine.geometry.stroke
    whitened_residual = project_out(fitted, residual / problem.sigma)
    levels = [replace(error, kernel=Level()) for error in errors]
    columns = _columns_of_factors(problem, x, levels, problem.factors)
    pairs = zip(problem.factors, problem.factor_rows, strict=True)
    visit = np.concatenate([factor.visit_number + rows.start for factor, rows in pairs])
    for error, rows in zip(errors, columns, strict=True):
        moments = _moments_or_travels(problem, error)
        order = np.argsort(moments, kind="stable")[::-1]  # sums from the end: after a moment
        moments, whitened = moments[order], whitened_residual[order]
        cuts = np.flatnonzero(np.diff(np.round(moments, _DECIMALS)) < 0)
        step = (rows[:, 0] / problem.sigma)[order]
        visible = np.flatnonzero(np.abs(step) > _LEAST_SIGNAL)
        visits = np.sort(visible[np.unique(visit[order][visible], return_index=True)[1]])
        after = np.searchsorted(visits, cuts, side="right")
        allowed = cuts[np.minimum(after, len(visits) - after) >= _LEAST_VISITS_BESIDE_JUMP]
        if not len(allowed):
            continue
        products, squares = np.cumsum(step * whitened)[allowed], np.cumsum(step**2)[allowed]
        components = np.cumsum(step[:, None] * fitted[order], axis=0)[allowed]
        gain = _chi2_gain(products, squares, components)
        between = np.stack([moments[allowed + 1], moments[allowed]], axis=1)
        # A drive loses a step while it moves, once between two readings; a screw loosens at any
        # time. Half of the prior is uniform over the pauses, half proportional to their durations;
        # so it is of places between the stations, as most of them stand where the machine is used.
        pause = between[:, 1] - between[:, 0]
        chance = (1 / len(allowed) + pause / pause.sum()) / 2
        order_of_gain = descending(gain / 2 + np.log(chance), LOG_ODDS_MARGIN)
        # Jumps of one name, a full second or a reading, are one: their priors add.
        names = between.mean(axis=1)
        if error.against == "time":
            names = np.rint(names) if error.timed else np.floor(names)
        _, first, name = np.unique(names[order_of_gain], return_index=True, return_inverse=True)
        shares = np.bincount(name, chance[order_of_gain])
        for k in np.sort(first)[:_MOST_JUMPS]:
            low, high = between[order_of_gain[k]].tolist()
            chance_of_jump = error.chance * float(shares[name[k]])
            yield replace(with_jump(error, (low, high), stroke), chance=chance_of_jump)


def _moments_or_travels(problem: Problem, error: FreeForm) -> Array:
    """Return what an error that may jump depends on ``(n,)``: seconds or orders, or metres."""
    if error.against == "time":
        return np.concatenate([_moments(f.readings)[0] for f in problem.factors])
    model = problem.machine.model
    legs = [model.leg_conditions({}, f.conditions())[error.leg] for f in problem.factors]
    return np.concatenate([leg.nominal_travel for leg in legs])


def _bump_candidates(
    problem: Problem, x: Array, residual: Array, fitted: Array
) -> Iterator[FreeForm]:
    """Yield the bumps of drives and rails that explain most of the residuals of readings at the
    tool; see `_jump_candidates`.

    Their postures seldom share a travel of a leg, so bumps are tried at evenly spaced travels.
    """
    machine, geometry = problem.machine, problem.machine.geometry
    step = _BUMP_STEP * geometry.scale
    first, last = np.ceil(geometry.stroke[0] / step), np.floor(geometry.stroke[1] / step)
    travels = (np.arange(first, last + 1) * step).round(_DECIMALS).tolist()
    bumps = travel_bumps([travels] * len(LEGS), machine.catalogue.legs, geometry.stroke,
                         geometry.scale)  # fmt: skip
    by_part: dict[str, list[FreeForm]] = {}
    for bump in bumps:
        by_part.setdefault(bump.location_key, []).append(bump)
    levels = [replace(of_part[0], kernel=Level()) for of_part in by_part.values()]
    parts = [machine.model.leg_conditions({}, f.conditions()) for f in problem.factors]
    rows_of = _columns_of_factors(problem, x, levels, problem.factors)
    whitened = project_out(fitted, residual / problem.sigma)
    for of_part, rows in zip(by_part.values(), rows_of, strict=True):
        leg = of_part[0].leg
        u = np.concatenate([c[leg].over_stroke(c[leg].nominal_travel) for c in parts])
        shapes = np.column_stack([bump.kernel.functions(u)[0] for bump in of_part])
        columns = shapes * rows / problem.sigma[:, None]
        stations = [len(np.unique(problem.station[shape > 0.5])) for shape in shapes.T]
        gain = _chi2_gain(columns.T @ whitened, np.sum(columns**2, axis=0), columns.T @ fitted)
        gain[np.array(stations) < _LEAST_BUMP_STATIONS] = 0.0
        for k in descending(gain, LOG_ODDS_MARGIN)[:_MOST_BUMPS]:
            if gain[k] > 0:
                yield of_part[k]


def _wave_candidates(
    problem: Problem, x: Array, residual: Array, errors: Sequence[FreeForm], fitted: Array
) -> Iterator[FreeForm]:
    """Yield waves of one period in place of short waves, at the periods that explain most of the
    residuals; see `_jump_candidates`.

    All frequencies are equally likely beforehand.
    """
    geometry = problem.machine.geometry
    cycles = np.arange(_LEAST_CYCLES, np.ptp(geometry.stroke) / _LEAST_WAVE, _CYCLE_STEP)
    levels = [replace(error, kernel=Level()) for error in errors]
    whitened = project_out(fitted, residual / problem.sigma)[:, None]
    columns = _columns_of_factors(problem, x, levels, problem.factors)
    for error, rows in zip(errors, columns, strict=True):
        level, travels = rows / problem.sigma[:, None], _moments_or_travels(problem, error)
        # The mean of travels within a tenth of a millimetre, a fiftieth of the shortest period.
        number = np.unique(travels.round(_DECIMALS), return_inverse=True)[1]
        travel = np.bincount(number, travels) / np.bincount(number)
        of_travel = np.zeros((len(travel), 2 + fitted.shape[1]))
        np.add.at(of_travel, number, level * np.hstack([level, whitened, fitted]))
        if not len(cycles) or np.sum(of_travel[:, 0] > _LEAST_SIGNAL**2) < _LEAST_WAVE_STATIONS:
            continue
        u = 2 * (travel - geometry.stroke[0]) / np.ptp(geometry.stroke) - 1
        gain = _wave_gain(cycles, u, of_travel)
        before, after = (np.concatenate([a, gain, b]) for a, b in (([0, 0], []), ([], [0, 0])))
        peaks = (gain > before[1:-1]) & (gain >= after[1:-1]) & (gain > 2 * np.log(len(cycles)))
        waves = dict[str, FreeForm]()  # by name: two trial periods may lead to the same peak
        for k in descending(np.where(peaks, gain, 0.0), LOG_ODDS_MARGIN)[:_MOST_WAVES]:
            if peaks[k]:
                near = cycles[k] + _CYCLE_STEP * np.linspace(-1, 1, 41)
                best = near[np.argmax(_wave_gain(near, u, of_travel))]
                about = _wave_gain(best + _CYCLE_STEP * np.array([-0.2, 0, 0.2]), u, of_travel)
                curvature = max(-np.diff(about, 2)[0], 1e-300) / (0.2 * _CYCLE_STEP) ** 2
                step = min(max(1.5 * np.sqrt(2 / curvature), _LEAST_CYCLE_DISTANCE), _CYCLE_STEP)
                for one in best + step * np.arange(-2, 3):  # three sigma either way
                    wave = with_period(error, np.ptp(geometry.stroke) / one, geometry.stroke)
                    chance = error.chance * step / np.ptp(cycles)
                    waves.setdefault(wave.name, replace(wave, chance=chance))
        yield from waves.values()


def _wave_gain(cycles: Array, u: Array, of_travel: Array) -> Array:
    """Return the chi2 that waves explain beside all that is fitted ``(k,)``; see `_chi2_gain`.

    Args:
        cycles: over the stroke ``(k,)``.
        u: travels, from -1 to 1 over the stroke ``(t,)``.
        of_travel: sums over the readings at a travel ``(t, 2 + q)`` of a level's column times
            itself, the residual and the fitted columns, all in sigmas.
    """
    waves = np.stack(Wave(1.0).functions(cycles[:, None] * u), axis=1)  # (k, 2, t)
    squares = (waves * of_travel[:, 0]) @ waves.swapaxes(1, 2)
    products, components = np.split(waves @ of_travel[:, 1:], [1], axis=2)
    remaining = squares - components @ components.swapaxes(1, 2)
    remaining[:, [0, 1], [0, 1]] += _LEAST_SIGNAL**2
    return np.asarray(np.sum(products * np.linalg.solve(remaining, products), axis=(1, 2)))


def _chi2_gain(products: Array, squares: Array, components: Array) -> Array:
    """Return the chi2 that each column s explains beside all that is fitted ``(k,)``.

    With r the residual and V the fitted columns it is ``(s^T (1 - V V^T) r)^2 / (s^T s - |V^T
    s|^2)``, in sigmas. The rounding error that visits share is neglected.

    Args:
        products: ``s^T (1 - V V^T) r`` ``(k,)``.
        squares: ``s^T s`` ``(k,)``.
        components: ``V^T s`` ``(k, q)``.
    """
    remaining = squares - np.sum(components**2, axis=1)
    return np.asarray(products**2 / np.maximum(remaining, _LEAST_SIGNAL**2))


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
    if factor.on_legs and any(error.against == "reversal" for error in errors):
        half = np.ptp(model.geometry.stroke) / 2
        built_up = factor.readings.built_up([half * length for length in BUILD_UP.lengths])
        legs = tuple(replace(c, built_up=tuple(built_up[:, :, k])) for k, c in enumerate(legs))
    for error in errors:
        parts = list[Array]()
        for leg in [error.leg] if error.leg >= 0 else range(len(LEGS)):
            functions = np.stack(error.functions(legs[leg]), axis=1)
            parts.append(response(error.prior_sd * _joint_shares(error, leg), functions))
            if error.moves_bar_ends and factor.on_legs:
                shift = error.prior_sd * _carriage_shift_at_dials(error, factor.readings)
                parts[-1] += shift[:, None] * functions
        yield reduce(np.add, parts)


def plate_shape_columns(problem: Problem) -> tuple[Array, Array]:
    """Return the columns ``(n, F)`` of residual shapes of plates, and their prior sd."""
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


def _joint_shares(error: FreeForm, leg: int) -> Array:
    """Return the share of every virtual joint in a free-form error of a leg ``(30,)``."""
    names = VIRTUAL_NAMES
    shares = np.zeros(len(LEGS) * len(names))
    for joint, share in error.joints:
        shares[leg * len(names) + names.index(joint)] = share
    return shares


def _carriage_shift_at_dials(error: FreeForm, campaign: Readings) -> Array:
    """Return the dial readings ``(n,)`` of a unit shift of the whole carriage along the error."""
    shift_by_setup = [s.sign * (s.leg == error.leg and LEGS[s.axis] == error.direction)
            for s in campaign.setups]  # fmt: skip
    return np.take(np.asarray(shift_by_setup, dtype=float), campaign.setup)
