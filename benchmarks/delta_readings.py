"""What instruments read of a simulated delta: tables of rows that the package reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import orthoglide as og
from benchmarks.public import tool_campaign
from tests.rig_delta import DeltaRig

Array = NDArray[np.float64]

INSTRUMENTS: dict[str, tuple[str, ...]] = {
    "probe": ("plate",),
    "probe and distances": ("plate", "distance"),
    "probe and level": ("plate", "incline"),
    "tool coordinates": ("tcp",),
}
SEEN = {
    "seven heights": ("seven",),
    "mesh": ("plate",),
    "mesh, distances": ("plate", "distance"),
    "mesh, level": ("plate", "incline"),
    "tool coordinates": ("tcp",),
}
"""What the firmware's own calibration reads, and what else there is."""

NOISE = {"plate": 1.8e-5, "distance": 5e-5, "incline": 2e-5, "tcp": 1e-5}
"""Standard deviation of one reading, metres or radians: a probe's touch and a calliper's distance
as owners repeat them, a level of 0.02 mm a metre, a measuring arm's best."""

PROBED = (0.95, 0.90, 0.85, 0.70, 0.75, 0.80)
"""Radii of a firmware's own seven points over its calibration radius; on rays at 90, 150 ...
degrees, with one in the centre."""

_REACH, _ROUND = 0.12, 0.09


def _spots(kind: str) -> tuple[Array, Array | None]:
    """Places ``(n, 3)`` and, of distances, the others."""
    t = np.arange(12) * np.pi / 6
    ring = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    if kind == "seven":  # one in the centre, and one on a ray every 60 degrees
        t, ring = np.deg2rad(90.0 + 60.0 * np.arange(6)), _REACH * np.array(PROBED)
        around = np.stack([ring * np.cos(t), ring * np.sin(t), 0 * t], axis=1)
        return np.concatenate([np.zeros((1, 3)), around]), None
    if kind == "plate":
        side = np.linspace(-_REACH, _REACH, 9)
        grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= _REACH * (1 + 1e-9)]
        return np.column_stack([grid, np.zeros(len(grid))]), None
    if kind == "distance":  # neighbours, every other one, opposites; both widths taken off
        ends = [(a, (a + k) % 12) for k in (2, 4, 6) for a in range(0, 12, 1 if k < 6 else 2)]
        one, other = np.array(ends).T
        return _ROUND * ring[one], _ROUND * ring[other]
    if kind == "incline":
        return np.concatenate([np.zeros((1, 3)), _REACH * ring]), None
    high = np.array([0.0, 0.0, 0.06])
    return np.concatenate([_REACH * ring, _REACH / 2 * ring + high, _REACH * ring + 2 * high]), None


def measured(
    rig: DeltaRig,
    rng: np.random.Generator | None = None,
    *,
    machine: og.Machine,
    instrument: str,
) -> og.Readings:
    """A campaign of one set of instruments.

    Args:
        rig: the machine.
        rng: of noise and nuisances; exact readings without.
        machine: nominal.
        instrument: of `INSTRUMENTS` or `SEEN`.
    """
    rows: list[dict[str, str]] = []
    for kind in (INSTRUMENTS | SEEN)[instrument]:
        rows += _rows(kind, rig, rng, machine)
    columns = list(dict.fromkeys(name for row in rows for name in row))
    full = [{name: row.get(name, "") for name in columns} for row in rows]
    return tool_campaign(full, machine)


def commands_of(kind: str, rig: DeltaRig) -> list[Array]:
    """Return the commands ``(n, 3)`` of all places that an instrument reads; of distances twice."""
    return [np.array([rig.inverse(p) for p in at]) for at in _spots(kind) if at is not None]


def exact(kind: str, rig: DeltaRig, poses: Sequence[Sequence[tuple[Array, Array]]]) -> Array:
    """Return what an instrument reads without noise or nuisances ``(n,)``, metres or radians.

    Args:
        kind: of the instrument.
        rig: for its plate.
        poses: tool and rotation vector at every place; of distances at both ends.
    """
    first = poses[0]
    if kind in ("plate", "seven"):
        return np.array([p[2] - rig.plate(p[0], p[1], _REACH) for p, _ in first])
    if kind == "distance":
        pairs = zip(first, poses[1], strict=True)
        return np.array([np.linalg.norm(other[0] - one[0]) for one, other in pairs])
    if kind == "incline":
        return np.array([turn[axis] for _, turn in first for axis in (0, 1)])
    return np.array([p[axis] for p, _ in first for axis in (0, 1, 2)])


def nuisances(kind: str, value: Array) -> tuple[Array, Array]:
    """Return columns of an instrument's nuisances, free ``(n, q)`` and at one standard deviation of
    their prior ``(n, k)``: a plate's height and slopes; a part's shrinkage and the width of its
    pillars; the datums of a level; the frame of a tracker.
    """
    places = _spots(kind)[0]
    none = np.zeros((len(value), 0))
    if kind in ("plate", "seven"):
        return np.column_stack([np.ones(len(places)), places[:, :2]]), none
    if kind == "distance":
        return none, np.column_stack([0.01 * value, np.full(len(value), 2e-4)])
    count = 2 if kind == "incline" else 3
    datums = np.tile(np.eye(count), (len(places), 1))
    if kind == "incline":
        return datums, none
    turns = np.stack([np.cross(e, places).ravel() for e in np.eye(3)], axis=1)
    return np.hstack([datums, turns]), none


def _rows(
    kind: str, rig: DeltaRig, rng: np.random.Generator | None, machine: og.Machine
) -> list[dict[str, str]]:
    """Return what an instrument reads, noise and nuisances with it if there is a generator."""
    ends = [p for p in _spots(kind) if p is not None]
    commands = [machine.inverse(p) for p in ends]
    poses = [[rig.pose(s, p) for s, p in zip(*each, strict=True)]
             for each in zip(commands, ends, strict=True)]  # fmt: skip
    value = exact(kind, rig, poses)
    kind = "plate" if kind == "seven" else kind
    tool = np.array([p for p, _ in poses[0]])
    if rng is not None:
        tilt, shrunk = rng.normal(0, 1e-3, 3), 1 + rng.normal(0, 2e-3)
        if kind == "distance":
            value = shrunk * value
        else:
            along = {"plate": -tool[:, :2] @ tilt[:2], "incline": np.tile(tilt[:2], len(tool)),
                     "tcp": np.cross(tilt, tool).ravel()}  # fmt: skip
            value = value + along[kind]
        value = value + NOISE[kind] * rng.standard_normal(len(value))
    axes = len(value) // len(tool)
    unit = "reading_mrad" if kind == "incline" else "reading_mm"
    rows = []
    for k, v in enumerate(value):
        row = {"kind": kind, "setup": {"plate": "bed"}.get(kind, kind)}
        row |= {"direction": "xyz"[k % axes]} if axes > 1 else {}
        for legs, at in zip((("a", "b", "c"), ("a2", "b2", "c2")), commands, strict=False):
            row |= {f"travel_{n}_mm": f"{s * 1e3:.9f}"
                    for n, s in zip(legs, at[k // axes], strict=True)}  # fmt: skip
        rows.append(row | {unit: f"{v * 1e3:.9f}"})
    return rows
