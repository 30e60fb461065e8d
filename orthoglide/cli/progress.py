"""Progress on the error stream: what is being done now, where somebody is looking."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from orthoglide.cli.run import stop_if_asked

if TYPE_CHECKING:
    from rich.progress import Progress

Step = Callable[[str], None]
"""Says what begins now."""


@contextmanager
def progress(quiet: bool) -> Iterator[Step]:
    """Show steps while they run; silent where asked for, or where nobody is looking."""
    if quiet or not sys.stderr.isatty():
        yield _go_on
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(text)


# Where each stage of a closed loop stands when it begins, in per cent of the whole; stages that
# come again and again creep toward the next.
_STAGES = {
    "reading": 2,
    "identifying": 8,
    "looking for faults": 20,
    "testing": 30,
    "trying": 36,
    "comparing": 50,
    "had the dials": 56,
    "allowing": 62,
    "judging": 66,
    "choosing": 70,
    "drawing": 78,
    "writing": 94,
}
_CREEP = 0.15


@contextmanager
def bar(quiet: bool) -> Iterator[Step]:
    """Show a bar that fills as the stages of a closed loop go by; silent as `progress`."""
    if quiet or not sys.stderr.isatty():
        yield _go_on
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(24), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("starting", total=100)
        yield lambda text: shown.update(task, description=text, completed=_share(text, shown))


def _go_on(_: str) -> None:
    """Nothing to show; a stop that compiled code swallowed is heeded at the next stage."""
    stop_if_asked()


def _share(text: str, shown: Progress) -> float:
    """How far it is in per cent; never less than before."""
    now = shown.tasks[0].completed
    begun = [(at, name) for name, at in _STAGES.items() if text.startswith(name)]
    if not begun:
        return now
    at, _ = begun[0]
    later = min((a for a in _STAGES.values() if a > at), default=100)
    return at if now < at else now + max(later - now, 0) * _CREEP
