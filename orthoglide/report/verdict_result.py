"""``result.json``, ``calibrated.toml`` and ``residuals.csv`` of a closed loop."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.effects import family_of
from orthoglide.geometry import LEGS
from orthoglide.machine_file import MachineFile
from orthoglide.report.result import (
    check_mapping,
    number,
    provenance_of,
    run_mapping,
    scores_mapping,
    weak_mapping,
)
from orthoglide.report.run import Run
from orthoglide.report.verdict_view import Explained, View
from orthoglide.report.verdict_wording import cautions, headline

if TYPE_CHECKING:
    from orthoglide.closing import Verdict


def verdict_result(view: View, run: Run) -> dict[str, Any]:
    """The mapping of ``result.json`` for a closed loop, keys as FORMAT names them, and more.

    Args:
        view: of the verdict.
        run: what was asked.
    """
    from orthoglide.planning import as_result

    verdict = view.verdict
    fit, base = verdict.fit, verdict.base
    return {
        **run_mapping(fit, run, headline(view)),
        "verdict": verdict.word,
        "nominal": scores_mapping(base.nominal),
        "before": scores_mapping(base.scores),
        "after": scores_mapping(fit.scores),
        "holdout": _hold_out(verdict),
        "tcp": _tcp(verdict),
        "effects": [_effect(e) for e in view.effects],
        "parameters": _parameters(verdict),
        "calibrated": _calibrated(verdict),
        "candidates": _candidates(view),
        "blunders": [_blunder(verdict, b) for b in verdict.blunders],
        "changed": [_change(c) for c in verdict.changed],
        "weak_directions": [weak_mapping(weak) for weak in fit.weak],
        "cross_check": check_mapping(base.check),
        "next_measurements": [dict(s) for s in as_result(view.following)],
        "left": _left(view),
        "workspace": workspace_mapping(view),
        "invisible": list(verdict.invisible),
        "method": {
            "name": fit.method,
            "iterations": fit.iterations,
            "last_step_in_sigmas": number(fit.optimality, 3),
        },
        "warnings": [*cautions(view), *view.warnings],
    }


def _change(change: Any) -> dict[str, Any]:
    si = change.unit.si
    return {
        "parameter": change.parameter,
        "members": list(change.members),
        "from": number(change.before / si),
        "to": number(change.after / si),
        "sigma": number(change.sigma / si),
        "unit": change.unit.name,
        "between": [file.rpartition("/")[2] for file in change.between],
        "words": change.message,
    }


def _hold_out(verdict: Verdict) -> dict[str, Any] | None:
    scored = verdict.hold_out
    if scored is None:
        return None
    return {
        "before_rms_mm": number(scored.before_rms * 1e3),
        "after_rms_mm": number(scored.after_rms * 1e3),
    }


def _tcp(verdict: Verdict) -> dict[str, Any] | None:
    if verdict.tcp is None:
        return None
    found: dict[str, Any] = {}
    for alignment, errors in verdict.tcp.items():
        found[alignment] = {
            f"{side}_{what}_mm": number(getattr(errors, side)[k] * 1e3)
            for side in ("nominal", "before", "after")
            for k, what in enumerate(("mean", "max"))
        }
        if np.isfinite(errors.inside):
            found[alignment]["inside_95"] = number(errors.inside, 6)
    return found


def _effect(explained: Explained) -> dict[str, Any]:
    effect = explained.effect
    before, after = effect.cv_rms
    return {
        "name": effect.name,
        "parameters": list(effect.parameters),
        "probability": number(effect.probability, 6),
        "indistinguishable_from": list(effect.indistinguishable_from),
        "words": explained.words,
        "rivals": [
            {
                "name": rival.trial.candidate.name,
                "probability": number(rival.weight, 6),
                "chi2_more": number(rival.trial.chi2 - effect.trial.chi2, 6),
            }
            for rival in effect.rivals
        ],
        "detection_p": number(effect.detection_p, 6),
        "naming_p": number(effect.naming_p, 6),
        "cv_rms_mm": {"before": number(before * 1e3), "after": number(after * 1e3)},
    }


def _parameters(verdict: Verdict) -> dict[str, Any]:
    """Values of the chosen explanation; sigma of the second kind, and of the first."""
    found, fit = {}, verdict.fit
    for name, tolerance in zip(fit.names, fit.problem.tolerance, strict=True):
        unit = family_of(name).unit
        found[name] = {
            "value": number(fit.values[name] / unit.si),
            "sigma": number(verdict.known.sigmas[name] / unit.si),
            "sigma_alone": number(fit.sigmas[name] / unit.si),
            "unit": unit.name,
            "tolerance": number(tolerance / unit.si),
        }
    return found


def _calibrated(verdict: Verdict) -> dict[str, Any]:
    """Parameters of ``calibrated.toml``: averaged over what fits as well."""
    found = {}
    for name, entry in verdict.machine.spec.parameters.items():
        unit = family_of(name).unit
        found[name] = {
            "value": number(entry.value / unit.si),
            "sigma": number(entry.sigma / unit.si),
            "unit": unit.name,
        }
    return found


def _candidates(view: View) -> list[dict[str, Any]]:
    return [
        {
            "name": tried.name,
            "parameters": list(tried.parameters),
            "p_value": number(tried.p_value, 6),
            "evidence": number(tried.evidence, 6),
            "cv_rms_mm": number(tried.cv_rms * 1e3),
            "plausible": tried.plausible,
            "round": tried.round,
        }
        for tried in view.tried
    ]


def _blunder(verdict: Verdict, blunder: Any) -> dict[str, Any]:
    assert verdict.faulty is not None  # there are blunders, so there is the fit with them
    lines = blunder.lines(verdict.faulty.problem.campaigns)
    return {
        "kind": blunder.kind,
        "rows": [line for rows in lines.values() for line in rows],
        "files": {name.rpartition("/")[2]: list(rows) for name, rows in lines.items()},
        "setups": list(blunder.setups),
        "message": blunder.message,
        "chi2_less": number(blunder.improvement, 6),
        "rms_with_mm": number(blunder.rms_with * 1e3),
        "rms_without_mm": number(blunder.rms_without * 1e3),
    }


def _left(view: View) -> dict[str, Any]:
    """What the last fit leaves, and why the search ended."""
    detection = view.verdict.left.detection
    return {
        "detection_p": number(detection.p_value, 6),
        "lack_of_fit_p": number(detection.lack_of_fit_p, 6),
        "stopped": view.verdict.stopped,
        "pattern": list(view.pattern),
    }


def workspace_mapping(view: View) -> dict[str, Any]:
    """The predicted TCP error over the workspace, best translation removed, mean and largest."""
    return {
        name: {"mean_mm": number(values.mean() * 1e3, 6), "max_mm": number(values.max() * 1e3, 6)}
        for name, values in view.workspace.figures().items()
    }


def calibrated_machine(verdict: Verdict, run: Run) -> MachineFile:
    """The machine file to go on with, with where its numbers come from."""
    machine = provenance_of(verdict.fit.problem.machine, verdict.machine, run)
    names = {e.name: list(e.indistinguishable_from) for e in verdict.effects}
    told: dict[str, Any] = {"verdict": verdict.word, "sigma": "all other effects allowed"}
    if names:
        told["effects"] = list(names)
    if any(names.values()):
        told["averaged_over"] = sorted({n for others in names.values() for n in others})
    return replace(machine, provenance={**machine.provenance, **told})


_TEXTS = ("campaign", "line", "setup", "leg", "direction", "posture")
_FIGURES = (
    "reading_mm", "sigma_mm",
    "predicted_nominal_mm", "predicted_before_mm", "predicted_after_mm",
    "residual_nominal_mm", "residual_before_mm", "residual_after_mm",
)  # fmt: skip


def residual_table(verdict: Verdict) -> str:
    """The text of ``residuals.csv``: nominal, before and after; faulty rows last, set aside."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    rho = [f"rho_{leg}_mm" for leg in LEGS]
    writer.writerow([*_TEXTS, *rho, "gauge_mm", "repeat", "order", *_FIGURES, "set_aside"])
    problem = verdict.fit.problem
    measured = problem.measured
    predicted = (verdict.base.predicted_before, verdict.base.predicted, verdict.fit.predicted)
    columns = [measured, problem.sigma, *predicted, *(measured - p for p in predicted)]
    figures = np.column_stack(columns)
    for campaign, part in zip(problem.campaigns, problem.rows, strict=True):
        for row, values in zip(campaign.rows, figures[part], strict=True):
            writer.writerow([*_places(campaign.name, row), *map(_mm, values), ""])
    for place, kind in _set_aside(verdict):
        campaign = verdict.faulty.problem.campaigns[place[0]]  # type: ignore[union-attr]
        alone = next(iter(campaign.subset([place[1]]).rows))
        values = [_mm(alone.reading), *[""] * (len(_FIGURES) - 1)]
        writer.writerow([*_places(campaign.name, alone), *values, kind])
    return stream.getvalue()


def _set_aside(verdict: Verdict) -> list[tuple[tuple[int, int], str]]:
    return [
        (place, blunder.kind)
        for blunder in verdict.blunders
        if blunder.kind != "knocked_stand"  # whose rows count, with a datum of their own
        for place in blunder.rows
    ]


def _places(campaign: str, row: Any) -> list[Any]:
    setup = row.setup
    return [
        campaign, row.line, setup.name, LEGS[setup.leg], setup.direction, row.posture,
        *map(_mm, row.command), _mm(setup.gauge), row.repeat, row.order,
    ]  # fmt: skip


def _mm(metres: float) -> str:
    return f"{round(float(metres) * 1e3, 6) + 0.0:.6f}"


def next_table(view: View) -> str:
    """The text of ``next_measurements.csv``: one sheet to fill in; empty where nothing helps.

    A visit that serves two purposes stands once; visits to a station are numbered through.
    """
    from orthoglide.observations import campaign_text
    from orthoglide.planning import next_sheet

    sheet = next_sheet(view.following)
    if sheet is None:
        return ""
    return campaign_text(sheet, view.verdict.fit.problem.machine.spec)
