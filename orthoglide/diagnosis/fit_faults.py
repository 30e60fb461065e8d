"""Faults that only the fit betrays: a sign, a unit, two labels, a dial that stuck, no repeats.

Each is a hypothesis about the readings that competes with the best effect of the catalogue on the
same residual, seen through station means, as systematic errors repeat. Both are scored alike, the
noise known no better than what is left says: Student's form of the evidence,
``dof / 2 log(chi2 before / chi2 after)`` with chi2 never taken below the noise itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.diagnosis.changes import Change, likeliest_change
from orthoglide.diagnosis.fault_view import View, set_free, with_effect
from orthoglide.diagnosis.faults import UNITS, Fault, Rows, in_order
from orthoglide.diagnosis.repeat_faults import EVIDENCE, Within, scatter
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.diagnosis.significance import within_groups
from orthoglide.errors import NumericsError
from orthoglide.fit import Problem, solve
from orthoglide.geometry import Array

MARGIN = 5.0
"""Log Bayes factor by which a fault must beat the best effect of the catalogue."""

CHANGE_MARGIN = 3.0
"""The same for a change between campaigns: there are about as many changes as effects."""

_EFFECTS = 2  # of the catalogue that may be in the model beside a fault
_EFFECTS_BESIDE_A_CHANGE = 5
_WORTH = 2.0  # evidence of an effect that is taken into the model beside a change
_LACK = 1.5  # chi2 a degree of freedom below which nothing is worth looking for
_HALVED = 0.6  # share of the rms of its own setups that a fault may leave
_APART = 3.0  # log Bayes factor between the best fault and the next one of other setups
_OFF_GRID = 0.06  # of the dial's step: six decimals of a millimetre, in metres
_DIGITS = 10.0  # log Bayes factor that the digits may add or take at most
_RELABELLED = 2  # pairs of setups that are identified anew with their labels exchanged
_MASSIVE = 300.0  # chi2 a degree of freedom that puts the linearisation itself in doubt
_REPEATS = 4  # degrees of freedom from which the scatter of a setup says something of its unit
_FACTOR = 0.15  # relative error of a sign's or unit's factor that the readings themselves may give
_MENDS = 2.0  # chi2 a degree of freedom that an outlier without repeats may leave
_ALONE = 3e-4  # metres that an outlier must reach where its posture was visited only once
_SPOILT = 3.0  # resolutions that it must reach


def fit_fault(seen: Signatures, known: Sequence[Fault]) -> Fault | Change | None:
    """The fault or change that explains most of what a fit leaves, if it does better than effects.

    Args:
        seen: signatures at the fit of the readings without the known faults.
        known: faults found before; their rows take no part.
    """
    problem = seen.estimate.problem
    for fault in known:
        seen = set_free(seen, fault.columns(problem))
    faulty = True
    for effects in range(_EFFECTS_BESIDE_A_CHANGE + 1):
        view = View.of(seen)
        if view.chi2 < _LACK * view.dof * view.floor:
            return None
        best = _best(list(_hypotheses(view, known))) if faulty else None
        change = likeliest_change(view)
        rival, place = view.rival
        if change is not None and change.evidence >= max(
            EVIDENCE, rival + CHANGE_MARGIN, best.evidence if best else -np.inf
        ):
            return change
        if best is not None and best.evidence >= max(EVIDENCE, rival + MARGIN):
            return best
        faulty = faulty and rival >= EVIDENCE and effects < _EFFECTS
        if place < 0 or rival < _WORTH or not (faulty or change):
            return None
        seen = with_effect(seen, place)
    return None


def _best(faults: list[Fault]) -> Fault | None:
    """The most probable fault, unless one of other setups is nearly as probable."""
    if not faults:
        return None
    best = max(faults, key=lambda f: f.evidence)
    others = [f.evidence for f in faults if not set(f.setups) & set(best.setups)]
    return best if best.evidence - max(others, default=-np.inf) >= _APART else None


def _hypotheses(view: View, known: Sequence[Fault]) -> Iterator[Fault]:
    touched = {s for f in known for s in f.setups}
    problem = view.seen.estimate.problem
    setups = [s for s in range(problem.setup_count) if s not in touched]
    yield from _changed(view, setups)
    yield from _relabelled(view, setups)
    yield from _single(view, setups)


# -- readings that mean something else ------------------------------------------------------------


def _changed(view: View, setups: list[int]) -> Iterator[Fault]:
    """A sign, a unit, or two columns exchanged: readings that fit once they are changed back."""
    problem = view.seen.estimate.problem
    measured = problem.measured
    found: list[tuple[str, tuple[int, ...], Rows, Array, float]] = []
    for s in setups:
        rows = in_order(problem, s)
        found.append(("sign", (s,), rows, -measured[rows], -1.0))
        found += [("unit", (s,), rows, f * measured[rows], f) for f in UNITS]
    for one, other in pairs_of_setups(problem, setups):
        a, b = in_order(problem, one), in_order(problem, other)
        if len(a) == len(b):
            rows = np.concatenate([a, b])
            found.append(
                ("exchanged_labels", (one, other), rows, measured[np.concatenate([b, a])], 0.0)
            )
    if not found:
        return
    change = np.zeros((len(measured), len(found)))
    for column, (_, _, rows, values, _) in zip(change.T, found, strict=True):
        column[rows] = values - measured[rows]
    after = np.sum((view.residual[:, None] + view.shown(change)) ** 2, axis=0)
    evidence = view.evidence(after) - np.log(len(found))
    evidence += [grain(problem, f[2], f[4]) if f[0] == "unit" else 0.0 for f in found]
    for k in np.flatnonzero(evidence >= EVIDENCE):
        kind, own, rows, _, size = found[k]
        swings = kind == "exchanged_labels" or meant(view, rows, size)
        bonus = _scattering(view, own[0], size) if kind == "unit" else 0.0
        if swings and _mended(view, own, change[:, k]):
            yield Fault(kind, rows, own, size, float(evidence[k]) + bonus)  # type: ignore[arg-type]


def grain(problem: Problem, rows: Rows, factor: float) -> float:
    """Log Bayes factor of the digits: in its own unit a dial shows multiples of its step."""
    step = problem.machine.spec.dial.resolution
    if step <= 0:
        return 0.0

    def on_grid(readings: Array) -> bool:
        return bool((np.abs(readings / step - np.round(readings / step)) < _OFF_GRID).all())

    readings, others = problem.measured[rows], np.ones(len(problem.measured), dtype=bool)
    others[rows] = False
    if not on_grid(problem.measured[others]):
        return 0.0
    decimal = abs(np.log10(factor) - round(float(np.log10(factor)))) < 1e-9
    if not on_grid(readings * factor) or (on_grid(readings) and factor > 1):
        # A point put elsewhere moves the grid along; a conversion may have been rounded again.
        return -_DIGITS if decimal else 0.0
    values = len(np.unique(readings)) - 1
    chance = 2 * _OFF_GRID if factor > 1 else max(factor, 2 * _OFF_GRID)
    return min(-values * float(np.log(chance)), _DIGITS)


def _scattering(view: View, setup: int, factor: float) -> float:
    """Log Bayes factor of the repeats: in a larger unit a setup scatters less, and conversely."""
    problem = view.seen.estimate.problem
    every = [Within.of(view.seen.estimate, s, ()) for s in range(problem.setup_count)]
    own = every[setup]
    if own.dof < _REPEATS:
        return 0.0
    ratio = float(own.rest @ own.rest) / own.dof / scatter(problem, every)
    if factor > 1:
        return 0.0 if ratio <= 0.5 else -np.inf
    if ratio < 0.1 / factor**2:
        return -np.inf
    return min(own.dof / 2 * float(ratio - 1 - np.log(ratio)), _DIGITS)


def meant(view: View, rows: Rows, factor: float) -> bool:
    """Whether the factor that fits best is this one: flat readings would fit any small factor."""
    readings = np.zeros(view.seen.count)
    readings[rows] = view.seen.estimate.problem.measured[rows]
    shown = view.shown(readings)
    square = max(float(shown @ shown), 1e-300)
    best, sigma = 1 - float(shown @ view.residual) / square, 1 / np.sqrt(square)
    allowed = _FACTOR * abs(factor)
    return bool(abs(best - factor) <= max(allowed, 3 * min(sigma, allowed)))


def _mended(view: View, setups: tuple[int, ...], change: Array) -> bool:
    """Whether the setups' own residuals shrink: a fault that mends others is none."""
    rows = np.isin(view.seen.estimate.problem.setup_of_row, setups)
    before = view.seen.residual[: view.seen.count]
    after = before + view.seen.whiten(change)[: view.seen.count]
    noise = np.sqrt(rows.sum()) * 2
    size = float(np.linalg.norm(after[rows]))
    return size <= max(_HALVED * float(np.linalg.norm(before[rows])), noise)


def pairs_of_setups(problem: Problem, setups: list[int]) -> Iterator[tuple[int, int]]:
    """Two setups of one campaign."""
    ends = np.cumsum([len(c.setups) for c in problem.campaigns])
    home = np.searchsorted(ends, np.arange(problem.setup_count), side="right")
    for k, one in enumerate(setups):
        yield from ((one, other) for other in setups[k + 1 :] if home[one] == home[other])


def _relabelled(view: View, setups: list[int]) -> Iterator[Fault]:
    """Two setups that carry each other's leg, direction and place while the commands stay."""
    problem = view.seen.estimate.problem
    value = view.seen.estimate.at.value
    pairs = [p for p in pairs_of_setups(problem, setups) if not same_commands(problem, *p)]
    if not pairs:
        return
    said = under_each_label(problem, view.seen.estimate.x)
    change = np.zeros((len(value), len(pairs)))
    for k, (one, other) in enumerate(pairs):
        a, b = in_order(problem, one), in_order(problem, other)
        change[a, k] = value[a] - said[a, other]
        change[b, k] = value[b] - said[b, one]
    after = np.sum((view.residual[:, None] + view.shown(change)) ** 2, axis=0)
    for k in np.argsort(after)[:_RELABELLED]:
        if view.chi2 < _MASSIVE * view.dof and after[k] > view.chi2 / 2:
            continue
        exact = _refitted(view, pairs[k])
        if exact is None:
            continue
        evidence = float(view.evidence(np.array(exact))) - float(np.log(len(pairs)))
        if evidence >= EVIDENCE:
            rows = np.concatenate([in_order(problem, s) for s in pairs[k]])
            yield Fault("exchanged_labels", rows, pairs[k], 1.0, evidence)


def _refitted(view: View, pair: tuple[int, int]) -> float | None:
    """Square of the station means' residual with two setups' labels exchanged, identified anew.

    Wrong labels lead the fit far from where it belongs: its linearisation is no guide there.
    """
    try:
        fit = solve(exchanged(view.seen.estimate.problem, pair), method="nested")
    except NumericsError:
        return None
    return fit.scores.chi2 - within_groups(view.seen)


def exchanged(problem: Problem, pair: tuple[int, int]) -> Problem:
    """The problem with the labels of two setups of one campaign exchanged."""
    ends = np.cumsum([len(c.setups) for c in problem.campaigns])
    home = int(np.searchsorted(ends, pair[0], side="right"))
    first = int(ends[home]) - len(problem.campaigns[home].setups)
    one, other = pair[0] - first, pair[1] - first
    setups = list(problem.campaigns[home].setups)
    setups[one], setups[other] = (
        replace(setups[other], name=setups[one].name),
        replace(setups[one], name=setups[other].name),
    )
    campaigns = list(problem.campaigns)
    campaigns[home] = replace(campaigns[home], setups=tuple(setups))
    return replace(problem, campaigns=tuple(campaigns))


def same_commands(problem: Problem, one: int, other: int) -> bool:
    """Whether two setups were read at the same commands, in the same order."""
    commands = np.concatenate([c.command for c in problem.campaigns])
    a, b = in_order(problem, one), in_order(problem, other)
    return len(a) == len(b) and np.allclose(commands[a], commands[b], atol=1e-6)


def under_each_label(problem: Problem, x: Array) -> Array:
    """What every row would read, datums apart, were it of each setup ``(n, setups)``, metres."""
    said = np.full((len(problem.measured), problem.setup_count), np.nan)
    first = 0
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.rows, strict=True)):
        count, n = len(campaign.setups), len(campaign)
        every = campaign.subset(np.tile(np.arange(n), count))
        every = replace(every, setup=np.repeat(np.arange(count), n))
        values = problem.machine.model.readings(problem.values(k, x), every)
        said[rows, first : first + count] = values.reshape(count, n).T
        first += count
    return said


# -- rows that contradict the rest ----------------------------------------------------------------


def _single(view: View, setups: list[int]) -> Iterator[Fault]:
    """Outliers where no repeat can show them.

    A knock is not looked for there: a step in time is a step in posture as well.
    """
    problem = view.seen.estimate.problem
    visits = np.bincount(problem.station)[problem.station]
    rows = np.flatnonzero((visits == 1) & np.isin(problem.setup_of_row, setups))
    if not len(rows):
        return
    shown = view.shown(np.eye(len(problem.measured))[:, rows])
    square = np.sum(shown**2, axis=0)
    along = shown.T @ view.residual
    # What the fit can imitate almost wholly is no fault that it could show.
    seen = square > 0.2 * view.seen.weight[rows] ** 2
    size = along / np.maximum(square, 1e-300)
    after = view.chi2 - along * size
    evidence = view.evidence(after, 1) - np.log(len(rows))
    least = _SPOILT * problem.machine.spec.dial.resolution
    # A cause in no catalogue looks much the same: only what mends the fit counts, and where no
    # other visit bears witness it must be a slip larger than such causes are.
    where = np.column_stack(
        [problem.setup_of_row, np.vstack([c.command for c in problem.campaigns])]
    )
    _, place, count = np.unique(where, axis=0, return_inverse=True, return_counts=True)
    needed = np.where(count[place.reshape(-1)][rows] > 1, least, max(least, _ALONE))
    sure = seen & (np.abs(size) >= needed) & (after <= _MENDS * view.dof)
    for k in np.flatnonzero(sure & (evidence >= EVIDENCE)):
        own = int(problem.setup_of_row[rows[k]])
        yield Fault("outlier", rows[[k]], (own,), float(size[k]), float(evidence[k]))
