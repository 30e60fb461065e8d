"""Kinematics of the Orthoglide, section 2 of the 2008 chapter, by both derivations.

``python examples/kinematics.py``: the inverse problem (3), the direct problem (4) with both
assembly modes, the Jacobian (5), and the general closed-loop mechanism beside the reduction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide import Geometry, Machine, Mechanism, reduction
from orthoglide.geometry import Array

MM = 1e-3


@dataclass(frozen=True)
class Shown:
    """What the example prints, SI.

    Attributes:
        p: the wanted TCP.
        rho: the command for it.
        modes: TCP of both assembly modes for that command, by the reduction and the mechanism.
        jacobian: dp/drho, by the reduction and by the mechanism.
        tcp: largest distance between reduction and mechanism over the stroke.
        moved: TCP of a machine with errors less the nominal TCP, for the same command.
        corrected: the command that brings that machine to p.
    """

    p: Array
    rho: Array
    modes: dict[str, tuple[Array, Array]]
    jacobian: tuple[Array, Array]
    tcp: float
    moved: Array
    corrected: Array


def compute() -> Shown:
    """Everything below, without printing it."""
    p = np.array([20.0, -30.0, 10.0]) * MM
    mechanism = Mechanism(Geometry())

    # (3): rho_i = p_i + s_i sqrt(L^2 - p_j^2 - p_k^2), the machine's own signs (+, +, +)
    rho = reduction.inverse(p)

    # (4): a quadratic, so two assembly modes
    modes = {
        mode: (reduction.forward(rho, mode=mode), mechanism.close(rho, mode=mode).p)
        for mode in ("machine", "other")
    }

    # (5): the velocity Jacobian
    jacobian = (
        reduction.jacobians(p, rho).rho,
        mechanism.velocity_jacobian(mechanism.close(rho)),
    )

    # general against simplified, over the stroke
    rng = np.random.default_rng(0)
    commands = rng.uniform(210.25, 370.25, (1000, 3)) * MM
    machine = Machine.nominal()
    apart = np.linalg.norm(machine.forward(commands) - reduction.forward(commands), axis=-1)

    # what only the general model has: a crooked axis, bars of two lengths in one leg
    crooked = machine.with_parameters({"axis_tilt.y.z": 1e-3, "bar_mismatch.x": 0.1 * MM})
    moved = crooked.forward(rho) - machine.forward(rho)
    return Shown(p, rho, modes, jacobian, float(apart.max()), moved, crooked.inverse(p))


def _mm(values: Array) -> str:
    return "(" + ", ".join(f"{v / MM:9.4f}" for v in values) + ") mm"


def main() -> None:
    shown = compute()
    print(f"TCP wanted                      {_mm(shown.p)}")
    print(f"command, inverse problem (3)    {_mm(shown.rho)}")
    for mode, (reduced, general) in shown.modes.items():
        print(f"TCP, assembly mode {mode!r:11}  {_mm(reduced)}   mechanism {_mm(general)}")
    print("Jacobian dp/drho, (5) / mechanism:")
    for one, other in zip(*shown.jacobian, strict=True):
        print("  " + "   ".join(" ".join(f"{v:+.6f}" for v in row) for row in (one, other)))
    print(f"reduction and mechanism over 1000 commands: at most {shown.tcp:.1e} m apart")
    print("a machine with axis y tilted 1 mrad toward z and a 0.1 mm bar mismatch in leg x:")
    print(f"  its TCP is off by             {_mm(shown.moved)}")
    print(f"  command that makes up for it  {_mm(shown.corrected)}")


if __name__ == "__main__":
    main()
