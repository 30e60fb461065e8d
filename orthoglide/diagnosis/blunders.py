"""Faults of the data, before any physics: found, named with their rows, and set aside in the open.

Data faults, changes between campaigns and causes of the machine compete on the same readings. What
repeats contradict is no cause that depends on the posture (`repeat_faults`); a command, a sign, a
unit, labels, whole turns, a stuck dial or a change must explain the readings better than the best
effect of the catalogue (`fit_faults`, `command_faults`, `joint_faults`, `stuck_faults`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.changes import Change, Changes, separated, visits
from orthoglide.diagnosis.command_faults import all_put_right, put_right
from orthoglide.diagnosis.faults import DATUMS, Fault, Kind, Rows, message, parts, places, steps
from orthoglide.diagnosis.fit_faults import fit_fault, unit_faults
from orthoglide.diagnosis.joint_faults import joint_fault
from orthoglide.diagnosis.misreadings import restored, with_noise_of_the_rest, without_weight
from orthoglide.diagnosis.repeat_faults import repeat_faults, scatter_faults, searches
from orthoglide.diagnosis.scatter import Scatter
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.diagnosis.stuck_faults import stuck_faults
from orthoglide.diagnosis.tool_faults import solved_without, tool_slips
from orthoglide.errors import InputError, NumericsError
from orthoglide.fit import Estimate, Factor, Problem, solve
from orthoglide.fit.least_squares import known_rows
from orthoglide.fit.scores import rms_by_unit
from orthoglide.geometry import Array
from orthoglide.observations import Readings

_MOST = 8
"""Slips: what is left beyond them is for a person to look at."""

_REFITS = 3
"""Faults of whole setups that are looked for one after the other, each at a new fit."""

_CHANGED = 2
"""Rounds more where something may have changed: before a fault of the data and beside it."""

MEANINGS = ("sign", "unit", "label", "exchanged_labels", "shifted")
"""Faults by which readings mean something else than they seem to."""

_FEW = 6
"""Postures of a mounting: a part that goes wrong smoothly, over 30 mm of 160, is no single one of
more."""

_DOUBTED = ("command", *MEANINGS)
"""Faults that a part which goes wrong in its own way may be taken for."""


@dataclass(frozen=True)
class Blunder:
    """A fault of the data."""

    # outlier, knocked_stand, zeroed, command, sign, label, exchanged_labels, shifted, unit, turns,
    # stuck or scatter
    kind: Kind
    # factor and row within it; of a knocked stand the rows after the knock, of dials set to zero
    # anew at each repeat those after the first
    rows: tuple[tuple[int, int], ...]
    setups: tuple[str, ...]  # names of the setups concerned
    message: str  # which file, which lines, what it looks like, what to do
    improvement: float  # fall of chi2 once it is known, the faults found before it set aside
    rms_with: float  # of the residuals with it, metres
    rms_without: float  # of the residuals without it, metres
    # of a wrong command the drives that it may be of, the likeliest first, and how much more each
    # was told than is written, metres
    commands: tuple[tuple[int, float], ...] = ()
    # the hypothesis, rows stacked over all campaigns
    fault: Fault | None = field(default=None, compare=False, repr=False)

    @property
    def sets_aside(self) -> bool:
        """Whether its rows do not count; else they have a datum of their own."""
        return self.kind not in DATUMS

    def may_be_the_machine(self, problem: Problem) -> bool:
        """Whether a part of the machine that goes wrong in its own way may look like it: like one
        wrong command only where few postures are read.
        """
        if self.kind == "command":  # different commands of the mounting that has most
            command = problem.of_dials("command")
            read = np.column_stack([problem.setup_of_row[: len(command)], command])
            each = np.bincount(np.unique(read, axis=0)[:, 0].astype(np.intp))
            if each.max() > _FEW:
                return False
        return self.kind in _DOUBTED and self.fault is not None

    def both_ways(self, problem: Problem, others: Sequence[Blunder]) -> tuple[Problem, Problem]:
        """The same readings as they stand and put right, those of other faults without weight.

        Args:
            problem: in which it was found.
            others: found beside it.
        """
        silent = [b.fault for b in others if b.fault is not None]
        muted = _muted(problem, silent) if silent else problem
        return muted, muted if self.fault is None else restored(muted, self.fault)

    def lines(self, given: Sequence[Readings]) -> dict[str, tuple[int, ...]]:
        """Lines of the rows by file, or by campaign where there is none."""
        found: dict[str, tuple[int, ...]] = {}
        for k, row in self.rows:
            name = given[k].file or given[k].name
            found[name] = (*found.get(name, ()), int(given[k].line[row]))
        return {name: tuple(dict.fromkeys(lines)) for name, lines in found.items()}


@dataclass(frozen=True)
class Findings:
    """What is wrong with readings before any cause is looked for."""

    # stuck dials first, then outliers and knocks that repeats show, then the rest
    blunders: tuple[Blunder, ...]
    # parameters of the machine that changed between campaigns, values included
    changes: tuple[Change, ...]


def examine(estimate: Estimate) -> Findings:
    """Find faults of the data, and changes between campaigns, that no cause explains as well, from
    the fit of the base model.

    Every test here is closed form: the answer has no seed.
    """
    tool, whole = tool_slips(estimate), estimate
    estimate = solved_without(estimate, tool)
    narrow = estimate.problem.at_tolerance()
    if narrow is not estimate.problem:
        # Wrong readings lead values beyond their tolerances: here these still count.
        estimate = solve(narrow, method="nested", start=estimate.x, widen=False)
    base = signatures(estimate)
    means = StationMeans.of(base)
    setups = [Scatter.of(estimate, s) for s in estimate.problem.leg_setups]
    found = stuck_faults(base, means, setups)
    found += unit_faults(estimate.problem, setups, found)
    slips = searches(estimate.problem, setups)
    found += repeat_faults(estimate.problem, slips, found)
    changes: list[Change] = []
    stale = 0 < _slips(found) < _MOST or any(f.kind == "zeroed" for f in found)
    several = len(visits(estimate.problem)) > 1
    for _ in range(_REFITS + (_CHANGED if several else 0)):
        if stale:
            problem = separated(_muted(estimate.problem, found), changes)
            try:
                fit = solve(problem, method="nested", widen=False)
                means = StationMeans.of(signatures(fit), found)
            except NumericsError:
                break
        item = fit_fault(means, setups, found)
        if item is None:
            break
        if isinstance(item, Changes):
            changes += item.changes
        else:
            found = _with(estimate.problem, found, item)
            changes = []  # found anew: what a fault does was not theirs to explain
        stale = True
    if _slips(found) < _MOST and not any(f.kind in MEANINGS for f in found):
        beside = joint_fault(means, found)
        found = _with(estimate.problem, found, beside) if beside is not None else found
    limited = [f for k, f in enumerate(found) if f.kind == "zeroed" or _slips(found[:k]) < _MOST]
    found = limited + scatter_faults(estimate.problem, slips, found)
    last = means.signatures.estimate
    blunders = _reported(base if not tool else signatures(whole), [*tool, *found])
    return Findings(blunders, tuple(c.measured(last) for c in changes))


def _with(problem: Problem, faults: Sequence[Fault], fault: Fault) -> list[Fault]:
    """Faults with one more, without the slips that were part of it: at an end of shifted readings,
    or a visit that is off by other turns than the rest of its station.
    """
    off = np.zeros(len(problem.measured))
    if fault.kind == "turns":
        off[fault.rows] = fault.sizes

    def was(slip: Fault) -> bool:
        if fault.kind == "shifted":
            return slip.setups == fault.setups
        return bool(np.ptp(off[problem.station == problem.station[slip.rows[0]]]) > 0)

    return [f for f in faults if f.kind != "outlier" or not was(f)] + [fault]


def _slips(faults: Sequence[Fault]) -> int:
    """How many are slips: a dial that is set to zero anew is no mistake."""
    return sum(f.kind != "zeroed" for f in faults)


def _muted(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """The same rows, those of faults without any weight, datums and commands put right."""
    silent = np.zeros(len(problem.measured), dtype=bool)
    readings = problem.measured.copy()
    for fault in faults:
        readings -= steps(problem, fault) @ np.array(fault.offsets)
        silent[fault.rows] |= fault.sets_aside
    problem = all_put_right(problem, faults)  # the side that its neighbours were reached from, too
    return without_weight(problem.with_readings(readings), silent)


def _reported(base: Signatures, faults: Sequence[Fault]) -> tuple[Blunder, ...]:
    """The faults with what each explains once those before it are set aside."""
    problem, n = base.estimate.problem, base.count
    kept, shown = np.ones(n, dtype=bool), np.zeros((n, 0))
    chi2, rms = _left(base.estimate, kept, shown)
    blunders = []
    for fault in faults:
        before, with_it = chi2, rms
        rows = np.isin(np.arange(n), fault.rows)
        shown = np.hstack([shown, steps(problem, fault)])
        if fault.sets_aside:
            kept = kept & ~rows
        chi2, rms = _left(base.estimate, kept, shown)
        blunders.append(
            Blunder(
                fault.kind,
                places(problem, fault.rows),
                tuple(problem.setups[s].name for s in fault.setups),
                message(problem, fault),
                before - chi2,
                with_it,
                rms,
                fault.commands,
                fault,
            )
        )
    return tuple(blunders)


def _left(estimate: Estimate, kept: NDArray[np.bool_], steps: Array) -> tuple[float, float]:
    """Least cost of a linearised fit to some readings ``(n,)``, with steps free, and the root mean
    square that it leaves of lengths.
    """
    problem, nuisance, at = estimate.problem, estimate.nuisance, estimate.at
    if not kept.any():
        return 0.0, 0.0
    weighing = problem.weighing.part(kept)
    columns = np.hstack([at.jacobian, nuisance.columns, steps])
    known = known_rows(problem, nuisance)
    known = np.hstack([known, np.zeros((len(known), steps.shape[1]))])
    rows = np.vstack([weighing.whiten(columns[kept]), known])
    rest = (problem.measured - at.value + at.jacobian @ at.x)[kept]
    aim = np.zeros(len(rows))
    aim[: len(rest)] = weighing.whiten(rest)
    _, target = problem.prior_rows
    aim[len(rest) :][: len(target)] = target
    scale = np.linalg.norm(rows, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    found = np.linalg.lstsq(rows / scale, aim, rcond=1e-10)[0] / scale
    left = aim - rows @ found
    rest = rest - columns[kept] @ found
    return float(left @ left), rms_by_unit(rest, problem.turned[kept]).length


def without(problem: Problem, blunders: Sequence[Blunder]) -> Problem:
    """The problem without the faulty rows; a knocked setup becomes two, with a datum each.

    Noise that was taken from the repeats is taken from those that are left.

    Raises:
        InputError: where nothing is left of a campaign.
    """
    factors = list[Factor]()
    for k, factor in enumerate(problem.factors):
        campaign, kept = factor.readings, np.ones(len(factor.readings), dtype=bool)
        split = campaign
        for blunder in blunders:
            rows = np.array([row for c, row in blunder.rows if c == k], dtype=np.int64)
            if blunder.commands and len(rows):
                # The side that its neighbours were reached from depends on it.
                split = put_right(split, rows, *blunder.commands[0])
            if blunder.sets_aside:
                kept[rows] = False
                continue
            for part in parts(blunder.kind, rows, campaign.setup, campaign.repeat):
                split = _split(split, part)
        if not kept.any():
            fault = next(b for b in blunders if any(c == k for c, _ in b.rows))
            raise InputError(
                f"nothing is left of {campaign.name} once its faulty rows are set aside: measure "
                f"it again ({fault.message})"
            )
        factors.append(factor.with_table(split).subset(kept))
    problem = replace(problem.at_tolerance(), factors=tuple(factors))
    return with_noise_of_the_rest(problem)


def _split(campaign: Readings, rows: Rows) -> Readings:
    """Rows of one setup as a setup of their own."""
    old = campaign.setups[int(campaign.setup[rows[0]])]
    taken = {s.name for s in campaign.setups}
    name = f"{old.name}-from-line-{int(campaign.line[rows].min())}"
    while name in taken:
        name += "-again"
    setup = campaign.setup.copy()
    # The rest was split off by a later knock.
    setup[rows[setup[rows] == setup[rows[0]]]] = len(campaign.setups)
    return replace(campaign, setups=(*campaign.setups, replace(old, name=name)), setup=setup)
