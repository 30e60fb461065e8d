"""Changes between campaigns: a parameter with one value before a file and another from it on.

The hypothesis "this parameter changed" is a column of its own in the readings: what the parameter
does to those of the later files, with the tolerance as the prior of the difference. Where the
parameter is not free in the fit its common value is allowed as well. Changes are weighed like
faults of the data, on the same station means and in the same form of evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Change, Problem, build_unknowns
from orthoglide.geometry import Array

_SIGNIFICANT = 3.0  # sigmas
_CLASS_WIDTH = 4.0  # fall of chi2 within which two changes cannot be told apart (Wilks)


def likeliest_change(means: StationMeans) -> Change | None:
    """The change that explains a residual best, whatever its evidence.

    Args:
        means: of what a fit leaves.

    Returns:
        The change without values, or ``None`` where there is one campaign only.
    """
    problem = means.problem
    if len(problem.campaigns) < 2:
        return None
    hypotheses = _hypotheses(means)
    scoring = Scoring.of(hypotheses, hypotheses.candidates)
    left = means.chi2 - scoring.gains(means.residual)
    evidence = means.evidence(left) - scoring.occam / 2 - np.log(len(left))
    # Which one is it, once something changed: what is left makes the readings worse witnesses, not
    # the tolerances wider.
    scale = max(means.floor, float(left[np.argmax(evidence)]) / means.dof)
    prior = _squared_tolerances(scoring, means.residual)
    best = int(np.argmin(np.round((left - prior) / scale + prior + scoring.occam, 2)))
    plain, _, since = hypotheses.candidates[best].name.partition("@")
    near = [
        k
        for k, candidate in enumerate(hypotheses.candidates)
        if left[k] <= left[best] + _CLASS_WIDTH * scale and candidate.name.endswith(f"@{since}")
    ]
    names = (hypotheses.candidates[k].name.partition("@")[0] for k in near)
    members = tuple(dict.fromkeys((plain, *names)))
    first = [c.name for c in problem.campaigns].index(since)
    before, after = (c.file or c.name for c in problem.campaigns[first - 1 : first + 1])
    unit = problem.machine.catalogue.effect_of(plain).unit
    return Change(plain, members, since, (before, after), float(evidence[near].max()), unit)


def _squared_tolerances(scoring: Scoring, residual: Array) -> Array:
    """What the prior adds to chi2 for the best fitting change of each candidate ``(C,)``."""
    pairs = zip(scoring.basis, scoring.shrink, strict=True)
    return np.array([np.sum(s * (1 - s) * (basis.T @ residual) ** 2) for basis, s in pairs])


def _hypotheses(means: StationMeans) -> Signatures:
    """Changes of all single parameters before all campaigns but the first, as candidates."""
    problem, base = means.problem, means.signatures
    catalogue = problem.machine.catalogue
    slopes: dict[str, Array] = {}
    for name, slope in base.slopes.items():
        if not catalogue.effect_of(name).of_dial:
            plain = name.partition("@")[0]
            slopes[plain] = slopes.get(plain, 0.0) + slope
    fitted = {n.partition("@")[0] for n in problem.names}
    names: list[str] = []
    columns: list[Array] = []
    found: list[Candidate] = []
    for plain, slope in slopes.items():
        names.append(plain)
        columns.append(slope)
        for campaign, rows in zip(problem.campaigns[1:], problem.rows[1:], strict=True):
            since = f"{plain}@{campaign.name}"
            if since in base.slopes:
                continue  # has values of its own from there on already
            names.append(since)
            columns.append(np.where(np.arange(base.count) >= rows.start, slope, 0.0))
            parts = (since,) if plain in fitted else (plain, since)
            effect = catalogue.effect_of(plain).name
            found.append(Candidate(since, effect, parts, tuple({n: 1.0} for n in parts)))
    tolerance = [problem.machine.tolerance(n.partition("@")[0]) for n in names]
    return replace(
        base,
        names=tuple(names),
        tolerance=np.array(tolerance),
        columns=means.by_reading @ np.stack(columns, axis=1),
        candidates=tuple(found),
    )


def separated(problem: Problem, changes: Sequence[Change]) -> Problem:
    """The problem with the changed parameters free and separate before and after the change."""
    own = (*problem.own, *(name for change in changes for name in change.own))
    unknowns = {u.name: u for u in problem.unknowns}
    for change in changes:
        unknowns = {n: u for n, u in unknowns.items() if n.partition("@")[0] != change.parameter}
        free = build_unknowns(problem.machine, problem.factors, [change.parameter], own)
        unknowns |= {u.name: u for u in free}
    held = tuple(
        {n: v for n, v in values.items() if not any(n in u.parts[k] for u in unknowns.values())}
        for k, values in enumerate(problem.held)
    )
    return replace(problem, unknowns=tuple(unknowns.values()), held=held, own=own)
