"""Measuring in conversation: a question, an answer, a row on the disk, until all is settled."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, field, replace

from orthoglide.closing import Closed, close, filled
from orthoglide.errors import FileError, InputError, OrthoglideError
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

_LEAD = 4
"""Readings of a sheet, its last, that are taken while what follows it is computed."""


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
    """One campaign being measured; what its file holds is all that it goes by."""

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
    _told: tuple[str, ...] = field(default=(), init=False)  # mounting, then position, last said
    _ahead: dict[str, Future[Next]] = field(default_factory=dict, init=False)

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
        """All sheets; rows that the file holds already are passed over."""
        self._at, self._live, self._told, number = 0, False, self._told[:1], 1
        while True:
            step = self._read(sheet, number)
            if step.sheet is None:
                self.tell("\nComputing the verdict.")
                rows = self.record.rows[: self._at]  # the file may hold later sheets already
                closed = self._closed(rows)
                step = following(closed, number, self.most - _readings(rows))
                if step.sheet is None:
                    verdict = filled(closed, Verdict)
                    return End(verdict, step.settled, step.reason, self.record.readings)
            self.tell(f"\nNot settled yet, {step.reason}: {len(step.sheet)} readings more.")
            sheet, number = step.sheet, number + 1

    def _read(self, sheet: Readings, number: int) -> Next:
        """Take the readings of one sheet that the file has not yet; what follows from all."""
        wait(self._ahead.values())  # the mechanism serves one at a time
        plan, taken = self.record.plan(sheet), dict[int, float]()
        expected = Expected.of(sheet, self.machine)
        lead = [k for k, row in enumerate(plan) if row["kind"] != "move"][-_LEAD:]
        for k in range(lead[0]):
            self._take(sheet, plan, k, expected, taken)
        ahead = self._following(number, len(lead))
        for k in range(lead[0], len(plan)):
            self._take(sheet, plan, k, expected, taken)
        return ahead.result()

    def _take(
        self,
        sheet: Readings,
        plan: Sequence[Row],
        k: int,
        expected: Expected,
        taken: dict[int, float],
    ) -> None:
        """Take one row of a sheet, or find it in the file; its reading joins those taken."""
        planned, reading = plan[k], sum(row["kind"] != "move" for row in plan[:k])
        row = self._recorded(planned)
        if row is None and planned["kind"] != "move":
            row = self._question(sheet, planned, reading, expected, taken)
        elif row is None:
            self._mounting(sheet, planned)
            row = self._move(planned)
        self._at += 1
        if row["reading_mm"]:
            taken[reading] = float(row["reading_mm"]) * 1e-3

    # --- What was read --------------------------------------------------------------------

    def _recorded(self, planned: Row) -> Row | None:
        """The row of the file that answers a planned one, if there is one yet."""
        rows = self.record.rows
        while self._at < len(rows) and rows[self._at]["posture"] == AGAIN:
            self._at += 1
        if self._at >= len(rows):
            return None
        row = rows[self._at]
        same = ["setup", *command_columns(planned)]
        if [row[name] for name in same] != [planned[name] for name in same]:
            raise FileError(
                "was not measured with this machine file and sheet: choose another name for --out",
                file=shown(self.record.path),
                line=self._at + 2,
            )
        return row

    def _closed(self, rows: Sequence[Row]) -> Closed:
        return close(requested(self.record.campaign(rows), self.machine))

    def _following(self, number: int, left: int) -> Future[Next]:
        """What follows a sheet, from the rows so far; computed while its last ones are read."""
        rows = tuple(self.record.rows[: self._at])
        key = f"{number} {rows}"
        if key not in self._ahead:
            room = self.most - left - _readings(rows)
            self._ahead[key] = _begun(lambda: self._after(rows, number, room))
        return self._ahead[key]

    def _after(self, rows: Sequence[Row], number: int, room: int) -> Next:
        try:
            return following(self._closed(rows), number, room)
        except OrthoglideError:
            return Next("")  # all of the sheet may do, or says what is wrong

    # --- Asking ---------------------------------------------------------------------------

    def _question(
        self, sheet: Readings, planned: Row, row: int, expected: Expected, taken: dict[int, float]
    ) -> Row:
        """Ask for one reading until it is given or skipped."""
        self._mounting(sheet, planned)
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
                empty = {"kind": "move", "posture": SKIPPED, "repeat": ""}
                return self._keep(planned | empty)
            elif answer == "undo":
                if self.record.take_back() is not None:
                    raise _Undone
                self.tell("  there is no reading to take back")
            else:
                value = float(answer) * 1e-3
                no = expected.impossible(row, value, taken)
                odd = "" if answer == doubted else expected.doubt(row, value, taken)
                if not (no or odd):
                    now = max(self.clock() - self._began, 0.0)
                    return self._keep(
                        planned | {"reading_mm": f"{answer:f}", "time_s": f"{now:.0f}"}
                    )
                doubted = answer
                remedy = "Type the number again." if no else (
                    "Type the same again to keep it, or the right number."
                )  # fmt: skip
                self.tell(
                    f"  {answer:f} mm {'cannot be' if no else 'is odd'}: {no or odd}. {remedy}"
                )

    def _keep(self, row: Row) -> Row:
        self._live = True
        return self.record.append(row)

    def _mounting(self, sheet: Readings, planned: Row) -> None:
        """Say where the dials of a mounting stand, once."""
        names = mounted_together(self.record.plan(sheet))[planned["setup"]]
        if self._told[:1] == (" and ".join(names),):
            return
        self._told = (" and ".join(names),)
        self.tell(f"\nMount {'dials' if len(names) > 1 else 'a dial'}: {self._told[0]}")
        for setup in sheet.setups:
            if setup.name in names:
                words = "\n    ".join(dial_words(setup, self.machine, _OTHERWISE))
                self.tell(f"  {setup.name}\n    {words}")
        self.tell(f"  {counted(self.machine)}")

    def _move(self, planned: Row) -> Row:
        """A place to go to, and nothing else."""
        self._position(planned, "go past", "and read nothing")
        return self._keep(planned)

    def _again(self, sheet: Readings, row: int) -> None:
        """Lead the machine back, so that it comes to the next place from the side it should."""
        back = sheet.command[row] - sheet.moves.beyond * sheet.approach[row]
        alone = replace(sheet.subset([row]), command=back[None], moves=Moves())
        told = {"kind": "move", "posture": AGAIN, "repeat": ""}
        self._move(self.record.plan(alone)[0] | told)
        self._at += 1

    def _position(self, planned: Row, what: str, why: str) -> None:
        cells = {name.split("_")[1]: planned[name] for name in command_columns(planned)}
        place = "  ".join(f"{axis} {float(cell):.3f}" for axis, cell in cells.items())
        if self._told[1:] != (place,):
            self.tell(f"{what:<7}  {place}  {why}")
        self._told = (*self._told[:1], place)


def _readings(rows: Sequence[Row]) -> int:
    return sum(bool(row["reading_mm"]) for row in rows)


def _begun(compute: Callable[[], Next]) -> Future[Next]:
    """Begin at once; a process that ends does not wait for it, as it would for a pool."""
    future: Future[Next] = Future()

    def run() -> None:
        try:
            future.set_result(compute())
        except BaseException as error:  # raised again where the result is wanted
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future
