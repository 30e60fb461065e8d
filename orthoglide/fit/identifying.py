"""``identify``: what a user asks, put together as a problem and solved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, Literal, get_args

import numpy as np

from orthoglide.errors import InputError, check_list, check_word
from orthoglide.fit.doubts import check_slips, check_units
from orthoglide.fit.earlier import account_for_changes
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.exchanged import check_columns
from orthoglide.fit.factors import Frame, TcpReadings
from orthoglide.fit.instrument_frame import turned_to
from orthoglide.fit.meant import check_meant
from orthoglide.fit.noise import noise_of
from orthoglide.fit.problem import Beside, Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.fit.tool import ToolReadings
from orthoglide.fit.unknowns import build_problem
from orthoglide.fit.verification import verify
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import (
    Campaign,
    Given,
    Readings,
    TcpPoints,
    ToolCampaign,
    check_given,
    read_readings,
    read_tcp,
)
from orthoglide.parameters import plain_and_campaign
from orthoglide.threads import on_one_thread

_EXACT = 1e-2  # of the noise; leaves a ten-thousandth of what a free datum takes up

Weighting = Literal["readings", "deviations"]

Source = Given | TcpPoints | ToolCampaign
"""A campaign of dial readings, readings of the tool, the path of either, or TCP points."""

Read = Readings | TcpPoints
"""Readings of any kind."""


@on_one_thread
def identify(
    campaigns: Source | Sequence[Source],
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
    """Identify parameters of the general mechanism from dial readings.

    Args:
        campaigns: one or several; paths are read as by ``read_readings``.
        machine: dimensions, tolerances and what is known already, or the path of its file; nominal
            where absent.
        free: effects, parameters or structured members to identify; joint offsets and leg lengths
            where absent.
        own: which of them each campaign has for itself; the rest is shared.
        priors: whether the machine's tolerances act as priors about zero.
        noise: standard deviation of one reading, metres (of one TCP coordinate where there are no
            dial readings); see ``noise_of`` where absent.
        bounds: by parameter or family, SI: values stay within plus and minus.
        weighting: ``"readings"`` weighs every reading by its noise, with a free datum a setup;
            ``"deviations"`` is the papers' ordinary least squares on differences from each
            setup's first posture, which takes that posture's reading and the dials' places for
            exact.
        method: ``"nlp"``, ``"nested"``, ``"pinocchio"`` (nested, closed by Pinocchio: slow) or
            ``"reduction"`` (the analytic PSS model); ``"auto"`` takes the programme up to
            ``NLP_POSTURES`` postures and ``NLP_UNKNOWNS`` unknowns, and nests the closure beyond.
        frame: how the instrument of TCP points may stand to the machine: ``"none"``: not at all,
            ``"translation"``, or ``"rigid"``.

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
    problem = assemble(
        _read(campaigns, machine), machine, chosen,
        own=own, priors=priors, noise=noise, bounds=bounds, frame=frame,
    )  # fmt: skip
    for name in problem.own:
        plain, _ = plain_and_campaign(name)
        if not any(plain in (n.plain, n.effect) for n in problem.names):
            raise InputError(f"{name} is own to each campaign but not free: free it too")
    if weighting == "deviations":
        problem = _anchored(problem)
    found = account_for_changes(solve(problem, method=method), method)
    check_columns(found)
    check_slips(found)
    return replace(found, verification=verify(found))


def assemble(
    given: Read | Sequence[Read],
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
    read = _listed(given)
    campaigns = [r for r in read if isinstance(r, Campaign)]
    points = [r for r in read if not isinstance(r, Campaign)]
    check_units(campaigns, machine.spec.dial)
    level = noise_of(campaigns, machine.spec.dial, noise)
    readings = [_beside(p, machine, frame, None if campaigns else noise) for p in points]
    if readings and not campaigns and noise is None:
        sigma = np.concatenate([r.sigma[~r.turned] for r in readings])
        if not len(sigma):  # a level alone
            sigma = np.concatenate([r.sigma for r in readings])
        told = all(np.isfinite(p.sigma).all() for p in points)
        typical = float(np.sqrt(np.mean(sigma**2)))
        level = replace(level, typical=typical, source="declared" if told else level.source)
    known = machine.posterior  # an earlier calibration says nothing where its file gives no sigmas
    return build_problem(
        machine, campaigns, free, level, own=own, priors=priors, bounds=bounds, points=readings,
        earlier=known if priors and np.diag(known.covariance).any() else None,
    )  # fmt: skip


def sorted_out(
    given: Source | Sequence[Source], machine: Machine
) -> tuple[tuple[Campaign, ...], tuple[TcpPoints | ToolCampaign, ...]]:
    """Campaigns of dial readings, and readings of the tool apart; paths are read.

    Raises:
        InputError: where there is neither, or a file cannot be read.
    """
    read = _read(given, machine)
    campaigns = tuple(r for r in read if isinstance(r, Campaign))
    return campaigns, tuple(r for r in read if not isinstance(r, Campaign))


def readings_of(given: Source | Sequence[Source], machine: Machine) -> tuple[Readings, ...]:
    """Readings of dials and of the tool's instruments; paths are read.

    Raises:
        InputError: as :func:`sorted_out`, and for TCP points.
    """
    read = _read(given, machine)
    found = tuple(r for r in read if not isinstance(r, TcpPoints))
    if len(found) < len(read):
        raise InputError("TCP points are no campaign of readings: give them as tcp")
    return found


def points_of(given: TcpPoints | str | PathLike[str], machine: Machine) -> TcpPoints:
    """TCP points to judge by; a path is read.

    Raises:
        InputError: for readings of another kind, and points that cannot be meant.
    """
    if isinstance(given, str | PathLike):
        return read_tcp(given, machine.spec)
    if not isinstance(given, TcpPoints):
        raise InputError(
            f"a {type(given).__name__} holds no TCP points: give TcpPoints, or the path of one "
            f"file of them; readings of another kind judge as holdout"
        )
    check_given(given, machine.spec)
    return given


def _read(given: Source | Sequence[Source], machine: Machine) -> list[Read]:
    read: list[Read] = []
    for one in _listed(given):
        if isinstance(one, str | PathLike):
            read += read_readings(one, machine.spec)
        else:
            check_given(one, machine.spec)
            read.append(one)
    if not read:
        raise InputError("there is no campaign: give at least one file of readings")
    return read


def _listed(given: Any) -> list[Any]:
    """One or several as a list; a path is one, and so is a data frame, which is none of them."""
    one = isinstance(given, str | Mapping) or hasattr(given, "columns")
    return [given] if one or not isinstance(given, Iterable) else list(given)


def _beside(
    points: TcpPoints | ToolCampaign, machine: Machine, frame: Frame, sigma: float | None
) -> Beside:
    """Points as readings; a large turn of the instrument's frame is taken out beforehand."""
    p = machine.forward(points.command)
    if isinstance(points, ToolCampaign):
        check_meant(points, p, machine)
        read = ToolReadings.of(points, machine, sigma)
        return read.about(p + points.beside, start=True).without_strays(machine)
    if len(points) < 3:
        raise InputError(
            f"{points.name}: these are too few TCP points to identify anything: measure three or "
            f"more"
        )
    if sigma is not None:
        points = replace(points, sigma=np.full(len(points), sigma))
    if frame == "rigid":
        points = turned_to(points, p)
    check_meant(points, p, machine)
    return TcpReadings(points, frame)


def _anchored(problem: Problem) -> Problem:
    """Averaged readings, equal weights, each setup's first posture and the dials' places exact."""
    campaigns, sigmas = [], []
    for every in problem.campaigns:
        # One row a setup and posture, as the papers average their repeats.
        table = np.column_stack([every.setup, every.command])
        _, first, station = np.unique(table, axis=0, return_index=True, return_inverse=True)
        station = station.reshape(-1)
        mean = np.bincount(station, every.reading) / np.bincount(station)
        kept = np.sort(first)
        campaign = every.subset(kept).with_readings(mean[station[kept]])
        campaigns.append(campaign)
        sigma = np.full(len(campaign), problem.noise.typical)
        _, first = np.unique(campaign.setup, return_index=True)
        sigma[first] *= _EXACT
        sigmas.append(sigma)
    none = tuple(np.zeros(len(s)) for s in sigmas)
    step = tuple(np.full(len(s), problem.noise.resolution) for s in sigmas)
    noise = replace(problem.noise, sigma=tuple(sigmas), common=none, step=step)
    return replace(problem, campaigns=tuple(campaigns), noise=noise, placement=0.0)
