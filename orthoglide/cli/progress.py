"""Progress on the error stream: a bar on a terminal, a line now and then where it is piped."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from orthoglide.cli.run import stop_if_asked
from orthoglide.cli.terminal import say
from orthoglide.progress import Progress, Step
from orthoglide.text import is_terminal

_CREEP = 0.15  # of what is left of a stage, each time that the stage comes again
_BETWEEN = 1.0  # seconds between two lines


@contextmanager
def progress(quiet: bool) -> Iterator[Progress]:
    """Show steps while they run, unless quiet.

    A stop that compiled code swallowed is heeded at every step, shown or not.
    """
    if quiet:
        yield lambda _: stop_if_asked()
    elif not is_terminal(err=True):
        yield _lines()
    else:
        with _bar() as shown:
            yield shown


def _lines() -> Progress:
    """Plain lines, at most one a second; a run that is over sooner prints none."""
    begun = last = time.monotonic()

    def show(step: Step) -> None:
        nonlocal last
        stop_if_asked()
        now = time.monotonic()
        if now - last >= _BETWEEN:
            last = now
            say(f"{now - begun:4.0f} s  {step}", err=True)

    return show


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress as Bar, TextColumn, TimeElapsedColumn

    columns = (BarColumn(24), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Bar(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("starting", total=100)

        def show(step: Step) -> None:
            stop_if_asked()
            done = share(step, shown.tasks[0].completed)
            shown.update(task, description=str(step), completed=done)

        yield show


def share(step: Step, now: float) -> float:
    """How far a run is when a step begins, per cent; never less than ``now``, where it was."""
    if step.done is not None:
        return max(step.done, now)
    if now < step.begins:
        return step.begins
    return now + max(step.ends - now, 0) * _CREEP
