"""Changes between campaigns: a parameter with one value before a file and another from it on.

Campaigns are those of dials, in their order; without dials the files of the tool, where each reads
the same setups as the others.

The hypothesis "this parameter changed" is a column of its own in the readings: what the parameter
does to those of the later files, with the tolerance as the prior of the difference. Where the
parameter is not free in the fit its common value is allowed as well. Changes are weighed like
faults of the data, on the same station means and in the same form of evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Change, Problem, with_free
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_LARGEST = 3.0
"""Tolerances that a repair may take back where dials do not fix its size: what an instrument at the
tool hardly shows is no less likely for that."""

_CLASS_WIDTH = 4.0  # fall of chi2 within which two changes cannot be told apart (Wilks)


def visits(problem: Problem) -> tuple[tuple[str, str, int], ...]:
    """Campaigns between which something may have changed: name, file, and first row."""
    if problem.campaigns:
        read = [(c.name, c.file) for c in problem.campaigns]
    elif len({frozenset(f.setup_names) for f in problem.factors}) == 1:
        read = [(f.name, f.points.file) for f in problem.points]
    else:
        return ()
    return tuple(
        (name, file or name, rows.start)
        for (name, file), rows in zip(read, problem.factor_rows, strict=False)
    )


@dataclass(frozen=True)
class _Hypothesis:
    """A parameter that changed, and how well that explains a residual.

    Attributes:
        parameter: with the campaign from which it has another value.
        gain: fall of chi2, the prior counted.
        prior: part of the new chi2 that is the prior's.
        occam: log det(S^T S + 1), S its columns at their tolerances.
        size: by how much it changed, in what its columns stand for.
    """

    parameter: Parameter
    gain: float
    prior: float
    occam: float
    size: float

    @classmethod
    def of(cls, parameter: Parameter, columns: Array, residual: Array) -> _Hypothesis:
        """Weigh columns at their tolerances ``(g, k)`` against a residual ``(g,)``."""
        left, singular, right = np.linalg.svd(columns, full_matrices=False)
        square, shown = singular**2, left.T @ residual
        along = shown**2 * square / (1 + square)
        prior, occam = np.sum(along / (1 + square)), np.sum(np.log1p(square))
        size = right[:, -1] @ (shown * singular / (1 + square))
        return cls(parameter, float(np.sum(along)), float(prior), float(occam), float(size))


def likeliest_change(means: StationMeans) -> Change | None:
    """The change that explains a residual best, whatever its evidence.

    Args:
        means: of what a fit leaves.

    Returns:
        The change without values, or ``None`` where there is one campaign only.
    """
    problem, several = means.problem, visits(means.problem)
    if len(several) < 2:
        return None
    tried = list(_hypotheses(means, several))
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
    sizes = {name: float("nan")}
    for k in near:
        plain = tried[k].parameter.plain
        sizes[plain] = tried[k].size * _scale(problem) * problem.machine.tolerance(plain)
    members = tuple(sizes)
    first = [stem for stem, _, _ in several].index(since)
    before, after = (file for _, file, _ in several[first - 1 : first + 1])
    return Change(
        name, members, since, (before, after), float(evidence[near].max()),
        problem.machine.catalogue,
        sizes=tuple(sizes.values()),
    )  # fmt: skip


def _hypotheses(
    means: StationMeans, several: Sequence[tuple[str, str, int]]
) -> Iterator[_Hypothesis]:
    """Every parameter of the machine, and without dials of plates and patterns of equal legs too,
    from every campaign but the first on.
    """
    slopes = _slopes(means)
    fitted, dials = {name.plain for name in means.problem.names}, means.problem.campaigns
    for (plain, slope), (stem, _, start) in product(slopes.items(), several[1:]):
        # A value that stays would draw what causes do beside the change, where all draw alike.
        common = [] if plain in fitted or not dials else [slope]
        later = np.where(np.arange(len(slope)) >= start, slope, 0.0)
        if plain.setup or plain.at(stem) not in means.signatures.slopes:
            columns = means.shown(np.stack([*common, later], axis=1))
            yield _Hypothesis.of(plain.at(stem), columns, means.residual)


def _scale(problem: Problem) -> float:
    return 1.0 if problem.campaigns else _LARGEST


def _slopes(means: StationMeans) -> dict[Parameter, Array]:
    """Readings ``(n,)`` by what may have changed, at its tolerance, or what a repair takes."""
    problem, catalogue = means.problem, means.problem.machine.catalogue
    largest = _scale(problem)
    found: dict[Parameter, Array] = {}
    for name, slope in means.signatures.slopes.items():
        plain = catalogue.parameter(name).plain
        effect = catalogue.effect_of(plain)
        if not effect.of_dial or (effect.plate and not plain.member):
            one = slope * problem.machine.tolerance(plain) * largest
            found[plain] = found[plain] + one if plain in found else one
    if not problem.campaigns:
        for name in dict.fromkeys(plain.effect for plain in found if not plain.setup):
            for member, weights in catalogue.structured(name).items():
                if set(weights) <= set(found):
                    parts = [w * found[part] for part, w in weights.items()]
                    found[member] = np.sum(parts, axis=0)
    return found


def separated(problem: Problem, changes: Sequence[Change]) -> Problem:
    """The problem with the changed parameters free and separate before and after the change."""
    changed = [change.parameter for change in changes]
    own = (*problem.own, *(name for change in changes for name in change.own))
    kept = tuple(u for u in problem.unknowns if u.name.plain not in changed)
    return with_free(replace(problem, unknowns=kept, own=own), changed)
