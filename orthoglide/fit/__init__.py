"""Identification: from readings to parameters, with their uncertainty and cross-check."""

from orthoglide.fit.change import Change
from orthoglide.fit.crosscheck import CrossCheck
from orthoglide.fit.earlier import account_for_changes
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.factors import Frame
from orthoglide.fit.identifying import (
    Source,
    assemble,
    identify,
    readings_of,
    sorted_out,
)
from orthoglide.fit.noise import Noise, noise_of
from orthoglide.fit.problem import Problem, Unknown
from orthoglide.fit.scores import Scores
from orthoglide.fit.solving import Method, solve
from orthoglide.fit.unknowns import build_problem, build_unknowns, with_free, with_others
from orthoglide.fit.weakness import WeakDirection
