"""Changes between campaigns: a parameter with one value before a file and another from it on.

The hypothesis "this parameter changed" is a column of its own in the readings: what the parameter
does to those of the later files, with the tolerance as the prior of the difference. Where the
parameter is not free in the fit its common value is allowed as well. Changes are weighed like
faults of the data, on the same station means and in the same form of evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Change, Problem, with_free
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_CLASS_WIDTH = 4.0  # fall of chi2 within which two changes cannot be told apart (Wilks)


@dataclass(frozen=True)
class _Hypothesis:
    """A parameter that changed, and how well that explains a residual.

    Attributes:
        parameter: with the campaign from which it has another value.
        gain: fall of chi2, the prior counted.
        prior: part of the new chi2 that is the prior's.
        occam: log det(S^T S + 1), S its columns at their tolerances.
    """

    parameter: Parameter
    gain: float
    prior: float
    occam: float

    @classmethod
    def of(cls, parameter: Parameter, columns: Array, residual: Array) -> _Hypothesis:
        """Weigh columns at their tolerances ``(g, k)`` against a residual ``(g,)``."""
        left, singular, _ = np.linalg.svd(columns, full_matrices=False)
        square = singular**2
        along = (left.T @ residual) ** 2 * square / (1 + square)
        prior, occam = np.sum(along / (1 + square)), np.sum(np.log1p(square))
        return cls(parameter, float(np.sum(along)), float(prior), float(occam))


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
    tried = list(_hypotheses(means))
    gain, prior, occam = np.array([(h.gain, h.prior, h.occam) for h in tried]).T
    left = means.chi2 - gain
    evidence = means.evidence(left) - occam / 2 - np.log(len(tried))
    # Which one is it, once something changed: what is left makes the readings worse witnesses, not
    # the tolerances wider.
    scale = max(means.floor, float(left[np.argmax(evidence)]) / means.dof)
    best = int(np.argmin(np.round((left - prior) / scale + prior + occam, 2)))
    name, since = tried[best].parameter.plain, tried[best].parameter.campaign
    near = [
        k
        for k in np.flatnonzero(left <= left[best] + _CLASS_WIDTH * scale)
        if tried[k].parameter.campaign == since
    ]
    members = tuple(dict.fromkeys((name, *(tried[k].parameter.plain for k in near))))
    first = [c.name for c in problem.campaigns].index(since)
    before, after = (c.file or c.name for c in problem.campaigns[first - 1 : first + 1])
    unit = problem.machine.catalogue.effect_of(name).unit
    return Change(name, members, since, (before, after), float(evidence[near].max()), unit)


def _hypotheses(means: StationMeans) -> Iterator[_Hypothesis]:
    """Every single parameter of the machine, from every campaign but the first on."""
    problem, catalogue = means.problem, means.problem.machine.catalogue
    slopes: dict[Parameter, Array] = {}
    for name, slope in means.signatures.slopes.items():
        plain = catalogue.parameter(name).plain
        if not catalogue.effect_of(plain).of_dial:
            slopes[plain] = slopes.get(plain, 0.0) + slope * problem.machine.tolerance(plain)
    fitted = {name.plain for name in problem.names}
    for plain, slope in slopes.items():
        common = [] if plain in fitted else [slope]
        for campaign, rows in zip(problem.campaigns[1:], problem.rows[1:], strict=True):
            since = plain.at(campaign.name)
            if since not in means.signatures.slopes:
                later = np.where(np.arange(len(slope)) >= rows.start, slope, 0.0)
                columns = means.shown(np.stack([*common, later], axis=1))
                yield _Hypothesis.of(since, columns, means.residual)


def separated(problem: Problem, changes: Sequence[Change]) -> Problem:
    """The problem with the changed parameters free and separate before and after the change."""
    changed = [change.parameter for change in changes]
    own = (*problem.own, *(name for change in changes for name in change.own))
    kept = tuple(u for u in problem.unknowns if u.name.plain not in changed)
    return with_free(replace(problem, unknowns=kept, own=own), changed)
