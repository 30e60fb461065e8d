"""Where what a fit leaves lives: in which readings, how much of it, and at which station most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.diagnosis.faults import setup_names
from orthoglide.fit import Estimate
from orthoglide.geometry import LEGS, Array
from orthoglide.numerals import plain
from orthoglide.observations import ToolCampaign
from orthoglide.observations.approach import Ints

_READS = {
    "tcp": "the tool along {}", "plate": "the plate's height", "distance": "distances",
    "ballbar": "the ball bar", "incline": "the platform's turn about {}",
}  # fmt: skip
_PLACES = 3  # at which most is left


@dataclass(frozen=True, eq=False)
class SetupRest:
    """What a fit leaves of one mounting of a dial."""

    setup: str  # its name
    leg: int  # 0, 1 or 2: that it touches
    axis: int  # 0, 1 or 2: base axis along which it reads
    share: float  # of everything left, in squares of the noise
    rms: float  # root mean square of it, metres
    most: float  # largest mean over one station along +axis, metres, with its sign
    command: Array  # at that station (3,), metres
    posture: str  # label of that station; may be empty


def rest_by_setup(estimate: Estimate) -> tuple[SetupRest, ...]:
    """What a fit leaves of every mounting of a dial, largest share first; none without dials."""
    campaigns = estimate.problem.campaigns
    if not campaigns:
        return ()
    count = sum(map(len, campaigns))
    of_setup = estimate.problem.setup_of_row[:count]
    station, left = estimate.problem.station[:count], estimate.residuals[:count]
    squares = _squares(estimate)
    visits = np.maximum(np.bincount(station), 1)
    mean = (np.bincount(station, left) / visits)[station]
    command = np.concatenate([c.command for c in campaigns])
    labels = [label for c in campaigns for label in c.posture]
    setups = [s for c in campaigns for s in c.setups]
    found = []
    for k, (name, setup) in enumerate(zip(setup_names(estimate.problem), setups, strict=True)):
        rows = np.flatnonzero(of_setup == k)
        at = int(rows[np.argmax(np.abs(mean[rows]))])
        found.append(
            SetupRest(
                name, setup.leg, setup.axis, float(squares[rows].sum()),
                float(np.sqrt(np.mean(left[rows] ** 2))), setup.sign * float(mean[at]),
                command[at], labels[at],
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda one: -one.share))


@dataclass(frozen=True, eq=False)
class ToolRest:
    """What a fit leaves of one mounting of an instrument at the tool, along its axis if any."""

    setup: str  # its name
    reads: str  # what is read, in words
    unit: str  # in which people read it
    share: float  # of everything left, in squares of the noise
    rms: float  # root mean square of it, metres or radians
    most: float  # largest mean over one station along +axis, with its sign
    posture: str  # label of that station; may be empty
    # places of the nominal tool at which most is left, most first, in millimetres
    where: tuple[str, ...]


def rest_of_tool(estimate: Estimate) -> tuple[ToolRest, ...]:
    """What a fit leaves of every instrument at the tool, largest share first; none without any."""
    problem, squares, found = estimate.problem, _squares(estimate), []
    for factor, rows in zip(problem.factors, problem.factor_rows, strict=True):
        if isinstance(campaign := factor.points, ToolCampaign):
            parts = np.column_stack([campaign.setup, campaign.axis])
            for part in np.unique(parts, axis=0):
                own = np.flatnonzero((parts == part).all(axis=1))
                found.append(_of_part(estimate, campaign, own, rows.start, squares))
    return tuple(sorted(found, key=lambda one: -one.share))


def _squares(estimate: Estimate) -> Array:
    """Share of each row ``(n,)`` in all that a fit leaves, in squares of the noise."""
    squares = estimate.problem.weighing.whiten(estimate.residuals) ** 2
    return np.asarray(squares / max(float(squares.sum()), 1e-300))


def _of_part(
    estimate: Estimate, campaign: ToolCampaign, own: Ints, first: int, squares: Array
) -> ToolRest:
    """Of some rows of a campaign ``(k,)`` that begins at a stacked row.

    Args:
        estimate: the fit.
        campaign: of which the rows are.
        own: rows of it.
        first: where it begins among all rows.
        squares: share of each row in all that is left ``(n,)``.
    """
    setup, left = campaign.setups[campaign.setup[own[0]]], estimate.residuals[first + own]
    _, at, of = np.unique(
        estimate.problem.station[first + own], return_index=True, return_inverse=True
    )
    mean = np.bincount(of, campaign.sign[own] * left) / np.bincount(of)
    most = np.argsort(-np.abs(mean))
    where = own[at[most]]
    _, fresh = np.unique(campaign.command[where], axis=0, return_index=True)
    worst = where[np.sort(fresh)[:_PLACES]]
    return ToolRest(
        setup.name,
        _READS[setup.kind].format(LEGS[campaign.axis[own[0]]]),
        "mrad" if setup.kind == "incline" else "mm",
        float(squares[first + own].sum()),
        float(np.sqrt(np.mean(left**2))),
        float(mean[most[0]]),
        campaign.posture[worst[0]],
        tuple(
            ", ".join(f"{name} {plain(v * 1e3, 0)}" for name, v in zip(LEGS, p, strict=True))
            for p in estimate.problem.machine.with_only({}).forward(campaign.command[worst])
        ),
    )
