"""The result of a finished run: every value that a report shows, computed once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import accumulate, chain
from typing import Any, Literal, TypeVar

import numpy as np

from orthoglide.accuracy import tcp_map, without_translation, workspace_grid
from orthoglide.closing.actions import actions, next_measurements, not_advised
from orthoglide.closing.outcome import RunOutcome
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_short
from orthoglide.effects.words import toward
from orthoglide.errors import NumericsError
from orthoglide.explanation import FullPosterior
from orthoglide.explanation.change import Change
from orthoglide.explanation.free_form import only_surface_readings
from orthoglide.fit import Estimate, solve
from orthoglide.fit.assembling import excited_effects, unmet_conditions, with_free
from orthoglide.fit.estimate import fitted_readings
from orthoglide.fit.noise_notes import noise_scales
from orthoglide.geometry import LEGS
from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine import Machine
from orthoglide.numerals import compact
from orthoglide.observations import campaign_rows, source
from orthoglide.parameters import Parameter
from orthoglide.pictures import dials, joint_mark, option
from orthoglide.planning import next_sheet
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import (
    Curve,
    Fit,
    Noise,
    Picture,
    Possible,
    Proposal,
    Result,
    SetupNoise,
    Unseen,
    Workspace,
    encoded,
    fits,
)
from orthoglide.scene import Mark, Option
from orthoglide.threads import on_one_thread


def picture(outcome: RunOutcome) -> Picture:
    """Return the drawing of the machine with the findings marked, or with the dial of the largest
    residual.
    """
    machine = outcome.before.problem.machine.with_only({})
    posed = machine.posed()
    groups: list[list[Option]] = []  # one for each finding, most probable option first
    for cause in outcome.effects:
        causes = [option(machine, e.words, e.values) for e in cause.explanations]
        groups.append([*causes, *(_located_option(machine, c) for c in cause.places)])
    groups += [[_located_option(machine, c) for c in f.members] for f in outcome.located]
    groups += [_change_options(machine, change) for change in outcome.moved]
    dials_hold_most = outcome.lack_of_fit.dials_hold_most
    if outcome.word == "unexplained" and dials_hold_most and outcome.request.searches:
        groups.append([_residual_option(outcome)])
    first_shown = accumulate([len(group) for group in groups[:-1]], initial=0) if groups else ()
    mounted_dials = dials(posed, outcome.after.problem.campaigns)
    return Picture(posed, mounted_dials, tuple(chain(*groups)), tuple(first_shown))


def _change_options(machine: Machine, change: Change) -> list[Option]:
    """Return the parameters that may have changed, each marked on its part."""
    options = []
    members = zip(change.member_clauses, change.change_by_member.items(), strict=True)
    for words, (name, difference) in members:
        drawn = option(machine, words, {name: difference} if math.isfinite(difference) else {})
        marks = (replace(m, label=m.label and f"changed by {m.label}") for m in drawn.marks)
        options.append(replace(drawn, marks=tuple(marks)))
    return options


def _located_option(machine: Machine, curve: Curve) -> Option:
    """Return a located error with the mark of its joint, which moves by the curve found."""
    place: FreeForm = curve.place
    size = curve.size_words
    if place.of_dial:
        return Option(place.words, (Mark("dial", -1, np.zeros(3), size, setup=place.setup),))
    if place.moves_bar_ends:
        direction = np.eye(3)[LEGS.index(place.direction)]
        return Option(place.words, (Mark("platform", place.leg, direction, size, both=True),))
    # A curve without a sign runs to both sides of its line.
    both, along = curve.loses or not place.is_signed, place.against == "travel"
    bars = len(place.joints) > 1
    value = curve.value if along else np.full(len(curve.at), curve.size)
    travel = curve.at if along else np.linspace(*machine.geometry.stroke, len(curve.at))
    joint = place.joints[0][0]
    mark = joint_mark(machine, place.leg, joint, travel, value, size, both, bars)
    return Option(place.words, (mark,))


def _residual_option(outcome: RunOutcome) -> Option:
    largest = outcome.lack_of_fit.by_dial[0]
    direction = np.eye(3)[largest.axis] * np.sign(largest.most)
    way = toward(LEGS[largest.axis], largest.most)
    size = f"{compact(abs(largest.most) * 1e3, 2)} mm toward {way}"
    words = f"the residual is largest on leg {LEGS[largest.leg]}: {size}"
    return Option(words, (Mark("dial", largest.leg, direction, size, setup=largest.setup),))


_ROUNDING = 1e-12
"""Metres: smaller differences of two derivations are rounding, which depends on the processor."""

_ONE_OR_SEVERAL = "one alone, or several differently"

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
        names = tuple(map(str, cause.parameters))
        try:
            fit = solve(with_free(problem, names), method="nested", widen=False)
        except NumericsError:
            continue
        yield Possible(cause.name, names, float(cause.probability), cause.words, fit.scores)


def _noise_by_setup(fit: Estimate) -> Iterator[SetupNoise]:
    """Yield the noise that the residuals show, by setup."""
    for noise in noise_scales(fit):
        file, setup = source(noise.readings), noise.setup
        yield SetupNoise(setup.name, file, setup.kind, noise.sigma, noise.scale, noise.scale_sigma)


def _unseen(outcome: RunOutcome) -> tuple[Unseen, tuple[str, ...]]:
    """Return what the readings cannot detect, and the names of all parameters concerned."""
    problem, posterior = outcome.after.problem, outcome.posterior
    excited = {e.name for e in excited_effects(problem)} | {*outcome.catalogue.base}
    unexcited = tuple(name for name in outcome.request.machine.catalogue if name not in excited)
    hidden, unvaried = tuple[Parameter, ...](), dict[str, tuple[str, ...]]()
    if posterior is not None:
        hidden, effects = posterior.invisible, problem.machine.catalogue.effects
        considered = (e for e in effects if not (e.of_dial or e.instead_of))
        unvaried = {e.name: unmet_conditions(problem, e) for e in considered if e.name in unexcited}
    undetected, reason = _undetected_effects(outcome, hidden), _one_sided_reason(outcome, unvaried)
    names = tuple(map(str, (*hidden, *outcome.catalogue.expand(list(unvaried)))))
    return Unseen(undetected, unvaried, reason, unexcited), names


def _undetected_effects(
    outcome: RunOutcome, invisible: tuple[Parameter, ...]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the effects that could not be detected at three tolerances, as `Unseen.effects`."""
    tested = [] if outcome.posterior is None else outcome.posterior.linearised.excited_parameters
    tested_counts, hidden_counts = (Counter(n.effect for n in ns) for ns in (tested, invisible))
    explanations = (explanation for cause in outcome.effects for explanation in cause.explanations)
    found_effects = {e.catalogue.effect_of(e.name).name for e in explanations}

    def parameters_concerned(effect: str) -> tuple[str, ...]:
        if hidden_counts[effect] == tested_counts[effect]:
            return (_ONE_OR_SEVERAL,) if effect in found_effects else ()
        names = (str(n) for n in invisible if n.effect == effect)
        return tuple(name.removeprefix(f"{effect}.") for name in names)

    catalogue = outcome.catalogue
    return tuple((cause_short(catalogue, e), parameters_concerned(e)) for e in hidden_counts)


def _one_sided_reason(
    outcome: RunOutcome, unvaried: dict[str, tuple[str, ...]]
) -> Literal["", "fixed", "same", "unknown"]:
    """Return why lost motion is not detected, as `Unseen.one_sided`."""
    if not any("approach" in needs for needs in unvaried.values()):
        return ""
    if only_surface_readings(outcome.after.problem):
        return "fixed"
    recorded = (f.conditions().approach.any() for f in outcome.after.problem.factors)
    return "same" if all(recorded) else "unknown"


# --- Findings -------------------------------------------------------------------------------


def _value_of(cls: type[T], source: object, **others: Any) -> T:
    """Return an instance of a dataclass of a result; fields without a value of their own are copied
    from the attributes of ``source`` with the same names.
    """
    names = (f.name for f in fields(cls) if f.name not in others)  # type: ignore[arg-type]
    return cls(**{name: getattr(source, name) for name in names}, **others)
