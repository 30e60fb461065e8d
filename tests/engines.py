"""Closed postures of both engines, for tests."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np

from orthoglide import urdf
from orthoglide.geometry import Array, Geometry
from orthoglide.layout import LinearDelta
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.engine import Outputs, SixBars
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from tests.rig_delta import DeltaRig

NOMINAL = Geometry()
OTHER = Geometry(L=0.5, d=0.11, r=0.047, stroke=(-0.12, 0.08))
_RIG = DeltaRig()
DELTA = Geometry(
    _RIG.L, _RIG.d, _RIG.r, _RIG.stroke,
    LinearDelta((_RIG.radius,) * 3, _RIG.angles, _RIG.tool),
)  # fmt: skip
"""The linear delta of `tests.rig_delta`."""


@cache
def mechanism(geometry: Geometry = NOMINAL) -> Mechanism:
    """The mechanism of these dimensions, built once."""
    return Mechanism(geometry)


@cache
def six_bars(geometry: Geometry = NOMINAL) -> SixBars:
    """Its six bars, interpreted, built once."""
    return SixBars(mechanism(geometry), compile=False)


def given(
    rho: Array, moves: Array | None = None, geometry: Geometry = NOMINAL
) -> tuple[Array, Array]:
    """Travel ``(n, 3)`` and displacements ``(n, 30)``, of arguments of any shape."""
    travel = (np.asarray(rho) - geometry.zero).reshape(-1, 3)
    count = 3 * len(VIRTUAL_NAMES)
    if moves is None:
        return travel, np.zeros((len(travel), count))
    return travel, np.broadcast_to(np.reshape(moves, (-1, count)), (len(travel), count)).copy()


def outputs(rho: Array, moves: Array | None = None, geometry: Geometry = NOMINAL) -> Outputs:
    """What postures show by six bars, in one row each."""
    return six_bars(geometry).outputs(*given(rho, moves, geometry))


def forward(rho: Array, moves: Array | None = None, geometry: Geometry = NOMINAL) -> Array:
    """TCP by six bars, shaped as the commands ``(..., 3)``."""
    return outputs(rho, moves, geometry).p.reshape(np.shape(rho))


def commands(n: int, seed: int = 0, geometry: Geometry = NOMINAL) -> Array:
    """Random commands of the stroke ``(n, 3)``."""
    return geometry.zero + np.random.default_rng(seed).uniform(*geometry.stroke, (n, 3))


def displacements(n: int, seed: int = 0, size: float = 3e-3) -> Array:
    """All virtual joints displaced ``(n, 3, 10)``, metres and radians."""
    return size * np.random.default_rng(seed).standard_normal((n, 3, len(VIRTUAL_NAMES)))


def edited(folder: Path, joint: str, xyz: str, rpy: str = "") -> Path:
    """A copy of the shipped files in which one joint's origin is another."""
    urdf.write(folder)
    path = folder / urdf.URDF_FILE
    head = rf'(<joint name="{joint}"[^>]*>\s*<origin xyz=")[^"]*(" rpy=")([^"]*)'
    text, count = re.subn(
        head, lambda m: f"{m[1]}{xyz}{m[2]}{rpy or m[3]}", path.read_text(encoding="utf-8")
    )
    assert count == 1
    path.write_text(text, encoding="utf-8")
    return folder
