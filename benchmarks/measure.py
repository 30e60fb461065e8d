"""How many readings ``orthoglide measure`` takes, against the sweep sheet, at which error rates.

Every campaign is measured twice on the same machine of `tests/rig.py`: along the sweep sheet, and
by the questions of ``measure``, answered by `tests/rig_operator.py` from the lines it prints. A
third of the machines have nothing wrong but zeros, lengths and the background of
`benchmarks/attribution_cases.py`; the others one effect of the catalogue besides, of a tenth to
three tolerances of `tests/data/rig/machine.toml`, every size as likely as its double.

    python benchmarks/measure.py --campaigns 60 --seed 0
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac
from benchmarks.independent import TOLERANCE
from benchmarks.public import asked_by_measure, campaign, machine
from tests import rig_campaigns as rc
from tests.rig import Rig
from tests.rig_operator import Operator

_OTHERWISE = ("thermal_growth", "thermal_drift", "drive_compliance", "gauge_scale",
              "gauge_direction", "gauge_drift")  # fmt: skip
FAMILIES = tuple(f for f in ac.FAMILIES if f not in _OTHERWISE)
"""Effects that show without a load, a thermometer or hours, and belong to no single mounting."""

SIZES = (0.1, 3.0)  # tolerances


@dataclass(frozen=True)
class Outcome:
    """One campaign, one way of measuring it.

    Attributes:
        true: name of the effect; empty where there is none.
        readings: taken.
        mountings: of one or two dials.
        verdict: at the end.
    """

    true: str
    readings: int
    mountings: int
    verdict: og.Verdict

    @property
    def named(self) -> bool:
        """Whether the effect is in a credible set."""
        return any(self.true in (e.name, *e.indistinguishable_from) for e in self.verdict.effects)

    @property
    def wrong(self) -> bool:
        """Whether a cause is named that is not there."""
        return any(self.true not in (e.name, *e.indistinguishable_from)
                   for e in self.verdict.effects)  # fmt: skip

    @property
    def alone(self) -> bool:
        """Whether it is named, and nothing else is; one phase of a screw is that screw."""
        several = [{*c.parameters} for c in self.verdict.effects]
        apart = (
            r for own, c in zip(several, self.verdict.effects, strict=True) for r in c.rivals
            if not (own <= {*r.parameters} or own >= {*r.parameters})
        )  # fmt: skip
        return self.named and next(apart, None) is None


def drawn(count: int, seed: int) -> Iterator[tuple[str, float, Rig]]:
    """Name of the effect, its size in tolerances, and the machine."""
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        rig = Rig(errors=ac.background(rng, [], ac.BACKGROUND) | ac.base_errors(rng))
        if k % 3 == 0:
            yield "", 0.0, rig
            continue
        family = FAMILIES[int(rng.integers(len(FAMILIES)))]
        cause = ac.effect(family, TOLERANCE[family], [], rng, shaped=False)
        size = float(np.exp(rng.uniform(*np.log(SIZES))))
        yield cause.name, size, cause.added_to(rig, size)


def swept(true: str, rig: Rig, rng: np.random.Generator) -> Outcome:
    """The sweep sheet."""
    taken = campaign(rc.simulate(rig, "sweep", rng))
    return Outcome(true, len(taken), 3, og.close_loop(taken, machine()))


def asked(true: str, rig: Rig, rng: np.random.Generator) -> Outcome:
    """The questions of ``measure``."""
    operator = Operator(rig, rng)

    def tell(text: str) -> None:
        for line in text.split("\n"):
            operator.hear(line)

    readings, verdict = asked_by_measure(lambda question: f"{operator.hear(question):.2f}", tell)
    return Outcome(true, readings, operator.mountings, verdict)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--campaigns", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="a line a campaign")
    options = parser.parse_args()
    ways = {"sweep sheet": swept, "measure": asked}
    found: dict[str, list[Outcome]] = {name: [] for name in ways}
    for k, (true, size, rig) in enumerate(drawn(options.campaigns, options.seed)):
        for place, (name, way) in enumerate(ways.items()):
            began = time.perf_counter()
            one = way(true, rig, np.random.default_rng([options.seed, k, place]))
            found[name].append(one)
            if options.verbose:
                told = ("named " if one.named else "") + ("alone " if one.alone else "")
                told += "WRONG " if one.wrong else ""
                print(
                    f"{true or 'nothing':28}{size:5.2f} {name:12}{one.readings:4} "
                    f"{one.verdict!r} {told}{time.perf_counter() - began:.0f} s",
                    flush=True,
                )
    table(found)


def table(found: dict[str, list[Outcome]]) -> None:
    """Print both ways side by side."""
    print("| | " + " | ".join(found) + " |\n|---|" + "---:|" * len(found))

    def row(title: str, cells: list[str]) -> None:
        print(f"| {title} | " + " | ".join(cells) + " |")

    def share(part: list[bool]) -> str:
        return f"{sum(part)}/{len(part)}"

    every = list(found.values())
    sound = [[o for o in way if not o.true] for way in every]
    worn = [[o for o in way if o.true] for way in every]
    taken = [[o.readings for o in way] for way in every]
    row("readings, mean", [f"{np.mean(t):.0f}" for t in taken])
    row("readings, least and most", [f"{min(t)} to {max(t)}" for t in taken])
    row("mountings, mean", [f"{np.mean([o.mountings for o in way]):.1f}" for way in every])
    row("sound machines: a cause named", [share([o.wrong for o in way]) for way in sound])
    row("effects: named, alone or with rivals", [share([o.named for o in way]) for way in worn])
    row("effects: named without rivals", [share([o.alone for o in way]) for way in worn])
    row("effects: a cause named that is not there", [share([o.wrong for o in way]) for way in worn])


if __name__ == "__main__":
    main()
