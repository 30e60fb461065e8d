"""The truth table: does closing the loop name what is wrong, and nothing where nothing is?

    python benchmarks/attribution.py [--campaigns 824] [--short 45] [--cache FILE.jsonl]

Campaigns are simulated by the tests' own machine (`tests/rig.py`, six bars, numpy alone), never by
the package's model. Each has joint offsets of about 1 mm and lengths of about 0.05 mm, a noise of
5 um rounded to 0.01 mm, dials misplaced by about 1 mm, and small errors of everything else, which
together show less than half a sigma of the averaged readings past the base in 95 of 100 machines
(`--background` makes them larger: false alarms then are no errors of the test, as something is
there, and rise).

An effect is *clear* where what it shows past the base has an rms of at least 3 sigma of the
averaged readings (single sigma / sqrt(visits from one side)), and lies at least 5 sigma (norm) from
the nearest other class. Its own class are the effects within 2 sigma, which nobody could tell
apart.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import json
import multiprocessing
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from zlib import crc32

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.attribution_asked import (
    alarmed,
    clear,
    holds,
    misplaced,
    named,
    placed,
    seen,
    well,
    wrongly_explained,
)  # fmt: skip
from benchmarks.attribution_cases import BACKGROUND, SHARES, SHORT, Case, cases
from benchmarks.attribution_former import former
from benchmarks.attribution_run import Record, run
from benchmarks.attribution_table import tables


def known(cache: Path | None, seed: int, background: float) -> dict[str, Record]:
    """Records of an earlier run by key."""
    if cache is None or not cache.exists():
        return {}
    found = {}
    for line in cache.read_text(encoding="utf-8").splitlines():
        try:
            record = json.loads(line)
        except json.JSONDecodeError:  # killed while writing
            continue
        if (record["seed"], record["share"]) == (seed, background):
            found[record["key"]] = record
    return found


def records(
    wanted: Sequence[Case], seed: int, background: float, workers: int, cache: Path | None
) -> Iterator[Record]:
    """Records of the cases that are not in the cache, as they end; kept in the cache."""
    before = known(cache, seed, background)
    # In no order of kinds, so that what is there after a while is a fair part of the whole.
    missing = [c for c in wanted if c.key not in before]
    missing.sort(key=lambda c: crc32(c.key.encode()))
    yield from (before[c.key] for c in wanted if c.key in before)
    file = cache.open("a", encoding="utf-8") if cache else None
    with multiprocessing.get_context("fork").Pool(workers) as pool:
        for record in pool.imap_unordered(partial(run, seed=seed, background=background), missing):
            if file:
                file.write(json.dumps(record) + "\n")
                file.flush()
            yield record
    if file:
        file.close()


def collect(wanted: Sequence[Case], options: argparse.Namespace) -> list[Record]:
    """All records in the order of the cases, under a progress bar."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    bar = Progress(
        "campaigns", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=Console(stderr=True), disable=options.quiet,
    )  # fmt: skip
    with bar:
        found = {
            r["key"]: r
            for r in bar.track(
                records(wanted, options.seed, options.background, options.workers, options.cache),
                total=len(wanted),
            )
        }
    return [found[c.key] for c in wanted]


def failures(found: Sequence[Record]) -> list[str]:
    """A line for every campaign that went against a requirement."""
    lines = []
    for r in found:
        if r["word"] in ("error", "crash"):
            lines.append(f"{r['key']}: {r['word']}: {r['message'].strip().splitlines()[-1]}")
    for r in well(found):
        kind, truth = r["kind"], r["truth"]
        missed = kind in ("effect", "structured") and truth and clear(truth[0]) and not named(r)
        extra = kind in ("effect", "structured") and len(r["effects"]) > 1
        alarm = kind == "nothing" and alarmed(r)
        claimed = kind == "fault" and not r["blunders"] and wrongly_explained(r)
        strange = kind == "outside" and truth and seen(r)
        pair = (
            kind == "pair"
            and truth
            and all(map(clear, truth))
            and not all(any(holds(e, t) for e in r["effects"]) for t in truth)
        )
        reasons = {
            "missed": missed, "second effect": extra, "false alarm": alarm, "wrong name": claimed,
            "pair": pair, "wrong place": strange and misplaced(r),
            "not located": strange and not placed(r) and not misplaced(r),
        }  # fmt: skip
        if any(reasons.values()):
            why = ", ".join(k for k, v in reasons.items() if v)
            lines.append(f"{r['key']}: {why}: {_told(r)}")
    return lines


def _told(r: Record) -> str:
    truth = " + ".join(
        f"{t['name']} {' '.join(t['places'])} rms {t['rms']:.1f}, "
        f"{t['distance']:.1f} from {t['nearest']}"
        for t in r["truth"]
    )
    effects = " + ".join(
        f"{e['name']} (p {e['members'][0][2]:.2f}, {len(e['members']) - 1} rivals)"
        for e in r["effects"]
    )
    places = " + ".join("|".join(f["places"]) for f in r["located"])
    chi2 = f"chi2 {r['chi2'][0]:.0f} -> {r['chi2'][1]:.0f} on {r['chi2'][2]}"
    left = f"left p {r['left'][0]:.4f}, {r['left'][1]:.4f}"
    said = f"{r['word']}: {effects or '-'}; {places or '-'}"
    return f"truth {truth or '-'}; {said}; {chi2}; {left}; {r['stopped']}"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=sum(SHARES.values()))
    parser.add_argument("--background", type=float, default=BACKGROUND)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=(*SHARES, *SHORT), default="")
    parser.add_argument("--short", type=int, default=45, help="of bumps, and of short waves")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="JSON lines; a run goes on from here")
    parser.add_argument("--finished", action="store_true", help="tables of the cache as it is")
    parser.add_argument("--markdown", action="store_true")
    parser.add_argument("--failures", action="store_true", help="list what went wrong")
    parser.add_argument("--quiet", action="store_true")
    options = parser.parse_args(arguments)
    wanted = cases(options.campaigns, options.only, options.short)
    if options.finished:
        before = known(options.cache, options.seed, options.background)
        wanted = [c for c in wanted if c.key in before]
    found = collect(wanted, options)
    for table in (*tables(found), *former(found)):
        print(table.markdown() if options.markdown else table.text())
    if options.failures:
        print("\nFailures\n\n" + "\n".join(failures(found)))


if __name__ == "__main__":
    main()
