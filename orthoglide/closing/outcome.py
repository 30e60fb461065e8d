"""``RunOutcome``: the outcome of the search, and the values that follow, each computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

from orthoglide.accuracy import best_zeros, expected_gain, tool_settings
from orthoglide.add_ons import Corrections, Section
from orthoglide.control import ControllerNumbers, DeltaSizes, best_sizes, controller_numbers
from orthoglide.explanation import CredibleSets, FullPosterior, budget
from orthoglide.explanation.change import Change
from orthoglide.explanation.lack_of_fit import residual_by_setup
from orthoglide.fit import Estimate
from orthoglide.layout import LinearDelta
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.numerals import distinct_figures
from orthoglide.observations import Readings
from orthoglide.observations.touched_plates import disagreements
from orthoglide.result import BudgetItem, DataFault, HoldOut, LackOfFit, Request, TcpErrors, Word
from orthoglide.result.fits import Identified
from orthoglide.result.result import Judged
from orthoglide.text import sentence

_ZEROS_CONFIRMED = (
    "But they confirm the new zeros, which predict them better than the old ones: enter these. "
    "calibrated.toml contains them alone."
)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class RunOutcome(Judged, CredibleSets):
    """The outcome of the search."""

    request: Request  # what was asked
    word: Word  # the verdict
    before: Estimate  # base model: joint offsets and leg lengths, or what `identify` frees
    after: Estimate  # fit at the posterior mean; `before` after `identify`
    residual_test: LackOfFit  # lack of fit of the last fit, without residuals by setup
    posterior: FullPosterior | None = None  # of the full model; none after `identify`
    blunders: tuple[DataFault, ...] = ()  # data faults
    changed: tuple[Change, ...] = ()  # parameters that differ between campaigns
    fit_with_faults: Estimate | None = None  # base fit with the faulty readings, if there are any
    hold_out: HoldOut | None = None  # scores on readings held out
    tcp: dict[str, TcpErrors] | None = None  # errors at measured TCP points by alignment
    # whether readings or points held out contradict what was found but confirm the new zeros, which
    # then are all that the calibrated machine has
    zeros_confirmed: bool = False
    not_contained: str = ""  # changes since earlier readings that it lacks, a sentence; else empty

    def with_warnings(self, *notes: Note) -> Self:
        """Return the outcome with further warnings on its last fit."""
        warnings = (*self.after.warnings, *notes)
        return replace(self, after=replace(self.after, warnings=warnings))

    # --- The calibrated machine -------------------------------------------------------------

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine with its covariance: the base model if significant residuals
        remain, the zeros alone if only they are confirmed, and otherwise the posterior's mean.

        Its provenance contains the verdict, and the causes and the cautions that concern it.
        """
        provenance: dict[str, Any] = {"command": self.request.command, "verdict": self.word}
        cautions = list(self.cautions)
        if self.zeros_confirmed:  # it does not contain what is contradicted
            cautions = [c for c in cautions if not c.startswith(self.refuted)]
        else:
            provenance |= self._findings_by_name
        if cautions:
            provenance["cautions"] = cautions
        if (printer := self.request.machine.spec.printer) is not None:
            provenance |= printer.provenance(self.corrections)
        return self._calibrated_machine.with_provenance(provenance)

    @property
    def _findings_by_name(self) -> dict[str, list[str]]:
        """Names of causes, of their rivals and of located errors, by key of the provenance."""
        rivals = {rival.name for cause in self.effects for rival in cause.rivals}
        names = {
            "effects": [cause.name for cause in self.effects],
            "averaged_over": sorted(rivals),
            "located": [found.name for found in self.located],
        }
        return {key: value for key, value in names.items() if value}

    @cached_property
    def corrections(self) -> Corrections | None:
        """New numbers for the firmware of an imported machine; ``None`` for others, and if the
        readings give none.
        """
        if (printer := self.request.machine.spec.printer) is None:
            return None
        return printer.corrections(self._calibrated_machine, self._tool_readings)

    @cached_property
    def sizes(self) -> DeltaSizes | None:
        """New sizes for the controller of a linear delta; ``None`` for other machines, for a
        firmware with an add-on, and if no plate was touched.
        """
        machine = self.request.machine
        if machine.spec.printer is not None or not isinstance(machine.geometry.layout, LinearDelta):
            return None
        return best_sizes(self.machine, self._tool_readings)

    @property
    def _tool_readings(self) -> list[Readings]:
        of_posterior = self.stands and not self.zeros_confirmed
        fit = self.after if of_posterior else self.before  # nearest to the calibrated machine
        return [f.readings for f in fit.problem.tool_factors]

    @property
    def _calibrated_machine(self) -> Machine:
        if self.posterior is None:
            return self.after.machine
        if self.zeros_confirmed:
            return self.zeros_alone
        return self.posterior.machine if self.stands else self._base_machine

    @property
    def _base_machine(self) -> Machine:
        """The machine of the base model, with the covariance of the full one."""
        machine = (self.posterior or self.after).machine
        return machine.with_posterior(self.before.machine.values, machine.posterior)

    @cached_property
    def zeros_alone(self) -> Machine:
        """The machine with nothing but the best zeros of the base model."""
        base = self._base_machine
        return base.with_posterior(best_zeros(base), base.posterior)

    @cached_property
    def identified(self) -> dict[str, Identified]:
        """The identified parameters in the units of files: those of the base model, and of each
        cause conditional on its being the true one of its credible set.

        Sigmas and intervals are those of the full model; after ``identify`` they count the noise
        alone.
        """
        fit = self.after
        names = fit.names if self.posterior is None else self.before.names
        figures_by_name = {n: (fit.values[n], fit.sigmas[n], *fit.interval(n)) for n in names}
        for cause in self.effects:
            for n, value in cause.chosen.values.items():
                sigma = cause.chosen.sigmas[n]
                half = fit.coverage_factor * sigma
                figures_by_name[n] = (value, sigma, value - half, value + half)
        rows = {}
        for name, figures in figures_by_name.items():
            unit, tolerance = self.catalogue.effect_of(name).unit, self.request.machine.tolerance
            value, sigma, low, high, expected = (v / unit.si for v in (*figures, tolerance(name)))
            on_bound = name in fit.on_bound
            rows[str(name)] = Identified(value, sigma, unit.name, (low, high), expected, on_bound)
        return rows

    @cached_property
    def budget(self) -> tuple[BudgetItem, ...]:
        """Error budget, largest gain first; empty after ``identify``."""
        if self.posterior is None:
            return ()
        causes: dict[str, tuple[str, ...]] = {c.name: c.all_parameters for c in self.effects}
        causes |= {c.parameter: c.members for c in self.moved if c.is_cause}
        causes |= {one.in_budget: one.parameters for one in self.located}
        return budget(self.posterior, causes)

    @cached_property
    def lack_of_fit(self) -> LackOfFit:
        """The residuals of the last fit against the noise."""
        mountings = tuple(sorted(residual_by_setup(self.after), key=lambda setup: setup.leg < 0))
        return replace(self.residual_test, mountings=mountings)

    # --- What follows -----------------------------------------------------------------------

    @cached_property
    def numbers(self) -> ControllerNumbers:
        """The best zeros of a controller that takes nothing else, and the TCP errors to expect.

        They are computed for every verdict; reports do not show them if it is not to be acted on.
        """
        return controller_numbers(self.machine, zeros_only=True, force=True)

    @cached_property
    def firmware(self) -> Section | None:
        """Report of the firmware's add-on on an imported machine; ``None`` for others."""
        original = self.request.machine
        if (printer := original.spec.printer) is None:
            return None
        causes = [e for cause in self.effects for e in cause.explanations]
        return printer.section(original, self.machine, self.corrections, causes)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Reasons not to act on the result, a sentence each."""
        reasons = list(self._disagreements)
        if self.word == "partial":
            reasons.append(
                "What was found explains only part of what is wrong, and may stand in for "
                "something that is not in the catalogue: do not act on it, nor put its numbers in "
                "a controller, before it is confirmed."
            )
        if self.contradicted and self.contradicted not in reasons:
            reasons.append(self.contradicted)
        return tuple(reasons)

    @cached_property
    def _disagreements(self) -> tuple[str, ...]:
        """How lists of touches contradict each other, one by one; without what the firmware's
        add-on states on import.
        """
        spec, touches = self.request.machine.spec, self.request.points
        found = disagreements(spec.kinematics, touches, relative=spec.meshes_relative)
        known = () if spec.printer is None else spec.printer.changed_since
        return tuple(text for *_, note in found if (text := sentence(note)) not in known)

    @property
    def contradicted(self) -> str:
        """How readings contradict each other, or how readings or points held out, or earlier
        readings, contradict the result; else empty.
        """
        if self._disagreements:
            return self._disagreements[0]
        if self.not_contained:
            return self.not_contained
        return " ".join(
            [self.refuted, _ZEROS_CONFIRMED] if self.zeros_confirmed else [self.refuted]
        )

    @property
    def refuted(self) -> str:
        """How readings or points held out contradict what was found, a sentence; else empty."""
        hold_out, tcp = self.hold_out, None if self.tcp is None else self.tcp["translation"]
        threshold = self.before.problem.noise.typical / 2  # a smaller difference is not measurable
        if tcp is not None and tcp.after_mean > tcp.before_mean + threshold:
            before, after = distinct_figures(tcp.before_mean * 1e3, tcp.after_mean * 1e3)
            return (
                f"The measured points contradict this result: the tool is {after} mm off with it "
                f"and {before} mm without it, so do not act on it before it is confirmed."
            )
        if self.found and hold_out is not None and hold_out.worse:
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
