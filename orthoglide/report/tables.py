"""``calibrated.toml``, ``residuals.csv`` and ``next_measurements.csv``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide import __version__
from orthoglide.geometry import LEGS
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.columns import of_commands
from orthoglide.text import csv_text

if TYPE_CHECKING:
    from orthoglide.result import Result

_FIGURES = (
    "reading_{}", "sigma_{}",
    "predicted_nominal_{}", "predicted_before_{}", "predicted_after_{}",
    "residual_nominal_{}", "residual_before_{}", "residual_after_{}",
)  # fmt: skip
_IN_MM, _IN_MRAD = (tuple(name.format(unit) for name in _FIGURES) for unit in ("mm", "mrad"))


def calibrated_machine(result: Result) -> MachineFile:
    """The machine file to go on with, with where its numbers come from."""
    request, spec = result.request, result.machine.spec
    given, read = request.machine.spec, [i for i in request.inputs if "role" not in i]
    machine = {"file": Path(given.file).name, "sha256": given.sha256}
    provenance: dict[str, Any] = {
        "version": __version__,
        "command": request.command,
        "campaigns": [{"file": i["file"], "sha256": i["sha256"]} for i in read],
        **({"machine": machine} if given.file else {}),
        **spec.provenance,
        "sigma": "noise alone" if result.posterior is None else "everything else allowed",
    }
    name = "Orthoglide, calibrated" if spec.name == MachineFile.name else spec.name
    return replace(spec, name=name, provenance=provenance)


def residual_table(result: Result) -> str:
    """The text of ``residuals.csv``: nominal, before and after; faulty rows last, set aside.

    Figures of inclinations have columns of their own, where any were read.
    """
    problem, base = result.after.problem, result.before
    measured, turned = problem.measured, problem.turned
    predicted = (base.predicted_before, base.predicted, result.after.predicted)
    columns = [measured, problem.sigma, *predicted, *(measured - p for p in predicted)]
    figures, rows = np.column_stack(columns), list[list[Any]]()
    none, several = [""] * len(_FIGURES), bool(turned.any())
    both = any(s.observation.dials > 1 for f in problem.factors for s in f.readings.setups)

    def add(cells: list[Any], row: int, kind: str) -> None:
        shown = [*map(_mm, figures[row])]
        mrad = shown if turned[row] else none
        rows.append(
            [*cells, *(none if turned[row] else shown), "", kind, *(mrad if several else ())]
        )

    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        read = factor.readings
        for k, row in enumerate(range(part.start, part.stop)):
            add(_cells(read, k, both), row, read.setups[read.setup[k]].kind)
    for blunder in result.blunders:
        for place, row in blunder.rows if blunder.sets_aside else ():
            read = result.first.problem.factors[place].readings
            setup = read.setups[read.setup[row]]
            shown = [_mm(read.reading[row]), *none[1:]]
            cells = [*_cells(read, row, both), *(none if setup.observation.angular else shown)]
            mrad = shown if setup.observation.angular else none
            rows.append([*cells, blunder.kind, setup.kind, *(mrad if several else ())])
    places = (
        "campaign", "line", "setup", "leg", "direction", "posture",
        *of_commands(problem.machine.geometry.layout.names),
        "gauge_mm", *(("gauge2_mm",) if both else ()), "repeat", "order",
    )  # fmt: skip
    last = ("set_aside", "kind", *(_IN_MRAD if several else ()))
    return csv_text((*places, *_IN_MM, *last), rows)


def _cells(read: Readings, row: int, both: bool) -> list[Any]:
    """What was read where; ``both`` where there are columns of two dials on a leg."""
    setup = read.setups[read.setup[row]]
    leg, gauge = (LEGS[setup.leg], _mm(setup.gauge)) if setup.leg >= 0 else ("", "")
    second = [_mm(setup.gauge2) if setup.observation.dials > 1 else ""] if both else []
    name = "" if read.by_point else setup.name
    return [
        read.name, read.line[row], name, leg, read.direction[row], read.posture[row],
        *map(_mm, read.command[row]), gauge, *second,
        "" if read.by_point else read.repeat[row],
        read.order[row] + read.by_point,
    ]  # fmt: skip


def _mm(metres: float) -> str:
    """Millimetres to a nanometre, milliradians to a nanoradian: further digits are rounding."""
    return f"{metres * 1e3:z.6f}"
