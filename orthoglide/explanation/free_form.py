"""Rows of the readings by the free functions of every place that they could show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.bumps_and_jumps import (
    DIAL_BUMP_WIDTHS,
    may_jump,
    travel_bumps,
    with_dial_bump,
    with_jump,
)
from orthoglide.effects.free_form import (
    BUILD_UP,
    FreeForm,
    Session,
    common_dial_form,
    dial_free_forms,
    free_forms,
)
from orthoglide.effects.kernels import Level
from orthoglide.effects.plates import residual_plate_shapes
from orthoglide.fit import Problem
from orthoglide.fit.excitation import axes_approached_from_both_sides
from orthoglide.fit.problem import Factor
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import Observation
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, descending, largest
from orthoglide.prediction import Model

_LARGEST_BUMP_SHARE = (
    0.2  # share of the readings at one travel of a leg, from which it is no single place
)
_MOST_BUMP_TRAVELS = (
    40  # travels of a leg: of more, each is seen by too few readings to weigh a bump
)
_MOST_DIAL_BUMPS = 2  # readings of a dial at which a bump is weighed: those that explain most
_MOST_JUMPS = 8  # moments at which a part may jump: those that explain most
_LEAST_READINGS_BESIDE_JUMP = 6  # readings on either side of a jump: fewer are slips
_LEAST_SIGNAL = 0.1  # sigmas of a reading that a place of its usual size shows
_LEAST_DIAL_MOVE = 1e-6  # metres: less moves no dial
_CLEAR_DIAL_MOVE = 5e-6  # metres: of a move from which it is clear which way it went
_DIRECTION_SEPARATION = 3.0  # times their scatter, by which readings of both ways have to differ


def only_surface_readings(problem: Problem) -> bool:
    """Whether plates and distances on them are all that was read."""
    return all(o.touches or o.paired for o in _observations(problem))


def only_plate_readings(problem: Problem) -> bool:
    """Whether plates are all that was read."""
    return all(o.touches for o in _observations(problem))


def _observations(problem: Problem) -> list[Observation]:
    return [s.observation for f in problem.factors for s in f.readings.setups]


def visible_free_form_errors(problem: Problem) -> tuple[FreeForm, ...]:
    """Places of the machine that these readings could show.

    The tuple is empty if only plates, or distances on them, were measured: the shape of the plate
    is then unknown, and a free-form error of any part could produce the same readings.
    """
    if only_surface_readings(problem):
        return ()
    sessions: list[Session] = []
    if len(problem.campaigns) == 1 and not problem.tool_factors:
        (campaign,) = problem.campaigns
        for leg in (*range(len(LEGS)), None):
            time = campaign.time if leg is None else campaign.time[campaign.leg == leg]
            if len(time) and np.isfinite(time).all() and np.ptp(time) > 0:
                sessions.append(Session(float(time.min()), float(time.max()), leg))
    machine = problem.machine
    geometry = machine.geometry
    found = free_forms(sessions, machine.catalogue.legs, geometry.stroke, geometry.scale)
    if len(problem.campaigns) < len(problem.factors):  # no other reading parts it from the carriage
        found = tuple(p for p in found if not p.moves_bar_ends)
    found += travel_bumps(
        bump_travels(problem), machine.catalogue.legs, geometry.stroke, geometry.scale
    )
    approach = np.concatenate([f.conditions().approach for f in problem.factors])
    one_sided = ~axes_approached_from_both_sides(
        approach
    )  # which shows no difference between sides
    hidden = {"approach": one_sided, "reversal": one_sided | bool(problem.tool_factors)}
    return tuple(p for p in found if p.against not in hidden or not hidden[p.against][p.leg])


def bump_travels(problem: Problem) -> list[list[float]]:
    """Return the travels of each leg, metres, at which a bump is weighed.

    A travel at which the leg stands in many readings is left out, because an error there is no bump
    to them. A travel without repeated readings is left out too, because there a slip of the reading
    is the likelier explanation.
    """
    found: list[list[float]] = [[] for _ in LEGS]
    if not problem.leg_factors:
        return found
    station = problem.station[: problem.leg_rows[-1].stop]
    again = np.bincount(station)[station] > 1
    legs = [problem.machine.model.leg_conditions({}, f.conditions()) for f in problem.leg_factors]
    for leg, own in enumerate(found):
        travel = np.round(np.concatenate([each[leg].nominal_travel for each in legs]), 4)
        at, count = np.unique(travel, return_counts=True)
        few = at[(count <= _LARGEST_BUMP_SHARE * len(travel)) & np.isin(at, travel[again])]
        if len(few) <= _MOST_BUMP_TRAVELS:
            own += few.tolist()
    return found


def free_form_columns(
    problem: Problem, x: Array, rest: Array
) -> tuple[Iterator[Array], tuple[FreeForm, ...]]:
    """Rows by the coefficients of each place ``(n, K)`` in its unit, and the places kept.

    Args:
        problem: the readings.
        x: its unknowns ``(P,)``, SI.
        rest: residuals of the readings there ``(n,)``, SI.
    """
    kept = visible_free_form_errors(problem)
    if not kept:
        return iter(()), ()
    kept += tuple(_jump_candidates(problem, x, rest, [p for p in kept if may_jump(p)]))
    return _columns_of_problem(problem, x, kept), kept


def _columns_of_problem(problem: Problem, x: Array, several: Sequence[FreeForm]) -> Iterator[Array]:
    """Yield rows of all readings by the coefficients of each place ``(n, K)`` in its unit."""
    model = problem.machine.model
    each = [free_form_columns_of_factor(factor, model, problem.values(k, x), several)
            for k, factor in enumerate(problem.factors)]  # fmt: skip
    for rows in zip(*each, strict=True):
        yield np.vstack(rows)


def _jump_candidates(
    problem: Problem, x: Array, rest: Array, several: Sequence[FreeForm]
) -> Iterator[FreeForm]:
    """Yield places with a jump, at the moments whose step explains most of the residuals.

    The gain of a step is its squared size over its variance, both by the readings before and after.
    """
    if not several:  # without recorded time
        return
    time = np.concatenate([f.readings.time for f in problem.factors])
    order = np.argsort(time, kind="stable")
    time, off = time[order], (rest / problem.sigma)[order]
    cuts = np.flatnonzero(np.diff(time) > 0)
    levels = [replace(p, kernel=Level()) for p in several]
    for place, rows in zip(several, _columns_of_problem(problem, x, levels), strict=True):
        shown = (rows[:, 0] / problem.sigma)[order]
        met, square = np.cumsum(shown * off), np.cumsum(shown**2)
        seen = np.cumsum(np.abs(shown) > _LEAST_SIGNAL)
        inside = cuts[
            (seen[cuts] >= _LEAST_READINGS_BESIDE_JUMP)
            & (seen[-1] - seen[cuts] >= _LEAST_READINGS_BESIDE_JUMP)
        ]
        if not len(inside):
            continue
        before, after = square[inside], square[-1] - square[inside]
        step = (met[-1] - met[inside]) / after - met[inside] / before
        gain = step**2 / (1 / before + 1 / after)
        likeliest: dict[int, float] = {}  # of each second, by which a jump is named
        for moment in (time[inside] + time[inside + 1])[descending(gain)].tolist():
            likeliest.setdefault(round(moment / 2), moment / 2)
        for moment in [*likeliest.values()][:_MOST_JUMPS]:
            yield with_jump(place, moment, len(likeliest))


def free_form_columns_of_factor(
    factor: Factor, model: Model, values: Mapping[str, float], several: Sequence[FreeForm]
) -> Iterator[Array]:
    """Yield rows of one factor by the coefficients of each place ``(n, K)`` in its unit, linear
    about parameters of some values, SI.
    """
    by_joints = factor.joint_response(model, values)
    legs = model.leg_conditions(values, factor.conditions())
    if factor.on_legs and any(p.against == "reversal" for p in several):
        half = np.ptp(model.geometry.stroke) / 2
        after = factor.readings.built_up([half * length for length in BUILD_UP.lengths])
        legs = tuple(replace(c, built_up=tuple(after[:, :, k])) for k, c in enumerate(legs))
    for place in several:
        functions = place.prior_sd * np.stack(place.functions(legs[place.leg]), axis=1)
        rows = by_joints(_joint_shares(place), functions)
        if place.moves_bar_ends and factor.on_legs:
            rows += _carriage_shift_at_dials(place, factor.readings)[:, None] * functions
        yield rows


def plate_shape_columns(problem: Problem) -> tuple[Array, Array]:
    """Rows ``(n, F)`` by the own shapes of every probed plate, and their standard deviations."""
    columns, sd = [np.zeros((len(problem.measured), 0))], list[float]()
    for k, factor, number, setup in problem.tool_setups:
        if setup.observation.touches:
            at = np.flatnonzero(factor.setup == number)
            for shape, size in residual_plate_shapes(
                factor.normalized_plate_xy[at], problem.machine.geometry.scale
            ):
                column = np.zeros((len(problem.measured), 1))
                column[problem.factor_rows[k].start + at, 0] = shape * size
                columns.append(column)
                sd.append(size)
    return np.hstack(columns), np.array(sd)


def _joint_shares(place: FreeForm) -> Array:
    """Share of every virtual joint in a place ``(30,)``."""
    names = VIRTUAL_NAMES
    joints = np.zeros(len(LEGS) * len(names))
    for leg in [place.leg] if place.leg >= 0 else range(len(LEGS)):
        for joint, share in place.joints:
            joints[leg * len(names) + names.index(joint)] = share
    return joints


def _carriage_shift_at_dials(place: FreeForm, campaign: Readings) -> Array:
    """What dials show ``(n,)`` of a leg that moves along a place's direction as a whole."""
    sees = [s.sign * (s.leg == place.leg and LEGS[s.axis] == place.direction)
            for s in campaign.setups]  # fmt: skip
    return np.take(np.asarray(sees, dtype=float), campaign.setup)


def dial_curve_columns(
    problem: Problem, value: Array, rest: Array
) -> tuple[list[Array], tuple[FreeForm, ...]]:
    """Rows ``(n, K)`` by the coefficients of each of the dials' places in its unit, and the places.

    Args:
        problem: its campaigns.
        value: predicted readings ``(n,)``, metres.
        rest: residuals of the readings that their bumps are to explain ``(n,)``, metres.
    """
    columns, found = list[Array](), list[FreeForm]()
    ways, turning = np.zeros(len(value)), 0
    scale = problem.machine.geometry.scale
    for campaign, part in zip(problem.campaigns, problem.leg_rows, strict=True):
        for k, setup in enumerate(campaign.setups):
            rows = part.start + np.flatnonzero(campaign.setup == k)
            time, shown = campaign.time[rows - part.start], value[rows]
            if np.ptp(shown) <= 0:
                continue
            name = setup.name if len(problem.campaigns) == 1 else f"{setup.name}@{campaign.name}"
            timed = np.isfinite(time).all() and np.ptp(time) > 0
            span = (float(time.min()), float(time.max())) if timed else None
            side = _plunger_direction(
                campaign, rows - part.start, shown, problem.measured[rows] - shown
            )
            range_ = (float(shown.min()), float(shown.max()))
            turns = bool((side > 0).any() and (side < 0).any())
            several = dial_free_forms(name, setup.leg, span, range_, turns, scale)
            # As commands are written: a corrected one is no part of what a bump is to explain.
            written = problem.measured[rows] - rest[rows]
            dents = [d for p in several if p.against == "reading"
                     for d in _dial_bumps(p, written, rest[rows] / problem.sigma[rows])]  # fmt: skip
            for place in (*several, *dents):
                low, high = place.span or (0.0, 1.0)
                by = time if place.against == "time" else written if place.is_local else shown
                functions = place.kernel.functions(2 * (by - low) / (high - low) - 1)
                block = np.zeros((len(value), len(functions)))
                block[rows] = np.stack(functions, axis=1) * place.prior_sd
                if place.against == "approach":
                    block[rows] *= side[:, None] / 2
                    ways[rows], turning = side / 2, turning + 1
                columns.append(block)
                found.append(place)
    if turning > 1:
        read = value[ways != 0]
        found.append(common_dial_form((float(read.min()), float(read.max())), scale))
        columns.append((ways * found[-1].prior_sd)[:, None])
    return columns, tuple(found)


def _dial_bumps(place: FreeForm, shown: Array, off: Array) -> Iterator[FreeForm]:
    """Yield a dial's place with a bump, at the readings that explain most of the residuals.

    Args:
        place: the dial's curve by its reading.
        shown: predicted readings of the dial ``(k,)``, metres.
        off: residuals there ``(k,)``, in sigmas; their median is the datum's.
    """
    at = np.unique(np.round(shown, 5))  # hundredths of a millimetre, by which a bump is named
    off = off - np.median(off)
    gain = np.empty((len(at), len(DIAL_BUMP_WIDTHS)))
    for k, width in enumerate(DIAL_BUMP_WIDTHS):
        about = np.exp(-0.5 * ((shown - at[:, None]) / width) ** 2)
        gain[:, k] = (about @ off) ** 2 / np.maximum(np.sum(about**2, axis=1), 1.0)
    for centre in descending(gain.max(axis=1), LOG_ODDS_MARGIN)[:_MOST_DIAL_BUMPS]:
        width = DIAL_BUMP_WIDTHS[largest(gain[centre], LOG_ODDS_MARGIN)]
        yield with_dial_bump(place, float(at[centre]), width, len(at))


def _plunger_direction(
    campaign: Readings, rows: NDArray[np.int64], shown: Array, off: Array
) -> Array:
    """Which way a dial's plunger came to some readings ``(k,)``: 1 as the reading grew, -1 as it
    fell, as before where it did not move; 0 where that is not known.

    If the direction is unknown or the last move was under 5 um, the reading is given the direction
    whose mean residual is nearer to its own. This is done only if the mean residuals of the two
    directions differ by more than three times their scatter.

    Args:
        campaign: of the readings.
        rows: of one setup within it ``(k,)``.
        shown: predicted there, metres ``(k,)``.
        off: measured less that, metres ``(k,)``.
    """
    order = np.argsort(campaign.order[rows], kind="stable")
    moved = np.diff(shown[order], prepend=shown[order][:1])
    way = np.where(np.abs(moved) > _LEAST_DIAL_MOVE, np.sign(moved), 0.0)
    last = np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))
    side, size = np.empty(len(way)), np.empty(len(way))
    side[order], size[order] = way[last], np.abs(moved)[last]
    # Moves that were not recorded came between.
    side *= (campaign.approach == campaign.derived_approach).all(axis=1)[rows]
    clear = (side != 0) & (size > _CLEAR_DIAL_MOVE)
    groups = [off[clear & (side == way)] for way in (1, -1)]
    if min(map(len, groups)) < 2:
        return side
    grown, fallen = map(np.mean, groups)
    scatter = np.sqrt(np.mean(np.concatenate([g - g.mean() for g in groups]) ** 2))
    if abs(grown - fallen) <= _DIRECTION_SEPARATION * scatter:
        return side
    nearer = np.where(np.abs(off - grown) < np.abs(off - fallen), 1.0, -1.0)
    return np.where(clear, side, nearer)
