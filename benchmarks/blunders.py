"""How often faults of the data are found, and how often one is seen where there is none.

    python benchmarks/blunders.py [--campaigns 800] [--jobs 2] [--seed 0]

Campaigns come from the tests' independent machine: joint offsets of a millimetre, small errors of
everything, noise, a rounding dial and dials that stand somewhat beside their stated places. A
quarter has nothing wrong, a quarter one effect of the catalogue, an eighth an effect that is in no
catalogue, the rest a fault of the data, half of these beside an effect. Half are judged with the
noise and tolerances of a machine file, half with the nominal machine, its noise from the repeats.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from orthoglide.diagnosis.blunders import Blunder, examine
from orthoglide.errors import OrthoglideError
from orthoglide.fit import identify
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from tests import rig_campaigns as rc
from tests.rig import LEGS, TOLERANCE, Rig, parameter_names

PROTOCOLS = ("standard", "sweep", "two-gauges")
SIZES = (1.0, 3.0, 8.0)  # of an effect, in tolerances of the machine file
OUTSIDE: dict[str, Callable[[int, int, float], Rig]] = {
    "s_curve": lambda i, j, v: Rig(extra=(rc.s_curve(i, j, v),)),
    "wavy_rail": lambda i, j, v: Rig(extra=(rc.wavy_rail(i, j, v),)),
    "stick_slip": lambda i, j, v: Rig(extra=(rc.stick_slip(i, v),)),
    "hysteresis": lambda i, j, v: Rig(extra=(rc.hysteresis(i, v),)),
    "cross_coupling": lambda i, j, v: Rig(extra=(rc.cross_coupling(i, j, 10 * v),)),
    "warming_drive": lambda i, j, v: Rig(extra=(rc.warming_drive(i, v),)),
    "platform_play": lambda i, j, v: Rig(extra_platform=(rc.platform_play(i, j, v),)),
}
FAULTS = {
    "outlier": (0.1, 0.2, 0.5, 1.0),
    "knocked_stand": (0.05, 0.1, 0.2, 0.5),
    "command": (0.3, 1.0, 10.0),
    "sign": (0.0,),
    "label": (0.0, 1.0),
    "exchanged_labels": (0.0, 1.0),
    "unit": (1e-3, 1 / 25.4, 0.1, 10.0),
    "turns": (1.0, 0.5),
    "stuck": (0.0,),
}
"""Sizes in mm, of a hand what one turn shows; factors of a unit; 0 and 1 as in ``TITLES``."""
TITLES = {
    "exchanged_labels": {0.0: "one leg's two dials", 1.0: "different legs"},
    "label": {0.0: "direction", 1.0: "leg"},
}


@dataclass(frozen=True)
class Case:
    """What is put into one campaign."""

    what: str
    name: str
    size: float
    number: int

    @property
    def protocol(self) -> str:
        """Of the readings."""
        return PROTOCOLS[self.number % 3]

    @property
    def declared(self) -> bool:
        """Whether the noise is known from a machine file."""
        return self.number // 3 % 2 == 0


@dataclass(frozen=True)
class Outcome:
    """What came out.

    Attributes:
        case: what was put in.
        visible: whether the fault changes the readings enough to be one.
        found: the fault put in, by kind and setup.
        exact: and by row, within one of a knock's.
        false: faults that were not put in.
        refused: by the checks on reading, or by the identification.
        seconds: of ``examine``.
        told: kinds and setups.
    """

    case: Case
    visible: bool
    found: bool
    exact: bool
    false: int
    refused: bool
    seconds: float
    told: str


@cache
def machine(declared: bool) -> Machine:
    if declared:
        return Machine.load(ROOT / "tests" / "data" / "rig" / "machine.toml")
    return Machine.nominal()


def cases(campaigns: int) -> list[Case]:
    """About that many campaigns."""
    quarter = max(campaigns // 4, 1)
    names = [n for n in TOLERANCE if n not in ("joint_offset", "leg_length")]
    found = [Case("nothing", "", 0.0, k) for k in range(quarter)]
    for k in range(quarter):
        size = SIZES[k // len(names) % len(SIZES)]
        found.append(Case("effect", names[k % len(names)], size, k + k // len(names)))
    for k in range(max(campaigns // 8, 1)):
        name = list(OUTSIDE)[k % len(OUTSIDE)]
        found.append(Case("outside", name, (2e-5, 5e-5, 2e-4)[k % 3], k // 7 + k))
    kinds = [(kind, size) for kind, sizes in FAULTS.items() for size in sizes]
    for k in range(campaigns - len(found)):
        found.append(Case("fault", *kinds[k % len(kinds)], k // len(kinds)))
    return found


def _effect(family: str, tolerances: float, rng: np.random.Generator, names: list[str]) -> dict:
    own = [n for n in parameter_names(names) if n.partition(".")[0] == family]
    name = own[int(rng.integers(len(own)))]
    return {name: tolerances * TOLERANCE[family] * float(rng.choice([-1, 1]))}


@dataclass(frozen=True)
class World:
    """What all campaigns of a run share: seed, repeats, noise and the background's size."""

    seed: int = 0
    repeats: int = 3
    noise: float = 5e-6
    background: float = 0.02


def measure(case: Case, world: World, rng: np.random.Generator) -> list[rc.Row]:
    """Rows with readings, before any fault."""
    plan = rc.protocol_rows(case.protocol, repeats=world.repeats)
    names = list(dict.fromkeys(r["setup"] for r in plan))
    rig = Rig()
    effect = {}
    if case.what == "effect":
        effect = _effect(case.name, case.size, rng, names)
    elif case.what == "outside":
        leg = int(rng.integers(3))
        rig = OUTSIDE[case.name](leg, (leg + 1 + int(rng.integers(2))) % 3, case.size)
    elif case.what == "fault" and case.number % 2:
        families = [n for n in TOLERANCE if n not in ("joint_offset", "leg_length")]
        effect = _effect(families[int(rng.integers(len(families)))], 2.0, rng, names)
    base = {f"joint_offset.{leg}": float(rng.normal(0, 1e-3)) for leg in LEGS}
    base |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rig = rig.with_errors(base | effect)
    warm = (lambda t: 22 + 8 * np.sin(6.9 * t / t.max())) if "thermal" in str(effect) else None
    return rc.simulate(
        rig, plan, rng, noise=world.noise, background=world.background, temperature=warm
    )


def spoil(case: Case, rows: list[rc.Row], rng: np.random.Generator) -> tuple[rc.Fault, str]:
    """Put the fault in; the kind as the package names it."""
    names = list(dict.fromkeys(r["setup"] for r in rows))
    own = names[int(rng.integers(len(names)))]
    after = float(rng.uniform(0.35, 0.65))
    sign = float(rng.choice([-1, 1]))
    if case.name == "outlier":
        return rc.outlier(rows, int(rng.integers(len(rows))), sign * case.size), own
    if case.name == "knocked_stand":
        return rc.knocked_stand(rows, own, sign * case.size, after), own
    if case.name == "command":
        return _mistyped(rows, sign * case.size, rng), own
    if case.name == "sign":
        return rc.swapped_sign(rows, own), own
    if case.name == "unit":
        return rc.wrong_unit(rows, own, case.size), own
    if case.name == "label":
        return rc.wrong_label(rows, own, "leg" if case.size else "direction"), own
    if case.name == "turns":
        return rc.whole_turns(rows, own, case.size), own
    if case.name == "stuck":
        return rc.stuck_dial(rows, own, after), own
    leg = own[0]
    same = [n for n in names if n != own and n[0] == leg and n[2:] == own[2:]]
    apart = [n for n in names if n[0] != leg]
    return rc.swapped_labels(rows, own, str(rng.choice(apart if case.size else same))), own


def _mistyped(rows: list[rc.Row], size: float, rng: np.random.Generator) -> rc.Fault:
    """The command of a posture on a drive that size more, or less where it would be beyond it."""
    postures = len({(r["leg"], *(r[c] for c in rc.RHO)) for r in rows})
    chosen, drive, rig = int(rng.integers(postures)), int(rng.integers(3)), Rig()
    found = rc.wrong_command(rows, chosen, drive, size)
    travel = found.rows[found.touched[0]][rc.RHO[drive]] * 1e-3 - rig.L
    if rig.stroke[0] <= travel <= rig.stroke[1]:
        return found
    return rc.wrong_command(rows, chosen, drive, -size)


def judge(job: tuple[Case, World]) -> Outcome:
    """One campaign."""
    case, world = job
    rng = np.random.default_rng([world.seed, hash_of(case), case.number])
    rows = measure(case, world, rng)
    spoilt, touched = rows, []
    if case.what == "fault":
        spoilt, touched = spoil(case, rows, rng)[0]
    visible = bool(touched) and _visible(rows, spoilt)
    try:
        chosen = machine(case.declared)
        columns = {name: [row[name] for row in spoilt] for name in spoilt[0]}
        campaign = Campaign.from_frame(columns, name="campaign", machine_file=chosen.spec)
        estimate = identify(campaign, chosen, method="nested")
        began = time.perf_counter()
        found = examine(estimate).blunders
        seconds = time.perf_counter() - began
    except OrthoglideError as error:
        return Outcome(case, visible, False, False, 0, True, 0.0, str(error)[:90])
    own = {spoilt[k]["setup"] for k in touched}
    right = [b for b in found if b.kind == case.name and set(b.setups) == own]
    # Rows of one fault that come back as two kinds are no false alarm about sound rows.
    false = sum(not _about(b, touched) for b in found)
    told = "; ".join(f"{b.kind} {'+'.join(b.setups)} {len(b.rows)}" for b in found)
    exact = any(len({r for _, r in b.rows} ^ set(touched)) <= 1 for b in right)
    return Outcome(case, visible, bool(right), exact, false, False, seconds, told)


def _about(blunder: Blunder, touched: Sequence[int]) -> bool:
    rows = {row for _, row in blunder.rows}
    return bool(rows) and len(rows & set(touched)) >= 0.5 * len(rows)


def _visible(rows: list[rc.Row], spoilt: list[rc.Row]) -> bool:
    """Whether labels change, or deviations within a setup by more than 0.05 mm."""
    labels = [[(r["setup"], r["leg"], r["direction"]) for r in of] for of in (rows, spoilt)]
    if labels[0] != labels[1]:
        return True
    change = {}
    shown = (rc.predict(Rig(), spoilt) - rc.predict(Rig(), rows)) * 1e3
    for a, b, moved in zip(rows, spoilt, shown, strict=True):
        change.setdefault(a["setup"], []).append(a["reading_mm"] - b["reading_mm"] - moved)
    return max(np.ptp(c) for c in change.values()) > 0.05


def hash_of(case: Case) -> int:
    from zlib import crc32

    return crc32(f"{case.what}:{case.name}:{case.size:g}".encode())


def run(campaigns: int, jobs: int, world: World, only: str = "") -> list[Outcome]:
    """All cases."""
    work = [(case, world) for case in cases(campaigns) if only in (case.what, "")]
    if jobs == 1:
        return [judge(job) for job in work]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(judge, work, chunksize=4))


def report(outcomes: Sequence[Outcome]) -> str:
    """The table."""
    lines = [f"{'no fault of the data':44}{'campaigns':>10}{'with a false fault':>20}"]
    for what, title in (
        ("nothing", "nothing wrong"),
        ("effect", "one effect of the catalogue"),
        ("outside", "one effect outside the catalogue"),
    ):
        own = [o for o in outcomes if o.case.what == what]
        false = sum(o.false > 0 for o in own)
        lines.append(f"{title:44}{len(own):>10}{false:>12} ({_percent(false, len(own))})")
    lines.append("")
    lines.append(
        f"{'fault put in':44}{'campaigns':>10}{'found':>8}{'rows':>8}{'refused':>9}{'false':>7}"
    )
    for kind, sizes in FAULTS.items():
        for size in sizes:
            own = [
                o
                for o in outcomes
                if o.case.what == "fault" and (o.case.name, o.case.size) == (kind, size)
            ]
            seen = [o for o in own if o.visible]
            if own:
                lines.append(_line(kind, size, seen) + _unseen(own))
    took = sorted(o.seconds for o in outcomes if not o.refused)
    lines.append("")
    lines.append(f"examine: median {took[len(took) // 2]:.3f} s, slowest {took[-1]:.3f} s")
    lines.append(
        "found: right kind and setup; rows: and those very rows, give or take one; refused: on\n"
        "reading or by the identification; false: campaigns with a fault named of sound rows."
    )
    return "\n".join(lines)


def _line(kind: str, size: float, own: Sequence[Outcome]) -> str:
    shown = TITLES.get(kind, {}).get(size) or (f"{size:.4g}" + " mm" * (kind in MM) if size else "")
    cells = [sum(o.found for o in own), sum(o.exact for o in own), sum(o.refused for o in own)]
    shares = [_percent(c, len(own)) for c in [*cells, sum(o.false > 0 for o in own)]]
    return f"{kind + ' ' + shown:44}{len(own):>10}{shares[0]:>8}{shares[1]:>8}{shares[2]:>9}" + (
        f"{shares[3]:>7}"
    )


MM = ("outlier", "knocked_stand", "command", "turns")


def _unseen(own: Sequence[Outcome]) -> str:
    left = sum(not o.visible for o in own)
    return f"   ({left} more changed no deviation by 0.05 mm)" if left else ""


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=800)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="nothing, effect, outside or fault")
    parser.add_argument("--list", action="store_true", help="every campaign that went wrong")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.005, help="of one reading, mm")
    parser.add_argument("--background", type=float, default=0.02, help="in tolerances")
    options = parser.parse_args()
    world = World(options.seed, options.repeats, options.noise * 1e-3, options.background)
    outcomes = run(options.campaigns, options.jobs, world, options.only)
    if options.list:
        for o in outcomes:
            if o.false or (o.visible and not o.found):
                print(o.case, o.case.protocol, o.case.declared, "->", o.told, "refused" * o.refused)
    print(report(outcomes))


if __name__ == "__main__":
    main()
