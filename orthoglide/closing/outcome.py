"""``Closed``: a closed loop as the search left it, and what follows, each computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from orthoglide.accuracy import expected_gain, tool_settings
from orthoglide.add_ons import Corrections, Section
from orthoglide.closing.actions import actions, next_measurements
from orthoglide.closing.picture import picture
from orthoglide.closing.values import explanation_value
from orthoglide.control import ControllerNumbers, controller_numbers
from orthoglide.effects import Catalogue
from orthoglide.explanation import Cause, Explanation, FullPosterior, Located, budget
from orthoglide.explanation.change import Change
from orthoglide.explanation.data_faults import ReportedFault
from orthoglide.explanation.residuals import residual_by_setup
from orthoglide.explanation.significance import LackOfFitTest
from orthoglide.fit import Estimate
from orthoglide.machine import Machine
from orthoglide.numerals import distinct_figures
from orthoglide.observations import Readings
from orthoglide.result import (
    Action,
    BudgetItem,
    CandidateScore,
    HoldOut,
    Identified,
    LackOfFit,
    Picture,
    Request,
    TcpErrors,
    Word,
)

if TYPE_CHECKING:
    from orthoglide.planning import Suggestion


@dataclass(frozen=True, eq=False, repr=False)
class RunOutcome:
    """A closed loop as the search left it."""

    request: Request  # what was asked
    word: Word  # the verdict
    before: Estimate  # base model: joint offsets and leg lengths, or what `identify` frees
    after: Estimate  # fit at the posterior mean; `before` after `identify`
    effects: tuple[Cause, ...]  # active causes
    located: tuple[Located, ...]  # active free-form errors
    candidates: tuple[CandidateScore, ...]  # what was considered, most probable first
    residual_test: LackOfFitTest  # lack of fit of the last fit
    posterior: FullPosterior | None = None  # of everything; none after `identify`
    blunders: tuple[ReportedFault, ...] = ()  # data faults
    changed: tuple[Change, ...] = ()  # parameters that differ between campaigns
    fit_with_faults: Estimate | None = None  # base fit with the faulty readings, if there are any
    hold_out: HoldOut | None = None  # scores on readings held out
    tcp: dict[str, TcpErrors] | None = None  # errors at measured TCP points by alignment
    # if nothing is active: causes that could each explain the residual alone
    alone: tuple[Explanation, ...] = ()
    # if the model does not fit and nothing is active: the most probable causes
    possible: tuple[Explanation, ...] = ()

    @property
    def catalogue(self) -> Catalogue:
        """Effects of the calibrated machine, located errors included."""
        machine = self.request.machine if self.posterior is None else self.posterior.machine
        return machine.catalogue

    @property
    def first_fit(self) -> Estimate:
        """The base fit to all readings, faulty ones included."""
        return self.fit_with_faults or self.before

    # --- The calibrated machine -------------------------------------------------------------

    @property
    def found(self) -> bool:
        """Whether a cause or a located error is significant."""
        return bool(self.effects or self.located)

    @property
    def stands(self) -> bool:
        """Whether the causes found are conclusive: if significant residuals remain, they may stand
        in for an error that the model lacks.
        """
        return self.word not in ("partial", "unexplained")

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters of the calibrated machine, SI."""
        return self.machine.values

    @cached_property
    def values_before(self) -> dict[str, float]:
        """Parameters of the base model's last campaign, dials included, SI."""
        problem = self.before.problem
        return problem.values(problem.last_factor, self.before.x)

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine with its covariance: the posterior's mean, or the base model
        where something significant is left.

        The verdict, its causes and its cautions are kept with it.
        """
        kept: dict[str, Any] = {"command": self.request.command, "verdict": self.word}
        if self.effects:
            kept["effects"] = [cause.name for cause in self.effects]
        if rivals := {rival.name for cause in self.effects for rival in cause.rivals}:
            kept["averaged_over"] = sorted(rivals)
        if self.located:
            kept["located"] = [found.name for found in self.located]
        if self.cautions:
            kept["cautions"] = list(self.cautions)
        if (printer := self.request.machine.spec.printer) is not None:
            kept |= printer.provenance(self.corrections)
        return self._calibrated_machine.with_provenance(kept)

    @cached_property
    def corrections(self) -> Corrections | None:
        """New numbers for the firmware of an imported machine; ``None`` for others, and if the
        readings give none.
        """
        if (printer := self.request.machine.spec.printer) is None:
            return None
        fit = self.after if self.stands else self.before  # which the machine is of
        return printer.corrections(
            self._calibrated_machine, [f.readings for f in fit.problem.tool_factors]
        )

    @property
    def _calibrated_machine(self) -> Machine:
        if self.posterior is None:
            return self.after.machine
        machine = self.posterior.machine
        if self.stands:
            return machine
        base = self.before.machine.values
        return machine.with_posterior(base, machine.posterior)

    @cached_property
    def identified(self) -> dict[str, Identified]:
        """What was identified in the units of files: the base, and each cause as if it were the
        right one of its set.

        Sigmas and intervals allow everything else but by ``identify``, where they count the noise
        alone.
        """
        fit, causes = self.after, [e.chosen for e in self.effects]
        names = fit.names if self.posterior is None else self.before.names
        found = {n: (fit.values[n], fit.sigmas[n], *fit.interval(n)) for n in names}
        for one in causes:
            for n, value in one.values.items():
                half = fit.coverage_factor * one.sigmas[n]
                found[n] = (value, one.sigmas[n], value - half, value + half)
        rows = {}
        for name, figures in found.items():
            unit, tolerance = self.catalogue.effect_of(name).unit, self.request.machine.tolerance
            value, sigma, low, high, expected = (v / unit.si for v in (*figures, tolerance(name)))
            bound = name in fit.on_bound
            rows[str(name)] = Identified(value, sigma, unit.name, (low, high), expected, bound)
        return rows

    @cached_property
    def budget(self) -> tuple[BudgetItem, ...]:
        """Error budget, largest gain first; empty after ``identify``."""
        if self.posterior is None:
            return ()
        causes: dict[str, tuple[str, ...]] = {c.name: c.all_parameters for c in self.effects}
        causes |= {c.parameter: c.members for c in self.moved if c.is_cause}
        causes |= dict(one.in_machine(self.catalogue) for one in self.located)
        return budget(self.posterior, causes)

    @cached_property
    def moved(self) -> tuple[Change, ...]:
        """Changes that no cause found reports."""
        told = {n for c in self.effects for e in (c.chosen, *c.same) for n in e.parameters}
        told = {self.catalogue.parameter(n).plain for n in told}
        return tuple(c for c in self.changed if c.parameter not in told)

    # --- What is left -----------------------------------------------------------------------

    @cached_property
    def lack_of_fit(self) -> LackOfFit:
        """The residuals of the last fit against the noise."""
        left, known = self.residual_test, self.posterior
        stopped = "nothing else stands out of the noise and of the background of small errors"
        mountings = residual_by_setup(self.after)
        return LackOfFit(
            p_value=left.p_value,
            background=float("nan") if known is None else known.background_scale,
            rare=left.rare,
            shaped=left.shaped,
            with_unreported=left.with_unreported,
            stopped="no cause was to be added" if known is None else stopped,
            mountings=tuple(sorted(mountings, key=lambda one: one.leg < 0)),
        )

    @cached_property
    def picture(self) -> Picture:
        """Drawing of the machine with the causes marked."""
        return picture(self)

    # --- What follows -----------------------------------------------------------------------

    @cached_property
    def actions(self) -> tuple[Action, ...]:
        """What to do, largest gain first."""
        return actions(self)

    @cached_property
    def next_measurements(self) -> tuple[Suggestion, ...]:
        """Readings to take next; empty after ``identify``."""
        return next_measurements(self) if self.request.searches else ()

    @cached_property
    def next_sheet(self) -> Readings | None:
        """The proposed readings as one sheet to fill in; ``None`` if there are none."""
        from orthoglide.planning import next_sheet

        return next_sheet(self.next_measurements)

    @cached_property
    def numbers(self) -> ControllerNumbers:
        """The best zeros of a controller that takes nothing else, and the TCP's errors to expect.

        They are here whatever the verdict says; where it is not to be acted on, reports do not
        show them.
        """
        return controller_numbers(self.machine, zeros_only=True, force=True)

    @cached_property
    def firmware(self) -> Section | None:
        """Report of the firmware's add-on on an imported machine; ``None`` for others."""
        given = self.request.machine
        if (printer := given.spec.printer) is None:
            return None
        causes = [explanation_value(one) for cause in self.effects for one in cause.explanations]
        return printer.section(given, self.machine, self.corrections, causes)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Reasons not to act on the result, a sentence each."""
        printer = self.request.machine.spec.printer
        found = [f"{note}." for note in (printer.cautions(self.request.points) if printer else ())]
        if self.word == "partial":
            found.append(
                "What was found explains only part of what is wrong, and may stand in for "
                "something that is not in the catalogue: do not act on it, nor put its numbers in "
                "a controller, before it is confirmed."
            )
        if self.contradicted:
            found.append(self.contradicted)
        return tuple(found)

    @property
    def contradicted(self) -> str:
        """What readings or points held out say against the result, a sentence; empty if nothing."""
        held, tool = self.hold_out, None if self.tcp is None else self.tcp["translation"]
        least = self.before.problem.noise.typical / 2  # what no reading would show
        if tool is not None and tool.after_mean > tool.before_mean + least:
            before, after = distinct_figures(tool.before_mean * 1e3, tool.after_mean * 1e3)
            return (
                f"The measured points contradict this result: the tool is {after} mm off with it "
                f"and {before} mm without it, so do not act on it before it is confirmed."
            )
        if self.found and held is not None and held.worse:
            return (
                "The readings held out are predicted worse with the cause than without it: it does "
                "not carry over to them, so do not act on it before it is confirmed."
            )
        return ""

    @cached_property
    def compensation_gain(self) -> tuple[float, float]:
        """Decrease of the tool's mean error by compensated commands, compared with the best zeros,
        and its standard deviation, metres.
        """
        settings = tool_settings(self.machine)
        return expected_gain(self.machine, settings["zeros"], settings["compensated"])

    @property
    def scattering(self) -> tuple[str, ...]:
        """Warnings that repeats scatter by more than the declared noise."""
        return tuple(w for w in self.after.warnings if w.kind == "scatter")
