"""Faults and changes that only the fit betrays, weighed against the effects of the catalogue.

Each is a hypothesis that competes with the best effect of the catalogue on the same residual of
station means, in the same form of evidence; then with an effect in the model beside it, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.diagnosis.changes import Changes, likeliest_changes
from orthoglide.diagnosis.command_faults import MENDS, change_of, command_faults
from orthoglide.diagnosis.faults import EVIDENCE, Fault, likeliest, untouched
from orthoglide.diagnosis.misreadings import (
    FACTORS,
    LABELS,
    Misreading,
    digits,
    factor_fits,
    misreadings,
    restored,
)
from orthoglide.diagnosis.repeat_faults import noise_scale
from orthoglide.diagnosis.scatter import Scatter
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.diagnosis.turns import turned
from orthoglide.fit import Problem
from orthoglide.ordering import EQUAL_ODDS, ranked
from orthoglide.units import MISTAKEN

MARGIN = 5.0
"""Log Bayes factor by which a fault must beat the best effect of the catalogue."""

_EFFECTS = 2  # of the catalogue that may be in the model
_LACK = 1.5  # chi2 a degree of freedom below which nothing is worth looking for
_HALVED = 0.6  # share of the rms of its own setups that a fault may leave
_APART = 3.0  # log Bayes factor between the best fault and the next one of other setups
_REPEATS = 4  # degrees of freedom from which the scatter of a setup says something of its unit
_LARGEST = 10.0  # log Bayes factor that the scatter may add
_QUIETER = 0.5  # of the variance of others, that a setup in a larger unit may have at most
_OUTLIER = 2.0  # chi2 a degree of freedom that an outlier without repeats may leave
_ALONE = 3e-4  # metres that an outlier must reach where its posture was visited only once
_PLAIN = 6.0  # log Bayes factor that the digits of a unit must give where the fit is not asked
_AS_OTHERS = 10.0  # times that the variance of a setup, once in its unit, may differ from others
_SMALL = 20.0  # factor of a unit beyond which no better dial explains its digits and its scatter
_VISIBLE = 0.2  # of its square, that the fit leaves of a fault
_SPOILT = 3.0  # resolutions that it must reach


def fit_fault(
    means: StationMeans, setups: Sequence[Scatter], known: Sequence[Fault]
) -> Fault | Changes | None:
    """The fault or changes that explain most of what a fit without the known faults leaves, if they
    do better than effects; setups of known faults take no part.
    """
    # Touches and distances show a change in few directions: it may hide in the chi2 of all.
    if means.problem.campaigns and not _lacking(means):
        return None
    changes = likeliest_changes(means)
    if not means.problem.campaigns:
        return changes
    free = untouched(means.problem, known)
    other = [f for f in known if f.kind != "outlier"]
    slipped = [s for s in untouched(means.problem, other) if s not in free]
    hypotheses = misreadings(means, free, slipped) + turned(means, free + slipped)
    commands = command_faults(means, known)  # beside effects they are left to `joint_fault`
    for _ in range(_EFFECTS + 1):
        misread = _misread(means, hypotheses, setups, known)
        best = likeliest(misread + _single(means, free) + commands, _APART)
        rival, place = means.best_effect
        if best is not None and best.evidence >= max(EVIDENCE, rival + MARGIN):
            if best.kind == "turns":  # which bend to much: they may leave no more than noise
                after = StationMeans.anew(restored(means.problem, best), known)
                if after is None or after.chi2 > MENDS * after.dof:
                    return changes  # beside effects they are left to `joint_fault`
            likelier = changes and _are_changes(changes, best, means, hypotheses)
            return changes if likelier else best
        commands = []
        if rival < EVIDENCE:
            break
        means = means.beside(place)
        if not _lacking(means):
            break
    return changes


def _are_changes(
    changes: Changes, fault: Fault, means: StationMeans, hypotheses: Sequence[Misreading]
) -> bool:
    """Whether changes are likelier than a fault, with all that both leave open."""
    found = changes.found
    readings = np.zeros(len(found.about.problem.measured))
    readings[fault.rows] = -fault.size
    if fault.commands:
        readings = change_of(means, fault)
    for one in hypotheses:
        same = (one.fault.kind, one.fault.size) == (fault.kind, fault.size)
        if one.fault.rows is fault.rows and same:
            readings = one.change
    tried = np.log(max(len(hypotheses), 1))
    return found.weight > found.about.evidence(readings) - tried


def _lacking(means: StationMeans) -> bool:
    return means.chi2 >= _LACK * means.dof * means.floor


def _misread(
    means: StationMeans,
    hypotheses: list[Misreading],
    setups: Sequence[Scatter],
    known: Sequence[Fault],
) -> list[Fault]:
    """A sign, a unit, a label, an exchange, turns: readings that fit once they are changed back."""
    if not hypotheses:
        return []
    shown = np.stack([means.shown(h.change) for h in hypotheses], axis=-1)
    after = means.residual[:, None] + shown
    evidence = means.evidence(np.sum(after**2, axis=0)) - np.log(len(hypotheses))
    evidence += [digits(means.problem, h.fault) + h.fault.evidence for h in hypotheses]
    found = []
    for k in np.flatnonzero(evidence >= EVIDENCE):
        fault, bonus = hypotheses[k].fault, 0.0
        if fault.kind == "unit":
            bonus = _scattering(means, setups, fault)
        if not _mended(means, fault, after[:, k]):
            continue
        # Wrong readings lead the fit far from where it belongs.
        left = np.array([np.sum(after[:, k] ** 2), _anew(means, hypotheses[k], known)])
        bonus += float(np.diff(means.evidence(left))[0])
        found.append(replace(fault, evidence=float(evidence[k] + bonus)))
    return found


def _anew(means: StationMeans, hypothesis: Misreading, known: Sequence[Fault]) -> float:
    """What is left where readings are put right and all is identified anew; all that there was
    where the readings themselves do not say that this is the fault.
    """
    fault = hypothesis.fault
    if fault.kind in FACTORS and not factor_fits(means, fault.rows, fault.size):
        return means.chi2
    after = StationMeans.anew(restored(means.problem, fault), known)
    if after is None or (fault.kind in LABELS and not hypothesis.leaves_none(means.problem, after)):
        return means.chi2
    return after.chi2


def _scattering(means: StationMeans, setups: Sequence[Scatter], fault: Fault) -> float:
    """Log Bayes factor of the repeats: in a larger unit a setup scatters less, and conversely."""
    scatter, factor = setups[fault.setups[0]], fault.size
    if scatter.dof < _REPEATS:
        return 0.0
    ratio = scatter.chi2 / scatter.dof / noise_scale(means.problem, setups)
    if factor > 1 and ratio > _QUIETER:
        return -np.inf
    if factor < 1 and (ratio < 0.1 / factor**2 or not scatter.repeats(means.problem)):
        return -np.inf
    return _unlike(scatter, max(ratio, 1e-12))


def _unlike(scatter: Scatter, ratio: float) -> float:
    """Log Bayes factor of a setup that scatters by a ratio of what others do, in squares."""
    return min(scatter.dof / 2 * float(ratio - 1 - np.log(ratio)), _LARGEST)


def unit_faults(problem: Problem, setups: Sequence[Scatter], known: Sequence[Fault]) -> list[Fault]:
    """Setups in a larger unit by their digits and their scatter alone, whatever the fit says.

    In metres or inches a dial seems not to move, and causes of the machine that are wrong explain
    that too.
    """
    found, scale = list[Fault](), noise_scale(problem, setups)
    for s in untouched(problem, known):
        scatter = setups[s]
        if scatter.dof < _REPEATS:
            continue
        ratio = max(scatter.chi2 / scatter.dof / scale, 1e-300)
        likely = []
        for factor in (f for f in MISTAKEN if f > _SMALL):
            fault = Fault("unit", scatter.rows, (s,), factor)
            told, own = digits(problem, fault), ratio * factor**2
            if told < _PLAIN or not 1 / _AS_OTHERS < own < _AS_OTHERS:
                continue
            odds = told + _unlike(scatter, ratio) - _unlike(scatter, own)
            likely.append(replace(fault, evidence=odds))
        found += _likeliest_unit(problem, likely, known)
    return found


def _likeliest_unit(problem: Problem, units: list[Fault], known: Sequence[Fault]) -> list[Fault]:
    """Of units that a setup may be in the one that fits best, effects beside it, and with it those
    that are nearly as likely; none where there are none.
    """
    if len(units) < 2:
        return units
    weighed = []
    for fault in units:
        after = StationMeans.anew(restored(problem, fault), known)
        if after is not None:
            (beside,) = after.explained(after.residual[:, None])
            fit = -after.dof / 2 * np.log(max(beside.left, after.dof) / after.dof)
            weighed.append(replace(fault, evidence=fault.evidence + float(fit)))
    ordered = ranked(weighed, lambda f: f.evidence, EQUAL_ODDS)
    near = [f.size for f in ordered if ordered[0].evidence - f.evidence < _APART]
    return [replace(f, sizes=tuple(near)) for f in ordered[:1]]


def _mended(means: StationMeans, fault: Fault, after: np.ndarray) -> bool:
    """Whether the setups' own residuals shrink: a fault that mends others is none."""
    problem = means.problem
    rows = np.isin(problem.setup_of_row, fault.setups)
    here = np.flatnonzero(rows[problem.weighing.first])
    before, size = (float(np.linalg.norm(r[here])) for r in (means.residual, after))
    return size <= max(_HALVED * before, 2 * float(np.sqrt(rows.sum())))


def _single(means: StationMeans, setups: list[int]) -> list[Fault]:
    """Outliers where no repeat can show them.

    A knock is not looked for there: a step in time is a step in posture as well.
    """
    problem = means.problem
    visits = np.bincount(problem.station)[problem.station]
    rows = np.flatnonzero((visits == 1) & np.isin(problem.setup_of_row, setups))
    if not len(rows):
        return []
    stations = problem.station[rows]
    sigma = problem.weighing.mean_sigma[stations]
    alone = np.arange(len(means.seen))
    each = means.together(np.ones(len(alone)), alone)
    square, along, _ = (values[stations] for values in each)
    # What the fit can imitate almost wholly is no fault that it could show.
    visible = square > _VISIBLE
    square, along = square / sigma**2, along / sigma
    size = along / np.maximum(square, 1e-300)
    after = means.chi2 - along * size
    evidence = means.evidence(after, 1) - np.log(len(rows))
    # A cause in no catalogue looks much the same: only what mends the fit counts, and where no
    # other visit bears witness it must be a slip larger than such causes are.
    least = _SPOILT * problem.step[rows]
    witnessed = np.bincount(problem.place)[problem.place][rows] > 1
    needed = np.where(witnessed, least, np.maximum(least, _ALONE))
    sure = visible & (np.abs(size) >= needed) & (after <= _OUTLIER * means.dof)
    return [
        Fault(
            "outlier",
            rows[[k]],
            (int(problem.setup_of_row[rows[k]]),),
            float(size[k]),
            float(evidence[k]),
        )
        for k in np.flatnonzero(sure & (evidence >= EVIDENCE))
    ]
