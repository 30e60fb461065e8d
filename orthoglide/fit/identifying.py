"""``identify``: what a user asks, put together as a problem and solved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, Literal, get_args

import numpy as np

from orthoglide.errors import InputError, check_list, check_word
from orthoglide.fit.doubts import check_slips
from orthoglide.fit.earlier import account_for_changes
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.exchanged import check_columns
from orthoglide.fit.factors import Factor, beliefs_of
from orthoglide.fit.noise import noise_of, overall
from orthoglide.fit.plausible import check_plausible
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.fit.unknowns import build_problem
from orthoglide.fit.verification import verify
from orthoglide.instruments import Frame
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Given, Readings, check_given, parts, read_readings, read_tcp
from orthoglide.parameters import plain_and_campaign
from orthoglide.threads import on_one_thread

_FEWEST_POINTS = 3
_EXACT = 1e-2  # of the noise; leaves a ten-thousandth of what a free datum takes up

Weighting = Literal["readings", "deviations"]


@on_one_thread
def identify(
    campaigns: Given | Sequence[Given],
    machine: MachineSource | None = None,
    free: Sequence[str] | None = None,
    *,
    own: Sequence[str] = (),
    priors: bool = True,
    noise: float | None = None,
    bounds: Mapping[str, float] | None = None,
    weighting: Weighting = "readings",
    method: Method = "auto",
    frame: Frame = "rigid",
) -> Estimate:
    """Identify parameters of the general mechanism from readings.

    Args:
        campaigns: readings of any kinds; paths are read as by ``read_readings``.
        machine: dimensions, tolerances, what is known, or the path of its file; else nominal.
        free: effects, parameters or structured members to identify; joint offsets and leg lengths
            where absent.
        own: which of them each campaign has for itself; the rest is shared.
        priors: whether the machine's tolerances act as priors about zero.
        noise: standard deviation of one reading of a leg, or of the tool where no leg is read,
            metres; see ``noise_of`` where absent.
        bounds: by parameter or family, SI: values stay within plus and minus.
        weighting: ``"readings"`` weighs every reading by its noise, with a free datum a setup;
            ``"deviations"`` is the papers' ordinary least squares on differences from each
            setup's first posture, which is taken for exact, as the dials' places are.
        method: ``"nlp"``, ``"nested"``, ``"pinocchio"`` (nested, closed by Pinocchio: slow) or
            ``"reduction"`` (the analytic PSS model); ``"auto"`` takes the programme for readings of
            legs up to ``NLP_POSTURES`` postures and ``NLP_UNKNOWNS`` unknowns, and else nests the
            closure.
        frame: by what a tracker's may differ from the machine's: ``"none"``, ``"translation"``, or
            ``"rigid"``.

    Raises:
        InputError: where what is asked makes no sense.
        UnidentifiableError: where the readings cannot determine it, naming what.
        SolverError: where no solver reaches an answer that passes our own checks.
        CrossCheckError: where mechanism, reduction and Pinocchio disagree beyond 1e-6 mm.
    """
    check_word("weighting", weighting, get_args(Weighting))
    check_word("method", method, get_args(Method))
    machine = Machine.of(machine)
    chosen = machine.catalogue.base if free is None else free
    read = _read(campaigns, machine)
    check_plausible(read, machine, frame)
    problem = assemble(
        read, machine, chosen,
        own=own, priors=priors, noise=noise, bounds=bounds, frame=frame,
    )  # fmt: skip
    _check_own(problem)
    if weighting == "deviations":
        problem = _anchored(problem)
    found = account_for_changes(solve(problem, method=method), method)
    check_columns(found)
    check_slips(found)
    return replace(found, verification=verify(found))


def _check_own(problem: Problem) -> None:
    """Refuse what is own to each campaign and not free."""
    for name in problem.own:
        plain, _ = plain_and_campaign(name)
        if not any(plain in (n.plain, n.effect) for n in problem.names):
            raise InputError(f"{name} is own to each campaign but not free: free it too")


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
    """The problem of readings of all kinds together; arguments as of :func:`identify`, but readings
    that were read and checked.
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
    read = _read(given, machine)
    legs = tuple(r for r in read if not r.of_tool)
    return legs, tuple(r for r in read if r.of_tool)


def readings_of(given: Given | Sequence[Given], machine: Machine) -> tuple[Readings, ...]:
    """Return readings of any kinds; paths are read.

    Raises:
        InputError: as :func:`sorted_out`, and for files with a row a point.
    """
    read = _read(given, machine)
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


def _read(given: Given | Sequence[Given], machine: Machine) -> list[Readings]:
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


def _anchored(problem: Problem) -> Problem:
    """Averaged readings, equal weights, each setup's first posture and the dials' places exact."""
    factors = []
    for factor in problem.on_legs:
        every = factor.readings
        # One row a setup and posture, as the papers average their repeats.
        table = np.column_stack([every.setup, every.command])
        _, first, station = np.unique(table, axis=0, return_index=True, return_inverse=True)
        station = station.reshape(-1)
        mean = np.bincount(station, every.reading) / np.bincount(station)
        kept = np.sort(first)
        some = factor.subset(kept).with_readings(mean[station[kept]])
        sigma = np.full(len(kept), problem.noise.typical)
        _, first = np.unique(some.setup, return_index=True)
        first = first[[s.observation.from_datum for s in some.readings.setups]]
        sigma[first] *= _EXACT
        step = np.full(len(kept), problem.noise.resolution)
        noise = replace(some.noise, sigma=sigma, common=np.zeros(len(kept)), step=step)
        beliefs = replace(some.beliefs, placement=0.0)
        factors.append(replace(some, noise=noise, beliefs=beliefs))
    return problem.with_factors(factors)
