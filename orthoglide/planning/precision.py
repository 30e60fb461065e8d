"""How often to repeat a protocol for the accuracy that is wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.accuracy import workspace
from orthoglide.effects import is_dial
from orthoglide.errors import InputError
from orthoglide.fit import Noise
from orthoglide.fit.noise import station_table
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.planning.bench import Scatter
from orthoglide.planning.expected import Expected, expected, expected_noise, scatter_of
from orthoglide.prediction import Conditions

TCP = "TCP"
"""Stands for the TCP where a parameter's name might stand."""

_MOST = 1000
_GRID = 4


@dataclass(frozen=True)
class Repeats:
    """An answer to "how often".

    Attributes:
        what: parameter, or ``"TCP"``: root mean square over the workspace and its three axes, best
            translation removed.
        wanted: standard deviation, SI.
        repeats: visits to every station; ``None`` where no number is enough.
        sigma: with that many; with one visit where none is enough.
        floor: what is left with any number of repeats: rounding, placement, and what is not seen.
    """

    what: str
    wanted: float
    repeats: int | None
    sigma: float
    floor: float


def once(campaign: Campaign) -> Campaign:
    """Every station of a campaign visited once."""
    _, first = np.unique(station_table(campaign), axis=0, return_index=True)
    return campaign.subset(np.sort(first))


@dataclass(frozen=True)
class Accuracy:
    """What a protocol would tell of one figure, by how often it is repeated.

    Attributes:
        seen: the protocol, every station once, at the machine as it is believed to be.
        slope: derivative of the figure ``(k, P)`` by unknowns in tolerances, SI.
        scatter: of one reading.
        level: noise of one reading, all counted.
    """

    seen: Expected
    slope: Array
    scatter: Scatter
    level: Noise

    def sigma(self, repeats: float) -> float:
        """Standard deviation with so many visits to every station, SI, tolerances as priors.

        Args:
            repeats: at least 1; infinite for the limit.
        """
        typical = self.level.typical
        # The mean of a station's visits; a tiny rest keeps the limit finite.
        mean = max(self.scatter.reading**2 / repeats, (1e-3 * typical) ** 2)
        own = np.sqrt(mean + self.scatter.common**2)
        visits = np.full(len(self.seen.problem.measured), own)
        noise = Noise((visits,), typical, self.level.source)
        covariance = self.seen.with_noise(noise).covariance
        variances = np.einsum("rp,pq,rq->r", self.slope, covariance, self.slope)
        return float(np.sqrt(np.mean(variances)))


def accuracy_of(
    machine: Machine,
    campaign: Campaign,
    families: Sequence[str],
    what: str,
    noise: float | None = None,
) -> Accuracy:
    """Prepare a protocol for questions of accuracy.

    Args:
        machine: tolerances and dial.
        campaign: stations; its own repeats do not count.
        families: to identify.
        what: one of their parameters, or ``"TCP"``.
        noise: standard deviation of one reading, metres.

    Raises:
        InputError: for a parameter that is not identified.
    """
    visits = once(campaign)
    level = expected_noise(machine, visits, noise)
    seen = expected(machine, visits, families, level)
    problem = seen.problem
    if what != TCP and what not in problem.names:
        known = ", ".join(problem.names)
        raise InputError(f"{what} is not identified here: it is TCP, or one of {known}")
    slope = (
        _tcp_slope(machine, seen)
        if what == TCP
        else np.diag(problem.tolerance)[[problem.names.index(what)]]
    )
    return Accuracy(seen, slope, scatter_of(machine, level.typical), level)


def _tcp_slope(machine: Machine, seen: Expected) -> Array:
    """Derivative of the TCP over the workspace ``(3 g, P)``, mean removed, by tolerances."""
    names, weights = seen.problem.elementary(0)
    kept = [k for k, n in enumerate(names) if not is_dial(n)]
    conditions = Conditions.at(workspace(machine.geometry, _GRID))
    here = {n: v for n, v in machine.values.items() if not is_dial(n)}
    _, by_name = machine.model.sensitivities(here, conditions, [names[k] for k in kept])
    slope = by_name[:, :3] @ weights[kept] * seen.problem.tolerance
    return np.asarray((slope - slope.mean(axis=0)).reshape(-1, slope.shape[-1]))


def repeats_needed(
    machine: Machine,
    campaign: Campaign,
    families: Sequence[str],
    what: str,
    wanted: float,
    noise: float | None = None,
) -> Repeats:
    """How often every station must be visited for a wanted accuracy.

    Repeats reduce the scatter of readings. They reduce neither the rounding that a station's
    visits share, nor the dial's misplacement, nor what no reading of the protocol sees.

    Args:
        machine: tolerances and dial.
        campaign: stations; its own repeats do not count.
        families: to identify, with their tolerances as priors.
        what: one of their parameters, or ``"TCP"``.
        wanted: standard deviation, SI.
        noise: standard deviation of one reading, metres.

    Raises:
        InputError: for a parameter that is not identified, or a ``wanted`` that is not positive.
    """
    if not wanted > 0:
        raise InputError(f"the accuracy wanted of {what} must be a positive standard deviation")

    sigma = accuracy_of(machine, campaign, families, what, noise).sigma
    floor = sigma(np.inf)
    if sigma(_MOST) > wanted:
        return Repeats(what, wanted, None, sigma(1), floor)
    low, high = 0, _MOST
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if sigma(middle) <= wanted else (middle, high)
    return Repeats(what, wanted, high, sigma(high), floor)
