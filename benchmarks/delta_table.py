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
from benchmarks.delta_readings import INSTRUMENTS
from benchmarks.runs import Record, Table

UNSEEN = 3.0
"""A cause is invisible that shows less than this in all readings together, in sigmas."""

Test = Callable[[Record], bool]


def tables(records: Sequence[Record]) -> Iterator[Table]:
    """What is asked, by instrument."""
    failed = Counter(map(ending, records))
    note = (
        f"{len(records)} campaigns; readings refused as faulty: {failed['refused']}, ended in "
        f"another error: {failed['error']}. A cause is *clear* that shows three sigmas (root mean "
        "square over the readings) beyond what endstops, towers and arms take up, and lies five "
        "from the nearest other class."
    )
    rows = [["", *INSTRUMENTS], *_of_effects(records), *_of_strangers(records), *_of_whole(records)]
    yield Table("What is reported of simulated deltas", note, rows)


def seen(record: Record) -> bool:
    """Whether readings show what lies outside the catalogue."""
    return any(t["rms"] >= STRONG for t in record["truth"])


def ending(record: Record) -> str:
    """How a campaign ended: its verdict, or another end.

    *Noisy* and *rows set aside* are adequate with a warning that readings are far noisier than is
    usual, or with a data fault; *refused* are readings called faulty, *error* is any other error.
    """
    if record["word"] == "error" and record["message"].startswith("InputError"):
        return "refused"
    if record["word"] != "adequate":
        return str(record["word"])
    return "rows set aside" if record["blunders"] else "noisy" if record["loud"] else "adequate"


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
        _row("  taken for noise, with a warning, or for faulty readings", strange,
             ends("noisy", "refused", "rows set aside")),
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
