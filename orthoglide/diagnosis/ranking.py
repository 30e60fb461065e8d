"""One round of the search: what is left, which causes explain it, which cannot be told apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.accuracy import workspace
from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.significance import (
    Detection,
    detect,
    name_p_value,
    station_degrees,
)
from orthoglide.errors import InputError, NumericsError
from orthoglide.fit import Estimate, Problem, solve, with_free
from orthoglide.fit.least_squares import normal
from orthoglide.geometry import Array
from orthoglide.observations import Campaign
from orthoglide.progress import Progress, Step

CLASS_WIDTH = 4.0
"""Fall of chi2 within which two causes cannot be told apart (Wilks: two sigmas)."""

_REFITS = 8
# Linearised at the fit, a large effect's fall of chi2 is off by second-order terms.
_MARGIN, _RELATIVE_MARGIN = 12.0, 0.03
_PLAUSIBLE = 4.0  # tolerances


@dataclass(frozen=True)
class CandidateFit:
    """A candidate identified properly, with everything else freed again.

    Attributes:
        candidate: what was added.
        estimate: the fit with it.
        evidence: log of the marginal likelihood, by Laplace; differences matter.
    """

    candidate: Candidate
    estimate: Estimate
    evidence: float

    @property
    def chi2(self) -> float:
        """Of the fit, priors included."""
        return self.estimate.scores.cost

    @property
    def plausible(self) -> bool:
        """Whether every parameter that was added stays within four tolerances."""
        problem = self.estimate.problem
        sizes = dict(zip(problem.names, np.abs(self.estimate.x) / problem.tolerance, strict=True))
        return all(sizes.get(p, 0.0) <= _PLAUSIBLE for p in self.candidate.parameters)


def log_evidence(estimate: Estimate) -> float:
    """Laplace's approximation of the log marginal likelihood, unknowns in prior widths."""
    here = normal(estimate.problem, estimate.at, estimate.nuisance)
    scale = np.minimum(estimate.problem.prior_sd, 1e3 * estimate.problem.tolerance)
    info = here.information * scale * scale[:, None]
    return float(-here.cost / 2 - np.linalg.slogdet(info)[1] / 2)


def refit(base: Problem, added: Sequence[str], like: Estimate | None = None) -> Estimate:
    """Identify a problem with effects added, starting from a fit at hand.

    Args:
        base: without any effect.
        added: parameters to free besides.
        like: a fit to start from; unknowns of the same name keep their value.
    """
    problem = with_free(base, added)
    start = None
    if like is not None:
        known = like.values
        start = np.array([known.get(name, 0.0) for name in problem.names])
    return solve(problem, method="nested", start=start)


@dataclass(frozen=True)
class Diagnosis:
    """What one fit leaves, and how each candidate would explain it.

    Attributes:
        estimate: the fit.
        signatures: of all effects at it.
        scoring: of the candidates small enough to be added.
        detection: is anything left?
    """

    estimate: Estimate
    signatures: Signatures
    scoring: Scoring
    detection: Detection

    @cached_property
    def evidences(self) -> Array:
        """Linearised log Bayes factor of each candidate ``(C,)``."""
        return self.scoring.evidences(self.signatures.residual)

    @cached_property
    def gains(self) -> Array:
        """Linearised fall of chi2 of each candidate ``(C,)``."""
        return self.scoring.gains(self.signatures.residual)

    def naming(self, candidate: Candidate, rng: np.random.Generator) -> float:
        """p-value of the naming test."""
        place = self.scoring.candidates.index(candidate)
        return name_p_value(self.signatures, self.scoring, place, rng)


def diagnose(estimate: Estimate, budget: int, rng: np.random.Generator) -> Diagnosis:
    """Score every candidate of at most ``budget`` parameters at a fit, and test what is left."""
    seen = signatures(estimate)
    chosen = [c for c in seen.candidates if c.size <= budget]
    scoring = Scoring.of(seen, chosen)
    return Diagnosis(estimate, seen, scoring, detect(seen, scoring, rng))


def budget(seen: Signatures) -> int:
    """How many parameters may be added in all: fewer than a third of the degrees of freedom.

    Counted over station means: repeats say nothing more of a cause.
    """
    return max(int(np.ceil(station_degrees(seen) / 3)) - 1, 0)


def fit_candidates(
    base: Problem,
    added: Sequence[str],
    found: Diagnosis,
    progress: Progress,
    least: int = 1,
) -> list[CandidateFit]:
    """Identify the most promising candidates in the general mechanism, best first.

    Args:
        base: without effects.
        added: parameters that are in already.
        found: scores at the present fit.
        progress: called with each step.
        least: how many to try whatever their score.
    """
    order = np.argsort(-found.evidences, kind="stable")
    best = found.evidences[order[0]]
    margin = _MARGIN + _RELATIVE_MARGIN * max(float(found.gains[order[0]]), 0.0) / 2
    near = [k for i, k in enumerate(order) if i < least or best - found.evidences[k] <= margin]
    trials = []
    for k in near[:_REFITS]:
        candidate = found.scoring.candidates[k]
        progress(Step("trying", candidate.name))
        trial = fit_candidate(base, added, candidate, found.estimate)
        if trial is not None:
            trials.append(trial)
    return sorted(trials, key=_order)


def fit_candidate(
    base: Problem, added: Sequence[str], candidate: Candidate, like: Estimate
) -> CandidateFit | None:
    """A candidate identified with the rest; ``None`` where that fails."""
    try:
        estimate = refit(base, [*added, *candidate.parameters], like)
    except (NumericsError, InputError):
        return None
    return CandidateFit(candidate, estimate, log_evidence(estimate))


def _order(trial: CandidateFit) -> tuple[float, int, str]:
    # Equal but for rounding: the order of the catalogue decides, so that answers are repeatable.
    place = list(trial.estimate.problem.machine.catalogue).index(trial.candidate.effect)
    return (-round(trial.evidence, 2), place, trial.candidate.name)


@dataclass(frozen=True)
class Rival:
    """A cause that fits the readings as well as the one that was added.

    Attributes:
        trial: the fit with it instead.
        weight: probability among all candidates.
        same: whether it moves the tool alike too, so that nothing hangs on which one it is.
    """

    trial: CandidateFit
    weight: float
    same: bool = False


def rivals(
    base: Problem,
    others: Sequence[str],
    chosen: CandidateFit,
    progress: Progress,
) -> tuple[float, tuple[Rival, ...]]:
    """Which candidates could stand in the place of an added one, and how probable each is.

    Args:
        base: without effects.
        others: what is added besides the one in question.
        chosen: the model with it.
        progress: called with each step.

    Returns:
        Probability of the chosen one among all candidates, and its rivals, most probable first.
    """
    without = refit(base, others, chosen.estimate)
    seen = signatures(without, {n for weights in chosen.candidate.weights for n in weights})
    scale = lack_scale(chosen.estimate)
    in_question = chosen.candidate
    others_as_small = [
        c for c in seen.candidates if c.size <= in_question.size and c.name != in_question.name
    ]
    scoring = Scoring.of(seen, [in_question, *others_as_small])
    gains, evidences = scoring.gains(seen.residual), scoring.evidences(seen.residual)
    names = [c.name for c in scoring.candidates]
    own = 0
    margin = (_MARGIN + CLASS_WIDTH) * scale**2 + _RELATIVE_MARGIN * gains[own]
    near = [k for k in np.argsort(-gains) if k != own and gains[own] - gains[k] <= margin]
    trials: dict[int, CandidateFit] = {own: chosen}
    for k in near[: 2 * _REFITS]:
        progress(Step("comparing", names[k]))
        trial = fit_candidate(base, others, scoring.candidates[k], without)
        if trial is not None:
            trials[k] = trial
    limit = chosen.chi2 + CLASS_WIDTH * scale**2
    found = {names[k]: t for k, t in trials.items() if k != own and t.chi2 <= limit}
    # What was identified counts as such; the rest as linearised, relative to the chosen one.
    shift = chosen.evidence - evidences[own]
    logs = {name: float(evidences[k] + shift) for k, name in enumerate(names)}
    logs |= {names[k]: trial.evidence for k, trial in trials.items()}
    others_bars = _under_other_bars(base, others, chosen, limit, progress)
    for trial in others_bars:
        name = trial.candidate.name
        if name != in_question.name and name not in found:
            found[name] = trial
            logs[name] = max(logs.get(name, -np.inf), trial.evidence)
    effects = {c.name: c.effect for c in (*scoring.candidates, *(t.candidate for t in others_bars))}
    weights = _weights(logs, effects, scale)
    members = [
        Rival(t, weights[n], same_tool(chosen.estimate, t.estimate)) for n, t in found.items()
    ]
    ordered = sorted(members, key=lambda r: (-r.weight, _order(r.trial)))
    return weights[in_question.name], tuple(ordered)


def same_tool(one: Estimate, other: Estimate) -> bool:
    """Whether two fits put the tool in the same places, over the workspace.

    What differs by less than half the noise of one reading, no reading on the machine would show.
    """
    where = workspace(one.problem.machine.geometry)
    apart = one.machine.forward(where) - other.machine.forward(where)
    return bool(np.sqrt(np.mean(np.sum(apart**2, axis=1))) < one.problem.noise.typical / 2)


def _weights(
    logs: Mapping[str, float], effects: Mapping[str, str], scale: float
) -> dict[str, float]:
    """Probabilities of candidates from their log evidences.

    Families are equally likely; within one, its candidates are. Where a fit still lacks something,
    what it lacks makes the readings worse witnesses.
    """
    families = [effects[name] for name in logs]
    shares = np.array([1.0 / families.count(f) for f in families])
    values = np.array(list(logs.values()))
    weights = np.exp((values - values.max()) / scale**2) * shares
    return dict(zip(logs, (weights / weights.sum()).tolist(), strict=True))


def lack_scale(estimate: Estimate) -> float:
    """sqrt(chi2 / dof) where a fit still lacks something, else 1."""
    return max(estimate.sigma_scale, 1.0)


def _under_other_bars(
    base: Problem,
    others: Sequence[str],
    chosen: CandidateFit,
    limit: float,
    progress: Progress,
) -> list[CandidateFit]:
    """Causes that would fit as well with every dial on bar 1, or on bar 2, where none is recorded.

    A recorded bar is taken at its word. An effect of the dial is the same on either bar.
    """
    if not base.campaigns or any(s.bar for c in base.campaigns for s in c.setups):
        return []
    found: list[CandidateFit] = []
    for bar in (1, 2):
        progress(Step("comparing", f"causes with the dials on bar {bar}"))
        other = replace(base, campaigns=tuple(_touching(c, bar) for c in base.campaigns))
        without = refit(other, others, chosen.estimate)
        seen = signatures(without)
        small = [c for c in seen.candidates if c.size <= chosen.candidate.size]
        gains = Scoring.of(seen, small).gains(seen.residual)
        left = float(seen.residual @ seen.residual) - gains
        for k in np.argsort(left)[:_REFITS]:
            if left[k] <= limit + _MARGIN + _RELATIVE_MARGIN * gains[k]:
                trial = fit_candidate(other, others, small[k], without)
                if trial is not None and trial.chi2 <= limit:
                    found.append(trial)
    return found


def _touching(campaign: Campaign, bar: int) -> Campaign:
    return replace(campaign, setups=tuple(replace(s, bar=bar) for s in campaign.setups))
