"""Dimensions that were measured on the machine itself, by a calliper, a rule or a jig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.effects import Catalogue
from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.parameters import Parameter

MEASURED_TRAVEL = 0.1
"""Commanded travel for the measurement of a carriage's travel, metres: the length of a rule."""

_DRIVE_SCALE_SD = 1e-3
"""Standard deviation of the scale between drives of one machine: belts stretch differently."""

_MAX_RELATIVE_DEVIATION = 0.5  # from the nominal length: beyond, the unit or the part is another

Pair = tuple[float, float]


@dataclass(frozen=True)
class Measured:
    """Measured lengths with their standard deviations.

    Attributes:
        rods: mean length of the bars between their pivots, metres.
        travel: mean travel of the carriages at a command of `MEASURED_TRAVEL`, metres.

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
        SI.

        The common part has the variance of the measurement. Single bars differ by their tolerance,
        single drives by `_DRIVE_SCALE_SD`.

        Raises:
            InputError: where a length differs from the nominal one by more than half.
        """
        for key, pair, quantity, nominal, scale in (
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
            (name,) = (effect for effect in catalogue.correctable_by(quantity))
            spread = tolerance[name] if quantity == "bar_length" else _DRIVE_SCALE_SD
            value, sigma = (pair[0] - nominal) * scale, pair[1] * scale
            covariance = np.full((3, 3), sigma**2) + spread**2 * np.eye(3)
            yield catalogue[name].parameters(), value, covariance
