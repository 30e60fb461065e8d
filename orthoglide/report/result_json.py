"""``result.json``: a result for programs, keys as FORMAT names them."""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orthoglide import __version__
from orthoglide.geometry import LEGS
from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine_file import machine_text
from orthoglide.machine_file.posterior import posterior_bytes
from orthoglide.report.wording import headline, located_words
from orthoglide.result.unvaried import unvaried
from orthoglide.urdf import urdf_digests

if TYPE_CHECKING:
    from orthoglide.diagnosis.blunders import Blunder
    from orthoglide.diagnosis.changes import Change
    from orthoglide.diagnosis.rest import SetupRest
    from orthoglide.fit import CrossCheck, Estimate, Scores, WeakDirection
    from orthoglide.judging import HoldOut, TcpErrors
    from orthoglide.planning import Suggestion
    from orthoglide.posterior import BudgetItem, CandidateScore, Cause, Curve, Explanation, Located
    from orthoglide.request import Request
    from orthoglide.result import Result
    from orthoglide.result.actions import Action

SCHEMA = 2
_DIGITS = 10  # what differs behind these is rounding
_FEW = 3  # digits of figures that are rounding themselves
_SHORT = 6  # digits of probabilities and the like
_ROUNDING = 1e-12  # metres: two derivations that differ by less agree, and how much less is chance


def result_text(result: Result) -> str:
    """The text of ``result.json``: the same bytes for the same result."""
    return json.dumps(_mapping(result), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def number(value: float, digits: int = _DIGITS) -> float | None:
    """A number without its rounding noise; ``None`` where there is none."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _mm(metres: float, digits: int = _DIGITS) -> float | None:
    return number(metres * 1e3, digits)


def _mapping(result: Result) -> dict[str, Any]:
    after, before, legs = result.after, result.before, result.machine.catalogue.legs.legs
    faulty = [f.readings for f in result.first.problem.factors]
    return {
        **_head(result.request, after),
        "summary": headline(result),
        "verdict": result.word,
        "nominal": _scores(result.nominal),
        "before": _scores(before.scores),
        "after": _scores(after.scores),
        "holdout": result.hold_out and _held_out(result.hold_out),
        "tcp": result.tcp and {name: _tcp(errors) for name, errors in result.tcp.items()},
        "effects": [_cause(cause, legs) for cause in result.effects],
        "located": [_located(found, legs) for found in result.located],
        "single_causes": [_explanation(one) for one in result.alone],
        "budget": [_budget(item, result) for item in result.budget],
        "parameters": _parameters(result),
        "correlations": _correlations(result),
        "calibrated": _calibrated(result),
        "candidates": [_tried(tried) for tried in result.candidates],
        "blunders": [_blunder(b, b.lines(faulty)) for b in result.blunders],
        "changed": [_change(change) for change in result.changed],
        "weak_directions": [_weak(weak) for weak in after.weak],
        "cross_check": before.check and _check(before.check),
        "verification": after.verification and after.verification.as_dict(),
        **({} if result.firmware is None else {"firmware": result.firmware.as_dict()}),
        "next_measurements": [_next(suggestion) for suggestion in result.next_measurements],
        "left": _left(result),
        "workspace": _workspace(result),
        "tool": {name: error.as_dict() for name, error in result.numbers.expected.items()},
        "actions": [_action(action) for action in result.actions],
        "invisible": [*result.invisible, *result.catalogue.expand(list(unvaried(result)))],
        "method": {
            "name": after.method,
            "iterations": after.iterations,
            "last_step_in_sigmas": number(after.optimality, _FEW),
        },
        "warnings": [*result.cautions, *after.warnings],
    }


def _head(request: Request, after: Estimate) -> dict[str, Any]:
    """What was asked of which files, and the noise: enough to run it again."""
    spec, kept = request.machine.spec, request.machine.spec.posterior
    return {
        "schema": SCHEMA,
        "version": __version__,
        "command": request.command,
        "arguments": request.arguments,
        "seed": request.seed,
        "inputs": request.inputs,
        "machine": {
            "file": Path(spec.file).name or None,
            "sha256": spec.sha256 or None,
            "toml": machine_text(spec),
            "npz": kept and b64encode(posterior_bytes(kept, spec.sha256)).decode(),
            **({"urdf": urdf_digests(spec.urdf)} if spec.urdf else {}),
        },
        "noise_mm": _mm(after.problem.told_noise),
        **_mrad(noise=after.problem.one_reading.turn),
        "noise_source": after.problem.noise_source,
        "noise_of": {
            kind: {OBSERVATIONS[kind].unit: _mm(sigma), "source": source}
            for kind, (sigma, source) in after.problem.noises.items()
        },
        "sigma_scale": number(after.sigma_scale),
    }


def _held_out(held: HoldOut) -> dict[str, Any]:
    return {
        "before_rms_mm": _mm(held.before.length),
        "after_rms_mm": _mm(held.after.length),
        **_mrad(before_rms=held.before.turn, after_rms=held.after.turn),
    }


def _scores(scores: Scores) -> dict[str, Any]:
    return {
        "rms_mm": _mm(scores.rms),
        "deviation_rms_mm": _mm(scores.deviation_rms),
        "max_mm": _mm(scores.max),
        "chi2": number(scores.chi2),
        "prior_chi2": number(scores.prior_chi2),
        "dof": number(scores.dof),
        "lack_of_fit_p": number(scores.lack_of_fit_p),
        "cv_rms_mm": _mm(scores.cv_rms),
        **_mrad(rms=scores.turn_rms, max=scores.turn_max, cv_rms=scores.turn_cv_rms),
    }


def _mrad(**radians: float) -> dict[str, float | None]:
    """Keys of what is known of inclinations: none where none was read."""
    return {f"{key}_mrad": _mm(v) for key, v in radians.items() if math.isfinite(v)}


def _tcp(errors: TcpErrors) -> dict[str, Any]:
    found = {
        f"{side}_{what}_mm": _mm(getattr(errors, side)[k])
        for side in ("nominal", "before", "after")
        for k, what in enumerate(("mean", "max"))
    }
    if math.isfinite(errors.inside):
        found["inside_95"] = number(errors.inside, _SHORT)
    return found


def _cause(cause: Cause, legs: Sequence[str]) -> dict[str, Any]:
    return {
        **_explanation(cause.chosen),
        "indistinguishable_from": list(cause.indistinguishable_from),
        "rivals": [_explanation(rival) for rival in cause.rivals],
        "places": [_place(curve, legs) for curve in cause.places],
    }


def _located(found: Located, legs: Sequence[str]) -> dict[str, Any]:
    """A place without a name; its class holds every member with its own size."""
    first = found.members[0]
    return {
        **_place(first, legs),
        "class": [_place(curve, legs) for curve in found.members],
        "class_probability": number(found.probability, _SHORT),
        "resembling": list(found.resembling),
        "curve": [
            [number(a if first.place.against == "time" else a * 1e3, _SHORT), number(v, _SHORT),
             number(s, _SHORT)]
            for a, v, s in zip(first.at, first.value * 1e3, first.sigma * 1e3, strict=True)
        ],
        "at_unit": "s" if first.place.against == "time" else "mm",
        "words": located_words(found),
    }  # fmt: skip


def _place(curve: Curve, legs: Sequence[str]) -> dict[str, Any]:
    place, unit = curve.place, curve.unit
    return {
        "leg": legs[place.leg] if place.leg >= 0 else None,
        "part": place.part,
        "direction": place.direction or None,
        "against": place.against,
        "short_waves": place.short,
        "by_leg": legs[place.by] if place.against == "command" else None,
        "setup": place.setup or None,
        "probability": number(curve.probability, _SHORT),
        f"rms_{unit}": _mm(float(curve.value.std()), _SHORT),
        f"size_{unit}": _mm(curve.size, _SHORT),
        "unit": unit,
    }


def _explanation(one: Explanation) -> dict[str, Any]:
    value, sigma = one.in_unit or (math.nan, math.nan)
    return {
        "name": one.name,
        "parameters": list(one.parameters),
        "value": number(value),
        "sigma": number(sigma),
        "unit": one.unit,
        "probability": number(one.probability, _SHORT),
        "words": one.words,
    }


def _budget(item: BudgetItem, result: Result) -> dict[str, Any]:
    unit = result.catalogue.effect_of(item.cause).unit
    return {
        "cause": item.cause,
        "members": list(item.members),
        "value": number(item.value / unit.si),
        "sigma": number(item.sigma / unit.si),
        "unit": unit.name,
        "tolerances": number(item.tolerances, _SHORT),
        "beyond_tolerance": number(item.beyond_tolerance, _SHORT),
        "readings_rms_mm": _mm(item.readings.length, _SHORT),
        **_mrad(readings_rms=item.readings.turn),
        "tcp_mean_mm": _mm(item.tcp_mean, _SHORT),
        "tcp_sigma_mm": _mm(item.tcp_sigma, _SHORT),
        "gain_mm": _mm(item.gain, _SHORT),
        "gain_sigma_mm": _mm(item.gain_sigma, _SHORT),
        "compensated_mm": _mm(item.compensated, _SHORT),
        "compensated_sigma_mm": _mm(item.compensated_sigma, _SHORT),
        "gain_share": number(item.share, _SHORT),
        "rest": item.rest,
    }


def _action(action: Action) -> dict[str, Any]:
    return {
        "action": action.kind,
        "words": action.words,
        "gain_mm": _mm(action.gain, _SHORT),
        "gain_sigma_mm": _mm(action.gain_sigma, _SHORT),
        "whichever": action.whichever,
        "options": [vars(option) for option in action.options],
    }


def _next(suggestion: Suggestion) -> dict[str, Any]:
    return {
        "reason": suggestion.reason,
        "aim": suggestion.aim,
        "gain": number(suggestion.gain, _SHORT),
        "readings": [dict(row) for row in suggestion.rows],
    }


def _left(result: Result) -> dict[str, Any]:
    return {
        "lack_of_fit_p": number(result.left.p_value, _SHORT),
        "background": number(result.share, _SHORT),
        "rare_probability": number(result.left.rare, _SHORT),
        "stopped": result.stopped,
        "pattern": list(result.pattern),
        "by_setup": [_rest(rest) for rest in result.rest],
        "by_instrument": [_rest_of_tool(rest) for rest in result.rest_of_tool],
    }


def _rest_of_tool(rest: SetupRest) -> dict[str, Any]:
    return {
        "setup": rest.setup,
        "reads": rest.reads,
        "unit": rest.unit,
        "share": number(rest.share, _SHORT),
        "rms": _mm(rest.rms, _SHORT),
        "most": _mm(rest.most, _SHORT),
        "posture": rest.posture,
        "where": list(rest.where),
    }


def _rest(rest: SetupRest) -> dict[str, Any]:
    return {
        "setup": rest.setup,
        "leg": LEGS[rest.leg],
        "direction": LEGS[rest.axis],
        "share": number(rest.share, _SHORT),
        "rms_mm": _mm(rest.rms, _SHORT),
        "most_mm": _mm(rest.most, _SHORT),
        "command_mm": [_mm(v) for v in rest.command],
        "posture": rest.posture,
    }


def _parameters(result: Result) -> dict[str, Any]:
    """Values of the base and of the causes found, in the units of files."""
    return {
        name: {
            "value": number(value),
            "sigma": number(sigma),
            "unit": unit,
            "interval_95": [number(low), number(high)],
            "tolerance": number(tolerance),
        }
        for name, value, sigma, low, high, tolerance, unit in zip(
            *result.columns.values(), strict=True
        )
    }


def _correlations(result: Result) -> dict[str, Any]:
    names = result.after.names if result.posterior is None else result.before.names
    at = [result.after.names.index(n) for n in names]
    matrix = result.after.correlation[at][:, at].tolist()
    return {
        "parameters": list(names),
        "matrix": [[round(v, 6) + 0.0 for v in row] for row in matrix],
    }


def _calibrated(result: Result) -> dict[str, Any]:
    """Parameters of ``calibrated.toml``: the posterior's mean."""
    found = {}
    for name, entry in result.machine.spec.parameters.items():
        unit = result.machine.catalogue.effect_of(name).unit
        value, sigma = number(entry.value / unit.si), number(entry.sigma / unit.si)
        found[name] = {"value": value, "sigma": sigma, "unit": unit.name}
    return found


def _tried(tried: CandidateScore) -> dict[str, Any]:
    return {
        "name": tried.name,
        "parameters": list(tried.parameters),
        "p_value": None,
        "evidence": number(tried.evidence, _SHORT),
        "probability": number(tried.probability, _SHORT),
        "cv_rms_mm": None,
        "plausible": True,
    }


def _blunder(blunder: Blunder, lines: Mapping[str, tuple[int, ...]]) -> dict[str, Any]:
    return {
        "kind": blunder.kind,
        "rows": [line for rows in lines.values() for line in rows],
        "files": {name.rpartition("/")[2]: list(rows) for name, rows in lines.items()},
        "setups": list(blunder.setups),
        "message": blunder.message,
        "chi2_less": number(blunder.improvement, _SHORT),
        "rms_with_mm": _mm(blunder.rms_with),
        "rms_without_mm": _mm(blunder.rms_without),
    }


def _change(change: Change) -> dict[str, Any]:
    si = change.unit.si
    return {
        "parameter": change.parameter,
        "members": list(change.members),
        "from": number(change.before / si),
        "to": number(change.after / si),
        "sigma": number(change.sigma / si),
        "unit": change.unit.name,
        "between": list(change.files),
        "words": change.message,
        "vague": change.vague,
    }


def _weak(weak: WeakDirection) -> dict[str, Any]:
    return {
        "parameters": {name: number(share, _SHORT) for name, share in weak.parameters.items()},
        "sigma": number(weak.sigma, _SHORT),
        "sigma_with_priors": number(weak.sigma_with_priors, _SHORT),
        "unit": weak.unit,
    }


def _check(check: CrossCheck) -> dict[str, Any]:
    return {
        "reduction_max_difference_mm": _mm(max(check.reduction, _ROUNDING), _FEW),
        "linear_system_max_difference_mm": _mm(max(check.linear, _ROUNDING), _FEW),
        "linear_system_rms_difference_mm": _mm(max(check.linear_size, _ROUNDING), _FEW),
        "linear_system_rms_bound_mm": _mm(check.linear_bound, _FEW),
    }


def _workspace(result: Result) -> dict[str, Any] | None:
    """The predicted TCP error over the workspace, best translation removed, mean and largest."""
    if result.workspace is None:
        return None
    return {
        name: {"mean_mm": _mm(values.mean(), _SHORT), "max_mm": _mm(values.max(), _SHORT)}
        for name, values in result.workspace.figures().items()
    }
