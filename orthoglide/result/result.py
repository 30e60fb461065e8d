"""``Result``: the request, the fits, what was found and what follows, each computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from orthoglide.accuracy import Map, tcp_map
from orthoglide.control import ControllerNumbers, controller_numbers
from orthoglide.diagnosis.blunders import Blunder
from orthoglide.diagnosis.changes import Change
from orthoglide.diagnosis.ranking import Diagnosis
from orthoglide.diagnosis.significance import Detection
from orthoglide.effects import Catalogue
from orthoglide.effects.wording import cause_short
from orthoglide.fit import Estimate, Scores
from orthoglide.frames import data_frame
from orthoglide.judging import HoldOut, TcpErrors
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.observations import Campaign
from orthoglide.posterior import FullPosterior
from orthoglide.request import Request
from orthoglide.result.causes import Cause, candidates, causes
from orthoglide.result.firmware import FirmwareAdvice, firmware_advice
from orthoglide.result.workspace import Workspace, uncertain_effects, workspace_of
from orthoglide.searching import CandidateScore, Effect

if TYPE_CHECKING:
    import pandas as pd

    from orthoglide.planning import Suggestion

Word = Literal["adequate", "explained", "ambiguous", "partial", "unexplained"]

_PROPOSED = 12
"""Readings that are proposed for each purpose."""


@dataclass(frozen=True)
class Result:
    """What a run found.

    Attributes:
        request: what was asked.
        word: adequate, explained, ambiguous, partial or unexplained.
        before: fit of the base model: joint offsets and leg lengths, or what ``identify`` frees.
        after: fit with the effects added; ``before`` where there are none.
        effects: in the order in which they were added.
        tried: candidates that the search identified.
        left: what the last fit leaves; ``None`` where the whole catalogue is free.
        stopped: why no further effect was added, in a sentence.
        posterior: what the readings say with everything else allowed; ``None`` of ``identify``.
        blunders: faults of the data, found before any physics.
        changed: parameters that are not the same in all campaigns, found before any physics.
        faulty: the base fit with the faulty readings in, where there are any.
        hold_out: scores on readings held out, or ``None``.
        tcp: errors at measured TCP points by alignment, or ``None``.
    """

    request: Request
    word: Word
    before: Estimate
    after: Estimate
    effects: tuple[Effect, ...]
    tried: tuple[CandidateScore, ...]
    left: Diagnosis | None
    stopped: str
    posterior: FullPosterior | None = None
    blunders: tuple[Blunder, ...] = ()
    changed: tuple[Change, ...] = ()
    faulty: Estimate | None = None
    hold_out: HoldOut | None = None
    tcp: dict[str, TcpErrors] | None = None

    @property
    def nominal(self) -> Scores:
        """Scores of the machine as it was, without what was identified."""
        return self.before.nominal

    @property
    def catalogue(self) -> Catalogue:
        """Of the machine: the effects that were weighed."""
        return self.request.machine.catalogue

    def short(self, name: str) -> str:
        """A candidate's cause without its size, as a clause."""
        return cause_short(self.catalogue, name)

    @property
    def first(self) -> Estimate:
        """The base fit to all readings, faulty ones included."""
        return self.faulty or self.before

    # --- The calibrated machine -------------------------------------------------------------

    @cached_property
    def explanations(self) -> tuple[tuple[float, dict[str, float]], ...]:
        """Weights and parameters (SI) of all that fits as well, the chosen one first."""
        found = []
        for effect in self.effects:
            total = effect.probability + sum(r.weight for r in effect.rivals)
            found += [(r.weight / total, last_values(r.trial.estimate)) for r in effect.different]
        rest = max(1.0 - sum(share for share, _ in found), 0.0)
        return ((rest, last_values(self.after)), *found)

    @property
    def averaged(self) -> bool:
        """Whether the calibrated machine is an average over causes that fit as well."""
        return len(self.explanations) > 1

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters of the calibrated machine, SI: averaged over what fits as well."""
        (_, chosen), *others = self.explanations
        averaged = dict(chosen)
        for weight, other in others:
            for name in dict.fromkeys((*chosen, *other)):
                change = other.get(name, 0.0) - chosen.get(name, 0.0)
                averaged[name] = averaged.get(name, 0.0) + weight * change
        of_dial = {n: self.catalogue.effect_of(n).of_dial for n in averaged}
        return {n: v for n, v in averaged.items() if not of_dial[n]}

    @cached_property
    def values_before(self) -> dict[str, float]:
        """Parameters of the base model, SI."""
        return last_values(self.before)

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine with its covariance, all else allowed but by ``identify``.

        The verdict and its cautions are kept with it.
        """
        kept: dict[str, Any] = {"command": self.request.command, "verdict": self.word}
        if self.cautions:
            kept["cautions"] = list(self.cautions)
        return self._machine.with_provenance(kept)

    @property
    def _machine(self) -> Machine:
        if self.posterior is None:
            return self.after.machine
        about_fit = self.posterior.machine
        mean = np.array([self.values.get(n, 0.0) for n in about_fit.names])
        covariance = about_fit.covariance.copy()
        for share, other in self.explanations:
            apart = np.array([other.get(n, 0.0) for n in about_fit.names]) - mean
            covariance += share * np.outer(apart, apart)
        known = Posterior(about_fit.names, mean, covariance)
        return self.after.problem.machine.with_posterior(self.values, known)

    @property
    def sigmas(self) -> dict[str, float]:
        """Sigmas of what was identified, SI: everything else allowed but by ``identify``."""
        return self.after.sigmas if self.posterior is None else self.posterior.unknowns.sigmas

    @property
    def columns(self) -> dict[str, list[Any]]:
        """What was identified in the units of files, a row a parameter.

        ``sigma`` allows everything else but by ``identify``, ``sigma_alone`` and the 95 % interval
        from ``lower`` to ``upper`` count the noise alone.
        """
        fit, found = self.after, []
        for name, tolerance in zip(fit.names, fit.problem.tolerance, strict=True):
            unit = self.catalogue.effect_of(name).unit
            sigmas = self.sigmas[name], fit.sigmas[name]
            figures = (fit.values[name], *sigmas, *fit.interval(name), float(tolerance))
            found.append((name, *(figure / unit.si for figure in figures), unit.name))
        names = ("parameter", "value", "sigma", "sigma_alone", "lower", "upper", "tolerance",
                 "unit")  # fmt: skip
        return dict(zip(names, map(list, zip(*found, strict=True)), strict=True))

    def to_frame(self) -> pd.DataFrame:
        """What was identified as a data frame; see :attr:`columns`.

        Raises:
            InputError: where pandas is not installed.
        """
        return data_frame(self.columns, index="parameter")

    # --- Causes, and what is left -----------------------------------------------------------

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """The causes that were added, with their rivals, in their order."""
        return tuple(causes(self.effects, self.before, self.after))

    @cached_property
    def candidates(self) -> tuple[CandidateScore, ...]:
        """All candidates that were identified, rivals that were found last among them."""
        return candidates(self.tried, self.causes)

    @property
    def invisible(self) -> tuple[str, ...]:
        """Effects that these readings cannot show: not absent, not visible."""
        return () if self.left is None else self.left.signatures.invisible

    @property
    def detection(self) -> Detection:
        """Whether anything is left; by lack of fit alone where the whole catalogue is free."""
        if self.left is not None:
            return self.left.detection
        return by_lack_of_fit(self.after)

    @property
    def unexcited(self) -> tuple[str, ...]:
        """Effects whose conditions the campaigns do not vary at all."""
        from orthoglide.fit.excited import excited_effects

        excited = {*(e.name for e in excited_effects(self.after.problem)), *self.catalogue.base}
        return tuple(name for name in self.catalogue if name not in excited)

    @cached_property
    def pattern(self) -> tuple[str, ...]:
        """What is left, in sentences, where causes were looked for and something significant is."""
        from orthoglide.diagnosis.pattern import describe_left

        if not self.request.searches or self.word not in ("partial", "unexplained"):
            return ()
        return describe_left(self.after)

    # --- What follows -----------------------------------------------------------------------

    @cached_property
    def next_measurements(self) -> tuple[Suggestion, ...]:
        """What to measure next; nothing is proposed by ``identify``."""
        from orthoglide.planning import next_measurements

        if not self.request.searches:
            return ()
        rivals = [(e.name, e.fit) for c in self.causes if c.rivals for e in c.explanations]
        return next_measurements(self.after, rivals, count=_PROPOSED)

    @cached_property
    def next_sheet(self) -> Campaign | None:
        """The proposed readings as one sheet to fill in; ``None`` where nothing helps."""
        from orthoglide.planning import next_sheet

        return next_sheet(self.next_measurements)

    @cached_property
    def map(self) -> Map | None:
        """Predicted TCP over the workspace, with its uncertainty; not of ``identify``."""
        return None if self.posterior is None else tcp_map(self.machine)

    @cached_property
    def workspace(self) -> Workspace | None:
        """The TCP's errors over the workspace; ``None`` of ``identify``."""
        if self.map is None:
            return None
        return workspace_of(self.before, self.after, self.map)

    @cached_property
    def uncertain_effects(self) -> tuple[tuple[str, float], ...]:
        """Effects that make most of the TCP's uncertainty, each with its share."""
        return () if self.posterior is None else uncertain_effects(self.machine)

    @cached_property
    def numbers(self) -> ControllerNumbers:
        """What a controller takes of the calibrated machine, and the errors to expect of the TCP.

        They are here whatever the verdict says; :func:`orthoglide.control.withheld` says whether
        they are to be shown.
        """
        return controller_numbers(self.machine, force=True)

    @cached_property
    def firmware(self) -> FirmwareAdvice | None:
        """Numbers for the firmware of a machine that was imported from it; ``None`` for others."""
        causes = self.causes if self.request.searches else ()
        return firmware_advice(self.request.machine, self.machine, self.after, causes)

    @property
    def cautions(self) -> tuple[str, ...]:
        """What speaks against acting on what was found as it stands, a sentence each."""
        found = []
        if self.word == "partial":
            causes = "causes named explain" if len(self.effects) > 1 else "cause named explains"
            found.append(
                f"The {causes} only part of what is wrong, and may stand in for something that is "
                f"not in the catalogue: do not act on it, nor put its numbers in a controller, "
                f"before it is confirmed."
            )
        held = self.hold_out
        if self.effects and held is not None and held.after_rms > held.before_rms:
            found.append(
                "The readings held out are predicted worse with the cause than without it: it does "
                "not carry over to them, so do not act on it before it is confirmed."
            )
        return tuple(found)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the final fit, lack of fit apart: the verdict's word says it already."""
        return tuple(w for w in self.after.warnings if w.kind != "lack_of_fit")


def last_values(estimate: Estimate) -> dict[str, float]:
    """Parameters of the last campaign's machine, dials included, SI."""
    problem = estimate.problem
    return problem.values(problem.last, estimate.x)


def by_lack_of_fit(estimate: Estimate) -> Detection:
    """What is left by chi2 alone: no effect is weighed."""
    p = estimate.scores.lack_of_fit_p
    return Detection(float("nan"), p, p, float("nan"))
