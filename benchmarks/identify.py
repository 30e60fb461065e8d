"""How long an identification takes, every way this package has, side by side in one run.

    python benchmarks/identify.py [--rounds 5]

All rows of a block solve the same problem (offsets and lengths with the tolerances as priors) from
the nominal machine to the same minimum. Rounds over all ways follow each other, so that a busy
computer disturbs all alike; the median round is shown.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import importlib.util
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from orthoglide import reduction
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Problem, assemble
from orthoglide.fit.crosscheck import by_reduction
from orthoglide.fit.gauss_newton import solve_nested
from orthoglide.fit.least_squares import Nuisances, linearise, normal_equations, nuisances
from orthoglide.fit.nlp import solve_programme
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, read_campaign
from orthoglide.planning import next_measurements
from tests.rig import Rig
from tests.rig_campaigns import protocol_rows, simulate

ERRORS = {
    "joint_offset.x": -5e-4, "joint_offset.y": 6e-4, "joint_offset.z": -1.7e-3,
    "leg_length.x": 3e-5, "leg_length.y": -4e-5, "leg_length.z": 2e-5,
}  # fmt: skip
RIVALS = ("axis_tilt.y.z", "axis_offset.y.z", "rail_bow.y.z", "encoder_scale.y")
SAME = 1e-9  # metres, between all ways of solving one problem


@dataclass(frozen=True)
class Row:
    """One way of solving one problem: its name and the median time, seconds."""

    problem: str
    way: str
    seconds: float


def campaign(rows: list[dict[str, object]], name: str) -> Campaign:
    return Campaign.from_frame({key: [row[key] for row in rows] for key in rows[0]}, name=name)


def problems(machine: Machine) -> Iterator[tuple[str, Problem]]:
    """Problems of 12, 18 and about 250 readings."""
    rng, rig = np.random.default_rng(0), Rig(errors=ERRORS)
    standard = [row for row in protocol_rows("standard") if row["repeat"] == 1]
    for name, rows in {
        "12 readings": [row for row in standard if row["posture"] != "zero"],
        "18 readings": standard,
        "252 readings": protocol_rows("sweep"),
    }.items():
        yield name, posed(machine, campaign(simulate(rig, rows, rng), name.replace(" ", "-")))


def posed(machine: Machine, measured: Campaign) -> Problem:
    return assemble(measured, machine, ["joint_offset", "leg_length"])


def random_campaign(count: int) -> Campaign:
    """As many readings, each at a posture of its own somewhere in the stroke."""
    rng = np.random.default_rng(count)
    one_each = {row["setup"]: row for row in protocol_rows("standard")}
    rho = rng.uniform(210.25, 370.25, (count, 3)).round(6)
    axes = ("rho_x_mm", "rho_y_mm", "rho_z_mm")
    rows = [
        {**setup, **dict(zip(axes, map(float, command), strict=True)), "order": k, "time_s": k}
        for k, (setup, command) in enumerate(
            zip((list(one_each.values()) * count)[:count], rho, strict=True)
        )
    ]
    return campaign(simulate(Rig(errors=ERRORS), rows, rng), f"random-{count}")


def by_scipy(problem: Problem, nuisance: Nuisances) -> Array:
    """The reduction's readings and Jacobian handed to scipy's trust region."""
    data = problem.campaigns[0]
    setups = [data.setups[k] for k in data.setup]
    legs, axes = np.array([s.leg for s in setups]), np.array([s.axis for s in setups])
    gauges = np.array([s.gauge for s in setups])

    def rows(six: Array) -> Array:
        shown = reduction.predict_readings(
            data.command, legs, axes, gauges, six[:3], six[3:]
        ).values
        return np.append(nuisance.project(problem.measured - shown), six / problem.tolerance)

    def slopes(six: Array) -> Array:
        by_six = reduction.predict_readings(
            data.command, legs, axes, gauges, six[:3], six[3:]
        ).gradient
        return np.vstack([-nuisance.project(by_six), np.diag(1 / problem.tolerance)])

    exact = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
    found = least_squares(rows, np.zeros(6), slopes, x_scale=problem.tolerance, **exact)
    return np.asarray(found.x)


def ways(problem: Problem) -> dict[str, Callable[[], Array]]:
    """Every way of solving a problem once."""
    first = linearise(problem, problem.start)
    nuisance = nuisances(problem, first.reading_poses)
    initial = normal_equations(problem, first, nuisance)

    def nested(predicted: Problem) -> Array:
        return solve_nested(predicted, nuisance, linearise(predicted, first.x))[0].x

    return {
        "programme over the mechanism": lambda: solve_programme(problem, nuisance, initial)[0],
        "mechanism nested": lambda: nested(problem),
        "reduction, nested": lambda: nested(by_reduction(problem)),
        "reduction, scipy.optimize.least_squares": lambda: by_scipy(problem, nuisance),
    }


def timed(call: Callable[[], object], rounds: int) -> float:
    seconds = []
    for _ in range(rounds):
        began = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def small(machine: Machine, rounds: int) -> Iterator[Row]:
    for name, problem in problems(machine):
        chosen = ways(problem)
        found = {way: solve() for way, solve in chosen.items()}  # also warms up
        reference = found["reduction, nested"]
        for way, x in found.items():
            apart = float(np.max(np.abs(x - reference)))
            if apart > SAME:
                raise SystemExit(f"{name}: {way} is {apart * 1e3:.1e} mm from the reduction")
        seconds: dict[str, list[float]] = {way: [] for way in chosen}
        for _ in range(rounds):
            for way, solve in chosen.items():
                seconds[way].append(timed(solve, 1))
        for way, each in seconds.items():
            yield Row(name, way, float(np.median(each)))
        data = problem.campaigns[0]
        whole = timed(lambda data=data: identify(data, machine), rounds)
        yield Row(name, "identify(): solved, verified, cross-checked, scored", whole)


def large(machine: Machine, rounds: int) -> Iterator[Row]:
    for count in (2_500, 10_000):
        data = random_campaign(count)
        name = f"{count} readings, {count} postures"
        began = time.perf_counter()
        identify(data, machine)
        yield Row(name, "identify(), the first time", time.perf_counter() - began)
        again = timed(lambda data=data: identify(data, machine), rounds)
        yield Row(name, "identify(), again", again)


def following(rounds: int) -> Iterator[Row]:
    """What to measure next, between rivals that the readings cannot decide."""
    rig = ROOT / "tests" / "data" / "rig"
    machine = Machine.load(rig / "machine.toml")
    readings = read_campaign(rig / "rig-3.csv", machine.spec)
    base = ("joint_offset", "leg_length")
    fits = [identify(readings, machine, [*base, name]) for name in RIVALS]
    rivals = [(name, fit.problem.values(0, fit.x)) for name, fit in zip(RIVALS, fits, strict=True)]
    next_measurements(fits[0], rivals)  # compiles what it needs
    seconds = timed(lambda: next_measurements(fits[0], rivals), rounds)
    yield Row(f"{len(readings)} readings, four rivals", "next_measurements()", seconds)


def processes(rounds: int) -> Iterator[Row]:
    """Whole processes."""
    python = [sys.executable, "-c", "import orthoglide"]
    bare = timed(lambda: _ran([sys.executable, "-c", "pass"]), rounds)
    yield Row("process", "python alone", bare)
    yield Row("process", "import orthoglide", timed(lambda: _ran(python), rounds))
    if importlib.util.find_spec("orthoglide.__main__") is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        numbers = iter(range(1000))
        readings = str(files("orthoglide") / "data" / "experiment2.csv")

        def command() -> None:
            out = str(Path(folder) / f"run-{next(numbers)}")
            _ran([sys.executable, "-m", "orthoglide", "identify", readings, "--out", out])

        yield Row("process", "orthoglide identify on Experiment 2", timed(command, rounds))


def _ran(command: list[str]) -> None:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed: {done.stderr.strip()}")


def scaled(seconds: float) -> str:
    return f"{seconds:9.2f} s" if seconds >= 1 else f"{seconds * 1e3:9.2f} ms"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    machine = Machine.nominal()
    before = ""
    rounds = options.rounds
    few = max(1, rounds // 3)
    blocks = (small(machine, rounds), large(machine, few), following(few), processes(rounds))
    for rows in blocks:
        for row in rows:
            if row.problem != before:
                print(f"\n{row.problem}")
                before = row.problem
            print(f"  {row.way:54}{scaled(row.seconds)}", flush=True)


if __name__ == "__main__":
    main()
