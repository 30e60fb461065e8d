"""One number to identify, and what is known of several before the readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter

_UNNOTICED = 0.02
"""Share of its tolerance by which a parameter drifts between visits without being a change: as much
as the background of other effects that a machine with nothing wrong is allowed."""


@dataclass(frozen=True)
class Unknown:
    """One number to identify."""

    name: Parameter  # as reported; what campaigns have for themselves carries the first one's name
    # for each factor, the weights of the elementary parameters that it sets
    parts: tuple[Mapping[str, float], ...]
    tolerance: float  # standard deviation to expect, SI
    start: float  # SI
    bound: float  # the value stays within plus and minus this, SI
    width: float = 1.0  # how many tolerances wide its prior is


def weight_matrix(names: Sequence[str], several: Sequence[Mapping[Any, float]]) -> Array:
    """Weights of parameters in each of several that stand for some of them ``(E, P)``."""
    place = {name: k for k, name in enumerate(names)}
    matrix = np.zeros((len(names), len(several)))
    for k, weights in enumerate(several):
        for name, weight in weights.items():
            matrix[place[name], k] = weight
    return matrix


def rows_about(
    known: Posterior, unknowns: Sequence[Unknown]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """What is known of a machine's elementary parameters as whitened rows about ``P`` unknowns.

    Returns:
        Matrix ``(k, P)`` and target ``(k,)`` of ``|matrix x - target|^2``, and which of the
        unknowns these speak of ``(P,)``.
    """
    place = {n: k for k, n in enumerate(known.names) if known.covariance[k, k] > 0}
    spoken = np.array([u.name in place for u in unknowns], dtype=bool)
    chosen = [place[u.name] for u, s in zip(unknowns, spoken, strict=True) if s]
    matrix = np.zeros((len(chosen), len(unknowns)))
    # What is not free stays at its mean: what is known of the rest is known given that.
    rest = [k for k in place.values() if k not in set(chosen)]
    block = known.covariance[np.ix_(chosen, chosen)]
    if rest:
        scale = np.sqrt(np.diag(known.covariance)[rest])
        among = known.covariance[np.ix_(rest, rest)] / scale / scale[:, None]
        across = known.covariance[np.ix_(chosen, rest)] / scale
        block = block - across @ np.linalg.pinv(among, rcond=1e-9, hermitian=True) @ across.T
    tolerance = np.array([u.tolerance for u, s in zip(unknowns, spoken, strict=True) if s])
    block = block + np.diag((_UNNOTICED * tolerance) ** 2)
    sd = np.sqrt(np.diag(block))
    values, vectors = np.linalg.eigh(block / sd / sd[:, None])
    root = (vectors / np.sqrt(np.maximum(values, 1e-10 * values.max(initial=1.0)))).T / sd
    matrix[:, spoken] = root
    return matrix, root @ known.mean[chosen], spoken
