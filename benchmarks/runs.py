"""Runs of many cases on several processes, which go on from a file, and tables of what they say."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

Record = dict[str, Any]
"""What became of one case, ready for JSON: ``case`` or ``key`` say which, ``seed`` how drawn."""


def arguments(says: str, **counts: int) -> argparse.ArgumentParser:
    """Return the options of a benchmark: how many of what, with what is usual, and how it runs."""
    parser = argparse.ArgumentParser(description=says.splitlines()[0])
    for name, usual in counts.items():
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", "--workers", type=int, default=2, help="processes")
    parser.add_argument("--cache", type=Path, help="JSON lines; a run goes on from here")
    parser.add_argument("--finished", action="store_true", help="the tables of the cache as it is")
    return parser


def run_all(
    says: str,
    cases: Callable[..., Iterable[Any]],
    run: Callable[..., Record],
    tables: Callable[[Sequence[Record]], Iterable[Table]],
    **counts: int,
) -> None:
    """Run the cases that a command line asks for, and print their tables.

    Args:
        says: the benchmark's docstring.
        cases: from the counts, in their order.
        run: one case, given the ``seed``.
        tables: of the records.
        counts: how many of what, with what is usual.
    """
    options = arguments(says, **counts).parse_args()
    wanted = [*cases(*(getattr(options, name) for name in counts))]
    show(tables(records(wanted, partial(run, seed=options.seed), options)))


def key_of(case: Any) -> str:
    """Return the name of a case, or of that of a record, unique in a run."""
    if isinstance(case, dict):
        case = case.get("key") or case["case"]
    return str(getattr(case, "key", None) or (case if isinstance(case, str) else json.dumps(case)))


def records(
    cases: Sequence[Any],
    run: Callable[[Any], Record],
    options: argparse.Namespace,
    **drawn: Any,
) -> list[Record]:
    """Return the records of all cases in their order, those of an earlier run from the cache.

    Args:
        cases: to run, with ``--finished`` those alone that the cache has.
        run: one case, on another process.
        options: of :func:`arguments`.
        drawn: fields by which a record was drawn as these are: the seed where absent.
    """
    drawn = drawn or {"seed": options.seed}
    found = {key_of(r): r for r in _kept(options.cache)
             if all(r[name] == value for name, value in drawn.items())}  # fmt: skip
    if options.finished:
        cases = [c for c in cases if key_of(c) in found]
    # In no order of kinds, so that what is there after a while is a fair part of the whole.
    missing = sorted((c for c in cases if key_of(c) not in found),
                     key=lambda c: crc32(key_of(c).encode()))  # fmt: skip
    with multiprocessing.get_context("fork").Pool(options.jobs) as pool:
        for record in _shown(pool.imap_unordered(run, missing), len(missing)):
            found[key_of(record)] = record
            if options.cache:
                with options.cache.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(record) + "\n")
    return [found[key_of(c)] for c in cases]


def _kept(cache: Path | None) -> Iterator[Record]:
    """Yield the records of an earlier run."""
    if cache is not None and cache.exists():
        for line in cache.read_text(encoding="utf-8").splitlines():
            with suppress(json.JSONDecodeError):  # it was killed while writing
                yield json.loads(line)


def _shown(done: Iterator[Record], count: int) -> Iterator[Record]:
    """Yield what is done under a progress bar, where somebody looks."""
    from rich.console import Console
    from rich.progress import track

    hidden = not sys.stderr.isatty()
    yield from track(done, "cases", count, console=Console(stderr=True), disable=hidden)


@dataclass(frozen=True)
class Table:
    """A heading, a sentence, and rows of cells; the first row holds the columns' names."""

    title: str
    note: str
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """A table of Markdown."""
        lines = ["| " + " | ".join(row) + " |" for row in self.rows]
        lines.insert(1, "|---" + "|---:" * (len(self.rows[0]) - 1) + "|")
        heading = f"\n## {self.title}\n" if self.title else ""
        return "\n".join([*filter(None, (heading, self.note and f"{self.note}\n")), *lines])


def show(tables: Iterable[Table]) -> None:
    """Print tables as Markdown."""
    print(*(table.markdown() for table in tables), sep="\n")
