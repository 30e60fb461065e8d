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
from orthoglide.geometry import Array
from orthoglide.identification import Problem
from orthoglide.identification.least_squares import normal
from orthoglide.identification.noise import repeat_variance

DRAWS = 1999
"""Draws of each bootstrap: the smallest p-value is 1 / (DRAWS + 1)."""

BACKGROUND = 0.02
"""Share of its tolerance that every other effect has on a machine with nothing wrong."""

_TIMELY = frozenset({"gauge_drift", "thermal_drift", "thermal_growth"})


@dataclass(frozen=True)
class Detection:
    """Whether something is left beyond the noise.

    Attributes:
        p_value: of the best evidence in the catalogue, family-wise.
        lack_of_fit_p: of the residual's chi2 against the same noise, whatever its shape.
        threshold: evidence that noise alone exceeds once in twenty.
    """

    p_value: float
    lack_of_fit_p: float
    threshold: float


def noise_residuals(signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Whitened, projected residuals ``(m, draws)`` of a machine that the fit describes.

    Not to the last nanometre: every draw has a little of everything else, ``BACKGROUND`` of its
    tolerance, so that readings precise enough to show it do not make it a cause.
    """
    problem = signatures.estimate.problem
    readings = _noise(problem, signatures, rng, draws)
    little = rng.standard_normal((len(signatures.names), draws))
    little *= BACKGROUND * signatures.tolerance[:, None]
    rows = signatures.whiten(readings) + signatures.columns @ little
    if problem.noise.source == "repeats":
        variance = np.array([repeat_variance(_with_noise(problem, r))[0] for r in readings.T])
        floor = problem.machine.spec.dial.resolution**2 / 12
        rows = rows * (problem.noise.typical / np.sqrt(np.maximum(variance, floor)))
    return np.asarray(rows)


def _with_noise(problem: Problem, readings: Array) -> tuple:  # type: ignore[type-arg]
    return problem.with_readings(readings).campaigns


def _noise(problem: Problem, signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Noise of all readings ``(n, draws)``, metres: scatter, rounding, placement, datum."""
    n = len(problem.measured)
    resolution = problem.machine.spec.dial.resolution
    variance = problem.sigma**2 + problem.noise.common**2 - resolution**2 / 12
    scatter = np.sqrt(np.maximum(variance, 0.0))
    noise = rng.standard_normal((n, draws)) * scatter[:, None]
    nuisance = signatures.estimate.nuisance
    placed = (nuisance.precision > 0) & (np.arange(nuisance.count) < 2 * problem.setup_count)
    if placed.any():
        places = rng.standard_normal((int(placed.sum()), draws))
        places /= np.sqrt(nuisance.precision[placed])[:, None]
        noise += nuisance.columns[:, placed] @ places
    exact = np.all(problem.measured == np.round(problem.measured / resolution) * resolution)
    if resolution > 0 and exact:
        value = signatures.estimate.at.value[:, None]
        datum = rng.uniform(0, resolution, (problem.setup_count, draws))[problem.setup_of_row]
        shown = np.round((value + datum + noise) / resolution) * resolution
        return np.asarray(shown - value - datum)
    return noise + rng.uniform(-0.5, 0.5, (n, draws)) * resolution


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
    noise = noise_residuals(signatures, rng, draws)
    # Parameters with priors are drawn with the machine: their share of noise alone is part of chi2.
    best = scoring.evidences(noise).max(axis=0) if scoring.candidates else np.zeros(draws)
    seen = float(scoring.evidences(signatures.residual).max()) if scoring.candidates else -np.inf
    chi2 = np.sum(noise**2, axis=0)
    left = float(signatures.residual @ signatures.residual)
    return Detection(_p_value(best, seen), _p_value(chi2, left), float(np.quantile(best, 0.95)))


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
    by_reading = candidate.family in _TIMELY
    groups = np.arange(signatures.count) if by_reading else signatures.groups
    left = float(signatures.residual @ signatures.residual)
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
    problem, groups = signatures.estimate.problem, signatures.groups
    rest = problem.measured - signatures.estimate.at.value
    weight = signatures.weight**2
    mean = np.bincount(groups, rest * weight) / np.bincount(groups, weight)
    return float(np.sum((rest - mean[groups]) ** 2 * weight))


def station_degrees(signatures: Signatures) -> float:
    """Degrees of freedom of the station means: stations less datums less what the unknowns take."""
    estimate = signatures.estimate
    here = normal(estimate.problem, estimate.at, estimate.nuisance)
    data = here.jacobian.T @ here.jacobian
    taken = float(np.trace(np.linalg.lstsq(here.information, data, rcond=1e-12)[0]))
    stations = int(signatures.groups.max()) + 1
    return stations - estimate.problem.setup_count - taken


def _p_value(draws: Array, seen: float) -> float:
    return float((1 + np.sum(draws >= seen)) / (len(draws) + 1))
