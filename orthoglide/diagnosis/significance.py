"""Two tests, not one: is anything left beyond the noise, and does the best cause deserve its name?

*Detection* compares the best evidence in the catalogue with what it reaches on noise alone, drawn
again and again with its rounding, its dial placements and, where the noise was estimated from
repeats, that estimate. *Naming* compares the share of the residual that the best cause explains
with the share that the best of the catalogue would explain of a structureless residual of the same
size: with something outside the catalogue present, every correlated cause is significant against
the noise, and only this test keeps the tool from naming it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import normal
from orthoglide.fit.noise import repeat_variance, total_variance
from orthoglide.geometry import Array
from orthoglide.observations import Campaign

DRAWS = 1999
"""Draws of each bootstrap: the smallest p-value is 1 / (DRAWS + 1)."""

_OFF_GRID = 1e-6  # of a step

BACKGROUND = 0.02
"""Share of its tolerance that every other effect has on a machine with nothing wrong."""


@dataclass(frozen=True)
class Detection:
    """Whether something is left beyond the noise.

    Attributes:
        p_value: of the best evidence in the catalogue, family-wise.
        lack_of_fit_p: of what is left, whatever its shape: the smaller of two tests, doubled; of
            all readings, and of the station means, which see a systematic error better.
        bare_lack_of_fit_p: the same against noise alone, without a little of everything.
        threshold: evidence that noise alone exceeds once in twenty.
    """

    p_value: float
    lack_of_fit_p: float
    bare_lack_of_fit_p: float
    threshold: float


@dataclass(frozen=True)
class Draws:
    """Residuals of a machine that the fit describes, many times.

    Attributes:
        rows: whitened, projected residuals ``(m, draws)`` of noise alone.
        little: what a little of everything else adds ``(m, draws)``.
        within: whitened sum of squares about the station means ``(draws,)``.
    """

    rows: Array
    little: Array
    within: Array


def noise_draws(signatures: Signatures, rng: np.random.Generator, draws: int) -> Draws:
    """Draw noise with its rounding, placements and estimate, and a little of everything else.

    No machine is described to the last nanometre: ``BACKGROUND`` of its tolerance of every other
    effect is not a cause, even where readings are precise enough to show it.
    """
    problem = signatures.estimate.problem
    readings = _noise(problem, signatures, rng, draws)
    rows, within = signatures.whiten(readings), about_means(signatures, readings)
    if problem.noise.source == "repeats":
        variance = np.array([repeat_variance(_with_noise(problem, r))[0] for r in readings.T])
        total = total_variance(variance, problem.machine.spec.dial.resolution)
        factor = problem.noise.typical / np.sqrt(np.maximum(total, 1e-300))
        rows, within = rows * factor, within * factor**2
    # A prior that holds an unknown back leaves something of it in the readings.
    known = len(problem.prior_rows[0])
    padded = np.zeros((len(signatures.fitted), draws))
    padded[signatures.count :][:known] = rng.standard_normal((known, draws))
    rows += signatures.project(padded)
    little = rng.standard_normal((len(signatures.names), draws))
    little *= BACKGROUND * signatures.tolerance[:, None]
    return Draws(rows, signatures.columns @ little, within)


def noise_residuals(signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Whitened, projected residuals ``(m, draws)`` of a machine with nothing wrong."""
    drawn = noise_draws(signatures, rng, draws)
    return drawn.rows + drawn.little


def _with_noise(problem: Problem, readings: Array) -> tuple[Campaign, ...]:
    return problem.with_readings(readings).campaigns


def _noise(problem: Problem, signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Noise of all readings ``(n, draws)``, metres: scatter, rounding, placement, datum."""
    n = len(problem.measured)
    dials = problem.rows[-1].stop if problem.rows else 0
    # What is not read from a dial has no step: its noise is all scatter.
    resolution = problem.machine.spec.dial.resolution * (np.arange(n) < dials)
    variance = problem.sigma**2 + problem.noise.common**2 - resolution**2 / 12
    scatter = np.sqrt(np.maximum(variance, 0.0))
    noise = rng.standard_normal((n, draws)) * scatter[:, None]
    nuisance = signatures.estimate.nuisance
    placed = nuisance.placement
    if placed.any():
        places = rng.standard_normal((int(placed.sum()), draws))
        places /= np.sqrt(nuisance.precision[placed])[:, None]
        noise += nuisance.columns[:, placed] @ places
    step = problem.machine.spec.dial.resolution
    if dials and on_grid(problem.measured[:dials], step):
        value, setup = signatures.estimate.at.value[:dials, None], problem.setup_of_row[:dials]
        datum = rng.uniform(0, step, (problem.setup_count, draws))[setup]
        shown = np.round((value + datum + noise[:dials]) / step) * step
        noise[:dials] = shown - value - datum
        return np.asarray(noise)
    return np.asarray(noise + rng.uniform(-0.5, 0.5, (n, draws)) * resolution[:, None])


def on_grid(readings: Array, resolution: float) -> bool:
    """Whether readings, metres, are all multiples of a dial's step, but for binary fractions."""
    steps = readings / resolution if resolution > 0 else np.full(1, np.nan)
    return bool(np.all(np.abs(steps - np.round(steps)) < _OFF_GRID))


def detect(
    signatures: Signatures, scoring: Scoring, rng: np.random.Generator, draws: int = DRAWS
) -> Detection:
    """Test the residual of a fit against noise alone.

    Args:
        signatures: at the fit.
        scoring: of the candidates in the running.
        rng: of the bootstrap.
        draws: of the bootstrap.
    """
    drawn = noise_draws(signatures, rng, draws)
    all_told = drawn.rows + drawn.little
    best = scoring.evidences(all_told).max(axis=0) if scoring.candidates else np.zeros(draws)
    seen = float(scoring.evidences(signatures.residual).max()) if scoring.candidates else -np.inf
    return Detection(
        _p_value(best, seen),
        _lack_of_fit(signatures, all_told, drawn.within),
        _lack_of_fit(signatures, drawn.rows, drawn.within),
        float(np.quantile(best, 0.95)),
    )


def _lack_of_fit(signatures: Signatures, rows: Array, within: Array) -> float:
    """The smaller of two tests, doubled: of all readings, and of the station means."""
    # What tolerances ask of the unknowns is no question to the readings.
    left, chi2 = signatures.square(signatures.residual), signatures.square(rows)
    whole = _p_value(chi2, left)
    means = _p_value(chi2 - within, left - within_groups(signatures))
    return min(1.0, 2 * min(whole, means))


def name_p_value(
    signatures: Signatures,
    scoring: Scoring,
    chosen: int,
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> float:
    """Probability that a structureless residual would be explained as well by anything at hand.

    A systematic error repeats at every visit to a station from one side, so both residuals are
    seen through station means; causes that change with time are seen reading by reading.

    Args:
        signatures: at the fit.
        scoring: of the candidates in the running.
        chosen: the candidate to be named, by place.
        rng: of the draws.
        draws: how many.
    """
    candidate = scoring.candidates[chosen]
    effect = signatures.estimate.problem.machine.catalogue[candidate.effect]
    by_reading = bool(effect.needs & {"time", "temperature"})
    groups = np.arange(signatures.count) if by_reading else signatures.groups
    left = float(signatures.square(signatures.residual))
    size = left - (0.0 if by_reading else within_groups(signatures))
    if size <= 0:
        return 1.0
    random = rng.standard_normal((int(groups.max()) + 1, draws))
    drawn = signatures.whiten(random[groups])
    drawn *= np.sqrt(size) / np.linalg.norm(drawn, axis=0)
    # A cause of few parameters does not compete with families that would fit anything.
    rivals = [k for k, c in enumerate(scoring.candidates) if c.size <= candidate.size]
    best = scoring.gains(drawn)[rivals].max(axis=0)
    return _p_value(best, float(scoring.gains(signatures.residual)[chosen]))


def within_groups(signatures: Signatures) -> float:
    """Whitened sum of squares of readings about their station's mean: no cause of the machine."""
    rest = signatures.estimate.problem.measured - signatures.estimate.at.value
    return float(about_means(signatures, rest[:, None])[0])


def about_means(signatures: Signatures, readings: Array) -> Array:
    """Whitened sum of squares ``(k,)`` of readings ``(n, k)`` about their station means."""
    groups, weight = signatures.groups, signatures.weight[:, None] ** 2
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=-1))
    total = np.add.reduceat((readings * weight)[order], starts, axis=0)
    share = np.add.reduceat(weight[order], starts, axis=0)
    square = np.sum(readings**2 * weight, axis=0)
    return np.asarray(square - np.sum(total**2 / share, axis=0))


def station_degrees(signatures: Signatures) -> float:
    """Degrees of freedom of the station means: stations less datums less what the unknowns take."""
    estimate = signatures.estimate
    here = normal(estimate.problem, estimate.at, estimate.nuisance)
    stations = int(signatures.groups.max()) + 1
    return stations - estimate.nuisance.free - here.determined


def _p_value(draws: Array, seen: float | Array) -> float:
    return float((1 + np.sum(draws >= seen)) / (len(draws) + 1))
