"""How fast the loops close: six bars and Pinocchio beside MuJoCo, in one run on one core.

    python benchmarks/closure.py [--markdown]

All rows solve random commands of the stroke of the same machine, on one thread. Rounds over all
rows follow each other, so that a busy computer disturbs all alike; a row shows the median round.
``--markdown`` prints the page ``docs/speed.md``.
"""

# ruff: noqa: E402, E501  (a page of text; the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import orthoglide as og
from orthoglide import reduction
from orthoglide.mechanism.engine import PinocchioEngine, SixBars
from orthoglide.mechanism.mechanism import Mechanism
from orthoglide.mechanism.mjcf import to_mjcf
from orthoglide.mechanism.tree import load
from orthoglide.prediction import Model

Array = NDArray[np.float64]
ROUNDS = 7
GEOMETRY = og.Geometry()

PAGE = """# Speed

To judge whether the closure is fast enough for your use, run `python benchmarks/closure.py --markdown`, which prints this page, on
your own computer, and compare rows of one run. Microseconds a posture on one core:

{table}

{notes}

- *Machine.forward*: commands and parameters in, TCP out; *twenty effects* at their tolerances.
- *Closure object*: its function evaluated in place, without checks.
- *Pinocchio*, *MuJoCo*: Newton's method in Python on the constraint Jacobian of each.
- *All sensitivities*: derivatives by three drives and thirty virtual joints.
- *Compiled*: by the computer's C compiler, once, after 50 000 postures, and kept in a cache (`ORTHOGLIDE_CACHE`). The numbers are
  the same to the last bit.
"""


@dataclass
class Row:
    """One way of closing the loops.

    Attributes:
        name: what it is.
        count: postures of one call.
        call: solves them.
        rounds: seconds of each round.
    """

    name: str
    count: int
    call: Callable[[], object]
    rounds: list[float] = field(default_factory=list)

    @property
    def microseconds(self) -> float:
        """Median time of one posture."""
        return 1e6 * float(np.median(self.rounds)) / self.count


def commands(n: int) -> Array:
    """Random commands of the stroke ``(n, 3)``."""
    return GEOMETRY.L + np.random.default_rng(0).uniform(*GEOMETRY.stroke, (n, 3))


def twenty_effects() -> dict[str, float]:
    """Twenty parameters of drives, rails, mounts and bars at their tolerances."""
    machine = og.Machine.nominal()
    families = ("joint_offset", "leg_length", "axis_tilt", "mount_tilt", "bar_mismatch", "rail_bow")
    names = [str(n) for n in machine.catalogue.parameters if n.effect in families]
    return {name: machine.tolerance(name) for name in names[:20]}


def rows() -> list[Row]:
    """Everything that is measured, built and warmed up."""
    found: list[Row] = []

    def add(name: str, count: int, call: Callable[[], object]) -> None:
        call()
        found.append(Row(name, count, call))

    few, many = commands(200), commands(20_000)
    add("analytic reduction, batch", len(many), lambda: reduction.forward(many))
    effects = twenty_effects()
    for compiled in (True, False):
        model = Model(GEOMETRY, compile=compiled)
        if compiled and not model.engine.compiled:
            continue
        how = "compiled" if compiled else "interpreted"
        for name, values in (("no effect", {}), ("twenty effects", effects)):
            machine = og.Machine.nominal().with_parameters(values)
            machine.__dict__["model"] = model
            forward = machine.forward
            add(f"Machine.forward, one posture, {name}, {how}", 200,
                lambda forward=forward: [forward(rho) for rho in few])  # fmt: skip
            add(f"Machine.forward, batch, {name}, {how}", len(many),
                lambda forward=forward: forward(many))  # fmt: skip
        add_engine(add, model.engine, how)
    add_pinocchio(add, few)
    add_mujoco(add, few)
    return found


def add_engine(add: Callable[..., None], engine: SixBars, how: str) -> None:
    """The closure object alone, and its sensitivities."""
    travel = commands(4000) - GEOMETRY.L
    moves = 1e-3 * np.random.default_rng(1).standard_normal((len(travel), 30))
    (constants, own_travel, own_moves), _, evaluate, _ = engine._close.rows("close").single
    constants[:], each = engine.constants, list(zip(travel[:500], moves[:500], strict=True))

    def bare() -> None:
        for one, displacements in each:
            own_travel[:], own_moves[:] = one, displacements
            evaluate()

    add(f"closure object, one posture, {how}", len(each), bare)
    add(f"closure and all sensitivities, batch, {how}", len(travel),
        lambda: engine.tangent(travel, moves))  # fmt: skip


def add_pinocchio(add: Callable[..., None], few: Array) -> None:
    """The definition, posture by posture."""
    mechanism = Mechanism(GEOMETRY)
    moves = 1e-3 * np.random.default_rng(1).standard_normal((len(few), 3, 10))
    judge = PinocchioEngine(mechanism)
    add("Pinocchio, Mechanism.close", len(few),
        lambda: [mechanism.close(rho, m) for rho, m in zip(few, moves, strict=True)])  # fmt: skip
    add("Pinocchio, closure and all sensitivities", len(few),
        lambda: judge.tangent(few - GEOMETRY.L, moves.reshape(-1, 30)))  # fmt: skip


def add_mujoco(add: Callable[..., None], few: Array) -> None:
    """MuJoCo's constraint Jacobian with a Newton loop in Python, if it is installed."""
    try:
        from tests.mujoco_machine import Dimensions, MujocoMachine, six_bar_mjcf
    except ImportError:
        return
    size = Dimensions(GEOMETRY.L, GEOMETRY.d, GEOMETRY.r)
    legs = to_mjcf(load(GEOMETRY), relief=False)
    named = {"MuJoCo, PRPaR legs": legs, "MuJoCo, six bars": six_bar_mjcf(size)}
    for name, mjcf in named.items():
        machine = MujocoMachine(mjcf, GEOMETRY.L)
        worst = max(np.abs(machine.pose(r)[0] - reduction.forward(r)).max() for r in few)
        if not worst < 1e-12:
            raise SystemExit(f"{name} stands {worst:.2g} m from the reduction: nothing to compare")
        add(name, len(few), lambda machine=machine: [machine.close(r) for r in few])


def measure(found: list[Row]) -> None:
    """Time all rows in turns."""
    for _ in range(ROUNDS):
        for row in found:
            # A round is long enough for the clock, however short a call is.
            calls = max(1, round(1e-2 / (row.microseconds * 1e-6 * row.count))) if row.rounds else 1
            begin = time.process_time()
            for _ in range(calls):
                row.call()
            row.rounds.append((time.process_time() - begin) / calls)


def process_seconds(code: str, environment: dict[str, str] | None = None) -> float:
    """Processor time of a fresh interpreter that runs ``code``, the least of five."""

    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, env=environment)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return min(once() for _ in range(5))


def notes(compiling: float) -> str:
    """Times of whole processes."""
    bare, imported = process_seconds("pass"), process_seconds("import orthoglide")
    first = "import orthoglide as og; og.Machine.nominal().forward([0.30, 0.31, 0.32])"
    return (
        f"Processor time of a fresh process, the least of five: `import orthoglide` "
        f"{imported - bare:.3f} s beyond the interpreter's, up to the end of the first "
        f"`Machine.forward` {process_seconds(first):.2f} s. Compiling, once: {compiling:.1f} s. "
        f"Python {platform.python_version()}, {platform.machine()}."
    )


def table(found: list[Row]) -> str:
    """The rows in Markdown, compiled and interpreted ones beside each other."""
    lines = ["| what | compiled | not compiled |", "|---|---:|---:|"]
    times = {row.name: f"{row.microseconds:.3g}" for row in found}
    plain = (name.removesuffix(", compiled").removesuffix(", interpreted") for name in times)
    for name in dict.fromkeys(plain):
        slow = times.get(f"{name}, interpreted", times.get(name, "-"))
        lines.append(f"| {name} | {times.get(f'{name}, compiled', '-')} | {slow} |")
    return "\n".join(lines)


def compile_seconds() -> float:
    """Processor time of compiling closure and sensitivities where the cache has nothing."""
    mechanism = Mechanism(GEOMETRY)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.process_time()
    SixBars(mechanism, compile=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    children = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.process_time() - begin + children


def main() -> None:
    """Print the table, or the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--markdown", action="store_true", help="the page docs/speed.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        os.environ["ORTHOGLIDE_CACHE"] = cache
        compiling = compile_seconds()
        found = rows()
        measure(found)
        page = PAGE.format(table=table(found), notes=notes(compiling))
    print(page if options.markdown else f"{table(found)}\n\n{notes(compiling)}")


if __name__ == "__main__":
    main()
