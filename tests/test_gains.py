"""The error budget: what mending is said to gain is what mending gains."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import gains
from benchmarks.public import machine
from orthoglide.explanation.budget import _Controller
from orthoglide.explanation.linear_model import Group, LinearModel, identity_group
from orthoglide.explanation.mixture import Mixture


@pytest.mark.thorough
def test_a_cause_gains_what_was_said() -> None:
    record = gains.run((1, "two-gauges", 1), 1)
    (item,) = [i for i in record["items"] if i["named"]]
    for how in ("repaired", "compensated"):
        gain, sigma = item["said"][how]
        assert gain == pytest.approx(item[how], rel=0.1)
        assert abs(gain - item[how]) <= 1.96 * sigma + gains.LEAST
    assert "| repaired | causes named | 1 |" in gains.tables([record])[0].markdown()


def test_the_best_zeros_and_lengths_leave_nothing_of_zeros_and_lengths() -> None:
    worn = machine().with_parameters({"joint_offset.x": 2e-3, "bar_mismatch.z": 2e-3})
    controller = _Controller.of(worn)
    plain = {"joint_offset.x": 4e-3, "joint_offset.y": -3e-3, "leg_length.z": 2e-4}
    assert np.abs(controller.residual_of(plain)).max() < 1e-6  # of millimetres
    left = np.linalg.norm(controller.residual_of(dict(worn.values)).reshape(-1, 3), axis=1).mean()
    other = gains.Tool().error(gains.Rig(errors=dict(worn.values)))
    assert 1e3 * left == pytest.approx(other, rel=1e-3)


def test_two_causes_are_found_that_an_effect_whole_could_draw() -> None:
    rng, sound = np.random.default_rng(0), 30
    basis = np.linalg.qr(rng.standard_normal((60, 4 + sound)))[0]
    whole_effect = 3e4 * basis[:, :3]
    other = whole_effect.sum(axis=1, keepdims=True) / np.sqrt(3) + 2.0 * basis[:, 3:4]
    # The rest of the machine is seen to be sound: no background draws anything.
    columns = np.hstack([whole_effect, other, 3e4 * basis[:, 4:]])
    groups: list[Group] = [
        identity_group(f"single.{k}", [k], free_form=False) for k in range(4 + sound)
    ]
    groups.append(identity_group("single", [0, 1, 2], free_form=False))
    noise = rng.standard_normal(60)
    noise -= basis[:, :4] @ (basis[:, :4].T @ noise)
    residual = 2.0 * columns[:, 0] - 1.7 * columns[:, 3] + noise
    count = columns.shape[1]
    linear = LinearModel(
        columns, residual, np.full(count, np.nan), np.zeros(count, bool), np.zeros(count, bool),
        tuple(groups), np.zeros((60, 1)),
    )  # fmt: skip
    mixture = Mixture(linear)
    assert {groups[k].name for k, _ in mixture.best} == {"single.0", "single.3"}
