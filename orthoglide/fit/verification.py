"""The postures of a finished fit closed once more by Pinocchio, and compared with six bars."""

from __future__ import annotations

import numpy as np

from orthoglide.errors import CrossCheckError
from orthoglide.fit.estimate import Estimate
from orthoglide.geometry import Array
from orthoglide.mechanism.engine import ByPinocchio
from orthoglide.prediction import Conditions
from orthoglide.result.fits import Verification

MOST_POSTURES = 500
"""Of more postures a random sample of this size is closed: one takes half a millisecond."""

TCP_LIMIT = 1e-9
"""Metres: a thousandth of what any instrument here resolves, a million times rounding."""

SENSITIVITY_LIMIT = 1e-6
"""Relative difference of derivatives: far below what a fit notices, far above rounding."""

SMALLEST_SCALE = 1e-3
"""Metres a metre: of outputs that move by less, differences count as absolute."""


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
