"""The TCP over the workspace: what is wrong now, and what stays unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.accuracy import Knowledge, Map, knowledge, tcp_map
from orthoglide.fit import Estimate
from orthoglide.geometry import Array
from orthoglide.prediction import Conditions

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


def workspace_of(before: Estimate, values: Mapping[str, float], after: Map) -> Workspace:
    """The workspace by the base model and by the calibrated machine.

    Args:
        before: fit of the base model.
        values: its parameters, SI.
        after: map of the calibrated machine.
    """
    base = tcp_map(before, knowledge(before), values)
    apart = after.p - base.p
    return Workspace(
        after.commands - before.problem.machine.geometry.L,
        after.error,
        np.linalg.norm(apart - apart.mean(axis=0), axis=1),
        base.uncertainty,
        after.uncertainty,
        1.96 * np.linalg.norm(after.sigma, axis=1),
    )


def uncertain_effects(
    after: Estimate, values: Mapping[str, float], known: Knowledge, commands: Array
) -> tuple[tuple[str, float], ...]:
    """Effects that make most of the variance of the TCP, each with its share of their sum.

    Args:
        after: the final fit.
        values: of the calibrated machine, SI.
        known: what the readings say with everything else allowed.
        commands: ``(g, 3)``, metres.
    """
    catalogue, model = after.problem.machine.catalogue, after.problem.machine.model
    _, by_theta = model.sensitivities(values, Conditions.at(commands), catalogue.parameters)
    slope = by_theta[:, :3] @ known.weights
    slope = slope - slope.mean(axis=0)
    names = [catalogue.effect_of(n).name for n in known.names]
    shares: dict[str, float] = {}
    for name in dict.fromkeys(n for n in names if not catalogue[n].of_dial):
        members = np.array([n == name for n in names])
        part = slope[:, :, members]
        block = known.covariance[np.ix_(members, members)]
        shares[name] = float(np.einsum("gie,ef,gif->", part, block, part))
    total = sum(shares.values())
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:_MOST_NAMED]
    return tuple((name, share / total) for name, share in ranked if total > 0)
