"""The search for causes: add one at a time while detection, naming and stations left out agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orthoglide.diagnosis.evidence import best_pairs
from orthoglide.diagnosis.ranking import (
    CandidateFit,
    Diagnosis,
    Rival,
    budget,
    diagnose,
    fit_candidate,
    fit_candidates,
    log_evidence,
    refit,
    rivals,
)
from orthoglide.fit import Estimate, Problem
from orthoglide.progress import Progress, Step

DETECTION = 0.01
"""Family-wise probability of finding a cause where there is none, in one round."""

NAMING = 0.05
"""Probability of naming a cause for a structureless residual of the same size."""

_MOST_EFFECTS = 6
_BETTER = 0.5  # log evidence by which another cause must win to take an effect's place
_PAIRS = 6.0  # log evidence by which two causes must win over one: there are many pairs


@dataclass(frozen=True)
class Effect:
    """A cause that was added to the model.

    Attributes:
        trial: the model with it.
        probability: among all candidates, the rest of the model given.
        rivals: causes that these readings cannot tell from it.
        detection_p: of the residual that it was found in.
        naming_p: of its name.
        cv_rms: of stations left out, before and after it was added, metres.
    """

    trial: CandidateFit
    probability: float
    rivals: tuple[Rival, ...]
    detection_p: float
    naming_p: float
    cv_rms: tuple[float, float]

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.trial.candidate.name

    @property
    def parameters(self) -> tuple[str, ...]:
        """What was freed for it."""
        return self.trial.candidate.parameters

    @property
    def same(self) -> tuple[Rival, ...]:
        """Rivals that move the tool alike: one cause with this, under another name."""
        return tuple(r for r in self.rivals if r.same)

    @property
    def different(self) -> tuple[Rival, ...]:
        """Rivals that move the tool otherwise."""
        return tuple(r for r in self.rivals if not r.same)

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """Names of its rivals."""
        return tuple(r.trial.candidate.name for r in self.rivals)


@dataclass(frozen=True)
class CandidateScore:
    """A candidate that was identified, whether it was added or not.

    Attributes:
        name: of the candidate.
        parameters: what was freed for it.
        p_value: of its fall of chi2, the search not counted.
        evidence: log Bayes factor against no effect, linearised.
        cv_rms: of stations left out, metres.
        plausible: whether it stays within four tolerances.
        round: of the search, from 1; those added before are in.
    """

    name: str
    parameters: tuple[str, ...]
    p_value: float
    evidence: float
    cv_rms: float
    plausible: bool
    round: int = 1


@dataclass
class Search:
    """The loop. Its random draws are in sequence, so that answers are repeatable.

    Attributes:
        problem: without any effect.
        progress: called with each step.
        rng: of all draws.
        effects: added so far.
        tried: all that were identified.
        limit: parameters that may be added in all.
        changed: causes to begin with: parameters that are known to differ between campaigns.
    """

    problem: Problem
    progress: Progress
    rng: np.random.Generator
    effects: list[Effect] = field(default_factory=list)
    tried: list[CandidateScore] = field(default_factory=list)
    limit: int = 0
    changed: Sequence[str] = ()

    def added(self, but: Effect | None = None) -> list[str]:
        """What is freed for the effects, one of them left out where asked."""
        return [p for e in self.effects if e is not but for p in e.parameters]

    def run(self, base: Estimate) -> tuple[Estimate, Diagnosis, str]:
        """Search from the base fit.

        Returns:
            The last fit, what it leaves, and why the search ended, in a sentence.
        """
        self.progress(Step("testing"))
        self.limit = budget(diagnose(base, 0, self.rng).signatures)
        fit, stopped = base, ""
        for name in self.changed:
            fit = self._begin_with(name, fit)
        while not stopped:
            fit, stopped = self._step(fit)
        self._settle()
        fit = refit(self.problem, self.added(), fit) if self.effects else base
        return fit, diagnose(fit, max(self.limit - len(self.added()), 1), self.rng), stopped

    def _begin_with(self, name: str, fit: Estimate) -> Estimate:
        """Add a cause that is known already."""
        found = diagnose(fit, self.limit, self.rng)
        candidate = next((c for c in found.scoring.candidates if c.name == name), None)
        if candidate is None:
            return fit
        trial = fit_candidate(self.problem, self.added(), candidate, fit)
        if trial is None:
            return fit
        self._note([trial], found)
        naming, scores = found.naming(candidate, self.rng), (fit.scores, trial.estimate.scores)
        before, after = (s.cv_rms for s in scores)
        detection = found.detection.p_value
        self.effects.append(Effect(trial, 1.0, (), detection, naming, (before, after)))
        return trial.estimate

    def _step(self, fit: Estimate) -> tuple[Estimate, str]:
        """Add one more cause, or say why not."""
        room = self.limit - len(self.added())
        found = diagnose(fit, max(room, 1), self.rng)
        if found.detection.p_value >= DETECTION:
            return fit, "nothing in the catalogue explains more of the residual than chance"
        if room < 1 or len(self.effects) >= _MOST_EFFECTS:
            return fit, "these readings are too few to tell a further cause"
        trials = fit_candidates(self.problem, self.added(), found, self.progress, least=3)
        if not trials:
            return fit, "no further cause could be identified"
        best = self._unmasked(trials, found, room)
        self._note(trials, found)
        naming = found.naming(best.candidate, self.rng)
        name = best.candidate.name
        if naming >= NAMING:
            return fit, (
                f"{name} explains no more of the residual than the best of the catalogue would "
                f"explain of a structureless one (p = {naming:.2f})"
            )
        if not best.estimate.scores.cv_rms < fit.scores.cv_rms:
            return fit, f"{name} does not predict stations left out better"
        scores = (fit.scores.cv_rms, best.estimate.scores.cv_rms)
        self.effects.append(Effect(best, 1.0, (), found.detection.p_value, naming, scores))
        return best.estimate, ""

    def _unmasked(self, trials: list[CandidateFit], found: Diagnosis, room: int) -> CandidateFit:
        """The best cause, unless two small ones together do better without it.

        Taken one at a time, a cause between two that act together, or a family whole, beats each.
        """
        best = trials[0]
        names = [c.name for c in found.scoring.candidates]
        residual = found.signatures.residual[:, None]
        pairs = best_pairs(found.scoring, residual) if room > 1 else ()
        if not pairs or best.candidate.name in (names[k] for k in pairs[0].members):
            return best
        (pair,) = pairs
        if pair.evidence < found.evidences[names.index(best.candidate.name)] + _PAIRS:
            return best
        self.progress(Step("trying", "two causes at once"))
        first, second = sorted(pair.members, key=lambda k: -found.evidences[k])
        one, other = (found.scoring.candidates[k] for k in (first, second))
        trial = fit_candidate(self.problem, self.added(), one, found.estimate)
        if trial is None:
            return best
        both = fit_candidate(self.problem, [*self.added(), *one.parameters], other, trial.estimate)
        if both is None or both.evidence < best.evidence + _PAIRS:
            return best
        trials.insert(0, trial)
        return trial

    def _note(self, trials: list[CandidateFit], found: Diagnosis) -> None:
        from scipy.special import chdtrc

        names = [c.name for c in found.scoring.candidates]
        for trial in trials:
            place = names.index(trial.candidate.name)
            # Wilks: the fall of chi2 of a candidate alone, not corrected for the search.
            p_value = chdtrc(trial.candidate.size, max(float(found.gains[place]), 0.0))
            self.tried.append(
                CandidateScore(
                    trial.candidate.name,
                    trial.candidate.parameters,
                    float(p_value),
                    float(found.evidences[place]),
                    trial.estimate.scores.cv_rms,
                    trial.plausible,
                    1 + len(self.effects),
                )
            )

    def _settle(self) -> None:
        """Weigh every effect against what could stand in its place; exchange it if it loses."""
        for _ in range(3):
            changed = [self._weigh(k) for k in range(len(self.effects))]
            if not any(changed):
                return

    def _weigh(self, k: int) -> bool:
        effect = self.effects[k]
        others = self.added(but=effect)
        fit = refit(self.problem, [*others, *effect.parameters], effect.trial.estimate)
        trial = CandidateFit(effect.trial.candidate, fit, log_evidence(fit))
        probability, near = rivals(self.problem, others, trial, self.progress)
        # A rival that needs another bar than the one taken for touched is none to exchange for.
        better = [
            r.trial
            for r in near
            if r.trial.evidence > trial.evidence + _BETTER
            and r.trial.estimate.problem.campaigns == self.problem.campaigns
        ]
        if better:
            winner = max(better, key=lambda t: t.evidence)
            self.effects[k] = replace(effect, trial=winner)
            return True
        self.effects[k] = replace(effect, trial=trial, probability=probability, rivals=near)
        return False
