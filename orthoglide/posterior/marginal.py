"""The covariance of some coefficients, all others marginalised, for readings however exact.

Prior less gain is a difference of large numbers where readings know a direction a million times
better than the prior does: what is left there is rounding, and no covariance. Here the others count
as noise, and precisions are added up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from orthoglide.geometry import Array
from orthoglide.posterior.linear import Linear, Scale


class Marginal:
    """Some coefficients of readings that are linear in all.

    Args:
        linear: the readings.
        at: places of the coefficients ``(k,)``.
    """

    def __init__(self, linear: Linear, at: NDArray[np.intp]) -> None:
        self.linear, self.at = linear, at
        others = np.ones(len(linear.fixed), dtype=bool)
        others[at] = False
        fixed = np.isfinite(linear.fixed)
        kinds = (fixed, linear.free & ~fixed, ~linear.free & ~fixed)
        size = np.where(fixed, linear.fixed, 1.0)
        rows = (linear.columns[:, others & kind] * size[others & kind] for kind in kinds)
        self._fixed, self._free, self._background = (part @ part.T for part in rows)

    def covariance(self, scale: Scale, spread: Array) -> Array:
        """Covariance ``(k, k)``.

        Args:
            scale: of what does not stand out.
            spread: what does, by coefficient ``(C, q)``, each times its standard deviation.
        """
        linear, at = self.linear, self.at
        noise = self._fixed + scale.free_share**2 * self._free + scale.share**2 * self._background
        noise += scale.rough**2 * linear.squares[3] + np.eye(len(noise))
        sd = np.sqrt(scale.spike[at])
        shown = np.hstack([linear.columns[:, at] * sd, linear.columns @ spread])
        shown = solve_triangular(np.linalg.cholesky(noise), shown, lower=True)
        precision = np.eye(shown.shape[1]) + shown.T @ shown
        units = np.hstack([np.diag(sd), spread[at]])
        half = solve_triangular(np.linalg.cholesky(precision), units.T, lower=True)
        return np.asarray(half.T @ half)
