"""Compare effects, machines and planes of the workspace."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from orthoglide import reduction
from orthoglide.comparison.bench import Bench, Circumstances, cube, fit_tcp, reduced
from orthoglide.comparison.rows import Row
from orthoglide.effects import CATALOGUE, MACHINE_PARAMETERS, elementary, family_of, is_dial
from orthoglide.geometry import Array
from orthoglide.machine import Machine


def compare_effects(
    machine: Machine | None = None,
    names: Iterable[str] | None = None,
    circumstances: Circumstances | None = None,
) -> tuple[Row, ...]:
    """Compare for effects one at a time, each at its tolerance on an else perfect machine.

    Args:
        machine: dimensions and tolerances; its identified parameters are left out.
        names: parameters, families or structured members; the whole catalogue where absent, dials
            by the campaign's first setup.
        circumstances: see there.

    Raises:
        InputError: for a name that is no effect.
    """
    bench = Bench(machine or Machine.nominal(), circumstances or Circumstances())
    plain = bench.machine
    rows = []
    for name in _chosen(names, bench.campaign.setups[0].name):
        value = plain.tolerance(name)
        parts = elementary(name, tuple(s.name for s in bench.campaign.setups))
        rows.append(bench.row(name, value, {n: w * value for n, w in parts.items()}))
    return tuple(rows)


def compare_machine(
    machine: Machine, circumstances: Circumstances | None = None
) -> tuple[Row, ...]:
    """Compare for a calibrated machine: all of its parameters together, then each alone.

    Returns:
        Row ``"machine"`` first, then one for every parameter that is not zero.
    """
    bench = Bench(machine, circumstances or Circumstances())
    values = {name: value for name, value in machine.values.items() if value}
    alone = (bench.row(name, value, {name: value}) for name, value in values.items())
    return (bench.row("machine", float("nan"), values), *alone)


@dataclass(frozen=True)
class Slice:
    """Difference at the TCP after the fit, on one plane through mechanical zero.

    Attributes:
        normal: base axis across the plane, 0, 1 or 2.
        p: points ``(n, n, 3)``, metres, the other two axes in their order along rows and columns.
        difference: the larger of the two visits' ``(n, n)``, metres.
    """

    normal: int
    p: Array
    difference: Array


def slices(
    machine: Machine, points: int = 41, circumstances: Circumstances | None = None
) -> tuple[Slice, Slice, Slice]:
    """Difference of mechanism and fitted reduction on three planes of the cube.

    Args:
        machine: with its errors.
        points: along each side of a plane.
        circumstances: see there.
    """
    bench = Bench(machine, circumstances or Circumstances())
    values = {name: value for name, value in machine.values.items() if not is_dial(name)}
    found, _ = bench.mechanism(values)
    six = fit_tcp(bench.commands, found, bench.geometry)
    side = np.linspace(*cube(bench.geometry), points)
    planes = []
    for normal in range(3):
        p = np.insert(np.stack(np.meshgrid(side, side, indexing="ij"), -1), normal, 0.0, -1)
        rho = reduction.inverse(p.reshape(-1, 3), geometry=bench.geometry)
        twice = bench.visits(rho)
        apart = bench.model.outputs(values, twice).p - reduced(twice.command, six, bench.geometry)
        size = np.linalg.norm(apart, axis=1).reshape(2, points, points).max(axis=0)
        planes.append(Slice(normal, p, size))
    return planes[0], planes[1], planes[2]


def _chosen(names: Iterable[str] | None, setup: str) -> list[str]:
    if names is None:
        dials = [f"{n}.{setup}" for n, family in CATALOGUE.items() if family.group == "dial"]
        return [*MACHINE_PARAMETERS, *dials]
    found: dict[str, None] = {}
    for name in names:
        family = family_of(name)
        if name != family.name:
            many = [name]
        elif family.group == "dial":
            many = [f"{name}.{setup}"]
        else:
            many = list(family.parameters())
        found.update(dict.fromkeys(many))
    return list(found)
