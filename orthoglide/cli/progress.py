"""Progress on the error stream: what is being done now, where somebody is looking."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Step = Callable[[str], None]
"""Says what begins now."""


@contextmanager
def progress(quiet: bool) -> Iterator[Step]:
    """Show steps while they run; silent where asked for, or where nobody is looking."""
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(text)
