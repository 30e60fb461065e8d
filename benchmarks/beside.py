"""Errors that no catalogue lists, beside something else that is wrong.

    python -m benchmarks.beside --campaigns 60 --jobs 2 --cache beside.jsonl

Each machine of `tests/rig.py` has one error from outside the catalogue, and beside it an effect,
another such error, a bump shorter than the distance of the stations, or a fault of the data.
Sizes, small errors of everything else and readings are those of `attribution.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks import attribution_cases as ac
from benchmarks.attribution_asked import SEEN, fault_found, holds, is_shape_of, share, well, worse
from benchmarks.attribution_cases import Case
from benchmarks.attribution_run import Drawn, bare_rig, points_of, run, size_of
from benchmarks.independent import Sheet, Visible
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc

BESIDE = ("effect", "outside", "bump", "fault")
"""What stands beside an error from outside the catalogue."""

RMS = (6.0, 12.0)  # of what each shows past the base, in sigmas of averaged readings
_BUMP = 0.1  # millimetres


def cases(campaigns: int) -> list[Case]:
    """Return so many campaigns: what stands beside alternates, and then the sheet."""
    sheets = len(ac.SWEEPS)
    return [
        Case("beside", BESIDE[k % 4], ac.SWEEPS[k // 4 % sheets], 0.0, k // (4 * sheets))
        for k in range(campaigns)
    ]


def draw(case: Case, seed: int, background: float) -> Drawn:
    """Simulate a case."""
    rng = case.rng(seed)
    rows = rc.protocol_rows(case.protocol)
    setups, bare = bare_rig(rows, rng, background)
    visible = Visible(Sheet(rows), bare)
    kinds = [str(kind) for kind in rng.choice(ac.OUTSIDE, 2, replace=False)]
    causes = [ac.outside(kinds[0], rows, rng)]
    if case.what == "outside":
        causes.append(ac.outside(kinds[1], rows, rng))
    elif case.what == "effect":
        family = str(rng.choice(ac.PLAIN))
        causes.append(ac.effect(family, rng, setups))
    sized = [(c, size_of(c, float(rng.choice(RMS)), bare, rows, visible)) for c in causes]
    if case.what == "bump":
        where = str(rng.choice(["rail.b", "rail.c", "drive"]))
        sized.append(ac.short_error(Case("bump", where, case.protocol, _BUMP, 0), rows, rng))
    rig = bare
    for cause, size in sized:
        rig = cause.added_to(rig, size)
    measured, touched = rc.simulate(rig, rows, rng), ()
    if case.what == "fault":
        measured, found = ac.spoil(str(rng.choice(ac.FAULTS)), measured, rng)
        touched = tuple(found)
    jumps = any(cause.name in ac.JUMPS for cause, _ in sized)
    points = points_of(rig, rng, rows[-1]["time_s"] if jumps else 0.0)
    return Drawn(bare, rig, tuple(sized), measured, touched, points, visible)


def _is_told(truth: Record, record: Record) -> bool:
    """Whether a set holds an error, its place or a known shape of it."""
    places = set(truth["places"])
    located = any(places & set(found["places"]) for found in record["located"])
    return located or any(_is_of(effect, truth) for effect in record["effects"])


def _is_of(effect: Record, truth: Record) -> bool:
    """Whether the members of a set include an error or a known shape of it."""
    shaped = any(
        is_shape_of(p, parts) for p in truth["places"] for _, parts, _ in effect["members"]
    )
    return shaped or holds(effect, truth)


def _strays(record: Record) -> bool:
    """Whether anything is named that is none of the errors."""
    places = {place for truth in record["truth"] for place in truth["places"]}
    elsewhere = any(not places & set(found["places"]) for found in record["located"])
    return elsewhere or any(
        not any(_is_of(effect, truth) for truth in record["truth"]) for effect in record["effects"]
    )


def tables(found: Sequence[Record]) -> list[Table]:
    """What was told, by what stands beside."""
    rows: list[Sequence[str]] = [
        ("beside", "campaigns", "errors seen that a set holds", "something else is named",
         "data fault found", "data fault reported where none is", "TCP before", "TCP after",
         "worse than stated")
    ]  # fmt: skip
    for title in (*BESIDE, "all"):
        chosen = [r for r in well(found) if title in (r["what"], "all")]
        if not chosen:
            continue
        told = [_is_told(t, r) for r in chosen for t in r["truth"] if t["norm"] >= SEEN]
        tcp = [f"{np.mean([r['tcp'][k][0] for r in chosen]):.4f}" for k in ("before", "after")]
        rows.append((
            title, str(len(chosen)), share(told, bool), share(chosen, _strays),
            share([r for r in chosen if r["touched"]], fault_found),
            share([r for r in chosen if not r["touched"]], lambda r: bool(r["blunders"])),
            *tcp, share(chosen, worse),
        ))  # fmt: skip
    failed = len(found) - len(well(found))
    note = f"*Seen*: known, an error lowers chi2 by 25 or more. TCP errors in mm. {failed} refused."
    return [Table("Errors outside the catalogue beside something else", note, rows)]


if __name__ == "__main__":
    run_all(__doc__, cases, partial(run, draw=draw), tables, campaigns=60)
