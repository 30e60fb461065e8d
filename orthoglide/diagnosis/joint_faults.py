"""A sign, a unit, labels or turns weighed together with the causes of the machine beside them.

One at a time, a fault of the data loses against a real error of the machine, and the error, in a
model of wrong readings, takes another shape. Here each hypothesis is scored with its own best
effects: ``-chi2 / 2 + max(best single evidence, best evidence of a pair)``, on station means. It
must beat the readings as they stand, with any pair or family of the catalogue, by a margin, and
leave no more than noise where these leave more. Hypotheses are ranked by the linearisation at the
fit and the best of them identified anew, as wrong readings lead the fit far from where it belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.diagnosis.command_faults import MENDS, commands_beside, postures, told
from orthoglide.diagnosis.faults import Fault, likeliest, same_place, untouched
from orthoglide.diagnosis.misreadings import (
    LABELS,
    Misreading,
    digits,
    factor_fits,
    misreadings,
    only,
    restored,
)
from orthoglide.diagnosis.station_means import Explained, StationMeans
from orthoglide.diagnosis.turns import turned
from orthoglide.errors import InputError, NumericsError
from orthoglide.fit import with_free
from orthoglide.geometry import LEGS
from orthoglide.ordering import EQUAL_ODDS, descending, largest

_MARGIN = 12.0  # log Bayes factor, the hypotheses' number discounted, over the readings as they are
_SPREAD = 2.5  # standard deviations of chi2 by which a fault and its effects may exceed noise
_SHARE = 0.5  # of what the best effects alone leave, that a fault and its effects may leave
_REFITS = 8  # hypotheses that are identified anew
_TURNS = 3  # of whole turns, which bend to much
_SIGMAS = 30.0  # of the station means, by which readings must swing past fit and effects
_FEWEST = 6.0  # degrees of freedom of station means: fewer tell nothing of two effects and a fault
_APART = 6.0  # log Bayes factor between the best fault and the next one of other setups


def joint_fault(means: StationMeans, known: Sequence[Fault]) -> Fault | None:
    """The sign, unit, exchange or whole turns that fit with one or two effects where no effects fit
    alone; setups of known faults take no part.
    """
    problem = means.problem
    if not (problem.campaigns and means.signatures.candidates) or means.dof < _FEWEST:
        return None
    if _is_noise(means, means.chi2):
        return None
    (bare,) = means.explained(means.residual[:, None])
    # The family that leaves least counts as well: is there any explanation but a fault?
    gains, evidences = means.scoring.gains(means.residual), means.scoring.evidences(means.residual)
    bare_left = min(bare.left, means.chi2 - float(gains.max()))
    bare_score = max(bare.score, float(evidences.max()) - means.chi2 / 2)
    hypotheses = misreadings(means, untouched(problem, known))
    turns = turned(means, untouched(problem, [f for f in known if f.kind != "outlier"]))
    if _is_noise(means, bare_left):
        return None
    nothing = np.zeros(len(problem.measured))
    likely = [(len(hypotheses), h) for h in _ranked(means, hypotheses)[:_REFITS]]
    likely += [(len(turns), h) for h in _ranked(means, turns)[:_TURNS]]
    places = len(LEGS) * (int(postures(problem).max()) + 1)
    likely += [(places, Misreading(f, nothing)) for f in commands_beside(means, known, bare_left)]
    faults = []
    for tried, hypothesis in likely:
        after = _identified(means, hypothesis, known)
        if after is None or after.left > _SHARE * bare_left:
            continue
        gain = after.score - bare_score - np.log(tried)
        gain += digits(problem, hypothesis.fault) + hypothesis.fault.evidence
        if gain >= _MARGIN:
            faults.append(replace(hypothesis.fault, evidence=float(gain)))
    best = likeliest(told(faults), _APART, _same)
    if best is None:
        return None
    rivals = {bare.places, (largest(gains, EQUAL_ODDS),), (largest(evidences, EQUAL_ODDS),)}
    return None if any(_fits(means, places, known) for places in rivals) else best


def _ranked(means: StationMeans, hypotheses: Sequence[Misreading]) -> list[Misreading]:
    """Signs, units, labels or turns, each with its own best effects, the likeliest first."""
    if not hypotheses:
        return []
    shown = np.stack([means.shown(h.change) for h in hypotheses], axis=-1)
    scores = [e.score for e in means.explained(means.residual[:, None] + shown)]
    scores = [s + h.fault.evidence for s, h in zip(scores, hypotheses, strict=True)]
    return [hypotheses[k] for k in descending(scores, EQUAL_ODDS)]


def _same(one: Fault, other: Fault) -> bool:
    """Whether two faults are about the same setups, of commands the same posture."""
    commands = "command" in (one.kind, other.kind)
    return same_place(one, other) if commands else one.setups == other.setups


def _fits(means: StationMeans, places: Sequence[int], known: Sequence[Fault]) -> bool:
    """Whether effects alone, identified anew as the faults are, leave no more than noise.

    A dial far from its direction is what a wrong label is; an effect of the machine may be far.
    """
    problem, candidates = means.problem, [means.signatures.candidates[p] for p in places]
    names = [name for c in candidates for name in c.parameters]
    machines = not any(problem.machine.catalogue.effect_of(n).of_dial for n in names)
    try:
        wide = with_free(problem, names)
    except (InputError, NumericsError):
        return False
    after = StationMeans.anew(wide, known, widen=machines)
    return after is not None and _is_noise(after, after.chi2)


def _is_noise(means: StationMeans, left: float) -> bool:
    """Whether chi2 of station means is that of noise, a little of everything allowed for."""
    return left <= means.dof + _SPREAD * np.sqrt(2 * means.dof)


def _identified(
    means: StationMeans, hypothesis: Misreading, known: Sequence[Fault]
) -> Explained | None:
    """What is left once the fault is taken back and all is identified anew, if it is noise."""
    after = StationMeans.anew(restored(means.problem, hypothesis.fault), known)
    if after is None or not after.signatures.candidates:
        return None
    (explained,) = after.explained(after.residual[:, None])
    command = hypothesis.fault.kind == "command" and explained.left <= MENDS * after.dof
    if not command and not _is_noise(after, explained.left):
        return None
    for place in explained.places:
        after = after.beside(place)
    # The readings themselves have to say the factor, beside the effects.
    kind, rows, says = hypothesis.fault.kind, hypothesis.fault.rows, True
    if kind in LABELS:
        says = hypothesis.leaves_none(means.problem, after)
    elif kind not in ("command", "turns"):
        shown = after.shown(only(rows, after.problem.measured))
        # Readings made small lose their say, and whatever troubled the setup is gone with them.
        least = _SIGMAS if kind == "unit" else 0.0
        says = float(np.linalg.norm(shown)) >= least and factor_fits(after, rows, 1.0)
    return explained if says else None
