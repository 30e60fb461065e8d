"""Mobility and redundancy of the closed mechanism at a posture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.geometry import Array
from orthoglide.mechanism.constraints import Constraints

# Zero singular values of the 21 rows are zero up to rounding; the smallest other one is 0.01.
_RANK_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Mobility:
    """How a machine with loops is constrained at one posture."""

    joints: int  # joints of the tree, drives included
    rows: int  # closure rows
    rank: int  # independent ones among them
    mobility: int  # degrees of freedom, `joints - rank`
    # conditions that the others imply, `rows - rank`: the machine is overconstrained, and errors
    # of the parts strain it
    redundant: int
    by_loop: dict[str, int]  # rank of each loop's rows alone

    def __str__(self) -> str:
        ranks = [rank for name, rank in self.by_loop.items() if "parallelogram" in name]
        planar = 3 * len(ranks) - sum(ranks)
        summary = (
            f"{self.joints} joints, {self.rows} closure rows of rank {self.rank}: mobility "
            f"{self.mobility}, {self.redundant} redundant rows."
        )
        if not ranks:
            return summary
        return (
            f"{summary} {planar} of them are in the parallelograms, whose planes already follow "
            f"from the other rows. The other {self.redundant - planar} repeat constraints on the "
            f"platform's rotation, because every leg resists torsion."
        )


def mobility(constraints: Constraints, q: Array) -> Mobility:
    """Return the mobility of the nominal tree at a closed posture ``q``."""
    rows = constraints.jacobian(q)
    by_loop = {name: _rank(rows[part]) for name, part in constraints.tree.rows.items()}
    (count, joints), rank = rows.shape, _rank(rows)
    return Mobility(joints, count, rank, joints - rank, count - rank, by_loop)


def _rank(rows: Array) -> int:
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(values > _RANK_TOLERANCE * values[0]))
