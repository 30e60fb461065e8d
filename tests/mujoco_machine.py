"""The machine in MuJoCo: an independent witness, and the yardstick of the benchmark.

``six_bar_mjcf`` is a machine written by hand as MJCF, with MuJoCo's own equality constraints: a
free platform on six bars, each on a universal joint at its carriage and ``connect``-ed to the
platform. Nothing of the package is used: dimensions come in as numbers. ``MujocoMachine`` closes
the loops of this MJCF, and of those that the package writes, with Newton steps on MuJoCo's
constraint Jacobian.

SI units; leg i has the axes a, b, c = e_i, e_(i+1), e_(i+2), bars run from the carriage toward -a,
bar 1 is on the +c side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv, dposv

Array = NDArray[np.float64]
LEGS = "xyz"
# Moving bodies must weigh something; kinematics does not ask how much.
_MASS = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
_HEAD = (
    '<mujoco><compiler angle="radian" autolimits="false"/>'
    '<option jacobian="dense" gravity="0 0 0"><flag contact="disable"/></option><worldbody>'
)


@dataclass(frozen=True)
class Dimensions:
    """Nominal dimensions, metres.

    Attributes:
        L, d, r: bar length, short link, distance from the TCP to each leg's attachment.
    """

    L: float = 0.31025
    d: float = 0.08
    r: float = 0.031


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(v)) for v in values)


def six_bar_mjcf(size: Dimensions) -> str:
    """A rigid platform on six bars."""
    carriages, ends, loops = [], [], []
    for leg, n in enumerate(LEGS):
        a, b, c = np.roll(np.eye(3), -leg, axis=0)
        bars = []
        for bar, side in ((1, 1.0), (2, -1.0)):
            where = side * c * size.d / 2
            bars.append(
                f'<body pos="{_text(where)}">'
                f'<joint name="{n}{bar}_b" type="hinge" axis="{_text(b)}"/>'
                f'<joint name="{n}{bar}_c" type="hinge" axis="{_text(c)}"/>{_MASS}'
                f'<site name="{n}{bar}_tip" pos="{_text(-a * size.L)}"/></body>'
            )
            ends.append(f'<site name="{n}{bar}_end" pos="{_text(a * size.r + where)}"/>')
            loops.append(f'<connect site1="{n}{bar}_tip" site2="{n}{bar}_end"/>')
        carriages.append(
            f'<body pos="{_text(a * (size.L + size.r))}">'
            f'<joint name="{n}_slide" type="slide" axis="{_text(a)}"/>{_MASS}{"".join(bars)}</body>'
        )
    middle = f'<body><freejoint name="platform"/>{_MASS}<site name="x_tcp"/>{"".join(ends)}</body>'
    return (
        f"{_HEAD}{''.join(carriages)}{middle}</worldbody>"
        f"<equality>{''.join(loops)}</equality></mujoco>"
    )


class MujocoMachine:
    """Closes the loops of an MJCF whose joints ``x_slide`` ... are the drives.

    Args:
        mjcf: as ``six_bar_mjcf`` or ``orthoglide.mechanism.mjcf.to_mjcf`` write it.
        length: L, metres: the drives stand at rho - L; 0 where commands are travel.
        legs: names of the legs.
    """

    def __init__(self, mjcf: str, length: float, legs: Sequence[str] = LEGS) -> None:
        self.model = mujoco.MjModel.from_xml_string(mjcf)
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self.data = mujoco.MjData(self.model)
        self.length = length
        joints = [self.model.joint(f"{n}_slide") for n in legs]
        self._drives = np.array([int(j.qposadr[0]) for j in joints])
        moved = [int(j.dofadr[0]) for j in joints]
        self._free = np.setdiff1d(np.arange(self.model.nv), moved)
        self._tcp = self.model.site(f"{legs[0]}_tcp").id
        self.steps = 0

    def close(self, rho: Array, guess: Array | None = None) -> Any:
        """Newton on MuJoCo's constraint Jacobian from the assembled machine at zero.

        Args:
            rho: command ``(3,)``, metres.
            guess: joints ``(nq,)`` to start from.

        Returns:
            MuJoCo's data at the closed pose (overwritten by the next call).

        Raises:
            ArithmeticError: where the loops do not close.
        """
        model, data, free = self.model, self.data, self._free
        data.qpos[:] = model.qpos0 if guess is None else guess
        data.qpos[self._drives] = rho - self.length
        step = np.zeros(model.nv)
        for self.steps in range(1, 40):
            self._constrain()
            residual = data.efc_pos
            matrix = data.efc_J.reshape(data.nefc, model.nv)[:, free]
            if len(residual) == len(free):
                step[free] = -dgesv(matrix, residual)[2]
            else:  # rows that repeat others: the step of least squares
                step[free] = -dposv(matrix.T @ matrix, residual @ matrix)[1]
            largest = float(np.abs(step).max())
            mujoco.mj_integratePos(model, data.qpos, step, min(1.0, 0.5 / max(largest, 0.5)))
            if largest < 1e-8:  # quadratic: the step just made leaves its square
                break
        self._constrain()
        if not np.abs(data.efc_pos).max() < 1e-11:
            raise ArithmeticError("MuJoCo's loops do not close")
        return data

    def _constrain(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_makeConstraint(self.model, self.data)

    def pose(self, rho: Array) -> tuple[Array, Array]:
        """TCP ``(3,)`` and rotation of the platform ``(3, 3)`` of a command ``(3,)``."""
        data = self.close(rho)
        return data.site_xpos[self._tcp].copy(), data.site_xmat[self._tcp].reshape(3, 3).copy()
