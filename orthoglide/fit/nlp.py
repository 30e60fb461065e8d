"""The identification as one nonlinear programme (CasADi, IPOPT).

Variables are the unknowns, the free joints of every distinct posture, and the nuisances; every
posture's 21 loop closures are equality constraints. Everything is scaled to the noise of the
readings, so that one tolerance suits all.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import SolverError
from orthoglide.fit.factors import Factor
from orthoglide.fit.least_squares import NormalEquations, Nuisances
from orthoglide.fit.noise import Weighing
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array
from orthoglide.instruments import POSE_SIZE
from orthoglide.mechanism.six_bars import OUTPUT_SIZE
from orthoglide.mechanism.symbolic import closure_functions
from orthoglide.prediction import Conditions, Model

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-9,
    "ipopt.constr_viol_tol": 1e-9,
    "ipopt.acceptable_tol": 1e-6,  # where rounding prevents more; the answer is checked
    "ipopt.acceptable_iter": 4,
    "ipopt.max_iter": 200,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.mu_init": 1e-9,
    "ipopt.bound_push": 1e-9,
    "ipopt.bound_frac": 1e-9,
    "ipopt.warm_start_init_point": "yes",
}
# Up to this number a flat expression is built as fast as a mapped one, and evaluates ten times
# faster.
_MAX_EXPANDED_POSTURES = 64


Postures = list[tuple[Conditions, NDArray[np.intp]]]
"""For each factor, its distinct conditions, and both postures of each reading among them."""


def solve_programme(
    problem: Problem, nuisance: Nuisances, initial: NormalEquations
) -> tuple[Array, int]:
    """Return IPOPT's answer ``(P,)``, SI, not checked yet, and its number of iterations from the
    ``initial`` values.

    Raises:
        SolverError: where IPOPT reports a failure.
    """
    model, scale = problem.machine.model, initial.single_sd
    length_unit = float(np.median(problem.sigma))  # of readings, datums and closures
    angle_unit = length_unit / problem.machine.geometry.L
    postures = [
        factor.postures(model, [*problem.elementary_parameters(k)[0], *problem.held[k]])
        for k, factor in enumerate(problem.factors)
    ]
    start = _closed_joints(problem, postures, initial.x)
    x, z = ca.MX.sym("x", len(scale)), ca.MX.sym("z", nuisance.count)
    joints = ca.MX.sym("joints", 21, len(start))
    closure, predicted = _symbolic_model(problem, postures, x * scale, joints * angle_unit)
    programme = {
        "x": ca.vertcat(x, ca.vec(joints), z),
        "f": _cost(problem, nuisance, x * scale, z, predicted),
        "g": ca.vec(closure) / length_unit,
    }
    options = {**_OPTIONS, "expand": len(start) <= _MAX_EXPANDED_POSTURES}
    solver = ca.nlpsol("identify", "ipopt", programme, options)
    upper = np.concatenate([problem.bound / scale, np.full(start.size + nuisance.count, np.inf)])
    x0 = np.concatenate([initial.x / scale, start.ravel() / angle_unit, np.zeros(nuisance.count)])
    answer = solver(x0=x0, lbx=-upper, ubx=upper, lbg=0, ubg=0)
    stats = solver.stats()
    if not stats["success"]:
        status = str(stats["return_status"])
        closure_residual = float(np.abs(answer["g"].full()).max(initial=0.0)) * length_unit
        raise SolverError(
            f"the programme did not converge (IPOPT: {status}); check the readings, or free "
            f"fewer parameters",
            evidence={"status": status, "closure": closure_residual},
        )
    return answer["x"].full().ravel()[: len(scale)] * scale, int(stats["iter_count"])


def _closed_joints(problem: Problem, postures: Postures, x: Array) -> Array:
    """Return free joints ``(K, 21)`` with which Pinocchio closes every posture at ``x``."""
    model, joints = problem.machine.model, []
    for k, (conditions, _) in enumerate(postures):
        displacements = model.displacements(problem.values(k, x), conditions)
        for command, row in zip(conditions.command, displacements, strict=True):
            posture = model.mechanism.close(command, row.reshape(3, 10))
            joints.append(posture.q[model.mechanism.tree.free])
    return np.array(joints)


def _symbolic_model(problem: Problem, postures: Postures, x: Any, joints: Any) -> tuple[Any, Any]:
    """Return closures of all postures, and predicted rows of all factors, as MX."""
    model = problem.machine.model
    residual, posture_outputs = closure_functions(model.mechanism.tree)
    map_, sizes = model.displacement_model.function.map, model.displacement_model.dimensions
    closures, rows, first = [], [], 0
    for k, (conditions, posture) in enumerate(postures):
        count, values = len(conditions), _values(problem, k, x)
        theta = ca.vertcat(*[values.get(n, ca.MX(0)) for n in model.catalogue.parameters])
        vectors = ca.DM(model.condition_vectors(conditions).T)
        displacement = map_("displacements", "serial", count, [0, 1], [])
        travel = ca.DM((conditions.command - model.geometry.zero).T)
        given = ca.vertcat(travel, displacement(ca.DM(sizes), theta, vectors))
        own_joints = joints[:, first : first + count]
        closures.append(residual.map(count)(own_joints, given))
        outputs = ca.vec(posture_outputs.map(count)(own_joints, given))
        rows.append(_rows(model, problem.factors[k], outputs, posture, values))
        first += count
    return ca.horzcat(*closures), ca.vertcat(*rows)


def _cost(problem: Problem, nuisance: Nuisances, x: Any, z: Any, predicted: Any) -> Any:
    """Return half the sum of squares of residuals, priors and nuisances, as MX; the nuisances ``z``
    are in units of their priors, or of the noise.
    """
    has_prior = nuisance.precision > 0
    units = np.full(nuisance.count, float(np.median(problem.sigma)))
    units[has_prior] = nuisance.precision[has_prior] ** -0.5
    residual = ca.DM(problem.measured) - predicted - ca.DM(nuisance.columns * units) @ z
    matrix, target = problem.prior_rows
    prior = ca.DM(matrix) @ x - ca.DM(target)
    scaled_nuisances = z * (units * np.sqrt(nuisance.precision))
    whitened = _whitened(residual, nuisance.weighing)
    return (ca.sumsqr(whitened) + ca.sumsqr(prior) + ca.sumsqr(scaled_nuisances)) / 2


def _whitened(rows: Any, weighing: Weighing) -> Any:
    """Return rows ``(n, 1)``, as MX, in units of their noise."""
    n, station = len(weighing.station), weighing.station
    repeated = np.flatnonzero(np.bincount(station)[station] > 1)
    if not weighing.common[repeated].any():
        return rows * np.sqrt(weighing.weight**-2 + weighing.common**2) ** -1
    matrix = ca.DM(weighing.whiten(np.eye(n)))
    return ca.sparsify(matrix) @ rows


def _values(problem: Problem, factor: int, x: Any) -> dict[str, Any]:
    """Return all parameters of the machine and dials of a factor as MX."""
    names, matrix = problem.elementary_parameters(factor)
    values = {name: ca.MX(value) for name, value in problem.held[factor].items()}
    free = ca.DM(matrix) @ x
    for k, name in enumerate(names):
        values[name] = values.get(name, 0) + free[k]
    return values


def _rows(model: Model, factor: Factor, outputs: Any, posture: Any, values: Any) -> Any:
    """Return the predicted readings ``(n, 1)`` of a factor, as MX, from the outputs of all its
    postures, one behind the other ``(48 m, 1)``, and the first and second posture of every reading
    ``(2, n)``.
    """
    first, second = OUTPUT_SIZE * posture
    starts = factor.first_output + first, second
    readings, order = [], []
    for kind in factor.by_kind(model, {}):
        count, poses = len(kind.rows), []
        for start in starts:
            flat = (start[kind.rows, None] + np.arange(POSE_SIZE)).ravel()
            poses.append(ca.reshape(outputs[flat.tolist()], POSE_SIZE, count))
        by_setup = []
        for names in kind.parameter_names:
            missing = [ca.MX(0)] * (kind.effect_parameters.shape[1] - len(names))
            by_setup.append(ca.vertcat(*[values.get(n, ca.MX(0)) for n in names], *missing))
        effects = ca.horzcat(*by_setup)[:, factor.setup[kind.rows].tolist()]
        given = ca.DM(kind.mounting_values.T), ca.DM(kind.nuisance.T), effects
        readings.append(kind.formula.function.map(count)(*poses, *given).T)
        order.append(kind.rows)
    inverse_order = np.argsort(np.concatenate(order))
    return ca.vertcat(*readings)[inverse_order.tolist()]
