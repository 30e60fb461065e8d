"""The noise assumed of each instrument: checked and enlarged by repeats, re-estimated after each
correction of data faults, and reduced where the posterior has more evidence with less.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from orthoglide.errors import InputError, NumericsError
from orthoglide.explanation.base_fit import fit_nested
from orthoglide.explanation.faults import Fault, Rows, factors_and_rows, fault_message
from orthoglide.explanation.full_posterior import FullPosterior, posterior_with_corrected_commands
from orthoglide.fit import Estimate, Factor, Problem
from orthoglide.fit.noise import noise_of, rms_noise
from orthoglide.fit.noise_notes import noise_scales
from orthoglide.fit.repeats import scatters_more
from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.observations.tables import repeat_rows, repeat_steps
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of

_MIN_VARIANCE_RATIO = 1e-4  # least ratio of noise variances: computed readings have no noise
_ROUNDS = 6  # rounds of leaving out outliers: 12 changed no result

_SCATTER_LIMIT, NO_NOISE_RATIO = 3.0, 10.0
"""Ratios to the expected scatter of a dial, and of an instrument at the tool, beyond which repeats
are not noise. If the noise was declared, the second applies to dials too, relative to all dials."""

_FEWEST_DIFFERENCES = 10  # that decide on the scatter: their deviation is known to a third

_OUTLIER_RATIO = 4.0
"""Ratio to the robust scatter beyond which a difference is an outlier: chance 1 in 16 000."""

_UPPER_QUANTILE, _MEDIAN_QUANTILE = (0.7, 1.04), (0.5, 0.674)
"""Share of differences, assumed to be without slips, that gives their scatter, and the normal
quantile of that share. The median, which tolerates more slips, is for noise that repeats refute: a
slip occurs in up to three differences of steps, and a ratio of 1.2 refutes. Other limits are wide
enough for the upper quantile."""

_REFUTING_RATIO, _REFUTING_CHANCE = 1.2, 1e-3
"""Ratio to the assumed noise beyond which repeats refute it, and the largest probability of such
scatter by chance, as in the note of the fit."""


def find_scattered_setups(problem: Problem) -> list[Fault]:
    """Return the setups of dials whose repeats scatter more than the repeats of a working dial can.

    Noise estimated from repeats is compared with that of the machine file or of typical dials. A
    shifted datum or a single slip does not count as scatter.

    Raises:
        InputError: if most setups scatter, because then no row can be trusted.
    """
    candidates, pooled = list[tuple[Fault, bool]](), [np.zeros(0)]
    for number in problem.leg_setups:
        rows = np.flatnonzero(problem.setup_of_row == number)
        k, _ = factors_and_rows(problem, rows[:1])[0]
        factor, own_rows = problem.factors[k], rows - problem.factor_rows[k].start
        step = float(factor.noise.step[own_rows].max())
        limit = _SCATTER_LIMIT * max(_expected_noise(factor, own_rows), step)
        if not factor.noise.from_repeats[own_rows].all():  # declared
            limit = NO_NOISE_RATIO * float(np.median(factor.noise.total))
        differences = _successive_differences(factor.readings.subset(own_rows))
        fault = Fault("scatter", rows, _robust_scatter(differences, step))
        candidates.append((fault, len(differences) >= _FEWEST_DIFFERENCES and fault.size > limit))
        pooled.append(differences / limit)
    scattered = [fault for fault, exceeds in candidates if exceeds]
    together = np.concatenate(pooled)
    all_scatter = len(together) >= _FEWEST_DIFFERENCES and _robust_scatter(together, 0.0) > 1.0
    if all_scatter or 2 * len(scattered) > len(candidates):
        measurable = [f for f, _ in candidates if np.isfinite(f.size)]
        worst = best_of(measurable, lambda fault: fault.size)
        raise InputError(fault_message(problem, worst) + "; most other setups are no better")
    return scattered


def check_scatter(problem: Problem) -> None:
    """Refuse readings of the tool whose repeats, with data faults corrected, scatter more than the
    repeats of a working instrument can.

    Raises:
        InputError: names file and setup, and what to do.
    """
    messages = list[str]()
    for k, factor, setup, _ in problem.iter_tool_setups():
        setup_rows = np.flatnonzero((factor.setup == setup) & factor.noise.weighted)
        if not len(setup_rows) or not factor.noise.from_repeats[setup_rows].any():
            continue
        size = float(np.sqrt(np.mean(factor.noise.total[setup_rows] ** 2)))
        if size > NO_NOISE_RATIO * _expected_noise(factor, setup_rows):
            rows = setup_rows + problem.factor_rows[k].start
            messages.append(fault_message(problem, Fault("scatter", rows, size)))
    if messages:
        raise InputError("; ".join(messages))


def _expected_noise(factor: Factor, rows: Rows) -> float:
    return float(np.sqrt(np.mean(factor.noise.expected[rows] ** 2)))


def _successive_differences(readings: Readings) -> Array:
    """Return the differences of successive steps between repeats ``(k,)``, in standard deviations
    of one reading. Neither a drift nor a shifted datum enlarges them.

    Two steps of one station share a reading, ``a - 2 b + c``, so that their difference has six
    times the variance of a reading; that of other steps has four times.
    """
    later, earlier = repeat_rows(readings)
    order = np.argsort(readings.order[later], kind="stable")
    share_reading = later[order][:-1] == earlier[order][1:]
    return np.asarray(
        np.diff(repeat_steps(readings)[order]) / np.sqrt(np.where(share_reading, 6.0, 4.0))
    )


def outlying_repeats(problem: Problem) -> NDArray[np.bool_]:
    """Return the rows ``(n,)`` of outlying differences between successive visits."""
    outlying = np.zeros(len(problem.measured), dtype=bool)
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        for kind in dict.fromkeys(factor.readings.kind):
            rows = np.flatnonzero(factor.readings.of_kind(kind) & factor.noise.weighted)
            readings = factor.readings.subset(rows)
            step = float(factor.noise.step[rows].max(initial=0.0))
            differences = np.abs(repeat_steps(readings))
            far = differences > _OUTLIER_RATIO * _robust_scatter(differences, step)
            for side in repeat_rows(readings):
                outlying[part.start + rows[side[far]]] = True
    return outlying


def _robust_scatter(
    differences: Array, step: float, quantile: tuple[float, float] = _UPPER_QUANTILE
) -> float:
    """Return the root mean square of differences between repeats ``(k,)`` without outliers, at
    least half a step of the instrument.

    Args:
        differences: differences between repeats.
        step: step of the instrument.
        quantile: share of differences without slips, and the normal quantile of that share.
    """
    if not len(differences):
        return np.inf
    differences, least = np.abs(differences), max(step / 2, 1e-300)
    size = max(float(np.quantile(differences, quantile[0]) / quantile[1]), least)
    for _ in range(_ROUNDS):
        inliers = differences[differences <= _OUTLIER_RATIO * size]
        size = max(float(np.sqrt(np.mean(inliers**2))), least)
    return size


def with_refuted_noise_enlarged(problem: Problem) -> Problem:
    """Return the problem with larger noise where repeats refute the noise that was assumed.

    There is one scale for each kind of instrument in a file, and a larger one for a setup that
    scatters more than the others of its kind in that file.
    """
    factors, scales, refuted = [], list[float](), dict[str, tuple[int, float]]()
    for factor in problem.factors:
        scale = np.ones(len(factor.readings))
        for kind in dict.fromkeys(factor.readings.kind):
            of_kind = factor.readings.of_kind(kind) & factor.noise.weighted
            scale_of_kind, dof = _scales_by_repeats(factor, np.flatnonzero(of_kind))
            scale = np.where(of_kind, scale_of_kind, scale)
            if dof:
                count, dof_before = refuted.get(kind, (0, 0.0))
                refuted[kind] = count + int(np.sum(scale[of_kind] > 1)), dof_before + dof
        factors.append(replace(factor, noise=factor.noise.enlarged(scale)))
        scales += scale[factor.noise.weighted].tolist()
    if not scales or max(scales) <= 1:
        return problem
    typical = problem.noise.typical * float(np.median(scales))
    larger = replace(problem.noise, typical=typical, refuted=refuted)
    return replace(problem, factors=tuple(factors), noise=larger)


def _scales_by_repeats(factor: Factor, rows: Rows) -> tuple[Array, float]:
    """Return the ratio of the noise of repeats to that assumed, by reading ``(n,)``, 1 where it is
    not refuted, and the degrees of freedom of the noise that refutes it.

    Args:
        factor: the readings.
        rows: readings of one kind of instrument.
    """
    setup, scales = factor.readings.setup, np.ones(len(factor.readings))
    differences = dict[int, Array]()
    for number in np.unique(setup[rows]).tolist():
        setup_rows = rows[setup[rows] == number]
        # A capped roughness of a plate is an assumption too, which repeats can refute.
        from_repeats = factor.noise.from_repeats[setup_rows] & ~factor.noise_capped[setup_rows]
        if from_repeats.any() or not factor.approach_known(number):
            continue
        sigma = float(np.sqrt(np.mean(factor.noise.total[setup_rows] ** 2)))
        differences[number] = _successive_differences(factor.readings.subset(setup_rows)) / sigma
    if not differences:
        return scales, 0.0
    each = [d for d in differences.values() if len(d)]
    variance = np.array([_robust_scatter(d, 0.0, _MEDIAN_QUANTILE) ** 2 for d in each])
    noisier = scatters_more(variance, np.array([_dof_of_differences(d) for d in each]), 0.0)
    pooled = np.concatenate([np.zeros(0), *compress(each, ~noisier)])
    common_scale = _refuted_scale(pooled, 1.0, _REFUTING_CHANCE)
    chance = _REFUTING_CHANCE / len(differences)
    for number, of_setup in differences.items():
        scales[setup == number] = max(common_scale, _refuted_scale(of_setup, common_scale, chance))
    enlarged = [d for number, d in differences.items() if scales[setup == number].max() > 1]
    return scales, sum(map(_dof_of_differences, enlarged))


def _refuted_scale(differences: Array, scale: float, chance: float) -> float:
    """Return the standard deviation of differences ``(k,)`` if it refutes the assumed ``scale``,
    and otherwise ``scale``.
    """
    size = _robust_scatter(differences, 0.0, _MEDIAN_QUANTILE)
    dof = _dof_of_differences(differences)
    ratio = size / scale
    larger = 2 * dof >= _FEWEST_DIFFERENCES and ratio > _REFUTING_RATIO
    return size if larger and chdtrc(dof, dof * ratio**2) < chance else scale


def _dof_of_differences(differences: Array) -> float:
    """Return the degrees of freedom of successive differences of steps, which share readings."""
    return len(differences) / 2


def with_smaller_noise(problem: Problem, variance_ratios: Mapping[str, float]) -> Problem:
    """Return the problem with smaller noise, at least the rounding of the instruments.

    Args:
        problem: the readings.
        variance_ratios: ratio of the noise variance to that assumed, by kind of reading.
    """
    factors = []
    for factor in problem.factors:
        noise, rounding = factor.noise, factor.noise.step / np.sqrt(12)
        variance_ratio = np.array([variance_ratios[kind] for kind in factor.readings.kind])
        ratio = np.sqrt(np.maximum(variance_ratio, _MIN_VARIANCE_RATIO))
        total = np.maximum(noise.total * ratio, rounding)
        scale = np.where(noise.weighted, total / noise.total, 1.0)
        smaller = replace(noise, sigma=noise.sigma * scale, common=noise.common * scale)
        factors.append(replace(factor, noise=smaller))
    return replace(problem, factors=tuple(factors))


def with_noise_reestimated(problem: Problem, excluded: NDArray[np.bool_] | None = None) -> Problem:
    """Return the problem with the noise of repeats estimated again from weighted rows.

    Rows ``excluded`` ``(n,)`` do not contribute, but get the median of that noise. Setups that are
    noisier than the others neither contribute nor get it.
    """
    noise = problem.noise
    kinds = set[str]()
    for factor in problem.factors:  # a plate's roughness needs no repeats
        kinds |= set(np.array(factor.readings.kind)[factor.noise.from_repeats].tolist())
    if not kinds:
        return problem
    excluded_rows = np.zeros(len(problem.measured), dtype=bool) if excluded is None else excluded
    has_shared_noise = [f.noise.weighted & (f.noise.source != "residuals") for f in problem.factors]
    parts = zip(problem.factors, problem.factor_rows, has_shared_noise, strict=True)
    pairs = [(f, shared & ~excluded_rows[part]) for f, part, shared in parts]
    tables = [f.readings.subset(used) for f, used in pairs]
    steps = [f.noise.step[used] for f, used in pairs]
    noise_again, rows = noise_of(tables, problem.machine.spec, steps=steps)
    factors = []
    for (factor, used), shared, new in zip(pairs, has_shared_noise, rows, strict=True):
        of_kinds = np.isin(factor.readings.kind, list(kinds)) & shared
        if len(usable := np.flatnonzero(of_kinds[used])):
            median = usable[np.argsort(new.sigma[usable])[len(usable) // 2]]
            row_of_new = np.full(len(used), median)
            row_of_new[used] = np.arange(used.sum())
            factor = factor.with_noise(np.flatnonzero(of_kinds), new.subset(row_of_new[of_kinds]))
        factors.append(factor if factor.on_legs else factor.with_roughness(problem.machine))
    on_legs = bool(problem.leg_factors)
    if not on_legs:
        total = [f.noise.total[used] for f, (_, used) in zip(factors, pairs, strict=True)]
        noise_again = replace(noise, typical=rms_noise(tables, total))
    basis = noise_again if not on_legs or noise.source == "repeats" else noise
    noise = replace(basis, refuted=noise.refuted)
    return replace(problem, factors=tuple(factors), noise=noise)


_SCATTERED_REPEATS = 0.5
"""Ratio of the usual noise variance to that of repeats below which an instrument may have been
moved between them. By chance, ten repeats scatter twice as much in 3 of 100 campaigns."""

_OVERSTATED_NOISE = 0.25
"""Chi2 per degree of freedom below which the declared noise is at least twice too large."""

FittedState = tuple[Estimate, FullPosterior]
"""A fit of the base model, and its posterior."""


def states_by_noise(base: Estimate, posterior: FullPosterior) -> list[FittedState]:
    """Return the states to search for faults, the likeliest first: the given fit and posterior,
    preceded by those with smaller noise if these have more evidence. Both are searched, because
    noise assumed too large hides faults.
    """
    candidates = [(base, posterior)]
    if variance_ratios := _smaller_variance_ratios(posterior):
        with suppress(NumericsError):  # readings far off drive a fit to where no loop closes
            smaller = fit_nested(with_smaller_noise(base.problem, variance_ratios), base.x)
            candidates.append((smaller, posterior_with_corrected_commands(smaller)))
    likelier = best_of(candidates, lambda state: state[1].evidence, LOG_ODDS_MARGIN)
    return [likelier] if likelier is candidates[0] else [likelier, candidates[0]]


def _smaller_variance_ratios(posterior: FullPosterior) -> dict[str, float]:
    """Return the ratio of a plausible smaller noise variance to that assumed, by kind of reading;
    empty if there is no reason for one.

    There are two reasons: the chi2 of the fit is far below its degrees of freedom (overstated
    noise), or repeats scatter much more than is usual for the instrument, which happens if it was
    moved between two visits to a station. A dial that was moved shifts all its next readings alike,
    so its noise is at least that of differences between successive steps.
    """
    if posterior.mixture.chi2_per_dof < _OVERSTATED_NOISE:
        return _fitted_variance_ratios(posterior)
    usual = dict[str, float]()
    for factor in posterior.before.problem.factors:
        noise = factor.noise
        least = noise.expected
        if factor.on_legs:
            differences = _successive_differences(factor.readings.subset(noise.weighted))
            if len(differences) >= _FEWEST_DIFFERENCES:
                least = np.maximum(least, _robust_scatter(differences, 0.0, _MEDIAN_QUANTILE))
        ratio = np.where(factor.readings.touching, 1.0, least / noise.total)
        for kind in dict.fromkeys(factor.readings.kind):
            of_kind = ratio[factor.readings.of_kind(kind) & noise.weighted]
            median = float(np.median(of_kind)) if len(of_kind) else 1.0
            usual[kind] = min(usual.get(kind, 1.0), median**2)
    return usual if min(usual.values()) < _SCATTERED_REPEATS else {}


def _fitted_variance_ratios(posterior: FullPosterior) -> dict[str, float]:
    """Return the ratio of the noise variance that the best explanation leaves to that assumed, 1 at
    most, by kind of reading: the noise of a single instrument may be overstated.
    """
    kinds = {kind for factor in posterior.before.problem.factors for kind in factor.readings.kind}
    chi2, dof = dict.fromkeys(kinds, 0.0), dict.fromkeys(kinds, 0.0)
    for scale in noise_scales(posterior.after):
        chi2[scale.setup.kind] += scale.chi2
        dof[scale.setup.kind] += scale.dof
    return {kind: min(chi2[kind] / dof[kind], 1.0) if dof[kind] > 0 else 1.0 for kind in kinds}
