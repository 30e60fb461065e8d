"""The folder of a result: its files for programs, written whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide import __version__
from orthoglide.errors import FileError
from orthoglide.files import as_file_errors, temporary_path
from orthoglide.geometry import LEGS
from orthoglide.machine_file import MachineFile
from orthoglide.numerals import mm_text
from orthoglide.observations import Readings
from orthoglide.observations.table import native_command_names
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
    original, campaigns = request.machine.spec, [i for i in request.inputs if "role" not in i]
    machine = {"file": Path(original.file).name, "sha256": original.sha256}
    provenance: dict[str, Any] = {
        "version": __version__,
        "command": request.command,
        "campaigns": [{"file": i["file"], "sha256": i["sha256"]} for i in campaigns],
        **({"machine": machine} if original.file else {}),
        **spec.provenance,
        "sigma": "everything else allowed" if result.searches else "noise alone",
    }
    name = "Orthoglide, calibrated" if spec.name == MachineFile.name else spec.name
    return replace(spec, name=name, provenance=provenance)


def residual_table(result: Result) -> str:
    """Return the text of ``residuals.csv``; excluded readings are the last rows.

    Readings that are fitted corrected have the kind of their fault in the last column. Inclinations
    have columns of their own, if any were read.
    """
    tables, shown = result.request.given, result.readings
    predicted = (shown.nominal, shown.before, shown.after)
    columns = [shown.measured, shown.sigma, *predicted, *(shown.measured - p for p in predicted)]
    empty, any_turned = [""] * len(_VALUE_COLUMNS), bool(shown.turned.any())
    two_dials = any(setup.observation.dials > 1 for t in tables for setup in t.setups)
    directions = [readings.direction for readings in tables]
    corrected = {
        file_and_row: fault.kind
        for fault in result.blunders
        for file_and_row in (() if fault.excluded else fault.rows_in_request)
    }

    def cells(file: int, row: int, values: list[str], fault: str = "") -> list[Any]:
        readings = tables[file]
        setup = readings.setups[readings.setup[row]]
        mm, mrad = (empty, values) if setup.observation.angular else (values, empty)
        identity = _reading_cells(readings, row, directions[file][row], two_dials)
        correction = "" if fault else corrected.get((file, row), "")
        return [*identity, *mm, fault, setup.kind, *(mrad if any_turned else ()), correction]

    fitted = zip(shown.file.tolist(), shown.row.tolist(), np.column_stack(columns), strict=True)
    rows = [cells(file, row, [*map(mm_text, values)]) for file, row, values in fitted]
    for fault in result.blunders:
        for file, row in fault.rows_in_request if fault.excluded else ():
            values = [mm_text(tables[file].reading[row]), *empty[1:]]
            rows.append(cells(file, row, values, fault.kind))
    titles = (
        "campaign", "line", "setup", "leg", "direction", "posture",
        *native_command_names(result.machine.geometry.layout.names),
        "gauge_mm", *(("gauge2_mm",) if two_dials else ()), "repeat", "order",
    )  # fmt: skip
    last = ("set_aside", "kind", *(_IN_MRAD if any_turned else ()), "corrected")
    return csv_text((*titles, *_IN_MM, *last), rows)


def _reading_cells(readings: Readings, row: int, direction: str, two_dials: bool) -> list[Any]:
    """Return the cells that identify a reading along a direction; ``two_dials``: whether there are
    columns of two dials on a leg.
    """
    setup = readings.setups[readings.setup[row]]
    name = "" if readings.by_point else setup.name
    leg, gauge = (LEGS[setup.leg], mm_text(setup.gauge)) if setup.leg >= 0 else ("", "")
    second = [mm_text(setup.gauge2) if setup.observation.dials > 1 else ""] if two_dials else []
    return [
        readings.name, readings.line[row], name, leg, direction, readings.posture[row],
        *map(mm_text, readings.command[row]), gauge, *second,
        "" if readings.by_point else readings.repeat[row],
        readings.order[row] + readings.by_point,
    ]  # fmt: skip


def result_text(result: Result) -> str:
    """Return the text of ``result.json``: the same bytes for the same result."""
    return f"{_json_text(result.as_dict(headline(result)))}\n"


def _json_text(value: Any, margin: str = "") -> str:
    """Return JSON with a line for each key and element.

    A list of numbers or words is one line, and so is an element of a list that is an object of
    them, such as a row of readings. The standard library's encoder is slow with indentation.
    """
    inner = f"{margin} "
    if isinstance(value, dict) and value:
        lines = (f"{inner}{json.dumps(k)}: {_json_text(v, inner)}" for k, v in value.items())
        return "{\n" + ",\n".join(lines) + f"\n{margin}}}"
    if _is_flat(value):
        return _json_line(value)
    texts = (_json_line(item) if _is_flat(item) else _json_text(item, inner) for item in value)
    return "[\n" + ",\n".join(inner + text for text in texts) + f"\n{margin}]"


_json_line = partial(json.dumps, ensure_ascii=False, allow_nan=False)


def _is_flat(value: Any) -> bool:
    """Whether a value contains no list or object that is not empty."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return not any(isinstance(part, dict | list) and part for part in parts)


_REPORT_FILES = {
    "calibrated.npz", "calibrated.toml", "figures", "next_measurements.csv",
    "next_measurements.html", "report.html", "residuals.csv", "result.json",
}  # fmt: skip
"""Names in a report's folder: a folder that contains any other name is not replaced."""


def check_folder(out: Path, overwrite: bool = False) -> Path:
    """Return the resolved folder for results, new or empty; with ``overwrite`` it may contain an
    earlier report, and nothing else.

    Raises:
        FileError: if results cannot be written there.
    """
    with as_file_errors(out):
        target = Path(os.path.realpath(out))
        names = {path.name for path in target.iterdir()} if target.is_dir() else set()
        foreign, parent = sorted(names - _REPORT_FILES), target.parent
        problems = {
            "is a link to nothing: name a new folder": out.is_symlink() and not target.exists(),
            "is a file: name a new folder for the results": target.exists() and not target.is_dir(),
            "is the folder you are in: name a new one inside it": target == Path.cwd(),
            "is not empty and results are never overwritten: name a new or empty folder":
                names and not overwrite,
            f"must hold an earlier report alone, and holds {''.join(foreign[:1])}: name another":
                foreign,
            "cannot be made where there is no folder to hold it: make that first":
                not parent.is_dir(),
            "cannot be made here: choose a place you may write to":
                not os.access(parent, os.W_OK | os.X_OK),
        }  # fmt: skip
    if problem := next((words for words, applies in problems.items() if applies), ""):
        raise FileError(problem, file=out)
    return target


def write_folder(out: Path, files: Mapping[str, str | bytes], overwrite: bool = False) -> None:
    """Write files into a temporary sibling in their order, then rename it; a ``/`` in a name leads
    to a folder inside, and ``overwrite`` replaces an earlier report whole.

    Raises:
        FileError: if the folder cannot be written.
    """
    target = check_folder(out, overwrite)
    with as_file_errors(out):
        temporary = temporary_path(target)
        try:
            temporary.mkdir()
            for name, content in files.items():
                if ".." in Path(name).parts or Path(name).is_absolute():
                    raise FileError("must be a place within the folder", file=name)
                path = temporary / name
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(content.encode() if isinstance(content, str) else content)
            _move_into_place(temporary, target, overwrite)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


def _move_into_place(temporary: Path, target: Path, overwrite: bool) -> None:
    """Rename a folder to a name that may exist; the earlier folder is removed only afterwards.

    The system refuses to replace a folder that another process has just filled.
    """
    earlier = temporary.with_name(f"{temporary.name}-earlier")
    if overwrite and target.is_dir() and any(target.iterdir()):
        target.rename(earlier)
    try:
        temporary.rename(target)
    except BaseException:
        if earlier.exists():
            earlier.rename(target)
        raise
    shutil.rmtree(earlier, ignore_errors=True)
