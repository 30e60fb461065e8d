"""The truth table of the linear delta: from the records of the campaigns to what the page shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from benchmarks.attribution_asked import (
    STRONG,
    classes,
    clear,
    holds_alone,
    misnamed,
    named,
    placed,
    share,
    well,
    wrongly_explained,
)
from benchmarks.attribution_run import Record
from benchmarks.attribution_table import Table
from benchmarks.delta_readings import INSTRUMENTS

UNSEEN = 3.0
"""A cause is invisible that shows less than this in all readings together, in sigmas."""

ENDS = ("adequate", "diffuse", "noisy", "rows set aside", "refused", "explained", "ambiguous",
        "located", "partial", "unexplained", "error")  # fmt: skip
"""How a campaign can end: the verdict's word; where it is adequate, with a warning that readings
are far noisier than is usual, or with rows set aside as faulty; readings refused as faulty, or
another error."""

Test = Callable[[Record], bool]


def tables(records: Sequence[Record]) -> Iterator[Table]:
    """What is asked, by instrument; and how campaigns end, by what was wrong."""
    failed = Counter(map(ending, records))
    note = (
        f"{len(records)} campaigns; readings refused as faulty: {failed['refused']}, ended in "
        f"another error: {failed['error']}. A cause is *clear* that shows three sigmas (root mean "
        "square over the readings) beyond what endstops, towers and arms take up, and lies five "
        "from the nearest other class."
    )
    rows = [["", *INSTRUMENTS], *_of_effects(records), *_of_strangers(records), *_of_whole(records)]
    yield Table("What is reported of simulated deltas", note, rows)
    yield endings(records)


def seen(record: Record) -> bool:
    """Whether readings show what lies outside the catalogue."""
    return any(t["rms"] >= STRONG for t in record["truth"])


def ending(record: Record) -> str:
    """How a campaign ended, one of `ENDS`."""
    if record["word"] == "error" and record["message"].startswith("InputError"):
        return "refused"
    if record["word"] != "adequate":
        return str(record["word"])
    return "rows set aside" if record["blunders"] else "noisy" if record["loud"] else "adequate"


def endings(records: Sequence[Record]) -> Table:
    """Campaigns by what was wrong and by how they ended; nothing is left out."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        kind = record["kind"]
        title = {"nothing": "nothing", "whole": "everything, a little"}.get(kind, kind)
        if kind == "effect":
            title = "a clear cause" if record["truth"] and _plain(record) else "a fainter cause"
        if kind == "outside":
            title = f"outside: {record['what']}" + ("" if seen(record) else ", below three sigma")
        groups.setdefault(title, []).append(record)
    first = {"nothing": 0, "a clear cause": 1, "a fainter cause": 2, "everything, a little": 3}
    # Earlier versions had no diffuse verdict.
    ends = [e for e in ENDS if e != "diffuse" or any(ending(r) == e for r in records)]
    rows = [["", *ends]]
    for title in sorted(groups, key=lambda t: (first.get(t, 4 + ("below" in t)), t)):
        count = Counter(map(ending, groups[title]))
        rows.append([title, *(str(count[end] or "") for end in ends)])
    note = (
        "All campaigns by what was wrong, all instruments together. *Noisy*: adequate, with a "
        "warning that the readings are noisier than usual. *Rows set aside*: a data fault was "
        "reported, and the rest is adequate. *Refused*: an error that calls the readings faulty. "
        "What lies outside the catalogue and ends *adequate* was not noticed; *explained* or "
        "*ambiguous*, it got a wrong name."
    )
    return Table("How campaigns end", note, rows)


def _row(title: str, records: Sequence[Record], test: Test) -> list[str]:
    """Shares by instrument."""
    own = ([r for r in records if r["instrument"] == i] for i in INSTRUMENTS)
    return [title, *(share(several, test) for several in own)]


def _plain(record: Record) -> bool:
    return clear(record["truth"][0])


def _hidden(record: Record) -> bool:
    return bool(record["truth"][0]["sigmas"] < UNSEEN)


def _unshown(record: Record) -> bool:
    """Whether a cause is said to be invisible."""
    truth, said = record["truth"][0], record["invisible"]
    return truth["family"] in said or set(truth["errors"]) <= set(said)


def _of_effects(records: Sequence[Record]) -> list[list[str]]:
    """Rows of machines with nothing wrong, or one cause of the catalogue."""
    nothing = [r for r in well(records) if r["kind"] == "nothing"]
    effects = [r for r in well(records) if r["kind"] == "effect"]
    strong, faint = [r for r in effects if _plain(r)], [r for r in effects if not _plain(r)]
    hidden = [r for r in effects if _hidden(r)]
    return [
        _row("false alarms", nothing, lambda r: ending(r) not in ("adequate", "diffuse", "noisy")),
        _row("clear causes named, alone or in a class", strong, named),
        _row("  named first and alone", strong, holds_alone),
        _row("  another cause besides", strong, lambda r: len(r["effects"]) > 1),
        _row("fainter ones called by a wrong name", faint, misnamed),
        _row("invisible at three tolerances", effects, _hidden),
        _row("  said to be invisible", hidden, _unshown),
        _row("  called by a wrong name", hidden, misnamed),
    ]


def _of_strangers(records: Sequence[Record]) -> list[list[str]]:
    """Rows of machines with something that lies outside the catalogue and shows."""
    strange = [{"located": []} | r for r in records if r["kind"] == "outside" and seen(r)]
    somewhere = [r for r in strange if r["truth"][0]["places"]]

    def ends(*words: str) -> Test:
        return lambda r: ending(r) in words

    return [
        _row("outside the catalogue, three sigma or more: not noticed", strange,
             ends("adequate", "diffuse")),
        _row("  taken for noise, with a warning", strange, ends("noisy")),
        _row("  taken for faulty readings", strange, ends("refused", "rows set aside")),
        _row("  said to be unexplained, or explained in part", strange,
             ends("unexplained", "partial")),
        _row("  explained by a wrong name", strange, wrongly_explained),
        _row("  a wrong place located", strange,
             lambda r: len(classes(r)) < len(r["located"])),
        _row("  rails and carriages: a place located that holds the true one", somewhere,
             placed),
    ]  # fmt: skip


def _of_whole(records: Sequence[Record]) -> list[list[str]]:
    """Rows of machines of which everything is a little off."""
    whole = [r for r in well(records) if r["kind"] == "whole"]
    rows = [_row("whole machines: nothing left unexplained", whole,
                 lambda r: r["word"] in ("adequate", "diffuse", "explained",
                                         "ambiguous"))]  # fmt: skip
    for title, k in (("nominal", 0), ("base identified", 1), ("closed", 2)):
        cells = [[r["tool_mm"][k] for r in whole if r["instrument"] == i] for i in INSTRUMENTS]
        rows.append([f"  error of the tool, {title}, mm",
                     *(f"{np.mean(c):.3f}" if c else "-" for c in cells)])  # fmt: skip
    return rows
