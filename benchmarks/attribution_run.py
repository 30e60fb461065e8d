"""One campaign of the truth table: simulate it, close the loop, and compare with the truth."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, independent, public
from benchmarks.attribution_cases import Array, Case, Cause
from benchmarks.independent import Sheet, Visible, is_cause, metric
from benchmarks.public import campaign, machine
from benchmarks.runs import Record
from tests import rig_campaigns as rc
from tests.rig import Rig

SEEN = 0.5
"""A parameter is seen where the readings leave less than this of its tolerance."""

POINTS = 40


@dataclass(frozen=True)
class Drawn:
    """A case with everything drawn: the machine without and with its causes, readings, TCP.

    Attributes:
        visible: what causes show in the readings of the machine without them; absent where there
            is nothing to compare with.
    """

    bare: Rig
    rig: Rig
    causes: tuple[tuple[Cause, float], ...]
    rows: list[rc.Row]
    touched: tuple[int, ...]
    points: og.Readings
    visible: Visible | None = None


def draw(case: Case, seed: int, background: float = ac.BACKGROUND) -> Drawn:
    """Simulate a case."""
    rng = case.rng(seed)
    rows = ac.rows_of(case)
    setups, bare = bare_rig(rows, rng, background)
    causes: list[tuple[Cause, float]] = []
    rig = bare
    visible = None if case.kind == "fault" else Visible(Sheet(rows), bare)
    if case.kind in ac.SHORT:
        causes = [ac.short_error(case, rows, rng)]
    elif visible is not None and (chosen := _causes(case, rows, setups, rng)):
        # Sizes were once taken from simulated readings: their draws keep the campaigns the same.
        rc.simulate(bare, rows, rng)
        causes = [(cause, size_of(cause, case.rms, bare, rows, visible)) for cause in chosen]
    for cause, size in causes:
        rig = cause.added_to(rig, size)
    measured, touched = rc.simulate(rig, rows, rng), ()
    if case.kind == "fault":
        measured, found = ac.spoil(case.what, measured, rng)
        touched = tuple(found)
    # What jumps stays so, and what drifts goes back: the tool is measured after the readings or
    # before.
    after = rows[-1]["time_s"] if case.what in ac.JUMPS else 0.0
    points = points_of(rig, rng, after)
    return Drawn(bare, rig, tuple(causes), measured, touched, points, visible)


def bare_rig(
    rows: Sequence[rc.Row], rng: np.random.Generator, background: float
) -> tuple[list[str], Rig]:
    """Return the setups of a sheet, and a machine with small errors of everything alone."""
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    return setups, Rig(errors=ac.background(rng, setups, background) | ac.base_errors(rng))


def points_of(rig: Rig, rng: np.random.Generator, time: float = 0.0) -> og.Readings:
    """What a perfect tracker says of a machine at one second."""
    return public.tcp_points(rc.tcp_points(rig, POINTS, rng, time=time))


def _causes(
    case: Case, rows: list[rc.Row], setups: list[str], rng: np.random.Generator
) -> list[Cause]:
    if case.kind in ("nothing", "fault"):
        return []
    if case.kind == "outside":
        return [ac.outside(case.what, rows, rng)]
    shaped = case.kind == "structured"
    return [ac.effect(family, rng, setups, shaped) for family in case.what.split("+")]


def size_of(cause: Cause, rms: float, bare: Rig, rows: list[rc.Row], visible: Visible) -> float:
    """Size at which a cause shows so much past the base, or the largest that is asked for."""
    small = 1.0 if cause.extra is None else ac.FIRST_SIZE
    shown = visible.rms(_shown(cause, small, bare, rows, visible))
    return min(small * rms / max(shown, 1e-12), cause.largest)


def _shown(cause: Cause, size: float, bare: Rig, rows: list[rc.Row], visible: Visible) -> Array:
    """What a cause adds to the readings, whitened and past the base ``(m,)``."""
    added = rc.predict(cause.added_to(bare, size), rows) - rc.predict(bare, rows)
    return visible.past(added)


# -- what the truth looks like to these readings -------------------------------------------------


def _truth(drawn: Drawn, visible: Visible) -> list[Record]:
    shown = [_shown(c, size, drawn.bare, drawn.rows, visible) for c, size in drawn.causes]
    found = []
    for k, (cause, size) in enumerate(drawn.causes):
        others = [s for i, s in enumerate(shown) if i != k]
        columns = np.stack(others, -1) if others else None
        several = 2 if cause.family == "screw_error" else 1
        about = metric(shown[k], visible.candidates, (cause.name, cause.family), several, columns)
        found.append({**about, "rms": visible.rms(shown[k]), "places": cause.places, "size": size})
    return found


def accepted(truth: Record, name: str, parameters: Sequence[str]) -> bool:
    """Whether a named cause is the true one."""
    return is_cause(name, parameters, truth["name"], truth["family"], truth["same_family"])


# -- what the tool says --------------------------------------------------------------------------


def run(
    case: Case,
    seed: int,
    background: float = ac.BACKGROUND,
    draw: Callable[[Case, int, float], Drawn] = draw,
) -> Record:
    """Everything the tables need of one case, ready for JSON."""
    began = time.perf_counter()
    record: Record = {
        "key": case.key, "seed": seed, "share": background, "kind": case.kind, "what": case.what,
        "protocol": case.protocol,
    }  # fmt: skip
    try:
        drawn = draw(case, seed, background)
        verdict = og.close_loop([campaign(drawn.rows)], machine(), tcp=drawn.points)
        result = public.verdict_of(verdict)
        record |= _said(result) | _compared(drawn, result)
    except og.OrthoglideError as error:
        record |= {"word": "error", "message": public.error_text(error)}
    except Exception:  # a crash is a result too: it is counted and shown
        record |= {"word": "crash", "message": traceback.format_exc(limit=-4)}
    return record | {"seconds": round(time.perf_counter() - began, 2)}


def _said(result: Record) -> Record:
    before, after, left = (result[k] for k in ("before", "after", "left"))
    return {
        "word": result["verdict"],
        **public.said(result),
        "stopped": left["stopped"],
        "left": [left["lack_of_fit_p"], left["background"]],
        "chi2": [before["chi2"], after["chi2"], after["dof"]],
        "blunders": [[b["kind"], b["rows"]] for b in result["blunders"]],
    }


def _compared(drawn: Drawn, result: Record) -> Record:
    # The truth's size is that in all readings, whether or not the tool set some aside.
    found: Record = {"touched": list(drawn.touched), "truth": []}
    if drawn.visible is not None:
        found["truth"] = _truth(drawn, drawn.visible)
        plain = Rig(errors={n: v for n, v in drawn.bare.errors.items() if n in independent.BASE})
        hum = rc.predict(drawn.bare, drawn.rows) - rc.predict(plain, drawn.rows)
        found["background"] = drawn.visible.rms(drawn.visible.past(hum))
        if drawn.causes and all(c.extra is None for c, _ in drawn.causes):
            found["told"] = _told(drawn)
    found["tcp"] = public.tcp_of(result)
    found["covered"] = _covered(drawn.rig, result)
    return found


def _told(drawn: Drawn) -> list[float]:
    """Mean and largest TCP error of an identification given the effect, millimetres."""
    scales = independent.base_scales()
    for cause, _ in drawn.causes:
        if cause.family == "screw_error":
            scales |= {n: {n: independent.tolerance(n)} for n in cause.errors}
        else:
            scales[cause.name] = dict(cause.errors)
    mean = independent.oracle(Sheet(drawn.rows), scales)
    told = drawn.points.points()
    return independent.tcp_error(mean, told.command, told.p)


def _covered(rig: Rig, result: Record) -> list[list[Any]]:
    """Name, error in stated sigmas and sigma in tolerances of each base parameter that is seen."""
    found = []
    identified = public.parameters_of(result)
    for name in independent.BASE:
        value, sigma = identified[name]
        share = sigma / independent.tolerance(name)
        if share <= SEEN:
            found.append([name, (value - rig.error(name)) / sigma, share])
    return found
