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
from orthoglide.identification.noise import repeat_variance

DRAWS = 1999
"""Draws of each bootstrap: the smallest p-value is 1 / (DRAWS + 1)."""


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
    """Whitened, projected residuals ``(m, draws)`` of a machine that the fit describes wholly."""
    problem = signatures.estimate.problem
    readings = _noise(problem, signatures, rng, draws)
    rows = signatures.whiten(readings)
    if problem.noise.source == "repeats":
        variance = np.array([repeat_variance(_with_noise(problem, r))[0] for r in readings.T])
        floor = problem.machine.spec.dial.resolution**2 / 12
        rows = rows * (problem.noise.typical / np.sqrt(np.maximum(variance, floor)))
    return np.asarray(rows)


def _with_noise(problem: Problem, readings: Array) -> tuple:  # type: ignore[type-arg]
    return problem.with_readings(readings).campaigns


def _noise(
    problem: Problem, signatures: Signatures, rng: np.random.Generator, draws: int
) -> Array:
    """Noise of all readings ``(n, draws)``, metres: scatter, rounding, placement, datum."""
    n = len(problem.measured)
    resolution = problem.machine.spec.dial.resolution
    scatter = np.sqrt(np.maximum(problem.sigma**2 - resolution**2 / 12, 0.0))
    noise = rng.standard_normal((n, draws)) * scatter[:, None]
    nuisance = signatures.estimate.nuisance
    placed = nuisance.precision > 0
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
    seen = (
        float(scoring.evidences(signatures.residual).max()) if scoring.candidates else -np.inf
    )
    chi2 = np.sum(noise**2, axis=0)
    left = float(signatures.residual @ signatures.residual)
    return Detection(
        _p_value(best, seen), _p_value(chi2, left), float(np.quantile(best, 0.95))
    )


def name_p_value(
    signatures: Signatures,
    scoring: Scoring,
    chosen: int,
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> float:
    """Probability that a structureless residual would be explained as well by anything at hand.

    Both are seen through averages over a station's visits from one side, as a systematic error
    repeats there; causes that change with time are seen reading by reading.

    Args:
        signatures: at the fit.
        scoring: of the candidates in the running.
        chosen: the candidate to be named, by place.
        rng: of the draws.
        draws: how many.
    """
    candidate = scoring.candidates[chosen]
    groups = signatures.groups
    if candidate.family in ("gauge_drift", "thermal_drift", "thermal_growth"):
        groups = np.arange(signatures.count)
    averaging = averaging_basis(signatures, groups)
    if not averaging.shape[1]:
        return 1.0
    # A station's error is one number, the same at every visit, of a size that the noise has not.
    averaged = Scoring.of(signatures, scoring.candidates, averaging)
    residual = averaging.T @ signatures.residual
    size = float(np.linalg.norm(residual))
    shares = averaged.gains(residual) / size**2
    random = rng.standard_normal((int(groups.max()) + 1, draws))
    drawn = averaging.T @ signatures.whiten(random[groups])
    drawn *= size / np.linalg.norm(drawn, axis=0)
    best = averaged.gains(drawn)[_single(scoring, candidate.size)].max(axis=0) / size**2
    return _p_value(best, float(shares[chosen]))


def _single(scoring: Scoring, size: int) -> list[int]:
    """Candidates of no more parameters than the one to be named."""
    return [k for k, c in enumerate(scoring.candidates) if c.size <= size]


def averaging_basis(signatures: Signatures, groups: Array) -> Array:
    """Orthonormal columns ``(m, g)`` of what readings equal within groups show past the fit."""
    count = int(groups.max()) + 1
    indicator = np.zeros((signatures.count, count))
    indicator[np.arange(signatures.count), groups] = 1.0
    shown = signatures.whiten(indicator)
    left, singular, _ = np.linalg.svd(shown, full_matrices=False)
    return np.asarray(left[:, singular > 1e-6 * max(float(singular.max(initial=0.0)), 1e-300)])


def _p_value(draws: Array, seen: float) -> float:
    return float((1 + np.sum(draws >= seen)) / (len(draws) + 1))
