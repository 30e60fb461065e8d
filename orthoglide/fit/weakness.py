"""Directions in the unknowns that the readings hardly see, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array

# An unknown whose sigma is ten times what it would be alone hides behind others.
_WEAK = 0.1
_SHARE = 0.05


@dataclass(frozen=True)
class WeakDirection:
    """Unknowns that the readings cannot tell apart."""

    parameters: Mapping[str, float]  # their shares along the direction; squares sum to one
    # how far the readings alone leave the machine free along it, in `unit`; infinite where nothing
    # is seen
    sigma: float
    sigma_with_priors: float  # the same with the tolerances as priors; equal without priors
    unit: str  # of both

    def __str__(self) -> str:
        names = " and ".join(self.parameters)
        along = " ".join(f"{share:+.2f} {name}" for name, share in self.parameters.items())
        left = (
            f"sigma {self.sigma:.2g} {self.unit}" if np.isfinite(self.sigma) else "nothing is seen"
        )
        verb = "cannot be told apart by" if len(self.parameters) > 1 else "is hardly seen by"
        tail = ""
        if self.sigma_with_priors < 0.5 * self.sigma:
            tail = (
                f" (with the tolerances as priors {self.sigma_with_priors:.2g} {self.unit}: that "
                f"is knowledge of the tolerances, not of the readings)"
            )
        return f"{names} {verb} these readings: {left} along {along}{tail}"


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
    seen = np.where(norm > 0, norm, 1.0)
    # Rows of zeros let fewer readings than unknowns span all directions.
    padded = np.vstack([jacobian / seen, np.zeros((len(names), len(names)))])
    _, singular, right = np.linalg.svd(padded, full_matrices=False)
    weak = singular < _WEAK
    if not weak.any():
        return ()
    # Back in SI, then the sparsest basis of the weak space, so that legs stand apart.
    basis = sparse_basis((right[weak] / seen) / np.linalg.norm(right[weak] / seen, axis=1)[:, None])
    found = []
    for direction in basis:
        seen_along = float(np.linalg.norm(jacobian @ direction))
        sigma = scale / seen_along if seen_along > 1e-9 * norm.max() else float("inf")
        with_priors = float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
        largest = int(np.argmax(np.abs(direction)))
        unit = problem.machine.catalogue.effect_of(names[largest]).unit
        kept = np.flatnonzero(np.abs(direction) >= _SHARE * abs(direction[largest]))
        sign = np.sign(direction[kept[0]])
        shares: dict[str, float] = {names[k]: float(sign * direction[k]) for k in kept}
        found.append(WeakDirection(shares, sigma / unit.si, with_priors / unit.si, unit.name))
    return tuple(sorted(found, key=lambda d: -d.sigma))


def sparse_basis(basis: Array) -> Array:
    """Reduced row echelon form of the rows, pivots by size; rows of unit length."""
    rows, pivots = basis.copy(), []
    for k in range(len(rows)):
        free = [j for j in range(rows.shape[1]) if j not in pivots]
        i, j = np.unravel_index(np.argmax(np.abs(rows[k:][:, free])), (len(rows) - k, len(free)))
        pivot = free[int(j)]
        rows[[k, k + int(i)]] = rows[[k + int(i), k]]
        rows[k] /= rows[k, pivot]
        others = np.arange(len(rows)) != k
        rows[others] -= rows[others, pivot][:, None] * rows[k]
        pivots.append(pivot)
    return np.asarray(rows / np.linalg.norm(rows, axis=1)[:, None])
