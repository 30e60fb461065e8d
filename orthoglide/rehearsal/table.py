"""What a rehearsal found: the user's own truth table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.frames import Framed, data_frame
from orthoglide.rehearsal.drawing import KINDS, OUTSIDE, Kind
from orthoglide.rehearsal.outcome import Outcome

if TYPE_CHECKING:
    import pandas as pd

_LISTED = 12  # campaigns that went against the wish, in the text

_SAID = ("named", "located", "missed", "false", "failed")
_TOOL = ("nominal_mm", "before_mm", "after_mm", "stated_mm", "inside")


@dataclass(frozen=True)
class Rehearsal(Framed):
    """Campaigns on machines of a user's own dimensions and tolerances, held against the truth.

    Attributes:
        machine: its name.
        readings: of the sheet.
        seed: of every draw.
        campaigns: one after the other.
        weak: what the sheet hardly finds, cannot name or does not show, as rows of text.
    """

    machine: str
    readings: int
    seed: int
    campaigns: tuple[Outcome, ...]
    weak: tuple[str, ...]

    def of(self, kind: Kind) -> tuple[Outcome, ...]:
        """Campaigns on which that was wrong."""
        return tuple(t for t in self.campaigns if t.kind == kind.name)

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The table, a row for what was wrong.

        ``named`` counts campaigns that named a cause that was there, ``located`` those that found
        the place of it, ``false`` those that claimed anything that was not there. The tool's mean
        errors are in millimetres after the best translation, ``inside`` is the share of its
        coordinates within their stated 95 % interval.
        """
        rows = []
        for kind in KINDS:
            tried = self.of(kind)
            counts = [sum(bool(getattr(t, name)) for t in tried) for name in _SAID]
            tool = [[getattr(t, name) for name in _TOOL] for t in tried if not t.failed]
            mean = np.mean(tool, axis=0).tolist() if tool else [float("nan")] * len(_TOOL)
            rows.append((kind.name, len(tried), *counts, *mean))
        titles = ("wrong", "campaigns", *_SAID, *_TOOL)
        return dict(zip(titles, map(list, zip(*rows, strict=True)), strict=True))

    def to_frame(self) -> pd.DataFrame:
        """All campaigns as a data frame, a row each.

        Raises:
            InputError: where pandas is not installed.
        """
        rows = [asdict(t) for t in self.campaigns]
        return data_frame({name: [r[name] for r in rows] for name in rows[0]}, index="number")

    @property
    def line(self) -> str:
        """How often what was said, in one line."""
        counts = [f"{n} {sum(bool(getattr(t, n)) for t in self.campaigns)}" for n in _SAID]
        return ", ".join([f"campaigns {len(self.campaigns)}", *counts])

    def __repr__(self) -> str:
        return f"<Rehearsal {self.machine!r}: {len(self.campaigns)} campaigns, seed {self.seed}>"

    def __str__(self) -> str:
        table = list(zip(*self.columns.values(), strict=True))
        last = 2 + len(_SAID)
        said = [[k.name, *_counts(k, row[1:last])] for k, row in zip(KINDS, table, strict=True)]
        tool = [[row[0], *_figures(row[last:])] for row in table]
        lines = [
            f"{len(self.campaigns)} campaigns of {self.readings} readings on machines like "
            f"{self.machine!r}, seed {self.seed}",
            "",
            *_aligned(["what is wrong", "campaigns", *_SAID], said),
            "",
            "TCP error, mean after the best translation, mm; coordinates in their 95 % interval:",
            "",
            *_aligned(["what is wrong", *(n.removesuffix("_mm") for n in _TOOL)], tool),
            *_listed("What went wrong", [_went(t) for t in self.campaigns]),
            *_listed(
                "Weak spots of the sheet, where nothing else is wrong", self.weak, len(self.weak)
            ),
        ]
        return "\n".join(lines)


def _counts(kind: Kind, counts: Sequence[int]) -> list[str]:
    """A count is left out where there is nothing to find."""
    campaigns, named, located, missed, false, failed = map(str, counts)
    if kind.extra != "effect" and not kind.share:
        named = "-"
    if not kind.extra:
        located, missed = "-", "-"
    return [campaigns, named, located, missed, false, failed]


def _figures(values: Sequence[float]) -> list[str]:
    if not np.isfinite(values[0]):
        return ["-"] * len(values)
    return [*(f"{v:.4f}" for v in values[:-1]), f"{100 * values[-1]:.0f} %"]


def _aligned(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    every = [titles, *rows]
    widths = [max(len(row[k]) for row in every) for k in range(len(titles))]
    return [
        "  ".join(c.ljust(w) if k == 0 else c.rjust(w)
                  for k, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in every
    ]  # fmt: skip


def _went(tried: Outcome) -> str:
    """What went against the wish in one campaign; empty where nothing did."""
    about = f"campaign {tried.number}, {tried.kind}"
    if tried.failed:
        return f"{about}: failed, {tried.failed}"
    found = []
    if tried.missed:
        measure = "its usual size" if tried.kind == OUTSIDE.name else "its tolerance"
        found.append(f"missed that {tried.words}, {tried.size:.1f} times {measure}")
    if tried.false:
        found.append(f"claimed {', '.join(tried.false)}, which was not there")
    return f"{about}: {'; '.join(found)} ({tried.word})" if found else ""


def _listed(title: str, lines: Sequence[str], most: int = _LISTED) -> list[str]:
    lines = [line for line in lines if line]
    more = [f"  and {len(lines) - most} more"] if len(lines) > most else []
    return ["", f"{title}:", *(f"  {line}" for line in lines[:most]), *more] if lines else []
