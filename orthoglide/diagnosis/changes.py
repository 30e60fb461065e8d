"""Changes between campaigns: a parameter with one value before a file and another from it on.

The hypothesis "this parameter changed" is a column of its own in the readings: what the parameter
does to those of the later files, with the tolerance as the prior of the difference. Where the
parameter is not free in the fit its common value is allowed as well. Changes are weighed like
faults of the data, on the same station means and in the same form of evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.fault_view import View
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.effects import family_of, is_dial
from orthoglide.fit import Estimate, Problem, build_unknowns
from orthoglide.geometry import Array
from orthoglide.numerals import compact
from orthoglide.units import Unit

_SIGNIFICANT = 3.0  # sigmas
_CLASS_WIDTH = 4.0  # fall of chi2 within which two changes cannot be told apart (Wilks)


@dataclass(frozen=True)
class Change:
    """A parameter of the machine that is not the same in all campaigns.

    Attributes:
        parameter: the most probable one.
        members: all parameters whose change these readings cannot tell from its, itself first.
        since: name of the first campaign after the change.
        between: files, or names, of the last campaign before and the first after the change.
        evidence: log Bayes factor in its favour, the number of its like discounted.
        before: value before the change, SI.
        after: value after the change, SI.
        sigma: standard deviation of the difference, SI.
        sigma_after: standard deviation of the value after the change, SI.
    """

    parameter: str
    members: tuple[str, ...]
    since: str
    between: tuple[str, str]
    evidence: float
    before: float = float("nan")
    after: float = float("nan")
    sigma: float = float("nan")
    sigma_after: float = float("nan")

    @property
    def unit(self) -> Unit:
        """Unit of the parameter in files."""
        return family_of(self.parameter).unit

    @property
    def message(self) -> str:
        """One sentence: between which files, what, from what to what."""
        si, name = self.unit.si, self.unit.name
        before, after, sigma = (compact(v / si) for v in (self.before, self.after, self.sigma))
        others = f" (or {', '.join(self.members[1:])})" if len(self.members) > 1 else ""
        return (
            f"between {_file(self.between[0])} and {_file(self.between[1])} "
            f"{self.parameter}{others} changed from {before} to {after} {name} (± {sigma})"
        )

    @property
    def own(self) -> tuple[str, ...]:
        """What is separate from ``since`` on, as ``build_problem`` takes it."""
        return tuple(f"{name}@{self.since}" for name in self.members)

    @property
    def is_cause(self) -> bool:
        """Whether the parameter still has an error after the change that these readings show."""
        return abs(self.after) > _SIGNIFICANT * self.sigma_after

    def measured(self, estimate: Estimate) -> Change:
        """With the values of a fit in which the parameter, or a member instead, is separate."""
        for name in self.members:
            pair = _either_side(estimate.problem, name, self.since)
            if pair is None:
                continue
            (before, after), spread = estimate.x[pair], estimate.covariance[np.ix_(pair, pair)]
            sigma = np.sqrt(spread[0, 0] + spread[1, 1] - 2 * spread[0, 1])
            others = tuple(n for n in self.members if n != name)
            return replace(
                self,
                parameter=name,
                members=(name, *others),
                before=float(before),
                after=float(after),
                sigma=float(sigma),
                sigma_after=float(np.sqrt(spread[1, 1])),
            )
        return self


def _file(path: str) -> str:
    return path.rpartition("/")[2]


def _either_side(problem: Problem, name: str, since: str) -> list[int] | None:
    """Places of the unknowns before and after a change."""
    places = [k for k, n in enumerate(problem.names) if n.partition("@")[0] == name]
    for one, other in pairwise(places):
        if problem.names[other] == f"{name}@{since}":
            return [one, other]
    return None


def likeliest_change(view: View) -> Change | None:
    """The change that explains a residual best, whatever its evidence.

    Args:
        view: station means of what a fit leaves.

    Returns:
        The change without values, or ``None`` where there is one campaign only.
    """
    problem = view.seen.estimate.problem
    if len(problem.campaigns) < 2:
        return None
    hypotheses = _hypotheses(view.seen)
    means = replace(hypotheses, columns=view.averaging.T @ hypotheses.columns)
    scoring = Scoring.of(means, hypotheses.candidates)
    left = view.chi2 - scoring.gains(view.residual)
    evidence = view.evidence(left) - scoring.occam / 2 - np.log(len(left))
    # Which one is it, once something changed: what is left makes the readings worse witnesses, not
    # the tolerances wider.
    scale = max(view.floor, float(left[np.argmax(evidence)]) / view.dof)
    prior = _squared_tolerances(scoring, view.residual)
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
    return Change(plain, members, since, (before, after), float(evidence[near].max()))


def _squared_tolerances(scoring: Scoring, residual: Array) -> Array:
    """What the prior adds to chi2 for the best fitting change of each candidate ``(C,)``."""
    pairs = zip(scoring.basis, scoring.shrink, strict=True)
    return np.array([np.sum(s * (1 - s) * (basis.T @ residual) ** 2) for basis, s in pairs])


def _hypotheses(seen: Signatures) -> Signatures:
    """Changes of all single parameters before all campaigns but the first, as candidates."""
    problem = seen.estimate.problem
    slopes: dict[str, Array] = {}
    for name, slope in seen.slopes.items():
        if not is_dial(name):
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
            if since in seen.slopes:
                continue  # has values of its own from there on already
            names.append(since)
            columns.append(np.where(np.arange(seen.count) >= rows.start, slope, 0.0))
            parts = (since,) if plain in fitted else (plain, since)
            found.append(
                Candidate(since, family_of(plain).name, parts, tuple({n: 1.0} for n in parts))
            )
    tolerance = [problem.machine.tolerance(n.partition("@")[0]) for n in names]
    return replace(
        seen,
        names=tuple(names),
        tolerance=np.array(tolerance),
        columns=seen.whiten(np.stack(columns, axis=1)),
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
