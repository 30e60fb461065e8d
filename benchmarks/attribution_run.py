"""One campaign of the truth table: simulate it, close the loop, and compare with the truth."""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import attribution_cases as ac
from benchmarks.attribution_cases import Array, Case, Cause
from orthoglide.closing import Verdict, close_loop
from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.effects import CATALOGUE
from orthoglide.errors import OrthoglideError
from orthoglide.fit import identify, solve, with_free
from orthoglide.judging import tcp_errors
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, TcpPoints
from orthoglide.rehearsal.outcome import is_cause, said
from tests import rig_campaigns as rc
from tests.rig import Rig

Record = dict[str, Any]

SAME = 2.0
"""Sigmas within which two causes cannot be told apart: a change of chi2 of 4."""

SEEN = 0.5
"""A parameter is seen where the readings leave less than this of its tolerance."""

POINTS = 40
MACHINE_FILE = Path(__file__).parents[1] / "tests" / "data" / "rig" / "machine.toml"


@cache
def machine() -> Machine:
    """The machine file of the tests' rig."""
    return Machine.load(MACHINE_FILE)


def campaign(rows: Sequence[rc.Row]) -> Campaign:
    """Rows as a campaign."""
    return Campaign.from_frame({key: [row[key] for row in rows] for key in rows[0]}, name="case")


@dataclass(frozen=True)
class Drawn:
    """A case with everything drawn: the machine without and with its causes, readings, TCP."""

    bare: Rig
    rig: Rig
    causes: tuple[tuple[Cause, float], ...]
    rows: list[rc.Row]
    touched: tuple[int, ...]
    points: TcpPoints


def draw(case: Case, seed: int, background: float = ac.BACKGROUND) -> Drawn:
    """Simulate a case."""
    rng = case.rng(seed)
    rows = ac.rows_of(case)
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    bare = Rig(errors=ac.background(rng, setups, background) | ac.base_errors(rng))
    causes: list[tuple[Cause, float]] = []
    rig = bare
    chosen = _causes(case, rows, setups, rng)
    if chosen:
        seen = signatures(identify(campaign(rc.simulate(bare, rows, rng)), machine()))
        for cause in chosen:
            size = _size(cause, case.rms, bare, rows, seen)
            causes.append((cause, size))
            rig = cause.added_to(rig, size)
    measured, touched = rc.simulate(rig, rows, rng), ()
    if case.kind == "fault":
        measured, found = ac.spoil(case.what, measured, rng)
        touched = tuple(found)
    return Drawn(bare, rig, tuple(causes), measured, touched, points_of(rig, rng))


def points_of(rig: Rig, rng: np.random.Generator) -> TcpPoints:
    """What a perfect tracker says of a machine."""
    table = rc.tcp_points(rig, POINTS, rng)
    command = np.array([[row[k] for k in rc.RHO] for row in table]) * 1e-3
    p = np.array([[row[f"p_{x}_mm"] for x in "xyz"] for row in table]) * 1e-3
    unknown = np.full(POINTS, np.nan)
    return TcpPoints(command, p, unknown, np.zeros((POINTS, 3)), np.arange(POINTS) + 2)


def _causes(
    case: Case, rows: list[rc.Row], setups: list[str], rng: np.random.Generator
) -> list[Cause]:
    if case.kind in ("nothing", "fault"):
        return []
    if case.kind == "outside":
        return [ac.outside(case.what, rows, rng)]
    shaped = case.kind == "structured"
    return [
        ac.effect(family, machine().tolerance(family), setups, rng, shaped)
        for family in case.what.split("+")
    ]


def _size(cause: Cause, rms: float, bare: Rig, rows: list[rc.Row], seen: Signatures) -> float:
    """Size at which a cause shows so much past the base, or the largest that is asked for."""
    small = 1.0 if cause.extra is None else ac.FIRST_SIZE
    shown = rms_of(_shown(cause, small, bare, rows, seen), seen)
    return min(small * rms / max(shown, 1e-12), cause.largest)


def _shown(cause: Cause, size: float, bare: Rig, rows: list[rc.Row], seen: Signatures) -> Array:
    """What a cause adds to the readings, whitened and past the base ``(m,)``."""
    added = rc.predict(cause.added_to(bare, size), rows) - rc.predict(bare, rows)
    return seen.whiten(added)


def _stations(seen: Signatures) -> int:
    return int(seen.estimate.problem.station.max()) + 1


def rms_of(shown: Array, seen: Signatures) -> float:
    """Root mean square over stations, in sigmas of a station's average."""
    return float(np.linalg.norm(shown) / np.sqrt(_stations(seen)))


# -- what the truth looks like to these readings -------------------------------------------------


def metric(shown: Array, seen: Signatures, cause: Cause, others: Array) -> Record:
    """Size of a cause past the base, its class, and the distance to the nearest other class.

    Rivals have no more parameters than the cause; ``others`` are columns of what else is wrong.
    """
    basis = np.linalg.qr(others)[0] if others.size else np.zeros((len(shown), 0))
    left = shown - basis @ (basis.T @ shown)
    apart: dict[str, float] = {}
    family: dict[str, str] = {}
    for candidate in seen.candidates:
        if candidate.size > _parameters(cause) or candidate.name == cause.name:
            continue
        space = seen.of(candidate)
        space = np.linalg.qr(np.hstack([space - basis @ (basis.T @ space)]))[0]
        apart[candidate.name] = float(np.linalg.norm(left - space @ (space.T @ left)))
        family[candidate.name] = candidate.effect
    same = [name for name, distance in apart.items() if distance <= SAME]
    rest = {name: distance for name, distance in apart.items() if distance > SAME}
    nearest = min(rest, key=rest.__getitem__, default="")
    return {
        "name": cause.name,
        "family": cause.family,
        "rms": rms_of(shown, seen),
        "norm": float(np.linalg.norm(left)),
        "same": len(same),
        "same_family": [name for name in same if family[name] == cause.family],
        "nearest": nearest,
        "distance": rest.get(nearest, float(np.linalg.norm(left))),
        "visible": cause.name in {c.name for c in seen.candidates},
        "places": cause.places,
    }


def _parameters(cause: Cause) -> int:
    return 2 if cause.family == "screw_error" else 1


def _truth(drawn: Drawn, seen: Signatures) -> list[Record]:
    shown = [_shown(c, size, drawn.bare, drawn.rows, seen) for c, size in drawn.causes]
    found = []
    for k, (cause, size) in enumerate(drawn.causes):
        others = [s for i, s in enumerate(shown) if i != k]
        columns = np.stack(others, -1) if others else np.zeros((0, 0))
        found.append({**metric(shown[k], seen, cause, columns), "size": size})
    return found


def accepted(truth: Record, name: str, parameters: Sequence[str]) -> bool:
    """Whether a named cause is the true one."""
    return is_cause(name, parameters, truth["name"], truth["family"], truth["same_family"])


# -- what the tool says --------------------------------------------------------------------------


def run(case: Case, seed: int, background: float = ac.BACKGROUND) -> Record:
    """Everything the tables need of one case, ready for JSON."""
    began = time.perf_counter()
    record: Record = {
        "key": case.key, "seed": seed, "share": background, "kind": case.kind, "what": case.what,
        "protocol": case.protocol,
    }  # fmt: skip
    try:
        drawn = draw(case, seed, background)
        verdict = close_loop([campaign(drawn.rows)], machine(), tcp=drawn.points)
        record |= _said(verdict) | _compared(drawn, verdict)
    except OrthoglideError as error:
        record |= {"word": "error", "message": f"{type(error).__name__}: {error}"}
    except Exception:  # a crash is a result too: it is counted and shown
        record |= {"word": "crash", "message": traceback.format_exc(limit=-4)}
    return record | {"seconds": round(time.perf_counter() - began, 2)}


def _said(verdict: Verdict) -> Record:
    return {
        "word": verdict.word,
        **said(verdict),
        "stopped": verdict.stopped,
        "left": [verdict.left.p_value, verdict.share],
        "chi2": [verdict.before.scores.chi2, verdict.after.scores.chi2, verdict.after.scores.dof],
        "blunders": [[b.kind, [row for _, row in b.rows]] for b in verdict.blunders],
    }


def _compared(drawn: Drawn, verdict: Verdict) -> Record:
    # The truth's size is that in all readings, whether or not the tool set some aside.
    base = verdict.first
    found: Record = {"touched": list(drawn.touched), "truth": []}
    if not drawn.touched:
        seen = signatures(base)
        truth = [c for c, _ in drawn.causes]
        found["truth"] = _truth(drawn, seen)
        plain = Rig(errors={n: v for n, v in drawn.bare.errors.items() if _is_base(n)})
        hum = rc.predict(drawn.bare, drawn.rows) - rc.predict(plain, drawn.rows)
        found["background"] = rms_of(seen.whiten(hum), seen)
        if truth and all(c.extra is None for c in truth):
            names = [p for c in truth for p in _freed(c, seen)]
            found["told"] = _told(drawn, verdict, names)
    found["tcp"] = _tcp(verdict)
    found["covered"] = _covered(drawn.rig, verdict)
    return found


def _is_base(name: str) -> bool:
    return name.partition(".")[0] in ("joint_offset", "leg_length")


def _freed(cause: Cause, seen: Signatures) -> tuple[str, ...]:
    """Parameters that free a cause: a structured member counts as one."""
    return tuple(cause.errors) if cause.family == "screw_error" else (cause.name,)


def _told(drawn: Drawn, verdict: Verdict, names: Sequence[str]) -> list[float]:
    """Mean and largest TCP error of an identification told the effect, millimetres."""
    base = verdict.first
    fit = solve(with_free(base.problem, names), method="nested")
    values = fit.problem.values(0, fit.x)
    errors = tcp_errors(machine(), drawn.points, verdict.values_before, values)["translation"]
    return [1e3 * errors.after[0], 1e3 * errors.after[1]]


def _tcp(verdict: Verdict) -> Record:
    errors = (verdict.tcp or {})["translation"]
    figures = {k: [1e3 * x for x in getattr(errors, k)] for k in ("nominal", "before", "after")}
    stated = 1e3 * verdict.numbers.expected["compensated"].shape
    return {**figures, "inside": errors.inside, "stated": stated}


def _covered(rig: Rig, verdict: Verdict) -> list[list[Any]]:
    """Name, error in stated sigmas and sigma in tolerances of each parameter that is seen."""
    problem, values = verdict.before.problem, verdict.after.values
    setups = tuple(s.name for s in problem.campaigns[0].setups)
    found = []
    for unknown in problem.unknowns:
        sigma = verdict.after.sigmas[unknown.name]
        share = sigma / unknown.tolerance
        if share > SEEN:
            continue
        weights = CATALOGUE.elementary(unknown.name, setups)
        true = float(np.mean([w * rig.error(n) for n, w in weights.items()]))
        found.append([unknown.name, (values[unknown.name] - true) / sigma, share])
    return found


__all__ = ["Candidate", "Drawn", "Record", "accepted", "draw", "run"]
