"""``measure``: asks for one reading after another and says when that is enough."""

from __future__ import annotations

import sys
from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.run import INTERRUPTED, Refusal
from orthoglide.cli.terminal import say
from orthoglide.errors import InputError
from orthoglide.text import is_terminal


@click.command()
@click.option("--out", type=opt.PATH, required=True, metavar="CAMPAIGN.csv",
              help="Readings to write, or to go on with.")  # fmt: skip
@opt.machine()
@click.option("--sheet", type=opt.PATH, metavar="SHEET.csv",
              help="Measuring sheet to read first; its own where absent.")  # fmt: skip
@click.option("--most", type=int, default=126, show_default=True,
              help="Readings after which no more are asked for.")  # fmt: skip
def measure(
    out: Path,
    machine_path: Path | None,
    effects_file: Path | None,
    sheet: Path | None,
    most: int,
) -> None:
    """Ask for one reading after another at the machine, until the verdict is settled.

    Says where each dial stands and where to go, takes what is typed or sent to its standard input
    (12.34, 12,34, 340 um; skip, undo, quit, ?), says at once when a reading cannot be or does not
    agree with its repeats, and asks next for the readings that the verdict suggests. Every
    reading is on the disk before the next question; the same command goes on where it was.

    The verdict is settled when no significant lack of fit is left and no suggested readings would
    separate two explanations by two standard deviations; that nothing is wrong is believed after 90
    readings.
    """
    from orthoglide.measuring import Record, Session, Stopped

    if most < 2:
        raise InputError(f"--most must be 2 or more, not {most}")
    machine = opt.load_machine(machine_path, effects_file)
    otherwise = "measure asks for dials on legs; fill it in and give it to close-loop"
    first = None if sheet is None else opt.dial_sheet(sheet, machine, otherwise)
    record = Record(out, machine.spec)
    session = Session(machine, record, _ask, say, sheet=first, most=most)
    try:
        end = session.run()
    except (Stopped, KeyboardInterrupt):
        if is_terminal():
            say("")  # behind the question
        count = f"{record.readings} reading" + ("" if record.readings == 1 else "s")
        raise Refusal(
            f"stopped before the verdict was settled, with {count} in "
            f"{click.format_filename(out)}: the same command goes on from there",
            INTERRUPTED,
        ) from None
    from orthoglide.report import summary

    word = "Settled" if end.settled else "Not settled"
    options = {"--machine": machine_path, "--effects-file": effects_file}
    given = "".join(f" {o} {click.format_filename(p)}" for o, p in options.items() if p)
    name, found = click.format_filename(out), summary(end.verdict, said="machine")
    say(
        f"{word} after {end.readings} readings: {end.reason}.\n\n{found}\n\n"
        f"The report: orthoglide close-loop {name}{given} --out {click.format_filename(out.stem)}",
        needed=True,
    )


def _ask(question: str) -> str:
    """Put a question; what is typed, or comes next on standard input."""
    if is_terminal() and sys.stdin.isatty():
        return input(question)
    say(question)
    answer = sys.stdin.readline()
    if not answer:
        raise EOFError
    return answer
