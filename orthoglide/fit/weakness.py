"""Directions in the unknowns that the readings hardly see, in words."""

from __future__ import annotations

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL, canonical_basis, largest, ranked
from orthoglide.result.fits import WeakDirection

# An unknown whose sigma is ten times what it would be alone hides behind others.
_WEAK = 0.1
_SHARE = 0.05
# Of what the unknown seen best shows at its tolerance: less is rounding.
_ROUNDING = 1e-9
# Singular value of unit columns below which a direction shows nothing but rounding.
_UNSEEN = 1e-6


def weak_directions(
    problem: Problem, jacobian: Array, covariance: Array, *, scale: float = 1.0
) -> tuple[WeakDirection, ...]:
    """Find the weak directions.

    Args:
        problem: whose unknowns these are.
        jacobian: whitened and projected ``(m, P)``, SI, priors apart.
        covariance: of the unknowns as reported ``(P, P)``, SI, scaled.
        scale: of the reported sigmas.

    Returns:
        Weakest first; empty where every unknown is seen well.
    """
    names = problem.names
    norm = np.linalg.norm(jacobian, axis=0)
    # An unknown of which only rounding shows is not seen at all.
    shown = norm * problem.tolerance
    norm = np.where(shown > _ROUNDING * shown.max(initial=0.0), norm, 0.0)
    seen = np.where(norm > 0, norm, 1.0)
    # Rows of zeros let fewer readings than unknowns span all directions.
    columns = np.where(norm > 0, jacobian, 0.0) / seen
    padded = np.vstack([columns, np.zeros((len(names), len(names)))])
    _, singular, right = np.linalg.svd(padded, full_matrices=False)
    weak = singular < _WEAK
    if not weak.any():
        return ()
    # In SI, where the basis has the fewest unknowns a direction, so that legs stand apart.
    blind = singular < _UNSEEN
    found = []
    for k, direction in enumerate(canonical_basis(right[weak] / seen, right[blind] / seen)):
        left = float(np.linalg.norm(columns @ (direction * seen)))
        sigma = scale / left if k >= blind.sum() else float("inf")
        with_priors = float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
        size = np.abs(direction)
        unit = problem.machine.catalogue.effect_of(names[largest(size)]).unit
        kept = np.flatnonzero(size >= _SHARE * size.max())
        sign = np.sign(direction[kept[0]])
        shares: dict[str, float] = {names[k]: float(sign * direction[k]) for k in kept}
        found.append(WeakDirection(shares, sigma / unit.si, with_priors / unit.si, unit.name))
    # Sigmas range over decades: equal are those of nearly equal logarithm.
    return tuple(ranked(found, lambda d: float(np.log(d.sigma)), EQUAL))
