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
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.attribution_cases import BACKGROUND, SHARES, SHORT, cases
from benchmarks.attribution_run import run
from benchmarks.attribution_table import tables
from benchmarks.runs import arguments, records, show


def main() -> None:
    parser = arguments(__doc__, campaigns=sum(SHARES.values()), short=45)
    parser.add_argument("--background", type=float, default=BACKGROUND)
    parser.add_argument("--only", choices=(*SHARES, *SHORT), default="")
    options = parser.parse_args()
    wanted = cases(options.campaigns, options.only, options.short)
    drawn = {"seed": options.seed, "background": options.background}
    found = records(
        wanted, partial(run, **drawn), options, seed=options.seed, share=options.background
    )
    show(tables(found))


if __name__ == "__main__":
    main()
