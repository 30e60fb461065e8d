"""Scores of a result on readings held out and on measured TCP points, which are not fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from orthoglide.accuracy import tcp_map
from orthoglide.closing.outcome import RunOutcome
from orthoglide.fit import assemble, solve
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.fit.noise import rms_by_unit
from orthoglide.fit.scores import FittedRows
from orthoglide.geometry import Array, align_points
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.numerals import SIGMAS_95, ByUnit, compact, distinct_figures
from orthoglide.observations import Readings
from orthoglide.observations.readings import Points
from orthoglide.observations.tables import shared_fraction
from orthoglide.prediction import Conditions
from orthoglide.result import HoldOut, Request, TcpErrors

_CLEAR_RATIO = 1.05  # least ratio of two errors held out that is told from chance
_MAX_ERROR_RATIO = 3.0  # ratio of errors to expected errors from which points fit no machine


def validation_readings(request: Request) -> tuple[Readings, ...]:
    """Return the readings and points held out, which are not fitted."""
    return (*request.holdout, *([] if request.tcp is None else [request.tcp]))


def validate(outcome: RunOutcome) -> RunOutcome:
    """Return an outcome with the scores of the readings and points held out, and with warnings if
    they contradict the stated errors or were fitted too.
    """
    request, machine = outcome.request, outcome.machine
    problem, after = outcome.before.problem, outcome.values
    before = problem.values(problem.last_factor_index, outcome.before.x)
    scores, errors, notes = None, None, list[str]()
    if held := request.holdout:
        scores = HoldOut(*(held_out_rms(v, machine, held, request.own) for v in (before, after)))
    if request.tcp is not None:
        stated_sigma = tcp_map(outcome.machine, request.tcp.points().command).sigma
        errors = tcp_errors(machine, request.tcp, before, after, stated_sigma)
        points = request.tcp.points()
        notes.append(points_contradiction(errors["translation"], stated_sigma, points))
    pairs = product(validation_readings(request), request.given)
    share = max((shared_fraction(*pair) for pair in pairs), default=0.0)
    if share > 0.5:
        notes.append(
            f"{100 * share:.0f} % of the readings held out were also fitted, so they do not test "
            f"the result; hold out other readings"
        )
    scored = replace(outcome, hold_out=scores, tcp=errors)
    scored = replace(scored, zeros_confirmed=_confirms_zeros(scored))
    return scored.with_warnings(*(Note(text, "holdout") for text in notes if text))


def _confirms_zeros(outcome: RunOutcome) -> bool:
    """Return whether readings and points held out confirm the new zeros where they contradict what
    was found.

    They do if the new zeros alone predict them clearly better than the nominal machine does, and
    if the old zero of no single drive clearly improves on the new one.
    """
    request = outcome.request
    if not outcome.stands or not outcome.refuted or outcome.contradicted != outcome.refuted:
        return False
    if request.machine.spec.printer is not None or outcome.sizes is not None:
        return False  # their controllers take sizes besides zeros
    zeros = outcome.zeros_alone.values
    others = [{}, *({n: v for n, v in zeros.items() if n != old} for old in zeros)]
    of_zeros, nominal, *with_old = (_errors_held_out(v, request) for v in (zeros, *others))
    no_worse = [of_zeros < errors * _CLEAR_RATIO for errors in with_old]
    return bool(np.all([of_zeros < nominal / _CLEAR_RATIO, *no_worse]))


def _errors_held_out(values: Mapping[str, float], request: Request) -> Array:
    """Return the error of a machine at the readings held out, the product over their units, and the
    one at the points ``(k,)``, of which only ratios mean something; ``values``: parameters, SI.
    """
    machine, errors = request.machine, list[float]()
    if held := request.holdout:
        rms = held_out_rms(values, machine, held, request.own)
        errors.append(math.prod(rms.shown.values()))
    if request.tcp is not None:
        errors.append(tcp_errors(machine, request.tcp, values, values)["translation"].before_mean)
    return np.array(errors)


def held_out_rms(
    values: Mapping[str, float],
    machine: Machine,
    held: Sequence[Readings],
    per_campaign: Sequence[str] = (),
) -> ByUnit:
    """Return the root mean square residual of readings that a machine was not fitted to; ``values``
    are its parameters, SI.

    Parameters specific to a campaign, its datums and its placements (of the tool's instruments all
    parameters of a setup) are fitted to the campaign itself, each time without the reading scored.
    """
    machine_values = machine.catalogue.machine_values(values)
    free = per_campaign or machine.catalogue.base
    problem = assemble(held, machine.with_only(machine_values), free)
    if per_campaign:
        rows = solve(problem, method="nested").rows
    else:
        problem = replace(problem, unknowns=(), held=(machine_values,) * len(problem.factors))
        linearised = linearise(problem, np.zeros(0))
        nuisance = nuisances(problem, linearised.reading_poses)
        rows = FittedRows.from_fit(problem, nuisance, linearised)
    share = 1 - rows.leverage  # of the residual of a reading that its own fit leaves
    return rms_by_unit(rows.residual / np.where(share > 1e-6, share, np.nan), problem.angular)


def points_contradiction(errors: TcpErrors, stated_sigma: Array, points: Points) -> str:
    """Return how measured points contradict the machine both with and without the finding, a
    clause; empty if they do not, or if their accuracy is unknown. The errors are after the best
    translation; ``stated_sigma`` is that of the calibrated machine ``(n, 3)``, metres.
    """
    declared_sigma = _declared_sigma(points)
    if not declared_sigma.any():
        return ""
    expected = float(np.sqrt(np.mean(np.sum(stated_sigma**2 + declared_sigma**2, axis=1))))
    if min(errors.before_mean, errors.after_mean) < _MAX_ERROR_RATIO * expected:
        return ""
    before, after = distinct_figures(errors.before_mean * 1e3, errors.after_mean * 1e3)
    return (
        f"the measured points fit this result neither with nor without what was found: the tool is "
        f"{after} and {before} mm off, where {compact(expected * 1e3, 2)} mm are to be expected; "
        f"look for what moved, or check the frame and the sigma of the points"
    )


def _declared_sigma(points: Points) -> Array:
    """Return the declared standard deviation of a coordinate ``(m, 1)``, metres; 0 without one."""
    return np.nan_to_num(points.sigma)[:, None]


def tcp_errors(
    machine: Machine,
    given: Readings,
    before: Mapping[str, float],
    after: Mapping[str, float],
    sigma: Array | None = None,
) -> dict[str, TcpErrors]:
    """Return errors at TCP points by alignment: none, the best translation, a rigid motion.

    ``before`` and ``after`` are parameters, SI; ``sigma`` is the standard deviation for ``after``,
    best translation removed ``(n, 3)``, metres, to which that of the points is added.
    """
    points = given.points()
    conditions = Conditions.from_commands(points.command, approach=points.approach)
    errors, declared_sigma = {}, _declared_sigma(points)
    predicted = {
        name: machine.model.outputs(values, conditions).p
        for name, values in (("nominal", {}), ("before", before), ("after", after))
    }
    for fit in ("none", "translation", "rigid"):
        figures, inside = {}, float("nan")
        for name, p in predicted.items():
            difference = _aligned(p, points.p, fit) - points.p
            distance = np.sqrt(np.nansum(difference**2, axis=1))
            figures[f"{name}_mean"] = float(distance.mean())
            figures[f"{name}_max"] = float(distance.max())
        if sigma is not None and fit == "translation":  # of `after`, the last
            within = np.abs(difference) <= SIGMAS_95 * np.hypot(sigma, declared_sigma)
            inside = float(np.mean(within[np.isfinite(difference)]))
        errors[fit] = TcpErrors(**figures, inside=inside)
    return errors


def _aligned(p: Array, measured: Array, fit: str) -> Array:
    """Return predicted points aligned with the measured ones, as ``fit`` says."""
    if fit == "none":
        return p
    complete = np.isfinite(measured).all(axis=1)
    if fit == "translation" or complete.sum() < 3:
        return p + np.nanmean(measured - p, axis=0)
    return align_points(p, p[complete], measured[complete])
