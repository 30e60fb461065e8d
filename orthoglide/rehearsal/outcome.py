"""One campaign of a rehearsal: a machine is drawn, measured, calibrated, and compared."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from orthoglide.accuracy import expected_error
from orthoglide.closing import RunOutcome, compute_outcome
from orthoglide.errors import OrthoglideError
from orthoglide.parameters import split_campaign
from orthoglide.rehearsal.random_machines import DrawnMachine, Scope, draw_machine, kind_of_campaign
from orthoglide.result import Result
from orthoglide.simulation import simulate, simulate_tcp
from orthoglide.threads import on_one_thread
from orthoglide.verdict import build_request

_ACTIVE_SHARES = 2.0
"""Times its share by which an effect is off that stands out of the others: one in twenty is."""


@dataclass(frozen=True)
class Outcome:
    """What became of one campaign; millimetres, of the tool after the best translation."""

    number: int  # of the campaign, from 0
    kind: str  # what was wrong, as in the table
    cause: str = ""  # what stood out, as verdicts call it; empty where nothing did
    size: float = 0.0  # of that, in tolerances or in the deviation to expect of such a place
    words: str = ""  # what it was, as a clause
    word: str = ""  # the verdict
    named: tuple[str, ...] = ()  # causes that were named and were there
    located: tuple[str, ...] = ()  # places that it located and that were there
    false: tuple[str, ...] = ()  # claims that were wrong
    nominal_mm: float = float("nan")  # mean error of the tool of the machine as drawn
    before_mm: float = float("nan")  # the same after zeros and lengths are put right
    after_mm: float = float("nan")  # the same after everything found is compensated
    stated_mm: float = float("nan")  # what the verdict says of that
    # share of the tool's coordinates within their stated 95 % interval
    inside: float = float("nan")
    seconds: float = 0.0  # that it took
    failed: str = ""  # why it came to no verdict; empty where it did

    @property
    def missed(self) -> bool:
        """True if a significant error was neither named nor located."""
        return bool(self.cause) and not (self.named or self.located or self.failed)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields for JSON, without those that are not a number."""
        return {k: v for k, v in asdict(self).items() if v == v}

    @classmethod
    def from_dict(cls, kept: Mapping[str, Any]) -> Outcome:
        """Return the outcome that such fields describe.

        Raises:
            TypeError: where something else was kept.
        """
        values: dict[str, Any] = dict(kept)
        for name in ("named", "located", "false"):
            values[name] = tuple(values[name])
        return cls(**values)


@on_one_thread
def run_campaign(scope: Scope, number: int, seed: int) -> Outcome:
    """Return the outcome of one campaign; its number and the seed determine every draw, and a
    failure is an outcome as well.
    """
    kind, began = kind_of_campaign(scope, number), time.perf_counter()
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    about: dict[str, Any] = {"number": number, "kind": kind.name}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what libraries tell programmers, in every process
            drawn = draw_machine(scope, kind, rng)
            about |= {"cause": drawn.cause, "size": round(drawn.size, 2), "words": drawn.words}
            about |= _measure_and_calibrate(scope, drawn, rng)
    except OrthoglideError as error:
        about["failed"] = f"{type(error).__name__}: {error}"
    except Exception as error:  # a crash is a result too: it is counted and shown
        about["failed"] = f"unexpected {type(error).__name__}: {error}"
    return Outcome(**about, seconds=round(time.perf_counter() - began, 1))


def _measure_and_calibrate(
    scope: Scope, drawn: DrawnMachine, rng: np.random.Generator
) -> dict[str, Any]:
    measured = [simulate(drawn.machine, sheet, seed=rng) for sheet in scope.sheets]
    points = simulate_tcp(drawn.machine, seed=rng)
    closed = compute_outcome(build_request(measured, scope.machine, tcp=points))
    named, located, false = judge_claims(closed, drawn)
    errors = dict(closed.tcp or {})["translation"]
    stated = expected_error(closed.machine, closed.machine.values).shape
    figures = (errors.nominal_mean, errors.before_mean, errors.after_mean, stated)
    names = ("nominal_mm", "before_mm", "after_mm", "stated_mm")
    return {
        "word": closed.word, "named": tuple(named), "located": tuple(located),
        "false": tuple(false), "inside": round(errors.inside, 4),
        **{n: round(1e3 * v, 5) for n, v in zip(names, figures, strict=True)},
    }  # fmt: skip


def judge_claims(
    verdict: RunOutcome | Result, drawn: DrawnMachine
) -> tuple[list[str], list[str], list[str]]:
    """Return what a verdict claims: causes and places that are there, and what is not there.

    On a machine of which everything is off, a cause is there if it is off by twice its share.
    """
    named, located, false = list[str](), list[str](), list[str]()
    for cause in verdict.effects:
        there = any(_is_true_cause(one.name, one.parameters, drawn) for one in cause.explanations)
        (named if there else false).append(cause.name)
    for found in verdict.located:
        places = [curve.name for curve in found.members]
        there = bool(drawn.cause) and drawn.cause in (*places, *found.resembling)
        (located if there else false).append(places[0])
    false += [f"a fault of the data ({b.kind})" for b in verdict.blunders]
    return named, located, false


def _is_true_cause(name: str, parameters: Sequence[str], drawn: DrawnMachine) -> bool:
    """Return whether a named cause is the true one, or a block of its family that contains it."""
    # A machine is drawn whole: what a file has for itself goes by its plain name.
    name, *parameters = (split_campaign(n)[0] for n in (name, *parameters))
    if drawn.kind.extra_error == "effect":
        family = drawn.machine.catalogue.effect_of(drawn.cause).name
        block = len(parameters) > 1 and name.startswith(f"{family}.") and drawn.cause in parameters
        return name in (drawn.cause, family) or block
    least = _ACTIVE_SHARES * drawn.kind.share
    return any(abs(_true_size(n, drawn)) > least for n in parameters if drawn.sizes)


def _true_size(name: str, drawn: DrawnMachine) -> float:
    """Return the true size of a parameter or of a structured member, in tolerances."""
    catalogue = drawn.machine.catalogue
    setups = dict.fromkeys(n.setup for n in map(catalogue.parameter, drawn.sizes) if n.setup)
    weights = catalogue.elementary_weights(name, list(setups))
    along = sum(w * drawn.sizes.get(str(n), 0.0) for n, w in weights.items())
    return along / sum(w**2 for w in weights.values())
