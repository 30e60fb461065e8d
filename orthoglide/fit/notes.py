"""Notes on a fit for its user, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.effects.wording import difference_words, signed_size
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.factors import Factor
from orthoglide.fit.noise_notes import noisy_repeats, small_residuals
from orthoglide.fit.problem import CERTAIN_SIGMAS, Problem
from orthoglide.fit.repeats import MAX_NOISE_RATIO
from orthoglide.instruments import PRINTED, SHRINKAGE_BY_MATERIAL
from orthoglide.notes import Note
from orthoglide.numerals import compact, with_sigma
from orthoglide.observations import Readings, source
from orthoglide.observations.approach import APPROACH_NOT_RECORDED, APPROACH_REMEDY
from orthoglide.observations.tables import copied_files, repeat_steps
from orthoglide.text import lower_first

_CHANCE = 1e-3  # probability of an outlier note on a campaign of sound readings
_NEARLY_MAX = 0.999  # share of the largest noise that roughness may count as
_MAX_LINES_NAMED = 8
_MIN_EQUAL_REPEATS = 6  # equal repeats: fewer may be equal by chance
_MIN_DOF = 1.0  # degrees of freedom below which the model is not tested
_TURN_PLATE_ADVICE = (
    ", and all once more with the plate turned by 60 degrees (turned_deg): what turns with it is "
    "its own, what does not comes of the machine"
)


def notes(estimate: Estimate) -> tuple[Note, ...]:
    """Return the notes on a fit: on the machine file, the readings, lack of fit, bounds, tolerances
    and the check.
    """
    problem, scores = estimate.problem, estimate.scores
    tables = [f.readings for f in problem.factors]
    collected = [Note(text, "machine") for text in problem.machine.warnings]
    spec = problem.machine.spec
    if (printer := spec.printer) is not None:
        collected += printer.imported({table.name for table in tables})
    else:  # the add-on of a firmware says this itself, first of all
        texts = filter(None, spec.measured.contradictions(spec.geometry.L))
        collected += [Note(lower_first(text[:-1]), "measured") for text in texts]
    for table in tables:
        file = f"{source(table)}: " if len(tables) > 1 else ""
        collected += [Note(file + text, "campaign") for text in table.warnings]
    collected += [*step_notes(problem), *copy_notes(problem)]
    collected += [
        Note(text, "stray") for f in problem.tool_factors for text in f.exclusion_sentences
    ]
    if estimate.sigma_scale > 1 and scores.dof >= _MIN_DOF:
        text = (
            f"the residuals are {estimate.sigma_scale:.1f} times the noise of "
            f"{problem.single_reading_sd.said()} (chi2 {scores.chi2:.0f} on {scores.dof:.0f} "
            f"degrees of freedom): the model lacks something"
        )
        if estimate.method != "posterior":  # which allows for more errors instead
            text += (
                f", and all sigmas take the readings for {estimate.sigma_scale:.1f} times as noisy"
            )
        collected.append(Note(text, "lack_of_fit"))
    else:
        collected += outlier_notes(estimate)
    collected += [*small_residuals(estimate), *large_noise_notes(estimate)]
    collected += [*noisy_repeats(estimate), *part_size_notes(estimate), *placement_notes(estimate)]
    for name in estimate.on_bound:
        text = f"{name} ended on its bound: it is not identified; check the readings and the units"
        collected.append(Note(text, "bound"))
    if estimate.method != "posterior":  # whose means are over several explanations
        collected += tolerance_notes(estimate, uncertain=True)
    check = estimate.check
    if check is not None and not check.second_order:
        text = (
            f"the linear system (11) predicts readings that differ by "
            f"{check.linear_size * 1e3:.3g} mm rms, where the second-order terms that it neglects "
            f"explain {check.linear_bound * 1e3:.3g} mm: treat the result with care"
        )
        collected.append(Note(text, "second_order"))
    return tuple(collected)


def copy_notes(problem: Problem) -> Iterator[Note]:
    """Yield notes on readings that may be copies: they equal others to the last digit."""
    tables = [f.readings for f in problem.factors]
    for text in copied_files(tables):
        yield Note(text, "copies")
    for table in tables:
        lines, equal = (
            _copied_point_lines(table) if table.by_point else (),
            repeat_steps(table) == 0,
        )
        if lines:
            text = (
                f"{_line_list(table, lines)}: the same point as before to the last "
                f"digit: a copy adds no information, so leave it out"
            )
            yield Note(text, "copies", lines)
        elif len(equal) >= _MIN_EQUAL_REPEATS and equal.all():
            text = (
                f"all {len(equal)} repeats of {table.name} are the same to the last digit as the "
                f"visit before: if they are copies they say nothing of the noise, so leave them "
                f"out and declare it"
            )
            yield Note(text, "copies")


def _copied_point_lines(table: Readings) -> tuple[int, ...]:
    """Return the lines whose command and coordinates equal those of an earlier line."""
    points = table.points()
    rows = np.nan_to_num(np.hstack([points.command, points.approach, points.p]))
    first = np.unique(rows, axis=0, return_index=True)[1]
    return tuple(np.delete(points.line, first).tolist())


def tolerance_notes(estimate: Estimate, *, uncertain: bool = False) -> Iterator[Note]:
    """Yield notes on the parameters that certainly exceed three tolerances; with ``uncertain`` also
    on those whose estimate exceeds them, but by less than its uncertainty.
    """
    problem, catalogue = estimate.problem, estimate.problem.machine.catalogue
    sd = np.sqrt(np.diag(estimate.covariance))
    certain = problem.is_implausible(estimate.x, CERTAIN_SIGMAS * sd)
    for k in np.flatnonzero(problem.is_implausible(estimate.x) if uncertain else certain).tolist():
        unknown, value = problem.unknowns[k], float(estimate.x[k])
        unit, effect = estimate.unit(unknown.name), catalogue.effect_of(unknown.name)
        sigma = f"{compact(sd[k] / unit.si, 2)}{unit.behind}"
        doubt = f"(± {sigma}, so it may be within three times the tolerance)"
        yield Note(
            f"{difference_words(catalogue, unknown.name)} is {signed_size(effect, value)}, "
            f"{abs(value) / unknown.tolerance:.1f} times its tolerance of "
            f"{compact(unknown.tolerance / unit.si, 2)}{unit.behind}"
            f"{'' if certain[k] else f' {doubt}'}: measure it; if it is so and will not be "
            f"repaired, enter a larger tolerance in the machine file",
            "tolerance",
        )


def step_notes(problem: Problem) -> Iterator[Note]:
    """Yield notes on dials whose readings show another step than that of the machine file."""
    declared = problem.machine.spec.dial.resolution
    for factor in problem.leg_factors if declared > 0 else ():
        campaign, step, file = factor.readings, factor.noise.step, source(factor.readings)
        finest = float(step.min())
        if finest > declared:
            yield Note(
                f"{file}: the readings are all multiples of {finest * 1e3:g} mm: this is taken for "
                f"the dials' step, not {declared * 1e3:g} mm; declare it as resolution under "
                f"[dial_mm] in the machine file",
                "step",
            )
        for k, setup in enumerate(campaign.setups):
            setup_step = float(step[factor.setup == k].max(initial=0.0))
            if setup_step > finest:
                yield Note(
                    f"{file}, setup {setup.name!r}: the readings are all multiples of "
                    f"{setup_step * 1e3:g} mm, those of others of {finest * 1e3:g} mm: this is "
                    f"taken for the step of this setup's dial; read it to its last digit, or look "
                    f"whether these readings are in another unit",
                    "step",
                )


def large_noise_notes(estimate: Estimate) -> Iterator[Note]:
    """Yield notes on instruments whose repeats, or whose plate, show far more noise than usual."""
    for _, factor, k, setup in estimate.problem.iter_tool_setups():
        noise, expected = factor.noise_and_expected(k)
        label = f"{source(factor.readings)}, setup {setup.name!r}"
        if noise > _NEARLY_MAX * MAX_NOISE_RATIO * expected:
            plate = ", or the plate's roughness," if setup.observation.touches else ""
            turn_advice = _TURN_PLATE_ADVICE if setup.observation.touches else ""
            yield Note(
                f"{label}: repeats{plate} have a reading count as good to "
                f"{compact(noise * 1e3, 2)} {setup.observation.unit}, "
                f"{compact(noise / expected, 2)} "
                f"times worse than is usual: smaller errors are not seen; something that moved "
                f"half way looks like this too, so read some places again at the end{turn_advice}",
                "loud",
            )
            if not factor.approach_known(k):
                yield Note(
                    f"{label}: {APPROACH_NOT_RECORDED}, so lost motion passes for the noise of its "
                    f"repeats: {APPROACH_REMEDY}",
                    "side",
                )


def placement_notes(estimate: Estimate) -> Iterator[Note]:
    """Yield notes on unusual placements of instruments at the tool."""
    for k, factor, j, setup in estimate.problem.iter_tool_setups():
        rows = factor.setup == j
        p, axis = estimate.at.reading_poses[k].p[rows], factor.readings.axis[rows]
        for text, kind in setup.observation.placement_warnings(factor.instrument_poses[j], p, axis):
            yield Note(f"{source(factor.readings)}, setup {setup.name!r}: {text}", kind)


def outlier_notes(estimate: Estimate) -> Iterator[Note]:
    """Yield notes on outliers of a fit without lack of fit: readings off by more than noise
    explains, but not by enough, or with too uncertain a noise, to be excluded.
    """
    from scipy.special import stdtrit

    problem, residual = estimate.problem, estimate.residuals
    chance = 1 - _CHANCE / (2 * max(len(residual), 1))
    limit = float(stdtrit(min(problem.noise_dof, 1e9), chance))
    for campaign, rows in zip(problem.campaigns, problem.leg_rows, strict=True):
        noise = np.hypot(problem.sigma, problem.shared_rounding_sd)[rows]
        ratio = np.abs(residual[rows]) / noise
        outliers = np.flatnonzero(ratio > limit)
        if len(outliers):
            worst = int(np.argmax(ratio))
            lines = tuple(int(line) for line in campaign.line[outliers])
            text = (
                f"{_line_list(campaign, lines)}: up to {ratio[worst]:.1f} times "
                f"the noise of a reading from what all others say: read "
                f"{'them' if len(outliers) > 1 else 'it'} again"
            )
            yield Note(text, "slip", lines)


def _line_list(readings: Readings, lines: tuple[int, ...]) -> str:
    """Return lines of a file as text, at most the first eight."""
    numbers = ", ".join(map(str, lines[:_MAX_LINES_NAMED]))
    more = " and more" if len(lines) > _MAX_LINES_NAMED else ""
    return f"{source(readings)}, line{'s' * (len(lines) > 1)} {numbers}{more}"


# The size of printed parts ------------------------------------------------------------------

_SIZE_ADVICE = (
    "the rods, the drives (belt pitch, microsteps), the part or the calliper cause the remainder: "
    "measure a rod between its holes, 100 mm of a carriage's travel (or a shorter stroke), and a "
    "gauge block with the calliper, and give the first two under [measured] of the machine file"
)
_MEAN_SIZE_SENTENCE = "printed parts are usually {} % smaller than commanded"


def part_size_notes(estimate: Estimate) -> Iterator[Note]:
    """Yield the measured scale of every file's printed parts with its standard deviation."""
    for factor in estimate.problem.tool_factors:
        rows = [s.material == PRINTED for s in factor.readings.setups]
        printed = factor.readings.paired & np.array(rows)[factor.setup] & factor.noise.weighted
        if printed.sum() > 1:
            yield _part_size_note(estimate, factor.subset(printed))


def _part_size_note(estimate: Estimate, factor: Factor) -> Note:
    """Return the scale of a printed part, by least squares with the offsets of its setups."""
    machine, (mean, sd) = estimate.problem.machine, SHRINKAGE_BY_MATERIAL[PRINTED]
    values, rods = estimate.machine.values, machine.spec.measured.rods
    if not rods:  # only nominal values: the firmware's rods belong to its radius
        values = {n: e.value for n, e in machine.spec.parameters.items() if not e.sigma}
    linear = factor.linearise(machine.model, values, ())
    nuisance = factor.nuisances(linear.reading_poses)
    # Scale, the only nuisance that setups share, comes first; it has no prior here.
    prior = np.where(np.arange(len(nuisance.sd)) == 0, 0.0, 1 / nuisance.sd)
    rows = np.vstack([nuisance.columns / factor.sigma[:, None], np.diag(prior)])
    target = np.zeros(len(rows))
    target[: len(factor.sigma)] = (factor.measured - linear.value) / factor.sigma
    covariance = np.linalg.inv(rows.T @ rows)
    scale, sigma = float((covariance @ rows.T @ target)[0]), float(np.sqrt(covariance[0, 0]))
    size = (1 - mean) * (1 + scale) - 1
    text = (
        f"{source(factor.readings)}: by the "
        f"{'measured rods' if rods else 'nominal numbers of the machine file'}, distances are "
        f"{with_sigma(abs(size) * 1e2, sigma * 1e2)} % {'longer' if size > 0 else 'shorter'} "
        f"than the tool's moves; {_MEAN_SIZE_SENTENCE.format(with_sigma(mean * 1e2, sd * 1e2))}"
    )
    beyond = abs(scale) > CERTAIN_SIGMAS * float(np.hypot(sigma, sd))
    unexplained = beyond and not rods
    return Note(f"{text}: {_SIZE_ADVICE}" if unexplained else text, "size")
