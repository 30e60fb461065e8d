"""What a rehearsal found: the user's own truth table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

_MAX_LISTED = 12  # failures that the text lists

_COUNT_FIELDS = ("named", "located", "missed", "false", "failed")
_TOOL_ERROR_FIELDS = ("nominal_mm", "before_mm", "after_mm", "stated_mm", "inside")


def _counts(outcomes: Sequence[Outcome]) -> list[int]:
    return [sum(bool(getattr(outcome, n)) for outcome in outcomes) for n in _COUNT_FIELDS]


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
        return tuple(outcome for outcome in self.campaigns if outcome.kind == kind.name)

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The truth table, a row for each kind of machine.

        ``named`` counts campaigns that named a true cause, ``located`` campaigns that located a
        true error, ``false`` campaigns with any false claim. The tool's mean
        errors are in millimetres after the best translation, ``inside`` is the share of its
        coordinates within their stated 95 % interval.
        """
        rows = []
        for kind in KINDS:
            outcomes = self.of(kind)
            judged = [outcome for outcome in outcomes if not outcome.failed]
            errors = [[getattr(outcome, n) for n in _TOOL_ERROR_FIELDS] for outcome in judged]
            none = [float("nan")] * len(_TOOL_ERROR_FIELDS)
            means = np.mean(errors, axis=0).tolist() if errors else none
            rows.append((kind.name, len(outcomes), *_counts(outcomes), *means))
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
        counts = (len(self.campaigns), *_counts(self.campaigns))
        names = ("campaigns", *_COUNT_FIELDS)
        return ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True))

    def __repr__(self) -> str:
        return f"<Rehearsal {self.machine!r}: {len(self.campaigns)} campaigns, seed {self.seed}>"

    def __str__(self) -> str:
        rows = [*zip(*self.columns.values(), strict=True)]
        first_error = 2 + len(_COUNT_FIELDS)
        count_rows = [[row[0], *map(str, row[1:first_error])] for row in rows]
        judged = [row for row in rows if np.isfinite(row[first_error])]
        tool_rows = [[row[0], *(f"{value:.4f}" for value in row[first_error:])] for row in judged]
        head = ["what is wrong", *(name.removesuffix("_mm") for name in _TOOL_ERROR_FIELDS)]
        parts = [
            f"{len(self.campaigns)} campaigns of {self.readings} readings on machines like "
            f"{self.machine!r}, seed {self.seed}",
            console_text(table(["what is wrong", "tried", *_COUNT_FIELDS], count_rows)),
            "Mean TCP error after the best translation, mm; share of coordinates inside their "
            "95 % interval:",
            console_text(table(head, tool_rows)),
        ]
        if failures := list(self._failure_sentences()):
            if len(failures) > _MAX_LISTED:
                failures[_MAX_LISTED:] = [f"and {len(failures) - _MAX_LISTED} more"]
            parts += ["\nWhat went wrong:", *(f"  {line}" for line in failures)]
        if self.weak:
            title = "\nWeak spots of the sheet, where nothing else is wrong:"
            parts += [title, *self.weak]
        return wrapped("\n".join(parts))

    def _failure_sentences(self) -> Iterator[str]:
        """Yield a sentence for each campaign that did not go as it should."""
        for outcome in self.campaigns:
            problems, campaign = list[str](), f"campaign {outcome.number}, {outcome.kind}"
            if outcome.failed:
                yield f"{campaign}: failed, {outcome.failed}"
            if outcome.missed:
                measure = "its usual size" if outcome.kind == OUTSIDE.name else "its tolerance"
                problems.append(f"missed that {outcome.words}, {outcome.size:.1f} times {measure}")
            if outcome.false:
                problems.append(f"claimed {', '.join(outcome.false)}, which was not there")
            if problems:
                yield f"{campaign}: {'; '.join(problems)} ({outcome.word})"
