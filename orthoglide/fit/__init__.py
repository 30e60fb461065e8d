"""Identification: from readings to parameters, with their uncertainty and cross-check.

In the order of the data:

- ``plausible``: readings that no such machine gives are refused.
- ``repeats``: noise that readings show, and ``noise``: the standard deviation of each reading.
- ``factors``: a table of readings with its noise and its instruments in place.
- ``unknowns``: the parameters to identify; ``problem``: unknowns and factors of an identification,
  ``assembling``: its construction, and the effects that its readings could show.
- ``least_squares``: the linear problem around a point, rows in units of their noise.
- ``solving``: choice of the method and tests of its answer; ``gauss_newton``: nested closures;
  ``nlp``: a programme with the closures as constraints.
- ``crosscheck``: comparison with the reduction, and with postures closed by Pinocchio.
- ``scores``: goodness of fit; ``estimate``: identified values with their uncertainty, and readings
  for figures; ``notes``, ``noise_notes``: notes for the user.
"""

from orthoglide.fit.assembling import (
    assemble as assemble,
    build_problem as build_problem,
    excited_effects as excited_effects,
    points_of as points_of,
    read_tables as read_tables,
    readings_of as readings_of,
    with_effects_freed as with_effects_freed,
    with_free as with_free,
)
from orthoglide.fit.crosscheck import CrossCheck as CrossCheck
from orthoglide.fit.estimate import Estimate as Estimate
from orthoglide.fit.factors import Factor as Factor
from orthoglide.fit.least_squares import (
    linearise as linearise,
    normal_equations as normal_equations,
)
from orthoglide.fit.noise import (
    PUBLISHED_REPEATABILITY as PUBLISHED_REPEATABILITY,
    Noise as Noise,
    expected_sigma as expected_sigma,
    noise_of as noise_of,
)
from orthoglide.fit.problem import Problem as Problem
from orthoglide.fit.repeats import common_rounding as common_rounding
from orthoglide.fit.solving import (
    refit_with_residual_noise as refit_with_residual_noise,
    solve as solve,
)
from orthoglide.fit.unknowns import weight_matrix as weight_matrix
