"""Where what a fit leaves lives: on which dial, how much of it, and at which station most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.diagnosis.faults import setup_names
from orthoglide.fit import Estimate
from orthoglide.geometry import Array


@dataclass(frozen=True, eq=False)
class SetupRest:
    """What a fit leaves of one mounting of a dial.

    Attributes:
        setup: its name.
        leg: 0, 1 or 2: that it touches.
        axis: 0, 1 or 2: base axis along which it reads.
        share: of everything left, in squares of the noise.
        rms: root mean square of it, metres.
        most: largest mean over one station along +axis, metres, with its sign.
        command: at that station ``(3,)``, metres.
        posture: label of that station; may be empty.
    """

    setup: str
    leg: int
    axis: int
    share: float
    rms: float
    most: float
    command: Array
    posture: str


def rest_by_setup(estimate: Estimate) -> tuple[SetupRest, ...]:
    """What a fit leaves of every mounting of a dial, largest share first; none without dials."""
    campaigns = estimate.problem.campaigns
    if not campaigns:
        return ()
    count = sum(map(len, campaigns))
    of_setup = estimate.problem.setup_of_row[:count]
    station, left = estimate.problem.station[:count], estimate.residuals[:count]
    squares = estimate.problem.weighing.whiten(estimate.residuals)[:count] ** 2
    visits = np.maximum(np.bincount(station), 1)
    mean = (np.bincount(station, left) / visits)[station]
    command = np.concatenate([c.command for c in campaigns])
    labels = [label for c in campaigns for label in c.posture]
    setups = [s for c in campaigns for s in c.setups]
    total, found = max(float(squares.sum()), 1e-300), []
    for k, (name, setup) in enumerate(zip(setup_names(estimate.problem), setups, strict=True)):
        rows = np.flatnonzero(of_setup == k)
        at = int(rows[np.argmax(np.abs(mean[rows]))])
        found.append(
            SetupRest(
                name, setup.leg, setup.axis, float(squares[rows].sum()) / total,
                float(np.sqrt(np.mean(left[rows] ** 2))), setup.sign * float(mean[at]),
                command[at], labels[at],
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda one: -one.share))
