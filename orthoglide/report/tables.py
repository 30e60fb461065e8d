"""Files of a result for programs: ``calibrated.toml``, ``residuals.csv`` and ``result.json``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide import __version__
from orthoglide.geometry import LEGS
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.columns import native_command_names
from orthoglide.report.sentences import headline
from orthoglide.result import Result
from orthoglide.text import csv_text

_VALUE_COLUMNS = (
    "reading_{}", "sigma_{}",
    "predicted_nominal_{}", "predicted_before_{}", "predicted_after_{}",
    "residual_nominal_{}", "residual_before_{}", "residual_after_{}",
)  # fmt: skip
_IN_MM, _IN_MRAD = (tuple(name.format(unit) for name in _VALUE_COLUMNS) for unit in ("mm", "mrad"))


def calibrated_machine(result: Result) -> MachineFile:
    """Return the calibrated machine file with the provenance of its numbers."""
    request, spec = result.request, result.machine.spec
    given, read = request.machine.spec, [i for i in request.inputs if "role" not in i]
    machine = {"file": Path(given.file).name, "sha256": given.sha256}
    provenance: dict[str, Any] = {
        "version": __version__,
        "command": request.command,
        "campaigns": [{"file": i["file"], "sha256": i["sha256"]} for i in read],
        **({"machine": machine} if given.file else {}),
        **spec.provenance,
        "sigma": "everything else allowed" if result.searches else "noise alone",
    }
    name = "Orthoglide, calibrated" if spec.name == MachineFile.name else spec.name
    return replace(spec, name=name, provenance=provenance)


def residual_table(result: Result) -> str:
    """Return the text of ``residuals.csv``: nominal, before and after; excluded rows last.

    Figures of inclinations have columns of their own, where any were read.
    """
    given, shown = result.request.given, result.readings
    predicted, turned = (shown.nominal, shown.before, shown.after), shown.turned
    columns = [shown.measured, shown.sigma, *predicted, *(shown.measured - p for p in predicted)]
    figures, rows = np.column_stack(columns), list[list[Any]]()
    none, several = [""] * len(_VALUE_COLUMNS), bool(turned.any())
    both = any(s.observation.dials > 1 for read in given for s in read.setups)
    directions = [read.direction for read in given]
    places = zip(shown.file.tolist(), shown.row.tolist(), shown.setups, strict=True)
    for k, (file, row, name) in enumerate(places):
        read, cells = given[file], [*map(_mm, figures[k])]
        kind = read.setups[read.setup[row]].kind
        mm, mrad = (none, cells) if turned[k] else (cells, none)
        place = _reading_cells(read, row, name, directions[file][row], both)
        rows.append([*place, *mm, "", kind, *(mrad if several else ())])
    for blunder in result.blunders:
        for file, row in blunder.rows_in_request if blunder.excluded else ():
            read = given[file]
            setup = read.setups[read.setup[row]]
            cells = [_mm(read.reading[row]), *none[1:]]
            mm, mrad = (none, cells) if setup.observation.angular else (cells, none)
            name = "" if read.by_point else setup.name
            place = _reading_cells(read, row, name, directions[file][row], both)
            rows.append([*place, *mm, blunder.kind, setup.kind, *(mrad if several else ())])
    titles = (
        "campaign", "line", "setup", "leg", "direction", "posture",
        *native_command_names(result.machine.geometry.layout.names),
        "gauge_mm", *(("gauge2_mm",) if both else ()), "repeat", "order",
    )  # fmt: skip
    last = ("set_aside", "kind", *(_IN_MRAD if several else ()))
    return csv_text((*titles, *_IN_MM, *last), rows)


def _reading_cells(read: Readings, row: int, name: str, direction: str, both: bool) -> list[Any]:
    """Return the cells that say what was read where.

    Args:
        read: the readings.
        row: within them.
        name: of the setup.
        direction: axis that is read, with its sign.
        both: whether there are columns of two dials on a leg.
    """
    setup = read.setups[read.setup[row]]
    leg, gauge = (LEGS[setup.leg], _mm(setup.gauge)) if setup.leg >= 0 else ("", "")
    second = [_mm(setup.gauge2) if setup.observation.dials > 1 else ""] if both else []
    return [
        read.name, read.line[row], name, leg, direction, read.posture[row],
        *map(_mm, read.command[row]), gauge, *second,
        "" if read.by_point else read.repeat[row],
        read.order[row] + read.by_point,
    ]  # fmt: skip


def _mm(metres: float) -> str:
    """Return millimetres to a nanometre, or milliradians to a nanoradian; further digits are
    rounding.
    """
    return f"{metres * 1e3:z.6f}"


def result_text(result: Result) -> str:
    """Return the text of ``result.json``: the same bytes for the same result."""
    return f"{_json_text(result.as_dict(headline(result)))}\n"


def _json_text(value: Any, margin: str = "") -> str:
    """Return JSON with a line for each key and element.

    A list of numbers or words is one line, as is an object of them that is an element of a list,
    such as a row of readings; the encoder of the standard library is slow where it indents.
    """
    inner = f"{margin} "
    if isinstance(value, dict) and value:
        each = (f"{inner}{json.dumps(key)}: {_json_text(one, inner)}" for key, one in value.items())
        return "{\n" + ",\n".join(each) + f"\n{margin}}}"
    if _is_flat(value):
        return _json_line(value)
    each = (inner + (_json_line(one) if _is_flat(one) else _json_text(one, inner)) for one in value)
    return "[\n" + ",\n".join(each) + f"\n{margin}]"


def _json_line(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


_CONTAINERS = frozenset({dict, list})


def _is_flat(value: Any) -> bool:
    """Whether a value contains no list or object with anything in it."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if _CONTAINERS.isdisjoint(map(type, parts)):  # which is quicker, of many numbers
        return True
    return not any(isinstance(part, dict | list) and part for part in parts)
