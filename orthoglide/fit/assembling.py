"""Problems put together from what a user gives: readings or their paths, and what is free."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, get_args

import numpy as np

from orthoglide.errors import InputError, check_choice, check_list
from orthoglide.fit.factors import Factor, machine_instrument_priors
from orthoglide.fit.noise import Noise, noise_of, rms_noise
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknowns import NOTHING_FREE, Unknown, build_unknowns, expand_names, with_bounds
from orthoglide.instruments import Frame
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.observations import (
    Readings,
    ReadingsOrPath,
    check_given,
    read_readings,
    read_tcp,
    split_legs_and_tool,
)
from orthoglide.parameters import Parameter, split_campaign

_MIN_POINTS = 3  # of the tool: a point's three coordinates decide about its place at most


def assemble(
    given: Readings | Sequence[Readings],
    machine: Machine,
    free: Sequence[str],
    *,
    per_campaign: Sequence[str] = (),
    priors: bool = True,
    noise: float | None = None,
    bounds: Mapping[str, float] | None = None,
    frame: Frame = "rigid",
) -> Problem:
    """Return the problem of readings of all kinds together; arguments as of ``og.identify``, but
    readings that were read and checked.
    """
    check_choice("frame", frame, get_args(Frame))
    check_list("free", free)
    check_list("own", per_campaign)
    tables = sorted(
        (p for one in _as_list(given) for p in split_legs_and_tool(one)), key=lambda t: t.of_tool
    )
    beliefs = machine_instrument_priors(machine, frame)
    level, noises = noise_of(tables, machine.spec, noise)
    told = noise is not None and all(t.of_tool for t in tables)
    factors = []
    for table, rows in zip(tables, noises, strict=True):
        if table.by_point and len(table.points().p) < _MIN_POINTS:
            raise InputError(
                f"{table.name}: these are too few TCP points to identify anything: measure three "
                f"or more"
            )
        factor = Factor.from_readings(table, machine, rows, beliefs)
        factor = factor if told else factor.with_roughness(machine)
        factors.append(factor.without_outlying_touches(machine))
    if all(t.of_tool for t in tables):
        rated = rms_noise([f.readings for f in factors], [f.noise.total for f in factors])
        level = replace(level, typical=rated)
    known = machine.posterior  # an earlier calibration says nothing where its file gives no sigmas
    return build_problem(
        machine, factors, free, level, per_campaign=per_campaign, priors=priors, bounds=bounds,
        earlier_posterior=known if priors and np.diag(known.covariance).any() else None,
    )  # fmt: skip


def build_problem(
    machine: Machine,
    factors: Sequence[Factor],
    free: Sequence[str],
    noise: Noise,
    *,
    per_campaign: Sequence[str] = (),
    priors: bool = True,
    bounds: Mapping[str, float] | None = None,
    earlier_posterior: Posterior | None = None,
) -> Problem:
    """Put an identification together; arguments as of :func:`identify`, but readings with their
    noise, those of legs first, that noise in one figure, and what an earlier calibration says. What
    is own to each campaign need not be free.

    Raises:
        InputError: where these do not fit together.
    """
    if not factors:
        raise InputError("there is no campaign: give at least one file of readings")
    nothing = Problem(
        machine, tuple(factors), (), noise, priors, (), tuple(per_campaign), earlier_posterior
    )
    stems = [s.name for s in nothing.factors]
    for name in per_campaign:
        plain, stem = split_campaign(name)
        if stem and stem not in stems:
            raise InputError(f"{name}: there is no campaign {stem!r}, only {', '.join(stems)}")
        expand_names(machine.catalogue, [plain], nothing.factors)
    unknowns = build_unknowns(machine, nothing.factors, free, per_campaign)
    if not unknowns:  # all of instruments that none of these readings are of
        raise InputError(NOTHING_FREE)
    if bounds:
        unknowns = with_bounds(unknowns, bounds)
    every = tuple(machine.values for _ in nothing.factors)
    return replace(nothing, unknowns=unknowns, held=_held_values(every, unknowns))


def _held_values(
    held: Sequence[Mapping[str, float]], unknowns: Sequence[Unknown]
) -> tuple[dict[str, float], ...]:
    """Return the values of each factor that no unknown sets, which stay held."""
    free = [{n for u in unknowns for n in u.weights[k]} for k in range(len(held))]
    return tuple(
        {n: v for n, v in values.items() if n not in set_here}
        for values, set_here in zip(held, free, strict=True)
    )


def with_free(problem: Problem, names: Sequence[str], *, release: bool = True) -> Problem:
    """The same problem with more freed; what is free already is not freed twice.

    Args:
        problem: to be extended.
        names: effects, parameters or structured members; with ``@`` only that campaign's.
        release: whether values that were held are let go; else the unknowns are changes of them.

    Returns:
        The problem with the new unknowns behind those that it has.
    """
    present = set(problem.names)
    added: list[Unknown] = []
    for name in names:
        plain, stem = split_campaign(name)
        for unknown in build_unknowns(
            problem.machine, problem.factors, [plain], problem.per_campaign
        ):
            wanted = not stem or unknown.name.campaign in ("", stem)
            if wanted and unknown.name not in present:
                present.add(unknown.name)
                added.append(unknown)
    # With more freed, whether a value is beyond its tolerance is asked anew.
    unknowns = (*problem.with_prior_widths_reset().unknowns, *added)
    held = _held_values(problem.held, unknowns) if release else problem.held
    return replace(problem, unknowns=unknowns, held=held)


def with_effects_freed(problem: Problem, effects: Sequence[str]) -> Problem:
    """The same problem with all single parameters of effects that no unknown sets yet: changes of
    what is held.
    """
    taken = {p for u in problem.unknowns for parts in u.weights for p in parts}
    found: dict[Parameter, None] = {}
    for unknown in build_unknowns(problem.machine, problem.factors, list(effects)):
        if not any(p in taken for parts in unknown.weights for p in parts):
            found[unknown.name.plain] = None
    return with_free(problem, tuple(found), release=False)


def read_legs_and_tool(
    given: ReadingsOrPath | Sequence[ReadingsOrPath], machine: Machine
) -> tuple[tuple[Readings, ...], tuple[Readings, ...]]:
    """Return readings of legs, and of the tool apart; paths are read.

    Raises:
        InputError: where there is neither, or a file cannot be read.
    """
    read = read_tables(given, machine)
    legs = tuple(r for r in read if not r.of_tool)
    return legs, tuple(r for r in read if r.of_tool)


def readings_of(
    given: ReadingsOrPath | Sequence[ReadingsOrPath], machine: Machine
) -> tuple[Readings, ...]:
    """Return readings of any kinds; paths are read.

    Raises:
        InputError: as :func:`read_legs_and_tool`, and for files with a row a point.
    """
    read = read_tables(given, machine)
    if any(r.by_point for r in read):
        raise InputError("TCP points are no campaign of readings: give them as tcp")
    return tuple(read)


def points_of(given: ReadingsOrPath, machine: Machine) -> Readings:
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


def read_tables(
    given: ReadingsOrPath | Sequence[ReadingsOrPath], machine: Machine
) -> list[Readings]:
    """Return tables of what was given; paths are read.

    Raises:
        InputError: where nothing was given, or a file cannot be read.
    """
    read: list[Readings] = []
    for one in _as_list(given):
        if isinstance(one, str | PathLike):
            read += read_readings(one, machine.spec)
        else:
            check_given(one, machine.spec)
            read += split_legs_and_tool(one)
    if not read:
        raise InputError("there is no campaign: give at least one file of readings")
    return read


def _as_list(given: Any) -> list[Any]:
    """One or several as a list; a path is one, and so is a data frame, which is none of them."""
    one = isinstance(given, str | Mapping) or hasattr(given, "columns")
    return [given] if one or not isinstance(given, Iterable) else list(given)
