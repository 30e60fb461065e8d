"""The identification as one nonlinear programme (CasADi, IPOPT).

Variables are the unknowns, the free joints of every distinct posture, and the nuisances; every
posture's 21 loop closures are equality constraints. Everything is scaled to the noise of the
readings, so that one tolerance suits all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.errors import SolverError
from orthoglide.fit.factors import Factor
from orthoglide.fit.least_squares import Nuisances
from orthoglide.fit.problem import Problem
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array
from orthoglide.instruments import POSE_SIZE
from orthoglide.mechanism.six_bars import OUTPUT_SIZE
from orthoglide.mechanism.symbolic import closure_functions
from orthoglide.prediction import Model

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


@dataclass(frozen=True)
class NlpResult:
    """The solver's answer, not checked yet."""

    x: Array  # unknowns (P,), SI
    closure: float  # largest closure residual, metres or radians
    iterations: int  # of IPOPT


class Nlp:
    """The programme of one problem; built once, solved for any number of sets of readings.

    Args:
        problem: its structure, noise and priors are built in; its readings are not.
        nuisance: columns frozen for the fit.
        scale: of the unknowns ``(P,)``, SI: standard deviation of each alone.
    """

    def __init__(self, problem: Problem, nuisance: Nuisances, scale: Array) -> None:
        self._unknown_scale = scale
        self._length_unit = float(np.median(problem.sigma))  # of readings, datums and closures
        self._angle_unit = self._length_unit / problem.machine.geometry.L  # of angles
        model = problem.machine.model
        # Distinct conditions of each factor, and both postures of each reading.
        self._postures = [
            factor.postures(model, [*problem.elementary_parameters(k)[0], *problem.held[k]])
            for k, factor in enumerate(problem.factors)
        ]
        self._closure_functions = closure_functions(model.mechanism.tree)
        self.postures = sum(len(conditions) for conditions, _ in self._postures)
        x = ca.MX.sym("x", len(problem.unknowns))
        joints = ca.MX.sym("joints", 21, self.postures)
        z = ca.MX.sym("z", nuisance.count)
        measured = ca.MX.sym("measured", len(problem.measured))
        closure, predicted = self._symbolic_model(
            problem, x * self._unknown_scale, joints * self._angle_unit
        )
        has_prior = nuisance.precision > 0
        columns = np.full(nuisance.count, self._length_unit)
        columns[has_prior] = nuisance.precision[has_prior] ** -0.5
        fitted = predicted + ca.DM(nuisance.columns * columns) @ z
        residual = _whitened(measured - fitted, nuisance.weighing)
        matrix, target = problem.prior_rows
        prior = ca.DM(matrix * self._unknown_scale) @ x - ca.DM(target)
        scaled_nuisances = z * (columns * np.sqrt(nuisance.precision))
        cost = (ca.sumsqr(residual) + ca.sumsqr(prior) + ca.sumsqr(scaled_nuisances)) / 2
        programme = {
            "x": ca.vertcat(x, ca.vec(joints), z),
            "p": measured,
            "f": cost,
            "g": ca.vec(closure) / self._length_unit,
        }
        options = {**_OPTIONS, "expand": self.postures <= _MAX_EXPANDED_POSTURES}
        self._solver = ca.nlpsol("identify", "ipopt", programme, options)
        free = np.full(21 * self.postures + nuisance.count, np.inf)
        self._upper = np.concatenate([problem.bound / scale, free])

    def _symbolic_model(self, problem: Problem, x: Any, joints: Any) -> tuple[Any, Any]:
        """Return closures of all postures, and predicted rows of all factors, as MX."""
        model, functions = problem.machine.model, self._closure_functions
        map_, sizes = model.displacement_model.function.map, model.displacement_model.dimensions
        closures, rows, first = [], [], 0
        for k, (conditions, posture) in enumerate(self._postures):
            count, values = len(conditions), _values(problem, k, x)
            theta = ca.vertcat(*[values.get(n, ca.MX(0)) for n in model.catalogue.parameters])
            vectors = ca.DM(model.condition_vectors(conditions).T)
            displacement = map_("displacements", "serial", count, [0, 1], [])
            travel = ca.DM((conditions.command - model.geometry.zero).T)
            given = ca.vertcat(travel, displacement(ca.DM(sizes), theta, vectors))
            own_joints = joints[:, first : first + count]
            closures.append(functions.residual.map(count)(own_joints, given))
            outputs = ca.vec(functions.outputs.map(count)(own_joints, given))
            rows.append(_rows(model, problem.factors[k], outputs, posture, values))
            first += count
        return ca.horzcat(*closures), ca.vertcat(*rows)

    def solve(self, measured: Array, x: Array, joints: Array | None = None) -> NlpResult:
        """Return IPOPT's fit to the readings.

        Args:
            measured: all readings ``(n,)``, metres.
            x: initial values ``(P,)``, SI.
            joints: initial free joints ``(K, 21)``; the assembled neutral where absent.

        Raises:
            SolverError: where IPOPT reports a failure.
        """
        count = 21 * self.postures
        angles = np.zeros(count) if joints is None else joints.ravel() / self._angle_unit
        nuisances = np.zeros(len(self._upper) - len(x) - count)
        x0 = np.concatenate([x / self._unknown_scale, angles, nuisances])
        answer = self._solver(x0=x0, p=measured, lbx=-self._upper, ubx=self._upper, lbg=0, ubg=0)
        stats = self._solver.stats()
        status = str(stats["return_status"])
        closure = float(np.abs(answer["g"].full()).max(initial=0.0)) * self._length_unit
        if not stats["success"]:
            raise SolverError(
                f"the programme did not converge (IPOPT: {status}); check the readings, or free "
                f"fewer parameters",
                evidence={"status": status, "closure": closure},
            )
        solution = answer["x"].full().ravel()[: len(x)] * self._unknown_scale
        return NlpResult(solution, closure, int(stats["iter_count"]))

    def start_joints(self, problem: Problem, x: Array) -> Array:
        """Return free joints ``(K, 21)`` with which Pinocchio closes every posture at ``x``."""
        model, joints = problem.machine.model, []
        for k, (conditions, _) in enumerate(self._postures):
            displacements = model.displacements(problem.values(k, x), conditions)
            for command, row in zip(conditions.command, displacements, strict=True):
                posture = model.mechanism.close(command, row.reshape(3, 10))
                joints.append(posture.q[model.mechanism.tree.free])
        return np.array(joints)


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
    """Return the predicted readings ``(n, 1)`` of a factor, as MX.

    Args:
        model: of the machine.
        factor: the readings.
        outputs: of all its postures, one behind the other ``(48 m, 1)``, as MX.
        posture: first and second posture of every reading ``(2, n)``.
        values: all parameters of machine and instruments, as MX.
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
