"""Readings with their data faults corrected: values, labels, commands and datums."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from orthoglide.errors import ClosureError
from orthoglide.explanation.faults import (
    DATUM_KINDS,
    MISREADING_KINDS,
    Fault,
    Rows,
    factors_and_rows,
    setups_of,
    split_by_datum,
)
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.prediction import MeasurementModel

COMMAND_UNIT = 1e-3  # metres: mistyped commands are seldom off by less than a millimetre


def with_faults_corrected(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with data faults corrected and an unchanged number of rows.

    Of misread rows, those whose true reading is lost (of a stuck dial, or at the end of a list that
    is shifted by a line) get zero weight. All other rows keep their weight.
    """
    # A moved datum splits a setup, so misreadings of whole setups are corrected first.
    for fault in sorted(faults, key=lambda f: f.kind not in MISREADING_KINDS):
        problem = _with_fault_corrected(problem, fault)
    return problem


def with_faults_accounted_for(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with data faults corrected, and with zero weight of the readings that no
    correction restores.

    Wrong commands are corrected nevertheless, because the approach of the next rows depends on
    them.
    """
    problem = with_faults_corrected(problem, faults)
    for fault in faults:
        if fault.excluded:
            problem = without_weight(problem, fault.rows)
    return problem


def _with_fault_corrected(problem: Problem, fault: Fault) -> Problem:
    match fault.kind:
        case "command":
            return _with_tables_changed(problem, fault, _with_command_corrected)
        case "noisy":
            return _with_larger_noise(problem, fault)
        case _ if fault.kind in DATUM_KINDS:
            return _with_tables_changed(problem, fault, _with_datums_split)
        case _ if fault.relabels:
            return _with_tables_changed(problem, fault, _with_labels_corrected)
    measured, lost = corrected_readings(problem, fault)
    problem = _with_readings(problem, measured)
    if len(lost):
        problem = without_weight(problem, lost)
    return _with_rate_free(problem, fault) if fault.kind == "drifted" else problem


def corrected_readings(problem: Problem, fault: Fault) -> tuple[Array, Rows]:
    """Return the readings with a fault of their values corrected ``(n,)``, and the rows of which
    the true reading is lost.
    """
    rows, measured, lost = fault.rows, problem.measured.copy(), fault.rows[:0]
    match fault.kind:
        case "exchanged_labels" if not fault.relabels:  # of equally many rows: exchange readings
            measured[rows] = measured[np.roll(rows, len(rows) // 2)]
        case "stuck":
            lost = rows
        case "shifted":  # entered one line too late or too early
            late = fault.size > 0
            measured[rows] = measured[np.roll(rows, -1 if late else 1)]
            lost = rows[[-1 if late else 0]]
        case "turns" | "drifted":
            measured[rows] -= np.array(fault.sizes)
        case "sign" | "unit":
            measured[rows] *= fault.size
    return measured, lost


def _with_larger_noise(problem: Problem, fault: Fault) -> Problem:
    """Return the problem with the noise of a fault's rows multiplied by its size."""
    scale, factors = np.ones(len(problem.measured)), []
    scale[fault.rows] = fault.size
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        noise = factor.noise.enlarged(scale[part])
        source = np.where(scale[part] > 1, "residuals", noise.source)
        factors.append(replace(factor, noise=replace(noise, source=source)))
    return replace(problem, factors=tuple(factors))


def _with_rate_free(problem: Problem, fault: Fault) -> Problem:
    """Return the problem with the rate of a drift free, as the subtracted one is an estimate."""
    factors, (k, _) = list(problem.factors), factors_and_rows(problem, fault.rows)[0]
    (setup,) = setups_of(problem, fault)
    name = problem.setups[setup].name
    factors[k] = replace(factors[k], drifting=(*factors[k].drifting, name))
    return replace(problem, factors=tuple(factors))


def with_exact_size(problem: Problem, x: Array, fault: Fault, change: Array) -> Fault:
    """Return a wrong command with the size that changes its readings as the linear model says;
    unchanged, if the machine does not reach it.

    Millimetres are far from linear: at zero travel a command moves the dials on its own leg to
    second order only.

    Args:
        problem: the readings, with the command as written.
        x: values of its unknowns ``(P,)``, SI.
        fault: the wrong command with the size of the linear model.
        change: of its readings in that model ``(k,)``, metres.
    """
    k, _ = factors_and_rows(problem, fault.rows)[0]
    rows, values = fault.rows - problem.factor_rows[k].start, problem.values(k, x)

    def predicted(size: float) -> Array:
        corrected = with_faults_corrected(problem, [replace(fault, size=size)])
        model = MeasurementModel(corrected.campaigns[k].subset(rows))
        return model.predict(problem.machine.model, values)

    wanted = predicted(0.0) + change
    try:
        found = least_squares(lambda size: predicted(size[0]) - wanted, fault.size, xtol=1e-12,
                              ftol=1e-12, gtol=None, x_scale=COMMAND_UNIT)  # fmt: skip
    except ClosureError:  # the linear size is not reached
        return fault
    return replace(fault, size=float(found.x[0])) if found.success else fault


def _with_readings(problem: Problem, measured: Array) -> Problem:
    pairs = zip(problem.factors, problem.factor_rows, strict=True)
    return replace(problem, factors=tuple(f.with_readings(measured[part]) for f, part in pairs))


def without_weight(problem: Problem, rows: Rows | NDArray[np.bool_]) -> Problem:
    """Return the problem with zero weight of some readings."""
    zero_weight = np.zeros(len(problem.measured), dtype=bool)
    zero_weight[rows] = True
    pairs = zip(problem.factors, problem.factor_rows, strict=True)
    return replace(problem, factors=tuple(f.without_weight(zero_weight[part]) for f, part in pairs))


def _with_tables_changed(
    problem: Problem, fault: Fault, change: Callable[[Readings, Fault, Rows], Readings]
) -> Problem:
    """Return the problem with each table changed that contains rows of a fault."""
    factors = list(problem.factors)
    for k, part in enumerate(problem.factor_rows):
        rows = fault.rows[(fault.rows >= part.start) & (fault.rows < part.stop)] - part.start
        if len(rows):
            factors[k] = factors[k].with_table(change(factors[k].readings, fault, rows))
    return replace(problem, factors=tuple(factors))


def _with_command_corrected(table: Readings, fault: Fault, rows: Rows) -> Readings:
    """Return the table with another command in some rows, and the approach derived again."""
    command = table.command.copy()
    command[rows, fault.drive] += fault.size
    corrected = replace(table, command=command)
    derived = table.approach == table.derived_approach
    approach = np.where(derived, corrected.derived_approach, table.approach)
    return replace(corrected, approach=approach)


def _with_datums_split(table: Readings, fault: Fault, rows: Rows) -> Readings:
    """Return the table with a setup of its own for the rows of each datum."""
    for part in split_by_datum(fault.kind, rows, table.setup, table.repeat):
        number = table.setup[part[0]]
        if len(part) == np.sum(table.setup == number):
            continue
        names = {s.name for s in table.setups}
        name = f"{table.setups[number].name}-from-line-{int(table.line[part].min())}"
        while name in names:
            name += "-again"
        setup = table.setup.copy()
        # A datum that moved later in the table may have split off some of these rows already.
        setup[part[setup[part] == number]] = len(table.setups)
        added = replace(table.setups[number], name=name)
        table = replace(table, setups=(*table.setups, added), setup=setup)
    return table


def _with_labels_corrected(table: Readings, fault: Fault, rows: Rows) -> Readings:
    """Return the table with another leg and axis of a setup, with the labels of two setups
    exchanged, or with the axes of a level exchanged.
    """
    if table.angular[rows[0]]:
        axis = table.axis.copy()
        axis[rows] = 1 - axis[rows]
        return replace(table, axis=axis)
    setups = list(table.setups)
    numbers = np.unique(table.setup[rows]).tolist()
    if fault.kind == "label":
        leg, direction = fault.label
        labels = [replace(setups[k], leg=leg, axis=direction) for k in numbers]
    else:
        labels = [setups[k] for k in reversed(numbers)]
    for k, label in zip(numbers, labels, strict=True):
        setups[k] = replace(label, name=setups[k].name)
    return replace(table, setups=tuple(setups))
