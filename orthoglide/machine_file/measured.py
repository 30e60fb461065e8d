"""Lengths that were measured on the machine itself."""

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


def _differs(measured: Pair, nominal: float) -> bool:
    """Return whether a measured length differs from the nominal one beyond the uncertainty."""
    return abs(measured[0] - nominal) > max(2 * measured[1], _DRIVE_SCALE_SD * nominal)


@dataclass(frozen=True)
class Measured:
    """Measured lengths with their standard deviations."""

    rods: Pair | None = None  # mean length of the bars between their pivots, metres
    # mean travel of the carriages at a command of `MEASURED_TRAVEL`, metres
    travel: Pair | None = None

    def contradictions(self, nominal_rods: float) -> tuple[str, str]:
        """Return that travel, and that rods, differ from those by which the controller computes, a
        sentence each, empty if they do not.
        """
        travel, rods = self.travel or (MEASURED_TRAVEL, 0.0), self.rods or (nominal_rods, 0.0)
        of_travel = (
            f"Carriages move {travel[0] * 1e3:.2f} mm at a command of 100 mm: first multiply "
            f"rotation_distance by {travel[0] / MEASURED_TRAVEL:.4f}, or divide the steps per "
            f"millimetre by it."
        )
        of_rods = (
            f"The rods measure {rods[0] * 1e3:.1f} mm, the controller has "
            f"{nominal_rods * 1e3:.1f} mm: all its sizes were fitted with that length, and change "
            f"with it."
        )
        return of_travel * _differs(travel, MEASURED_TRAVEL), of_rods * _differs(rods, nominal_rods)

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
