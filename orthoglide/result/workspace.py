"""The TCP over the workspace: what is wrong now, and what stays unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.accuracy import Map, tcp_map, variance_by_effect, without_place
from orthoglide.fit import Estimate
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.posterior import full_posterior

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
        alone: 95 % radius about the calibrated machine, as if nothing else were wrong.
    """

    travel: Array
    nominal: Array
    before: Array
    sure_before: Array
    sure: Array
    alone: Array

    def figures(self) -> dict[str, Array]:
        """By name in ``result.json``."""
        return {
            "predicted_error_nominal": self.nominal,
            "predicted_error_before": self.before,
            "uncertainty_95_before": self.sure_before,
            "uncertainty_95_after": self.sure,
            "uncertainty_95_after_alone": self.alone,
        }


def workspace_of(before: Estimate, after: Estimate, calibrated: Map) -> Workspace:
    """The workspace by the base model and by the calibrated machine.

    Args:
        before: fit of the base model.
        after: the final fit.
        calibrated: map of the calibrated machine.
    """
    start, posterior = before.problem.machine, full_posterior(before)
    base = tcp_map(start.with_posterior(before.machine.values, posterior.machine))
    return Workspace(
        calibrated.commands - start.geometry.zero,
        calibrated.error,
        np.linalg.norm(without_place(calibrated.p - base.p), axis=1),
        base.uncertainty,
        calibrated.uncertainty,
        tcp_map(after.machine).uncertainty,
    )


def uncertain_effects(machine: Machine) -> tuple[tuple[str, float], ...]:
    """Effects that make most of the variance of the TCP, each with its share of their sum."""
    shares = variance_by_effect(machine)
    total = sum(shares.values())
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:_MOST_NAMED]
    return tuple((name, share / total) for name, share in ranked if total > 0)
