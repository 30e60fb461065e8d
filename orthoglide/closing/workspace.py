"""The TCP over the workspace: what is wrong now, and what stays unknown."""

from __future__ import annotations

from orthoglide.accuracy import Map, tcp_map, variance_by_effect, without_place, workspace
from orthoglide.fit import Estimate
from orthoglide.machine import Machine
from orthoglide.ordering import ranked
from orthoglide.result import Workspace

_MOST_NAMED = 3


def workspace_of(before: Estimate, known: Machine, calibrated: Map) -> Workspace:
    """The workspace by the base model, and by the calibrated machine, of which this is the map;
    ``known`` is the posterior's machine.
    """
    base = tcp_map(known.with_posterior(before.machine.values, known.posterior))
    travels = known.geometry.dialled  # elsewhere no levels of travel are levels of the tool
    return Workspace(
        workspace(known.geometry) - known.geometry.zero if travels else calibrated.nominal,
        "travel of {}" if travels else "{} of the tool",
        without_place(calibrated.p - calibrated.nominal),
        without_place(calibrated.p - base.p),
        base.uncertainty,
        calibrated.uncertainty,
    )


def uncertain_effects(machine: Machine) -> tuple[tuple[str, float], ...]:
    """Effects that make most of the variance of the TCP, each with its share of their sum."""
    shares = variance_by_effect(machine)
    total = sum(shares.values())
    largest = ranked(shares.items(), lambda item: item[1])[:_MOST_NAMED]
    return tuple((name, share / total) for name, share in largest if total > 0)
