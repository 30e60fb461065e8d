"""Measuring in conversation: a question, an answer, a row on the disk, until all is settled.

Measuring begins with both dials near the platform of each leg in turn; where nothing is found, near
the carriages too, as small causes take more readings. After that every sheet contains the readings
that the verdict itself suggests.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Literal

import numpy as np

from orthoglide.closing import RunOutcome, build_result, compute_outcome, next_measurements
from orthoglide.errors import FileError, InputError
from orthoglide.machine import Machine
from orthoglide.measuring.record import RETURN_POSTURE, SKIPPED_POSTURE, Record
from orthoglide.observations import Moves, Readings
from orthoglide.observations.checks import max_dial_span
from orthoglide.observations.protocols import (
    labelled_postures,
    leg_dial_campaign,
    require_dial_layout,
)
from orthoglide.observations.writing import Row, command_columns
from orthoglide.planning import next_sheet
from orthoglide.planning.sheets import dial_scale
from orthoglide.planning.suggestions import DECISIVE_SIGMAS
from orthoglide.report.sheet import command_convention, dial_words, mounted_together
from orthoglide.text import abbreviated, printable_path
from orthoglide.verdict import Verdict, build_request

# --- What is typed, or sent by a dial -------------------------------------------------------------

AnswerWord = Literal["skip", "undo", "quit", "help"]

_ANSWER_WORDS: dict[str, AnswerWord] = {
    "skip": "skip", "s": "skip", "undo": "undo", "u": "undo", "back": "undo", "b": "undo",
    "quit": "quit", "q": "quit", "exit": "quit", "?": "help", "help": "help", "h": "help",
}  # fmt: skip

HELP = """\
  12.34   what the dial shows, in millimetres; 12,34 and 340 um are understood
  skip    this reading cannot be taken: go on with the next
  undo    take the last reading back and ask for it again (also: back)
  quit    stop here; the same command goes on later
  ?       this help"""

_NUMBER = re.compile(r"([+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+))\s*(mm|um|µm|μm)?", re.IGNORECASE)
_LARGEST_READING = Decimal(1000)  # millimetres: no dial shows more


def parse_answer(answer: str) -> Decimal | AnswerWord:
    """Return a reading in millimetres, exactly as it was given, or what a word asks for.

    Raises:
        InputError: if the answer is neither.
    """
    text = answer.strip().replace("−", "-")
    if text.lower() in _ANSWER_WORDS:
        return _ANSWER_WORDS[text.lower()]
    number = _NUMBER.fullmatch(text)
    if number is None:
        raise InputError(
            f"a reading must be a number such as 12.34, not {abbreviated(text)!r}; ? shows help"
        )
    in_mm = (number[2] or "mm").lower() == "mm"
    value = Decimal(number[1].replace(",", ".")).scaleb(0 if in_mm else -3)
    if abs(value) > _LARGEST_READING:
        raise InputError(f"{abbreviated(text)} is more than any dial shows: give millimetres")
    return value


# --- What to read, and when the verdict is settled ------------------------------------------------

SETTLED_CRITERION = (
    "The verdict is settled when no significant lack of fit is left and no suggested readings "
    "would separate two explanations by two standard deviations; that nothing is wrong is accepted "
    "only after 90 readings."
)
"""The criterion, in words."""

MAX_READINGS = 126
"""Readings after which the answer is what it is: half of a sweep sheet."""

_INNER_STATIONS = (0.57, 0.43, 0.71, 0.34, 0.64)
"""Stations between zero and the ends of the stroke, as parts of its halves, sheet by sheet: none on
the same phase of a screw as zero and the ends, as round numbers often are."""

_DIAL_PLACES = ((0.25, 0), (0.65, 0), (0.25, 1), (0.65, 2), (0.5, 0))
"""Where the dials stand, as parts of the leg, and the bar that they touch (0: the median line),
sheet by sheet. The first two together find every effect from a fifth more than the size at which a
sweep sheet does, or less (``orthoglide.smallest_effects``)."""

_CLEARANCE = 8e-3
"""Metres that a dial keeps from the ends of its leg, over the whole stroke, times `dial_scale`."""

_MIN_READINGS_NOTHING_WRONG = 90  # readings before which it is not accepted that nothing is wrong
_MAX_SHEETS = 6  # after so many nobody goes on


def opening_sheet(machine: Machine, number: int = 0) -> Readings:
    """Return the sheet to begin with: both dials on each leg in turn, up, down and back, both ways
    at all stations but the ends; later numbers have other places.

    Raises:
        InputError: for a machine against whose legs no dial is set.
    """
    geometry = machine.geometry
    require_dial_layout(geometry)
    share, bar = _DIAL_PLACES[number % len(_DIAL_PLACES)]
    low, high = geometry.stroke
    clearance = _CLEARANCE * dial_scale(geometry)
    ends = (high + clearance) / geometry.L, 1 + (low - clearance) / geometry.L
    share = round(float(np.clip(share, *ends)), 3)
    inner = _INNER_STATIONS[number % len(_INNER_STATIONS)]
    travels = [inner * high, high, inner * high, 0.0, inner * low, low, inner * low, 0.0]
    return leg_dial_campaign(geometry, "measure", [(share,)], labelled_postures(travels), bar=bar)


def next_step(
    outcome: RunOutcome, number: int, readings_left: int
) -> tuple[Readings | None, str, bool]:
    """Return what to read after so many sheets, where there is room for so many readings more: the
    sheet, `None` where no further reading is worth it; why, a clause; and whether the verdict is
    settled.
    """
    taken = sum(map(len, outcome.request.campaigns))
    suggested = [
        s for s in next_measurements(outcome)
        if s.aim == "trace" or (s.aim == "separate" and s.gain >= DECISIVE_SIGMAS)
    ]  # fmt: skip
    sheet = next_sheet(suggested)
    if sheet is not None:
        reason = suggested[0].reason.partition(":")[0]
    elif not outcome.found and taken < _MIN_READINGS_NOTHING_WRONG:
        reason, sheet = "nothing was found yet", opening_sheet(outcome.request.machine, number)
    else:
        return None, "no further readings within reach would add information", outcome.stands
    if len(sheet) > readings_left or number >= _MAX_SHEETS:
        return None, f"{reason}, and no more readings were to be taken", False
    return _numbered(sheet, number), reason, False


def _numbered(sheet: Readings, number: int) -> Readings:
    """Return a sheet after others: no two have mountings of one name."""
    named = (replace(s, name=f"{s.name.removeprefix('next-')}-{number + 1}") for s in sheet.setups)
    return replace(sheet, setups=tuple(named))


# --- The conversation -----------------------------------------------------------------------------


@dataclass(frozen=True)
class SessionEnd:
    """Outcome of a measuring session."""

    verdict: Verdict  # of all readings
    settled: bool  # whether the verdict is settled
    reason: str  # why no more is asked for, a clause
    readings: int  # number of readings taken


@dataclass(frozen=True, eq=False)
class _Part:
    """The rows of one sheet."""

    rows: list[Row]  # as the file has them, moves included
    first_row: int  # number of rows of all sheets before it
    sheet: Readings

    @property
    def end(self) -> int:
        """Number of rows up to the end of this sheet."""
        return self.first_row + len(self.rows)


def _as_move(row: Row, posture: str) -> Row:
    """Return the row of a move to the position of a reading that is not taken there."""
    return row | {"kind": "move", "posture": posture, "repeat": ""}


@dataclass(eq=False)
class Session:
    """One campaign being measured: its file determines what is asked next."""

    machine: Machine  # as its file has it
    record: Record  # the campaign file
    ask: Callable[[str], str]  # returns the answer to a question; `EOFError` at the end of input
    tell: Callable[[str], None]  # shows a message
    sheet: Readings | None = None  # to read first; the program's own where absent
    # readings after which no more are asked for; `MAX_READINGS`, or all of a sheet, where absent
    max_readings: int | None = None
    clock: Callable[[], float] = time.time  # seconds; only differences count
    _start_time: float = field(default=0.0, init=False)
    _parts: list[_Part] = field(default_factory=list, init=False)  # up to the next row
    _dials: tuple[str, ...] = field(default=(), init=False)  # announced last
    # dials and position of the machine announced last; none where nobody knows where it stands
    _place: tuple[tuple[str, ...], str] | None = field(default=None, init=False)

    def run(self) -> SessionEnd | None:
        """Ask until the verdict is settled, or no more is to be read; return `None` if somebody
        asked to stop, or the input ended.

        Raises:
            InputError: if the file or the sheet cannot be used, or all readings give no verdict.
        """
        first = self.sheet or opening_sheet(self.machine)
        file_name = printable_path(self.record.path)
        first = first if len(first.moves) else first.with_moves()
        max_readings = self.max_readings or max(MAX_READINGS, len(first))
        if self.record.open(first):
            self.tell(f"{file_name} holds {self.record.readings} readings: going on after them.")
        else:
            self.tell(f"Readings go to {file_name}, each as soon as it is given. Answers:\n{HELP}")
        last_time = max((float(row["time_s"] or 0) for row in self.record.rows), default=0.0)
        self._start_time = self.clock() - last_time - self.record.idle
        sheet: Readings | None = first
        try:
            while sheet is not None:
                self._begin_sheet(sheet)
                rows, number = self._read_sheets(max_readings), len(self._parts)
                readings_left = max_readings - sum(row["kind"] != "move" for row in rows)
                self.tell("\nComputing the verdict.")
                try:
                    if (campaign := self.record.campaign(rows)) is None:
                        raise InputError("no dial was read at two places without moving it")
                    outcome = compute_outcome(build_request(campaign, self.machine))
                    sheet, reason, settled = next_step(outcome, number, readings_left)
                except InputError as error:  # all was skipped, or a dial was stuck
                    sheet = _numbered(opening_sheet(self.machine, number), number)
                    reason = f"no verdict is possible ({getattr(error, 'reason', error)})"
                    if len(sheet) > readings_left or number >= _MAX_SHEETS:
                        raise FileError(
                            f"{reason}: give a larger --most, or another name for --out",
                            file=file_name,
                        ) from None
                if sheet is not None:
                    self.tell(f"\nNot settled yet, {reason}: {len(sheet)} readings more.")
        except EOFError:
            return None
        verdict = build_result(outcome, Verdict)
        return SessionEnd(verdict, settled, reason, self.record.readings)

    def _read_sheets(self, max_readings: int) -> list[Row]:
        """Return the rows of the file up to the end of the last sheet, once all of it is read, or
        so many readings are.
        """
        while True:
            done = self._sheet_rows
            while len(done) < self._parts[-1].first_row:  # a reading was taken back
                self._parts.pop()
            part = self._parts[-1]
            if len(done) >= part.end:
                return self.record.rows[: int(done[part.end - 1]["order"]) + 1]
            if self.record.readings >= max_readings:
                return self.record.rows
            self._read_next(part, len(done) - part.first_row)

    @property
    def _sheet_rows(self) -> list[Row]:
        """Rows of the file in the order of the sheets, without moves that lead back."""
        return [row for row in self.record.rows if row["posture"] != RETURN_POSTURE]

    def _begin_sheet(self, sheet: Readings) -> None:
        """Go on with a sheet, of which the file may contain rows already.

        Raises:
            FileError: if these are rows of another sheet.
        """
        start, rows = self._parts[-1].end if self._parts else 0, self.record.plan(sheet)
        for row, planned in zip(self._sheet_rows[start:], rows, strict=False):
            if any(row[name] != planned[name] for name in ("setup", *command_columns(planned))):
                raise FileError(
                    "was not measured with this machine file and sheet: choose another name for "
                    "--out",
                    file=printable_path(self.record.path),
                    line=int(row["order"]) + 2,
                )
        self._parts.append(_Part(rows, start, sheet))

    def _read_next(self, part: _Part, count: int) -> None:
        """Go to the place after ``count`` rows of a sheet and read it; `EOFError` for a stop."""
        planned = part.rows[count]
        reading = sum(row["kind"] != "move" for row in part.rows[:count])
        self._announce_mounting(part, planned["setup"])
        if planned["kind"] == "move":
            self._pass(planned)
            return
        if self._place is None and self.record.rows:
            # It comes to the place from the prescribed side.
            sheet = part.sheet
            before = sheet.command[reading] - sheet.moves.overshoot * sheet.approach[reading]
            target = replace(sheet.subset([reading]), command=before[None], moves=Moves())
            self._pass(_as_move(self.record.plan(target)[0], RETURN_POSTURE))
        self._go(planned, "go to", f"posture {planned['posture']}")
        mounting = int(part.sheet.setup[reading])
        self._ask_reading(planned, max_dial_span(part.sheet, mounting))

    def _ask_reading(self, planned: Row, max_span: float) -> None:
        """Ask for one reading until it is given, skipped, or the one before is taken back; those of
        a mounting span at most ``max_span``, metres.
        """
        while True:
            try:
                answer = parse_answer(self.ask(f"{planned['setup']} shows: "))
            except InputError as error:
                self.tell(f"  {error}")
                continue
            if answer == "quit":
                raise EOFError
            if answer == "help":
                self.tell(f"{HELP}\n{SETTLED_CRITERION}")
            elif answer == "skip":
                self.record.append(_as_move(planned, SKIPPED_POSTURE))
                return
            elif answer == "undo":
                if self.record.take_back():
                    self._place = None
                    return
                self.tell("  there is no reading to take back")
            else:
                objection = self._objection(planned["setup"], answer, max_span)
                if not objection:
                    seconds = f"{max(self.clock() - self._start_time, 0.0):.0f}"
                    self.record.append(planned | {"reading_mm": f"{answer:f}", "time_s": seconds})
                    return
                self.tell(f"  {answer:f} mm cannot be: {objection}")

    def _objection(self, setup: str, answer: Decimal, max_span: float) -> str:
        """Return which reading of the same mounting makes an answer impossible, and what to do;
        empty if it is possible.
        """
        rows = [row for row in self.record.rows if row["kind"] != "move"]
        spans = {k: abs(Decimal(row["reading_mm"]) - answer)
                 for k, row in enumerate(rows) if row["setup"] == setup}  # fmt: skip
        k = max(spans, key=spans.__getitem__, default=0)
        if float(spans.get(k, 0)) * 1e-3 <= max_span:
            return ""
        line, undone = int(rows[k]["order"]) + 2, len(rows) - k
        return (
            f"the dial would have moved {spans[k]:.1f} mm from the {rows[k]['reading_mm']} mm of "
            f"line {line}, which no leg does. Type the number again; if line {line} is wrong, type "
            f"undo {undone} time{'s' * (undone > 1)}, and it is asked for again."
        )

    def _announce_mounting(self, part: _Part, setup: str) -> None:
        """Say where the dials of a mounting stand, once."""
        names = mounted_together(part.rows)[setup]
        if self._dials == names:
            return
        self._dials = names
        self.tell(f"\nMount {'dials' if len(names) > 1 else 'a dial'}: {' and '.join(names)}")
        for dial in part.sheet.setups:
            if dial.name in names:
                remedy = "give all its numbers with the other sign"
                words = "\n    ".join(dial_words(dial, self.machine, remedy))
                self.tell(f"  {dial.name}\n    {words}")
        self.tell(f"  {command_convention(self.machine)}")

    def _pass(self, row: Row) -> None:
        """Send the machine to a place where nothing is read."""
        self._go(row, "go past", "and read nothing")
        self.record.append(row)

    def _go(self, planned: Row, action: str, purpose: str) -> None:
        """Say where the machine is to go, unless it is there."""
        commands = {name.split("_")[1]: planned[name] for name in command_columns(planned)}
        position = "  ".join(f"{axis} {float(cell):.3f}" for axis, cell in commands.items())
        if self._place != (self._dials, position):
            self.tell(f"{action:<7}  {position}  {purpose}")
        self._place = self._dials, position
