"""The checks of a fit by other derivations: its values by the reduction's own fit and the linear
system (11), its postures by Pinocchio's constraint Jacobian.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide import reduction
from orthoglide.effects import CATALOGUE
from orthoglide.errors import CrossCheckError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.least_squares import Linearised, Nuisances
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknowns import weight_matrix
from orthoglide.geometry import Array
from orthoglide.mechanism.engine import PinocchioEngine
from orthoglide.prediction import Conditions
from orthoglide.result.fits import CrossCheck, Verification

AGREEMENT = 1e-9
"""Metres: two derivations of one model that disagree by more have an error."""

_REDUCTION_PARAMETERS = tuple(p for name in CATALOGUE.base for p in CATALOGUE[name].parameters())


def reduction_fit(
    problem: Problem,
    nuisance: Nuisances,
    *,
    linear: bool = False,
    start: Array | None = None,
    held: NDArray[np.bool_] | None = None,
) -> reduction.ReadingFit:
    """The reduction's fit of the same problem: same noise, priors, datums and placements.

    Readings are those of the stations, in the order of ``problem.station``.

    Args:
        problem: with no unknowns but joint offsets and leg lengths.
        nuisance: the frozen columns.
        linear: fit system (11), generalised to any readings, instead.
        start: where to start ``(P,)``; the problem's where absent.
        held: unknowns that stay at their start ``(P,)``; none where absent. Bounds do not act.
    """
    # Visits to a station differ in nothing that the reduction knows: their mean says it all.
    weighing = nuisance.weighing
    chosen = weighing.first_rows
    campaigns = problem.campaigns
    group = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
    command, leg, axis, gauge, sign = (column[chosen] for column in _dial_columns(problem))
    maps = np.zeros((len(campaigns), 6, len(problem.unknowns) + 1))
    for k in range(len(campaigns)):
        maps[k, :, :-1], maps[k, :, -1] = _reduction_weights(problem, k)
    free = np.ones(len(problem.unknowns), dtype=bool) if held is None else ~held
    # The last parameter is held at one: it carries what the machine file already says.
    return reduction.fit_readings(
        command,
        leg,
        axis,
        gauge,
        weighing.means(problem.measured),
        weighing.mean_sigma,
        signs=sign,
        free=np.append(free, False),
        prior_sd=np.append(problem.prior_sd, np.inf),
        nuisance=weighing.means(nuisance.columns),
        precision=nuisance.precision,
        x0=np.append(problem.start if start is None else start, 1.0),
        group=group[chosen],
        maps=maps,
        geometry=problem.machine.geometry,
        linear=linear,
    )


def _reduction_weights(problem: Problem, campaign: int) -> tuple[Array, Array]:
    """The reduction's six for a campaign: by the unknowns ``(6, P)``, and as held ``(6,)``."""
    held = np.array([problem.held[campaign].get(name, 0.0) for name in _REDUCTION_PARAMETERS])
    return weight_matrix(
        _REDUCTION_PARAMETERS, [u.weights[campaign] for u in problem.unknowns]
    ), held


def _dial_columns(problem: Problem) -> list[Any]:
    """Command ``(n, 3)``, leg, axis, gauge and sign ``(n,)`` of every reading of a dial."""
    return [problem.dial_column(name) for name in ("command", "leg", "axis", "gauge", "sign")]


def cross_check(problem: Problem, nuisance: Nuisances, at: Linearised) -> CrossCheck | None:
    """Compare an identification, linearised where it ended, with the reduction and system (11).

    Returns:
        The differences, or ``None`` where the reduction cannot represent what was asked.

    Raises:
        CrossCheckError: where mechanism and reduction disagree by more than 1e-6 mm.
    """
    if not problem.reduction_applies:
        return None
    x, value = at.x, at.value
    # What ended on a bound is held there, and far from the start the legs need not meet.
    held = problem.on_bound(x)
    start = x if held.any() else problem.start
    own = reduction_fit(problem, nuisance, start=start, held=held)
    difference = float(np.max(np.abs(own.values[:-1] - x), initial=0.0))
    if not own.converged or difference > AGREEMENT:
        raise CrossCheckError(
            f"the mechanism and the reduction disagree by {difference * 1e3:.3g} mm on the same "
            f"readings: do not use these values, and report the campaign",
            difference=difference,
        )
    linear = reduction_fit(problem, nuisance, linear=True, start=start, held=held)
    fitted = value + nuisance.explained_residual(problem.measured - value)
    weighing = nuisance.weighing
    apart = fitted - linear.readings[weighing.station]
    size = float(np.linalg.norm(weighing.whiten(apart)) / np.linalg.norm(weighing.weight))
    return CrossCheck(
        difference,
        float(np.max(np.abs(apart), initial=0.0)),
        _second_order_bound(problem, nuisance, at),
        size,
        linear.values[:-1],
    )


def _second_order_bound(problem: Problem, nuisance: Nuisances, at: Linearised) -> float:
    """Largest norm of the difference between nonlinear and linear fit that theory allows.

    With f(x) = J0 x + e and residual q of the nonlinear fit, the linear fit is P0 (f + q), P0 the
    projection on the linear system's columns: the difference is (1 - P0) e - P0 q, no longer than
    |e| + |P0 q| in the norm of the noise.
    """
    x, value = at.x, at.value
    *dials, sign = _dial_columns(problem)
    seen = reduction.predict_readings(*dials, geometry=problem.machine.geometry)
    by_six = sign[:, None] * seen.gradient
    by_x = np.zeros((len(sign), len(x)))
    constant = np.zeros(len(sign))
    for k, part in enumerate(problem.leg_rows):
        by_unknowns, held = _reduction_weights(problem, k)
        by_x[part], constant[part] = by_six[part] @ by_unknowns, by_six[part] @ held
    prior = np.diag(1 / problem.prior_sd)
    jacobian = np.vstack([nuisance.project(by_x), prior])[:, ~problem.on_bound(x)]
    remainder = nuisance.project(value - by_x @ x - constant)
    residual = np.concatenate([nuisance.project(problem.measured - value), -x / problem.prior_sd])
    basis, _ = np.linalg.qr(jacobian)
    bound = float(np.linalg.norm(remainder) + np.linalg.norm(basis.T @ residual))
    return bound / float(np.linalg.norm(nuisance.weighing.weight))


# By Pinocchio --------------------------------------------------------------------------------

MAX_POSTURES = 500
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
    if len(travel) > MAX_POSTURES:
        drawn = np.random.default_rng(0).choice(len(travel), MAX_POSTURES, replace=False)
        travel, moves = travel[drawn], moves[drawn]
    engine = estimate.problem.machine.model.engine
    reference = PinocchioEngine(engine.mechanism)
    shown, by_given = engine.tangent(travel, moves)
    expected, expected_by_given = reference.tangent(travel, moves)
    scale = np.abs(expected_by_given).max(axis=2, initial=SMALLEST_SCALE)
    apart = np.abs(by_given - expected_by_given).max(axis=2, initial=0.0)
    found = Verification(
        reference.largest_residual,
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
        moves.append(model.loaded_displacements(values, conditions))
    return np.concatenate(travel), np.concatenate(moves)
