"""Identification: from dial readings to parameters, with their uncertainty and cross-check."""

from orthoglide.fit.crosscheck import CrossCheck
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.noise import Noise, noise_of
from orthoglide.fit.problem import Problem, Unknown, build_problem
from orthoglide.fit.scores import Scores
from orthoglide.fit.solving import Method, identify, solve
from orthoglide.fit.weakness import WeakDirection

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
