"""The noise of each setup by what a fit leaves of its readings, against the noise assumed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.estimate import Estimate
from orthoglide.observations import Readings, Setup


@dataclass(frozen=True)
class NoiseScale:
    """Noise of the readings of one setup, or of several together."""

    readings: Readings  # the table that they belong to
    setup: Setup  # of several the first
    rows: NDArray[np.intp]  # of all readings (m,)
    sigma: float  # standard deviation of one reading as assumed, root mean square, SI
    chi2: float  # of the residuals
    dof: float  # what that is expected to be: the readings less what was fitted to them

    @property
    def scale(self) -> float:
        """Ratio of the noise that the residuals show to the noise assumed; nan without degrees of
        freedom.
        """
        return float(np.sqrt(self.chi2 / self.dof)) if self.dof > 0 else float("nan")

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of :attr:`scale`: that of a root of a chi2."""
        return self.scale / float(np.sqrt(2 * self.dof)) if self.dof > 0 else float("nan")


def noise_scales(estimate: Estimate) -> tuple[NoiseScale, ...]:
    """Return the noise of every setup, in the order of the files; TCP points count as one."""
    problem = estimate.problem
    square = problem.weighing.whiten(estimate.residuals) ** 2
    free = 1 - estimate.rows.leverage
    found = []
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        readings = factor.readings
        for number in np.unique(readings.setup):
            own = (readings.setup == number) & factor.noise.weighted
            if own.any():
                rows = part.start + np.flatnonzero(own)
                sigma = float(np.sqrt(np.mean(factor.noise.total[own] ** 2)))
                chi2, dof = float(square[rows].sum()), max(float(free[rows].sum()), 0.0)
                found.append(NoiseScale(readings, readings.setups[number], rows, sigma, chi2, dof))
    return tuple(found)


def together(several: Iterable[NoiseScale]) -> NoiseScale:
    """Return the noise of several setups of one table as one."""
    each = list(several)
    rows = np.concatenate([one.rows for one in each])
    size = np.array([len(one.rows) for one in each])
    sigma = np.sqrt(np.average([one.sigma**2 for one in each], weights=size))
    chi2, dof = sum(one.chi2 for one in each), sum(one.dof for one in each)
    return NoiseScale(each[0].readings, each[0].setup, rows, float(sigma), chi2, dof)
