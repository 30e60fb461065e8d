"""The truth table of the linear delta: what a probe, a calliper, a level or a tracker can tell.

    python -m benchmarks.delta_truth [--campaigns 300] [--cache FILE.jsonl] [--jobs 2]

Machines are simulated by the tests' own delta (`tests/rig_delta.py`, a rigid platform on six bars,
numpy alone). Each has endstops off by half a millimetre, towers by a few tenths, arms by two
hundredths, 1.5 % of a printer's tolerance of everything else, and one cause or none. A run goes on
where it stopped, from the cache. *Clear* is as in the Orthoglide's table: what shows past the base
has an rms of three sigma and lies five from the nearest other class, the noise widened by the
background; *invisible* is what shows less than three sigma of all readings together, at a size of
up to three tolerances.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from zlib import crc32

import numpy as np

import orthoglide as og
from benchmarks import public
from benchmarks.attribution_cases import Case, Cause
from benchmarks.delta_readings import INSTRUMENTS, SEEN, Array, measured
from benchmarks.delta_table import UNSEEN, tables
from benchmarks.independent import family_of, metric
from benchmarks.independent_delta import (
    TOLERANCE,
    WIDER,
    DeltaVisible,
    machine_parameters,
    visible as visible_by,
    weights_of,
)
from benchmarks.runs import Record, Table, arguments, records
from tests.rig_delta import LEGS, DeltaRig

BACKGROUND = 0.015
SIZES = (4.0, 12.0)
"""Wanted rms past the base, in sigmas of noise and background; never more than three
tolerances."""

CAUSES: Mapping[str, tuple[str, ...]] = {
    "carriages lean with their rails": ("rail_tilt.@.tangential", "rail_tilt.@.radial"),
    "paths out of square": ("axis_tilt.@.tangential", "axis_tilt.@.radial"),
    "twisted frame": ("rail_tilt.tangential.common",),
    "carriage roll": ("mount_tilt.@.a",),
    "hinge turned about its pivots": ("mount_tilt.@.b", "mount_tilt.b.common"),
    "rail torsion": ("rail_torsion.@", "rail_torsion.common"),
    "unequal rods": ("bar_mismatch.@",),
    "unequal short links": ("parallelogram_width.@", "parallelogram_width.common"),
    "bent rail": ("rail_bow.@.tangential", "rail_bow.@.radial"),
    "belt": ("encoder_scale.@",),
    "bed of three lobes": ("plate_trefoil.bed.cos", "plate_trefoil.bed.sin"),
    "bed a bowl": ("plate_bow.bed",),
    "saddle of a bed": ("plate_saddle.bed.cos", "plate_saddle.bed.sin"),
}
OUTSIDE = ("wavy rail", "kinked rail", "carriage rolls in waves", "bump",
           "uneven bed")  # fmt: skip
SHARES = {"nothing": 6, "effect": 14, "outside": 6, "whole": 4}


HEAD = """# The truth table of the linear delta

Read this page to choose instruments for a delta: which cause each shows, and how often the verdict
is right. Printed by `python -m benchmarks.delta_truth --campaigns {campaigns} --seed {seed}`.
Machines are simulated by the tests' own delta, which shares no code with the package: arms of
345 mm, a mesh of 49 touches (each to 0.018 mm), thirty distances on a ring of 90 mm (0.05 mm), a
level at 13 places (0.02 mrad), 36 places of the tool (0.01 mm)."""

UNSHOWN = (
    "  another cause besides", "  called by a wrong name", "  error of the tool, nominal, mm",
    "  taken for noise, with a warning, or for faulty readings",
)  # fmt: skip
"""Rows of `delta_table` that the page leaves out; `compare_frozen` prints them."""

FEW = """ A few campaigns of each kind are no rate yet;
`--campaigns 300` takes some minutes."""


def cases(campaigns: int) -> list[Case]:
    """Cases of a table of about that many, the instrument of each as its protocol; a smaller table
    is part of a larger one.
    """
    found: list[Case] = []
    total = sum(SHARES.values())
    for kind, part in SHARES.items():
        what = {"effect": tuple(CAUSES), "outside": OUTSIDE}.get(kind, ("",))
        sizes = SIZES if kind == "effect" else (8.0,)
        count, number = max(len(INSTRUMENTS), round(campaigns * part / total)), 0
        batch: list[Case] = []
        while len(batch) < count:
            grid = [Case(kind, w, i, s, number) for w in what for i in INSTRUMENTS for s in sizes]
            # Every instrument in turn, whatever the number.
            grid.sort(key=lambda c: crc32(c.key.encode()))
            turns = [[c for c in grid if c.protocol == i] for i in INSTRUMENTS]
            batch += [c for together in zip(*turns, strict=True) for c in together]
            number += 1
        found += batch[:count]
    return found


@cache
def machine() -> og.Machine:
    """The nominal machine of the rig, with a printer's tolerances."""
    rig = DeltaRig()
    layout = og.LinearDelta((rig.radius,) * 3, rig.angles, rig.tool)
    geometry = og.Geometry(rig.L, rig.d, rig.r, rig.stroke, layout)
    noise = {kind: og.Instrument(repeatability=sigma) for kind, sigma in
             (("plate", 1.8e-5), ("distance", 5e-5), ("incline", 2e-5), ("tcp", 1e-5))}  # fmt: skip
    wider = {f: TOLERANCE[f] for f in WIDER}
    return og.Machine(og.MachineFile(geometry=geometry, instruments=noise, tolerance=wider))


def _drawn(rng: np.random.Generator, much: float) -> DeltaRig:
    """A machine with its base errors, and a share of its tolerances of everything else."""
    errors = {}
    for name in machine_parameters():
        family = family_of(name)
        base = {"joint_offset": 5e-4, "axis_offset": 3e-4, "leg_length": 2e-5}.get(family)
        sd = base or (much * TOLERANCE[family] if family in WIDER else 0.0)
        if family != "backlash":  # everything arrives downwards
            errors[name] = sd * float(rng.standard_normal())
    return DeltaRig(errors=errors)


def _cause(case: Case, rng: np.random.Generator) -> Cause:
    if case.kind == "outside":
        return _strange(case.what, rng)
    name = str(rng.choice(CAUSES[case.what])).replace("@", str(rng.choice(list(LEGS))))
    return _named(name, float(rng.choice([-1.0, 1.0])))


def _named(name: str, sign: float) -> Cause:
    """A cause of the catalogue at one tolerance, with a sign."""
    family = name.partition(".")[0]
    size = sign * TOLERANCE[family]
    if family.startswith("plate"):
        return Cause(name, family, {name: size})
    return Cause(name, family, {n: w * size for n, w in weights_of(name).items()})


def _strange(kind: str, rng: np.random.Generator) -> Cause:
    """What no catalogue lists, of the size given in metres (turns: over 25 mm)."""
    leg, phase = str(rng.choice(list(LEGS))), float(rng.uniform(0, 6))
    period, at = float(rng.uniform(0.03, 0.06)), float(rng.uniform(-0.02, 0.04))

    def wave(travel: float) -> float:
        return float(np.sin(2 * np.pi * travel / period + phase))

    def kink(travel: float) -> float:
        return max(travel - at, 0.0) / 0.05

    def bent(shape: Callable[[float], float]) -> Callable[[DeltaRig, float], DeltaRig]:
        return lambda rig, v: replace(rig, bends={leg: lambda s: (0.0, v * shape(s), 0.0)})

    shares = rng.standard_normal(6)

    def uneven(x: Array, y: Array) -> Array:
        """Four-sided waves and finer ones than a bowl or three lobes have."""
        four, two = (x + 1j * y) ** 4, (x + 1j * y) ** 2 * (4 * (x**2 + y**2) - 3)
        square = 6 * (x**2 + y**2) * (x**2 + y**2 - 1) + 1
        finer = x * (x**2 + y**2 - 0.5)
        return shares @ np.array([four.real, four.imag, two.real, two.imag, square, finer])

    def bed(shape: Callable[[Array, Array], Array]) -> Callable[[DeltaRig, float], DeltaRig]:
        return lambda rig, v: replace(rig, bed=lambda x, y: v * shape(x / 0.12, y / 0.12))

    made = {
        "wavy rail": bent(wave),
        "kinked rail": bent(kink),
        "carriage rolls in waves": lambda rig, v: replace(
            rig, turns={leg: lambda s: 40.0 * v * wave(s)}
        ),
        "uneven bed": bed(uneven),
        "bump": bed(lambda x, y: np.exp(-((x - 0.4) ** 2 + (y - 0.2) ** 2) / 0.05)),
    }
    rail, roll = (
        tuple(f"{part}/{how}" for how in ("travel", "waves"))
        for part in (f"rail.{leg}.tangential", f"carriage.{leg}.{leg}")
    )
    where = {"wavy rail": rail, "kinked rail": rail, "carriage rolls in waves": roll}
    extra = made[kind]
    return Cause(
        kind, kind, {}, lambda rig, size: extra(rig, 1e-4 * size), where.get(kind, ()), 20.0
    )


def run(case: Case, seed: int) -> Record:
    """Everything the tables need of one campaign, ready for JSON."""
    began, rng = time.perf_counter(), case.rng(seed)
    record: Record = {"key": case.key, "seed": seed, "kind": case.kind, "what": case.what,
                      "instrument": case.protocol, "rms": case.rms, "truth": []}  # fmt: skip
    try:
        bare = _drawn(rng, 0.3 if case.kind == "whole" else BACKGROUND)
        rig, given = bare, partial(measured, machine=machine(), instrument=case.protocol)
        if case.kind in ("effect", "outside"):
            cause = _cause(case, rng)
            given(bare, rng)  # sizes were once taken from readings: the draws stay the same
            seen = visible_by(INSTRUMENTS[case.protocol], BACKGROUND)
            one = _added(given, cause.added_to(bare, 1.0), bare)
            small = _rms(seen.beside.past(one), seen)
            size = min(case.rms / max(small, 1e-12), cause.largest)
            rig = cause.added_to(bare, size)
            shown = _added(given, rig, bare)
            blurred = seen.beside.past(shown)
            truth = metric(blurred, seen.candidates(beside=True), (cause.name, cause.family))
            truth |= {"rms": _rms(blurred, seen), "places": cause.places, "size": float(size)}
            truth["sigmas"] = float(np.linalg.norm(seen.whitener.past(shown)))
            record["truth"] = [truth | {"errors": list(cause.errors)}]
        verdict = og.close_loop([given(rig, rng)], machine())
        result = public.verdict_of(verdict)
        record |= {"word": result["verdict"], "blunders": len(result["blunders"])}
        record |= public.said(result)
        record["loud"] = public.warned_of_noise(result)
        record["invisible"] = public.unseen_of(result)
        record["tool_mm"] = _errors(rig, verdict, public.base_of(result, TOLERANCE))
    except og.OrthoglideError as error:
        record |= {"word": "error", "message": public.error_text(error)}
    return record | {"seconds": round(time.perf_counter() - began, 2)}


def _added(
    given: Callable[[DeltaRig], og.Readings], rig: DeltaRig, bare: DeltaRig
) -> Array:  # fmt: skip
    """Return what a machine's readings have beside those of another, without noise ``(n,)``."""
    return np.asarray(given(rig).reading - given(bare).reading)


def _rms(shown: Array, seen: DeltaVisible) -> float:
    """Return the root mean square over the readings, in sigmas."""
    return float(np.linalg.norm(shown) / np.sqrt(seen.count))


def _errors(rig: DeltaRig, verdict: og.Verdict, base_values: Mapping[str, float]) -> list[float]:
    """Mean error of the predicted tool over the print, best rigid motion of the plate removed."""
    t, z = np.arange(12) * np.pi / 6, np.tile([0.0, 0.05], 6)
    p = np.stack([0.1 * np.cos(t), 0.1 * np.sin(t), z], axis=1)
    command = machine().inverse(p)
    true = np.array([rig.pose(s, q)[0] for s, q in zip(command, p, strict=True)])
    found = []
    base = machine().with_parameters(base_values)
    for predicted in (machine(), base, verdict.machine):
        apart = predicted.forward(command) - true
        turns = np.stack([np.cross(e, p) for e in np.eye(3)], axis=2)
        columns = np.concatenate([np.tile(np.eye(3), (len(p), 1, 1)), turns], axis=2)
        columns = columns.reshape(-1, 6)
        rest = apart.reshape(-1)
        rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
        found.append(1e3 * float(np.linalg.norm(rest.reshape(-1, 3), axis=1).mean()))
    return found


def visible() -> Table:
    """What instruments see of each cause at its tolerance, past the base, without noise."""
    rows, columns = [["", *SEEN]], list[list[str]]()
    for instrument in SEEN:
        given = partial(measured, machine=machine(), instrument=instrument)
        cells, seen = list[str](), visible_by(SEEN[instrument], BACKGROUND)
        candidates = seen.candidates(beside=False)
        for what in CAUSES:
            name = CAUSES[what][0].replace("@", "b")
            cause = _named(name, 1.0)
            shown = _added(given, cause.added_to(DeltaRig(), 1.0), DeltaRig())
            found = metric(seen.whitener.past(shown), candidates, (cause.name, cause.family))
            others = f", {found['same']} alike" if found["same"] else ""
            norm = found["norm"]
            # Not rounded up to three.
            size = f"{norm:.0f}" if norm >= 10 else f"{np.floor(10 * norm) / 10:.1f}"
            cells.append(f"{size}{others}" if norm >= UNSEEN else f"({size})")
        columns.append(cells)
    for k, what in enumerate(CAUSES):
        rows.append([what, *(cells[k] for cells in columns)])
    note = (
        "What one cause at a printer's tolerance shows in all readings together, in sigmas, with "
        "endstops, towers, arms and nuisances fitted. *Alike*: other causes within two sigmas of "
        "it. In brackets: below three, invisible to that instrument."
    )
    return Table("What can be seen at all", note, rows)


def main() -> None:
    """Run what is missing and print the page."""
    options = arguments(__doc__, campaigns=300).parse_args()
    seen = visible()  # which all processes then know
    found = records(cases(options.campaigns), partial(run, seed=options.seed), options)
    few = FEW if options.campaigns < 300 else ""
    print(HEAD.format(campaigns=options.campaigns, seed=options.seed) + few)
    for table in (seen, *tables(found)):
        shown = replace(table, rows=[row for row in table.rows if row[0] not in UNSHOWN])
        print(re.sub(r"[\d.]+ % \((\d+/\d+)\)", r"\1", shown.markdown()))


if __name__ == "__main__":
    main()
