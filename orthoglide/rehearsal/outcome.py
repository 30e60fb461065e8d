"""One campaign: a machine is drawn, measured, calibrated, and compared; and the table of many."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.accuracy import expected_error
from orthoglide.closing import RunOutcome, compute_outcome
from orthoglide.errors import OrthoglideError
from orthoglide.frames import Framed, data_frame
from orthoglide.parameters import split_campaign
from orthoglide.rehearsal.random_machines import (
    KINDS,
    OUTSIDE,
    DrawnMachine,
    Kind,
    Scope,
    draw_machine,
    kind_of_campaign,
)
from orthoglide.report.terminal import console_text, table
from orthoglide.result import Result
from orthoglide.simulation import simulate, simulate_tcp
from orthoglide.text import wrapped
from orthoglide.threads import on_one_thread
from orthoglide.verdict import build_request

if TYPE_CHECKING:
    import pandas as pd

_ACTIVE_SHARES = 2.0  # shares from which an effect counts as active: one in twenty reaches that
_MAX_LISTED = 12  # failures that the text lists
_TOOL_ERRORS = ("nominal_mm", "before_mm", "after_mm", "stated_mm", "inside")


@dataclass(frozen=True)
class Outcome:
    """What became of one campaign; millimetres, of the tool after the best translation."""

    number: int  # of the campaign, from 0
    kind: str  # what was wrong, as in the table
    cause: str = ""  # the active cause, as verdicts call it; empty if there was none
    size: float = 0.0  # of that, in tolerances or in prior deviations of a free-form error
    words: str = ""  # what it was, as a clause
    word: str = ""  # the verdict
    named: tuple[str, ...] = ()  # causes that were named and were there
    located: tuple[str, ...] = ()  # places that it located and that were there
    false: tuple[str, ...] = ()  # claims that were wrong
    nominal_mm: float = float("nan")  # mean error of the tool of the machine as drawn
    before_mm: float = float("nan")  # that error after zeros and lengths are corrected
    after_mm: float = float("nan")  # that error after everything found is compensated
    stated_mm: float = float("nan")  # that error as the verdict states it
    inside: float = float("nan")  # share of the tool's coordinates in their stated 95 % interval
    seconds: float = 0.0  # that it took
    failed: str = ""  # why it came to no verdict; empty where it did

    @property
    def missed(self) -> bool:
        """True if a significant error was neither named nor located."""
        return bool(self.cause) and not (self.named or self.located or self.failed)

    @property
    def problem(self) -> str:
        """What did not go as it should, a clause; empty if all did."""
        problems = [f"failed, {self.failed}"] if self.failed else []
        if self.missed:
            measure = "its usual size" if self.kind == OUTSIDE.name else "its tolerance"
            problems.append(f"missed that {self.words}, {self.size:.1f} times {measure}")
        if self.false:
            problems.append(f"claimed {', '.join(self.false)}, which was not there")
        verdict = f" ({self.word})" if problems and self.word else ""
        return f"{'; '.join(problems)}{verdict}"


@on_one_thread
def run_campaign(scope: Scope, number: int, seed: int) -> Outcome:
    """Return the outcome of one campaign, determined by number and seed; it may be a failure."""
    kind, began = kind_of_campaign(scope, number), time.perf_counter()
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    fields: dict[str, Any] = {"number": number, "kind": kind.name}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what libraries tell programmers, in every process
            drawn = draw_machine(scope, kind, rng)
            fields |= {"cause": drawn.cause, "size": round(drawn.size, 2), "words": drawn.words}
            fields |= _measure_and_calibrate(scope, drawn, rng)
    except OrthoglideError as error:
        fields["failed"] = f"{type(error).__name__}: {error}"
    except Exception as error:  # a crash is a result too: it is counted and shown
        fields["failed"] = f"unexpected {type(error).__name__}: {error}"
    return Outcome(**fields, seconds=round(time.perf_counter() - began, 1))


def _measure_and_calibrate(
    scope: Scope, drawn: DrawnMachine, rng: np.random.Generator
) -> dict[str, Any]:
    measured = [simulate(drawn.machine, sheet, seed=rng) for sheet in scope.sheets]
    points = simulate_tcp(drawn.machine, seed=rng)
    run = compute_outcome(build_request(measured, scope.machine, tcp=points))
    named, located, false = map(tuple, judge_claims(run, drawn))
    errors = dict(run.tcp or {})["translation"]
    stated = expected_error(run.machine, run.machine.values).shape
    means = (errors.nominal_mean, errors.before_mean, errors.after_mean, stated)
    sizes = {n: round(1e3 * v, 5) for n, v in zip(_TOOL_ERRORS, means, strict=False)}
    inside = round(errors.inside, 4)
    return {"word": run.word, "named": named, "located": located, "false": false,
            "inside": inside} | sizes  # fmt: skip


def judge_claims(
    verdict: RunOutcome | Result, drawn: DrawnMachine
) -> tuple[list[str], list[str], list[str]]:
    """Return the claims of a verdict: true causes, true located errors, and false claims.

    On a machine with errors of all parameters, a cause is true from twice its share on.
    """
    named, located, false = list[str](), list[str](), list[str]()
    for cause in verdict.effects:
        is_true = any(_is_true_cause(e.name, e.parameters, drawn) for e in cause.explanations)
        (named if is_true else false).append(cause.name)
    for error in verdict.located:
        places = [curve.name for curve in error.members]
        is_true = bool(drawn.cause) and drawn.cause in (*places, *error.resembling)
        (located if is_true else false).append(places[0])
    false += [f"a fault of the data ({fault.kind})" for fault in verdict.blunders]
    return named, located, false


def _is_true_cause(name: str, parameters: Sequence[str], drawn: DrawnMachine) -> bool:
    """Return whether a named cause is the true one, or a block of its family that contains it."""
    # A drawn machine has no values specific to a campaign: plain names are compared.
    name, *parameters = (split_campaign(n)[0] for n in (name, *parameters))
    if drawn.kind.extra_error == "effect":
        family = drawn.machine.catalogue.effect_of(drawn.cause).name
        block = len(parameters) > 1 and name.startswith(f"{family}.") and drawn.cause in parameters
        return name in (drawn.cause, family) or block
    limit = _ACTIVE_SHARES * drawn.kind.share
    return any(abs(_true_size(n, drawn)) > limit for n in parameters if drawn.sizes)


def _true_size(name: str, drawn: DrawnMachine) -> float:
    """Return the true size of a parameter or of a structured member, in tolerances."""
    catalogue = drawn.machine.catalogue
    setups = dict.fromkeys(n.setup for n in map(catalogue.parameter, drawn.sizes) if n.setup)
    weights = catalogue.elementary_weights(name, list(setups))
    projection = sum(w * drawn.sizes.get(str(n), 0.0) for n, w in weights.items())
    return projection / sum(w**2 for w in weights.values())


# -- the table -------------------------------------------------------------------------------------


def _counts(outcomes: Sequence[Outcome]) -> dict[str, int]:
    """Return the number of campaigns, and of those with each kind of outcome."""
    fields = ("named", "located", "missed", "false", "failed")
    counts = {name: sum(bool(getattr(o, name)) for o in outcomes) for name in fields}
    return {"campaigns": len(outcomes), **counts}


@dataclass(frozen=True)
class Rehearsal(Framed):
    """Campaigns on machines of a user's own dimensions and tolerances, held against the truth.

    Attributes:
        machine: its name.
        readings: of the sheet.
        seed: of every draw.
        campaigns: one after the other.
    """

    machine: str
    readings: int
    seed: int
    campaigns: tuple[Outcome, ...]

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
            finished = [o for o in self.of(kind) if not o.failed]
            means = {
                name: float(np.mean([getattr(o, name) for o in finished] or [np.nan]))
                for name in _TOOL_ERRORS
            }
            rows.append({"wrong": kind.name, **_counts(self.of(kind)), **means})
        return {name: [row[name] for row in rows] for name in rows[0]}

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
        return ", ".join(f"{name} {count}" for name, count in _counts(self.campaigns).items())

    def __repr__(self) -> str:
        return f"<Rehearsal {self.machine!r}: {len(self.campaigns)} campaigns, seed {self.seed}>"

    def __str__(self) -> str:
        rows = [list(row) for row in zip(*self.columns.values(), strict=True)]
        heads, first = list(self.columns), len(self.columns) - len(_TOOL_ERRORS)
        counts = [[str(cell) for cell in row[:first]] for row in rows]
        errors = [
            [row[0], *(f"{value:.4f}" for value in row[first:])]
            for row in rows if np.isfinite(row[first])
        ]  # fmt: skip
        error_heads = (name.removesuffix("_mm") for name in _TOOL_ERRORS)
        parts = [
            f"{len(self.campaigns)} campaigns of {self.readings} readings on machines like "
            f"{self.machine!r}, seed {self.seed}",
            console_text(table(["what is wrong", "tried", *heads[2:first]], counts)),
            "Mean TCP error after the best translation, mm; share of coordinates inside their "
            "95 % interval:",
            console_text(table(["what is wrong", *error_heads], errors)),
        ]
        problems = [o for o in self.campaigns if o.problem]
        if problems:
            lines = [
                f"  campaign {o.number}, {o.kind}: {o.problem}" for o in problems[:_MAX_LISTED]
            ]
            lines += [f"  and {len(problems) - _MAX_LISTED} more"] * (len(problems) > _MAX_LISTED)
            parts += ["\nWhat went wrong:", *lines]
        return wrapped("\n".join(parts))
