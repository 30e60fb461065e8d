"""The result of a finished run: every value that a report shows, computed once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any, Literal, TypeVar

import numpy as np

from orthoglide.accuracy import tcp_map, without_translation, workspace_grid
from orthoglide.closing.actions import actions, next_measurements, not_advised
from orthoglide.closing.drawing import picture
from orthoglide.closing.outcome import RunOutcome
from orthoglide.effects.wording import cause_short
from orthoglide.errors import NumericsError
from orthoglide.explanation import FullPosterior
from orthoglide.explanation.free_form import only_surface_readings
from orthoglide.fit import Estimate, Problem, solve
from orthoglide.fit.assembling import excited_effects, unmet_conditions, with_free
from orthoglide.fit.estimate import fitted_readings
from orthoglide.fit.factors import NuisanceBlock
from orthoglide.fit.noise_notes import noise_scales
from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine import Machine
from orthoglide.observations import campaign_rows, source
from orthoglide.parameters import Parameter
from orthoglide.planning import next_sheet
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import Curve, Result, Workspace, encoded, fits
from orthoglide.result.display import Proposal
from orthoglide.result.findings import Possible
from orthoglide.result.fits import Fit, Noise, SetupNoise
from orthoglide.result.result import Unseen
from orthoglide.threads import on_one_thread

_ROUNDING = 1e-12
"""Metres: smaller differences of two derivations are rounding, which depends on the processor."""

_ONE_OR_SEVERAL = "a single one of them, or several of different sizes"

R = TypeVar("R", bound=Result)
T = TypeVar("T")


@on_one_thread
def build_result(outcome: RunOutcome, cls: type[R], progress: Progress = no_progress) -> R:
    """Return a finished run as an instance of ``cls``, `Result` or a subclass of it.

    The values are encoded as in ``result.json`` and decoded again, so that a result that is loaded
    later equals this one to the last digit.
    """
    progress(Step("suggesting"))
    return cls.read(encoded(_result_values(outcome)), outcome.request, outcome.machine)


def _result_values(outcome: RunOutcome) -> Result:
    base, after = outcome.before, outcome.after
    kinds = {s.kind for f in after.problem.factors for s in f.readings.setups}
    suggestions, posterior = next_measurements(outcome), outcome.posterior
    sheet = next_sheet(suggestions)
    unseen, invisible = _unseen(outcome)
    problem, check = after.problem, base.check
    warnings, machine = list(after.warnings), outcome.request.machine
    if (printer := machine.spec.printer) is not None:
        warnings += printer.assumptions(machine, outcome.effects)
    predicted = base.predicted_before, base.predicted, after.predicted
    if check is not None:
        differences = ("reduction", "linear", "linear_size")
        check = replace(check, **{n: max(getattr(check, n), _ROUNDING) for n in differences})
    noise, (first_noise, *_) = problem.noise_by_instrument, problem.noise_by_instrument.values()
    return _value_of(
        Result,
        outcome,
        noise=Noise(problem.declared_noise, problem.single_reading_sd, first_noise.source, noise),
        nominal=base.nominal,
        before=_value_of(Fit, base),
        after=_value_of(Fit, after),
        rms_of_all=(outcome.fit_with_faults or base).scores.rms,
        changed=tuple(
            _value_of(
                fits.Change,
                c,
                before=c.before / c.unit.si,
                after=c.after / c.unit.si,
                sigma=c.sigma / c.unit.si,
                unit=c.unit.name,
                each=c.member_clauses,
            )
            for c in outcome.changed
        ),
        weak=after.weak,
        check=check,
        verification=after.verification,
        next_measurements=tuple(
            _value_of(Proposal, s, readings=s.rows, other_instrument=s.pool is None)
            for s in suggestions
        ),
        sheet=() if sheet is None else tuple(campaign_rows(sheet)),
        left=outcome.lack_of_fit,
        actions=actions(outcome, suggestions, sheet),
        picture=picture(outcome),
        workspace=None if posterior is None else _workspace(base, posterior, outcome.machine),
        invisible=invisible,
        unseen=unseen,
        instruments={k: o.instrument_phrase for k, o in OBSERVATIONS.items() if k in kinds},
        warnings=tuple(w for w in warnings if w.kind != "lack_of_fit"),  # the verdict reports it
        calibrated_before=base.problem.has_earlier_calibration,
        shapes_of_plate=posterior is not None and bool(posterior.mixture.linear.plate_shapes.any()),
        readings=fitted_readings(problem, *predicted, outcome.request.given),
        withheld=not_advised(outcome),
        possible=tuple(_possible_causes(outcome)),
        noise_by_setup=tuple(_noise_by_setup(after)),
        compared=(),
    )


def _workspace(before: Estimate, posterior: FullPosterior, calibrated: Machine) -> Workspace:
    """Return the TCP over the workspace by the base model and by the calibrated machine."""
    machine, geometry = posterior.machine, calibrated.geometry
    base_map = tcp_map(machine.with_posterior(before.machine.values, machine.posterior))
    calibrated_map = tcp_map(calibrated)
    dialled = geometry.dialled  # on other layouts equal travels are no level of the tool
    return Workspace(
        at=workspace_grid(geometry) - geometry.zero if dialled else calibrated_map.nominal,
        axis="travel of {}" if dialled else "{} of the tool",
        now=without_translation(calibrated_map.p - calibrated_map.nominal),
        left=without_translation(calibrated_map.p - base_map.p),
        sure_before=base_map.uncertainty,
        sure=calibrated_map.uncertainty,
    )


def _possible_causes(outcome: RunOutcome) -> Iterator[Possible]:
    """Yield the most probable causes if nothing was found, each with the scores of its own fit."""
    problem = outcome.before.problem
    for cause in outcome.possible:
        names = () if isinstance(cause, Curve) else tuple(map(str, cause.parameters))
        added = with_free(problem, names) if names else _with_curve(outcome, cause.name)
        try:
            fit = solve(added, method="nested", widen=False)
        except NumericsError:
            continue
        yield Possible(cause.name, names, float(cause.probability), cause.words, fit.scores)


def _with_curve(outcome: RunOutcome, name: str) -> Problem:
    """Return the problem of the base model with a free-form error as a further nuisance."""
    problem, posterior = outcome.before.problem, outcome.posterior
    if posterior is None:
        return problem
    mixture = posterior.mixture
    k = [group.name for group in mixture.linear.groups].index(name)
    ((_, tau),) = mixture.child((), k)
    index = mixture.linear.groups[k].coefficients
    curve = NuisanceBlock(posterior.linearised.rows.columns(index), np.full(len(index), tau))
    return replace(problem, free_form_nuisances=curve)


def _noise_by_setup(fit: Estimate) -> Iterator[SetupNoise]:
    """Yield the noise that the residuals show, by setup."""
    for noise in noise_scales(fit):
        file, setup = source(noise.readings), noise.setup
        yield SetupNoise(setup.name, file, setup.kind, noise.sigma, noise.scale, noise.scale_sigma)


def _unseen(outcome: RunOutcome) -> tuple[Unseen, tuple[str, ...]]:
    """Return the effects that the readings do not show, and the names of all parameters concerned.

    An undetectable parameter was tested, and could not be detected at three tolerances. An untested
    effect needs a condition that was not varied.
    """
    problem, posterior = outcome.after.problem, outcome.posterior
    excited = {e.name for e in excited_effects(problem)} | {*outcome.catalogue.base}
    untested = tuple(name for name in outcome.request.machine.catalogue if name not in excited)
    undetectable, conditions = tuple[Parameter, ...](), dict[str, tuple[str, ...]]()
    if posterior is not None:
        undetectable, effects = posterior.invisible, problem.machine.catalogue.effects
        considered = (e for e in effects if not (e.of_dial or e.instead_of))
        conditions = {
            e.name: unmet_conditions(problem, e) for e in considered if e.name in untested
        }
    clauses = _undetectable_effects(outcome, undetectable)
    reason = _one_sided_reason(outcome, conditions)
    names = tuple(map(str, (*undetectable, *outcome.catalogue.expand(list(conditions)))))
    return Unseen(clauses, conditions, reason, untested), names


def _undetectable_effects(
    outcome: RunOutcome, undetectable: tuple[Parameter, ...]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the effects with undetectable parameters, as `Unseen.effects`."""
    tested = [] if outcome.posterior is None else outcome.posterior.linearised.excited_parameters
    tested_counts, counts = (Counter(n.effect for n in ns) for ns in (tested, undetectable))
    explanations = (explanation for cause in outcome.effects for explanation in cause.explanations)
    found_effects = {e.catalogue.effect_of(e.name).name for e in explanations}

    def parameters_concerned(effect: str) -> tuple[str, ...]:
        if counts[effect] == tested_counts[effect]:
            return (_ONE_OR_SEVERAL,) if effect in found_effects else ()
        names = (str(n) for n in undetectable if n.effect == effect)
        return tuple(name.removeprefix(f"{effect}.") for name in names)

    catalogue = outcome.catalogue
    return tuple((cause_short(catalogue, e), parameters_concerned(e)) for e in counts)


def _one_sided_reason(
    outcome: RunOutcome, conditions: dict[str, tuple[str, ...]]
) -> Literal["", "fixed", "same", "unknown"]:
    """Return why lost motion is untested, as `Unseen.one_sided`.

    Args:
        outcome: of the run.
        conditions: that untested effects need, by effect.
    """
    if not any("approach" in needs for needs in conditions.values()):
        return ""
    if only_surface_readings(outcome.after.problem):
        return "fixed"
    recorded = (f.conditions().approach.any() for f in outcome.after.problem.factors)
    return "same" if all(recorded) else "unknown"


def _value_of(cls: type[T], source: object, **others: Any) -> T:
    """Return an instance of a dataclass of a result; fields without a value of their own are copied
    from the attributes of ``source`` with the same names.
    """
    names = (f.name for f in fields(cls) if f.name not in others)  # type: ignore[arg-type]
    return cls(**{name: getattr(source, name) for name in names}, **others)
