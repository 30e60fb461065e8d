"""What a user should know of a fit, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.effects.wording import parameter_words
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.factors import Factor
from orthoglide.fit.noise_notes import noisy_dials, noisy_instruments, small_residuals
from orthoglide.fit.problem import Problem
from orthoglide.fit.repeats import GRID_TOLERANCE, off_grid
from orthoglide.fit.roughness import MAX_NOISE_RATIO
from orthoglide.instruments import PRINTED, SHRINKAGE_BY_MATERIAL
from orthoglide.notes import Note
from orthoglide.numerals import compact, with_sigma
from orthoglide.observations import Readings, source
from orthoglide.observations.approach import APPROACH_NOT_RECORDED, APPROACH_REMEDY
from orthoglide.observations.repetition import (
    copied_files,
    copied_point_lines,
    count_copied_repeats,
)

_CHANCE = 1e-3  # of a campaign in which noise alone makes a reading that is said to be off
_NEARLY_MAX = 0.999  # of the loudest that a plate's roughness may count as
_MAX_LINES_NAMED = 8  # lines
_MIN_DOF = 1.0  # degrees of freedom: less is no test of a model
_MIN_READINGS = 8  # different readings: by chance one in eight is a multiple of the step
_ON_STEP_SHARE = 0.9  # share of the readings of a setup that its dial's step tells
_TURN_PLATE_ADVICE = (
    ", and all once more with the plate turned by 60 degrees (turned_deg): what turns with it is "
    "its own, what does not comes of the machine"
)


def notes(estimate: Estimate) -> tuple[Note, ...]:
    """Notes of a fit: what was noticed on reading the machine's file and the readings, lack of fit,
    bounds, tolerances, the check.
    """
    problem, scores = estimate.problem, estimate.scores
    given = [f.readings for f in problem.factors]
    found = [Note(text, "machine") for text in problem.machine.warnings]
    if (printer := problem.machine.spec.printer) is not None:
        found += printer.imported({points.name for points in given})
    for points in given:
        file = f"{source(points)}: " if len(given) > 1 else ""
        found += [Note(file + text, "campaign") for text in points.warnings]
    found += [*coarse_step_notes(problem), *off_step_notes(problem)]
    found += copy_notes(problem)
    found += [Note(text, "stray") for f in problem.tool_factors for text in f.exclusion_sentences]
    if estimate.sigma_scale > 1 and scores.dof >= _MIN_DOF:
        text = (
            f"the residuals are {estimate.sigma_scale:.1f} times the noise of "
            f"{problem.one_reading.said()} (chi2 {scores.chi2:.0f} on {scores.dof:.0f} "
            f"degrees of freedom): the model lacks something"
        )
        if estimate.method != "posterior":  # which allows for more errors instead
            text += (
                f", and all sigmas take the readings for {estimate.sigma_scale:.1f} times as noisy"
            )
        found.append(Note(text, "lack_of_fit"))
    else:
        found += outlier_notes(estimate)
    found += [*small_residuals(estimate), *large_noise_notes(estimate), *noisy_dials(estimate)]
    found += noisy_instruments(estimate)
    found += part_size_notes(problem)
    found += placement_notes(estimate)
    for name in estimate.on_bound:
        text = f"{name} ended on its bound: it is not identified; check the readings and the units"
        found.append(Note(text, "bound"))
    found += tolerance_notes(estimate)
    check = estimate.check
    if check is not None and not check.second_order:
        text = (
            f"the linear system (11) fits readings that differ by {check.linear * 1e3:.3g} mm, "
            f"more than second-order terms explain: treat the result with care"
        )
        found.append(Note(text, "second_order"))
    return tuple(found)


def copy_notes(problem: Problem) -> Iterator[Note]:
    """Readings that are the same to the last digit as others, and so may be copies of them."""
    given = [f.readings for f in problem.factors]
    for text in copied_files(given):
        yield Note(text, "copies")
    for one in given:
        if one.by_point and (lines := copied_point_lines(one)):
            text = (
                f"{_line_list(one, lines)}: the same point as before to the last "
                f"digit: a copy tells nothing that the other does not, so leave it out"
            )
            yield Note(text, "copies", lines)
        elif count := count_copied_repeats(one):
            text = (
                f"all {count} repeats of {one.name} are the same to the last digit as the "
                f"visit before: if they are copies they say nothing of the noise, so leave them "
                f"out and declare it"
            )
            yield Note(text, "copies")


def tolerance_notes(estimate: Estimate) -> Iterator[Note]:
    """Parameters of the base beyond what their tolerances let expect."""
    problem, catalogue = estimate.problem, estimate.problem.machine.catalogue
    for unknown, value, far in zip(
        problem.unknowns, estimate.x, problem.is_implausible(estimate.x), strict=True
    ):
        if far:
            unit = estimate.unit(unknown.name)
            text = (
                f"{parameter_words(catalogue.parameter(unknown.name), catalogue.legs)} "
                f"is {abs(value) / unknown.tolerance:.1f} times its tolerance of "
                f"{compact(unknown.tolerance / unit.si, 2)}{unit.behind}: measure it, or correct "
                f"the tolerance in the machine file"
            )
            yield Note(text, "tolerance")


def coarse_step_notes(problem: Problem) -> Iterator[Note]:
    """Campaigns and setups whose readings show a coarser step than that of the machine's dial."""
    declared = problem.machine.spec.dial.resolution
    for factor in problem.leg_factors:
        campaign, step = factor.readings, factor.noise.step
        if (least := float(step.min())) > declared:
            told = f"{least * 1e3:g} mm"
            yield Note(
                f"{source(campaign)}: the readings are all multiples of {told}: this is taken for "
                f"the dials' step, not {declared * 1e3:g} mm; declare it as resolution under "
                f"[dial_mm] in the machine file",
                "step",
            )
        for setup in np.unique(campaign.setup[step > least]).tolist():
            told = f"{float(step[campaign.setup == setup][0]) * 1e3:g} mm"
            yield Note(
                f"{source(campaign)}, setup {campaign.setups[setup].name!r}: the readings are all "
                f"multiples of {told}, those of others of {least * 1e3:g} mm: this is taken for "
                f"the step of this setup's dial; read it to its last digit, or look whether these "
                f"readings are in another unit",
                "step",
            )


def off_step_notes(problem: Problem) -> Iterator[Note]:
    """Setups of which few readings are multiples of the dial's step, where those of others are."""
    step = problem.machine.spec.dial.resolution
    for campaign in problem.campaigns if step > 0 else ():
        shown = [np.unique(campaign.reading[campaign.setup == k])
                 for k in range(len(campaign.setups))]  # fmt: skip
        share = np.array([np.mean(off_grid(own, step) < GRID_TOLERANCE) for own in shown])
        if np.mean(share > _ON_STEP_SHARE) <= 0.5:
            continue
        for k in np.flatnonzero((share < 0.5) & (np.array([*map(len, shown)]) >= _MIN_READINGS)):
            yield Note(
                f"{source(campaign)}, setup {campaign.setups[k].name!r}: the readings are no "
                f"multiples of the dial's step of {step * 1e3:g} mm, and those of other setups "
                f"are: look whether this dial shows inches; give its readings in millimetres",
                "step",
            )


def large_noise_notes(estimate: Estimate) -> Iterator[Note]:
    """Instruments whose repeats, or whose plate, have them count as far noisier than their kind."""
    for _, factor, k, setup in estimate.problem.tool_setups:
        size, kind = factor.noise_and_expected(k)
        if size > _NEARLY_MAX * MAX_NOISE_RATIO * kind:
            plate = ", or the plate's roughness," if setup.observation.touches else ""
            turned = _TURN_PLATE_ADVICE if setup.observation.touches else ""
            yield Note(
                f"{source(factor.readings)}, setup {setup.name!r}: repeats{plate} have a reading "
                f"count as good to {compact(size * 1e3, 2)} {setup.observation.unit}, "
                f"{compact(size / kind, 2)} "
                f"times worse than is usual: smaller errors are not seen; something that moved "
                f"half way looks like this too, so read some places again at the end{turned}",
                "loud",
            )
            if not factor.approach_known(k):
                yield Note(
                    f"{source(factor.readings)}, setup {setup.name!r}: {APPROACH_NOT_RECORDED}, so lost "
                    f"motion passes for the noise of its repeats: {APPROACH_REMEDY}",
                    "side",
                )


def placement_notes(estimate: Estimate) -> Iterator[Note]:
    """What is odd in where instruments at the tool stand by their readings."""
    for k, factor, j, setup in estimate.problem.tool_setups:
        rows = factor.setup == j
        p, axis = estimate.at.reading_poses[k].p[rows], factor.readings.axis[rows]
        for text, kind in setup.observation.placement_warnings(factor.instrument_poses[j], p, axis):
            yield Note(f"{source(factor.readings)}, setup {setup.name!r}: {text}", kind)


def outlier_notes(estimate: Estimate) -> Iterator[Note]:
    """Readings that stand out of a fit which leaves nothing else: too near to be set aside, or too
    little is known of the noise, but nothing that noise does.
    """
    from scipy.special import stdtrit

    problem, residual = estimate.problem, estimate.residuals
    chance = 1 - _CHANCE / (2 * max(len(residual), 1))
    limit = float(stdtrit(min(problem.noise_dof, 1e9), chance))
    for campaign, rows in zip(problem.campaigns, problem.leg_rows, strict=True):
        noise = np.hypot(problem.sigma, problem.common)[rows]
        times = np.abs(residual[rows]) / noise
        off = np.flatnonzero(times > limit)
        if len(off):
            worst = int(np.argmax(times))
            lines = tuple(int(line) for line in campaign.line[off])
            text = (
                f"{_line_list(campaign, lines)}: up to {times[worst]:.1f} times "
                f"the noise of a reading from what all others say: read "
                f"{'them' if len(off) > 1 else 'it'} again"
            )
            yield Note(text, "slip", lines)


def _line_list(given: Readings, lines: tuple[int, ...]) -> str:
    """Lines of a file, the first of many."""
    told = ", ".join(map(str, lines[:_MAX_LINES_NAMED])) + (
        " and more" if len(lines) > _MAX_LINES_NAMED else ""
    )
    return f"{source(given)}, line{'s' * (len(lines) > 1)} {told}"


# The size of printed parts ------------------------------------------------------------------

_MAX_SIZE_SIGMAS = 2.0  # sigmas: one part in twenty is off by more, if nothing is wrong
_SIZE_ADVICE = (
    "what is beyond that is of the rods, of the drives (belt pitch, microsteps), of the part or of "
    "the calliper: measure a rod between its holes, 100 mm of a carriage's travel, and a gauge "
    "block with the calliper, and give the first two under [measured] of the machine file"
)
_MEAN_SIZE_SENTENCE = "printed parts are {} % smaller than they were commanded"


def part_size_notes(problem: Problem) -> Iterator[Note]:
    """Yield the measured scale of every file's printed parts with its standard deviation."""
    for factor in problem.tool_factors:
        rows = [s.material == PRINTED for s in factor.readings.setups]
        printed = factor.readings.paired & np.array(rows)[factor.setup] & factor.noise.weighted
        if printed.sum() > 1:
            yield _part_size_note(problem, factor.subset(printed))


def _part_size_note(problem: Problem, factor: Factor) -> Note:
    """Return the scale of a printed part, by least squares with the offsets of its setups."""
    machine, (mean, sd) = problem.machine, SHRINKAGE_BY_MATERIAL[PRINTED]
    # Without what was identified or measured: the rods that the firmware has go with its radius.
    values = {n: e.value for n, e in machine.spec.parameters.items() if not e.sigma}
    here = factor.linearise(machine.model, values, ())
    nuisance = factor.nuisances(here.reading_poses)
    # Scale is the only nuisance that setups have together, and stands first: nothing is taken as
    # known of it here.
    prior = np.where(np.arange(len(nuisance.sd)) == 0, 0.0, 1 / nuisance.sd)
    rows = np.vstack([nuisance.columns / factor.sigma[:, None], np.diag(prior)])
    aim = np.zeros(len(rows))
    aim[: len(factor.sigma)] = (factor.measured - here.value) / factor.sigma
    inverse = np.linalg.inv(rows.T @ rows)
    scale, sigma = float((inverse @ rows.T @ aim)[0]), float(np.sqrt(inverse[0, 0]))
    size = (1 - mean) * (1 + scale) - 1
    text = (
        f"{source(factor.readings)}: by the nominal numbers of the machine file, distances are "
        f"{with_sigma(abs(size) * 1e2, sigma * 1e2)} % {'longer' if size > 0 else 'shorter'} "
        f"than the tool went; {_MEAN_SIZE_SENTENCE.format(with_sigma(mean * 1e2, sd * 1e2))}"
    )
    beyond = (
        abs(scale) > _MAX_SIZE_SIGMAS * float(np.hypot(sigma, sd))
        and not machine.spec.measured.rods
    )
    return Note(f"{text}: {_SIZE_ADVICE}" if beyond else text, "size")
