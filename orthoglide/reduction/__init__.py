"""The analytic reduction: three drives, three bars, one point (Pashkevich et al. 2006, 2008).

``forward`` and ``inverse`` are the quadratic and eq. (3), ``jacobians`` eq. (5); ``system11``,
``covariance`` and ``solve`` the papers' linear calibration; ``observe`` and ``fit_readings`` the
same without linearising; ``intersect_spheres`` the general form, with carriages anywhere. A
derivation of its own: nothing here knows the general mechanism.
"""

from orthoglide.reduction.deviations import observe
from orthoglide.reduction.fit import ReadingFit, fit_readings
from orthoglide.reduction.kinematics import (
    CONFIGURATIONS,
    NOMINAL,
    forward,
    inverse,
    jacobians,
)
from orthoglide.reduction.linear import (
    COLUMNS,
    G,
    LinearFit,
    LinearSystem,
    coefficients,
    covariance,
    leg_deviations,
    reduced_system,
    solve,
    stroke_angles,
    system8,
    system11,
)
from orthoglide.reduction.spheres import intersect_spheres, reading
