"""The truth table's campaigns beside what a version said that sought one cause at a time."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.attribution_asked import well
from benchmarks.attribution_run import Record
from benchmarks.attribution_table import Table

FORMER = Path(__file__).parent / "former.csv"
"""Words and TCP errors of that version (commit c0ef8f3), run once, seed 2029."""


def former(records: Sequence[Record]) -> list[Table]:
    """The same readings, as the tool judged them that sought one cause at a time; empty where none
    of the campaigns is among those kept in ``FORMER``.
    """
    with FORMER.open(encoding="utf-8", newline="") as file:
        known = {row["key"]: row for row in csv.DictReader(file)}
    rows: list[Sequence[str]] = [
        ("", "campaigns", "adequate, then", "now", "TCP error, then", "now", "ratio")
    ]
    for kind, title in (("nothing", "nothing wrong"), ("effect", "one effect")):
        pairs = [
            (known[r["key"]], r)
            for r in well(records)
            if r["kind"] == kind and r["key"] in known and _same_machine(known[r["key"]], r)
        ]
        if pairs:
            then = float(np.mean([float(old["after_mm"]) for old, _ in pairs]))
            now = float(np.mean([r["tcp"]["after"][0] for _, r in pairs]))
            adequate = (
                sum(old["word"] == "adequate" for old, _ in pairs),
                sum(r["word"] == "adequate" for _, r in pairs),
            )
            errors = f"{then:.4f}", f"{now:.4f}", f"{now / then:.2f}"
            rows.append((title, str(len(pairs)), *map(str, adequate), *errors))
    note = (
        "*Then* is commit c0ef8f3, run once on the campaigns of seed 2029 and kept in "
        f"`benchmarks/{FORMER.name}`. Millimetres, mean, best translation removed; "
        "campaigns whose machine was drawn otherwise then are left out."
    )
    return [Table("One cause at a time, and one posterior", note, rows)] if len(rows) > 1 else []


def _same_machine(old: Mapping[str, str], record: Record) -> bool:
    return bool(abs(float(old["nominal_mm"]) - record["tcp"]["nominal"][0]) < 1e-5)
