"""One campaign: a machine is drawn, measured, calibrated, and compared; and the table of many."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.accuracy import expected_error
from orthoglide.closing import RunOutcome, compute_outcome
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_short
from orthoglide.errors import InputError, OrthoglideError
from orthoglide.explanation import visible_free_form_errors, with_all_parameters
from orthoglide.frames import Framed, data_frame
from orthoglide.machine import Machine
from orthoglide.machine_file.values import largest_value
from orthoglide.numerals import compact
from orthoglide.observations import Readings
from orthoglide.parameters import Parameter, split_campaign
from orthoglide.planning.detectable import predicted_problem
from orthoglide.report.terminal import console_text, table
from orthoglide.result import Result
from orthoglide.simulation import simulate, simulate_tcp
from orthoglide.text import wrapped
from orthoglide.threads import on_one_thread
from orthoglide.verdict import build_request

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Kind:
    """What is wrong with some of the machines."""

    name: str  # for tables
    share: float = 0.0  # of their tolerances by which all effects are off
    extra_error: str = ""  # significant error besides: "effect", "outside" the catalogue, or none


NOTHING, EFFECT = Kind("nothing"), Kind("one effect", extra_error="effect")
OUTSIDE = Kind("outside the catalogue", extra_error="outside")
ALL_EFFECTS = tuple(Kind(f"everything, f = {share:g}", share) for share in (0.1, 0.3, 1.0))
KINDS = (NOTHING, EFFECT, OUTSIDE, *ALL_EFFECTS)
"""In the order of tables."""

KIND_SEQUENCE = (
    EFFECT, ALL_EFFECTS[0], OUTSIDE,
    EFFECT, ALL_EFFECTS[1], NOTHING,
    EFFECT, OUTSIDE, ALL_EFFECTS[2],
)  # fmt: skip
"""Kinds of successive campaigns: a small rehearsal is a fair sample of a larger one."""

EFFECT_SIZES = (3.0, 10.0)
"""Sizes of a single effect, in tolerances."""

_BASE_SIGMAS = 3.0  # sigmas of zeros and lengths that a machine must allow: few draws exceed them

FREE_FORM_SIZES = (0.5, 2.0)
"""Root mean squares of a free-form error, in its prior standard deviations."""


@dataclass(frozen=True, eq=False)
class Scope:
    """Everything that may be wrong with a machine and that a sheet may show."""

    machine: Machine  # dimensions, tolerances and instruments; without errors
    sheets: tuple[Readings, ...]  # rows to be read, of dials and of instruments at the tool
    # beyond zeros and lengths, of effects whose conditions the sheets vary, of instruments too
    parameters: tuple[Parameter, ...]
    free_forms: tuple[FreeForm, ...]  # that the sheets may show

    @classmethod
    def of(cls, machine: Machine, *sheets: Readings) -> Scope:
        """Return the scope of sheets, whose readings do not count, on a machine without errors."""
        bare = machine.with_only({})
        full_model = with_all_parameters(predicted_problem(bare, sheets))
        names = (n.plain for n in full_model.names if n.effect not in bare.catalogue.base)
        setups = [s.name for sheet in sheets for s in sheet.setups]
        parameters = tuple(bare.catalogue.parameter(n, setups) for n in names)
        errors = visible_free_form_errors(full_model)
        drawable = (e for e in errors if e.in_model and not (e.is_local or e.is_line))
        # Errors that belong to no single leg have no motions and cannot be drawn.
        errors = tuple(e for e in drawable if e.effect.motions)
        return cls(bare, sheets, parameters, errors)


def check_tolerances(scope: Scope) -> None:
    """Refuse tolerances so large that drawn machines would have errors implausible for their size.

    Raises:
        InputError: naming the tolerances, with the largest that can be drawn.
    """
    spec, catalogue = scope.machine.spec, scope.machine.catalogue
    largest = dict[str, str]()
    for name in dict.fromkeys((*catalogue.base, *(n.effect for n in scope.parameters))):
        effect = catalogue.effect_of(name)
        multiple = _BASE_SIGMAS if name in catalogue.base else EFFECT_SIZES[1]
        limit = largest_value(spec, effect) / multiple
        if spec.tolerance[name] > limit:
            step = 10.0 ** (np.floor(np.log10(limit / effect.unit.si)) - 1)
            rounded = np.floor(limit / effect.unit.si / step) * step  # two digits, not above
            largest[name] = f"{name} = {rounded:.2g}"
    if largest:
        raise InputError(
            f"the tolerances are too large for a machine whose bars are "
            f"{compact(spec.geometry.L * 1e3, 3)} mm long: give those of your machine under "
            f"[tolerance] of the machine file, at most {', '.join(largest.values())}"
        )


@dataclass(frozen=True, eq=False)
class DrawnMachine:
    """One machine as it is."""

    kind: Kind  # what is wrong
    machine: Machine  # with all its errors
    sizes: Mapping[str, float] = field(default_factory=dict)  # beyond zeros, lengths; tolerances
    cause: str = ""  # the active cause, as verdicts call it; empty if there is none
    size: float = 0.0  # of that, in tolerances or in prior deviations of a free-form error
    words: str = ""  # what that is, as a clause


def draw_machine(scope: Scope, kind: Kind, rng: np.random.Generator) -> DrawnMachine:
    """Return a machine with zeros and lengths off by their tolerances, and what its kind adds."""
    bare = scope.machine
    values = {
        str(n): bare.tolerance(n) * float(rng.standard_normal())
        for n in bare.catalogue.expand(bare.catalogue.base)
    }
    if kind.extra_error == "outside":
        return _draw_free_form_error(scope, kind, values, rng)
    sizes, cause, size, words = dict[str, float](), "", 0.0, ""
    if kind.share:
        sizes = {str(n): kind.share * float(rng.standard_normal()) for n in scope.parameters}
    if kind.extra_error == "effect":
        cause, size, sizes = _draw_effect(scope, rng)
        words = cause_short(bare.catalogue, cause)
    values |= {n: v * bare.tolerance(n) for n, v in sizes.items()}
    return DrawnMachine(kind, bare.with_only(values), sizes, cause, size, words)


def _draw_effect(scope: Scope, rng: np.random.Generator) -> tuple[str, float, dict[str, float]]:
    """Return the name of an effect, its size, and sizes by parameter, all effects as likely."""
    effects = list(dict.fromkeys(n.effect for n in scope.parameters))
    effect = scope.machine.catalogue[effects[int(rng.integers(len(effects)))]]
    members = [n for n in scope.parameters if n.effect == effect.name]
    parameter, size = members[int(rng.integers(len(members)))], float(rng.uniform(*EFFECT_SIZES))
    if not effect.paired:
        return str(parameter), size, {str(parameter): size * float(rng.choice([-1.0, 1.0]))}
    parts = [n for n in members if n.undirected == parameter.undirected]
    direction = rng.standard_normal(len(parts))
    direction *= size / np.linalg.norm(direction)
    sizes = dict(zip(map(str, parts), direction.tolist(), strict=True))
    return str(parameter.undirected), size, sizes


def _draw_free_form_error(
    scope: Scope, kind: Kind, values: dict[str, float], rng: np.random.Generator
) -> DrawnMachine:
    """Return a machine with a free-form error that no shape of the catalogue describes."""
    error = scope.free_forms[int(rng.integers(len(scope.free_forms)))]
    u = np.linspace(-1, 1, 201)
    functions = np.stack(error.kernel.functions(u), axis=1)
    weights = rng.standard_normal((functions.shape[1],))
    # Level, slope and curvature are removed.
    parabola = np.polynomial.legendre.legvander(u, 2).T @ functions / len(u)
    weights -= np.linalg.pinv(parabola) @ (parabola @ weights)
    size = float(rng.uniform(*FREE_FORM_SIZES))
    weights *= size * error.prior_sd / np.sqrt(np.mean((functions @ weights) ** 2))
    effect = error.effect
    values = values | dict(zip(effect.motions, weights.tolist(), strict=True))
    machine = scope.machine.with_effects([effect]).with_only(values)
    return DrawnMachine(kind, machine, {}, error.name, size, error.words)


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
    kind, began = KIND_SEQUENCE[number % len(KIND_SEQUENCE)], time.perf_counter()
    if kind == OUTSIDE and not scope.free_forms:  # which the sheets do not show
        kind = EFFECT
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
