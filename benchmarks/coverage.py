"""How often 95 % intervals hold the truth, over simulated campaigns.

    python benchmarks/coverage.py [--campaigns 2000] [--jobs 2] [--seed 0]

Campaigns come from the tests' independent machine, with noise, a rounding dial and dials that stand
somewhat beside their stated places. Three cases: no priors, on a handful of fixed machines; the
tolerances as priors, on machines drawn from them; and the same priors on machines whose every
parameter is three tolerances off, which the priors do not expect.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import orthoglide as og
from tests.rig import LEGS, TOLERANCE, Rig
from tests.rig_campaigns import protocol_rows, simulate

CASES = {
    "a": "no priors, fixed machines",
    "b": "priors, machines drawn from the tolerances",
    "c": "priors, machines three tolerances off",
}
OFFSETS, LENGTHS = ("joint_offset",), ("leg_length",)
# What is free, and over which protocol; without priors all six at once as well as each family.
PLANS = (
    (OFFSETS, "standard"),
    (LENGTHS, "standard"),
    (OFFSETS + LENGTHS, "standard"),
    (OFFSETS + LENGTHS, "sweep"),
)
NAMES = tuple(f"{family}.{leg}" for family in OFFSETS + LENGTHS for leg in LEGS)
FIXED_MACHINES = 5
WITNESSES = 5  # campaigns a case and plan that the general mechanism's programme solves as well
DIAL = og.Dial(resolution=1e-5, repeatability=1e-5, placement=1e-3)


@dataclass(frozen=True)
class Outcome:
    """One campaign.

    Attributes:
        case: a, b or c.
        plan: index into ``PLANS``.
        covered: by parameter, whether its 95 % interval holds the truth.
        scaled: whether lack of fit was seen, so that sigmas were scaled.
        difference: of the general mechanism's result from the reduction's, metres; nan: not run.
    """

    case: str
    plan: int
    covered: dict[str, bool]
    scaled: bool
    difference: float


@cache
def machine() -> og.Machine:
    return og.Machine(og.MachineFile(dial=DIAL))


@cache
def sheet(protocol: str) -> og.Campaign:
    rows = [{**row, "reading_mm": 0.0} for row in protocol_rows(protocol)]
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    return og.Campaign.from_frame(columns, name=protocol, require_readings=False)


def truth(case: str, free: Sequence[str], rng: np.random.Generator, k: int) -> dict[str, float]:
    """Errors of the machine that is measured; what is not free it does not have."""
    if case == "a":  # the same few machines again and again
        rng = np.random.default_rng(k % FIXED_MACHINES)
    size = np.array([TOLERANCE[name.partition(".")[0]] for name in NAMES])
    drawn = rng.standard_normal(len(NAMES))
    values = size * (3 * np.sign(drawn) if case == "c" else drawn)
    return {
        name: float(value)
        for name, value in zip(NAMES, values, strict=True)
        if name.partition(".")[0] in free
    }


def measure(case: str, plan: int, k: int, seed: int) -> Outcome:
    """Simulate one campaign, identify, and look whether the intervals hold the truth."""
    free, protocol = PLANS[plan]
    rng = np.random.default_rng([seed, ord(case), plan, k])
    real = truth(case, free, rng, k)
    rows = simulate(
        Rig(errors=real),
        protocol,
        rng,
        noise=DIAL.repeatability or 0.0,
        resolution=DIAL.resolution,
        placement=DIAL.placement,
    )
    readings = 1e-3 * np.array([row["reading_mm"] for row in rows])
    campaign = sheet(protocol).with_readings(readings)
    found = og.identify(campaign, machine(), free, priors=case != "a", method="reduction")
    covered = {}
    for name, value in real.items():
        low, high = found.interval(name)
        covered[name] = bool(low <= value <= high)
    difference = float("nan")
    if k < WITNESSES:
        witness = og.identify(campaign, machine(), free, priors=case != "a", method="nlp")
        apart = [witness.values[name] - found.values[name] for name in found.names]
        difference = float(np.max(np.abs(apart)))
    return Outcome(case, plan, covered, found.sigma_scale > 1, difference)


def _measure(job: tuple[str, int, int, int]) -> Outcome:
    return measure(*job)


def run(campaigns: int, jobs: int, seed: int = 0) -> list[Outcome]:
    """All cases and plans; ``campaigns`` of each case, spread over the plans."""
    work = [
        (case, plan, k, seed)
        for case in CASES
        for plan in range(len(PLANS))
        for k in range(-(-campaigns // len(PLANS)))
    ]
    if jobs == 1:
        return [_measure(job) for job in work]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(_measure, work, chunksize=25))


def share(outcomes: Sequence[Outcome], family: str = "") -> tuple[float, float]:
    """Intervals that hold the truth, per cent, and the standard error over campaigns."""
    each = [
        np.mean([hit for name, hit in o.covered.items() if name.startswith(family)])
        for o in outcomes
        if any(name.startswith(family) for name in o.covered)
    ]
    if not each:
        return float("nan"), float("nan")
    return 100 * float(np.mean(each)), 100 * float(np.std(each) / np.sqrt(len(each)))


def _cell(value: tuple[float, float]) -> str:
    return f"{'-':>12}" if np.isnan(value[0]) else f"{value[0]:6.1f} +-{value[1]:4.1f}"


def report(outcomes: Sequence[Outcome]) -> str:
    """The table."""
    by: dict[tuple[str, int], list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        by[outcome.case, outcome.plan].append(outcome)
    lines = [f"{'':40}{'campaigns':>10}{'offsets, %':>14}{'lengths, %':>14}{'scaled, %':>11}"]
    for case, title in CASES.items():
        lines.append(f"({case}) {title}")
        for (own, plan), some in by.items():
            if own == case:
                free, protocol = PLANS[plan]
                lines.append(_line(f"    {' + '.join(free)}, {protocol}", some))
        every = [o for o in outcomes if o.case == case]
        pooled, error = share(every)
        lines.append(f"    pooled: {pooled:.2f} % +- {error:.2f} of {len(every)} campaigns")
    apart = [o.difference for o in outcomes if np.isfinite(o.difference)]
    lines.append(
        f"Solved by the analytic reduction; {len(apart)} of the campaigns by the general "
        f"mechanism's programme too:\n"
        f"largest difference of a parameter {max(apart) * 1e3:.1e} mm."
    )
    lines.append(
        "scaled: campaigns whose lack of fit was significant at 1 %, so that sigmas were scaled "
        "and Student's t\ntook the place of the normal; one in a hundred is to be expected."
    )
    return "\n".join(lines)


def _line(name: str, some: Sequence[Outcome]) -> str:
    scaled = 100 * float(np.mean([o.scaled for o in some]))
    cells = "  ".join(_cell(share(some, family)) for family in OFFSETS + LENGTHS)
    return f"{name:40}{len(some):>10}  {cells}{scaled:>11.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=2000, help="of each case")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    began = time.perf_counter()
    print(report(run(options.campaigns, options.jobs, options.seed)))
    print(f"{time.perf_counter() - began:.0f} s on {options.jobs} processes")


if __name__ == "__main__":
    main()
