"""Checks of a fit by other derivations: of its values by the reduction's own fit and the linear
system (11), of its postures by Pinocchio's constraint Jacobian.
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
    """Return the reduction's fit of a problem, with its noise, priors, datums and placements.

    Readings are the means of the stations, in the order of ``problem.station``: visits to a
    station differ in nothing that the reduction describes.

    Args:
        problem: with no unknowns but joint offsets and leg lengths.
        nuisance: the frozen columns.
        linear: whether to fit system (11), generalised to any readings.
        start: initial values ``(P,)``; the problem's where absent.
        held: unknowns that stay at their start ``(P,)``; none where absent. Bounds do not act.
    """
    weighing, campaigns = nuisance.weighing, problem.campaigns
    first_rows = weighing.first_rows
    group = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
    command, leg, axis, gauge, sign = (column[first_rows] for column in _dial_columns(problem))
    maps = np.zeros((len(campaigns), 6, len(problem.unknowns) + 1))
    for k in range(len(campaigns)):
        maps[k, :, :-1], maps[k, :, -1] = _reduction_weights(problem, k)
    free = np.ones(len(problem.unknowns), dtype=bool) if held is None else ~held
    # The last parameter is held at one: its column holds the values of the machine file.
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
        group=group[first_rows],
        maps=maps,
        geometry=problem.machine.geometry,
        linear=linear,
    )


def _reduction_weights(problem: Problem, campaign: int) -> tuple[Array, Array]:
    """Return the weights of the unknowns in a campaign's six parameters of the reduction
    ``(6, P)``, and the held values of these ``(6,)``.
    """
    held = np.array([problem.held[campaign].get(name, 0.0) for name in _REDUCTION_PARAMETERS])
    weights = [u.weights[campaign] for u in problem.unknowns]
    return weight_matrix(_REDUCTION_PARAMETERS, weights), held


def _dial_columns(problem: Problem) -> list[Any]:
    """Return command ``(n, 3)``, leg, axis, gauge and sign ``(n,)`` of every dial reading."""
    return [problem.dial_column(name) for name in ("command", "leg", "axis", "gauge", "sign")]


def cross_check(problem: Problem, nuisance: Nuisances, fit: Linearised) -> CrossCheck | None:
    """Return the differences of a fit from the reduction and from system (11), or ``None`` where
    the reduction cannot represent the problem.

    Raises:
        CrossCheckError: where mechanism and reduction disagree by more than 1e-6 mm.
    """
    if not problem.reduction_applies:
        return None
    # Unknowns on a bound are held there; far from the start the legs need not meet.
    held = problem.on_bound(fit.x)
    start = fit.x if held.any() else problem.start
    reduced = reduction_fit(problem, nuisance, start=start, held=held)
    difference = float(np.max(np.abs(reduced.values[:-1] - fit.x), initial=0.0))
    if not reduced.converged or difference > AGREEMENT:
        raise CrossCheckError(
            f"the mechanism and the reduction disagree by {difference * 1e3:.3g} mm on the same "
            f"readings: do not use these values, and report the campaign",
            difference=difference,
        )
    linear = reduction_fit(problem, nuisance, linear=True, start=start, held=held)
    weighing = nuisance.weighing
    fitted = fit.value + nuisance.explained_residual(problem.measured - fit.value)
    nonlinearity = fitted - linear.readings[weighing.station]
    norm = np.linalg.norm(weighing.whiten(nonlinearity)) / np.linalg.norm(weighing.weight)
    largest, bound = (
        np.abs(nonlinearity).max(initial=0.0),
        _second_order_bound(problem, nuisance, fit),
    )
    return CrossCheck(difference, float(largest), bound, float(norm))


def _second_order_bound(problem: Problem, nuisance: Nuisances, fit: Linearised) -> float:
    """Return the largest norm of the difference between nonlinear and linear fit in theory.

    With f(x) = J0 x + e and residual q of the nonlinear fit, the linear fit is P0 (f + q), P0 the
    projection on the linear system's columns: the difference is (1 - P0) e - P0 q, no longer than
    |e| + |P0 q| in the norm of the noise.
    """
    x, value = fit.x, fit.value
    *dials, sign = _dial_columns(problem)
    reduced = reduction.predict_readings(*dials, geometry=problem.machine.geometry)
    by_parameters = sign[:, None] * reduced.gradient
    by_x, constant = np.zeros((len(sign), len(x))), np.zeros(len(sign))
    for k, rows in enumerate(problem.leg_rows):
        by_unknowns, held = _reduction_weights(problem, k)
        by_x[rows], constant[rows] = by_parameters[rows] @ by_unknowns, by_parameters[rows] @ held
    prior = np.diag(1 / problem.prior_sd)
    jacobian = np.vstack([nuisance.project(by_x), prior])[:, ~problem.on_bound(x)]
    remainder = nuisance.project(value - by_x @ x - constant)
    residual = np.concatenate([nuisance.project(problem.measured - value), -x / problem.prior_sd])
    basis, _ = np.linalg.qr(jacobian)
    bound = float(np.linalg.norm(remainder) + np.linalg.norm(basis.T @ residual))
    return bound / float(np.linalg.norm(nuisance.weighing.weight))


# By Pinocchio --------------------------------------------------------------------------------

MAX_POSTURES = 500
"""Larger sets of postures are sampled at random: closing one takes half a millisecond."""

TCP_LIMIT = 1e-9
"""Metres: a thousandth of any instrument's resolution, a million times rounding."""

SENSITIVITY_LIMIT = 1e-6
"""Relative difference of derivatives: without effect on a fit, but far above rounding."""

SMALLEST_SCALE = 1e-3
"""Metres a metre: derivatives of smaller outputs are compared by absolute difference."""


def verify(estimate: Estimate) -> Verification:
    """Return the comparison of a fit's postures with those that Pinocchio closes.

    Raises:
        ClosureError: where Pinocchio does not close a posture that the engine closed.
        CrossCheckError: where TCP or sensitivities differ by more than the limits.
    """
    travel, displacements = _postures(estimate)
    if len(travel) > MAX_POSTURES:
        sample = np.random.default_rng(0).choice(len(travel), MAX_POSTURES, replace=False)
        travel, displacements = travel[sample], displacements[sample]
    engine = estimate.problem.machine.model.engine
    reference = PinocchioEngine(engine.mechanism)
    outputs, tangent = engine.tangent(travel, displacements)
    expected, expected_tangent = reference.tangent(travel, displacements)
    scale = np.abs(expected_tangent).max(axis=2, initial=SMALLEST_SCALE)
    difference = np.abs(tangent - expected_tangent).max(axis=2, initial=0.0)
    sensitivity = float((difference / scale).max(initial=0.0))
    tcp = float(np.linalg.norm(outputs.p - expected.p, axis=1).max(initial=0.0))
    if not (tcp <= TCP_LIMIT and sensitivity <= SENSITIVITY_LIMIT):
        raise CrossCheckError(
            f"six bars and Pinocchio disagree by {tcp * 1e3:.3g} mm of the TCP and "
            f"{sensitivity:.3g} of a sensitivity: do not use these values, and report the campaign",
            difference=tcp,
        )
    return Verification(reference.largest_residual, tcp, sensitivity, len(travel))


def _postures(estimate: Estimate) -> tuple[Array, Array]:
    """Return travel ``(n, 3)`` and displacements ``(n, 30)`` of a fit's distinct postures."""
    problem, travel, displacements = estimate.problem, list[Array](), list[Array]()
    model = problem.machine.model
    for k, factor in enumerate(problem.factors):
        values = problem.values(k, estimate.x)
        conditions, _ = factor.postures(model, values)
        travel.append(conditions.command - model.geometry.zero)
        displacements.append(model.loaded_displacements(values, conditions))
    return np.concatenate(travel), np.concatenate(displacements)
