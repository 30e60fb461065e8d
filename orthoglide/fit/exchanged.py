"""Commands that stand in each other's columns: no machine reads as these dials then do."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import permutations

from orthoglide.errors import InputError, NumericsError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.identifying import assemble
from orthoglide.fit.solving import solve
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, source

_FAR = 20.0
"""Times the noise by which an exchange is off, and more: a machine's own errors are rarely."""

_BETTER = 10.0  # times nearer by which the readings must fit with the commands put right


def check_columns(estimate: Estimate) -> None:
    """Refuse campaigns whose readings fit only with the commands of drives exchanged.

    Raises:
        InputError: naming the file, and the drives.
    """
    if estimate.sigma_scale < _FAR:
        return
    machine = estimate.problem.machine
    for campaign in estimate.problem.campaigns:
        with suppress(NumericsError):
            _check(campaign, machine)


def _check(campaign: Campaign, machine: Machine) -> None:
    def off(order: Sequence[int]) -> float:
        found = _exchanged(campaign, list(order))
        return solve(
            assemble([found], machine, machine.catalogue.base), method="nested"
        ).sigma_scale

    now = off((0, 1, 2))
    if now < _FAR:
        return
    names = machine.geometry.leg_names
    orders = [order for order in permutations(range(3)) if order != (0, 1, 2)]
    best, order = min((off(order), order) for order in orders)
    if best * _BETTER < now:
        moved = [k for k in range(3) if order[k] != k]
        told = " and ".join(f"of drive {names[k]} under {names[order[k]]}" for k in moved)
        raise InputError(
            f"{source(campaign)}: the readings fit {now / best:.0f} times better with the commands "
            f"{told}: exchange the columns, or else the legs and directions of all dials"
        )


def _exchanged(campaign: Campaign, order: list[int]) -> Campaign:
    """A campaign whose k-th drive was commanded as the file has it of another."""
    return replace(
        campaign,
        command=campaign.command[:, order],
        approach=campaign.approach[:, order],
        moves=replace(campaign.moves, command=campaign.moves.command[:, order]),
    )
