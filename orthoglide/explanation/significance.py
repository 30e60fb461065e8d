"""What is left of the readings against the noise, and noise drawn again and again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.explanation.signatures import Signatures
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import past
from orthoglide.fit.repeats import finest_of, on_grid, repeat_variance, total_variance
from orthoglide.geometry import Array
from orthoglide.observations import Readings

SIGNIFICANT = 0.003
"""Probability of calling what is left significant where nothing is: one false alarm in 300."""

DRAWS = 1999
"""Draws of the noise from which thresholds are taken."""

_BINARY = 1e-6  # of a step, by which binary fractions miss it

BACKGROUND = 0.02
"""Share of its tolerance that every other effect has on a machine with nothing wrong."""


@dataclass(frozen=True)
class Left:
    """Whether a fit leaves anything beyond the noise, whatever its shape."""

    p_value: float  # of as much being left by noise alone; nan where that was not looked at
    # probability that the machine is beyond its tolerances altogether, or that the noise is larger
    # than the repeats show
    rare: float = 0.0
    shaped: float = 0.0  # `p_value` where probed plates may have shapes that no effect names
    # `p_value` where what may stand out counts that is not likely enough to be told
    untold: float = 0.0
    # `p_value` of the base model alone
    base: float = 1.0
    # whether errors of at most one tolerance of everything explain the readings, stations that are
    # left out included
    diffuse: bool = False


def left_over(estimate: Estimate) -> Left:
    """Test what a fit leaves against the noise: :attr:`Scores.lack_of_fit_p`."""
    p = estimate.scores.lack_of_fit_p
    p = p if np.isfinite(p) else 1.0
    return Left(p, base=p)


def noise_residuals(signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Whitened, projected residuals ``(m, draws)`` of a machine with nothing wrong.

    Noise with its rounding, placements and estimate, and a little of everything else: no machine
    is described to the last nanometre, so ``BACKGROUND`` of its tolerance of every other effect is
    not a cause, even where readings are precise enough to show it.
    """
    problem = signatures.estimate.problem
    readings = _noise(problem, signatures, rng, draws)
    rows = signatures.whiten(readings)
    if problem.noise.source == "repeats":
        drawn = [problem.with_readings(r).campaigns for r in readings.T]
        total, single = (_single(problem, given) for given in (drawn, [problem.campaigns]))
        rows = rows * np.sqrt(single / np.maximum(total, 1e-300))
    # A prior that holds an unknown back leaves something of it in the readings.
    known = len(problem.prior_rows[0])
    padded = np.zeros((len(signatures.fitted), draws))
    padded[signatures.count :][:known] = rng.standard_normal((known, draws))
    rows += past(signatures.fitted, padded)
    little = rng.standard_normal((len(signatures.names), draws))
    little *= BACKGROUND * signatures.tolerance[:, None]
    return np.asarray(rows + signatures.columns @ little)


def _single(problem: Problem, drawn: Sequence[Sequence[Readings]]) -> Array:
    """Variance of one reading from the repeats of each of some draws of all campaigns."""
    steps = [f.noise.step for f in problem.on_legs]
    kept = [finest_of(campaigns, steps) for campaigns in drawn]
    variance = np.array([repeat_variance(campaigns)[0] for campaigns, _ in kept])
    return total_variance(variance, kept[0][1])


def _noise(problem: Problem, signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Noise of all readings ``(n, draws)``, metres: scatter, rounding, placement, datum."""
    n, resolution = len(problem.measured), problem.step
    dials = problem.rows[-1].stop if problem.rows else 0
    variance = problem.sigma**2 + problem.common**2 - resolution**2 / 12
    scatter = np.sqrt(np.maximum(variance, 0.0))
    noise = rng.standard_normal((n, draws)) * scatter[:, None]
    nuisance = signatures.estimate.nuisance
    placed = nuisance.precision > 0  # where the dials stand
    if placed.any():
        places = rng.standard_normal((int(placed.sum()), draws))
        places /= np.sqrt(nuisance.precision[placed])[:, None]
        noise += nuisance.columns[:, placed] @ places
    step = resolution[:dials, None]
    rounded = dials and (step > 0).all()
    if rounded and on_grid(problem.measured[:dials], resolution[:dials], _BINARY):
        value, setup = signatures.estimate.at.value[:dials, None], problem.setup_of_row[:dials]
        datum = rng.uniform(0, 1, (len(problem.leg_setups), draws))[setup] * step
        shown = np.round((value + datum + noise[:dials]) / step) * step
        noise[:dials] = shown - value - datum
        return np.asarray(noise)
    return np.asarray(noise + rng.uniform(-0.5, 0.5, (n, draws)) * resolution[:, None])
