"""Close one posture of the Orthoglide with Pinocchio's constraint Jacobian.

``python examples/pinocchio_closure.py`` loads ``urdf/orthoglide.urdf``, turns the loop closures
beside it into constraint models, solves them by Newton's method, and compares the tool with the
quadratic of the 2008 chapter, eq. (4).
"""

import numpy as np
import pinocchio as pin

import orthoglide as og
from orthoglide import reduction
from orthoglide.mechanism.mechanism import Constraints
from orthoglide.mechanism.tree import load

rho = np.array([0.300, 0.310, 0.325])  # commands of the drives, metres

tree = load()  # pin.buildModelFromUrdf, and the closures read from the file beside it
constraints = Constraints(tree)  # three point anchors, two frame anchors: 21 rows
print(f"{tree.model.njoints - 1} joints, {len(tree.loops)} loops")

q = pin.neutral(tree.model)
q[tree.drive] = rho - og.Geometry().zero  # slides count from mechanical zero
for step in range(10):
    residual = constraints.residual(q)
    print(f"step {step}: largest closure residual {np.abs(residual).max():.1e}")
    if np.abs(residual).max() < 1e-12:
        break
    jacobian = constraints.newton_matrix()[:, tree.passive]
    # Planar loops closed in space repeat rows: least squares, of rank 15.
    q[tree.passive] -= np.linalg.lstsq(jacobian, residual, rcond=1e-9)[0]

for loop, misfit in tree.by_loop(residual).items():
    print(f"  {loop:16} {misfit:.1e}")

tcp = pin.updateFramePlacement(tree.model, constraints.data, tree.frame(tree.tool)).translation
expected = reduction.forward(rho)
print("TCP in mm:         ", np.round(1e3 * tcp, 6))
print("by the quadratic:  ", np.round(1e3 * expected, 6))
print(f"difference:         {1e3 * np.abs(tcp - expected).max():.1e} mm")
print(og.Mechanism().mobility(rho))
