"""How fast the elastic equilibrium is found, beside the closure with relief joints, in one run.

    python benchmarks/elastic.py

All rows take the same random commands of the stroke, on one thread: a load at the TCP, legs of
known torsional stiffness, and every error of the catalogue drawn at its tolerance, or all virtual
joints displaced by 3 mm and mrad. Everything starts from the assembled machine at mechanical zero.
"""

from __future__ import annotations

import os
import tempfile
import time

from closure import ROUNDS, Row, commands, measure  # sets the threads before numpy is imported

# isort: split
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from orthoglide.effects import CATALOGUE
from orthoglide.geometry import Geometry
from orthoglide.machine_file import Stiffness
from orthoglide.mechanism.elastic import RELIEF_LIMIT, relief_angles
from orthoglide.prediction import Conditions, Model

Array = NDArray[np.float64]
STIFFNESS = Stiffness(torsion=1e4, bar=5e7)
LOAD = 100.0
COUNT = 4000


def conditions(geometry: Geometry) -> Conditions:
    return Conditions.at(commands(geometry, COUNT), warming=2.0, load=LOAD)


def at_tolerance(seed: int = 1) -> dict[str, float]:
    """Every parameter of the machine drawn at its tolerance, SI."""
    rng = np.random.default_rng(seed)
    return {
        name: CATALOGUE.effect_of(name).tolerance_si * rng.standard_normal()
        for name in CATALOGUE.parameters
    }


def inputs(model: Model) -> dict[str, Array]:
    """What is given of the postures ``(n, 34)``, by the size of the errors."""
    seen = conditions(model.geometry)
    far = 3e-3 * np.random.default_rng(1).standard_normal((COUNT, 3, 10))
    moves = {"at tolerance": model.displacements(at_tolerance(), seen), "3 mm, mrad": far}
    return {
        name: np.column_stack([model.mechanism.given(seen.command, m), seen.load])
        for name, m in moves.items()
    }


def rows(geometry: Geometry) -> list[Row]:
    """Everything that is measured, built and warmed up; ``start`` tells the errors."""
    found: list[Row] = []
    for with_compiler in (False, True):
        model = Model(geometry, 0.02, stiffness=STIFFNESS, compile=with_compiler)
        if with_compiler and not model.elastic.compiled:
            continue
        how = "C compiler" if with_compiler else "no compiler"
        for name, given in inputs(model).items():
            _add(found, model, given, name, how)
    for row in found:
        row.call()
    return found


def _add(found: list[Row], model: Model, given: Array, errors: str, how: str) -> None:
    elastic, relief = model.elastic, model.mechanism.batch
    bare, part = given[:, :33].copy(), given[:1000]
    ones = [(given[k : k + 1], bare[k : k + 1]) for k in range(100)]
    closed, loose = elastic.close(part), relief.close(bare[:1000])

    def add(name: str, count: int, call: object) -> None:
        found.append(Row(f"{name}, {how}", errors, count, call, []))  # type: ignore[arg-type]

    add("relief closure, single", len(ones), lambda: [relief.close(b) for _, b in ones])
    add("elastic equilibrium, single", len(ones), lambda: [elastic.close(g) for g, _ in ones])
    add("relief closure, batch", COUNT, lambda: relief.close(bare))
    add("elastic equilibrium, batch", COUNT, lambda: elastic.close(given))
    add("tangent of the relief closure", 1000, lambda: relief.tangent(loose, bare[:1000]))
    add("tangent of the equilibrium", 1000, lambda: elastic.tangent(closed, part))
    add("deformation and forces", 1000, lambda: elastic.deformation(closed, part))


def table(found: list[Row]) -> Table:
    shown = Table(title=f"{LOAD:g} N, {STIFFNESS.torsion:g} N m/rad, {STIFFNESS.bar:g} N/m")
    for heading in ("what", "errors", "us a posture"):
        shown.add_column(heading, justify="right" if heading.startswith("us") else "left")
    for row in found:
        shown.add_row(row.name, row.start, f"{row.microseconds:.1f}")
    return shown


def strained(geometry: Geometry) -> str:
    """How far legs twist when every error is at its tolerance, against what counts as too far."""
    model = Model(geometry, 0.02, compile=False)
    worst = []
    for seed in range(200):
        seen = Conditions.at(commands(geometry, seed + 1)[-1:], warming=2.0)
        closure, given = model.closing(at_tolerance(seed), seen)
        worst.append(np.abs(relief_angles(closure.tree, closure.close(given))).max())
    rms = float(np.sqrt(np.mean(np.square(worst))))
    return (
        f"errors at tolerance twist the worst leg by {np.rad2deg(rms):.2f} degrees rms, "
        f"{np.rad2deg(max(worst)):.2f} at most of {len(worst)}; "
        f"the limit is {np.rad2deg(RELIEF_LIMIT):g}"
    )


def compile_seconds(geometry: Geometry) -> float:
    """Wall time of compiling the equilibrium where the cache has nothing; 0 without a compiler."""
    model = Model(geometry, stiffness=STIFFNESS, compile=False)
    begin = time.perf_counter()
    model.elastic._compile(build=True)
    return time.perf_counter() - begin if model.elastic.compiled else 0.0


def main() -> None:
    begin = time.perf_counter()
    console, geometry = Console(width=120), Geometry()
    with tempfile.TemporaryDirectory() as cache:
        os.environ["ORTHOGLIDE_CACHE"] = cache
        compiling = compile_seconds(geometry)
        found = rows(geometry)
        measure(found)
        console.print(table(found))
    console.print(f"compiling the equilibrium, once: {compiling:.1f} s")
    console.print(strained(geometry))
    console.print(f"median of {ROUNDS} rounds; {time.perf_counter() - begin:.0f} s in all")


if __name__ == "__main__":
    main()
