"""Figures of the frozen runs beside those of a fresh one, on the campaigns that both have.

    python -m benchmarks.compare_frozen NAME [FRESH.jsonl] [--all]

NAME is a cache of `benchmarks/frozen`: attribution, whole_machines, second_visit, blunders,
stands_out, delta_truth or gains. Without a fresh cache the frozen tables are printed alone. Cells
that differ read ``frozen -> fresh``. Run the benchmark with the seed of the frozen run.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

from benchmarks import (
    attribution_table,
    blunders,
    delta_table,
    gains,
    second_visit,
    stands_out,
    whole_machines,
)
from benchmarks.runs import Record, Table, key_of

FROZEN = Path(__file__).parent / "frozen"

Rows = list[list[str]]
"""Lines of tables, cell by cell; a heading is one cell."""

TABLES: dict[str, Callable[[Sequence[Record]], Iterable[Table]]] = {
    "attribution": attribution_table.tables,
    "whole_machines": whole_machines.tables,
    "second_visit": second_visit.tables,
    "blunders": blunders.tables,
    "stands_out": stands_out.tables,
    "delta_truth": delta_table.tables,
    "gains": gains.tables,
}
"""The tables of each benchmark, from its records."""


def rows_of(name: str, records: Iterable[Record]) -> Rows:
    """Return the lines of a benchmark's tables."""
    rows: Rows = []
    for table in TABLES[name](list(records)):
        rows += [[""], [f"## {table.title}"], [""]] if table.title else []
        rows += map(list, table.rows)
    return rows


def records_in(path: Path) -> dict[str, Record]:
    """Return the records of a cache, gzipped or not, by seed and case."""
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8") as file:
        found = [json.loads(line) for line in file]
    return {_identity(r): r for r in found}


def _identity(record: Record) -> str:
    seed = record["seed"] if "seed" in record else record["world"]["seed"]  # of former runs
    return f"{seed}: {key_of(record)}"


def frozen_path(name: str) -> Path:
    """Return the cache of a frozen run."""
    return FROZEN / f"{name}.jsonl.gz"


def side_by_side(before: Rows, after: Rows) -> Iterator[str]:
    """Yield the lines of two tables of one shape, cells that differ with an arrow between."""
    for one, other in zip_longest(before, after, fillvalue=[]):
        if len(one) == len(other) == 1 or len(one) != len(other):
            yield from dict.fromkeys((" | ".join(one), " | ".join(other)))
            continue
        cells = (
            a if a == b else f"{a or '-'} -> {b or '-'}" for a, b in zip(one, other, strict=True)
        )
        yield "| " + " | ".join(cells) + " |"


def compared(name: str, fresh: Path | None, everything: bool = False) -> Iterator[str]:
    """Yield the lines of a benchmark's tables, frozen beside fresh.

    Args:
        name: of the benchmark.
        fresh: cache of another run; without one the frozen tables alone.
        everything: whether campaigns count that only one of both has.
    """
    before = records_in(frozen_path(name))
    after = before if fresh is None else records_in(fresh)
    common = [key for key in before if key in after]
    if not everything and common:
        before, after = ({k: kept[k] for k in common} for kept in (before, after))
    yield f"{name}: {len(before)} campaigns frozen, {len(after)} fresh, {len(common)} in both"
    if not common:
        yield "No campaign is in both: run the benchmark with the seed of the frozen run."
    yield from side_by_side(rows_of(name, before.values()), rows_of(name, after.values()))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=TABLES)
    parser.add_argument("fresh", type=Path, nargs="?", help="cache of a fresh run, JSON lines")
    parser.add_argument("--all", action="store_true", help="campaigns of either run, not of both")
    options = parser.parse_args(arguments)
    print("\n".join(compared(options.name, options.fresh, options.all)))


if __name__ == "__main__":
    main()
