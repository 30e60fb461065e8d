"""Causes that were added, and their rivals: each with its own fit, values and words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from orthoglide.diagnosis.ranking import CLASS_WIDTH, CandidateFit, lack_scale, log_evidence, refit
from orthoglide.effects import Catalogue
from orthoglide.effects.wording import cause_words
from orthoglide.fit import Estimate
from orthoglide.searching import CandidateScore, Effect


@dataclass(frozen=True)
class Explanation:
    """One cause and the fit with it.

    Attributes:
        name: of the candidate.
        parameters: what was freed for it.
        probability: among all candidates, the rest of the model given.
        fit: with it, everything else freed again.
    """

    name: str
    parameters: tuple[str, ...]
    probability: float
    fit: Estimate

    @property
    def values(self) -> dict[str, float]:
        """Of its parameters, SI."""
        return {name: self.fit.values[name] for name in self.parameters}

    @property
    def sigmas(self) -> dict[str, float]:
        """Of its parameters, SI, as if nothing else were wrong."""
        return {name: self.fit.sigmas[name] for name in self.parameters}

    @property
    def _catalogue(self) -> Catalogue:
        return self.fit.problem.machine.catalogue

    @property
    def unit(self) -> str:
        """Of its parameters, as files name it."""
        return self._catalogue.effect_of(self.name).unit.name

    @property
    def words(self) -> str:
        """What is wrong, with size and sign, as a clause."""
        values: dict[str, float] = self.values
        if "@" not in self.name:  # of what campaigns have for themselves: the last one's
            values = {self._catalogue.parameter(n).plain: v for n, v in values.items()}
        return cause_words(self._catalogue, self.name, values)

    @property
    def look_at(self) -> str:
        """Where to look for it on the machine."""
        return self._catalogue.effect_of(self.name).look_at

    @property
    def in_unit(self) -> tuple[float, float] | None:
        """Value and sigma in its unit; ``None`` where it has several parameters.

        Of one that campaigns have for themselves: the last one's.
        """
        if len({self._catalogue.parameter(n).plain for n in self.parameters}) != 1:
            return None
        name, si = self.parameters[-1], self._catalogue.effect_of(self.name).unit.si
        return self.values[name] / si, self.sigmas[name] / si


@dataclass(frozen=True)
class Cause:
    """One cause that was added.

    Attributes:
        effect: with the tests that it passed.
        chosen: the cause itself.
        rivals: what fits as well and moves the tool otherwise, most probable first.
        same: what fits as well and moves the tool alike: the same cause under another name.
        without: the fit of everything but this cause, rivals apart.
    """

    effect: Effect
    chosen: Explanation
    rivals: tuple[Explanation, ...]
    same: tuple[Explanation, ...]
    without: Estimate

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.chosen.name

    @property
    def explanations(self) -> tuple[Explanation, ...]:
        """The chosen cause and its rivals."""
        return (self.chosen, *self.same, *self.rivals)

    def chi2_more(self, rival: Explanation) -> float:
        """By how much a rival fits worse, priors included."""
        return rival.fit.scores.cost - self.effect.trial.chi2

    @property
    def class_width(self) -> float:
        """Change of chi2 within which causes count as one class."""
        return CLASS_WIDTH * lack_scale(self.chosen.fit) ** 2

    @property
    def lacking(self) -> bool:
        """Whether the fit with it still leaves more than noise."""
        return lack_scale(self.chosen.fit) > 1


def causes(effects: Sequence[Effect], before: Estimate, after: Estimate) -> Iterator[Cause]:
    """The causes that were added, each with the fit of everything else.

    Args:
        effects: as found, in their order.
        before: the fit without any.
        after: the fit with all.
    """
    for effect in effects:
        others = [p for e in effects if e is not effect for p in e.parameters]
        yield Cause(
            effect,
            Explanation(effect.name, effect.parameters, effect.probability, after),
            tuple(_explanation(r.trial, r.weight) for r in effect.different),
            tuple(_explanation(r.trial, r.weight) for r in effect.same),
            refit(before.problem, others, after) if others else before,
        )


def _explanation(trial: CandidateFit, probability: float) -> Explanation:
    candidate = trial.candidate
    return Explanation(candidate.name, candidate.parameters, probability, trial.estimate)


def candidates(
    tried: Sequence[CandidateScore], found: Sequence[Cause]
) -> tuple[CandidateScore, ...]:
    """All candidates that were identified, rivals that were found last among them.

    Args:
        tried: those of the search.
        found: the causes that were added.
    """
    from scipy.special import chdtrc

    every = list(tried)
    for place, one in enumerate(found, start=1):
        known = {t.name for t in every if t.round == place}
        for rival in one.effect.rivals:
            trial = rival.trial
            if trial.candidate.name in known:
                continue
            fall = max(one.without.scores.cost - trial.chi2, 0.0)
            every.append(
                CandidateScore(
                    trial.candidate.name,
                    trial.candidate.parameters,
                    float(chdtrc(trial.candidate.size, fall)),
                    trial.evidence - log_evidence(one.without),
                    trial.estimate.scores.cv_rms,
                    trial.plausible,
                    place,
                )
            )
    return tuple(sorted(every, key=lambda t: (t.round, -round(t.evidence, 6), t.name)))
