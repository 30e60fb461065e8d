"""Readings setup by setup, as figures draw them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import LEGS, Array

if TYPE_CHECKING:
    from orthoglide.fit import Problem

_MOVES = 1e-3  # metres of travel from which a setup is drawn over it


@dataclass(frozen=True)
class Mounting:
    """One setup."""

    name: str  # of the setup, its campaign before it where there are several
    title: str  # name, leg and direction
    label: str  # of the scale across
    rows: NDArray[np.intp]  # of all readings (m,)
    x: Array  # travel of the touched leg's carriage in millimetres, or place in the file (m,)
    side: Array  # of the approach of that leg's own axis (m,)
    unit: str  # in which people read it


def mountings(problem: Problem) -> Iterator[Mounting]:
    """All setups of a problem, in their order; of TCP points their coordinates."""
    several = len(problem.campaigns) > 1
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        read = factor.readings
        for k, setup in enumerate(read.setups):
            there = np.flatnonzero(factor.setup == k)
            if not len(there):
                continue
            x, side = np.arange(1.0, len(there) + 1), np.zeros(len(there))
            if setup.leg >= 0:
                leg = setup.leg
                travel = read.command[there, leg] - problem.machine.geometry.zero[leg]
                moves = np.ptp(travel) > _MOVES
                name = _named(read.name, setup.name) if several else setup.name
                title = f"{name}: leg {LEGS[leg]}, read along {setup.direction}"
                label = f"travel of carriage {LEGS[leg]}, mm" if moves else "place in the file"
                x = travel * 1e3 if moves else read.order[there].astype(float)
                side = read.approach[there, leg]
            else:
                name, label = _named(read.name, setup.name), "reading"
                title = f"{name}, {setup.kind}"
            unit = setup.observation.unit
            yield Mounting(name, title, label, part.start + there, x, side, unit)


def _named(file: str, setup: str) -> str:
    """A setup by its file, whose name may have it already."""
    return file if setup in file else f"{file} · {setup}"
