"""What the posterior leaves of the readings: whether anything is missing from its list."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orthoglide.explanation.causes import Outstanding
from orthoglide.explanation.everything import FullPosterior
from orthoglide.explanation.linear import Scale
from orthoglide.explanation.search import State
from orthoglide.explanation.significance import SIGNIFICANT, Left, left_over
from orthoglide.fit.scores import improvement, smaller, tail
from orthoglide.geometry import Array

_VISIBLE = 1e-6  # of the largest: directions that stations span
_FEW = 2.0  # degrees of freedom: less is no test of the mean
_SURE = 30.0
"""Degrees of freedom behind the noise of an instrument of the tool: with fewer it may be off by a
quarter, so that more of it than the repeats show is not rare; ``p_value`` counts that."""

_ENOUGH = 0.05  # probability from which an explanation leaves nothing


def remains(posterior: FullPosterior, found: Outstanding) -> Left:
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
    base = left_over(posterior.before).p_value
    if not posterior.settled:
        return Left(np.nan, mixture.rare, base=base)
    reported = mixture.restricted_to(found.names)
    p = untold = _best(posterior, reported)
    if p < _ENOUGH:
        untold = max(p, _best(posterior, mixture.named))
        mean = posterior.after.scores
        p = max(p, min(untold, mean.lack_of_fit_p) if mean.dof >= _FEW else untold)
    shaped = 0.0
    if mixture.linear.unnamed.any():
        shaped = _chance(posterior, mixture.precision(*reported[0], unnamed=True))
    few = any(dof < _SURE for _, dof in posterior.before.problem.repeated)
    rare = mixture.beyond if few else mixture.rare
    return Left(p, rare, shaped, untold, base, base < SIGNIFICANT and _is_diffuse(posterior))


def _is_diffuse(posterior: FullPosterior) -> bool:
    """Whether a background of at most one tolerance explains the readings, and predicts stations
    that are left out better than the base alone by more than the standard error.
    """
    mixture = posterior.mixture
    p = _chance(posterior, mixture.precision((), mixture.likeliest_background()))
    if p < SIGNIFICANT:
        return False
    before, after = posterior.before, posterior.after
    fall, error = improvement(before.rows, after.rows)
    return fall > error


def _best(posterior: FullPosterior, explanations: Sequence[tuple[State, Scale]]) -> float:
    """Probability of as much being left by noise alone, by the first that leaves nothing."""
    p = 0.0
    for state, scale in explanations:
        p = max(p, _chance(posterior, posterior.mixture.precision(state, scale)))
        if p > _ENOUGH:
            break
    return p


def _chance(posterior: FullPosterior, inverse: Array) -> float:
    """Probability of as much being left by noise alone, the inverse covariance given."""
    linear, problem = posterior.mixture.linear, posterior.before.problem
    rest = inverse @ linear.residual
    vectors, size, _ = np.linalg.svd(linear.stations, full_matrices=False)
    means = vectors[:, size > _VISIBLE * size.max(initial=1.0)]
    square, count, _ = linear.beyond
    known = problem.noise_dof
    p = _tail(means.T @ rest, means.T @ inverse @ means, square, count, known)
    if count == 0 and not np.isfinite(known) and not problem.common.any():
        p = smaller(p, _tail(rest, inverse, 0.0, 0.0, np.inf))
    return p if np.isfinite(p) else 1.0


def _tail(rest: Array, spread: Array, square: float, count: float, known: float) -> float:
    """Probability of a rest this large ``(k,)`` of covariance ``(k, k)``, and of more squares."""
    shares = np.asarray(1 - np.linalg.eigvalsh(spread), dtype=np.float64)
    return tail(float(rest @ rest) + square, round(len(rest) + count), shares, known)
