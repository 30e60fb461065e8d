"""A sign, a unit or two labels weighed together with the causes of the machine beside them.

One at a time, a fault of the data loses against a real error of the machine, and the error, in a
model of wrong readings, takes another shape. Here each hypothesis is scored with its own best
effects: ``-chi2 / 2 + max(best single evidence, best evidence of a pair)``, on station means. It
must beat the readings as they stand, with any pair or family of the catalogue, by a margin, and
leave no more than noise where these leave more. Hypotheses are ranked by the linearisation at the
fit and the best of them identified anew, as wrong readings lead the fit far from where it belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.diagnosis.evidence import Scoring, best_pair
from orthoglide.diagnosis.fault_view import View, set_free, with_effect
from orthoglide.diagnosis.faults import UNITS, Fault, Kind, Rows, in_order
from orthoglide.diagnosis.fit_faults import (
    exchanged,
    grain,
    meant,
    pairs_of_setups,
    same_commands,
    under_each_label,
)
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.errors import NumericsError
from orthoglide.fit import Problem, solve
from orthoglide.geometry import Array

MARGIN = 12.0
"""Log Bayes factor, the number of hypotheses discounted, by which the readings must be beaten."""

_SPREAD = 2.5  # standard deviations of chi2 by which a fault and its effects may exceed noise
_SHARE = 0.5  # of what the best effects alone leave, that a fault and its effects may leave
_REFITS = 4  # hypotheses that are identified anew
_TOLD = 30.0  # sigmas of the station means by which readings must swing past fit and effects
_FEWEST = 6.0  # degrees of freedom of station means: fewer tell nothing of two effects and a fault
_APART = 6.0  # log Bayes factor between the best fault and the next one of other setups


@dataclass(frozen=True)
class _Hypothesis:
    """Readings that mean something else.

    Attributes:
        fault: with no evidence yet.
        change: what the readings change by, ``(n,)`` metres.
        problem: with the fault taken back.
    """

    fault: Fault
    change: Array
    problem: Problem


@dataclass(frozen=True)
class _Scored:
    """A residual with its best effects.

    Attributes:
        score: log evidence but for a constant.
        left: chi2 of the station means past the effects.
        places: of the effects among the candidates.
    """

    score: float
    left: float
    places: tuple[int, ...]


def joint_fault(seen: Signatures, known: Sequence[Fault]) -> Fault | None:
    """The sign, unit or exchange that fits with one or two effects where no effects fit alone.

    Args:
        seen: signatures at the fit of the readings without the known faults.
        known: faults found before; their rows take no part.
    """
    problem = seen.estimate.problem
    for fault in known:
        seen = set_free(seen, fault.columns(problem))
    view = View.of(seen)
    if not seen.candidates or view.dof < _FEWEST or _fits(view, view.chi2):
        return None
    bare = _scored(view, view.residual, families=True)
    if _fits(view, bare.left):
        return None
    touched = {s for f in known for s in f.setups}
    tried = _hypotheses(view, [s for s in range(problem.setup_count) if s not in touched])
    if not tried:
        return None
    shown = view.shown(np.stack([h.change for h in tried], axis=-1))
    first = [_scored(view, view.residual + column).score for column in shown.T]
    faults = []
    for k in np.argsort(first)[::-1][:_REFITS]:
        after = _retaken(tried[k], known)
        if after is None or after.left > _SHARE * bare.left:
            continue
        gain = after.score - bare.score - np.log(len(tried))
        if tried[k].fault.kind == "unit":
            gain += grain(problem, tried[k].fault.rows, tried[k].fault.size)
        if gain >= MARGIN:
            faults.append(replace(tried[k].fault, evidence=float(gain)))
    if not faults:
        return None
    best = max(faults, key=lambda f: f.evidence)
    others = [f.evidence for f in faults if f.setups != best.setups]
    return best if best.evidence - max(others, default=-np.inf) >= _APART else None


def _fits(view: View, left: float) -> bool:
    """Whether chi2 of station means is that of noise, a little of everything allowed for."""
    return left <= view.dof + _SPREAD * np.sqrt(2 * view.dof)


def _scored(view: View, residual: Array, families: bool = False) -> _Scored:
    """A residual of station means ``(g,)`` with the effects that explain it best."""
    scoring, means = _means(view, residual)
    evidences = scoring.evidences(residual)
    usable = [k for k, c in enumerate(scoring.candidates) if families or c.size == 1]
    single = max(usable, key=lambda k: evidences[k])
    places: tuple[int, ...] = (single,)
    best = float(evidences[single])
    pair = best_pair(scoring, means)
    if pair is not None and pair.evidence > best:
        places, best = pair.members, pair.evidence
    chi2 = float(residual @ residual)
    # The family that leaves least counts as well: is there any explanation but a fault?
    left = chi2 - _explained(means, places, residual)
    if families:
        left = min(left, chi2 - float(scoring.gains(residual).max()))
    return _Scored(best - chi2 / 2, left, places)


def _means(view: View, residual: Array) -> tuple[Scoring, Signatures]:
    columns = view.averaging.T @ view.seen.columns
    return view.scoring, replace(view.seen, columns=columns, residual=residual)


def _explained(means: Signatures, places: Sequence[int], residual: Array) -> float:
    """Fall of chi2 by several effects together, their tolerances as priors."""
    shape = np.hstack([means.of(means.candidates[k]) for k in places])
    along = shape.T @ residual
    return float(along @ np.linalg.solve(shape.T @ shape + np.eye(len(along)), along))


def _retaken(tried: _Hypothesis, known: Sequence[Fault]) -> _Scored | None:
    """What is left once the fault is taken back and all is identified anew, if it is noise."""
    fault = tried.fault
    try:
        after = signatures(solve(tried.problem, method="nested"))
    except NumericsError:
        return None
    for past in known:
        after = set_free(after, past.columns(tried.problem))
    if not after.candidates:
        return None
    there = View.of(after)
    scored = _scored(there, there.residual)
    swings = fault.kind == "exchanged_labels" or _swings(there, scored.places, fault)
    return scored if swings and _fits(there, scored.left) else None


def _swings(there: View, places: Sequence[int], fault: Fault) -> bool:
    """Whether the readings themselves say the factor, beside the effects."""
    seen = there.seen
    for place in places:
        seen = with_effect(seen, place)
    past = View.of(seen)
    readings = np.zeros(seen.count)
    readings[fault.rows] = seen.estimate.problem.measured[fault.rows]
    # Readings made small lose their say, and whatever troubled the setup is gone with them.
    least = _TOLD if fault.kind == "unit" else 0.0
    told = float(np.linalg.norm(past.shown(readings))) >= least
    return told and meant(past, fault.rows, 1.0)


def _hypotheses(view: View, setups: list[int]) -> list[_Hypothesis]:
    problem = view.seen.estimate.problem
    found = []
    for s in setups:
        rows = in_order(problem, s)
        for kind, factor in [("sign", -1.0), *(("unit", f) for f in UNITS)]:
            readings = problem.measured.copy()
            readings[rows] *= factor
            found.append(_meaning(problem, kind, rows, (s,), factor, readings))  # type: ignore[arg-type]
    said = under_each_label(problem, view.seen.estimate.x)
    for one, other in pairs_of_setups(problem, setups):
        a, b = in_order(problem, one), in_order(problem, other)
        rows = np.concatenate([a, b])
        if len(a) == len(b):
            readings = problem.measured.copy()
            readings[rows] = problem.measured[np.concatenate([b, a])]
            found.append(_meaning(problem, "exchanged_labels", rows, (one, other), 0.0, readings))
        if not same_commands(problem, one, other):
            value = view.seen.estimate.at.value
            change = np.zeros(len(value))
            change[a] = value[a] - said[a, other]
            change[b] = value[b] - said[b, one]
            fault = Fault("exchanged_labels", rows, (one, other), 1.0, 0.0)
            found.append(_Hypothesis(fault, change, exchanged(problem, (one, other))))
    return found


def _meaning(
    problem: Problem, kind: Kind, rows: Rows, setups: tuple[int, ...], size: float, readings: Array
) -> _Hypothesis:
    fault = Fault(kind, rows, setups, size, 0.0)
    return _Hypothesis(fault, readings - problem.measured, problem.with_readings(readings))
