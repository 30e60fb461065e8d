"""How often to repeat a protocol for the accuracy that is wanted."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.accuracy import tcp_slopes, without_place, workspace
from orthoglide.errors import InputError
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings
from orthoglide.planning.linear import LinearReadings, in_tolerances
from orthoglide.prediction import Conditions

TCP = "TCP"
"""Stands for the TCP where a parameter's name might stand."""

_MOST = 1000
_GRID = 4
_REST = 1e-3  # of a reading's sigma: keeps the limit of many repeats finite


@dataclass(frozen=True)
class Repeats:
    """An answer to "how often"."""

    # parameter, or `"TCP"`: root mean square over the workspace and its three axes, best
    # translation removed
    what: str
    wanted: float  # standard deviation, SI
    repeats: int | None  # visits to every station; `None` where no number is enough
    sigma: float  # with that many; with one visit where none is enough
    # what is left with any number of repeats: rounding, placement, and what is not seen
    floor: float


def sigma_by_repeats(
    machine: Machine,
    campaign: Readings,
    free: Sequence[str],
    what: str,
    noise: float | None = None,
) -> Callable[[float], float]:
    """How sure a protocol makes one figure, by how often it is repeated; arguments as of
    :func:`repeats_needed`.

    Returns:
        From the visits to every station, 1 to infinity, to the standard deviation, SI.

    Raises:
        InputError: for a parameter that is not identified.
    """
    _, first = np.unique(campaign.stations, axis=0, return_index=True)
    once = campaign.subset(np.sort(first))
    names = machine.catalogue.expand(free, [s.name for s in once.setups])
    if what != TCP and what not in names:
        known = ", ".join(names)
        raise InputError(f"{what} is not identified here: it is TCP, or one of {known}")
    if what == TCP:  # over the workspace, mean removed
        of_machine = [not machine.catalogue.effect_of(n).of_dial for n in names]
        moving = [n for n, moves in zip(names, of_machine, strict=True) if moves]
        parts, weights = in_tolerances(machine, moving)
        where = Conditions.at(workspace(machine.geometry, _GRID, machine.spec.screw_pitch))
        moved = without_place(tcp_slopes(machine, parts, where) @ weights)
        slope = np.zeros((*moved.shape[:2], len(names)))
        slope[..., of_machine] = moved
        slope = slope.reshape(-1, len(names))
    else:
        slope = np.array([[machine.tolerance(n) if n == what else 0.0 for n in names]])
    readings = LinearReadings.of(machine, once, names, noise)

    def sigma(repeats: float) -> float:
        mean = readings.sigma * max(1 / np.sqrt(repeats), _REST)
        information = replace(readings, sigma=mean).information()
        covariance = np.linalg.inv(information + np.eye(len(names)))
        return float(np.sqrt(np.mean(np.einsum("rp,pq,rq->r", slope, covariance, slope))))

    return sigma


def repeats_needed(
    machine: MachineSource,
    campaign: Readings,
    free: Sequence[str],
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
        free: to identify, with their tolerances as priors.
        what: one of their parameters, or ``"TCP"``.
        wanted: standard deviation, SI.
        noise: standard deviation of one reading, metres.

    Raises:
        InputError: for a parameter that is not identified, or a ``wanted`` that is not positive.
    """
    if not wanted > 0:
        raise InputError(f"the accuracy wanted of {what} must be a positive standard deviation")
    machine = Machine.of(machine)
    sigma = sigma_by_repeats(machine, campaign, free, what, noise)
    floor = sigma(np.inf)
    if sigma(_MOST) > wanted:
        return Repeats(what, wanted, None, sigma(1), floor)
    few = 1 + bisect_left(range(1, _MOST), True, key=lambda n: sigma(n) <= wanted)
    return Repeats(what, wanted, few, sigma(few), floor)
