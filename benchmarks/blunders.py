"""How often faults of the data are found, and how often one is seen where there is none.

    python -m benchmarks.blunders [--campaigns 800] [--worn 24] [--jobs 2] [--cache FILE.jsonl]

Campaigns come from the tests' independent machine: joint offsets of a millimetre, small errors of
everything, noise, a rounding dial and dials that stand somewhat beside their stated places. A
quarter has nothing wrong, a quarter one effect of the catalogue, an eighth an effect that is in no
catalogue, the rest a fault of the data, half of these beside an effect. Half are judged with the
noise and tolerances of a machine file, half with the nominal machine, its noise from the repeats.
What counts is what the closed loop reports.

Worn machines are apart: everything is off by 0.3 or 0.1 of its tolerance, one effect is clear,
and the command of one posture is written 5 to 10 mm wrong on one drive. Right is the drive, a size
within 0.1 mm, and the machine's cause in a set that is named. A run goes on where it stopped, from
the cache.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, public, stands_out, whole_machines
from benchmarks.independent import TOLERANCE as EXPECTED, is_cause, tolerance
from tests import rig_campaigns as rc
from tests.rig import LEGS, TOLERANCE, Rig, parameter_names

Record = dict[str, Any]

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
WORN = {"command": 0.3, "command, less worn": 0.1}
"""Shares of their tolerances by which everything on a worn machine is off."""

WORN_EFFECTS = ("axis_tilt", "rail_bow", "backlash", "encoder_scale", "screw_error", "bar_mismatch")
WORN_TOLERANCES = (2.0, 5.0)  # of what stands out
WORN_CLEAR = 8.0  # sigmas past noise and background that it shows at least
WORN_COMMANDS = (5.0, 7.5, 10.0)  # millimetres
WORN_SHEETS = ("sweep", "two-gauges")
RIGHT_SIZE = 0.1  # millimetres within which the size of a wrong command is right
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
    def key(self) -> str:
        """Unique in a run."""
        return f"{self.what}:{self.name}:{self.size:g}:{self.number}"

    @property
    def protocol(self) -> str:
        """Of the readings."""
        return PROTOCOLS[self.number % 3]

    @property
    def declared(self) -> bool:
        """Whether the noise is known from a machine file."""
        return self.number // 3 % 2 == 0


@cache
def machine(declared: bool) -> og.Machine:
    return public.machine() if declared else og.Machine.nominal()


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


def judge(case: Case, world: World) -> Record:
    """Return what became of one campaign, ready for JSON."""
    rng = np.random.default_rng([world.seed, hash_of(case), case.number])
    record: Record = {"key": case.key, "world": vars(world), "what": case.what, "name": case.name,
                      "size": case.size}  # fmt: skip
    if case.what == "worn":
        return record | judge_worn(case, rng)
    rows = measure(case, world, rng)
    spoilt, touched = rows, list[int]()
    if case.what == "fault":
        spoilt, touched = spoil(case, rows, rng)[0]
    record["visible"] = bool(touched) and _visible(rows, spoilt)
    try:
        chosen = machine(case.declared)
        campaign = public.campaign(spoilt, name="campaign", machine_file=chosen.spec)
        began = time.perf_counter()
        result = public.verdict_of(og.close_loop([campaign], chosen))
    except og.OrthoglideError as error:
        return record | {"refused": public.error_text(error)[:120]}
    found = result["blunders"]
    setups = {spoilt[k]["setup"] for k in touched}
    right = [b for b in found if b["kind"] == case.name and set(b["setups"]) == setups]
    return record | {
        "word": result["verdict"],
        "found": bool(right),
        "exact": any(len(set(b["rows"]) ^ set(touched)) <= 1 for b in right),
        # Rows of one fault that come back as two kinds are no false alarm about sound rows.
        "false": sum(not _about(b, touched) for b in found),
        "said": "; ".join(f"{b['kind']} {'+'.join(b['setups'])} {len(b['rows'])}" for b in found),
        "seconds": round(time.perf_counter() - began, 2),
    }


def judge_worn(case: Case, rng: np.random.Generator) -> Record:
    """Return what is reported of a wrong command on a worn machine with one clear cause."""
    share = WORN[case.name]
    rows = rc.protocol_rows(WORN_SHEETS[case.number % len(WORN_SHEETS)])
    while True:
        cause = ac.effect(
            family := str(rng.choice(WORN_EFFECTS)), EXPECTED[family], [], rng, shaped=False
        )
        size = float(rng.uniform(*WORN_TOLERANCES))
        rig = whole_machines.rig_of(share, rng)
        rig = rig.with_errors({n: size * v for n, v in cause.errors.items()})
        measured = rc.simulate(rig, rows, rng)
        shown = {n: size * v / tolerance(n) for n, v in cause.errors.items()}
        beside = stands_out.beside(measured, share)
        if (clear := stands_out.seen(beside, shown, share)) >= WORN_CLEAR:
            break
    spoilt, touched = _mistyped(measured, case.size * float(rng.choice([-1, 1])), rng)
    first = touched[0]
    apart = [measured[first][c] - spoilt[first][c] for c in rc.RHO]
    drive = int(np.argmax(np.abs(apart)))
    record: Record = {"cause": cause.name, "sigmas": clear, "drive": LEGS[drive],
                      "apart": apart[drive]}  # fmt: skip
    began = time.perf_counter()
    try:
        result = public.verdict_of(og.close_loop([public.campaign(spoilt)], public.machine()))
    except og.OrthoglideError as error:
        return record | {"refused": public.error_text(error)[:120]}
    stated = list(public.command_faults(result))
    here = [s for d, s in stated[:1] if d == LEGS[drive]]
    return record | {
        "word": result["verdict"],
        "stated": stated,
        "right_drive": bool(here),
        "right_size": any(abs(s - apart[drive]) <= RIGHT_SIZE for s in here),
        "right_rows": any(set(b["rows"]) == set(touched) for b in result["blunders"]
                          if b["kind"] == "command"),
        "cause_named": any(is_cause(e["name"], e["parameters"], cause.name, family)
                           for f in result["effects"] for e in f["set"]),
        "said": "; ".join(f"{b['kind']} {'+'.join(b['setups'])} {len(b['rows'])}"
                          for b in result["blunders"]),
        "effects": [f["name"] for f in result["effects"]],
        "located": [f["places"][0] for f in public.said(result)["located"]],
        "seconds": round(time.perf_counter() - began, 2),
    }  # fmt: skip


def _about(blunder: Mapping[str, Any], touched: Sequence[int]) -> bool:
    rows = set(blunder["rows"])
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
    return bool(max(np.ptp(c) for c in change.values()) > 0.05)


def hash_of(case: Case) -> int:
    return crc32(f"{case.what}:{case.name}:{case.size:g}".encode())


def worn(campaigns: int) -> list[Case]:
    """Return so many wrong commands on machines of each share of wear."""
    sizes = WORN_COMMANDS
    return [
        Case("worn", name, sizes[k % len(sizes)], k // len(sizes))
        for name in WORN
        for k in range(campaigns)
    ]


def known(cache: Path | None, world: World) -> dict[str, Record]:
    """Return the records of an earlier run by key."""
    if cache is None or not cache.exists():
        return {}
    lines = map(json.loads, cache.read_text(encoding="utf-8").splitlines())
    return {r["key"]: r for r in lines if r["world"] == vars(world)}


def run(wanted: Sequence[Case], jobs: int, world: World, cache: Path | None) -> Iterator[Record]:
    """Yield the records of all cases, those of an earlier run first."""
    before = known(cache, world)
    yield from (before[c.key] for c in wanted if c.key in before)
    # In no order of kinds, so that what is there after a while is a fair part of the whole.
    missing = sorted(
        (c for c in wanted if c.key not in before), key=lambda c: crc32(c.key.encode())
    )
    with multiprocessing.get_context("fork").Pool(jobs) as pool:
        for record in pool.imap_unordered(partial(judge, world=world), missing):
            if cache:
                with cache.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(record) + "\n")
            yield record


def report(outcomes: Sequence[Record]) -> str:
    """Return the tables."""
    lines = [f"{'no fault of the data':44}{'campaigns':>10}{'with a false fault':>20}"]
    for what, title in (
        ("nothing", "nothing wrong"),
        ("effect", "one effect of the catalogue"),
        ("outside", "one effect outside the catalogue"),
    ):
        own = [o for o in outcomes if o["what"] == what]
        false = sum(o.get("false", 0) > 0 for o in own)
        lines.append(f"{title:44}{len(own):>10}{false:>12} ({_percent(false, len(own))})")
    lines.append("")
    lines.append(
        f"{'fault put in':44}{'campaigns':>10}{'found':>8}{'rows':>8}{'refused':>9}{'false':>7}"
    )
    every = [o for o in outcomes if o["what"] == "fault"]
    for kind, sizes in FAULTS.items():
        for size in sizes:
            own = [o for o in every if (o["name"], o["size"]) == (kind, size)]
            if own:
                lines.append(_line(kind, size, [o for o in own if o["visible"]]) + _unseen(own))
    if seen := [o for o in every if o["visible"]]:
        lines.append(_line("all", 0.0, seen) + _unseen(every))
    lines += [
        "",
        "found: right kind and setup; rows: and those very rows, give or take one; refused: on",
        "reading or by the identification; false: campaigns with a fault named of sound rows.",
        "",
        *_of_worn([o for o in outcomes if o["what"] == "worn"]),
    ]
    took = sorted(o["seconds"] for o in outcomes if "seconds" in o)
    if took:
        lines.append(f"close_loop: median {took[len(took) // 2]:.1f} s, slowest {took[-1]:.1f} s")
    return "\n".join(lines)


def _of_worn(outcomes: Sequence[Record]) -> Iterator[str]:
    titles = ("campaigns", "command", "drive", "size", "cause", "all right", "fit left", "refused")
    yield f"{'wrong command on a worn machine':36}" + "".join(f"{t:>10}" for t in titles)
    rows = [
        (f"{s:g} mm, all off by {share:g}", [o for o in own if o["size"] == s])
        for name, share in WORN.items()
        for own in [[o for o in outcomes if o["name"] == name]]
        for s in WORN_COMMANDS
    ]
    for title, own in [*rows, ("all", list(outcomes))]:
        ended = [o for o in own if "word" in o]
        cells = (
            len(own),
            sum(bool(o["stated"]) for o in ended),
            *(sum(o[k] for o in ended) for k in ("right_drive", "right_size", "cause_named")),
            sum(o["right_size"] and o["cause_named"] for o in ended),
            sum(o["word"] in ("partial", "unexplained") for o in ended),
            len(own) - len(ended),
        )
        if own:
            yield f"{title:36}" + "".join(f"{c:>10}" for c in cells)
    yield (
        "command: a wrong command is reported; drive, size: the first one stated is right; cause:\n"
        "the machine's cause is in a named set; fit left: verdict partial or unexplained."
    )


def _line(kind: str, size: float, own: Sequence[Record]) -> str:
    shown = TITLES.get(kind, {}).get(size) or (f"{size:.4g}" + " mm" * (kind in MM) if size else "")
    cells = [sum(o.get(k, False) for o in own) for k in ("found", "exact")]
    cells += [sum("refused" in o for o in own), sum(o.get("false", 0) > 0 for o in own)]
    shares = [_percent(c, len(own)) for c in cells]
    return f"{kind + ' ' + shown:44}{len(own):>10}{shares[0]:>8}{shares[1]:>8}{shares[2]:>9}" + (
        f"{shares[3]:>7}"
    )


MM = ("outlier", "knocked_stand", "command", "turns")


def _unseen(own: Sequence[Record]) -> str:
    left = sum(not o["visible"] for o in own)
    return f"   ({left} more changed no deviation by 0.05 mm)" if left else ""


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "-"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=800)
    parser.add_argument(
        "--worn", type=int, default=24, help="wrong commands on machines of each share of wear"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="nothing, effect, outside, fault or worn")
    parser.add_argument("--list", action="store_true", help="every campaign that went wrong")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.005, help="of one reading, mm")
    parser.add_argument("--background", type=float, default=0.02, help="in tolerances")
    parser.add_argument("--cache", type=Path, help="JSON lines; a run goes on from here")
    parser.add_argument("--finished", action="store_true", help="tables of the cache as it is")
    options = parser.parse_args(arguments)
    world = World(options.seed, options.repeats, options.noise * 1e-3, options.background)
    wanted = [c for c in (*cases(options.campaigns), *worn(options.worn))
              if options.only in (c.what, "")]  # fmt: skip
    if options.finished:
        before = known(options.cache, world)
        wanted = [c for c in wanted if c.key in before]
    outcomes = list(run(wanted, options.jobs, world, options.cache))
    if options.list:
        for o in outcomes:
            if o.get("false") or (o.get("visible") and not o.get("found")):
                print(o["key"], "->", o.get("said") or o.get("refused"))
    print(report(outcomes))


if __name__ == "__main__":
    main()
