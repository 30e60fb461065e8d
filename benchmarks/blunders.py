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

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any
from zlib import crc32

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, public, stands_out, whole_machines
from benchmarks.attribution_asked import share
from benchmarks.independent import is_cause, tolerance
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc
from tests.rig import LEGS, TOLERANCE, Rig, parameter_names

PROTOCOLS = ("standard", "sweep", "two-gauges")
NOISE, BACKGROUND = 5e-6, 0.02  # metres of one reading; tolerances of everything
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


def measure(case: Case, rng: np.random.Generator) -> list[rc.Row]:
    """Rows with readings, before any fault."""
    plan = rc.protocol_rows(case.protocol)
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
    return rc.simulate(rig, plan, rng, noise=NOISE, background=BACKGROUND, temperature=warm)


def spoil(case: Case, rows: list[rc.Row], rng: np.random.Generator) -> rc.Fault:
    """Put the fault of a case in."""
    names = list(dict.fromkeys(r["setup"] for r in rows))
    own, size = names[int(rng.integers(len(names)))], case.size
    after = float(rng.uniform(0.35, 0.65))
    signed = float(rng.choice([-1, 1])) * size

    def relabelled() -> rc.Fault:
        same = [n for n in names if n != own and n[0] == own[0] and n[2:] == own[2:]]
        apart = [n for n in names if n[0] != own[0]]
        return rc.swapped_labels(rows, own, str(rng.choice(apart if size else same)))

    faults: dict[str, Callable[[], rc.Fault]] = {
        "outlier": lambda: rc.outlier(rows, int(rng.integers(len(rows))), signed),
        "knocked_stand": lambda: rc.knocked_stand(rows, own, signed, after),
        "command": lambda: _mistyped(rows, signed, rng),
        "sign": lambda: rc.swapped_sign(rows, own),
        "unit": lambda: rc.wrong_unit(rows, own, size),
        "label": lambda: rc.wrong_label(rows, own, "leg" if size else "direction"),
        "turns": lambda: rc.whole_turns(rows, own, size),
        "stuck": lambda: rc.stuck_dial(rows, own, after),
        "exchanged_labels": relabelled,
    }
    return faults[case.name]()


def _mistyped(rows: list[rc.Row], size: float, rng: np.random.Generator) -> rc.Fault:
    """The command of a posture on a drive that size more, or less where it would be beyond it."""
    postures = len({(r["leg"], *(r[c] for c in rc.RHO)) for r in rows})
    chosen, drive, rig = int(rng.integers(postures)), int(rng.integers(3)), Rig()
    found = rc.wrong_command(rows, chosen, drive, size)
    travel = found.rows[found.touched[0]][rc.RHO[drive]] * 1e-3 - rig.L
    if rig.stroke[0] <= travel <= rig.stroke[1]:
        return found
    return rc.wrong_command(rows, chosen, drive, -size)


def judge(case: Case, seed: int) -> Record:
    """Return what became of one campaign, ready for JSON."""
    drawn = crc32(f"{case.what}:{case.name}:{case.size:g}".encode())
    rng = np.random.default_rng([seed, drawn, case.number])
    record: Record = {"key": case.key, "seed": seed, "what": case.what, "name": case.name,
                      "size": case.size}  # fmt: skip
    try:
        for found in (_worn if case.what == "worn" else _usual)(case, rng):
            record |= found
    except og.OrthoglideError as error:
        record["refused"] = public.error_text(error)[:120]
    return record


def _closed(rows: list[rc.Row], chosen: og.Machine) -> public.Result:
    campaign = public.campaign(rows, name="campaign", machine_file=chosen.spec)
    return public.verdict_of(og.close_loop([campaign], chosen))


def _usual(case: Case, rng: np.random.Generator) -> Iterator[Record]:
    """Yield whether a fault can be seen, and then what is reported of it."""
    rows = measure(case, rng)
    spoilt, touched = spoil(case, rows, rng) if case.what == "fault" else (rows, list[int]())
    yield {"visible": bool(touched) and _visible(rows, spoilt)}
    result = _closed(spoilt, machine(case.declared))
    setups = {spoilt[k]["setup"] for k in touched}
    right = [b for b in result["blunders"]
             if b["kind"] == case.name and set(b["setups"]) == setups]  # fmt: skip
    yield {
        "word": result["verdict"],
        "found": bool(right),
        "exact": any(len(set(b["rows"]) ^ set(touched)) <= 1 for b in right),
        # Rows of one fault that come back as two kinds are no false alarm about sound rows.
        "false": sum(not _about(b, touched) for b in result["blunders"]),
    }


def _worn(case: Case, rng: np.random.Generator) -> Iterator[Record]:
    """Yield what is reported of a wrong command on a worn machine with one clear cause."""
    share = WORN[case.name]
    rows = rc.protocol_rows(WORN_SHEETS[case.number % len(WORN_SHEETS)])
    clear = 0.0
    while clear < WORN_CLEAR:
        family = str(rng.choice(WORN_EFFECTS))
        cause = ac.effect(family, rng)
        size = float(rng.uniform(*WORN_TOLERANCES))
        rig = whole_machines.rig_of(share, rng)
        rig = rig.with_errors({n: size * v for n, v in cause.errors.items()})
        measured = rc.simulate(rig, rows, rng)
        shown = {n: size * v / tolerance(n) for n, v in cause.errors.items()}
        clear = stands_out.seen(stands_out.beside(measured, share), shown, share)
    spoilt, touched = _mistyped(measured, case.size * float(rng.choice([-1, 1])), rng)
    apart = [measured[touched[0]][c] - spoilt[touched[0]][c] for c in rc.RHO]
    drive = int(np.argmax(np.abs(apart)))
    result = _closed(spoilt, public.machine())
    stated = list(public.command_faults(result))
    here = [s for d, s in stated[:1] if d == LEGS[drive]]
    yield {
        "word": result["verdict"],
        "stated": stated,
        "right_drive": bool(here),
        "right_size": any(abs(s - apart[drive]) <= RIGHT_SIZE for s in here),
        "right_rows": any(set(b["rows"]) == set(touched) for b in result["blunders"]
                          if b["kind"] == "command"),
        "cause_named": any(is_cause(e["name"], e["parameters"], cause.name, family)
                           for f in result["effects"] for e in f["set"]),
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


def worn(campaigns: int) -> list[Case]:
    """Return so many wrong commands on machines of each share of wear."""
    sizes = WORN_COMMANDS
    return [
        Case("worn", name, sizes[k % len(sizes)], k // len(sizes))
        for name in WORN
        for k in range(campaigns)
    ]


def tables(outcomes: Sequence[Record]) -> Iterator[Table]:
    """Yield what was seen on sound readings, of faults, and on worn machines."""
    sound = [["", "campaigns", "with a false fault"]]
    for what, title in (
        ("nothing", "nothing wrong"),
        ("effect", "one effect of the catalogue"),
        ("outside", "one effect outside the catalogue"),
    ):
        own = [o for o in outcomes if o["what"] == what]
        sound.append([title, str(len(own)), share(own, _has_false)])
    yield Table("No fault of the data", "", sound)
    faults = [["", "campaigns", "found", "rows", "refused", "false", "unseen"]]
    every = [o for o in outcomes if o["what"] == "fault"]
    kinds = [(kind, size) for kind, sizes in FAULTS.items() for size in sizes]
    groups = [(_title(*k), [o for o in every if (o["name"], o["size"]) == k]) for k in kinds]
    for title, own in [*groups, ("all", every)]:
        seen = [o for o in own if o["visible"]]
        tests = (lambda o: o.get("found"), lambda o: o.get("exact"), lambda o: "refused" in o,
                 _has_false)  # fmt: skip
        shares = [share(seen, test) for test in tests]
        faults.append([title, str(len(seen)), *shares, str(len(own) - len(seen) or "")])
    note = (
        "*Found*: right kind and setup; *rows*: and those very rows, give or take one; *refused*: "
        "on reading or by the identification; *false*: campaigns with a fault named of sound rows; "
        "*unseen*: further campaigns, of which no deviation changed by 0.05 mm."
    )
    yield Table("Fault put in", note, faults)
    yield _of_worn([o for o in outcomes if o["what"] == "worn"])


def _has_false(outcome: Record) -> bool:
    return bool(outcome.get("false", 0) > 0)


def _title(kind: str, size: float) -> str:
    shown = TITLES.get(kind, {}).get(size) or (f"{size:.4g}" + " mm" * (kind in MM) if size else "")
    return f"{kind} {shown}".strip()


MM = ("outlier", "knocked_stand", "command", "turns")


def _of_worn(outcomes: Sequence[Record]) -> Table:
    rows = [["", "campaigns", "command", "drive", "size", "cause", "all right", "fit left",
             "refused"]]  # fmt: skip
    groups = [
        (f"{s:g} mm, all off by {worn_by:g}",
         [o for o in outcomes if (o["name"], o["size"]) == (name, s)])
        for name, worn_by in WORN.items()
        for s in WORN_COMMANDS
    ]  # fmt: skip
    for title, own in [*groups, ("all", list(outcomes))]:
        ended = [o for o in own if "word" in o]
        cells = (
            len(own),
            sum(bool(o["stated"]) for o in ended),
            *(sum(o[k] for o in ended) for k in ("right_drive", "right_size", "cause_named")),
            sum(o["right_size"] and o["cause_named"] for o in ended),
            sum(o["word"] in ("partial", "unexplained") for o in ended),
            len(own) - len(ended),
        )
        rows.append([title, *map(str, cells)])
    note = (
        "*Command*: a wrong command is reported; *drive*, *size*: the first one stated is right; "
        "*cause*: the machine's cause is in a named set; *fit left*: verdict partial or "
        "unexplained."
    )
    return Table("Wrong command on a worn machine", note, rows)


if __name__ == "__main__":
    run_all(__doc__, lambda usual, worn_: [*cases(usual), *worn(worn_)], judge, tables,
            campaigns=800, worn=24)  # fmt: skip
