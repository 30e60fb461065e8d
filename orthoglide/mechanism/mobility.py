"""Mobility and redundancy of the closed mechanism at a posture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.geometry import Array
from orthoglide.mechanism.constraints import Constraints

# Singular values of the 21 rows that vanish do so to rounding; the smallest that does not is 0.01.
_RANK_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Mobility:
    """How a machine with loops is constrained at one posture."""

    joints: int  # joints of the tree, drives included
    rows: int  # closure rows
    rank: int  # independent ones among them
    mobility: int  # degrees of freedom, `joints - rank`
    # conditions that the others imply, `rows - rank`: where the machine is overconstrained and
    # errors of the parts strain it
    redundant: int
    by_loop: dict[str, int]  # rank of each loop's rows alone

    def __str__(self) -> str:
        pa = [rank for name, rank in self.by_loop.items() if "parallelogram" in name]
        planar = 3 * len(pa) - sum(pa)
        counted = (
            f"{self.joints} joints, {self.rows} closure rows of rank {self.rank}: mobility "
            f"{self.mobility}, {self.redundant} redundant rows."
        )
        if not pa:
            return counted
        return (
            f"{counted} {planar} of them are in the parallelograms, whose planes already follow "
            f"from the other rows. The other {self.redundant - planar} repeat constraints on the "
            f"platform's rotation, because every leg resists torsion."
        )


def mobility(constraints: Constraints, q: Array) -> Mobility:
    """Rank of the constraint Jacobian at a closed posture ``q`` of the nominal tree."""
    rows = constraints.jacobian(q)
    rank, by_loop = _rank(rows), {n: _rank(rows[own]) for n, own in constraints.tree.rows.items()}
    count, joints = rows.shape
    return Mobility(joints, count, rank, joints - rank, count - rank, by_loop)


def _rank(rows: Array) -> int:
    # Translations in metres beside turns in radians: bring the bars' length to order one.
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(values > _RANK_TOLERANCE * values[0]))
