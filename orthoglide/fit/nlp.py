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
from orthoglide.mechanism.symbolic_closure import closure_functions
from orthoglide.prediction import Model

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-9,
    "ipopt.constr_viol_tol": 1e-9,
    "ipopt.acceptable_tol": 1e-6,  # where rounding keeps it from more; what it is worth we check
    "ipopt.acceptable_iter": 4,
    "ipopt.max_iter": 200,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.mu_init": 1e-9,
    "ipopt.bound_push": 1e-9,
    "ipopt.bound_frac": 1e-9,
    "ipopt.warm_start_init_point": "yes",
}
# Up to here one flat expression is built as fast as a mapped one, and evaluates ten times faster.
_MAX_EXPANDED_POSTURES = 64


@dataclass(frozen=True)
class NlpResult:
    """What the solver says; to be checked, not believed."""

    x: Array  # unknowns (P,), SI
    closure: float  # largest closure residual left, metres or radians
    iterations: int  # of IPOPT


class Nlp:
    """The programme of one problem; built once, solved for as many sets of readings as wanted.

    Args:
        problem: its structure, noise and priors are built in; its readings are not.
        nuisance: columns frozen for the fit.
        scale: of the unknowns ``(P,)``, SI: what the readings would leave of each alone.
    """

    def __init__(self, problem: Problem, nuisance: Nuisances, scale: Array) -> None:
        self._unknown_scale = scale
        self._length_unit = float(np.median(problem.sigma))  # of readings, datums and closures
        self._angle_unit = self._length_unit / problem.machine.geometry.L  # of angles
        # Distinct postures of each factor, and where its rows (or points) find theirs.
        model, tree = problem.machine.model, problem.machine.model.mechanism.tree
        self._postures = [
            model.merged(f.conditions(), [*problem.elementary_parameters(k)[0], *problem.held[k]])
            for k, f in enumerate(problem.factors)
        ]
        self._closure_functions = closure_functions(tree)
        self.postures = sum(len(conditions) for conditions, _ in self._postures)
        x = ca.MX.sym("x", len(problem.unknowns))
        joints = ca.MX.sym("joints", 21, self.postures)
        z = ca.MX.sym("z", nuisance.count)
        measured = ca.MX.sym("measured", len(problem.measured))
        closure, predicted = self._symbolic_model(
            problem, x * self._unknown_scale, joints * self._angle_unit
        )
        known = nuisance.precision > 0
        columns = np.full(nuisance.count, self._length_unit)
        columns[known] = nuisance.precision[known] ** -0.5
        fitted = predicted + ca.DM(nuisance.columns * columns) @ z
        left = _whitened(measured - fitted, nuisance.weighing)
        matrix, target = problem.prior_rows
        prior = ca.DM(matrix * self._unknown_scale) @ x - ca.DM(target)
        placed = z * (columns * np.sqrt(nuisance.precision))
        cost = (ca.sumsqr(left) + ca.sumsqr(prior) + ca.sumsqr(placed)) / 2
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
        """Closures of all postures, and predicted rows of all factors, as MX."""
        model = problem.machine.model
        closures, rows, first = [], [], 0
        each = zip(problem.factors, self._postures, strict=True)
        for k, (factor, (conditions, place)) in enumerate(each):
            count = len(conditions)
            values = _values(problem, k, x)
            theta = ca.vertcat(*[values.get(n, ca.MX(0)) for n in model.catalogue.parameters])
            displacement = model.displacement_model.function.map(
                "displacements", "serial", count, [0, 1], []
            )
            moves = displacement(
                ca.DM(model.displacement_model.dimensions),
                theta,
                ca.DM(model.condition_vectors(conditions).T),
            )
            travel = ca.DM((conditions.command - model.geometry.zero).T)
            given = ca.vertcat(travel, moves)
            own = joints[:, first : first + count]
            closures.append(self._closure_functions.residual.map(count)(own, given))
            outputs = self._closure_functions.outputs.map(count)(own, given)
            rows.append(_rows(model, factor, ca.vec(outputs), place, values))
            first += count
        return ca.horzcat(*closures), ca.vertcat(*rows)

    def solve(self, measured: Array, x: Array, joints: Array | None = None) -> NlpResult:
        """Fit the readings.

        Args:
            measured: all readings ``(n,)``, metres.
            x: where to start ``(P,)``, SI.
            joints: free joints to start from ``(K, 21)``; the assembled neutral where absent.

        Raises:
            SolverError: where IPOPT itself says that it failed.
        """
        count = 21 * self.postures
        angles = np.zeros(count) if joints is None else joints.ravel() / self._angle_unit
        nuisances = np.zeros(len(self._upper) - len(x) - count)
        answer = self._solver(
            x0=np.concatenate([x / self._unknown_scale, angles, nuisances]),
            p=measured,
            lbx=-self._upper,
            ubx=self._upper,
            lbg=0,
            ubg=0,
        )
        stats = self._solver.stats()
        status = str(stats["return_status"])
        found = answer["x"].full().ravel()
        closure = float(np.abs(answer["g"].full()).max(initial=0.0)) * self._length_unit
        if not stats["success"]:
            raise SolverError(
                f"the programme did not converge (IPOPT: {status}); check the readings, or free "
                f"fewer parameters",
                evidence={"status": status, "closure": closure},
            )
        return NlpResult(found[: len(x)] * self._unknown_scale, closure, int(stats["iter_count"]))

    def start_joints(self, problem: Problem, x: Array) -> Array:
        """Free joints ``(K, 21)`` with which Pinocchio closes every posture at ``x``."""
        model = problem.machine.model
        free, found = model.mechanism.tree.free, []
        for k, (conditions, _) in enumerate(self._postures):
            moves = model.displacements(problem.values(k, x), conditions).reshape(-1, 3, 10)
            for command, displacements in zip(conditions.command, moves, strict=True):
                found.append(model.mechanism.close(command, displacements).q[free])
        return np.array(found)


def _whitened(rows: Any, weighing: Weighing) -> Any:
    """Rows ``(n, 1)`` as MX in units of their noise."""
    n, station = len(weighing.station), weighing.station
    shared = np.flatnonzero(np.bincount(station)[station] > 1)
    if not weighing.common[shared].any():
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


def _rows(model: Model, factor: Factor, outputs: Any, place: Any, values: Any) -> Any:
    """Readings ``(n, 1)`` of a factor, as MX.

    Args:
        model: of the machine.
        factor: the readings.
        outputs: of all its postures, one behind the other ``(48 m, 1)``, as MX.
        place: posture of every condition ``(N,)``.
        values: all parameters of machine and instruments, as MX.
    """
    observed = factor.measurement_model
    n, second = len(factor.readings), np.array(place[: len(factor.readings)])
    second[observed.paired] = place[n:]
    start = {"pose": observed.first_output + OUTPUT_SIZE * place[:n], "other": OUTPUT_SIZE * second}
    found, order = [], []
    for part in observed.by_kind(model, {}):
        k, count = part.rows, len(part.rows)

        def poses(which: str, k: Any = k, count: int = count) -> Any:
            flat = (start[which][k, None] + np.arange(POSE_SIZE)).ravel()
            return ca.reshape(outputs[flat.tolist()], POSE_SIZE, count)

        width = part.effect_parameters.shape[1]
        by_setup = []
        for names in part.parameter_names:
            own = [values.get(name, ca.MX(0)) for name in names]
            by_setup.append(ca.vertcat(*own, *(ca.MX(0) for _ in range(width - len(own)))))
        effects = ca.horzcat(*by_setup)[:, factor.setup[k].tolist()]
        given = ca.DM(part.mounting_values.T), ca.DM(part.nuisance.T), effects
        reading = part.formula.function.map(count)(poses("pose"), poses("other"), *given)
        found.append(reading.T)
        order.append(k)
    behind = np.argsort(np.concatenate(order))
    return ca.vertcat(*found)[behind.tolist()]
