"""The analytic reduction: three drives, three bars, one point (Pashkevich et al. 2006, 2008).

``forward`` and ``inverse`` are the quadratic and eq. (3), ``jacobians`` eq. (5); ``system11``,
``covariance`` and ``solve`` the papers' linear calibration; ``readings`` and ``fit_readings`` the
same without linearising; ``intersect_spheres`` the general form, with carriages anywhere. A
derivation of its own: nothing here knows the general mechanism.
"""

from orthoglide.reduction.deviations import reading_jacobian, readings
from orthoglide.reduction.fit import ReadingFit, fit_readings
from orthoglide.reduction.kinematics import (
    CONFIGURATIONS,
    NOMINAL,
    Jacobians,
    forward,
    inverse,
    jacobians,
    velocity_jacobian,
)
from orthoglide.reduction.linear import (
    COLUMNS,
    Coefficients,
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
from orthoglide.reduction.spheres import (
    Mode,
    SphereDerivatives,
    intersect_spheres,
    reading,
    reading_derivatives,
    sphere_derivatives,
)

__all__ = [
    "COLUMNS",
    "CONFIGURATIONS",
    "NOMINAL",
    "Coefficients",
    "G",
    "Jacobians",
    "LinearFit",
    "LinearSystem",
    "Mode",
    "ReadingFit",
    "SphereDerivatives",
    "coefficients",
    "covariance",
    "fit_readings",
    "forward",
    "intersect_spheres",
    "inverse",
    "jacobians",
    "leg_deviations",
    "reading",
    "reading_derivatives",
    "reading_jacobian",
    "readings",
    "reduced_system",
    "solve",
    "sphere_derivatives",
    "stroke_angles",
    "system8",
    "system11",
    "velocity_jacobian",
]
