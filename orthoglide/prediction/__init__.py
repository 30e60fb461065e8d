"""Conditions and parameters in, poses and readings out, with sensitivities."""

from orthoglide.prediction.conditions import Conditions as Conditions
from orthoglide.prediction.measurement_model import (
    MeasurementModel as MeasurementModel,
    ReadingPoses as ReadingPoses,
)
from orthoglide.prediction.model import Model as Model
