"""Measuring in conversation: a question, an answer, a row on the disk, until all is settled."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Literal

from orthoglide.closing import close, filled
from orthoglide.errors import FileError, InputError
from orthoglide.machine import Machine
from orthoglide.measuring.expected import Expected
from orthoglide.measuring.program import MOST, SETTLED, following, opening
from orthoglide.measuring.record import AGAIN, SKIPPED, Record
from orthoglide.observations import Moves, Readings
from orthoglide.observations.writing import Row, command_columns
from orthoglide.report.sheet import counted, dial_words, mounted_together
from orthoglide.text import brief, shown
from orthoglide.verdict import Verdict, requested

# --- What is typed, or sent by a dial -------------------------------------------------------------

Word = Literal["skip", "undo", "quit", "help"]

_WORDS: dict[str, Word] = {
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
_LARGEST = Decimal(1000)  # millimetres: no dial shows more


def understood(answer: str) -> Decimal | Word:
    """Return a reading in millimetres, exactly as it was given, or what a word asks for.

    Raises:
        InputError: if the answer is neither.
    """
    text = answer.strip().replace("−", "-")
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    found = _NUMBER.fullmatch(text)
    if found is None:
        raise InputError(
            f"{brief(text)!r} is no reading: type a number such as 12.34, or ? for help"
        )
    in_mm = (found[2] or "mm").lower() == "mm"
    value = Decimal(found[1].replace(",", ".")).scaleb(0 if in_mm else -3)
    if abs(value) > _LARGEST:
        raise InputError(f"{brief(text)} is more than any dial shows: give millimetres")
    return value


# --- The conversation -----------------------------------------------------------------------------


@dataclass(frozen=True)
class End:
    """Outcome of a measuring session."""

    verdict: Verdict  # of all readings
    settled: bool  # whether the verdict is settled
    reason: str  # why no more is asked for, a clause
    readings: int  # number of readings taken


@dataclass(frozen=True, eq=False)
class _Part:
    """A sheet that the session goes through."""

    sheet: Readings
    rows: list[Row]  # as the file has them, moves included
    first_row: int  # number of rows of all sheets before it
    expected: Expected  # readings of the sheet

    @property
    def end(self) -> int:
        """Number of rows up to the end of this sheet."""
        return self.first_row + len(self.rows)


@dataclass(eq=False)
class Session:
    """One campaign being measured: its file determines what is asked next."""

    machine: Machine  # as its file has it
    record: Record  # the campaign file
    # puts a question and returns what is typed; `EOFError` at the end of input
    ask: Callable[[str], str]
    tell: Callable[[str], None]  # says something
    sheet: Readings | None = None  # to read first; the program's own where absent
    most: int = MOST  # readings after which no more are asked for
    clock: Callable[[], float] = time.time  # seconds; only differences count
    _began: float = field(default=0.0, init=False)
    _parts: list[_Part] = field(default_factory=list, init=False)  # up to the row that is next
    # True if this session moved the machine to the last row of the file
    _live: bool = field(default=False, init=False)
    _mounted: str = field(default="", init=False)  # dials that were told last
    _place: str = field(default="", init=False)  # position that was told last

    def run(self) -> End | None:
        """Ask until the verdict is settled, or no more is to be read.

        Returns:
            What it came to; `None` if somebody asked to stop, or the input ended.

        Raises:
            InputError: if the file or the sheet cannot be used.
        """
        first, name = self.sheet or opening(self.machine), shown(self.record.path)
        first = first if len(first.moves) else first.with_moves()
        if self.record.open(first):
            self.tell(f"{name} holds {self.record.readings} readings: going on after them.")
        else:
            self.tell(f"Readings go to {name}, each as soon as it is given. Answers:\n{HELP}")
        last = max((float(row["time_s"] or 0) for row in self.record.rows), default=0.0)
        self._began = self.clock() - last - self.record.idle
        self._begin(first)
        while True:
            while self._done < self._parts[-1].first_row:  # a reading was taken back
                self._parts.pop()
            part = self._parts[-1]
            if self._done < part.end:
                if not self._read_next(part):
                    return None
                continue
            rows = self.record.rows[: int(self._answers[part.end - 1]["order"]) + 1]
            self.tell("\nComputing the verdict.")
            closed = close(requested(self.record.campaign(rows), self.machine))
            room = self.most - sum(bool(row["reading_mm"]) for row in rows)
            step = following(closed, len(self._parts), room)
            if step.sheet is None:
                verdict = filled(closed, Verdict)
                return End(verdict, step.settled, step.reason, self.record.readings)
            self.tell(f"\nNot settled yet, {step.reason}: {len(step.sheet)} readings more.")
            self._begin(step.sheet)

    @property
    def _answers(self) -> list[Row]:
        """Rows of the file, without those that lead back, in the order of the sheets."""
        return [row for row in self.record.rows if row["posture"] != AGAIN]

    @property
    def _done(self) -> int:
        return len(self._answers)

    def _begin(self, sheet: Readings) -> None:
        """Go on with a sheet, of which the file may contain rows already.

        Raises:
            FileError: if these are rows of another sheet.
        """
        start, rows = self._parts[-1].end if self._parts else 0, self.record.plan(sheet)
        for row, planned in zip(self._answers[start:], rows, strict=False):
            if any(row[name] != planned[name] for name in ("setup", *command_columns(planned))):
                raise FileError(
                    "was not measured with this machine file and sheet: choose another name for "
                    "--out",
                    file=shown(self.record.path),
                    line=int(row["order"]) + 2,
                )
        self._parts.append(_Part(sheet, rows, start, Expected.of(sheet, self.machine)))

    def _read_next(self, part: _Part) -> bool:
        """Go to the next place of a sheet and read it; return False if somebody asks to stop."""
        before = part.rows[: self._done - part.first_row]
        planned, reading = part.rows[len(before)], sum(row["kind"] != "move" for row in before)
        self._mount(part, planned["setup"])
        if planned["kind"] == "move":
            self._move_without_reading(planned)
            return True
        if not self._live and self.record.rows:
            self._lead_back(part.sheet, reading)
        self._tell_position(planned, "go to", f"posture {planned['posture']}")
        return self._question(part, planned, reading)

    def _question(self, part: _Part, planned: Row, reading: int) -> bool:
        """Ask for one reading until it is given, skipped, or the one before is taken back."""
        answers = zip(part.rows, self._answers[part.first_row :], strict=False)
        taken = [row["reading_mm"] for asked, row in answers if asked["kind"] != "move"]
        known = {k: float(value) * 1e-3 for k, value in enumerate(taken) if value}
        doubted = None
        while True:
            try:
                answer = understood(self.ask(f"{planned['setup']} shows: "))
            except InputError as error:
                self.tell(f"  {error}")
                continue
            except EOFError:
                return False
            if answer == "quit":
                return False
            if answer == "help":
                self.tell(f"{HELP}\n{SETTLED}")
            elif answer == "skip":
                self._append_row(planned | {"kind": "move", "posture": SKIPPED, "repeat": ""})
                return True
            elif answer == "undo":
                if self.record.take_back():
                    self._live, self._place = False, ""
                    return True
                self.tell("  there is no reading to take back")
            else:
                wrong, possible = part.expected.objection(reading, float(answer) * 1e-3, known)
                if not wrong or (possible and answer == doubted):
                    now = f"{max(self.clock() - self._began, 0.0):.0f}"
                    self._append_row(planned | {"reading_mm": f"{answer:f}", "time_s": now})
                    return True
                doubted, judged = answer, "is implausible" if possible else "cannot be"
                remedy = "Type the same again to keep it, or the right number."
                remedy = remedy if possible else "Type the number again."
                self.tell(f"  {answer:f} mm {judged}: {wrong}. {remedy}")

    def _append_row(self, row: Row) -> None:
        self.record.append(row)
        self._live = True

    def _mount(self, part: _Part, setup: str) -> None:
        """Say where the dials of a mounting stand, once."""
        names = mounted_together(part.rows)[setup]
        if self._mounted == " and ".join(names):
            return
        self._mounted, self._place = " and ".join(names), ""
        self.tell(f"\nMount {'dials' if len(names) > 1 else 'a dial'}: {self._mounted}")
        for one in part.sheet.setups:
            if one.name in names:
                otherwise = "give all its numbers with the other sign"
                words = "\n    ".join(dial_words(one, self.machine, otherwise))
                self.tell(f"  {one.name}\n    {words}")
        self.tell(f"  {counted(self.machine)}")

    def _move_without_reading(self, row: Row) -> None:
        """Send the machine to a place where nothing is read."""
        self._tell_position(row, "go past", "and read nothing")
        self._append_row(row)

    def _lead_back(self, sheet: Readings, reading: int) -> None:
        """Lead the machine back, so that it comes to the next place from the prescribed side."""
        back = sheet.command[reading] - sheet.moves.beyond * sheet.approach[reading]
        alone = replace(sheet.subset([reading]), command=back[None], moves=Moves())
        self._move_without_reading(
            self.record.plan(alone)[0] | {"kind": "move", "posture": AGAIN, "repeat": ""}
        )

    def _tell_position(self, planned: Row, what: str, why: str) -> None:
        cells = {name.split("_")[1]: planned[name] for name in command_columns(planned)}
        place = "  ".join(f"{axis} {float(cell):.3f}" for axis, cell in cells.items())
        if self._place != place:
            self.tell(f"{what:<7}  {place}  {why}")
        self._place = place
