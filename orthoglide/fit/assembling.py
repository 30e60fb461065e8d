"""Problems assembled from the user's input: readings or their paths, and free parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.errors import InputError, check_choice, check_list
from orthoglide.fit.factors import Factor, machine_instrument_priors
from orthoglide.fit.noise import Noise, noise_of, rms_noise
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknowns import NOTHING_FREE, Unknown, build_unknowns, expand_names, with_bounds
from orthoglide.geometry import Array
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
from orthoglide.observations.tables import with_distinct_sources
from orthoglide.observations.touched_plates import outlying_touches
from orthoglide.parameters import Parameter, split_campaign

_MIN_POINTS = 3  # TCP points: the frame alone needs three


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
    machine = machine.with_shapes()  # the curve of a calibrated error changes as a whole
    tables = [part for item in _as_list(given) for part in split_legs_and_tool(item)]
    tables = sorted(tables, key=lambda table: table.of_tool)
    instrument_priors = machine_instrument_priors(machine, frame)
    summary, row_noises = noise_of(tables, machine.spec, noise)
    tool_only = all(table.of_tool for table in tables)
    factors = []
    for table, row_noise in zip(tables, row_noises, strict=True):
        if table.by_point and len(table.points().p) < _MIN_POINTS:
            raise InputError(
                f"{table.name}: these are too few TCP points to identify anything: measure three "
                f"or more"
            )
        factor = Factor.from_readings(table, machine, row_noise, instrument_priors)
        if noise is None or not tool_only:
            factor = factor.with_roughness(machine).without_outlying_touches(machine)
        factors.append(factor)
    touches = [f.readings for f in factors]
    for k, row, height in outlying_touches(machine.spec.kinematics, touches):
        heights = np.where(np.arange(len(factors[k].readings)) == row, height, 0.0)
        factors[k] = factors[k].without_touches(heights, machine)
    if tool_only:
        rms = rms_noise([f.readings for f in factors], [f.noise.total for f in factors])
        summary = replace(summary, typical=rms)
    prior = machine.spec.prior  # without sigmas in the machine file it is no information
    return build_problem(
        machine, factors, free, summary, per_campaign=per_campaign, priors=priors, bounds=bounds,
        earlier_posterior=prior if priors and np.diag(prior.covariance).any() else None,
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
    """Return the problem of an identification; arguments as of :func:`identify`, but factors, those
    of legs first, their noise in one figure, and the posterior of an earlier calibration.
    Parameters in ``per_campaign`` need not be free.

    Raises:
        InputError: where the arguments do not fit together.
    """
    unfreed = Problem(
        machine, tuple(factors), (), noise, priors, (), tuple(per_campaign), earlier_posterior
    )
    stems = [factor.name for factor in unfreed.factors]
    for name in per_campaign:
        plain, stem = split_campaign(name)
        if stem and stem not in stems:
            raise InputError(f"{name}: there is no campaign {stem!r}, only {', '.join(stems)}")
        expand_names(machine.catalogue, [plain], unfreed.factors)
    unknowns = build_unknowns(machine, unfreed.factors, free, per_campaign)
    if not unknowns:  # all are parameters of instruments without readings
        raise InputError(NOTHING_FREE)
    if bounds:
        unknowns = with_bounds(unknowns, bounds)
    values_by_factor = tuple(machine.values for _ in unfreed.factors)
    return replace(unfreed, unknowns=unknowns, held=_held_values(values_by_factor, unknowns))


def _held_values(
    held: Sequence[Mapping[str, float]], unknowns: Sequence[Unknown]
) -> tuple[dict[str, float], ...]:
    """Return the values of each factor that no unknown sets, which stay held."""
    free = [{n for u in unknowns for n in u.weights[k]} for k in range(len(held))]
    return tuple({n: v for n, v in held[k].items() if n not in free[k]} for k in range(len(held)))


def with_free(problem: Problem, names: Sequence[str], *, release: bool = True) -> Problem:
    """Return the problem with further unknowns behind its own: effects, parameters or structured
    members, with ``@`` only that campaign's. Their held values are released, or else the unknowns
    are changes of them.
    """
    present = set(problem.names)
    added: list[Unknown] = []
    for name in names:
        plain, stem = split_campaign(name)
        own = problem.per_campaign
        for unknown in build_unknowns(problem.machine, problem.factors, [plain], own):
            in_campaign = not stem or unknown.name.campaign in ("", stem)
            if in_campaign and unknown.name not in present:
                present.add(unknown.name)
                added.append(unknown)
    # With further unknowns, other values may exceed their tolerances.
    unknowns = (*problem.with_prior_widths_reset().unknowns, *added)
    held = _held_values(problem.held, unknowns) if release else problem.held
    return replace(problem, unknowns=unknowns, held=held)


def with_effects_freed(problem: Problem, effects: Sequence[str]) -> Problem:
    """Return the problem with all single parameters of effects that no unknown sets yet, as changes
    of the held values.
    """
    taken = {p for u in problem.unknowns for parts in u.weights for p in parts}
    names: dict[Parameter, None] = {}
    for unknown in build_unknowns(problem.machine, problem.factors, list(effects)):
        if not any(p in taken for parts in unknown.weights for p in parts):
            names[unknown.name.plain] = None
    return with_free(problem, tuple(names), release=False)


def readings_of(
    given: ReadingsOrPath | Sequence[ReadingsOrPath], machine: Machine
) -> tuple[Readings, ...]:
    """Return readings of any kinds; paths are read.

    Raises:
        InputError: as :func:`read_tables`, and for files with a row a point.
    """
    tables = read_tables(given, machine)
    if points := [table.name for table in tables if table.by_point]:
        raise InputError(
            f"{points[0]} has TCP points, which are no campaign of readings: give them to a closed "
            f"loop, with --tcp (tcp=)"
        )
    return tuple(tables)


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
    tables: list[Readings] = []
    for item in _as_list(given):
        if isinstance(item, str | PathLike):
            tables += read_readings(item, machine.spec)
        else:
            check_given(item, machine.spec)
            tables += split_legs_and_tool(item)
    if not tables:
        raise InputError("there is no campaign: give at least one file of readings")
    return with_distinct_sources(tables)


def _as_list(given: Any) -> list[Any]:
    """One or several as a list; a path is one, and so is a data frame, which is none of them."""
    is_single = isinstance(given, str | Mapping) or hasattr(given, "columns")
    return [given] if is_single or not isinstance(given, Iterable) else list(given)


def excited_effects(problem: Problem) -> tuple[Effect, ...]:
    """Return the effects beyond the base whose conditions the readings vary."""
    catalogue = problem.machine.catalogue
    return tuple(
        effect
        for effect in catalogue.effects
        if effect.name not in catalogue.base
        and not unmet_conditions(problem, effect)
        and not (effect.instead_of and _CONDITION_TESTS[effect.instead_of](problem))
        and (not effect.of_dial or any(f.setups_of(effect) for f in problem.factors))
    )


def unmet_conditions(problem: Problem, effect: Effect) -> tuple[str, ...]:
    """Return the conditions that an effect needs and the readings do not vary."""
    return tuple(sorted(need for need in effect.needs if not _CONDITION_TESTS[need](problem)))


def axes_approached_from_both_sides(approach: Array) -> NDArray[np.bool_]:
    """Return which axes ``(3,)`` readings ``(n, 3)`` approach from both sides, as booleans."""
    return np.asarray((approach > 0).any(axis=0) & (approach < 0).any(axis=0))


def _varies(problem: Problem, column: str) -> bool:
    """Return whether the finite values of a column differ in any table."""
    columns = [getattr(factor.readings, column) for factor in problem.factors]
    return any(len(np.unique(values[np.isfinite(values)])) > 1 for values in columns)


_CONDITION_TESTS: Mapping[str, Callable[[Problem], bool]] = {
    "approach": lambda problem: any(
        axes_approached_from_both_sides(f.conditions().approach).any() for f in problem.factors
    ),
    "time": lambda problem: _varies(problem, "time"),
    "temperature": lambda problem: _varies(problem, "temperature"),
    "load": lambda problem: any(f.conditions().load.any() for f in problem.factors),
    "pitch": lambda problem: problem.machine.spec.screw_pitch is not None,
}
