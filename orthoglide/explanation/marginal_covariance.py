"""Covariance of some coefficients in a state, all others marginalised as noise."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from orthoglide.explanation.linear_model import LinearModel, Scale
from orthoglide.geometry import Array


def marginal_covariances(
    linear: LinearModel, index: NDArray[np.intp]
) -> Callable[[Scale, Array], Array]:
    """Return a function that computes the posterior covariance ``(k, k)`` of some coefficients.

    Its arguments are the scale of the background, and a root ``(C, q)`` of the additional prior
    covariance (the slab) of the groups that are active. The usual form, prior minus gain, loses all
    digits where the readings determine a direction a million times better than the prior. Here the
    other coefficients are marginalised as noise, and the precisions of prior and data are added.

    Args:
        linear: the readings.
        index: of the coefficients ``(k,)``.
    """
    marginalised = np.ones(len(linear.fixed_sd), dtype=bool)
    marginalised[index] = False
    fixed = np.isfinite(linear.fixed_sd)
    kinds = (fixed, linear.free_form & ~fixed, ~linear.free_form & ~fixed)
    scaled = linear.columns * np.where(fixed, linear.fixed_sd, 1.0)
    blocks = (scaled[:, marginalised & kind] for kind in kinds)
    fixed_part, free, background = (block @ block.T for block in blocks)
    *_, stations = linear.prior_covariances

    @cache  # many states share a scale
    def whitened(scale: Scale) -> tuple[Array, Array, Array]:
        covariance = fixed_part + scale.free_form_scale**2 * free
        covariance += scale.background_scale**2 * background
        covariance += scale.noise**2 * stations + np.eye(len(covariance))
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        columns = linear.columns[:, index] * np.sqrt(scale.spike[index])
        columns = np.asarray(solve_triangular(root, columns, lower=True))
        return root, columns, columns.T @ columns

    def covariance(scale: Scale, slab_root: Array) -> Array:
        root, columns, gram = whitened(scale)
        active = solve_triangular(root, linear.columns @ slab_root, lower=True)
        crossed = columns.T @ active
        precision = np.block([[gram, crossed], [crossed.T, active.T @ active]])
        precision += np.eye(len(precision))
        units = np.hstack([np.diag(np.sqrt(scale.spike[index])), slab_root[index]])
        scaled_root = solve_triangular(np.linalg.cholesky(precision), units.T, lower=True)
        return np.asarray(scaled_root.T @ scaled_root)

    return covariance
