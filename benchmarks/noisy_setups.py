"""One setup noisier or quieter than the machine file says, on sound machines and beside an effect.

    python -m benchmarks.noisy_setups --campaigns 60 --jobs 2 --cache noisy.jsonl

Each machine of `tests/rig.py` has small errors of everything; every other one has an effect of
three to six tolerances besides. One dial has half to five times the noise that is declared of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks import attribution_cases as ac
from benchmarks.attribution_asked import SEEN, named, share, well
from benchmarks.attribution_cases import Case
from benchmarks.attribution_run import Drawn, bare_rig, points_of, run
from benchmarks.independent import Sheet, Visible
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc

RATIOS = (0.5, 1.0, 2.0, 3.0, 5.0)
SHEETS = {"standard": 3, "sweep": 1, "two-gauges": 1}
"""Sheets with the number of visits to each posture: 54, 84 and 168 readings."""

TOLERANCES = (3.0, 6.0)  # of an effect
_NOISE = 5e-6  # metres, as the machine file says


def cases(campaigns: int) -> list[Case]:
    """Return so many campaigns: sound machines and others alternate, then ratios, then sheets."""
    count, sheets = len(RATIOS), list(SHEETS)
    return [
        Case("noisy", ("sound", "effect")[k % 2], sheets[k // (2 * count) % 3],
             RATIOS[k // 2 % count], k // (6 * count))
        for k in range(campaigns)
    ]  # fmt: skip


def draw(case: Case, seed: int, background: float) -> Drawn:
    """Simulate a case; the rows touched are those of the dial with other noise."""
    rng, rows = case.rng(seed), rc.protocol_rows(case.protocol, repeats=SHEETS[case.protocol])
    setups, bare = bare_rig(rows, rng, background)
    causes, rig = [], bare
    if case.what == "effect":
        family = str(rng.choice(ac.PLAIN))
        cause = ac.effect(family, rng, setups)
        causes.append((cause, float(rng.uniform(*TOLERANCES))))
        rig = cause.added_to(bare, causes[0][1])
    chosen = str(rng.choice(setups))
    touched = [k for k, row in enumerate(rows) if row["setup"] == chosen]
    noise = np.full(len(rows), _NOISE)
    noise[touched] *= case.rms
    measured = rc.simulate(rig, rows, rng, noise=noise)
    visible = Visible(Sheet(rows), bare)
    return Drawn(bare, rig, tuple(causes), measured, tuple(touched), points_of(rig, rng), visible)


def _ratio(record: Record) -> float:
    return float(record["key"].split(":")[3])


def _noise_found(record: Record) -> bool:
    """Whether the dial with other noise is the one that is reported as noisy."""
    return any(k == "noisy" and set(rows) <= set(record["touched"])
               for k, rows in record["blunders"])  # fmt: skip


def _other_fault(record: Record) -> bool:
    """Whether a data fault is reported that is none."""
    found = [fault for fault in record["blunders"] if fault[0] == "noisy"]
    return len(record["blunders"]) > len(found) or (bool(found) and not _noise_found(record))


def tables(found: Sequence[Record]) -> list[Table]:
    """What is said, by the ratio of the dial's noise to that declared."""
    rows: list[Sequence[str]] = [
        ("noise", "campaigns", "reported noisy", "another data fault", "sound: something named",
         "effect seen: named", "values within 1.96 sigma", "TCP within its radius")
    ]  # fmt: skip
    for ratio in (*RATIOS, 0.0):
        chosen = [r for r in well(found) if ratio in (_ratio(r), 0.0)]
        if not chosen:
            continue
        sound = [r for r in chosen if r["what"] == "sound"]
        seen = [r for r in chosen if r["truth"] and r["truth"][0]["norm"] >= SEEN]
        values = [abs(z) <= 1.96 for r in chosen for _, z, _ in r["covered"]]
        rows.append((
            f"{ratio:g} x" if ratio else "all", str(len(chosen)), share(chosen, _noise_found),
            share(chosen, _other_fault),
            share(sound, lambda r: bool(r["effects"] or r["located"])), share(seen, named),
            share(values, bool), f"{np.mean([r['tcp']['inside'] for r in chosen]):.3f}",
        ))  # fmt: skip
    note = f"*Seen*: known, the effect lowers chi2 by 25. {len(found) - len(well(found))} refused."
    return [Table("One dial with other noise than declared", note, rows)]


if __name__ == "__main__":
    run_all(__doc__, cases, partial(run, draw=draw), tables, campaigns=60)
