"""Judging a finished result on what was not used: readings held out, and TCP points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.fit import assemble, solve
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.fit.scores import FittedRows, rms_by_unit
from orthoglide.geometry import Array, align_points
from orthoglide.machine import Machine
from orthoglide.numerals import SIGMAS_95, ByUnit, compact, distinct_figures
from orthoglide.observations import Readings
from orthoglide.observations.readings import Points
from orthoglide.prediction import Conditions
from orthoglide.result import HoldOut, TcpErrors

_MAX_ERROR_RATIO = (
    3.0  # ratio of errors to what is expected of them from which points fit no machine
)


def hold_out(
    before: Mapping[str, float],
    after: Mapping[str, float],
    machine: Machine,
    held: Sequence[Readings],
    own: Sequence[str] = (),
) -> HoldOut:
    """Return the scores of two machines on readings that neither was fitted to.

    What is own to a campaign, its datums and its placements (of the tool's instruments all that a
    setup brings) are fitted to the campaign itself; the reading scored is left out each time.

    Args:
        before: parameters of the base model, SI.
        after: parameters of the extended model, SI.
        machine: tolerances and dimensions.
        held: out, of any kinds.
        own: families or parameters that each campaign has for itself.
    """
    return HoldOut(*(_held_out_rms(values, machine, held, own) for values in (before, after)))


def _held_out_rms(
    values: Mapping[str, float], machine: Machine, held: Sequence[Readings], own: Sequence[str]
) -> ByUnit:
    kept = machine.catalogue.machine_values(values)
    problem = assemble(held, machine.with_only(kept), own or machine.catalogue.base)
    if own:
        rows = solve(problem, method="nested").rows
    else:
        problem = replace(problem, unknowns=(), held=(kept,) * len(problem.factors))
        at = linearise(problem, np.zeros(0))
        rows = FittedRows.from_fit(problem, nuisances(problem, at.reading_poses), at)
    left = 1 - rows.leverage
    scored = np.where(left > 1e-6, left, np.nan)
    return rms_by_unit(rows.residual / scored, problem.angular)


def points_contradiction(errors: TcpErrors, stated: Array, points: Points) -> str:
    """Return that measured points contradict the machine with and without the finding, a clause;
    empty if they do not, or if their accuracy is unknown.

    Args:
        errors: best translation removed.
        stated: standard deviations of the machine with what was found ``(n, 3)``, metres.
        points: measured.
    """
    known = _declared_sigma(points)
    if not known.any():
        return ""
    expected = float(np.sqrt(np.mean(np.sum(stated**2 + known**2, axis=1))))
    if min(errors.before_mean, errors.after_mean) < _MAX_ERROR_RATIO * expected:
        return ""
    before, after = distinct_figures(errors.before_mean * 1e3, errors.after_mean * 1e3)
    return (
        f"the measured points fit this result neither with nor without what was found: the tool is "
        f"{after} and {before} mm off, where {compact(expected * 1e3, 2)} mm are to be expected; "
        f"look for what moved, or check the frame and the sigma of the points"
    )


def _declared_sigma(points: Points) -> Array:
    """Return the declared standard deviation of a coordinate ``(m, 1)``, metres; 0 if there is
    none.
    """
    return np.nan_to_num(points.sigma)[:, None]


def tcp_errors(
    machine: Machine,
    given: Readings,
    before: Mapping[str, float],
    after: Mapping[str, float],
    sigma: Array | None = None,
) -> dict[str, TcpErrors]:
    """Return errors at TCP points: as they are, after the best translation, and after a rigid
    motion.

    Args:
        machine: dimensions.
        given: measured positions; missing coordinates are left out.
        before: parameters of the base model, SI.
        after: parameters of the extended model, SI.
        sigma: stated for ``after``, best translation removed ``(n, 3)``, metres; what the points
            are known to counts beside it.
    """
    points = given.points()
    conditions = Conditions.from_commands(points.command, approach=points.approach)
    found = {}
    predicted = {
        name: machine.model.outputs(values, conditions).p
        for name, values in (("nominal", {}), ("before", before), ("after", after))
    }
    for fit in ("none", "translation", "rigid"):
        figures, inside = {}, float("nan")
        for name, p in predicted.items():
            apart = _aligned(p, points.p, fit) - points.p
            distance = np.sqrt(np.nansum(apart**2, axis=1))
            figures[f"{name}_mean"] = float(distance.mean())
            figures[f"{name}_max"] = float(distance.max())
        if sigma is not None and fit == "translation":  # of `after`, the last
            known = np.isfinite(apart)
            both = np.hypot(sigma, _declared_sigma(points))
            inside = float(np.mean(np.abs(apart[known]) <= SIGMAS_95 * both[known]))
        found[fit] = TcpErrors(**figures, inside=inside)
    return found


def _aligned(p: Array, measured: Array, fit: str) -> Array:
    """Return predicted points after no motion, a translation, or a rigid motion onto the measured
    ones.
    """
    if fit == "none":
        return p
    complete = np.isfinite(measured).all(axis=1)
    if fit == "translation" or complete.sum() < 3:
        return p + np.nanmean(measured - p, axis=0)
    return align_points(p, p[complete], measured[complete])
