"""Identification: from dial readings to parameters, with their uncertainty and cross-check."""

from orthoglide.identification.crosscheck import CrossCheck
from orthoglide.identification.estimate import Estimate
from orthoglide.identification.noise import Noise, noise_of
from orthoglide.identification.problem import Problem, Unknown, build_problem
from orthoglide.identification.scores import Scores
from orthoglide.identification.solving import Method, identify, solve
from orthoglide.identification.weakness import WeakDirection

__all__ = [
    "CrossCheck",
    "Estimate",
    "Method",
    "Noise",
    "Problem",
    "Scores",
    "Unknown",
    "WeakDirection",
    "build_problem",
    "identify",
    "noise_of",
    "solve",
]
