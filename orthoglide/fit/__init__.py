"""Identification: from readings to parameters, with their uncertainty and cross-check."""

from orthoglide.fit.assembling import (
    assemble as assemble,
    points_of as points_of,
    readings_of as readings_of,
    sorted_out as sorted_out,
)
from orthoglide.fit.crosscheck import CrossCheck as CrossCheck
from orthoglide.fit.estimate import Estimate as Estimate
from orthoglide.fit.excited import excited_effects as excited_effects
from orthoglide.fit.factors import Factor as Factor
from orthoglide.fit.least_squares import linearise as linearise, normal as normal
from orthoglide.fit.noise import (
    PUBLISHED_REPEATABILITY as PUBLISHED_REPEATABILITY,
    Noise as Noise,
    expected_sigma as expected_sigma,
    noise_of as noise_of,
)
from orthoglide.fit.problem import Problem as Problem
from orthoglide.fit.repeats import common_rounding as common_rounding
from orthoglide.fit.scores import Scores as Scores
from orthoglide.fit.solving import solve as solve, tempered as tempered
from orthoglide.fit.unknown import weight_matrix as weight_matrix
from orthoglide.fit.unknowns import (
    build_problem as build_problem,
    with_free as with_free,
    with_others as with_others,
)
from orthoglide.fit.weakness import WeakDirection as WeakDirection
