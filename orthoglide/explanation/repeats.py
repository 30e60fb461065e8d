"""What repeats show before anything is searched: instruments that scatter as none does, repeats
that are no measure of the noise, and noise that was declared too large or too small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from orthoglide.errors import InputError
from orthoglide.explanation.faults import Fault, Rows, factors_and_rows, fault_message
from orthoglide.fit import Factor, Problem
from orthoglide.fit.repeats import common_rounding
from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.observations.repetition import repeat_rows, repeat_steps
from orthoglide.ordering import best_of

_LEAST_NOISE_SQUARE = 1e-4  # square of the noise that no reading is without
_ROUNDS = 6  # of leaving out what is far beyond the rest

_SCATTER_LIMIT, _SCATTER_LIMIT_OF_TOOL = 3.0, 10.0
"""Times the scatter expected of a dial, or of an instrument at the tool, that is no noise of it.
Where the noise was declared, a dial is held to the latter beside the others: up to that it counts
as a dial with more noise of its own."""

_FEWEST_DIFFERENCES = 10  # repeats of repeats from which a setup may be said to scatter

_OUTLIER_RATIO = 4.0
"""Times what most repeats differ by, beyond which two are no measure of the noise: one in sixteen
thousand."""

_UPPER_QUANTILE, _MEDIAN_QUANTILE = (0.7, 1.04), (0.5, 0.674)
"""Share of repeats that slips leave alone, and the quantile of a normal law within which so many
are; of differences of differences, in which a slip stands twice as often."""

_REFUTING_RATIO, _REFUTING_CHANCE = 1.2, 1e-3
"""Ratio to the noise assumed from which repeats refute it, and the probability that noise as
assumed would scatter as much: those of the note that says so."""


def find_scattered_setups(problem: Problem) -> list[Fault]:
    """Setups whose repeats do not repeat: by more than any such instrument scatters.

    Noise that is taken from the repeats believes anything of them: here it is held against what
    the machine file says of the instrument, or what such instruments are like. A datum that is
    another from some moment on, and a single slip, scatter nothing.

    Raises:
        InputError: where most setups are like that: then none of their rows can be believed.
    """
    every, pooled = list[tuple[Fault, bool]](), [np.zeros(0)]
    for number in problem.leg_setups:
        rows = np.flatnonzero(problem.setup_of_row == number)
        k, _ = factors_and_rows(problem, rows[:1])[0]
        factor, own = problem.factors[k], rows - problem.factor_rows[k].start
        step = float(factor.noise.step[own].max())
        most = _SCATTER_LIMIT * max(_expected_noise(factor, own), step)
        if not factor.noise.from_repeats[own].all():  # declared, perhaps too small for all dials
            most = _SCATTER_LIMIT_OF_TOOL * float(np.median(factor.noise.total))
        apart = _successive_differences(factor.readings.subset(own))
        fault = Fault("scatter", rows, (number,), _robust_scatter(apart, step))
        every.append((fault, len(apart) >= _FEWEST_DIFFERENCES and fault.size > most))
        pooled.append(apart / most)
    found = [fault for fault, alone in every if alone]
    together = np.concatenate(pooled)
    alike = len(together) >= _FEWEST_DIFFERENCES and _robust_scatter(together, 0.0) > 1.0
    if alike or 2 * len(found) > len(every):
        able = [f for f, _ in every if np.isfinite(f.size)]
        worst = best_of(able, lambda fault: fault.size)
        raise InputError(fault_message(problem, worst) + "; most other setups are no better")
    return found


def check_scatter(problem: Problem) -> None:
    """Refuse readings of the tool whose repeats scatter as no such instrument does, once what
    slipped and moved is put right.

    Raises:
        InputError: naming file and setup, and what to do.
    """
    first, said = len(problem.leg_setups), list[str]()
    for number, (k, factor, setup, _) in enumerate(problem.tool_setups, first):
        own = np.flatnonzero((factor.setup == setup) & factor.noise.weighted)
        if not len(own) or not factor.noise.from_repeats[own].any():
            continue
        size = float(np.sqrt(np.mean(factor.noise.total[own] ** 2)))
        if size > _SCATTER_LIMIT_OF_TOOL * _expected_noise(factor, own):
            rows = own + problem.factor_rows[k].start
            said.append(fault_message(problem, Fault("scatter", rows, (number,), size)))
    if said:
        raise InputError("; ".join(said))


def _expected_noise(factor: Factor, rows: Rows) -> float:
    return float(np.sqrt(np.mean(factor.noise.expected[rows] ** 2)))


def _successive_differences(readings: Readings) -> Array:
    """Return the differences of successive steps between repeats ``(k,)``, scaled to the standard
    deviation of one reading: neither a drift nor a moved datum enlarges them.

    Two steps of one station share a reading, ``a - 2 b + c``: their difference has six times the
    variance of a reading, that of other steps four times.
    """
    later, before = repeat_rows(readings)
    order = np.argsort(readings.order[later], kind="stable")
    shares = later[order][:-1] == before[order][1:]
    return np.asarray(np.diff(repeat_steps(readings)[order]) / np.sqrt(np.where(shares, 6.0, 4.0)))


def outlying_repeats(problem: Problem) -> NDArray[np.bool_]:
    """Rows ``(n,)`` that repeat the visit before by far less well than most do."""
    found = np.zeros(len(problem.measured), dtype=bool)
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        for kind in dict.fromkeys(factor.readings.kind):
            rows = np.flatnonzero(factor.readings.of_kind(kind) & factor.noise.weighted)
            own = factor.readings.subset(rows)
            step = float(factor.noise.step[rows].max(initial=0.0))
            apart = np.abs(repeat_steps(own))
            far = apart > _OUTLIER_RATIO * _robust_scatter(apart, step)
            for side in repeat_rows(own):
                found[part.start + rows[side[far]]] = True
    return found


def _robust_scatter(
    apart: Array, step: float, most: tuple[float, float] = _UPPER_QUANTILE
) -> float:
    """Root mean square of differences between repeats ``(k,)``, those left out that are far beyond
    it; no less than what an instrument with a step shows.

    Args:
        apart: differences.
        step: of the instrument.
        most: share of them that slips leave alone, and the quantile of so many.
    """
    if not len(apart):
        return np.inf
    apart, least = np.abs(apart), max(step / 2, 1e-300)
    size = max(float(np.quantile(apart, most[0]) / most[1]), least)
    for _ in range(_ROUNDS):
        near = apart[apart <= _OUTLIER_RATIO * size]
        size = max(float(np.sqrt(np.mean(near**2))), least)
    return size


def with_refuted_noise_enlarged(problem: Problem) -> Problem:
    """Return the problem with larger noise where repeats refute the noise that was assumed.

    There is one scale for each kind of instrument, and a larger one for a setup that scatters more
    than the others of its kind. Differences of successive repeat differences are taken, which
    neither a drift, a knocked stand nor a dial set to zero anew enlarges; slips are left out.
    """
    factors, scales, refuted = [], list[float](), set[str]()
    for factor in problem.factors:
        scale = np.ones(len(factor.readings))
        for kind in dict.fromkeys(factor.readings.kind):
            of_kind = factor.readings.of_kind(kind) & factor.noise.weighted
            scale = np.where(of_kind, _noise_scales(factor, np.flatnonzero(of_kind)), scale)
        noise, loud = factor.noise, scale > 1
        total, common = noise.total * scale, noise.common.copy()
        for row in np.flatnonzero(loud).tolist():
            common[row] = common_rounding(float(total[row]), float(noise.step[row]))
        sigma = np.sqrt(np.maximum(total**2 - common**2, 0.0))
        more = replace(noise, sigma=np.where(loud, sigma, noise.sigma), common=common)
        factors.append(replace(factor, noise=more))
        scales += scale[noise.weighted].tolist()
        refuted |= set(np.array(factor.readings.kind)[loud].tolist())
    if not scales or max(scales) <= 1:
        return problem
    typical = problem.noise.typical * float(np.median(scales))
    larger = replace(problem.noise, typical=typical, refuted=frozenset(refuted))
    return replace(problem, factors=tuple(factors), noise=larger)


def _noise_scales(factor: Factor, rows: Rows) -> Array:
    """Return the ratio of the noise that repeats show to that assumed, by reading ``(n,)``; 1
    where they agree with it.

    Args:
        factor: the readings.
        rows: those of one kind of instrument.
    """
    setup, found = factor.readings.setup, np.ones(len(factor.readings))
    apart = dict[int, Array]()
    for number in np.unique(setup[rows]).tolist():
        own = rows[setup[rows] == number]
        # The largest roughness that is assumed of a plate is refuted by repeats like other noise.
        shown = factor.noise.from_repeats[own] & ~factor.noise_capped[own]
        if shown.any() or not factor.approach_known(number):
            continue
        sigma = float(np.sqrt(np.mean(factor.noise.total[own] ** 2)))
        apart[number] = _successive_differences(factor.readings.subset(own)) / sigma
    if not apart:
        return found
    every = np.concatenate(list(apart.values()))
    all_alike = _refuted_scale(every, 1.0, _REFUTING_CHANCE)
    for number, own in apart.items():
        found[setup == number] = max(
            all_alike, _refuted_scale(own, all_alike, _REFUTING_CHANCE / len(apart))
        )
    return found


def _refuted_scale(apart: Array, scale: float, chance: float) -> float:
    """Return the standard deviation of differences ``(k,)`` where it refutes the one assumed, and
    the one assumed otherwise.
    """
    size = _robust_scatter(apart, 0.0, _MEDIAN_QUANTILE)
    dof = len(apart) / 2  # differences of differences share readings
    ratio = size / scale
    if (
        dof < _FEWEST_DIFFERENCES / 2
        or not ratio > _REFUTING_RATIO
        or chdtrc(dof, dof * ratio**2) >= chance
    ):
        return scale
    return size


def with_smaller_noise(problem: Problem, squares: Mapping[str, float]) -> Problem:
    """Return the problem with less noise, but what instruments round; of readings that were
    computed, which have none, with a little.

    Args:
        problem: the readings.
        squares: by kind of reading, ratio of the square of its noise to that assumed.
    """
    factors = []
    for factor in problem.factors:
        noise, least = factor.noise, factor.noise.step / np.sqrt(12)
        square = np.array(
            [max(squares[kind], _LEAST_NOISE_SQUARE) for kind in factor.readings.kind]
        )
        total = np.maximum(noise.total * np.sqrt(square), least)
        scale = np.where(noise.weighted, total / noise.total, 1.0)
        less = replace(noise, sigma=noise.sigma * scale, common=noise.common * scale)
        factors.append(replace(factor, noise=less))
    return replace(problem, factors=tuple(factors))
