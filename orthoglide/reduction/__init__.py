"""The analytic reduction: three drives, three bars, one point (Pashkevich et al. 2006, 2008).

``forward`` and ``inverse`` are the quadratic and eq. (3), ``jacobians`` eq. (5); ``system11``,
``covariance`` and ``solve`` the papers' linear calibration; ``predict_readings`` the readings of
any dials; ``intersect_spheres`` the general form, with carriages anywhere.
The derivation is independent of the general mechanism.
"""

from orthoglide.reduction.deviations import predict_readings as predict_readings
from orthoglide.reduction.kinematics import (
    NOMINAL as NOMINAL,
    forward as forward,
    inverse as inverse,
    jacobians as jacobians,
)
from orthoglide.reduction.linear import (
    COLUMNS as COLUMNS,
    G as G,
    LinearFit as LinearFit,
    LinearSystem as LinearSystem,
    coefficients as coefficients,
    covariance as covariance,
    reduced_system as reduced_system,
    solve as solve,
    stroke_angles as stroke_angles,
    system8 as system8,
    system11 as system11,
)
from orthoglide.reduction.spheres import intersect_spheres as intersect_spheres
