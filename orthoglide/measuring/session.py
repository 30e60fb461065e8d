"""Measuring in conversation: a question, an answer, a row on the disk, until all is settled."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Literal

from orthoglide.closing import build_result, compute_outcome
from orthoglide.errors import FileError, InputError
from orthoglide.machine import Machine
from orthoglide.measuring.expected import ExpectedReadings
from orthoglide.measuring.record import RETURN_POSTURE, SKIPPED_POSTURE, Record
from orthoglide.measuring.schedule import MAX_READINGS, SETTLED_CRITERION, next_step, opening_sheet
from orthoglide.observations import Moves, Readings
from orthoglide.observations.writing import Row, command_columns
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
            f"{abbreviated(text)!r} is no reading: type a number such as 12.34, or ? for help"
        )
    in_mm = (number[2] or "mm").lower() == "mm"
    value = Decimal(number[1].replace(",", ".")).scaleb(0 if in_mm else -3)
    if abs(value) > _LARGEST_READING:
        raise InputError(f"{abbreviated(text)} is more than any dial shows: give millimetres")
    return value


# --- The conversation -----------------------------------------------------------------------------


@dataclass(frozen=True)
class SessionEnd:
    """Outcome of a measuring session."""

    verdict: Verdict  # of all readings
    settled: bool  # whether the verdict is settled
    reason: str  # why no more is asked for, a clause
    readings: int  # number of readings taken


@dataclass(frozen=True, eq=False)
class _SheetProgress:
    """A sheet that the session goes through."""

    sheet: Readings
    rows: list[Row]  # as the file has them, moves included
    first_row: int  # number of rows of all sheets before it
    expected: ExpectedReadings  # readings of the sheet

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
    max_readings: int = MAX_READINGS  # readings after which no more are asked for
    clock: Callable[[], float] = time.time  # seconds; only differences count
    _start_time: float = field(default=0.0, init=False)
    _parts: list[_SheetProgress] = field(default_factory=list, init=False)  # up to the next row
    _machine_in_place: bool = field(default=False, init=False)  # at the last row of the file
    _announced_dials: str = field(default="", init=False)  # dials announced last
    _announced_position: str = field(default="", init=False)  # position announced last

    def run(self) -> SessionEnd | None:
        """Ask until the verdict is settled, or no more is to be read.

        Returns:
            What it came to; `None` if somebody asked to stop, or the input ended.

        Raises:
            InputError: if the file or the sheet cannot be used.
        """
        first = self.sheet or opening_sheet(self.machine)
        file_name = printable_path(self.record.path)
        first = first if len(first.moves) else first.with_moves()
        if self.record.open(first):
            self.tell(f"{file_name} holds {self.record.readings} readings: going on after them.")
        else:
            self.tell(f"Readings go to {file_name}, each as soon as it is given. Answers:\n{HELP}")
        last_time = max((float(row["time_s"] or 0) for row in self.record.rows), default=0.0)
        self._start_time = self.clock() - last_time - self.record.idle
        self._begin_sheet(first)
        while True:
            while self._rows_done < self._parts[-1].first_row:  # a reading was taken back
                self._parts.pop()
            progress = self._parts[-1]
            if self._rows_done < progress.end:
                if not self._read_next(progress):
                    return None
                continue
            rows = self.record.rows[: int(self._sheet_rows[progress.end - 1]["order"]) + 1]
            self.tell("\nComputing the verdict.")
            outcome = compute_outcome(build_request(self.record.campaign(rows), self.machine))
            readings_left = self.max_readings - sum(bool(row["reading_mm"]) for row in rows)
            step = next_step(outcome, len(self._parts), readings_left)
            if step.sheet is None:
                verdict = build_result(outcome, Verdict)
                return SessionEnd(verdict, step.settled, step.reason, self.record.readings)
            self.tell(f"\nNot settled yet, {step.reason}: {len(step.sheet)} readings more.")
            self._begin_sheet(step.sheet)

    @property
    def _sheet_rows(self) -> list[Row]:
        """Rows of the file in the order of the sheets, without moves that lead back."""
        return [row for row in self.record.rows if row["posture"] != RETURN_POSTURE]

    @property
    def _rows_done(self) -> int:
        return len(self._sheet_rows)

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
        self._parts.append(
            _SheetProgress(sheet, rows, start, ExpectedReadings.of(sheet, self.machine))
        )

    def _read_next(self, progress: _SheetProgress) -> bool:
        """Go to the next place of a sheet and read it; return False if somebody asks to stop."""
        count = self._rows_done - progress.first_row
        planned = progress.rows[count]
        reading = sum(row["kind"] != "move" for row in progress.rows[:count])
        self._announce_mounting(progress, planned["setup"])
        if planned["kind"] == "move":
            self._move_without_reading(planned)
            return True
        if not self._machine_in_place and self.record.rows:
            self._lead_back(progress.sheet, reading)
        self._tell_position(planned, "go to", f"posture {planned['posture']}")
        return self._ask_reading(progress, planned, reading)

    def _ask_reading(self, progress: _SheetProgress, planned: Row, reading: int) -> bool:
        """Ask for one reading until it is given, skipped, or the one before is taken back."""
        answers = zip(progress.rows, self._sheet_rows[progress.first_row :], strict=False)
        cells = [row["reading_mm"] for sheet_row, row in answers if sheet_row["kind"] != "move"]
        taken = {k: float(cell) * 1e-3 for k, cell in enumerate(cells) if cell}
        doubted = None
        while True:
            try:
                answer = parse_answer(self.ask(f"{planned['setup']} shows: "))
            except InputError as error:
                self.tell(f"  {error}")
                continue
            except EOFError:
                return False
            if answer == "quit":
                return False
            if answer == "help":
                self.tell(f"{HELP}\n{SETTLED_CRITERION}")
            elif answer == "skip":
                self._append_row(_as_move(planned, SKIPPED_POSTURE))
                return True
            elif answer == "undo":
                if self.record.take_back():
                    self._machine_in_place, self._announced_position = False, ""
                    return True
                self.tell("  there is no reading to take back")
            else:
                metres = float(answer) * 1e-3
                objection, possible = progress.expected.objection(reading, metres, taken)
                if not objection or (possible and answer == doubted):
                    seconds = f"{max(self.clock() - self._start_time, 0.0):.0f}"
                    self._append_row(planned | {"reading_mm": f"{answer:f}", "time_s": seconds})
                    return True
                doubted, judgement = answer, "is implausible" if possible else "cannot be"
                remedy = "Type the same again to keep it, or the right number."
                remedy = remedy if possible else "Type the number again."
                self.tell(f"  {answer:f} mm {judgement}: {objection}. {remedy}")

    def _append_row(self, row: Row) -> None:
        self.record.append(row)
        self._machine_in_place = True

    def _announce_mounting(self, progress: _SheetProgress, setup: str) -> None:
        """Say where the dials of a mounting stand, once."""
        names = mounted_together(progress.rows)[setup]
        if self._announced_dials == " and ".join(names):
            return
        self._announced_dials, self._announced_position = " and ".join(names), ""
        self.tell(f"\nMount {'dials' if len(names) > 1 else 'a dial'}: {self._announced_dials}")
        for dial in progress.sheet.setups:
            if dial.name in names:
                remedy = "give all its numbers with the other sign"
                words = "\n    ".join(dial_words(dial, self.machine, remedy))
                self.tell(f"  {dial.name}\n    {words}")
        self.tell(f"  {command_convention(self.machine)}")

    def _move_without_reading(self, row: Row) -> None:
        """Send the machine to a place where nothing is read."""
        self._tell_position(row, "go past", "and read nothing")
        self._append_row(row)

    def _lead_back(self, sheet: Readings, reading: int) -> None:
        """Lead the machine back, so that it comes to the next place from the prescribed side."""
        command = sheet.command[reading] - sheet.moves.overshoot * sheet.approach[reading]
        target = replace(sheet.subset([reading]), command=command[None], moves=Moves())
        self._move_without_reading(_as_move(self.record.plan(target)[0], RETURN_POSTURE))

    def _tell_position(self, planned: Row, action: str, purpose: str) -> None:
        commands = {name.split("_")[1]: planned[name] for name in command_columns(planned)}
        position = "  ".join(f"{axis} {float(cell):.3f}" for axis, cell in commands.items())
        if self._announced_position != position:
            self.tell(f"{action:<7}  {position}  {purpose}")
        self._announced_position = position
