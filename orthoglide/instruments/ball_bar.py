"""A ball bar: the distance of the tool from a fixed ball."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments.instrument import (
    Instrument,
    Mounting,
    Nuisance,
    Pose,
    Varied,
    unit_vectors,
)

CENTRE_SD = 1e-3
"""How far the ball may be from where the readings have it, metres: more than a micrometre of theirs
leaves open, but across the plane of a circle, where they do not say."""


class BallBar(Instrument):
    """Lengths, or deviations of them, about a ball that stands somewhere near its place."""

    kind = "ballbar"
    words = "a ball bar"
    reads = "the ball bar"
    fill = "reading_mm is the bar's length, or how much longer it is than at some place"
    repeatability = 5e-6
    slip_alone = 1e-4
    about_ball = True

    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """The length from the ball."""
        return np.asarray(np.linalg.norm(pose.p - mounting.ball, axis=1))

    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """Away from the ball."""
        return {"p": unit_vectors(pose.p - mounting.ball)}

    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """The ball's centre and the bar's length."""
        toward = unit_vectors(p - mounting.ball)
        return [*((column, CENTRE_SD) for column in toward.T), (np.ones(len(p)), np.inf)]

    def displaced(
        self, p: Array, mounting: Mounting, draw: np.random.Generator, sd: float
    ) -> Array | None:
        """About a ball that stands elsewhere, by a bar of another length."""
        ball, length = mounting.ball + draw.normal(scale=sd, size=3), draw.normal(scale=sd)
        return np.asarray(np.linalg.norm(p - ball, axis=1) + length)
