"""The TCP over the workspace: what is wrong now, and what stays unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.accuracy import Map, tcp_map, variance_by_effect, without_place, workspace
from orthoglide.fit import Estimate
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.ordering import ranked

_MOST_NAMED = 3


@dataclass(frozen=True, repr=False)
class Workspace:
    """The TCP over the workspace, best translation removed, metres."""

    # A regular grid (g, 3): travel from mechanical zero on the Orthoglide, else where the tool is
    # wanted. With screws, errors are of a place a part of a turn beside it.
    at: Array
    axis: str  # what its columns are, with the axis' name to fill in
    now: Array  # predicted error of a controller that knows of no error (g, 3)
    left: Array  # predicted error of one that knows of joint offsets and leg lengths (g, 3)
    sure_before: Array  # 95 % radius about the base model, everything else allowed (g,)
    sure: Array  # 95 % radius about the calibrated machine, everything else allowed (g,)

    @property
    def nominal(self) -> Array:
        """Length of ``now`` ``(g,)``."""
        return np.linalg.norm(self.now, axis=1)

    @property
    def before(self) -> Array:
        """Length of ``left`` ``(g,)``."""
        return np.linalg.norm(self.left, axis=1)

    def figures(self) -> dict[str, Array]:
        """By name in ``result.json``."""
        return {
            "predicted_error_nominal": self.nominal,
            "predicted_error_before": self.before,
            "uncertainty_95_before": self.sure_before,
            "uncertainty_95_after": self.sure,
        }


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
