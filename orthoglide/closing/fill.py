"""The result of a finished run: every value that a report shows, computed once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, TypeVar

from orthoglide.accuracy import tcp_map, without_translation, workspace_grid
from orthoglide.closing.actions import not_advised
from orthoglide.closing.outcome import RunOutcome
from orthoglide.closing.values import (
    cause_value,
    change_value,
    data_fault_value,
    explanation_value,
    fit_value,
    located_value,
)
from orthoglide.effects.wording import cause_short
from orthoglide.errors import NumericsError
from orthoglide.explanation.free_form import only_surface_readings
from orthoglide.fit import CrossCheck, Estimate, solve
from orthoglide.fit.assembling import with_free
from orthoglide.fit.excitation import excited_effects, unmet_conditions
from orthoglide.fit.noise_notes import noise_scales
from orthoglide.fit.reading_tables import fitted_readings, row_indices
from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.observations import campaign_rows, source
from orthoglide.parameters import Parameter
from orthoglide.planning import INSTRUMENT_WORDS, Suggestion
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import (
    CandidateScore,
    DataFault,
    InstrumentNoise,
    Noise,
    Possible,
    Proposal,
    Result,
    SetupNoise,
    Unseen,
    Workspace,
    encoded,
)
from orthoglide.threads import on_one_thread

# Metres. Two derivations that differ by less agree; the difference below is rounding, which differs
# from one processor to the next.
_ROUNDING = 1e-12

_ONE_OR_SEVERAL = "one alone, or several differently"

R = TypeVar("R", bound=Result)


@on_one_thread
def build_result(closed: RunOutcome, cls: type[R], progress: Progress = no_progress) -> R:
    """Return a finished run as an instance of ``cls``, `Result` or a subclass of it.

    The values are encoded as in ``result.json`` and decoded again, so that a result that is loaded
    later equals this one to the last digit.
    """
    progress(Step("suggesting"))
    request, machine = closed.request, closed.machine
    return cls.read(encoded(_result_values(closed)), request, machine)


def _result_values(closed: RunOutcome) -> Result:
    request, base, after, catalogue = closed.request, closed.before, closed.after, closed.catalogue
    moved = {id(change) for change in closed.moved}
    kinds = {s.kind for f in after.problem.factors for s in f.readings.setups}
    sheet, known = closed.next_sheet, closed.posterior
    not_seen, invisible = _unseen(closed)
    return Result(
        request=request,
        machine=closed.machine,
        word=closed.word,
        noise=_noise(closed),
        nominal=closed.before.nominal,
        before=fit_value(base),
        after=fit_value(after),
        rms_of_all=closed.first_fit.scores.rms,
        hold_out=closed.hold_out,
        tcp=closed.tcp,
        effects=tuple(map(cause_value, closed.effects)),
        located=tuple(located_value(one, catalogue) for one in closed.located),
        alone=tuple(map(explanation_value, closed.alone)),
        budget=closed.budget,
        identified=closed.identified,
        candidates=tuple(_candidates(closed)),
        blunders=_data_faults(closed),
        changed=tuple(change_value(c, id(c) not in moved) for c in closed.changed),
        weak=after.weak,
        check=base.check and _above_rounding(base.check),
        verification=after.verification,
        firmware=closed.firmware,
        next_measurements=tuple(map(_proposal, closed.next_measurements)),
        sheet=() if sheet is None else tuple(campaign_rows(sheet)),
        left=closed.lack_of_fit,
        workspace=None if known is None else _workspace(base, known.machine, closed.machine),
        numbers=closed.numbers,
        actions=closed.actions,
        invisible=invisible,
        unseen=not_seen,
        instruments={kind: words for kind, words in INSTRUMENT_WORDS.items() if kind in kinds},
        cautions=closed.cautions,
        warnings=_warnings(closed),
        calibrated_before=base.problem.has_earlier_calibration,
        shapes_of_plate=known is not None and bool(known.mixture.linear.plate_shapes.any()),
        picture=closed.picture,
        readings=fitted_readings(after, base, request.given),
        withheld=not_advised(closed),
        contradicted=closed.contradicted,
        possible=tuple(_possible_causes(closed)),
        noise_by_setup=tuple(_noise_by_setup(after)),
    )


def _candidates(closed: RunOutcome) -> Iterator[CandidateScore]:
    """Yield the causes and located errors that were considered, in words."""
    known = closed.posterior
    places = (
        {}
        if known is None
        else {place.name: place.words for place in known.linearised.free_form_errors}
    )
    for one in closed.candidates:
        named = (
            cause_short(closed.catalogue, one.name) if one.parameters else places.get(one.name, "")
        )
        yield replace(one, words=named)


def _data_faults(closed: RunOutcome) -> tuple[DataFault, ...]:
    """Return the data faults, with their rows within the readings of the request."""
    tables = [factor.readings for factor in closed.first_fit.problem.factors]
    given = zip(tables, closed.request.given, strict=True)
    rows = [row_indices(part, whole) for part, whole in given]
    return tuple(data_fault_value(b, tables, lambda k, r: int(rows[k][r])) for b in closed.blunders)


def _above_rounding(check: CrossCheck) -> CrossCheck:
    return replace(
        check,
        reduction=max(check.reduction, _ROUNDING),
        linear=max(check.linear, _ROUNDING),
        linear_size=max(check.linear_size, _ROUNDING),
    )


def _workspace(before: Estimate, known: Machine, calibrated: Machine) -> Workspace:
    """Return the TCP over the workspace by the base model and by the calibrated machine; ``known``
    is the posterior's machine.
    """
    base = tcp_map(known.with_posterior(before.machine.values, known.posterior))
    found, geometry = tcp_map(calibrated), known.geometry
    travels = geometry.dialled  # elsewhere no levels of travel are levels of the tool
    return Workspace(
        at=workspace_grid(geometry) - geometry.zero if travels else found.nominal,
        axis="travel of {}" if travels else "{} of the tool",
        now=without_translation(found.p - found.nominal),
        left=without_translation(found.p - base.p),
        sure_before=base.uncertainty,
        sure=found.uncertainty,
    )


def _warnings(closed: RunOutcome) -> tuple[Note, ...]:
    """Return warnings of the last fit, except lack of fit, which the verdict reports."""
    machine, found = closed.request.machine, list(closed.after.warnings)
    if (printer := machine.spec.printer) is not None:
        found += printer.assumptions(machine, closed.effects)
    return tuple(w for w in found if w.kind != "lack_of_fit")


def _noise(closed: RunOutcome) -> Noise:
    problem = closed.after.problem
    each = {
        kind: InstrumentNoise(float(sigma), OBSERVATIONS[kind].unit, source)
        for kind, (sigma, source) in problem.noise_by_instrument.items()
    }
    return Noise(
        declared=problem.declared_noise,
        single_reading=problem.one_reading,
        source=problem.noise_source,
        by_instrument=each,
    )


def _possible_causes(closed: RunOutcome) -> Iterator[Possible]:
    """Yield the most probable causes if nothing was found, each with the scores of its own fit."""
    problem = closed.before.problem
    for one in closed.possible:
        names = tuple(map(str, one.parameters))
        try:
            fit = solve(with_free(problem, names), method="nested", widen=False)
        except NumericsError:
            continue
        yield Possible(one.name, names, float(one.probability), one.words, fit.scores)


def _noise_by_setup(fit: Estimate) -> Iterator[SetupNoise]:
    """Yield the noise that the residuals show, by setup."""
    for one in noise_scales(fit):
        file, setup = source(one.readings), one.setup
        yield SetupNoise(setup.name, file, setup.kind, one.sigma, one.scale, one.scale_sigma)


def _proposal(one: Suggestion) -> Proposal:
    return Proposal(
        reason=one.reason,
        aim=one.aim,
        gain=one.gain,
        readings=one.rows,
        what=one.what,
        other_instrument=one.pool is None,
        hopeless=one.hopeless,
    )


def _unseen(closed: RunOutcome) -> tuple[Unseen, tuple[str, ...]]:
    """Return what the readings cannot detect, and the names of all parameters concerned."""
    hidden = () if closed.posterior is None else closed.posterior.invisible
    excited = {e.name for e in excited_effects(closed.after.problem)} | {*closed.catalogue.base}
    still = tuple(name for name in closed.request.machine.catalogue if name not in excited)
    varied = _unvaried_conditions(closed, still)
    found = Unseen(
        effects=_undetected_effects(closed, hidden),
        unvaried=varied,
        one_sided=_one_sided_reason(closed, varied),
        unexcited=still,
    )
    return found, tuple(map(str, (*hidden, *closed.catalogue.expand(list(varied)))))


def _undetected_effects(
    closed: RunOutcome, invisible: tuple[Parameter, ...]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return effects that would not show at three tolerances, each as a clause with the parameters
    concerned: none where it is all of them; of an effect that was found, its other parameters.
    """
    asked = [] if closed.posterior is None else closed.posterior.linearised.varied_parameters
    every, hidden = (Counter(n.effect for n in names) for names in (asked, invisible))
    several = [one for cause in closed.effects for one in cause.explanations]
    told = {one.catalogue.effect_of(one.name).name for one in several}

    def which(effect: str) -> tuple[str, ...]:
        if hidden[effect] == every[effect]:
            return (_ONE_OR_SEVERAL,) if effect in told else ()
        names = (str(n) for n in invisible if n.effect == effect)
        return tuple(name.removeprefix(f"{effect}.") for name in names)

    return tuple((cause_short(closed.catalogue, effect), which(effect)) for effect in hidden)


def _unvaried_conditions(
    closed: RunOutcome, unexcited: tuple[str, ...]
) -> dict[str, tuple[str, ...]]:
    """Return effects of the machine for which the readings vary no condition, each with those that
    it needs; empty where no cause was looked for.
    """
    problem = closed.after.problem
    several = () if closed.posterior is None else problem.machine.catalogue.effects
    asked = (e for e in several if not (e.of_dial or e.instead_of) and e.name in unexcited)
    return {effect.name: unmet_conditions(problem, effect) for effect in asked}


def _one_sided_reason(
    closed: RunOutcome, unvaried: dict[str, tuple[str, ...]]
) -> Literal["", "fixed", "same", "unknown"]:
    """Return why lost motion is not detected, as `Unseen.one_sided`."""
    if not any("approach" in needs for needs in unvaried.values()):
        return ""
    if only_surface_readings(closed.after.problem):
        return "fixed"
    known = (f.conditions().approach.any() for f in closed.after.problem.factors)
    return "same" if all(known) else "unknown"
