"""Faults of the data as hypotheses: what is wrong with which rows, and how a mechanic reads it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit import Problem
from orthoglide.geometry import LEGS, Array
from orthoglide.machine_file import Controller
from orthoglide.numerals import compact, plain, signed
from orthoglide.observations import source
from orthoglide.observations.approach import APPROACH_NOT_RECORDED, APPROACH_REMEDY
from orthoglide.observations.arrays import group_ids
from orthoglide.units import UNIT_MISTAKES

Kind = Literal[
    "outlier", "knocked_stand", "zeroed", "command", "sign", "label", "exchanged_labels", "shifted",
    "unit", "turns", "stuck", "scatter", "moved",
]  # fmt: skip
Rows = NDArray[np.int64]
Same = Callable[["Fault", "Fault"], bool]

DATUM_KINDS: tuple[Kind, ...] = ("knocked_stand", "zeroed", "moved")
"""Faults whose rows count, each with a datum of its own."""

REQUIRED_EVIDENCE = 7.0
"""Log Bayes factor that a fault must reach, the number of its like discounted: about 1 in 1000."""

_LOCAL_RANGE = (
    2e-3  # metres: a drive that is wrong at a command is wrong as near as this, by no more
)
_MOST_LINES_LISTED = 12  # lines that a message lists one by one


@dataclass(frozen=True)
class Fault:
    """A hypothesis about the data."""

    kind: Kind  # of the fault
    # stacked readings that are spoilt, in the order they were taken; for a knocked stand those
    # after the knock, of dials set to zero anew those after the first repeat
    rows: Rows
    setups: tuple[int, ...]  # numbered over all campaigns
    # of an outlier or a knock, metres; a unit's factor; rows by which readings stand too late; what
    # one turn of the hand shows, metres
    size: float = 0.0
    label: tuple[int, int] = (0, 0)  # of a wrong label the leg and axis that fit
    # of a wrong command the drives that it may be of, the likeliest first, and how much more each
    # was told than is written, metres
    commands: tuple[tuple[int, float], ...] = ()
    # of dials set to zero anew, each of `datums` less that of the first repeat; of whole turns,
    # what each of its rows shows too much, metres; factors of units that fit nearly alike
    sizes: tuple[float, ...] = ()
    alternatives: tuple[Fault, ...] = ()  # of another kind, which the readings do not rule out

    @property
    def excluded(self) -> bool:
        """Whether its rows do not count; else they have a datum of their own."""
        return self.kind not in DATUM_KINDS

    @property
    def offsets(self) -> tuple[float, ...]:
        """Of each of its :func:`datum_rows`, metres."""
        return () if self.excluded else self.sizes or (self.size,)


def rows_in_order(problem: Problem, setup: int) -> Rows:
    """Stacked rows of a setup, in the order they were taken."""
    rows = np.flatnonzero(problem.setup_of_row == setup)
    return np.asarray(rows[np.argsort(problem.dial_column("order")[rows], kind="stable")])


def weighted_rows(problem: Problem, setup: int) -> Rows:
    """Rows of a setup of dials that have weight, in the order they were taken."""
    rows = rows_in_order(problem, setup)
    kept = np.concatenate([f.noise.weighted for f in problem.leg_factors])
    return rows[kept[rows]]


def datum_rows(problem: Problem, fault: Fault) -> list[Rows]:
    """Rows that have a datum of their own: by setup and repeat, or all behind a knock."""
    if fault.excluded:
        return []
    setup = problem.setup_of_row
    repeat = problem.dial_column("repeat") if fault.kind == "zeroed" else np.zeros_like(setup)
    return split_by_datum(fault.kind, fault.rows, setup, repeat)


def datum_columns(problem: Problem, fault: Fault) -> Array:
    """What readings show of a metre of each of its :func:`datum_rows` ``(n, datums)``."""
    shown = np.zeros((len(problem.measured), len(fault.offsets)))
    for k, rows in enumerate(datum_rows(problem, fault)):
        shown[rows, k] = 1.0
    return shown


def split_by_datum(kind: Kind, rows: Rows, setup: Rows, repeat: Rows) -> list[Rows]:
    """Rows of each datum, by setup and repeat of all rows of which these are some."""
    datum = group_ids(np.column_stack([setup, repeat * (kind == "zeroed")])[rows])
    return [rows[datum == k] for k in range(datum.max(initial=-1) + 1)]


def campaign_index(problem: Problem, rows: Rows) -> int:
    """Number of the campaign that stacked rows of one campaign belong to."""
    return next(k for k, part in enumerate(problem.leg_rows) if rows[0] < part.stop)


def factors_and_rows(problem: Problem, rows: Rows) -> tuple[tuple[int, int], ...]:
    """Factor and row within it of stacked rows."""
    ends = [part.stop for part in problem.factor_rows]
    ordered = np.sort(rows).tolist()
    homes = np.searchsorted(ends, ordered, side="right").tolist()
    each = zip(homes, ordered, strict=True)
    return tuple((k, row - problem.factor_rows[k].start) for k, row in each)


def fault_message(problem: Problem, fault: Fault) -> str:
    """One sentence: which file, which lines, what it looks like, what to do."""
    at = factors_and_rows(problem, fault.rows)
    given = problem.factors[at[0][0]].readings
    lines = _line_list([*dict.fromkeys(int(given.line[row]) for k, row in at if k == at[0][0])])
    setups = " and ".join(repr(problem.setups[s].name) for s in fault.setups)
    plural = "s" * (len(fault.setups) > 1)
    where = "" if given.by_point else f", setup{plural} {setups}"
    clauses = [_clause(problem, one) for one in (fault, *fault.alternatives)]
    return f"{source(given)}, {lines}{where}{_row_label(problem, at)}: {'; or '.join(clauses)}"


def _row_label(problem: Problem, at: tuple[tuple[int, int], ...]) -> str:
    """Return the label by which people know what was read, behind its place in the file; empty
    where the rows have none, or several.
    """
    labels = {problem.factors[k].readings.posture[row] for k, row in at}
    if len(labels) > 1 or not (label := labels.pop()):
        return ""
    k, row = at[0]
    given = problem.factors[k].readings
    return f", {given.kind[row] if given.paired[row] else 'posture'} {label}"


def _outlier_clause(problem: Problem, fault: Fault) -> str:
    """How far off a reading or a point is, and what to look up."""
    k, row = factors_and_rows(problem, fault.rows)[0]
    given = problem.factors[k].readings
    unit = given.setups[given.setup[row]].observation.unit
    off = compact(fault.size * 1e3, plus=True)
    what = f"the reading {compact(given.reading[row] * 1e3, 6)} {unit} is {off} {unit}"
    if len(fault.rows) > 1 and given.on_legs[row]:
        setup = repr(problem.setups[fault.setups[0]].name)
        much = f"{abs(fault.size) * 1e3:.2g} {unit} too {'much' if fault.size > 0 else 'little'}"
        return (
            f"the dial {setup} alone reads {much} here, at each of {len(fault.rows)} visits: look "
            f"for dirt or a burr where it touches, and at its sheet"
        )
    if given.by_point:
        what = f"the point is {abs(fault.size) * 1e3:.3g} {unit}"
    visits = np.sum(problem.station[fault.rows[0]] == problem.station)
    rest = "the other readings of this place" if visits > 1 else "what all others say"
    looked = "it" if visits > 1 or given.paired[row] else "it and its command"
    lost = ""
    if visits > 1 and not given.approach[row].all() and not given.paired[row]:
        lost = f"; or it is lost motion, as {APPROACH_NOT_RECORDED}: {APPROACH_REMEDY}"
    once = ""
    if visits == 1 and given.on_legs[row]:
        once = "; it was visited once, and a defect of the machine at this place would read alike"
    return (
        f"{what} off {rest}: look {looked} up in the notes and correct it, or measure this place "
        f"again{lost}{once}"
    )


def _clause(problem: Problem, fault: Fault) -> str:
    """What a fault looks like, and what to do about it."""
    first = f"{compact(problem.measured[fault.rows[0]] * 1e3, 6)} mm"
    up = f"{abs(fault.size) * 1e3:.3g} mm {'higher' if fault.size > 0 else 'lower'}"
    match fault.kind:
        case "outlier":
            return _outlier_clause(problem, fault)
        case "zeroed":
            return _zeroed_clause(problem, fault)
        case "knocked_stand":
            return (
                f"from here on all readings of the setup are {up} than before, as if the "
                f"dial's stand had been knocked: give these rows a setup name of their own, or "
                f"measure the setup again"
            )
        case "command":
            return _command_clause(problem, fault)
        case "sign" | "label" | "exchanged_labels":
            return _label_clause(problem, fault)
        case "shifted":
            late, up = ("late", "up") if fault.size > 0 else ("early", "down")
            return (
                f"the readings fit a row farther {up}, so they were written a row too {late}: move "
                f"them {up} by one, and measure the one that is lost again"
            )
        case "unit":
            factors = fault.sizes or (fault.size,)
            by = " or ".join(f"{factor:.4g}" for factor in factors)
            return (
                f"the readings fit once they are multiplied by {by}, so they seem to be "
                f"{', or '.join(UNIT_MISTAKES[f] for f in factors)}: put this setup into millimetres"
            )
        case "turns":
            return _turns_clause(fault)
        case "scatter":
            return _scatter_clause(problem, fault)
        case "moved":
            k, row = factors_and_rows(problem, fault.rows)[0]
            given = problem.factors[k].readings
            unit = given.setups[given.setup[row]].observation.unit
            return (
                f"from here on the same places read about {compact(fault.size * 1e3, 2)} {unit} "
                f"otherwise than before, as if the instrument, or what it stands on, had been "
                f"moved, or drifted: give the rows from there on a setup name of their own, as is "
                f"done here, or measure the setup again"
                f"{_lost_motion_clause(problem, k, int(given.setup[row]))}"
            )
        case "stuck":
            return (
                f"the dial shows {first} in {len(fault.rows)} readings one after the other while "
                f"the machine moves it by {fault.size * 1e3:.2g} mm: free the plunger and measure "
                f"these rows again"
            )


def _scatter_clause(problem: Problem, fault: Fault) -> str:
    """By how much visits to one place differ, and what to do."""
    k, row = factors_and_rows(problem, fault.rows)[0]
    given, size = problem.factors[k].readings, f"{fault.size * 1e3:.2g}"
    if problem.factors[k].on_legs:
        return (
            f"visits to the same posture scatter by {size} mm, which is no noise of a dial: rows "
            f"were exchanged, the readings have another unit, or the dial is loose; put it right, "
            f"or declare the noise with --noise"
        )
    setup = int(given.setup[row])
    instrument = given.setups[setup].observation
    near = ", or to places beside it," if instrument.touches else ""
    return (
        f"visits to the same place{near} scatter by {size} {instrument.unit}, which is no noise of "
        f"such an instrument: rows were exchanged, the readings have another unit, or something "
        f"is loose; put it right, or give repeatability in the machine file under "
        f"[instrument.{instrument.kind}]{_lost_motion_clause(problem, k, setup)}"
    )


def _lost_motion_clause(problem: Problem, factor: int, setup: int) -> str:
    """What else visits of one place differ by, where nobody knows their sides."""
    if problem.factors[factor].approach_known(setup):
        return ""
    return f"; or it is lost motion, as {APPROACH_NOT_RECORDED}: {APPROACH_REMEDY}"


def _label_clause(problem: Problem, fault: Fault) -> str:
    """As what setup the readings fit: the other way round, of another leg, or of another dial."""
    if fault.kind == "sign":
        setup = problem.setups[fault.setups[0]]
        other = ("" if setup.sign < 0 else "-") + LEGS[setup.axis]
        return (
            f"the readings fit with the opposite sign, so the dial counted the other way: look "
            f"at which way its hand turns and put direction {other} instead of "
            f"{setup.direction}"
        )
    if fault.kind == "label":
        leg, axis = (LEGS[k] for k in fault.label)
        return (
            f"the readings fit as those of a dial on leg {leg} that reads along {axis}: check "
            f"where it stood, and correct the leg or the direction of the setup"
        )
    return (
        "the readings of these two fit once they are exchanged, so the two dials or their "
        "columns were mixed up: check which dial stood where and exchange the setups' "
        "labels"
    )


def _turns_clause(fault: Fault) -> str:
    """By how much readings are off, and which hand tells."""
    ends = sorted({min(fault.sizes), max(fault.sizes)})
    by = " to ".join(compact(size * 1e3, plus=True) for size in ends)
    count = len(fault.rows)
    return (
        f"{f'these {count} readings are' if count > 1 else 'this reading is'} {by} mm off the "
        f"setup's others, in whole turns of a hand that shows {fault.size * 1e3:.3g} mm by each: "
        f"read the small hand, which counts them, and correct or drop these rows"
    )


def _zeroed_clause(problem: Problem, fault: Fault) -> str:
    """By how much the datum of each repeat is off that of the first."""
    repeat = problem.dial_column("repeat")
    said: dict[str, list[str]] = {}
    for rows, size in zip(datum_rows(problem, fault), fault.sizes, strict=True):
        by = said.setdefault(problem.setups[problem.setup_of_row[rows[0]]].name, [])
        by.append(f"{signed(size * 1e3, 3)} mm at repeat {repeat[rows[0]]}")
    several = len(said) > 1
    each = "; ".join(f"{name}: " * several + ", ".join(by) for name, by in said.items())
    return (
        f"from repeat to repeat all readings of {'a' if several else 'the'} setup are shifted "
        f"(against the first, {each}), as if the dial{'s' * several} had been set to zero anew at "
        f"each: give each repeat a setup name of its own, as is done here"
    )


def _command_clause(problem: Problem, fault: Fault) -> str:
    """Which command fits a posture, in the coordinates of files, and what else it could be."""
    (k, row), *_ = factors_and_rows(problem, fault.rows)
    written = problem.campaigns[k].command[row]
    spec, said = problem.machine.spec, []
    for drive, size in fault.commands:
        meant = written + size * np.eye(3)[drive]
        text = f"rho_{LEGS[drive]} = {plain(meant[drive] * 1e3, 2)} mm where "
        text += compact(written[drive] * 1e3, 8)
        if spec.controller != Controller():
            both = spec.controller.from_rho(np.stack([meant, written]), spec.geometry)[:, drive]
            text += (
                f" (the controller's {plain(both[0] * 1e3, 2)} where {compact(both[1] * 1e3, 8)})"
            )
        said.append(f"{text} is written")
    text = (
        f"the readings of this posture fit with {', or with '.join(said)}: look up the command, "
        f"and correct or drop these rows"
    )
    # It may be the drive where no other posture has it near, and it is off by little.
    others = np.delete(problem.dial_column("command"), fault.rows, axis=0) - written
    far = (np.abs(others) > _LOCAL_RANGE).all(axis=0)
    alone = [
        LEGS[drive] for drive, size in fault.commands if abs(size) <= _LOCAL_RANGE and far[drive]
    ]
    if not alone:
        return text
    return f"{text}; or drive {' or '.join(alone)} is off at this place alone: measure it again"


def _line_list(lines: Sequence[int]) -> str:
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > _MOST_LINES_LISTED:
        return f"{len(lines)} lines from {min(lines)} to {max(lines)}"
    return "lines " + ", ".join(map(str, lines[:-1])) + f" and {lines[-1]}"
