"""Readings as a problem takes them: with their noise, and their instruments in place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import orthoglide as og
from orthoglide.fit import Factor, Problem, build_problem, noise_of


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
