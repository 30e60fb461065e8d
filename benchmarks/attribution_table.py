"""The truth table: from the records of the campaigns to the figures that the docs show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from benchmarks.attribution_asked import (
    alarmed,
    both_found,
    classes,
    clear,
    fault_found,
    holds,
    holds_alone,
    misnamed,
    misplaced,
    named,
    placed,
    seen,
    shaped,
    share,
    singles,
    upper_bound,
    well,
    worse,
    wrongly_explained,
)  # fmt: skip
from benchmarks.attribution_cases import FAULTS, LATER, OUTSIDE, SHARES, SHORT, SHORT_SIZES
from benchmarks.attribution_run import accepted
from benchmarks.runs import Record, Table


def tables(records: Sequence[Record]) -> list[Table]:
    """All tables of a run; errors shorter than the stations' distance have one of their own."""
    usual = [r for r in records if r["kind"] in SHARES]
    brief = [r for r in records if r["kind"] in SHORT]
    made = [requirements, words, places, reliability, accuracy]
    return [table(usual) for table in made if usual] + [short(brief)] * bool(brief)


# -- tables --------------------------------------------------------------------------------------


def requirements(records: Sequence[Record]) -> Table:
    """What is required, and what was found."""
    done = well(records)
    kinds = {
        k: [r for r in done if r["kind"] == k]
        for k in ("nothing", "pair", "three", "outside", "fault")
    }
    single = singles(records)
    strong = [r for r in single if clear(r["truth"][0])]
    weak = [r for r in single if not clear(r["truth"][0])]
    both = [r for r in kinds["pair"] if r["truth"] and all(map(clear, r["truth"]))]
    outside = [r for r in kinds["outside"] if r["truth"] and seen(r)]
    members = [len(c) for r in outside for c in classes(r)]
    gain = [r["tcp"]["after"][0] / r["tcp"]["before"][0] for r in outside]
    alarms = sum(map(alarmed, kinds["nothing"]))
    sizes = [len(e["members"]) for r in strong for e in r["effects"][:1]]
    told = [r for r in strong if r.get("told") and named(r)]
    rows = [
        ("", "required", "found"),
        ("campaigns", "600", f"{len(records)}, {len(records) - len(done)} failed"),
        ("false alarms", "", share(kinds["nothing"], alarmed)),
        ("  their upper 95 % bound", "<= 5 %",
         f"{100 * upper_bound(alarms, max(len(kinds['nothing']), 1)):.1f} %"),
        ("clear effects named, alone or in a class", ">= 95 %", share(strong, named)),
        ("  named first and alone", "", share(strong, lambda r: holds_alone(r))),
        ("  verdict is no mere part", "",
         share(strong, lambda r: r["word"] in ("explained", "ambiguous"))),
        ("effects below that named", "", share(weak, named)),
        ("  called by a wrong name", "", share(weak, misnamed)),
        ("mean size of the class of clear effects", "", f"{np.mean(sizes or [np.nan]):.2f}"),
        ("second effect added for a single cause", "<= 5 %",
         share(single, lambda r: len(r["effects"]) > 1)),
        ("clear pairs: both found", "", share(both, both_found)),
        ("three at once: causes that are clear beside the others, named alone or in a class", "",
         _found_beside(kinds["three"])),
        ("  sets named that hold none of the three", "<= 5 %", _strange(kinds["three"])),
        ("outside the catalogue, seen: class of the true place located", ">= 90 %",
         share(outside, placed)),
        ("  or a known shape of it named", "", share(outside, lambda r: placed(r) or shaped(r))),
        ("  a wrong place or a wrong name", "<= 5 %", share(outside, misplaced)),
        ("  members of the class, median", "<= 4", f"{np.median(members or [np.nan]):g}"),
        ("  TCP error after over before, median", "<= 0.5", f"{np.median(gain or [np.nan]):.2f}"),
        ("  TCP worse than before by more than stated", "<= 5 %", share(outside, worse)),
        ("places located where there are none", "<= 2 %",
         share([r for r in done if r["kind"] not in ("outside", "fault")],
               lambda r: bool(r["located"]))),
        ("data faults, on machines without another effect: explained by a wrong name", "<= 5 %",
         share(kinds["fault"], lambda r: wrongly_explained(r) and not r["blunders"])),
        ("  found", "", share(kinds["fault"], fault_found)),
        ("data faults reported where there are none", "",
         share([r for r in done if r["kind"] != "fault"], lambda r: bool(r["blunders"]))),
        ("parameters seen: inside their 95 % interval", ">= 93 %", _covered(done)),
        ("TCP coordinates inside their 95 % interval", ">= 93 %", _inside(done)),
        ("TCP error over that of an identification given the effect, median", "",
         f"{np.median([r['tcp']['after'][0] / r['told'][0] for r in told] or [np.nan]):.2f}"),
    ]  # fmt: skip
    return Table("What is required and what was found", "", rows)


def _covered(records: Sequence[Record]) -> str:
    errors = np.array([abs(e) for r in _trusted(records) for _, e, _ in r["covered"]])
    return f"{100 * np.mean(errors <= 1.96):.1f} % of {len(errors)}" if len(errors) else "-"


def _found_beside(records: Sequence[Record]) -> str:
    """Clear causes of machines with several that a set holds."""
    held = [any(holds(e, t) for e in r["effects"]) for r in records for t in r["truth"] if clear(t)]
    return share(held, bool)


def _strange(records: Sequence[Record]) -> str:
    """Sets that hold nothing of what is wrong, of all that are named."""
    none = [not any(holds(e, t) for t in r["truth"]) for r in records for e in r["effects"]]
    return share(none, bool)


def _inside(records: Sequence[Record]) -> str:
    inside = [r["tcp"]["inside"] for r in _trusted(records)]
    return f"{100 * np.mean(inside):.1f} %" if inside else "-"


def _trusted(records: Sequence[Record]) -> list[Record]:
    """Campaigns whose verdict stands by its intervals: what is left is described."""
    kinds = ("nothing", "effect", "structured", "pair", "three")
    return [r for r in records if r["kind"] in kinds]


def words(records: Sequence[Record]) -> Table:
    """Verdicts by kind of campaign."""
    every = ("adequate", "diffuse", "explained", "ambiguous", "located", "partial",
             "unexplained", "error", "crash")  # fmt: skip
    # Earlier versions had no such verdict.
    columns = [w for w in every if w != "diffuse" or any(r["word"] == w for r in records)]
    groups = [("nothing", "nothing"), ("clear effect", "effect"), ("fainter effect", "effect"),
              ("pair", "pair"), ("three at once", "three"),
              *[(f"outside: {o}", "outside") for o in OUTSIDE],
              *[(f"fault: {f}", "fault") for f in FAULTS]]  # fmt: skip
    rows: list[Sequence[str]] = [("", *columns, "fault found")]
    for title, kind in groups:
        chosen = [r for r in records if _in_group(r, title, kind)]
        if not chosen and title.partition(": ")[2] in LATER:
            continue
        count = Counter(r["word"] for r in chosen)
        faults = sum(bool(r.get("blunders")) for r in chosen)
        rows.append((title, *(str(count[c] or "") for c in columns), str(faults or "")))
    note = (
        "Campaigns by what was wrong and by the verdict's word. Machines with a fault of the data "
        "have no other effect."
    )
    return Table("Verdicts", note, rows)


def places(records: Sequence[Record]) -> Table:
    """What lies outside the catalogue, kind by kind."""
    rows: list[Sequence[str]] = [
        ("", "campaigns", "seen", "located", "wrong place or name", "nothing claimed",
         "class, median", "TCP before", "TCP after", "worse")
    ]  # fmt: skip
    for kind in OUTSIDE:
        every = [r for r in well(records) if r["what"] == kind and r["truth"]]
        shown = [r for r in every if seen(r)]
        if not every:
            continue
        right = [r for r in shown if placed(r)]
        size = [len(c) for r in right for c in classes(r)]
        silent = sum(not placed(r) and not misplaced(r) for r in shown)
        tcp = [np.mean([r["tcp"][k][0] for r in shown] or [np.nan]) for k in ("before", "after")]
        rows.append(
            (kind, str(len(every)), str(len(shown)), str(len(right)),
             str(sum(map(misplaced, shown))), str(silent),
             f"{np.median(size):g}" if size else "-",
             *(f"{t:.4f}" if np.isfinite(t) else "-" for t in tcp), str(sum(map(worse, shown))))
        )  # fmt: skip
    note = (
        "Campaigns that the readings can see (told, the cause lowers chi2 by 25 or more), by the "
        "true place. TCP errors in mm, mean; worse: by more than was stated."
    )
    return Table("Outside the catalogue", note, rows)


def short(records: Sequence[Record]) -> Table:
    """Bumps and waves that are shorter than the distance of the stations, kind by kind."""
    rows: list[Sequence[str]] = [
        ("", "campaigns", "seen", "adequate", "explained or ambiguous", "located",
         "partial or unexplained", "a set holds the true place", "another place or name",
         "data fault reported", "its rows, median", "TCP before", "TCP after", "worse at all",
         "worse than stated")
    ]  # fmt: skip
    kinds = (
        ("bump", "rail", "bump of a rail"),
        ("bump", "drive", "bump of a drive"),
        ("short_wave", "drive", "short wave of a drive"),
        ("rail_wave", "rail", "wave of a rail"),
    )
    groups = [
        (f"{title}, {size:g} mm", partial(_is_short, kind=kind, what=what, size=size))
        for kind, what, title in kinds
        for size in SHORT_SIZES
    ]
    for title, belongs in [*groups, ("all", lambda r: True)]:
        chosen = [r for r in well(records) if r["truth"] and belongs(r)]
        if not chosen:
            continue
        word = Counter(r["word"] for r in chosen)
        aside = [len({row for _, rows in r["blunders"] for row in rows}) for r in chosen]
        tcp = [np.mean([r["tcp"][k][0] for r in chosen]) for k in ("before", "after")]
        counts = (
            len(chosen), sum(map(seen, chosen)), word["adequate"] + word["diffuse"],
            word["explained"] + word["ambiguous"], word["located"],
            word["partial"] + word["unexplained"], sum(map(placed, chosen)),
            sum(map(misplaced, chosen)), sum(bool(r["blunders"]) for r in chosen),
        )  # fmt: skip
        faulty = [n for n in aside if n]
        after = sum(r["tcp"]["after"][0] > r["tcp"]["before"][0] for r in chosen)
        rows.append((title, *(str(c or "") for c in counts),
                     f"{np.median(faulty):g}" if faulty else "", *(f"{t:.4f}" for t in tcp),
                     str(after or ""), str(sum(map(worse, chosen)) or "")))  # fmt: skip
    note = (
        "A bump of 6 to 10 mm standard deviation within 4 mm of a station; waves with periods of 6 "
        "to 14 mm of a drive, of 10 to 45 mm of a rail. *Seen*: known, the cause lowers chi2 by 25 "
        "or more. TCP errors in mm, mean."
    )
    return Table("Shorter than the distance of the stations", note, rows)


def _is_short(record: Record, kind: str, what: str, size: float) -> bool:
    """Whether a record is of that kind of short error and of that size in millimetres."""
    where = record["kind"] == kind and record["what"].startswith(what)
    return bool(where and abs(abs(record["truth"][0]["size"]) - size * 1e-3) < 1e-9)


def _in_group(record: Record, title: str, kind: str) -> bool:
    if kind == "effect":
        ended = record["kind"] in ("effect", "structured")
        truth = (record.get("truth") or [None])[0]
        return ended and (title == "clear effect") == (truth is not None and clear(truth))
    return record["kind"] == kind and (": " not in title or title.endswith(f": {record['what']}"))


def reliability(records: Sequence[Record]) -> Table:
    """Stated probabilities of all members of the classes against how often they were the cause."""
    stated, true = [], []
    for record in singles(records):
        for name, parameters, probability in (
            m for e in record["effects"][:1] for m in e["members"]
        ):
            stated.append(probability)
            true.append(accepted(record["truth"][0], name, parameters))
    edges = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0 + 1e-9)
    rows: list[Sequence[str]] = [("stated", "causes", "mean stated", "true")]
    p, hit = np.array(stated), np.array(true, dtype=float)
    for low, high in pairwise(edges):
        chosen = (p >= low) & (p < high)
        if chosen.any():
            cells = (f"{p[chosen].mean():.2f}", f"{hit[chosen].mean():.2f}")
            rows.append((f"{low:g} to {min(high, 1):g}", str(chosen.sum()), *cells))
    note = "First effect of campaigns with a single cause: the chosen one and its rivals."
    return Table("Reliability of the stated probabilities", note, rows)


def accuracy(records: Sequence[Record]) -> Table:
    """Mean TCP error, best translation removed."""
    rows: list[Sequence[str]] = [
        ("", "campaigns", "nominal", "before", "after", "given the effect", "inside")
    ]
    groups = {
        "nothing": [r for r in well(records) if r["kind"] == "nothing"],
        "clear effects, named": [r for r in singles(records) if clear(r["truth"][0]) and named(r)],
        "all single effects": singles(records),
        "pairs": [r for r in well(records) if r["kind"] == "pair"],
        "three at once": [r for r in well(records) if r["kind"] == "three"],
        "outside the catalogue": [r for r in well(records) if r["kind"] == "outside"],
        "data faults": [r for r in well(records) if r["kind"] == "fault"],
    }
    for title, chosen in groups.items():
        if chosen:
            tcp = [r["tcp"] for r in chosen]
            cells = [
                f"{np.mean([t[k][0] for t in tcp]):.4f}" for k in ("nominal", "before", "after")
            ]
            told = [r["told"][0] for r in chosen if r.get("told")]
            cells.append(f"{np.mean(told):.4f}" if told else "")
            cells.append(f"{100 * np.mean([t['inside'] for t in tcp]):.1f} %")
            rows.append((title, str(len(chosen)), *cells))
    note = "Millimetres, mean over points and campaigns, best translation removed."
    return Table("TCP error", note, rows)
