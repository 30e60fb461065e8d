"""A circle before and after calibration.

A machine with errors is measured with dials, identified from the readings alone, and then told
where to go: first by the nominal machine's commands, then by those of the identified one. The
error is that of the true machine at the TCP. ``python examples/compensate_path.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orthoglide import Machine, identify
from orthoglide.control import Compensation, compensate
from orthoglide.geometry import Array
from orthoglide.observations import Campaign
from orthoglide.observations.protocols import protocol

NOISE = 2e-6  # metres: a dial read to a hundredth and averaged
SEED = 1
TRUE = {
    "joint_offset.x": 1.1e-3, "joint_offset.y": -0.7e-3, "joint_offset.z": 0.4e-3,
    "leg_length.x": 3e-5, "axis_tilt.y.z": 1.4e-3, "backlash.x": 3e-5, "bar_mismatch.z": 4e-5,
    "axis_offset.z.x": 2e-4,
}  # fmt: skip
"""What the true machine has."""

FREE = ("joint_offset", "leg_length", "axis_tilt.y.z", "backlash.x", "bar_mismatch.z")
"""What is identified: not everything the machine has, as in life."""


@dataclass(frozen=True)
class Result:
    """Errors of the true TCP, metres: ``(n, 3)`` along a circle."""

    before: Array
    after: Array
    plan: Compensation


def circle(radius: float = 0.045, points: int = 72) -> Array:
    angle = np.linspace(0, 2 * np.pi, points)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.01 * np.cos(angle)], 1)


def measured(true: Machine, rng: np.random.Generator) -> Campaign:
    sheet = protocol("sweep")
    shown = true.readings(sheet) + rng.normal(0, NOISE, len(sheet))
    datum = rng.uniform(0, 1e-2, len(sheet.setups))[sheet.setup]
    return replace(sheet.with_readings(shown + datum), sigma=np.full(len(sheet), NOISE))


def run() -> Result:
    true = Machine.nominal().with_parameters(TRUE)
    estimate = identify(measured(true, np.random.default_rng(SEED)), free=FREE)
    goal = circle()
    plan = compensate(estimate.machine, goal)
    nominal = compensate(Machine.nominal(), goal)
    before = true.forward(nominal.rho, approach=nominal.approach) - goal
    after = true.forward(plan.rho, approach=plan.approach) - goal
    return Result(before, after, plan)


def mean_and_max(errors: Array) -> str:
    size = np.linalg.norm(errors, axis=1) * 1e3
    return f"{size.mean():.4f} mm on average, {size.max():.4f} mm at most"


def main() -> None:
    result = run()
    print(f"before: the TCP misses by {mean_and_max(result.before)}")
    print(f"after:  {mean_and_max(result.after)}")
    print("leg readings cannot see the machine move as a whole; after the best translation,")
    for name, errors in (("before", result.before), ("after", result.after)):
        print(f"  {name}: {mean_and_max(errors - errors.mean(axis=0))}")
    print(result.plan)


if __name__ == "__main__":
    main()
