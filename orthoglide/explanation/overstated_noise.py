"""Noise that is smaller than assumed: it was overstated, or a fault has set repeats apart."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from orthoglide.errors import NumericsError
from orthoglide.explanation.assumed_noise import with_smaller_noise
from orthoglide.explanation.full_posterior import FullPosterior, posterior_with_corrected_commands
from orthoglide.explanation.ranked_readings import fit_nested
from orthoglide.fit import Estimate
from orthoglide.fit.noise_notes import noise_scales
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of

_SCATTERED_REPEATS = 0.5
"""Ratio of the expected squared noise to that of repeats below which a fault may have set them
apart. By chance, ten repeats scatter twice as much in 3 of 100 campaigns."""

_OVERSTATED_NOISE = 0.25
"""Chi2 per degree of freedom below which the declared noise is at least twice too large."""

State = tuple[Estimate, FullPosterior]
"""A fit of the base model, and its posterior."""


def with_likelier_noise(base: Estimate, posterior: FullPosterior) -> list[State]:
    """Return the fit and its posterior; before them, with smaller noise if its evidence is larger:
    larger noise would hide a fault.
    """
    either = [(base, posterior)]
    if squares := _smaller_noise_squares(posterior):
        with suppress(NumericsError):  # readings far off drive a fit to where no loop closes
            smaller = fit_nested(with_smaller_noise(base.problem, squares), base.x)
            either.append((smaller, posterior_with_corrected_commands(smaller)))
    likelier = best_of(either, lambda one: one[1].evidence, LOG_ODDS_MARGIN)
    return [likelier] if likelier is either[0] else [likelier, either[0]]


def _smaller_noise_squares(posterior: FullPosterior) -> dict[str, float]:
    """Return ratios of the squared noise to that assumed, by kind of reading, where the noise is
    probably smaller: overstated, or that of repeats which a fault has set apart. An instrument that
    was moved scatters at places that were read before and after.
    """
    if posterior.mixture.chi2_per_dof < _OVERSTATED_NOISE:
        return _noise_square_ratios(posterior)
    usual = dict[str, float]()
    for factor in posterior.before.problem.factors:
        noise = factor.noise
        ratio = np.where(factor.readings.touching, 1.0, noise.expected / noise.total)
        for kind in dict.fromkeys(factor.readings.kind):
            of_kind = ratio[factor.readings.of_kind(kind) & noise.weighted]
            median = float(np.median(of_kind)) if len(of_kind) else 1.0
            usual[kind] = min(usual.get(kind, 1.0), median**2)
    return usual if min(usual.values()) < _SCATTERED_REPEATS else {}


def _noise_square_ratios(posterior: FullPosterior) -> dict[str, float]:
    """Return the ratio of the squared noise of the best explanation to that assumed, by kind of
    reading, because the noise of one instrument alone may be overstated.
    """
    kinds = {kind for factor in posterior.before.problem.factors for kind in factor.readings.kind}
    chi2, dof = dict.fromkeys(kinds, 0.0), dict.fromkeys(kinds, 0.0)
    for one in noise_scales(posterior.after):
        chi2[one.setup.kind] += one.chi2
        dof[one.setup.kind] += one.dof
    return {kind: min(chi2[kind] / dof[kind], 1.0) if dof[kind] > 0 else 1.0 for kind in kinds}
