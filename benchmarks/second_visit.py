"""Several things changed between two visits: are they told, and nothing else?

    python -m benchmarks.second_visit --machines 60 --jobs 2 --cache second-visit.jsonl

Machines are simulated by the tests' own (`tests/rig.py`): offsets and lengths, a background of all
other effects, and up to two causes of several tolerances. Between the visits zeros are entered or
slip, causes are put right, others come, and now and then bars are exchanged. *File*: the machine
file of the first visit is given to the second. *Check*: both campaigns are compared. A change is
told where it is one of those that a sentence names; what is told of nothing that changed is false.
A run goes on where it stopped, from the cache.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, public
from benchmarks.attribution_asked import share as share_of
from benchmarks.independent import tolerance
from benchmarks.public import campaign, machine
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc
from tests.rig import Rig, parameter_names

COUNTS = (0, 1, 2, 3, 5)
"""How many parameters changed."""

CAUSES = ("axis_tilt", "rail_bow", "backlash", "encoder_scale", "screw_error")
"""Of those that a visit puts right, or that come."""

ROUTES = ("file", "check")
_BACKGROUND = 0.1  # of their tolerances, by which everything else is off

Errors = dict[str, float]


def drawn(count: int, rng: np.random.Generator) -> tuple[Errors, Errors]:
    """What is wrong at the first visit, and what changed until the second, SI."""
    errors = ac.base_errors(rng)
    names = [n for n in parameter_names() if n.partition(".")[0] in CAUSES and "cos" not in n]
    for name in names:
        errors[name] = _BACKGROUND * tolerance(name) * float(rng.standard_normal())
    strong = [str(n) for n in rng.choice(names, 2, replace=False)]
    for name in strong[: int(rng.integers(0, 3))]:
        errors[name] = tolerance(name) * float(rng.uniform(3, 6) * rng.choice([-1, 1]))
    others = [n for n in names if n not in strong]
    zeros, bars = ([f"{e}.{leg}" for leg in "xyz"] for e in ("joint_offset", "leg_length"))
    likely = dict.fromkeys(zeros, 4.0) | {
        n: 4.0 for n in strong if abs(errors[n]) > 1.5 * machine().tolerance(n)
    }
    likely |= dict.fromkeys(bars, 0.3) | {n: 3.0 / len(others) for n in others}
    weights = np.array(list(likely.values()))
    chosen = rng.choice(list(likely), count, replace=False, p=weights / weights.sum())
    changed = {}
    for name in map(str, chosen):
        if name in strong:
            changed[name] = -errors[name] * float(rng.uniform(0.9, 1.0))
        elif name in zeros:
            changed[name] = float(rng.uniform(2e-4, 1.5e-3) * rng.choice([-1, 1]))
        else:
            size = float(rng.uniform(3, 6) * rng.choice([-1, 1]))
            changed[name] = tolerance(name) * size
    return errors, changed


def run(case: tuple[int, str, int], seed: int) -> Record:
    """One machine, visited twice: what is told by either route."""
    count, protocol, number = case
    rng = np.random.default_rng([seed, count, number])
    errors, changed = drawn(count, rng)
    rows = rc.protocol_rows(protocol)
    first = campaign(rc.simulate(Rig(errors=errors), rows, rng))
    now = {n: errors.get(n, 0.0) + changed.get(n, 0.0) for n in {**errors, **changed}}
    second = campaign(rc.simulate(Rig(errors=now), rows, rng))
    record: Record = {"case": list(case), "seed": seed, "changed": changed}
    try:
        began = time.perf_counter()
        known = og.close_loop([first], machine()).machine
        again = og.close_loop([second], known)
        record["file"] = told(public.changes_of(again), changed)
        record["word"] = again.word
        middle = time.perf_counter()
        record["check"] = told(public.changes_of(og.check([first], [second], machine())), changed)
        record["seconds"] = [middle - began, time.perf_counter() - middle]
    except og.OrthoglideError as error:
        return record | {"word": "error", "message": str(error)}
    return record


def told(changes: Iterable[Record], truth: Errors) -> list[Record]:
    """Of each change that is told: what it is one of, and its size against the truth."""
    found = []
    for change in changes:
        first, by = change["parameter"], change["to"] - change["from"]
        found.append(
            {
                "members": change["members"],
                "right": [n for n in change["members"] if n in truth],
                "by": by,
                "apart": (by - truth[first]) / change["sigma"] if first in truth else None,
            }
        )
    return found


def tables(found: Sequence[Record]) -> list[Table]:
    """The table."""
    lines = [["changed, and by which route", "n", "all reported and nothing else", "reported",
              "first of its set", "false", "95 % interval holds"]]  # fmt: skip
    for route in ROUTES:
        for count in COUNTS:
            rows = [r for r in found if r["case"][0] == count and route in r]
            lines.append([f"{count}, {route}", *_row(rows, route)])
        lines.append([f"all, {route}", *_row([r for r in found if route in r], route)])
    errors = sum(r["word"] == "error" for r in found)
    return [Table("", f"{errors} of {len(found)} ended in an error", lines)]


def _row(rows: Sequence[Record], route: str) -> list[str]:
    said = [t for r in rows for t in r[route]]
    held = [
        (name, any(name in t["right"] for t in r[route])) for r in rows for name in r["changed"]
    ]
    whole = [
        all(t["right"] for t in r[route])
        and {n for t in r[route] for n in t["right"]} == set(r["changed"])
        for r in rows
    ]
    right = [t for t in said if t["right"]]
    return [
        str(len(rows)),
        share_of(whole, bool),
        share_of(held, lambda h: h[1]),
        share_of(right, lambda t: t["members"][0] in t["right"]),
        share_of(said, lambda t: not t["right"]),
        share_of([t for t in said if t["apart"] is not None], lambda t: abs(t["apart"]) < 1.96),
    ]


def cases(machines: int) -> list[tuple[int, str, int]]:
    """Return so many machines of each count of changes; sheets alternate."""
    return [(n, ac.PROTOCOLS[k % len(ac.PROTOCOLS)], k) for k in range(machines) for n in COUNTS]


if __name__ == "__main__":
    run_all(__doc__, cases, run, tables, machines=60)
