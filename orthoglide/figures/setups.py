"""Readings setup by setup, as figures draw them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import LEGS, Array
from orthoglide.observations import ToolCampaign

if TYPE_CHECKING:
    from orthoglide.fit import Problem

_MOVES = 1e-3  # metres of travel from which a setup is drawn over it


@dataclass(frozen=True)
class Mounting:
    """One setup.

    Attributes:
        name: of the setup, its campaign before it where there are several.
        title: name, leg and direction.
        label: of the scale across.
        rows: of all readings ``(m,)``.
        x: travel of the touched leg's carriage in millimetres, or place in the file ``(m,)``.
        side: of the approach of that leg's own axis ``(m,)``.
    """

    name: str
    title: str
    label: str
    rows: NDArray[np.intp]
    x: Array
    side: Array


def mountings(problem: Problem) -> Iterator[Mounting]:
    """All setups of a problem, in their order."""
    several, first = len(problem.campaigns) > 1, 0
    for campaign in problem.campaigns:
        for k, setup in enumerate(campaign.setups):
            there = np.flatnonzero(campaign.setup == k)
            travel = campaign.command[there, setup.leg] - problem.machine.geometry.zero[setup.leg]
            moves = np.ptp(travel) > _MOVES
            name = f"{campaign.name} · {setup.name}" if several else setup.name
            yield Mounting(
                name,
                f"{name}: leg {LEGS[setup.leg]}, read along {setup.direction}",
                f"travel of carriage {LEGS[setup.leg]}, mm" if moves else "place in the file",
                first + there,
                travel * 1e3 if moves else campaign.order[there].astype(float),
                campaign.approach[there, setup.leg],
            )
        first += len(campaign)
    for points, part in zip(
        problem.points, problem.factor_rows[len(problem.campaigns) :], strict=True
    ):
        if isinstance(points.points, ToolCampaign):
            yield from _of_tool(points.points, points.setup, part.start)
            continue
        for k, axis in enumerate(LEGS):
            there = np.flatnonzero(points.setup == k)
            if len(there):
                yield Mounting(
                    f"{points.name} · {axis}",
                    f"{points.name}: coordinate {axis} of the TCP",
                    "point",
                    part.start + there,
                    (points.point[there] + 1).astype(np.float64),
                    points.points.approach[points.point[there], k],
                )


def _of_tool(tool: ToolCampaign, place: NDArray[np.int64], first: int) -> Iterator[Mounting]:
    for k, setup in enumerate(tool.setups):
        there = np.flatnonzero(place == k)
        yield Mounting(
            f"{tool.name} · {setup.name}",
            f"{tool.name}: {setup.name}, {setup.kind}",
            "reading",
            first + there,
            np.arange(1.0, len(there) + 1),
            np.zeros(len(there)),
        )
