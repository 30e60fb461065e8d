"""What a report shows of a verdict beyond what the verdict itself holds, computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from orthoglide.geometry import Array

if TYPE_CHECKING:
    from orthoglide.accuracy import Map
    from orthoglide.closing import Effect, Tried, Verdict
    from orthoglide.fit import Estimate
    from orthoglide.planning import Suggestion

_FEEDS = 3
_PROPOSED = 12
"""Readings that are proposed for each purpose."""


@dataclass(frozen=True)
class Explained:
    """One cause that was added.

    Attributes:
        effect: of the verdict.
        words: what is wrong, for a mechanic, as a clause.
        without: the fit of everything but this cause, rivals apart.
    """

    effect: Effect
    words: str
    without: Estimate

    @property
    def fits(self) -> tuple[tuple[str, Estimate], ...]:
        """The chosen cause and its rivals, each with its fit, most probable first."""
        trials = (self.effect.trial, *(r.trial for r in self.effect.rivals))
        return tuple((t.candidate.name, t.estimate) for t in trials)


@dataclass(frozen=True)
class Workspace:
    """The TCP over the workspace, best translation removed, metres ``(g,)`` each.

    Attributes:
        commands: ``(g, 3)``.
        nominal: predicted error of a controller that knows of no error.
        before: predicted error of one that knows of joint offsets and leg lengths.
        sure_before: 95 % radius about the base model, everything else allowed.
        sure: 95 % radius about the calibrated machine, everything else allowed.
        alone: 95 % radius about the calibrated machine, as if nothing else were wrong.
    """

    commands: Array
    nominal: Array
    before: Array
    sure_before: Array
    sure: Array
    alone: Array

    def figures(self) -> dict[str, Array]:
        """By name in ``result.json``."""
        return {
            "predicted_error_nominal": self.nominal,
            "predicted_error_before": self.before,
            "uncertainty_95_before": self.sure_before,
            "uncertainty_95_after": self.sure,
            "uncertainty_95_after_alone": self.alone,
        }


@dataclass(frozen=True)
class View:
    """A verdict as reports see it.

    Attributes:
        verdict: what was found.
    """

    verdict: Verdict

    @cached_property
    def effects(self) -> tuple[Explained, ...]:
        """The causes that were added, in their order."""
        from orthoglide.diagnosis import refit
        from orthoglide.report.causes import cause

        verdict, found = self.verdict, []
        for effect in verdict.effects:
            others = [p for e in verdict.effects if e is not effect for p in e.parameters]
            base = verdict.base
            without = refit(base.problem, others, verdict.fit) if others else base
            values = {p: verdict.fit.values[p] for p in effect.parameters}
            if "@" not in effect.name:  # of what campaigns have for themselves: the last one's
                values = {p.partition("@")[0]: value for p, value in values.items()}
            words = cause(effect.name, values)
            found.append(Explained(effect, words, without))
        return tuple(found)

    @cached_property
    def tried(self) -> tuple[Tried, ...]:
        """All candidates that were identified, rivals that were found last among them."""
        from scipy.special import chdtrc

        from orthoglide.closing import Tried
        from orthoglide.diagnosis.ranking import log_evidence

        found = list(self.verdict.tried)
        for place, explained in enumerate(self.effects, start=1):
            for rival in explained.effect.rivals:
                trial = rival.trial
                if trial.candidate.name in {t.name for t in found if t.round == place}:
                    continue
                fall = max(explained.without.scores.chi2 - trial.chi2, 0.0)
                found.append(
                    Tried(
                        trial.candidate.name,
                        trial.candidate.parameters,
                        float(chdtrc(trial.candidate.size, fall)),
                        trial.evidence - log_evidence(explained.without),
                        trial.estimate.scores.cv_rms,
                        trial.plausible,
                        place,
                    )
                )
        return tuple(sorted(found, key=lambda t: (t.round, -round(t.evidence, 6), t.name)))

    @property
    def explanations(self) -> tuple[tuple[str, Estimate], ...]:
        """Machines between which the readings cannot decide."""
        return tuple(fit for e in self.effects if e.effect.rivals for fit in e.fits)

    @cached_property
    def following(self) -> tuple[Suggestion, ...]:
        """What to measure next."""
        from orthoglide.planning import next_measurements

        return next_measurements(self.verdict.fit, self.explanations, count=_PROPOSED)

    @cached_property
    def pattern(self) -> tuple[str, ...]:
        """What is left, where something significant is."""
        from orthoglide.diagnosis.pattern import describe_left

        if self.verdict.word not in ("partial", "unexplained"):
            return ()
        return describe_left(self.verdict.fit)

    @cached_property
    def base_map(self) -> Map:
        """The TCP as the base model predicts it."""
        from orthoglide.accuracy import knowledge, tcp_map

        base = self.verdict.base
        return tcp_map(base, knowledge(base), self.verdict.before)

    @cached_property
    def workspace(self) -> Workspace:
        """The TCP over the workspace."""
        after, before = self.verdict.map, self.base_map
        apart = after.p - before.p
        return Workspace(
            after.commands,
            after.error,
            np.linalg.norm(apart - apart.mean(axis=0), axis=1),
            before.uncertainty,
            after.uncertainty,
            1.96 * np.linalg.norm(after.sigma, axis=1),
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the final fit: what troubles the base model may be what the cause explains."""
        return tuple(w for w in self.verdict.fit.warnings if not w.startswith("the residuals are"))

    @property
    def unexcited(self) -> tuple[str, ...]:
        """Families whose conditions the campaigns do not vary at all."""
        from orthoglide.effects import BASE_FAMILIES, CATALOGUE
        from orthoglide.fit.excited import excited_effects

        excited = {e.name for e in excited_effects(self.verdict.fit.problem)}
        return tuple(f for f in CATALOGUE if f not in excited and f not in BASE_FAMILIES)

    @cached_property
    def uncertain_families(self) -> tuple[tuple[str, float], ...]:
        """Families that make most of the variance of the TCP, each with its share of their sum."""
        from orthoglide.effects import MACHINE_PARAMETERS, family_of, is_dial
        from orthoglide.prediction import Conditions

        known, where = self.verdict.known, self.verdict.map.commands
        model = self.verdict.fit.problem.machine.model
        _, by_theta = model.sensitivities(
            self.verdict.values, Conditions.at(where), MACHINE_PARAMETERS
        )
        slope = by_theta[:, :3] @ known.weights
        slope = slope - slope.mean(axis=0)
        shares: dict[str, float] = {}
        families = [family_of(n).name for n in known.names]
        for family in dict.fromkeys(f for f in families if not is_dial(f)):
            own = np.array([f == family for f in families])
            part = slope[:, :, own]
            block = known.covariance[np.ix_(own, own)]
            shares[family] = float(np.einsum("gie,ef,gif->", part, block, part))
        total = sum(shares.values())
        ranked = sorted(shares.items(), key=lambda item: -item[1])[:_FEEDS]
        return tuple((f, s / total) for f, s in ranked if total > 0)
