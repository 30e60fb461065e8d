"""Rows of the independent machine as readings, and readings as a problem takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import orthoglide as og
from orthoglide.fit import Factor, Problem, build_problem, noise_of
from orthoglide.observations.arrays import READING_ARRAYS


def campaign_of(
    rows: Sequence[Mapping[str, Any]], machine: og.Machine | None = None, name: str = "campaign"
) -> og.Campaign:
    """Rows of `tests.rig_campaigns` as a campaign."""
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    spec = None if machine is None else machine.spec
    return og.Campaign.from_frame(columns, name=name, machine_file=spec)


def factor_of(readings: og.Readings, machine: og.Machine, noise: float | None = None) -> Factor:
    """Readings of legs alone or of the tool alone; ``noise`` replaces all that is known of it."""
    _, (rows,) = noise_of([readings], machine.spec, noise)
    factor = Factor.from_readings(readings, machine, rows)
    return factor if noise else factor.with_roughness(machine)


def problem_of(
    machine: og.Machine, tables: Sequence[og.Readings], free: Sequence[str], **options: Any
) -> Problem:
    """The problem of readings of legs as they are, neither checked nor doubted."""
    noise, each = noise_of(tables, machine.spec)
    factors = [Factor.from_readings(t, machine, rows) for t, rows in zip(tables, each, strict=True)]
    return build_problem(machine, factors, free, noise, **options)


def same_readings(one: og.Readings, other: og.Readings) -> bool:
    """Return whether names, setups, labels, moves and all arrays but the lines are equal."""
    return (
        (one.name, one.setups, one.posture) == (other.name, other.setups, other.posture)
        and np.array_equal(one.moves.command, other.moves.command)
        and np.array_equal(one.moves.order, other.moves.order)
        and all(
            np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True)
            for name in READING_ARRAYS
            if name != "line"
        )
    )
