"""Whether a fit, or the posterior, leaves more of the readings than their noise explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.explanation.causes import CredibleSets
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.explanation.linear_model import Scale
from orthoglide.explanation.search import State
from orthoglide.explanation.signatures import Signatures
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import project_out
from orthoglide.fit.repeats import on_grid, readings_of_finest_step, repeat_variance, total_variance
from orthoglide.fit.scores import chi2_p_value, cross_validation_improvement, smaller_p_value
from orthoglide.geometry import Array
from orthoglide.observations import Readings

SIGNIFICANT = 0.003
"""Probability of calling what is left significant where nothing is: one false alarm in 300."""

DRAWS = 1999
"""Draws of the noise from which thresholds are taken."""

_GRID_TOLERANCE = 1e-6  # of a step, by which binary fractions miss it

BACKGROUND = 0.02
"""Share of its tolerance that every other effect has on a machine with nothing wrong."""


@dataclass(frozen=True)
class LackOfFitTest:
    """Whether a fit leaves anything beyond the noise, whatever its shape."""

    p_value: float  # of as much being left by noise alone; nan where that was not looked at
    # probability that the machine is beyond its tolerances altogether, or that the noise is larger
    # than the repeats show
    rare: float = 0.0
    shaped: float = 0.0  # `p_value` where probed plates may have shapes that no effect names
    # `p_value` where what may stand out counts that is not likely enough to be told
    with_unreported: float = 0.0
    # `p_value` of the base model alone
    base_p_value: float = 1.0
    # whether errors of at most one tolerance of everything explain the readings, stations that are
    # left out included
    explained_within_tolerances: bool = False


def estimate_lack_of_fit(estimate: Estimate) -> LackOfFitTest:
    """Test what a fit leaves against the noise: :attr:`Scores.lack_of_fit_p`."""
    p = estimate.scores.lack_of_fit_p
    p = p if np.isfinite(p) else 1.0
    return LackOfFitTest(p, base_p_value=p)


def noise_residuals(signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Whitened, projected residuals ``(m, draws)`` of a machine with nothing wrong.

    Noise with its rounding, placements and estimate, and a little of everything else: no machine
    is described to the last nanometre, so ``BACKGROUND`` of its tolerance of every other effect is
    not a cause, even where readings are precise enough to show it.
    """
    problem = signatures.estimate.problem
    readings = _draw_noise(problem, signatures, rng, draws)
    rows = signatures.whiten(readings)
    if problem.noise.source == "repeats":
        drawn = [problem.with_readings(r).campaigns for r in readings.T]
        total, single = (
            _single_reading_variance(problem, given) for given in (drawn, [problem.campaigns])
        )
        rows = rows * np.sqrt(single / np.maximum(total, 1e-300))
    # A prior that holds an unknown back leaves something of it in the readings.
    known = len(problem.prior_rows[0])
    padded = np.zeros((len(signatures.fitted_basis), draws))
    padded[signatures.count :][:known] = rng.standard_normal((known, draws))
    rows += project_out(signatures.fitted_basis, padded)
    little = rng.standard_normal((len(signatures.names), draws))
    little *= BACKGROUND * signatures.tolerance[:, None]
    return np.asarray(rows + signatures.columns @ little)


def _single_reading_variance(problem: Problem, drawn: Sequence[Sequence[Readings]]) -> Array:
    """Variance of one reading from the repeats of each of some draws of all campaigns."""
    steps = [f.noise.step for f in problem.leg_factors]
    kept = [readings_of_finest_step(campaigns, steps) for campaigns in drawn]
    variance = np.array([repeat_variance(campaigns)[0] for campaigns, _ in kept])
    return total_variance(variance, kept[0][1])


def _draw_noise(
    problem: Problem, signatures: Signatures, rng: np.random.Generator, draws: int
) -> Array:
    """Noise of all readings ``(n, draws)``, metres: scatter, rounding, placement, datum."""
    n, resolution = len(problem.measured), problem.step
    dials = problem.leg_rows[-1].stop if problem.leg_rows else 0
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
    if rounded and on_grid(problem.measured[:dials], resolution[:dials], _GRID_TOLERANCE):
        value, setup = signatures.estimate.at.value[:dials, None], problem.setup_of_row[:dials]
        datum = rng.uniform(0, 1, (len(problem.leg_setups), draws))[setup] * step
        shown = np.round((value + datum + noise[:dials]) / step) * step
        noise[:dials] = shown - value - datum
        return np.asarray(noise)
    return np.asarray(noise + rng.uniform(-0.5, 0.5, (n, draws)) * resolution[:, None])


_SPANNED_DIRECTION = 1e-6  # of the largest: directions that stations span
_LEAST_DOF = 2.0  # degrees of freedom: less is no test of the mean
_RELIABLE_NOISE_DOF = 30.0
"""Degrees of freedom behind the noise of an instrument of the tool: with fewer it may be off by a
quarter, so that more of it than the repeats show is not rare; ``p_value`` counts that."""

_SUFFICIENT_P_VALUE = 0.05  # probability from which an explanation leaves nothing


def posterior_lack_of_fit(posterior: FullPosterior, found: CredibleSets) -> LackOfFitTest:
    """Test what explanations by name or place leave against the noise: the likeliest, and where it
    leaves something those that are nearly as likely, of which one may be the truth. What is not
    told explains something where the mean of all, which is the machine, fits with it.

    With ``S = 1 + A D A^T`` the rest ``S^-1 r`` has the covariance ``S^-1`` where the explanation
    is right: its chi2 is a sum of squares, each weighed by an eigenvalue of that. Of the station
    means, which see best what repeats at every visit; where the noise is declared the smaller of
    that and a test of everything, allowed for being two.

    A posterior that did not settle was not looked at where it is: what it leaves is not known.
    """
    mixture = posterior.mixture
    base = estimate_lack_of_fit(posterior.before).p_value
    if not posterior.converged:
        return LackOfFitTest(np.nan, mixture.probability_rare, base_p_value=base)
    reported = mixture.restricted_to(found.names)
    p = untold = _largest_p_value(posterior, reported)
    if p < _SUFFICIENT_P_VALUE:
        untold = max(p, _largest_p_value(posterior, mixture.likely_explanations))
        mean = posterior.after.scores
        p = max(p, min(untold, mean.lack_of_fit_p) if mean.dof >= _LEAST_DOF else untold)
    shaped = 0.0
    if mixture.linear.plate_shapes.any():
        shaped = _p_value(posterior, mixture.precision(*reported[0], plate_shapes=True))
    few = any(dof < _RELIABLE_NOISE_DOF for _, dof in posterior.before.problem.repeat_dof)
    rare = mixture.probability_beyond_tolerance if few else mixture.probability_rare
    return LackOfFitTest(
        p, rare, shaped, untold, base, base < SIGNIFICANT and _is_diffuse(posterior)
    )


def _is_diffuse(posterior: FullPosterior) -> bool:
    """Whether a background of at most one tolerance explains the readings, and predicts stations
    that are left out better than the base alone by more than the standard error.
    """
    mixture = posterior.mixture
    p = _p_value(posterior, mixture.precision((), mixture.likeliest_background()))
    if p < SIGNIFICANT:
        return False
    before, after = posterior.before, posterior.after
    fall, error = cross_validation_improvement(before.rows, after.rows)
    return fall > error


def _largest_p_value(
    posterior: FullPosterior, explanations: Sequence[tuple[State, Scale]]
) -> float:
    """Probability of as much being left by noise alone, by the first that leaves nothing."""
    p = 0.0
    for state, scale in explanations:
        p = max(p, _p_value(posterior, posterior.mixture.precision(state, scale)))
        if p > _SUFFICIENT_P_VALUE:
            break
    return p


def _p_value(posterior: FullPosterior, inverse: Array) -> float:
    """Probability of as much being left by noise alone, the inverse covariance given."""
    linear, problem = posterior.mixture.linear, posterior.before.problem
    rest = inverse @ linear.residual
    vectors, size, _ = np.linalg.svd(linear.stations, full_matrices=False)
    means = vectors[:, size > _SPANNED_DIRECTION * size.max(initial=1.0)]
    square, count, _ = linear.station_remainder
    known = problem.noise_dof
    p = _tail_probability(means.T @ rest, means.T @ inverse @ means, square, count, known)
    if count == 0 and not np.isfinite(known) and not problem.common.any():
        p = smaller_p_value(p, _tail_probability(rest, inverse, 0.0, 0.0, np.inf))
    return p if np.isfinite(p) else 1.0


def _tail_probability(
    rest: Array, spread: Array, square: float, count: float, known: float
) -> float:
    """Probability of a rest this large ``(k,)`` of covariance ``(k, k)``, and of more squares."""
    shares = np.asarray(1 - np.linalg.eigvalsh(spread), dtype=np.float64)
    return chi2_p_value(float(rest @ rest) + square, round(len(rest) + count), shares, known)
