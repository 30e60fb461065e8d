"""Readings that were put together in Python, checked as those of a file are."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from orthoglide.errors import InputError
from orthoglide.machine_file import MachineFile
from orthoglide.observations.campaign import Campaign
from orthoglide.observations.checks import check_campaign, check_commands, check_filled
from orthoglide.observations.columns import TURNS
from orthoglide.observations.tcp import TcpPoints, check_points
from orthoglide.observations.tool import ToolCampaign
from orthoglide.observations.tool_reading import check_tool
from orthoglide.units import NOISE


def check_given(given: Campaign | ToolCampaign | TcpPoints, machine: MachineFile) -> None:
    """Refuse readings for which a file that holds them would be refused.

    Args:
        given: the readings.
        machine: whose stroke, dimensions and dial count.

    Raises:
        InputError: naming the row, counted from 0, and what would be right.
    """

    def fail(message: str, row: int | None = None) -> NoReturn:
        place = "" if row is None else f", row {row} (counted from 0)"
        raise InputError(f"{given.name}{place}: {message} (arrays are in metres and radians)")

    if not isinstance(given, Campaign | ToolCampaign | TcpPoints):
        raise InputError(
            f"a {type(given).__name__} holds no readings: give a campaign, TCP points, or the path "
            "of a file"
        )
    if not len(given):
        fail("has no readings: give some")
    check_commands(given.command, False, machine, fail)
    most = np.full(len(given), NOISE[1])
    if isinstance(given, ToolCampaign):
        most[given.of_kind("incline")] = TURNS
    wrong = np.isfinite(given.sigma) & ((given.sigma < NOISE[0]) | (given.sigma > most))
    if wrong.any():
        row = int(np.argmax(wrong))
        fail(
            f"sigma is {given.sigma[row]:g}: give a standard deviation in metres from "
            f"{NOISE[0]:g} to {most[row]:g}, or nan",
            row,
        )
    if isinstance(given, TcpPoints):
        check_points(given, fail)
    elif isinstance(given, ToolCampaign):
        check_tool(given, fail)
    else:
        check_filled(given.reading, fail)
        check_campaign(given, machine, fail)
