"""The readings to take with several instruments at the tool: one choice among all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orthoglide.errors import InputError
from orthoglide.fit import with_others
from orthoglide.fit.excited import excited_effects
from orthoglide.fit.least_squares import linearise
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import ToolCampaign
from orthoglide.planning.detectable import as_expected

_LOOSE = 1e-6  # precision of a datum, in readings: one of which nothing is known

LEAST = 6
"""Readings that are worth choosing: a plate's own height and slopes take three."""


def mixed_sheet(
    machine: Machine, sheets: Sequence[ToolCampaign], count: int
) -> tuple[ToolCampaign, ...]:
    """The ``count`` readings, of sheets of one instrument each, that together tell most of
    everything that could be wrong with a machine.

    From all of them the one is dropped, again and again, without which the determinant of the
    information falls least: of all parameters in their tolerances, what belongs to the setups
    (a plate's height and slopes, an instrument's frame) projected out.

    Returns:
        What is kept of each sheet; sheets of which nothing is are left out.

    Raises:
        InputError: for too few readings.
    """
    most = sum(map(len, sheets))
    if not LEAST <= count <= most:
        raise InputError(
            f"there are {most} readings of the tool to choose from: ask for {LEAST} to {most}, not "
            f"{count}"
        )
    rows, shared, prior = whitened(machine, sheets)
    kept = np.arange(len(rows))
    both = np.diag(prior) + rows.T @ rows
    while len(kept) > count:
        whole = _leverage(both, rows[kept])
        datums = _leverage(both[shared:, shared:], rows[kept, shared:])
        worst = int(np.argmin(np.log1p(-datums) - np.log1p(-whole)))
        both -= np.outer(rows[kept[worst]], rows[kept[worst]])
        kept = np.delete(kept, worst)
    owner = np.repeat(np.arange(len(sheets)), [len(s) for s in sheets])
    first = np.cumsum([0, *(len(s) for s in sheets)])
    chosen = [kept[owner[kept] == k] - first[k] for k in range(len(sheets))]
    return tuple(s.subset(at).in_order() for s, at in zip(sheets, chosen, strict=True) if len(at))


def whitened(machine: Machine, sheets: Sequence[ToolCampaign]) -> tuple[Array, int, Array]:
    """Rows ``(n, P + k)`` by parameters in tolerances and by datums, ``P``, and precisions."""
    estimate = as_expected(machine, sheets, None)
    problem = estimate.problem
    wide = with_others(problem, [effect.name for effect in excited_effects(problem)])
    nuisance = estimate.nuisance
    weight = nuisance.weighing.weight[:, None]
    columns = linearise(wide, wide.padded(estimate.x)).jacobian * wide.tolerance * weight
    datums = nuisance.columns * weight
    size = np.linalg.norm(datums, axis=0)
    size[size == 0] = 1.0
    known = nuisance.precision / size**2
    prior = np.concatenate([np.ones(columns.shape[1]), np.maximum(known, _LOOSE)])
    return np.hstack([columns, datums / size]), columns.shape[1], prior


def _leverage(information: Array, rows: Array) -> Array:
    """Share of each row ``(n,)`` in what is known along it."""
    share = np.sum(rows * np.linalg.solve(information, rows.T).T, axis=1)
    return np.asarray(np.clip(share, 0.0, 1 - 1e-12))
