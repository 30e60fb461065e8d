"""Commands that are not those written: of one posture, on one drive.

A drive or a rail that is wrong somewhere shows at all postures that pass there; a wrong command at
its own posture alone, in each dial by as much as the drive moves it: one number for all readings
of the posture. Postures are ranked by the linearisation at the fit, all at once; the best of them
are identified anew with the command put right, as a slipped digit is far from linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Rows, campaign_of
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.errors import InputError, NumericsError
from orthoglide.fit import Problem, with_free
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.geometry import LEGS, Array
from orthoglide.observations import Readings
from orthoglide.observations.arrays import numbered
from orthoglide.ordering import EQUAL_ODDS, descending, ranked

MENDS = 1.5
"""Chi2 a degree of freedom that a wrong command may leave: small errors of everything stay."""

_VISIBLE = 0.02  # of its square, that the fit leaves of a wrong command once it is put right
_ROUNDING = 1e-9  # the same before: there a dial that stands elsewhere imitates a slipped digit
_LEAST = 5e-5  # metres that it must reach
_USUAL = 1e-3  # metres that it may well be
_SIGMAS = 5.0  # standard deviations of its size that it must reach
_BEYOND = 1e-3  # metres beyond the stroke that no drive was
_TRIED = 6  # hypotheses that are identified anew
_ASIDE = 12  # postures that are set aside, one at a time, to see what effects leave of the rest
_POSTURES = 2  # of these that are identified anew, beside the effects
_DRIVES = 0.1  # of the gain of the best drive of a posture, that others must have to be tried
_ROUNDS = 5  # of finding its size
_SETTLED = 2e-6  # metres, of a step
_SHARE = 0.5  # of chi2, that it may leave whatever its size
_APART = 3.0  # log Bayes factor from which one drive is likelier than another
_STEP = 1e-5  # metres, of a difference quotient


def postures(problem: Problem) -> Rows:
    """Posture of each reading ``(n,)``: one for each campaign and command; -1 where no dial is."""
    campaigns = problem.campaigns
    number = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
    found = np.full(len(problem.measured), -1)
    found[: len(number)] = numbered(np.column_stack([number, problem.of_dials("command")]))
    return found


def slopes(problem: Problem, x: Array, value: Array) -> Array:
    """Derivative of every reading by its own command ``(n, 3)``.

    Args:
        problem: with dials.
        x: its unknowns ``(P,)``, SI.
        value: the readings there ``(n,)``, metres.
    """
    found = np.zeros((len(value), len(LEGS)))
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.rows, strict=True)):
        values = problem.values(k, x)
        for drive in range(len(LEGS)):
            moved = replace(campaign, command=campaign.command + _STEP * np.eye(3)[drive])
            read = problem.machine.model.readings(values, moved)
            found[rows, drive] = (read - value[rows]) / _STEP
    return found


def put_right(campaign: Readings, rows: Rows, drive: int, size: float) -> Readings:
    """The campaign with another command in some rows, metres, and the approach that follows."""
    command = campaign.command.copy()
    command[rows, drive] += size
    moved = replace(campaign, command=command)
    derived = campaign.approach == campaign.derived_approach
    approach = np.where(derived, moved.derived_approach, campaign.approach)
    return replace(moved, approach=approach)


def all_put_right(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """The problem with the likeliest commands in the rows of faults of that kind."""
    factors = list(problem.on_legs)
    for fault in faults:
        for drive, size in fault.commands[:1]:
            k = campaign_of(problem, fault.rows)
            within = fault.rows - problem.rows[k].start
            moved = put_right(factors[k].readings, within, drive, size)
            factors[k] = factors[k].with_table(moved)
    return problem.with_factors(factors)


@dataclass(frozen=True)
class _Scores:
    """All postures ``H`` and drives at one fit."""

    posture: Rows  # of each reading (n,)
    square: Array  # of a metre in the station means, past the fit (H, 3)
    along: Array  # of this in the residual (H, 3)
    left: Array  # share of its square that the fit does not imitate (H, 3)

    @classmethod
    def of(cls, means: StationMeans, posture: Rows) -> _Scores:
        estimate, weighing = means.signatures.estimate, means.problem.weighing
        moved = weighing.along(
            weighing.whiten(slopes(means.problem, estimate.x, estimate.at.value))
        )
        group = posture[weighing.first] + 1  # the first is of readings that are no dial's
        found = [means.together(moved[:, drive], group) for drive in range(len(LEGS))]
        square, along, whole = (np.stack(v, axis=1)[1:] for v in zip(*found, strict=True))
        return cls(posture, square, along, square / np.maximum(whole, 1e-300))

    @property
    def size(self) -> Array:
        """What fits best ``(H, 3)``, metres."""
        return np.asarray(self.along / np.maximum(self.square, 1e-300))

    @property
    def gain(self) -> Array:
        """Fall of chi2 ``(H, 3)``."""
        return np.where(self.left > _ROUNDING, self.along * self.size, 0.0)

    def fault(self, problem: Problem, place: int, drive: int, size: float) -> Fault:
        """The hypothesis."""
        rows = np.flatnonzero(self.posture == place)
        setups = tuple(np.unique(problem.setup_of_row[rows]).tolist())
        return Fault("command", rows, setups, size, commands=((drive, size),))


def command_faults(means: StationMeans, known: Sequence[Fault]) -> list[Fault]:
    """Commands which, put right, leave no more than noise, no effect of the machine beside them;
    rows of known faults take no part.
    """
    if not means.signatures.candidates:
        return []
    (bare,) = means.explained(means.residual[:, None])
    posture = _free(means.problem, known)
    likely, count = _likely(means, posture, known)
    found = []
    for first in likely:
        after = settled(means.problem, first, known, means.chi2)
        if after is None or after[1].chi2 > MENDS * after[1].dof:
            continue
        fault, left = after
        # Two effects that fit as well are as likely as one wrong command.
        if bare.score > -left.chi2 / 2 - np.log(count):
            continue
        odds = float(means.evidence(np.array(left.chi2), 1)) - float(np.log(count))
        found.append(replace(fault, evidence=odds + fault.evidence))
    return told(found)


def _likely(means: StationMeans, posture: Rows, known: Sequence[Fault]) -> tuple[list[Fault], int]:
    """The likeliest commands by the linearisations at the fit and where it started, and of how
    many: a slipped digit leads a fit far from where it belongs.
    """
    found: dict[tuple[int, int], Fault] = {}
    count = 1
    for base in (means, StationMeans.of(begun(means), known)):
        scores = _Scores.of(base, posture)
        count = max(scores.gain.size, 1)
        evidence = base.evidence(base.chi2 - scores.gain, 1) - np.log(count)
        for k in descending(evidence, EQUAL_ODDS)[:_TRIED]:
            place, drive = divmod(k, len(LEGS))
            if evidence[place, drive] >= EVIDENCE:
                size = float(scores.size[place, drive])
                found[place, drive] = scores.fault(means.problem, place, drive, size)
    return list(found.values()), count


def begun(means: StationMeans) -> Signatures:
    """Everything about the machine where the fit started."""
    estimate, problem = means.signatures.estimate, means.problem
    at = linearise(problem, problem.start)
    nuisance = nuisances(problem, at.seen)
    return signatures(replace(estimate, x=problem.start, at=at, nuisance=nuisance))


def commands_beside(means: StationMeans, known: Sequence[Fault], before: float) -> list[Fault]:
    """Commands which, put right, leave least beside one or two effects of the machine, of which the
    best alone leave a chi2 ``before``; rows of known faults take no part.
    """
    problem, posture = means.problem, _free(means.problem, known)
    base = begun(means)
    scores = _Scores.of(StationMeans.of(base, known), posture)
    weighed = []
    for place in descending(scores.gain.max(axis=1), EQUAL_ODDS)[:_ASIDE]:
        aside = scores.fault(problem, place, 0, 0.0)
        rest = StationMeans.of(base, [*known, aside])
        (explained,) = rest.explained(rest.residual[:, None])
        if explained.left < _SHARE * before:
            weighed.append((explained.left - rest.dof, place, explained.places))
    found = []
    for _, place, places in ranked(weighed, lambda one: -one[0], EQUAL_ODDS)[:_POSTURES]:
        names = [n for p in places for n in base.candidates[p].parameters]
        try:
            wide = with_free(problem, names) if names else problem
        except (InputError, NumericsError):
            continue
        gain = scores.gain[place]
        for drive in np.flatnonzero(gain > _DRIVES * gain.max()).tolist():
            first = scores.fault(problem, place, drive, float(scores.size[place, drive]))
            after = settled(wide, first, known, means.chi2)
            found += [after[0]] if after is not None else []
    return found


def settled(
    problem: Problem, fault: Fault, known: Sequence[Fault], before: float
) -> tuple[Fault, StationMeans] | None:
    """A wrong command of about some size with that found anew, and the station means, of which chi2
    was ``before``, with it put right; rows of known faults take no part.

    Its evidence is the logarithm of what the readings leave of the sizes that it may have.

    Returns:
        None where no size fits, or none that a machine could have been told.
    """
    ((drive, size),) = fault.commands
    own = np.full(len(problem.measured), -1)
    own[fault.rows] = 0
    # Where a machine can have been.
    geometry, written = problem.machine.geometry, problem.of_dials("command")[fault.rows[0], drive]
    travel = float(written - geometry.zero[drive])
    least, most = geometry.stroke[0] - _BEYOND - travel, geometry.stroke[1] + _BEYOND - travel
    last = np.inf
    for k in range(_ROUNDS):
        size = float(np.clip(size, least, most))
        fault = replace(fault, size=size, commands=((drive, size),))
        after = StationMeans.anew(all_put_right(problem, [fault]), known)
        # At first a slip of ten may leave more than a dial that stands elsewhere.
        if after is None or (k and after.chi2 > _SHARE * before):
            return None
        means, scores = after, _Scores.of(after, own)
        step = float(scores.size[0, drive])
        if abs(step) < _SETTLED:
            break
        if abs(step) > last / 2:
            return None
        size, last = size + step, abs(step)
    sigma = 1 / float(np.sqrt(max(scores.square[0, drive], 1e-300)))
    settles = abs(step) < _SETTLED and scores.left[0, drive] > _VISIBLE
    if not settles or abs(size) < max(_LEAST, _SIGMAS * sigma):
        return None
    return replace(fault, evidence=-float(np.log(max(_USUAL, abs(size)) / sigma))), means


def told(faults: Sequence[Fault]) -> list[Fault]:
    """Faults with the drives of one posture that fit nearly as well as one."""
    found: list[Fault] = []
    for fault in ranked(faults, lambda f: f.evidence, EQUAL_ODDS):
        at = next((k for k, f in enumerate(found) if np.array_equal(f.rows, fault.rows)), None)
        if at is None:
            found.append(fault)
        elif found[at].evidence - fault.evidence < _APART:
            found[at] = replace(found[at], commands=found[at].commands + fault.commands)
    return found


def change_of(means: StationMeans, fault: Fault) -> Array:
    """What the residual changes by once the command is put right ``(n,)``, metres."""
    estimate = means.signatures.estimate
    ((drive, size), *_) = fault.commands
    change = np.zeros(len(means.problem.measured))
    moved = slopes(means.problem, estimate.x, estimate.at.value)[:, drive]
    change[fault.rows] = -size * moved[fault.rows]
    return change


def _free(problem: Problem, known: Sequence[Fault]) -> Rows:
    """Posture of each reading, -1 for those of known faults and where there is but one reading,
    which is an outlier, whatever slipped.
    """
    posture = postures(problem)
    for fault in known:
        if fault.sets_aside:
            posture[fault.rows] = -1
    counts = np.bincount(posture + 1)
    return np.asarray(np.where(counts[posture + 1] > 1, posture, -1))
