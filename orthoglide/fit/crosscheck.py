"""Independent checks of a fit: its values by the analytic reduction and the linear system (11), its
postures by Pinocchio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from orthoglide import reduction
from orthoglide.effects import CATALOGUE
from orthoglide.errors import CrossCheckError, SolverError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.factors import Factor
from orthoglide.fit.gauss_newton import solve_nested
from orthoglide.fit.least_squares import (
    Linearised,
    Nuisances,
    covariance,
    linearise,
    normal_equations,
)
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array
from orthoglide.mechanism.engine import PinocchioEngine
from orthoglide.prediction import Model, ReadingPoses
from orthoglide.prediction.measurement_model import LinearRows
from orthoglide.result.fits import CrossCheck, Verification

AGREEMENT = 1e-9
"""Metres: two derivations of one model that disagree by more have an error."""

_BASE_PARAMETERS = tuple(p for name in CATALOGUE.base for p in CATALOGUE[name].parameters())


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedFactor(Factor):
    """Readings of dials on legs as the reduction predicts them."""

    linear: bool  # by system (11), generalised to any readings

    def linearise(
        self, model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> LinearRows:
        """Return the readings with their derivatives by the base parameters of these names."""
        r = self.readings
        base = np.array([values.get(name, 0.0) for name in _BASE_PARAMETERS])
        offsets, lengths = np.split(np.zeros(6) if self.linear else base, 2)
        predicted = reduction.predict_readings(
            r.command, r.leg, r.axis, r.gauge, offsets, lengths, geometry=model.geometry
        )
        value = predicted.values
        if self.linear:
            value = value + predicted.gradient @ base
        columns = [_BASE_PARAMETERS.index(name) for name in names]
        # Dials on legs have no pose to fit.
        unplaced = ReadingPoses(*np.zeros((3, len(r), 0)))
        return LinearRows(
            r.sign * value, r.sign[:, None] * predicted.gradient[:, columns], unplaced
        )


def by_reduction(problem: Problem, *, linear: bool = False) -> Problem:
    """Return a problem with the reduction, or with its linearisation (11), in place of the
    mechanism.
    """
    arguments = [{f.name: getattr(k, f.name) for f in fields(k)} for k in problem.leg_factors]
    return problem.with_leg_factors([ReducedFactor(**a, linear=linear) for a in arguments])


def cross_check(problem: Problem, nuisance: Nuisances, fit: Linearised) -> CrossCheck | None:
    """Return the differences of a fit from the reduction and from system (11), or ``None`` where
    the reduction cannot represent the problem.

    Raises:
        CrossCheckError: where mechanism and reduction disagree by more than 1e-6 mm, or the fit of
            the reduction does not converge.
    """
    if not problem.reduction_applies:
        return None
    # With an unknown on its bound, legs of the nominal machine may not meet.
    start = fit.x if problem.on_bound(fit.x).any() else problem.start
    reduced = by_reduction(problem)
    try:
        x = solve_nested(reduced, nuisance, linearise(reduced, start))[0].x
        difference = float(np.max(np.abs(x - fit.x), initial=0.0))
    except SolverError as error:
        raise CrossCheckError(
            f"the values could not be checked by the reduction: {error}", difference=np.inf
        ) from None
    if not difference <= AGREEMENT:
        raise CrossCheckError(
            f"the mechanism and the reduction disagree by {difference * 1e3:.3g} mm on the same "
            f"readings, so one of them is wrong: do not use these values, and send the campaign to "
            f"the maintainers",
            difference=difference,
        )
    linear = linearise(by_reduction(problem, linear=True), fit.x)
    equations, free = normal_equations(problem, linear, nuisance), ~problem.on_bound(fit.x)
    step_by_gradient, _ = covariance(equations.jacobian[:, free], equations.prior[:, free])
    value = linear.value - linear.jacobian[:, free] @ step_by_gradient @ equations.gradient[free]
    fitted, linear_fitted = (
        rows + nuisance.explained_residual(problem.measured - rows) for rows in (fit.value, value)
    )
    weighing, nonlinearity = nuisance.weighing, fitted - linear_fitted
    norm = np.linalg.norm(weighing.whiten(nonlinearity)) / np.linalg.norm(weighing.weight)
    largest = float(np.abs(nonlinearity).max(initial=0.0))
    bound = _second_order_bound(problem, nuisance, fit, linear)
    return CrossCheck(difference, largest, bound, float(norm))


def _second_order_bound(
    problem: Problem, nuisance: Nuisances, fit: Linearised, linear: Linearised
) -> float:
    """Return an upper bound of the weighted rms difference, metres, between the readings of the
    nonlinear fit and of system (11), both at the solution.

    All vectors are whitened, with the nuisances projected out. With f(x) = J0 x + e and residual q
    of the nonlinear fit, the linear fit is P0 (f + q), P0 the projection on the linear system's
    columns: the difference is (1 - P0) e - P0 q, no longer than |e| + |P0 q|.
    """
    prior = np.diag(1 / problem.prior_sd)
    jacobian = np.vstack([nuisance.project(linear.jacobian), prior])[:, ~problem.on_bound(fit.x)]
    remainder = nuisance.project(fit.value - linear.value)
    residual = nuisance.project(problem.measured - fit.value)
    residual = np.concatenate([residual, -fit.x / problem.prior_sd])
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
"""Least scale in the comparison of derivatives, so that rounding near zero does not count."""


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
            f"{sensitivity:.3g} of a sensitivity: do not use these values, and send the campaign "
            f"to the maintainers",
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
