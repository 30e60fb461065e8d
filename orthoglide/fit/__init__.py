"""Identification: from readings to parameters, with their uncertainty and cross-check."""

from orthoglide.fit.change import Change as Change
from orthoglide.fit.crosscheck import CrossCheck as CrossCheck
from orthoglide.fit.earlier import account_for_changes as account_for_changes
from orthoglide.fit.estimate import Estimate as Estimate
from orthoglide.fit.factors import Factor as Factor
from orthoglide.fit.identifying import (
    assemble as assemble,
    identify as identify,
    points_of as points_of,
    readings_of as readings_of,
    sorted_out as sorted_out,
)
from orthoglide.fit.noise import Noise as Noise, noise_of as noise_of
from orthoglide.fit.problem import Problem as Problem
from orthoglide.fit.scores import Scores as Scores
from orthoglide.fit.solving import solve as solve, tempered as tempered
from orthoglide.fit.unknowns import (
    build_problem as build_problem,
    with_free as with_free,
    with_others as with_others,
)
from orthoglide.fit.weakness import WeakDirection as WeakDirection
