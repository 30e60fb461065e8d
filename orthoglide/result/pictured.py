"""A result as pictures show it: the machine with what was found, and the TCP over the workspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.geometry import Array
from orthoglide.result.codec import MetresField, in_mm_short
from orthoglide.scene import Dial, Option, Posed, drawing


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A drawing of what was found."""

    posed: Posed  # the nominal machine at mechanical zero
    dials: tuple[Dial, ...]  # where they stood
    # explanations, found ones in order, each followed by what else it could be
    options: tuple[Option, ...]
    first: tuple[int, ...]  # which options are the most probable of what was found

    def svg(self, alone: bool = False) -> str:
        """Return the drawing as SVG; ``alone``: as a file of its own."""
        title = "The machine, what was found marked on it" if self.options else "The machine"
        return drawing(
            self.posed, self.options, self.dials, title=title, shown=self.first, alone=alone
        )


@dataclass(frozen=True, eq=False, repr=False)
class Workspace:
    """The TCP over the workspace, best translation removed, metres."""

    # A regular grid (g, 3): travel from mechanical zero on the Orthoglide, else where the tool is
    # wanted. With screws, errors are of a place a part of a turn beside it.
    at: MetresField
    axis: str  # what its columns are, with the axis' name to fill in
    now: MetresField  # predicted error of a controller that knows of no error (g, 3)
    left: MetresField  # predicted error of one that knows of joint offsets and leg lengths (g, 3)
    sure_before: MetresField  # 95 % radius about the base model, everything else allowed (g,)
    sure: MetresField  # 95 % radius about the calibrated machine, everything else allowed (g,)

    @property
    def nominal(self) -> Array:
        """Length of ``now`` ``(g,)``."""
        return np.linalg.norm(self.now, axis=1)

    @property
    def before(self) -> Array:
        """Length of ``left`` ``(g,)``."""
        return np.linalg.norm(self.left, axis=1)

    def derived(self) -> dict[str, Any]:
        """Keys of ``result.json`` that follow from the others: mean and largest."""
        figures = {
            "predicted_error_nominal": self.nominal,
            "predicted_error_before": self.before,
            "uncertainty_95_before": self.sure_before,
            "uncertainty_95_after": self.sure,
        }
        return {
            name: {"mean_mm": in_mm_short(float(v.mean())), "max_mm": in_mm_short(float(v.max()))}
            for name, v in figures.items()
        }
