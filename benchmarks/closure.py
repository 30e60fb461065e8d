"""How fast the loops close: every way this package has, beside MuJoCo, in one run.

    python benchmarks/closure.py

All rows solve random commands of the stroke of the same machine, on one thread. Rounds over all
rows follow each other, so that a busy computer disturbs all alike; a row shows the median round.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from orthoglide import reduction
from orthoglide.effects import CATALOGUE
from orthoglide.geometry import Geometry
from orthoglide.layout import LinearDelta
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.batch import BatchClosure
from orthoglide.prediction import Conditions, Model

Array = NDArray[np.float64]
ROUNDS = 7
YARDSTICKS = ("MuJoCo, PRPaR legs", "MuJoCo, six bars")


@dataclass
class Row:
    """One way of closing the loops.

    Attributes:
        name: what it is.
        start: where Newton's method starts from.
        count: postures of one call.
        call: solves them.
        rounds: seconds of each round.
    """

    name: str
    start: str
    count: int
    call: Callable[[], object]
    rounds: list[float]

    @property
    def microseconds(self) -> float:
        """Median time of one posture."""
        return 1e6 * float(np.median(self.rounds)) / self.count


def commands(geometry: Geometry, n: int) -> Array:
    """Random commands of the stroke ``(n, 3)``."""
    return geometry.L + np.random.default_rng(0).uniform(*geometry.stroke, (n, 3))


def rows(geometry: Geometry) -> list[Row]:
    """Everything that is measured, built and warmed up."""
    found: list[Row] = []

    def add(name: str, start: str, count: int, call: Callable[[], object]) -> None:
        call()
        found.append(Row(name, start, count, call, []))

    many = commands(geometry, 100_000)
    add("analytic reduction, batch", "none", len(many), lambda: reduction.forward(many))
    for with_compiler in (False, True):
        _add_single(geometry, add, with_compiler)
        _add_batches(geometry, add, with_compiler)
    _add_mujoco(geometry, add)
    return found


def _add_single(geometry: Geometry, add: Callable[..., None], with_compiler: bool) -> None:
    mechanism, rho = Mechanism(geometry, compile=with_compiler), commands(geometry, 200)
    if with_compiler and not mechanism.batch.compiled:
        return
    moves = 3e-3 * np.random.default_rng(1).standard_normal((len(rho), 3, 10))
    near = [mechanism.close(r + 1e-3) for r in rho]
    pairs = list(zip(rho, near, strict=True))
    displaced = list(zip(rho, moves, strict=True))
    one = f"one posture, {'C compiler' if with_compiler else 'Pinocchio'}"
    add(f"{one}, relieved legs", "cold", 200, lambda: [mechanism.close(r) for r in rho])
    add(
        f"{one}, relieved legs",
        "1 mm off",
        200,
        lambda: [mechanism.close(r, guess=g) for r, g in pairs],
    )
    add(
        f"{one}, all virtual joints",
        "cold",
        200,
        lambda: [mechanism.close(r, m) for r, m in displaced],
    )
    if not with_compiler:
        rigid = lambda: [mechanism.close(r, legs="rigid") for r in rho]  # noqa: E731
        add(f"{one}, rigid legs", "cold", 200, rigid)


def _add_batches(geometry: Geometry, add: Callable[..., None], with_compiler: bool) -> None:
    model = Model(geometry, 0.02, compile=with_compiler)
    mechanism = model.mechanism
    if with_compiler and not mechanism.batch.compiled:
        return
    how = "C compiler" if with_compiler else "no compiler"
    rho = commands(geometry, 4000)
    moves = 3e-3 * np.random.default_rng(1).standard_normal((len(rho), 3, 10))
    rigid, general = mechanism.given(rho)[:, :3].copy(), mechanism.given(rho, moves)
    batch, nominal = mechanism.batch, mechanism.nominal_batch
    add(f"batch, rigid legs, {how}", "cold", len(rho), lambda: nominal.close(rigid))
    add(f"batch, relief and virtual joints, {how}", "cold", len(rho), lambda: batch.close(general))
    delta = Mechanism(_delta(), compile=with_compiler)
    rods = delta.given(delta.inverse(_on_plate(4000)), moves / 10)
    name = "batch, all virtual joints, linear delta"
    add(f"{name}, {how}", "cold", len(rods), lambda: delta.batch.close(rods))
    closed, part = batch.close(general[:1000]), general[:1000]
    add(
        f"tangent by 33 joints, closed batch, {how}",
        "closed",
        1000,
        lambda: batch.tangent(closed, part),
    )
    values = {"joint_offset.x": 1e-3, "axis_tilt.y.z": 1e-3}
    for count, name in ((1000, "batch"), (1, "one posture")):
        seen = Conditions.at(rho[:count])
        add(
            f"closure and {len(CATALOGUE.parameters)} sensitivities, {name}, {how}",
            "cold",
            count,
            lambda seen=seen: model.sensitivities(values, seen, CATALOGUE.parameters),
        )


def _delta() -> Geometry:
    """A printer of common size."""
    return Geometry(0.3455, 0.05, 0.032, (-0.17, 0.43), LinearDelta((0.195,) * 3))


def _on_plate(count: int) -> Array:
    """Points above the plate ``(count, 3)``, metres."""
    r, turn, z = np.random.default_rng(0).random((3, count))
    r, turn = 0.13 * np.sqrt(r), 2 * np.pi * turn
    return np.stack([r * np.cos(turn), r * np.sin(turn), 0.15 * z], axis=1)


def _add_mujoco(geometry: Geometry, add: Callable[..., None]) -> None:
    try:
        from tests.mujoco_machine import Dimensions, MujocoMachine, prpar_mjcf, six_bar_mjcf
    except ImportError:
        return
    rho = commands(geometry, 200)
    size = Dimensions(geometry.L, geometry.d, geometry.r)
    for name, build in zip(YARDSTICKS, (prpar_mjcf, six_bar_mjcf), strict=True):
        machine = MujocoMachine(build(size), geometry.L)
        worst = max(np.abs(machine.pose(r)[0] - reduction.forward(r)).max() for r in rho)
        if not worst < 1e-12:
            raise SystemExit(f"{name} stands {worst:.2g} m from the reduction: nothing to compare")
        add(name, "cold", len(rho), lambda machine=machine: [machine.close(r) for r in rho])


def import_seconds(code: str) -> float:
    """Wall time of a fresh interpreter that runs ``code``, the least of five."""

    def once() -> float:
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
        return time.perf_counter() - begin

    return min(once() for _ in range(5))


def compile_seconds(geometry: Geometry) -> float:
    """Wall time of compiling both trees where the cache has nothing."""
    mechanism = Mechanism(geometry)
    trees = [mechanism.tree, mechanism.nominal_batch.tree]
    begin = time.perf_counter()
    for tree in trees:
        BatchClosure(tree, compile=True)
    return time.perf_counter() - begin


def measure(found: list[Row]) -> None:
    for _ in range(ROUNDS):
        for row in found:
            # A round is long enough for the clock, however short a call is.
            calls = max(1, round(1e-2 / (row.microseconds * 1e-6 * row.count))) if row.rounds else 1
            begin = time.perf_counter()
            for _ in range(calls):
                row.call()
            row.rounds.append((time.perf_counter() - begin) / calls)


def table(found: list[Row]) -> Table:
    yardstick = {row.name: row.microseconds for row in found if row.name in YARDSTICKS}
    shown = Table(title="closure solves, one thread", caption="x: times as fast as MuJoCo's row")
    for heading, justify in (
        ("what", "left"), ("start", "left"), ("batch", "right"), ("us/solve", "right"),
        ("solves/s", "right"), *((f"x {name}", "right") for name in yardstick),
    ):  # fmt: skip
        shown.add_column(heading, justify=justify)  # type: ignore[arg-type]
    for row in found:
        us = row.microseconds
        ratios = [f"{reference / us:.2f}" for reference in yardstick.values()]
        shown.add_row(row.name, row.start, str(row.count), f"{us:.3g}", f"{1e6 / us:,.0f}", *ratios)
    return shown


def main() -> None:
    begin = time.perf_counter()
    console = Console(width=150)
    geometry = Geometry()
    with tempfile.TemporaryDirectory() as cache:
        os.environ["ORTHOGLIDE_CACHE"] = cache
        compiling = compile_seconds(geometry)
        found = rows(geometry)
        measure(found)
        console.print(table(found))
    console.print(f"compiling both trees, once: {compiling:.1f} s")
    bare, whole = import_seconds("pass"), import_seconds("import orthoglide")
    console.print(
        f"python -c 'import orthoglide': {whole:.3f} s wall, of which the interpreter {bare:.3f} s"
    )
    console.print(
        f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores; "
        f"median of {ROUNDS} rounds; {time.perf_counter() - begin:.0f} s in all"
    )


if __name__ == "__main__":
    main()
