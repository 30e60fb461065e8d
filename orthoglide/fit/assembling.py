"""Problems put together from what a user gives: readings or their paths, and what is free."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, get_args

import numpy as np

from orthoglide.errors import InputError, check_list, check_word
from orthoglide.fit.factors import Factor, beliefs_of
from orthoglide.fit.noise import noise_of, overall
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknowns import build_problem
from orthoglide.instruments import Frame
from orthoglide.machine import Machine
from orthoglide.observations import Given, Readings, check_given, parts, read_readings, read_tcp

_FEWEST_POINTS = 3  # of the tool: a point's three coordinates decide about its place at most


def assemble(
    given: Readings | Sequence[Readings],
    machine: Machine,
    free: Sequence[str],
    *,
    own: Sequence[str] = (),
    priors: bool = True,
    noise: float | None = None,
    bounds: Mapping[str, float] | None = None,
    frame: Frame = "rigid",
) -> Problem:
    """Return the problem of readings of all kinds together; arguments as of ``og.identify``, but
    readings that were read and checked.
    """
    check_word("frame", frame, get_args(Frame))
    check_list("free", free)
    check_list("own", own)
    tables = sorted((p for one in _listed(given) for p in parts(one)), key=lambda t: t.of_tool)
    beliefs = beliefs_of(machine, frame)
    level, noises = noise_of(tables, machine.spec, noise)
    told = noise is not None and all(t.of_tool for t in tables)
    factors = []
    for table, rows in zip(tables, noises, strict=True):
        if table.by_point and len(table.points().p) < _FEWEST_POINTS:
            raise InputError(
                f"{table.name}: these are too few TCP points to identify anything: measure three "
                f"or more"
            )
        factor = Factor.of(table, machine, rows, beliefs)
        factor = factor if told else factor.with_roughness(machine)
        factors.append(factor.without_outlying_touches(machine))
    if all(t.of_tool for t in tables):
        rated = overall([f.readings for f in factors], [f.noise.total for f in factors])
        level = replace(level, typical=rated)
    known = machine.posterior  # an earlier calibration says nothing where its file gives no sigmas
    return build_problem(
        machine, factors, free, level, own=own, priors=priors, bounds=bounds,
        earlier=known if priors and np.diag(known.covariance).any() else None,
    )  # fmt: skip


def sorted_out(
    given: Given | Sequence[Given], machine: Machine
) -> tuple[tuple[Readings, ...], tuple[Readings, ...]]:
    """Return readings of legs, and of the tool apart; paths are read.

    Raises:
        InputError: where there is neither, or a file cannot be read.
    """
    read = read_given(given, machine)
    legs = tuple(r for r in read if not r.of_tool)
    return legs, tuple(r for r in read if r.of_tool)


def readings_of(given: Given | Sequence[Given], machine: Machine) -> tuple[Readings, ...]:
    """Return readings of any kinds; paths are read.

    Raises:
        InputError: as :func:`sorted_out`, and for files with a row a point.
    """
    read = read_given(given, machine)
    if any(r.by_point for r in read):
        raise InputError("TCP points are no campaign of readings: give them as tcp")
    return tuple(read)


def points_of(given: Given, machine: Machine) -> Readings:
    """Return points of the tool to judge by; a path is read.

    Raises:
        InputError: for readings of another kind, and points that cannot be meant.
    """
    if isinstance(given, str | PathLike):
        return read_tcp(given, machine.spec)
    if not isinstance(given, Readings) or not given.by_point:
        raise InputError(
            f"a {type(given).__name__} holds no TCP points: give those of og.read_tcp, or the path "
            f"of one file of them; readings of another kind judge as holdout"
        )
    check_given(given, machine.spec)
    return given


def read_given(given: Given | Sequence[Given], machine: Machine) -> list[Readings]:
    """Return tables of what was given; paths are read.

    Raises:
        InputError: where nothing was given, or a file cannot be read.
    """
    read: list[Readings] = []
    for one in _listed(given):
        if isinstance(one, str | PathLike):
            read += read_readings(one, machine.spec)
        else:
            check_given(one, machine.spec)
            read += parts(one)
    if not read:
        raise InputError("there is no campaign: give at least one file of readings")
    return read


def _listed(given: Any) -> list[Any]:
    """One or several as a list; a path is one, and so is a data frame, which is none of them."""
    one = isinstance(given, str | Mapping) or hasattr(given, "columns")
    return [given] if one or not isinstance(given, Iterable) else list(given)
