"""Conditions and parameters in, poses and readings out, with sensitivities."""

from orthoglide.prediction.conditions import Conditions as Conditions
from orthoglide.prediction.model import Model as Model
from orthoglide.prediction.observed import (
    LinearRows as LinearRows,
    Observed as Observed,
    Seen as Seen,
)
