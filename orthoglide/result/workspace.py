"""The TCP over the workspace: what is wrong now, and what stays unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.accuracy import Map, tcp_map, variance_by_effect, without_place
from orthoglide.fit import Estimate
from orthoglide.geometry import Array
from orthoglide.machine import Machine

_MOST_NAMED = 3


@dataclass(frozen=True)
class Workspace:
    """The TCP over the workspace, best translation removed, metres ``(g,)`` each.

    Attributes:
        travel: from mechanical zero ``(g, 3)``.
        nominal: predicted error of a controller that knows of no error.
        before: predicted error of one that knows of joint offsets and leg lengths.
        sure_before: 95 % radius about the base model, everything else allowed.
        sure: 95 % radius about the calibrated machine, everything else allowed.
    """

    travel: Array
    nominal: Array
    before: Array
    sure_before: Array
    sure: Array

    def figures(self) -> dict[str, Array]:
        """By name in ``result.json``."""
        return {
            "predicted_error_nominal": self.nominal,
            "predicted_error_before": self.before,
            "uncertainty_95_before": self.sure_before,
            "uncertainty_95_after": self.sure,
        }


def workspace_of(before: Estimate, known: Machine, calibrated: Map) -> Workspace:
    """The workspace by the base model and by the calibrated machine.

    Args:
        before: fit of the base model.
        known: the posterior's machine.
        calibrated: map of the calibrated machine.
    """
    base = tcp_map(known.with_posterior(before.machine.values, known.posterior))
    return Workspace(
        calibrated.commands - known.geometry.zero,
        calibrated.error,
        np.linalg.norm(without_place(calibrated.p - base.p), axis=1),
        base.uncertainty,
        calibrated.uncertainty,
    )


def uncertain_effects(machine: Machine) -> tuple[tuple[str, float], ...]:
    """Effects that make most of the variance of the TCP, each with its share of their sum."""
    shares = variance_by_effect(machine)
    total = sum(shares.values())
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:_MOST_NAMED]
    return tuple((name, share / total) for name, share in ranked if total > 0)
