"""Measuring in conversation: a question, an answer, a row on the disk, until all is settled."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from orthoglide.closing import Closed, close, filled
from orthoglide.errors import FileError, InputError
from orthoglide.machine import Machine
from orthoglide.measuring.answers import HELP, understood
from orthoglide.measuring.expected import Expected
from orthoglide.measuring.program import MOST, SETTLED, Next, following, opening
from orthoglide.measuring.record import AGAIN, SKIPPED, Record
from orthoglide.observations import Moves, Readings
from orthoglide.observations.writing import Row, command_columns
from orthoglide.report.sheet import counted, dial_words, mounted_together
from orthoglide.text import shown
from orthoglide.verdict import Verdict, requested

_OTHERWISE = "give all its numbers with the other sign"


class Stopped(Exception):
    """Somebody asked to stop before the verdict was settled."""


class _Undone(Exception):
    """The last reading was taken back."""


@dataclass(frozen=True)
class End:
    """What measuring came to."""

    verdict: Verdict  # of all readings
    settled: bool  # whether it is
    reason: str  # why no more is asked for, a clause
    readings: int  # that were taken


@dataclass(eq=False)
class Session:
    """One campaign being measured; what its file contains is all that it goes by."""

    machine: Machine  # as its file has it
    record: Record  # the campaign file
    # puts a question and returns what is typed; `EOFError` at the end of input
    ask: Callable[[str], str]
    tell: Callable[[str], None]  # says something
    sheet: Readings | None = None  # to read first; the program's own where absent
    most: int = MOST  # readings after which no more are asked for
    clock: Callable[[], float] = time.time  # seconds; only differences count
    _began: float = field(default=0.0, init=False)
    _at: int = field(default=0, init=False)  # rows of the file that were gone through
    _live: bool = field(default=False, init=False)  # whether the last row was given just now
    _last: tuple[str, ...] = field(default=(), init=False)  # mounting, then position, last said
    # verdict and what follows, by number of rows and how many times readings were taken back
    _verdicts: dict[str, tuple[Closed, Next]] = field(default_factory=dict, init=False)

    def run(self) -> End:
        """Ask until the verdict is settled, or no more is to be read.

        Raises:
            Stopped: where somebody asked to stop.
            InputError: where the file or the sheet cannot be used.
        """
        first = self.sheet or opening(self.machine)
        first = first if len(first.moves) else first.with_moves()
        name = shown(self.record.path)
        if self.record.open(first):
            self.tell(f"{name} holds {self.record.readings} readings: going on after them.")
        else:
            self.tell(f"Readings go to {name}, each as soon as it is given. Answers:\n{HELP}")
        last = max((float(r["time_s"] or 0) for r in self.record.rows), default=0.0)
        self._began = self.clock() - last - self.record.idle
        while True:
            try:
                return self._through(first)
            except _Undone:
                continue
            except EOFError:
                raise Stopped from None

    def _through(self, sheet: Readings) -> End:
        """Go through all sheets; rows that the file contains already are passed over."""
        self._at, self._live, self._last, number = 0, False, self._last[:1], 1
        while True:
            self._read(sheet)
            closed, step = self._verdict(number)
            if step.sheet is None:
                verdict = filled(closed, Verdict)
                return End(verdict, step.settled, step.reason, self.record.readings)
            self.tell(f"\nNot settled yet, {step.reason}: {len(step.sheet)} readings more.")
            sheet, number = step.sheet, number + 1

    def _verdict(self, number: int) -> tuple[Closed, Next]:
        """Return the verdict on the rows so far, and what follows; the file may go on."""
        rows = self.record.rows[: self._at]
        key = str(rows)
        if key not in self._verdicts:
            self.tell("\nComputing the verdict.")
            closed = close(requested(self.record.campaign(rows), self.machine))
            room = self.most - sum(bool(row["reading_mm"]) for row in rows)
            self._verdicts[key] = closed, following(closed, number, room)
        return self._verdicts[key]

    def _read(self, sheet: Readings) -> None:
        """Take the readings of a sheet that the file does not contain yet."""
        expected, taken, reading = Expected.of(sheet, self.machine), dict[int, float](), 0
        for planned in self.record.plan(sheet):
            row, moves = self._recorded(planned), planned["kind"] == "move"
            if row is None:
                self._mounting(sheet, planned)
            if row is None and moves:
                row = self._move(planned)
            elif row is None:
                row = self._question(sheet, planned, reading, expected, taken)
            if row["reading_mm"]:
                taken[reading] = float(row["reading_mm"]) * 1e-3
            self._at, reading = self._at + 1, reading + (not moves)

    def _recorded(self, planned: Row) -> Row | None:
        """Return the row of the file that answers a planned one, if there is one yet."""
        rows = self.record.rows
        while self._at < len(rows) and rows[self._at]["posture"] == AGAIN:
            self._at += 1
        if self._at >= len(rows):
            return None
        row = rows[self._at]
        if any(row[name] != planned[name] for name in ("setup", *command_columns(planned))):
            raise FileError(
                "was not measured with this machine file and sheet: choose another name for --out",
                file=shown(self.record.path),
                line=self._at + 2,
            )
        return row

    # --- Asking ---------------------------------------------------------------------------

    def _question(
        self, sheet: Readings, planned: Row, row: int, expected: Expected, taken: dict[int, float]
    ) -> Row:
        """Ask for one reading until it is given or skipped."""
        if not self._live and self._at:
            self._again(sheet, row)
        self._position(planned, "go to", f"posture {planned['posture']}")
        doubted = None
        while True:
            try:
                answer = understood(self.ask(f"{planned['setup']} shows: "))
            except InputError as error:
                self.tell(f"  {error}")
                continue
            if answer == "help":
                self.tell(f"{HELP}\n{SETTLED}")
            elif answer == "quit":
                raise Stopped
            elif answer == "skip":
                return self._keep(planned | {"kind": "move", "posture": SKIPPED, "repeat": ""})
            elif answer == "undo":
                if self.record.take_back():
                    raise _Undone
                self.tell("  there is no reading to take back")
            else:
                value = float(answer) * 1e-3
                wrong, remedy = expected.impossible(row, value, taken), "Type the number again."
                judged = "cannot be"
                if not wrong and answer != doubted:
                    wrong, judged = expected.doubt(row, value, taken), "is odd"
                    remedy = "Type the same again to keep it, or the right number."
                if not wrong:
                    now = f"{max(self.clock() - self._began, 0.0):.0f}"
                    return self._keep(planned | {"reading_mm": f"{answer:f}", "time_s": now})
                doubted = answer
                self.tell(f"  {answer:f} mm {judged}: {wrong}. {remedy}")

    def _keep(self, row: Row) -> Row:
        self._live = True
        return self.record.append(row)

    def _mounting(self, sheet: Readings, planned: Row) -> None:
        """Say where the dials of a mounting stand, once."""
        names = mounted_together(self.record.plan(sheet))[planned["setup"]]
        if self._last[:1] == (" and ".join(names),):
            return
        self._last = (" and ".join(names),)
        self.tell(f"\nMount {'dials' if len(names) > 1 else 'a dial'}: {self._last[0]}")
        for setup in sheet.setups:
            if setup.name in names:
                words = "\n    ".join(dial_words(setup, self.machine, _OTHERWISE))
                self.tell(f"  {setup.name}\n    {words}")
        self.tell(f"  {counted(self.machine)}")

    def _move(self, planned: Row) -> Row:
        """Send the machine to a place where nothing is read."""
        self._position(planned, "go past", "and read nothing")
        return self._keep(planned)

    def _again(self, sheet: Readings, row: int) -> None:
        """Lead the machine back, so that it comes to the next place from the side it should."""
        back = sheet.command[row] - sheet.moves.beyond * sheet.approach[row]
        alone = replace(sheet.subset([row]), command=back[None], moves=Moves())
        self._move(self.record.plan(alone)[0] | {"kind": "move", "posture": AGAIN, "repeat": ""})
        self._at += 1

    def _position(self, planned: Row, what: str, why: str) -> None:
        cells = {name.split("_")[1]: planned[name] for name in command_columns(planned)}
        place = "  ".join(f"{axis} {float(cell):.3f}" for axis, cell in cells.items())
        if self._last[1:] != (place,):
            self.tell(f"{what:<7}  {place}  {why}")
        self._last = (*self._last[:1], place)
