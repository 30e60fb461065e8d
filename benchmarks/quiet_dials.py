"""Large offsets and lengths alone, and ever better dials: neither may turn a verdict wrong.

    python benchmarks/quiet_dials.py [--machines 200] [--descents 24] [--seed 0]

The machines have offsets and lengths of up to ten tolerances and nothing else: each is *adequate*,
or refused as its stroke is out of reach, and what is far beyond its tolerance is named. A descent
is one machine with one cause, or none, measured by dials from 20 um of noise down to 0.1 um,
rounded to 0.01 mm or not at all: once a verdict was right, none of a better dial may be wrong.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import re
from collections import Counter
from dataclasses import replace

import numpy as np

import orthoglide as og

NOISES = (2e-5, 1e-5, 5e-6, 2e-6, 1e-6, 5e-7, 2e-7, 1e-7)
"""Metres, from the worst dial to the best."""

CAUSES = {"": 0.0, "backlash.x": 6e-5, "axis_tilt.y.z": 2e-3, "rail_bow.z.x": 1e-4}
"""Sizes that a dial of 20 um of noise shows, over the repeats of a sweep."""

UNNAMED = ("adequate", "diffuse")
"""Verdicts by which no part of the machine is wrong beyond its tolerance."""

_FAR = 4.0  # tolerances from which a value is to be said to be far off
_SHEETS = ("standard", "sweep")


def large(number: int, seed: int) -> str:
    """How a machine with nothing but large offsets and lengths is judged."""
    machine, rng = og.Machine.nominal(), np.random.default_rng([seed, number])
    names = [f"{effect}.{leg}" for effect in ("joint_offset", "leg_length") for leg in "xyz"]
    errors = {n: machine.tolerance(n) * float(rng.uniform(-10, 10)) for n in names}
    campaign = og.simulate(
        machine.with_parameters(errors), _SHEETS[number % 2], noise=5e-6, seed=number
    )
    try:
        verdict = og.close_loop(campaign, machine)
    except og.OrthoglideError as error:
        told = "times its tolerance" in str(error)
        return f"refused, {'told' if told else str(error)[:80]}"
    far = [w for w in verdict.after.warnings if w.kind == "tolerance"]
    said = {name for w in far for name in re.findall(r"\((\S+)\) is ", w)}
    if verdict.word not in UNNAMED:
        return f"{verdict.word}, {'told' if said else 'nothing told'}"
    seen = {n for n in names if abs(verdict.after.values[n]) > _FAR * machine.tolerance(n)}
    return "adequate" + (", what is far off untold" if seen - said else "")


def right(verdict: og.Verdict, cause: str) -> bool | None:
    """Whether a verdict is right; ``None`` where it claims nothing that is wrong."""
    if not cause:
        return verdict.word in UNNAMED
    known = {n for e in verdict.effects for one in (e.chosen, *e.rivals, *e.same)
             for n in one.parameters}  # fmt: skip
    if cause in known and len(verdict.effects) == 1 and verdict.word != "partial":
        return True
    return None if verdict.word == "located" else False


def descent(number: int, seed: int) -> tuple[str, list[bool | None]]:
    """One machine by ever better dials: what it is, and how each verdict is."""
    cause = list(CAUSES)[number % len(CAUSES)]
    resolution = (1e-5, 0.0)[number // len(CAUSES) % 2]
    nominal, rng = og.Machine.nominal(), np.random.default_rng([seed, number, 1])
    dial = og.Dial(resolution=resolution, placement=1e-3)
    spec = replace(nominal.spec, dial=dial)
    machine = og.Machine(spec)
    errors = {f"joint_offset.{leg}": float(rng.normal(0, 1e-3)) for leg in "xyz"}
    errors |= {cause: CAUSES[cause]} if cause else {}
    truth = machine.with_parameters(errors)
    found = []
    for noise in NOISES:
        try:
            verdict = og.close_loop(og.simulate(truth, "sweep", noise=noise, seed=number), machine)
            found.append(right(verdict, cause))
        except og.OrthoglideError:
            found.append(False)
    return f"{cause or 'nothing'}, {'rounded' if resolution else 'not rounded'}", found


def turned(found: list[bool | None]) -> bool:
    """Whether a better dial gave a wrong verdict after a right one."""
    first = found.index(True) if True in found else len(found)
    return False in found[first:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--descents", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    words = Counter(large(k, given.seed) for k in range(given.machines))
    print(f"{given.machines} machines with offsets and lengths of up to ten tolerances alone:")
    for word, count in words.most_common():
        print(f"  {count:4}  {word}")
    print("right (+), wrong (x) or neither (.) at " + ", ".join(f"{n * 1e6:g}" for n in NOISES)
          + " um of noise:", flush=True)  # fmt: skip
    worse = 0
    for k in range(given.descents):
        what, found = descent(k, given.seed)
        signs = "".join({True: "+", False: "x", None: "."}[r] for r in found)
        worse += turned(found)
        print(f"  {signs}  {what}{'  turned wrong' * turned(found)}", flush=True)
    print(f"{worse} of {given.descents} turned wrong by a better dial")


if __name__ == "__main__":
    main()
