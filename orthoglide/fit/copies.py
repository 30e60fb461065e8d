"""Readings that are there twice: repeats that were copied, files given under two names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from orthoglide.fit.noise import repeat_steps
from orthoglide.observations import Readings, Recorded, TcpPoints, ToolCampaign

_FEWEST = 6  # repeats that are too few to say they are copies


def copied(campaign: Recorded) -> int:
    """Number of repeats, where each is the same to the last digit as the visit before; else 0."""
    alike = repeat_steps(campaign) == 0
    return len(alike) if len(alike) >= _FEWEST and alike.all() else 0


def repeated_points(points: TcpPoints) -> tuple[int, ...]:
    """Lines whose point an earlier line has too, to the last digit of command and coordinates."""
    rows = np.nan_to_num(np.hstack([points.command, points.approach, points.p]))
    first = np.unique(rows, axis=0, return_index=True)[1]
    return tuple(np.delete(points.line, first).tolist())


def shared(one: Readings | TcpPoints, other: Readings | TcpPoints) -> float:
    """Share of readings that another file has too: the same value, instrument and command."""

    def rows(campaign: Readings | TcpPoints) -> set[tuple[object, ...]]:
        if isinstance(campaign, TcpPoints):
            return set(map(tuple, np.nan_to_num(np.hstack([campaign.command, campaign.p]))))
        if isinstance(campaign, ToolCampaign):
            seen = zip(campaign.kind, campaign.axis.tolist(), strict=True)
            read = [
                (*kind, *np.nan_to_num(s)) for kind, s in zip(seen, campaign.second, strict=True)
            ]
        else:
            setups = [(s.leg, s.direction, s.gauge, s.bar) for s in campaign.setups]
            read = [setups[k] for k in campaign.setup]
        places = zip(read, campaign.command.tolist(), campaign.repeat.tolist(),
                     campaign.reading.tolist(), strict=True)  # fmt: skip
        return {(*of, *command, n, value) for of, command, n, value in places}

    own = rows(one)
    return len(own & rows(other)) / max(len(own), 1)


def twice(several: Sequence[Readings | TcpPoints]) -> Iterator[str]:
    """A sentence for each file whose readings are all those of an earlier one."""
    for k, one in enumerate(several):
        for other in several[:k]:
            if type(one) is type(other) and len(one) == len(other) and shared(one, other) == 1.0:
                yield (
                    f"the readings of {one.name} are those of {other.name} to the last digit: a "
                    f"copy tells nothing that the other does not, so leave one of them out"
                )
                break
