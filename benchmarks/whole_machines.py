"""Machines on which everything is wrong at once: TCP errors, and whether intervals hold.

    python benchmarks/whole_machines.py --machines 60 --jobs 2 --cache whole.jsonl

Machines are simulated by the tests' own (`tests/rig.py`), every effect that moves the tool drawn at
``f`` of its tolerance in the rig's machine file. ``oracle`` is the Gaussian posterior that is
given ``f``, of `benchmarks/independent.py`.
A run goes on where it stopped, from the cache.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, independent, public
from benchmarks.attribution_run import points_of
from benchmarks.independent import Sheet
from benchmarks.public import campaign, machine
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc
from tests.rig import Rig, parameter_names

SHARES = (0.0, 0.1, 0.3, 1.0)
"""Of their tolerances by which machines are off; 0: offsets and lengths alone."""

FAMILIES = (
    "axis_tilt", "axis_offset", "rail_bow", "encoder_scale", "screw_error", "backlash",
    "bar_mismatch", "parallelogram_width",
)  # fmt: skip

BASE_SD = (1e-3, 5e-5)
"""Standard deviations by which joint offsets and leg lengths are drawn, metres."""

Case = tuple[float, str, int]


def rig_of(share: float, rng: np.random.Generator) -> Rig:
    """A machine of which everything is off by a share of its tolerance."""
    errors = ac.base_errors(rng)
    for name in parameter_names():
        family = name.partition(".")[0]
        if family in FAMILIES:
            errors[name] = share * independent.TOLERANCE[family] * float(rng.standard_normal())
    return Rig(errors=errors)


def run(case: Case, seed: int) -> Record:
    """One machine: what it is off by, before and after, and what was stated."""
    share, protocol, number = case
    rng = np.random.default_rng([seed, round(1000 * share), number])
    rig, began = rig_of(share, rng), time.perf_counter()
    rows = rc.simulate(rig, rc.protocol_rows(protocol), rng)
    points = points_of(rig, rng)
    record: Record = {"case": list(case), "seed": seed}
    try:
        verdict = og.close_loop([campaign(rows)], machine(), tcp=points)
    except og.OrthoglideError as error:
        return record | {"word": "error", "message": str(error)}
    seconds = time.perf_counter() - began
    result = public.verdict_of(verdict)
    errors = public.tcp_of(result)
    told = points.points()
    given = independent.tcp_error(oracle(rows, max(share, 1e-3)), told.command, told.p)
    said = public.said(result)
    return record | {
        "word": result["verdict"],
        "named": [e["name"] for e in said["effects"]] + [f["places"][0] for f in said["located"]],
        "tcp": [*(errors[k][0] for k in ("nominal", "before", "after")), given[0]],
        "stated": errors["stated"],
        "inside": errors["inside"],
        "parameters": covered(verdict, rig),
        "seconds": round(seconds, 2),
    }


def oracle(rows: Sequence[rc.Row], share: float) -> dict[str, float]:
    """Return the posterior mean of a machine whose scales are given: offsets and lengths as drawn,
    and the share of their tolerances by which all other effects are off.
    """
    scales = independent.base_scales(*BASE_SD)
    for family in FAMILIES:
        size = share * independent.TOLERANCE[family]
        scales |= {n: {n: size} for n in independent.parameters(family)}
    return independent.oracle(Sheet(rows), scales)


def covered(verdict: og.Verdict, rig: Rig) -> list[bool]:
    """Of each parameter of the machine, whether its 95 % interval holds."""
    families = (*FAMILIES, *independent.BASE_FAMILIES)
    return [
        bool(abs(value - rig.error(name)) <= 1.96 * sigma)
        for name, (value, sigma) in public.calibrated_of(verdict).items()
        if independent.family_of(name) in families and sigma > 0
    ]


def tables(found: Sequence[Record]) -> list[Table]:
    """The table; TCP errors in mm."""
    lines = [["machines", "n", "nominal", "before", "after", "oracle", "stated",
              "worse than before", "TCP inside", "parameters inside", "verdicts"]]  # fmt: skip
    for share in SHARES:
        rows = [r for r in found if r["case"][0] == share and "tcp" in r]
        if not rows:
            continue
        tcp = np.array([r["tcp"] for r in rows]).mean(axis=0)
        stated = float(np.mean([r["stated"] for r in rows]))
        # Worse by more than it states itself.
        worse = sum(r["tcp"][2] > r["tcp"][1] + r["stated"] for r in rows)
        inside = np.array([r["inside"] for r in rows])
        held = np.array([np.mean(r["parameters"]) for r in rows])
        words = Counter(r["word"] for r in rows)
        error = 1 / np.sqrt(max(len(rows) - 1, 1))
        lines.append([
            f"f = {share:g}", str(len(rows)), *(f"{v:.4f}" for v in (*tcp, stated)), str(worse),
            *(f"{v.mean():.3f} ± {v.std() * error:.3f}" for v in (inside, held)),
            ", ".join(f"{w} {n}" for w, n in sorted(words.items())),
        ])  # fmt: skip
    return [Table("", "", lines)]


def cases(machines: int) -> list[Case]:
    """Return so many machines of each share; sheets alternate."""
    return [(f, ac.PROTOCOLS[k % len(ac.PROTOCOLS)], k) for k in range(machines) for f in SHARES]


if __name__ == "__main__":
    run_all(__doc__, cases, run, tables, machines=60)
