"""Conditions and parameters in, poses and readings out, with sensitivities."""

from orthoglide.prediction.conditions import Conditions as Conditions
from orthoglide.prediction.model import LinearRows as LinearRows, Model as Model
