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

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

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
from benchmarks.attribution_cases import BACKGROUND, SHARES, SHORT, cases
from benchmarks.attribution_run import run
from benchmarks.attribution_table import tables
from benchmarks.runs import Record, arguments, records, show


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


def main() -> None:
    parser = arguments(__doc__, campaigns=sum(SHARES.values()), short=45)
    parser.add_argument("--background", type=float, default=BACKGROUND)
    parser.add_argument("--only", choices=(*SHARES, *SHORT), default="")
    parser.add_argument("--failures", action="store_true", help="list what went wrong")
    options = parser.parse_args()
    wanted = cases(options.campaigns, options.only, options.short)
    drawn = {"seed": options.seed, "background": options.background}
    found = records(
        wanted, partial(run, **drawn), options, seed=options.seed, share=options.background
    )
    show(tables(found))
    if options.failures:
        print("\nFailures\n\n" + "\n".join(failures(found)))


if __name__ == "__main__":
    main()
