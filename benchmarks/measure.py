"""How many readings ``orthoglide measure`` takes, against the sweep sheet, at which error rates.

Every campaign is measured twice on the same machine of `tests/rig.py`: along the sweep sheet, and
by the questions of ``measure``, answered by `tests/rig_operator.py` from the lines it prints. A
third of the machines have nothing wrong but zeros, lengths and the background of
`benchmarks/attribution_cases.py`; the others one effect of the catalogue besides, of a tenth to
three tolerances of `tests/data/rig/machine.toml`, every size as likely as its double.

    python benchmarks/measure.py --campaigns 60 --seed 0
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac
from benchmarks.public import asked_by_measure, campaign, machine
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc
from tests.rig import Rig
from tests.rig_operator import Operator

_OTHERWISE = ("thermal_growth", "thermal_drift", "drive_compliance", "gauge_scale",
              "gauge_direction", "gauge_drift")  # fmt: skip
FAMILIES = tuple(f for f in ac.FAMILIES if f not in _OTHERWISE)
"""Effects that show without a load, a thermometer or hours, and belong to no single mounting."""

SIZES = (0.1, 3.0)  # tolerances


WAYS = ("sweep sheet", "measure")


def drawn(number: int, seed: int) -> tuple[str, float, Rig]:
    """Name of the effect, empty where there is none, its size in tolerances, and the machine."""
    rng = np.random.default_rng([seed, number])
    rig = Rig(errors=ac.background(rng, [], ac.BACKGROUND) | ac.base_errors(rng))
    if number % 3 == 0:
        return "", 0.0, rig
    family = FAMILIES[int(rng.integers(len(FAMILIES)))]
    cause = ac.effect(family, rng)
    size = float(np.exp(rng.uniform(*np.log(SIZES))))
    return cause.name, size, cause.added_to(rig, size)


def run(case: tuple[int], seed: int) -> Record:
    """One machine, measured both ways."""
    (number,) = case
    true, size, rig = drawn(number, seed)
    record: Record = {"case": list(case), "seed": seed, "true": true, "size": size}
    for k, (way, measured) in enumerate(zip(WAYS, (swept, asked), strict=True)):
        began = time.perf_counter()
        readings, mountings, verdict = measured(rig, np.random.default_rng([seed, number, k]))
        seconds = round(time.perf_counter() - began, 1)
        record[way] = {"readings": readings, "mountings": mountings, "seconds": seconds,
                       **judged(verdict, true)}  # fmt: skip
    return record


def swept(rig: Rig, rng: np.random.Generator) -> tuple[int, int, og.Verdict]:
    """Readings, mountings and the verdict of the sweep sheet."""
    taken = campaign(rc.simulate(rig, "sweep", rng))
    return len(taken), 3, og.close_loop(taken, machine())


def asked(rig: Rig, rng: np.random.Generator) -> tuple[int, int, og.Verdict]:
    """Readings, mountings and the verdict by the questions of ``measure``."""
    operator = Operator(rig, rng)

    def tell(text: str) -> None:
        for line in text.split("\n"):
            operator.hear(line)

    readings, verdict = asked_by_measure(lambda question: f"{operator.hear(question):.2f}", tell)
    return readings, operator.mountings, verdict


def judged(verdict: og.Verdict, true: str) -> Record:
    """Whether the effect is in a credible set, alone there, and whether a cause is named that is
    not there; one phase of a screw is that screw.
    """
    right = [true in (e.name, *e.indistinguishable_from) for e in verdict.effects]
    rivals = (({*c.parameters}, {*r.parameters}) for c in verdict.effects for r in c.rivals)
    alone = any(right) and all(own <= other or own >= other for own, other in rivals)
    return {"named": any(right), "alone": alone, "wrong": not all(right)}


def tables(found: Sequence[Record]) -> list[Table]:
    """Return both ways side by side."""

    def cells(key: str) -> list[list[int]]:
        return [[r[way][key] for r in found] for way in WAYS]

    def shares(key: str, sound: bool) -> list[str]:
        parts = [[r[way][key] for r in found if sound is not bool(r["true"])] for way in WAYS]
        return [f"{sum(part)}/{len(part)}" for part in parts]

    return [Table("", "", [
        ["", *WAYS],
        ["readings, mean", *(f"{np.mean(t):.0f}" for t in cells("readings"))],
        ["readings, least and most", *(f"{min(t)} to {max(t)}" for t in cells("readings"))],
        ["mountings, mean", *(f"{np.mean(t):.1f}" for t in cells("mountings"))],
        ["sound machines: a cause named", *shares("wrong", sound=True)],
        ["effects: named, alone or with rivals", *shares("named", sound=False)],
        ["effects: named without rivals", *shares("alone", sound=False)],
        ["effects: a cause named that is not there", *shares("wrong", sound=False)],
    ])]  # fmt: skip


if __name__ == "__main__":
    run_all(__doc__, lambda n: ((k,) for k in range(n)), run, tables, campaigns=60)
