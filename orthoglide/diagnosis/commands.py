"""The command of a posture that is not the one written: which readings, and what is then read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.diagnosis.faults import Fault, Rows, campaign_of
from orthoglide.fit import Problem
from orthoglide.geometry import LEGS, Array
from orthoglide.observations import Campaign
from orthoglide.observations.arrays import numbered

_STEP = 1e-5  # metres, of a difference quotient


def postures(problem: Problem) -> Rows:
    """Posture of each reading ``(n,)``: one for each campaign and command; -1 where no dial is."""
    campaigns = problem.campaigns
    number = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
    found = np.full(len(problem.measured), -1)
    found[: len(number)] = numbered(np.column_stack([number, problem.of_dials("command")]))
    return found


def slopes(problem: Problem, x: Array, value: Array) -> Array:
    """Derivative of every reading by its own command ``(n, 3)``.

    Args:
        problem: with dials.
        x: its unknowns ``(P,)``, SI.
        value: the readings there ``(n,)``, metres.
    """
    found = np.zeros((len(value), len(LEGS)))
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.rows, strict=True)):
        values = problem.values(k, x)
        for drive in range(len(LEGS)):
            moved = replace(campaign, command=campaign.command + _STEP * np.eye(3)[drive])
            read = problem.machine.model.readings(values, moved)
            found[rows, drive] = (read - value[rows]) / _STEP
    return found


def put_right(campaign: Campaign, rows: Rows, drive: int, size: float) -> Campaign:
    """The campaign with another command in some rows, metres, and the approach that follows."""
    command = campaign.command.copy()
    command[rows, drive] += size
    moved = replace(campaign, command=command)
    derived = campaign.approach == campaign.derived_approach
    approach = np.where(derived, moved.derived_approach, campaign.approach)
    return replace(moved, approach=approach)


def all_put_right(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """The problem with the likeliest commands in the rows of faults of that kind."""
    campaigns = list(problem.campaigns)
    for fault in faults:
        for drive, size in fault.commands[:1]:
            k = campaign_of(problem, fault.rows)
            within = fault.rows - problem.rows[k].start
            campaigns[k] = put_right(campaigns[k], within, drive, size)
    return replace(problem, campaigns=tuple(campaigns))
