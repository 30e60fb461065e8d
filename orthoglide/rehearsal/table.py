"""What a rehearsal found: the user's own truth table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.frames import Framed, data_frame
from orthoglide.rehearsal.outcome import Outcome
from orthoglide.rehearsal.random_machines import KINDS, OUTSIDE, Kind
from orthoglide.report.terminal import console_text, table
from orthoglide.text import wrapped

if TYPE_CHECKING:
    import pandas as pd

_MAX_LISTED = 12  # campaigns that went against the wish, in the text

_COUNT_FIELDS = ("named", "located", "missed", "false", "failed")
_TOOL_ERROR_FIELDS = ("nominal_mm", "before_mm", "after_mm", "stated_mm", "inside")


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
        """Return the campaigns on which that was wrong."""
        return tuple(t for t in self.campaigns if t.kind == kind.name)

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The truth table, a row for each kind of machine.

        ``named`` counts campaigns that named a cause that was there, ``located`` those that found
        the place of it, ``false`` those that claimed anything that was not there. The tool's mean
        errors are in millimetres after the best translation, ``inside`` is the share of its
        coordinates within their stated 95 % interval.
        """
        rows = []
        for kind in KINDS:
            tried = self.of(kind)
            counts = [sum(bool(getattr(t, name)) for t in tried) for name in _COUNT_FIELDS]
            tool = [
                [getattr(t, name) for name in _TOOL_ERROR_FIELDS] for t in tried if not t.failed
            ]
            mean = (
                np.mean(tool, axis=0).tolist() if tool else [float("nan")] * len(_TOOL_ERROR_FIELDS)
            )
            rows.append((kind.name, len(tried), *counts, *mean))
        titles = ("wrong", "campaigns", *_COUNT_FIELDS, *_TOOL_ERROR_FIELDS)
        return dict(zip(titles, map(list, zip(*rows, strict=True)), strict=True))

    def to_frame(self) -> pd.DataFrame:
        """Return all campaigns as a data frame, a row each.

        Raises:
            InputError: where pandas is not installed.
        """
        rows = [asdict(t) for t in self.campaigns]
        return data_frame({name: [r[name] for r in rows] for name in rows[0]}, index="number")

    @property
    def line(self) -> str:
        """Counts over all campaigns, in one line."""
        counts = [f"{n} {sum(bool(getattr(t, n)) for t in self.campaigns)}" for n in _COUNT_FIELDS]
        return ", ".join([f"campaigns {len(self.campaigns)}", *counts])

    def __repr__(self) -> str:
        return f"<Rehearsal {self.machine!r}: {len(self.campaigns)} campaigns, seed {self.seed}>"

    def __str__(self) -> str:
        rows = [*zip(*self.columns.values(), strict=True)]
        last = 2 + len(_COUNT_FIELDS)
        said = [[row[0], *map(str, row[1:last])] for row in rows]
        judged = [row for row in rows if np.isfinite(row[last])]
        tool = [[row[0], *(f"{value:.4f}" for value in row[last:])] for row in judged]
        head = ["what is wrong", *(name.removesuffix("_mm") for name in _TOOL_ERROR_FIELDS)]
        parts = [
            f"{len(self.campaigns)} campaigns of {self.readings} readings on machines like "
            f"{self.machine!r}, seed {self.seed}",
            console_text(table(["what is wrong", "tried", *_COUNT_FIELDS], said)),
            "Mean TCP error after the best translation, mm; share of coordinates inside their "
            "95 % interval:",
            console_text(table(head, tool)),
        ]
        if went := list(self._failure_sentences()):
            more = [f"and {len(went) - _MAX_LISTED} more"] if len(went) > _MAX_LISTED else []
            parts += ["\nWhat went wrong:", *(f"  {line}" for line in [*went[:_MAX_LISTED], *more])]
        if self.weak:
            title = "\nWeak spots of the sheet, where nothing else is wrong:"
            parts += [title, *self.weak]
        return wrapped("\n".join(parts))

    def _failure_sentences(self) -> Iterator[str]:
        """Yield a sentence for each campaign that did not go as it should."""
        for tried in self.campaigns:
            found, about = list[str](), f"campaign {tried.number}, {tried.kind}"
            if tried.failed:
                yield f"{about}: failed, {tried.failed}"
            if tried.missed:
                measure = "its usual size" if tried.kind == OUTSIDE.name else "its tolerance"
                found.append(f"missed that {tried.words}, {tried.size:.1f} times {measure}")
            if tried.false:
                found.append(f"claimed {', '.join(tried.false)}, which was not there")
            if found:
                yield f"{about}: {'; '.join(found)} ({tried.word})"
