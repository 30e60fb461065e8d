"""Data faults as hypotheses: what is wrong with which rows, and the sentence that reports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit import Problem
from orthoglide.geometry import LEGS
from orthoglide.machine_file import Controller
from orthoglide.numerals import compact, plain, signed
from orthoglide.observations import Readings, Setup, source
from orthoglide.observations.approach import APPROACH_NOT_RECORDED, APPROACH_REMEDY
from orthoglide.observations.arrays import group_ids
from orthoglide.units import UNIT_MISTAKES

Kind = Literal[
    "outlier", "knocked_stand", "zeroed", "command", "sign", "label", "exchanged_labels", "shifted",
    "unit", "turns", "stuck", "noisy", "scatter", "moved", "drifted",
]  # fmt: skip
Rows = NDArray[np.int64]

DATUM_KINDS: tuple[Kind, ...] = ("knocked_stand", "zeroed", "moved")
"""Faults whose rows get a separate datum."""

STARTING_KINDS: tuple[Kind, ...] = ("knocked_stand", "moved")
"""Faults that begin at some row and last to the end of their setup."""

MISREADING_KINDS: tuple[Kind, ...] = (
    "sign", "label", "exchanged_labels", "shifted", "unit", "turns", "stuck", "noisy",
)  # fmt: skip
"""Faults of readings that are mislabelled, rescaled or noisier, with which the search continues."""

EXCLUDED_KINDS: tuple[Kind, ...] = ("outlier", "command", "stuck", "scatter")
"""Faults of which the true readings are unknown, or the command is known from these readings alone:
their rows get zero weight. The rows of all others are corrected and keep their weight, because no
other reading may show what they show."""

_LOCAL_RANGE = 2e-3  # metres: range and size of an error of a drive at one command alone
_MOST_LINES_LISTED = 12  # lines that a message lists one by one
_POSTURE_KINDS = ("command", "noisy")  # what a defect of the machine at a posture reads like
_VISITED_ONCE = (
    "; nothing here was visited twice, and a defect of the machine at one place, such as a bump of "
    "a rail, would read alike: visit it again"
)
_FOLD = (  # a mesh is touched row by row
    ", or the plate is bent along a line there, which a mesh in another order of rows shows again"
)
_LOST_MOTION = f"; or it is lost motion, as {APPROACH_NOT_RECORDED}: {APPROACH_REMEDY}"


@dataclass(frozen=True)
class Fault:
    """A hypothesis about the data."""

    kind: Kind
    # stacked faulty readings, in the order they were taken; for a knocked stand the readings after
    # the knock, for dials set to zero anew those after the first repeat
    rows: Rows
    # outlier or knock: metres; unit: factor; noisy: factor of the noise; shifted: number of rows by
    # which readings stand too late; turns: metres that one turn of the hand shows;
    # exchanged_labels: 1 if the labels are exchanged, 0 if the readings are, the first half of the
    # rows with the second
    size: float = 0.0
    label: tuple[int, int] = (0, 0)  # wrong label: the leg and axis that fit
    drive: int | None = None  # whose command is wrong: by size, the commanded less the written
    # zeroed: each datum less that of the first repeat, metres; turns, drifted: excess of each row,
    # metres or radians
    sizes: tuple[float, ...] = ()
    # of a misreading before the fit: of its kind, the digits, and the density of rescaled readings
    log_odds: float = 0.0
    # what the readings do not rule out either: other drives, and a fault of another kind
    alternatives: tuple[Fault, ...] = ()

    @property
    def excluded(self) -> bool:
        """True if its rows get zero weight; otherwise they are corrected."""
        return self.kind in EXCLUDED_KINDS

    @property
    def relabels(self) -> bool:
        """True if its rows get other labels; their readings are the same."""
        return self.kind == "label" or (self.kind == "exchanged_labels" and self.size != 0)


def setups_of(problem: Problem, fault: Fault) -> list[int]:
    """Return the setups of a fault's rows, numbered over all tables."""
    return np.unique(problem.setup_of_row[fault.rows]).tolist()


def weighted_rows(problem: Problem, setup: int) -> Rows:
    """Return the stacked rows of a setup that have any weight, in the order they were taken."""
    rows = np.flatnonzero((problem.setup_of_row == setup) & problem.weighted)
    return np.asarray(rows[np.argsort(problem.column("order")[rows], kind="stable")])


def split_by_datum(kind: Kind, rows: Rows, setup: Rows, repeat: Rows) -> list[Rows]:
    """Split rows by datum: by setup, and by repeat if dials were zeroed, given the setup and the
    repeat of all readings ``(n,)``.
    """
    datum = group_ids(np.column_stack([setup, repeat * (kind == "zeroed")])[rows])
    return [rows[datum == k] for k in range(datum.max(initial=-1) + 1)]


def factors_and_rows(problem: Problem, rows: Rows) -> tuple[tuple[int, int], ...]:
    """Return the factor and the row within it of stacked rows."""
    ordered = np.sort(rows)
    stops = [part.stop for part in problem.factor_rows]
    factors = np.searchsorted(stops, ordered, side="right").tolist()
    pairs = zip(factors, ordered.tolist(), strict=True)
    return tuple((k, row - problem.factor_rows[k].start) for k, row in pairs)


def lines_of(problem: Problem, fault: Fault) -> tuple[tuple[int, int], ...]:
    """Return the table and the line of every row of a fault."""
    tables = [f.readings for f in problem.factors]
    places = factors_and_rows(problem, fault.rows)
    return tuple((k, int(tables[k].line[row])) for k, row in places)


def _readings_and_setup(problem: Problem, fault: Fault) -> tuple[int, int, Readings, Setup]:
    """Return the factor, the row within it, the table and the setup of a fault's first row."""
    k, row = factors_and_rows(problem, fault.rows)[0]
    readings = problem.factors[k].readings
    return k, row, readings, readings.setups[readings.setup[row]]


def fault_message(problem: Problem, fault: Fault) -> str:
    """Return one sentence: which file, which lines, what it looks like, what to do."""
    places = factors_and_rows(problem, fault.rows)
    factor = places[0][0]
    readings = problem.factors[factor].readings
    lines = _line_list(
        [*dict.fromkeys(int(readings.line[row]) for k, row in places if k == factor)]
    )
    setups = [repr(problem.setups[s].name) for s in setups_of(problem, fault)]
    plural = "s" * (len(setups) > 1)
    where = "" if readings.by_point else f", setup{plural} {' and '.join(setups)}"
    label = _row_label(problem, places)
    others = [a for a in fault.alternatives if a.kind != fault.kind]
    clauses = [_clause(problem, each) for each in (fault, *others)]
    once = _VISITED_ONCE * (fault.kind in _POSTURE_KINDS and _visited_once(problem, fault))
    return f"{source(readings)}, {lines}{where}{label}: {'; or '.join(clauses)}{once}"


def _visited_once(problem: Problem, fault: Fault) -> bool:
    """Return whether no visit of a fault was repeated, so that none confirms another."""
    stations = np.unique(problem.station[fault.rows])
    return bool(np.isin(problem.station, stations).sum() == len(stations))


def _row_label(problem: Problem, places: tuple[tuple[int, int], ...]) -> str:
    """Return the posture or point label that all rows share; empty if there is none."""
    labels = {problem.factors[k].readings.posture[row] for k, row in places}
    if len(labels) > 1 or not (label := labels.pop()):
        return ""
    k, row = places[0]
    readings = problem.factors[k].readings
    return f", {readings.kind[row] if readings.paired[row] else 'posture'} {label}"


_CLAUSES: dict[Kind, str] = {
    "knocked_stand": "from here on all readings of the setup are {shift} than before, as if the "
    "dial's stand had been knocked: give these rows a setup name of their own, or measure the "
    "setup again",
    "moved": "from here on the same places read about {size} {unit} otherwise than before, as if "
    "the instrument, or what it stands on, had been moved, or drifted{fold}: give the rows from "
    "there on a setup name of their own, as is done here, or measure the setup again{lost_motion}",
    "drifted": "from the first of these readings to the last, what the same places read changes "
    "evenly by about {size} {unit}, as if the instrument, or what it stands on, crept or warmed: "
    "its rate is fitted here; let it settle and measure the setup again{lost_motion}",
    "scatter": "visits to the same {place} scatter by {scatter} {unit}, which is no noise of such "
    "an instrument: rows were exchanged, the readings have another unit, or something is loose; "
    "correct it, or {remedy}",
    "sign": "the readings fit with the opposite sign, so {dials} counted the other way: look at "
    "which way {hands} and put {direction}",
    "label": "the readings fit as those of a dial on leg {leg} that reads along {axis}: check "
    "where it stood, and correct the leg or the direction of the setup",
    "exchanged_labels": "the readings of these two fit once they are exchanged, so the two dials "
    "or their columns were mixed up: check which dial stood where and exchange the setups' labels",
    "shifted": "the readings fit a row farther {up}, so they were written a row too {late}: move "
    "them {up} by one, and measure the one that is lost again",
    "unit": "the readings fit once they are multiplied by {factor}, so they seem to be {mistake}: "
    "put these readings into millimetres",
    "noisy": "the readings of this setup are {times} times as noisy as assumed, and their weight "
    "is reduced accordingly: look for what is loose on this {parts}, and read the setup again",
    "turns": "{these} {range} mm off the setup's others, in whole turns of a hand that shows "
    "{shown} mm by each: read the small hand, which counts them, and correct or drop these rows",
    "stuck": "the dial shows {reading} mm in {count} readings one after the other while the "
    "machine moves: free the plunger and measure these rows again",
}
"""What each other kind of fault looks like, and what to do about it."""


def _clause(problem: Problem, fault: Fault) -> str:
    """Return what a fault looks like, and what to do about it."""
    match fault.kind:
        case "outlier":
            return _outlier_clause(problem, fault)
        case "zeroed":
            return _zeroed_clause(problem, fault)
        case "command":
            return _command_clause(problem, fault)
    k, row, readings, setup = _readings_and_setup(problem, fault)
    known = problem.factors[k].approach_known(int(readings.setup[row]))
    lost_motion = "" if known else _LOST_MOTION
    place, remedy = "posture", "declare the noise with --noise"
    if readings.of_tool:
        place = "place, or to places beside it," if setup.observation.touches else "place"
        remedy = f"give repeatability in the machine file under [instrument.{setup.kind}]"
        remedy += lost_motion
    several, size, count = len(setups_of(problem, fault)) > 1, fault.size, len(fault.rows)
    other = ("" if setup.sign < 0 else "-") + LEGS[setup.axis]
    extremes = sorted({min(fault.sizes, default=0.0), max(fault.sizes, default=0.0)})
    return _CLAUSES[fault.kind].format(
        shift=f"{abs(size) * 1e3:.3g} mm {'higher' if size > 0 else 'lower'}",
        size=compact(size * 1e3, 2),
        unit=setup.observation.unit,
        lost_motion=lost_motion,
        fold=_FOLD * setup.observation.touches,
        place=place,
        scatter=f"{size * 1e3:.2g}",
        remedy=remedy,
        dials="these dials" if several else "the dial",
        hands="their hands turn" if several else "its hand turns",
        direction="the opposite directions"
        if several
        else f"direction {other} instead of {setup.direction}",
        leg=LEGS[fault.label[0]],
        axis=LEGS[fault.label[1]],
        late="late" if size > 0 else "early",
        up="up" if size > 0 else "down",
        factor=f"{size:.4g}",
        mistake=UNIT_MISTAKES.get(size),
        times=compact(size, 2),
        parts="dial, its stand and its leg"
        if setup.observation.on_leg
        else "instrument and its stand",
        these=f"these {count} readings are" if count > 1 else "this reading is",
        range=" to ".join(compact(each * 1e3, plus=True) for each in extremes),
        shown=f"{size * 1e3:.3g}",
        reading=compact(problem.measured[fault.rows[0]] * 1e3, 6),
        count=count,
    )


def _outlier_clause(problem: Problem, fault: Fault) -> str:
    """Return how far off a reading or a point is, and what to look up."""
    _, row, readings, setup = _readings_and_setup(problem, fault)
    unit = setup.observation.unit
    deviation = compact(fault.size * 1e3, plus=True)
    subject = f"the reading {compact(readings.reading[row] * 1e3, 6)} {unit} is {deviation} {unit}"
    if len(fault.rows) > 1 and readings.on_legs[row]:
        excess = f"{abs(fault.size) * 1e3:.2g} {unit} too {'much' if fault.size > 0 else 'little'}"
        return (
            f"the dial {setup.name!r} alone reads {excess} here, at each of {len(fault.rows)} "
            f"visits: look for dirt or a burr where it touches, and check these entries"
        )
    if len(fault.rows) > 1 and readings.paired[row]:
        return (
            f"these distances end at one place, and fit with it {abs(fault.size) * 1e3:.2g} mm "
            f"elsewhere on the plate: look whether the pillar or hole there leans, has a burr or "
            f"was measured at its foot, and measure these distances again"
        )
    if readings.by_point:
        subject = f"the point is {abs(fault.size) * 1e3:.3g} {unit}"
    revisited = np.sum(problem.station[fault.rows[0]] == problem.station) > 1
    if readings.touching[row] and not revisited:  # a printer's firmware keeps no notes of it
        side = "below" if fault.size > 0 else "above"
        return (
            f"the touch here is {compact(abs(fault.size) * 1e3)} mm {side} the surface of all "
            f"others, as by a speck, a clip or a bad touch: clean the plate and touch this place "
            f"again"
        )
    reference = "the other readings of this place" if revisited else "what all others say"
    checked = "it" if revisited or readings.paired[row] else "it and its command"
    other_cause = ""
    if revisited and not readings.approach[row].all() and not readings.paired[row]:
        other_cause = _LOST_MOTION
    elif not revisited and readings.on_legs[row]:
        other_cause = (
            "; it was visited once, and a defect of the machine at this place would read alike"
        )
    return (
        f"{subject} off {reference}: look {checked} up in the notes and correct it, or measure "
        f"this place again{other_cause}"
    )


def _zeroed_clause(problem: Problem, fault: Fault) -> str:
    """Return by how much the datum of each repeat differs from that of the first."""
    repeat = problem.column("repeat")
    by_setup: dict[str, list[str]] = {}
    datums = split_by_datum("zeroed", fault.rows, problem.setup_of_row, repeat)
    for rows, size in zip(datums, fault.sizes, strict=True):
        clauses = by_setup.setdefault(problem.setups[problem.setup_of_row[rows[0]]].name, [])
        clauses.append(f"{signed(size * 1e3, 3)} mm at repeat {repeat[rows[0]]}")
    plural = len(by_setup) > 1
    shifts = "; ".join(f"{name}: " * plural + ", ".join(c) for name, c in by_setup.items())
    return (
        f"from repeat to repeat all readings of {'a' if plural else 'the'} setup are shifted "
        f"(against the first, {shifts}), as if the dial{'s' * plural} had been set to zero anew at "
        f"each: give each repeat a setup name of its own, as is done here"
    )


def _command_clause(problem: Problem, fault: Fault) -> str:
    """Return which command fits a posture, in the coordinates of files, and its alternatives."""
    (k, row), *_ = factors_and_rows(problem, fault.rows)
    written = problem.campaigns[k].command[row]
    spec, options = problem.machine.spec, []
    faults = [fault, *(a for a in fault.alternatives if a.kind == fault.kind)]
    sizes = {f.drive: f.size for f in faults if f.drive is not None}
    for drive, size in sizes.items():
        fitted = written + size * np.eye(3)[drive]
        text = f"rho_{LEGS[drive]} = {plain(fitted[drive] * 1e3, 2)} mm where "
        text += compact(written[drive] * 1e3, 8)
        if spec.controller != Controller():
            both = spec.controller.from_rho(np.stack([fitted, written]), spec.geometry)[:, drive]
            where = f"{plain(both[0] * 1e3, 2)} where {compact(both[1] * 1e3, 8)}"
            text += f" (the controller's {where})"
        options.append(f"{text} is written")
    text = (
        f"the readings of this posture fit with {', or with '.join(options)}: look up the command, "
        f"and correct or drop these rows"
    )
    # A small error may also be the drive's, if no other posture has it near this command.
    others = np.delete(problem.dial_column("command"), fault.rows, axis=0) - written
    isolated = (np.abs(others) > _LOCAL_RANGE).all(axis=0)
    drives = [LEGS[k] for k, size in sizes.items() if abs(size) <= _LOCAL_RANGE and isolated[k]]
    if not drives:
        return text
    return f"{text}; or drive {' or '.join(drives)} is off at this place alone: measure it again"


def _line_list(lines: Sequence[int]) -> str:
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > _MOST_LINES_LISTED:
        return f"{len(lines)} lines from {min(lines)} to {max(lines)}"
    return "lines " + ", ".join(map(str, lines[:-1])) + f" and {lines[-1]}"
