"""What an owner measured on the machine itself, by a calliper, a rule or a jig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.effects import Catalogue
from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.parameters import Parameter

MEASURED_TRAVEL = 0.1
"""Metres that a carriage is told to go for the measurement of its travel: a rule's length."""

_DRIVE_SCALE_SD = 1e-3
"""Ratio by which drives of one kind differ: pulleys are alike, and belts stretch."""

_MAX_RELATIVE_DEVIATION = (
    0.5  # of the nominal length: what differs by more is in another unit, or of another part
)

Pair = tuple[float, float]


@dataclass(frozen=True)
class Measured:
    """Sizes with their standard deviations.

    Attributes:
        rods: length of the bars between their pivots, in the mean of all, metres.
        travel: how far a carriage went that was told to go `TRAVEL`, in the mean of all, metres.

    Raises:
        InputError: where a length or a standard deviation is not above 0.
    """

    rods: Pair | None = None
    travel: Pair | None = None

    def __post_init__(self) -> None:
        for name, pair in (("rods_mm", self.rods), ("travel_of_100_mm", self.travel)):
            if pair is not None and not (pair[0] > 0 and pair[1] > 0):
                raise InputError(
                    f"{name} is a length and its standard deviation, both above 0: "
                    f"correct it to [length, sigma]"
                )

    def parameter_priors(
        self, catalogue: Catalogue, geometry: Geometry, tolerance: Mapping[str, float]
    ) -> Iterator[tuple[tuple[Parameter, ...], float, Array]]:
        """Yield parameters, the measured deviation of their mean, and their covariance ``(3, 3)``,
        SI. The common part has the variance of the measurement; single bars differ by their
        tolerance, and single drives by `_BELTS`.

        Raises:
            InputError: where a length differs from the nominal one by more than half.
        """
        for key, pair, held, nominal, scale in (
            ("rods_mm", self.rods, "bar_length", geometry.L, 1.0),
            ("travel_of_100_mm", self.travel, "scale", MEASURED_TRAVEL, 1 / MEASURED_TRAVEL),
        ):
            if pair is None:
                continue
            if abs(pair[0] / nominal - 1) > _MAX_RELATIVE_DEVIATION:
                raise InputError(
                    f"{key} is {pair[0] * 1e3:g} mm, where the machine has {nominal * 1e3:g} mm by "
                    f"its other numbers: correct one of them, in millimetres"
                )
            (name,) = (effect for effect in catalogue.correctable_by(held))
            each = tolerance[name] if held == "bar_length" else _DRIVE_SCALE_SD
            value, sigma = (pair[0] - nominal) * scale, pair[1] * scale
            covariance = np.full((3, 3), sigma**2) + each**2 * np.eye(3)
            yield catalogue[name].parameters(), value, covariance
