"""``result.json``, ``calibrated.toml`` and ``residuals.csv``: results for programs."""

from __future__ import annotations

import csv
import io
import json
import math
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.effects import family_of
from orthoglide.fit import CrossCheck, Estimate, Scores, WeakDirection
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile, machine_text, nominal_machine_file
from orthoglide.machine_file.posterior import posterior_bytes
from orthoglide.report.run import Run
from orthoglide.report.wording import headline

SCHEMA = 1
_DIGITS = 10  # what differs behind these is rounding
_FEW = 3  # digits of figures that are rounding themselves


def identification_result(estimate: Estimate, run: Run) -> dict[str, Any]:
    """The mapping of ``result.json`` for an identification.

    ``before`` is the machine without what was identified, ``after`` the fit; what only closing the
    loop finds is null or empty.

    Args:
        estimate: what was found.
        run: what was asked.
    """
    return {
        **run_mapping(estimate, run, headline(estimate)),
        "verdict": None,
        "before": scores_mapping(estimate.nominal),
        "after": scores_mapping(estimate.scores),
        "holdout": None,
        "tcp": None,
        "effects": [],
        "parameters": parameters_mapping(estimate),
        "correlations": {
            "parameters": list(estimate.names),
            "matrix": [[round(v, 6) + 0.0 for v in row] for row in estimate.correlation.tolist()],
        },
        "candidates": [],
        "blunders": [],
        "weak_directions": [weak_mapping(weak) for weak in estimate.weak],
        "cross_check": check_mapping(estimate.check),
        "next_measurements": [],
        "method": {
            "name": estimate.method,
            "iterations": estimate.iterations,
            "last_step_in_sigmas": number(estimate.optimality, _FEW),
        },
        "warnings": list(estimate.warnings),
    }


def run_mapping(estimate: Estimate, run: Run, summary: str) -> dict[str, Any]:
    """What every ``result.json`` begins with: what was asked of which files, and the noise.

    Args:
        estimate: the final fit.
        run: what was asked.
        summary: the finding in a sentence.
    """
    problem = estimate.problem
    return {
        "schema": SCHEMA,
        "version": run.version,
        "command": run.command,
        "arguments": dict(run.arguments),
        "seed": run.seed,
        "inputs": [i.mapping() for i in run.inputs],
        "machine": machine_mapping(problem.machine),
        "summary": summary,
        "noise_mm": number(problem.noise.typical * 1e3),
        "noise_source": problem.noise.source,
        "sigma_scale": number(estimate.sigma_scale),
    }


def to_json(result: Mapping[str, Any]) -> str:
    """The text of ``result.json``: the same bytes for the same result."""
    return json.dumps(result, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def number(value: float, digits: int = _DIGITS) -> float | None:
    """A number without its rounding noise; ``None`` where there is none."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def scores_mapping(scores: Scores) -> dict[str, Any]:
    """Figures of one fit as files name them."""
    return {
        "rms_mm": number(scores.rms * 1e3),
        "deviation_rms_mm": number(scores.deviation_rms * 1e3),
        "max_mm": number(scores.max * 1e3),
        "chi2": number(scores.chi2),
        "dof": scores.dof,
        "lack_of_fit_p": number(scores.lack_of_fit_p),
        "cv_rms_mm": number(scores.cv_rms * 1e3),
    }


def parameters_mapping(estimate: Estimate) -> dict[str, dict[str, Any]]:
    """Identified values in the units of files, with intervals and tolerances."""
    found = {}
    for name, tolerance in zip(estimate.names, estimate.problem.tolerance, strict=True):
        unit = family_of(name).unit
        low, high = estimate.interval(name)
        found[name] = {
            "value": number(estimate.values[name] / unit.si),
            "sigma": number(estimate.sigmas[name] / unit.si),
            "unit": unit.name,
            "interval_95": [number(low / unit.si), number(high / unit.si)],
            "tolerance": number(tolerance / unit.si),
        }
    return found


def weak_mapping(weak: WeakDirection) -> dict[str, Any]:
    """A direction that the readings hardly see."""
    return {
        "parameters": {name: number(share, 6) for name, share in weak.parameters.items()},
        "sigma": number(weak.sigma, 6),
        "sigma_with_priors": number(weak.sigma_with_priors, 6),
        "unit": weak.unit,
    }


def check_mapping(check: CrossCheck | None) -> dict[str, Any] | None:
    """The cross-check; null where the reduction cannot represent what was asked."""
    if check is None:
        return None
    return {
        "reduction_max_difference_mm": number(check.reduction * 1e3, _FEW),
        "linear_system_max_difference_mm": number(check.linear * 1e3, _FEW),
        "linear_system_rms_difference_mm": number(check.linear_size * 1e3, _FEW),
        "linear_system_rms_bound_mm": number(check.linear_bound * 1e3, _FEW),
    }


def machine_mapping(machine: Machine) -> dict[str, Any]:
    """The machine that was started from, whole."""
    spec, kept = machine.spec, machine.spec.posterior
    return {
        "file": Path(spec.file).name or None,
        "sha256": spec.sha256 or None,
        "toml": machine_text(spec),
        "npz": kept and b64encode(posterior_bytes(kept, spec.sha256)).decode(),
    }


def calibrated_machine(estimate: Estimate, run: Run) -> MachineFile:
    """The machine file to go on with: the last campaign's, with where its numbers come from."""
    return provenance_of(estimate.problem.machine, estimate.machine, run)


def provenance_of(start: Machine, calibrated: Machine, run: Run) -> MachineFile:
    """The file of a calibrated machine, with where its numbers come from.

    Args:
        start: the machine that was started from.
        calibrated: what was found.
        run: what was asked.
    """
    before, after = start.spec, calibrated.spec
    nominal = nominal_machine_file().name
    used = [i for i in run.inputs if i.role == "campaign"]
    provenance: dict[str, Any] = {
        "version": run.version,
        "command": run.command,
        "campaigns": [{"file": i.file, "sha256": i.sha256} for i in used],
    }
    if before.file:
        provenance["machine"] = {"file": Path(before.file).name, "sha256": before.sha256}
    name = "Orthoglide, calibrated" if after.name == nominal else after.name
    return replace(after, name=name, provenance=provenance)


def residual_table(estimate: Estimate) -> str:
    """The text of ``residuals.csv``: each reading, its prediction and residual before and after."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        ["campaign", "line", "setup", "leg", "direction", "posture",
         *(f"rho_{leg}_mm" for leg in LEGS), "gauge_mm", "repeat", "order", "reading_mm",
         "sigma_mm", "predicted_before_mm", "predicted_after_mm", "residual_before_mm",
         "residual_after_mm"]
    )  # fmt: skip
    problem = estimate.problem
    before, after = estimate.predicted_before, estimate.predicted
    figures = np.column_stack(
        [problem.measured, problem.sigma, before, after, problem.measured - before,
         problem.measured - after]
    )  # fmt: skip
    for campaign, part in zip(problem.campaigns, problem.rows, strict=True):
        for row, values in zip(campaign.rows, figures[part], strict=True):
            setup = row.setup
            writer.writerow(
                [campaign.name, row.line, setup.name, LEGS[setup.leg], setup.direction, row.posture,
                 *map(_mm, row.command), _mm(setup.gauge), row.repeat, row.order,
                 *map(_mm, values)]
            )  # fmt: skip
    return stream.getvalue()


def _mm(metres: float) -> str:
    """Millimetres to a nanometre: further digits are rounding."""
    return f"{round(metres * 1e3, 6) + 0.0:.6f}"
