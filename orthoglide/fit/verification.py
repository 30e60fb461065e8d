"""The postures of a finished fit closed once more by Pinocchio, and compared with six bars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.errors import CrossCheckError
from orthoglide.fit.estimate import Estimate
from orthoglide.geometry import Array
from orthoglide.mechanism.engine import ByPinocchio
from orthoglide.prediction import Conditions

MOST_POSTURES = 500
"""Of more postures a random sample of this size is closed: one takes half a millisecond."""

TCP_LIMIT = 1e-9
"""Metres: a thousandth of what any instrument here resolves, a million times rounding."""

SENSITIVITY_LIMIT = 1e-6
"""Relative difference of derivatives: far below what a fit notices, far above rounding."""

SMALLEST_SCALE = 1e-3
"""Metres a metre: of outputs that move by less, differences count as absolute."""


@dataclass(frozen=True)
class Verification:
    """How far Pinocchio's closed postures are from those that the fit used.

    Attributes:
        closure: largest closure residual by loop, metres or radians.
        tcp: largest difference of the TCP, metres.
        sensitivity: largest difference of a derivative by travel or a virtual joint, relative to
            the largest derivative of the same output, or to ``SMALLEST_SCALE``.
        postures: how many were closed.
    """

    closure: dict[str, float]
    tcp: float
    sensitivity: float
    postures: int

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``result.json``."""
        return {
            "closure_residual_m": {name: float(f"{v:.3g}") for name, v in self.closure.items()},
            "tcp_max_difference_mm": float(f"{1e3 * self.tcp:.3g}"),
            "sensitivity_max_relative_difference": float(f"{self.sensitivity:.3g}"),
            "postures": self.postures,
        }


def verify(estimate: Estimate) -> Verification:
    """Close the postures of a fit with Pinocchio's constraint Jacobian at the values it found.

    Raises:
        ClosureError: where Pinocchio does not close a posture that the engine closed.
        CrossCheckError: where TCP or sensitivities differ by more than the limits.
    """
    travel, moves = _postures(estimate)
    if len(travel) > MOST_POSTURES:
        drawn = np.random.default_rng(0).choice(len(travel), MOST_POSTURES, replace=False)
        travel, moves = travel[drawn], moves[drawn]
    engine = estimate.problem.machine.model.engine
    reference = ByPinocchio(engine.mechanism)
    shown, by_given = engine.tangent(travel, moves)
    expected, expected_by_given = reference.tangent(travel, moves)
    scale = np.abs(expected_by_given).max(axis=2, initial=SMALLEST_SCALE)
    apart = np.abs(by_given - expected_by_given).max(axis=2, initial=0.0)
    found = Verification(
        reference.worst,
        float(np.linalg.norm(shown.p - expected.p, axis=1).max(initial=0.0)),
        float((apart / scale).max(initial=0.0)),
        len(travel),
    )
    if not (found.tcp <= TCP_LIMIT and found.sensitivity <= SENSITIVITY_LIMIT):
        raise CrossCheckError(
            f"six bars and Pinocchio disagree by {found.tcp * 1e3:.3g} mm of the TCP and "
            f"{found.sensitivity:.3g} of a sensitivity: do not use these values, and report the "
            f"campaign",
            difference=found.tcp,
        )
    return found


def _postures(estimate: Estimate) -> tuple[Array, Array]:
    """Travel ``(n, 3)`` and displacements ``(n, 30)`` of all distinct postures of a fit."""
    problem, travel, moves = estimate.problem, list[Array](), list[Array]()
    model = problem.machine.model
    for k, factor in enumerate(problem.factors):
        values = problem.values(k, estimate.x)
        conditions: Conditions = model.merged(factor.conditions(), values)[0]
        travel.append(conditions.command - model.geometry.zero)
        moves.append(model.moves(values, conditions))
    return np.concatenate(travel), np.concatenate(moves)
