"""Conditions and parameters -> poses and readings, with sensitivities to all parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.prediction.measurement_model import LinearRows, MeasurementModel
from orthoglide.prediction.moved_mechanism import MovedMechanism


@dataclass(frozen=True, eq=False)
class Model(MovedMechanism):
    """The general mechanism moved by the catalogue's effects, and the readings of instruments."""

    def readings(self, values: Mapping[str, float], readings: Readings) -> Array:
        """Return predicted readings ``(n,)`` of instruments in the base frame, no nuisances."""
        return MeasurementModel(readings).predict(self, values)

    def linearised(
        self, values: Mapping[str, float], readings: Readings, names: Sequence[str]
    ) -> LinearRows:
        """Return predicted readings with their derivative by parameters; see
        :meth:`MeasurementModel.linearise`.
        """
        return MeasurementModel(readings).linearise(self, values, names)
