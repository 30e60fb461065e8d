"""Dials on the legs and a tracker at the tool in one campaign, on the independent machine."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.verdict import Verdict, close_loop
from tests import rig_campaigns as rc
from tests.rig import Rig

MACHINE = Machine.load(Path(__file__).parent / "data" / "rig" / "machine.toml")
RIG = Rig(
    errors={
        "joint_offset.x": 8e-4, "joint_offset.y": -5e-4, "joint_offset.z": 3e-4,
        "leg_length.x": 4e-5, "leg_length.y": -3e-5, "axis_offset.y.x": 6e-4,
    }
)  # fmt: skip


def tracked(count: int, noise: float, rng: np.random.Generator) -> Readings:
    table = rc.tcp_points(RIG, count, rng)
    command = np.array([[row[k] for k in rc.RHO] for row in table]) * 1e-3
    p = np.array([[row[f"p_{x}_mm"] for x in "xyz"] for row in table]) * 1e-3
    p += noise * rng.standard_normal(p.shape)
    unknown = np.full(count, noise or np.nan)
    return Readings.from_points(command, p, unknown)


@cache
def verdicts() -> dict[str, Verdict]:
    rng = np.random.default_rng(5)
    rows = rc.simulate(RIG, rc.protocol_rows("standard"), rng)
    dials = Readings.from_frame({k: [row[k] for row in rows] for k in rows[0]}, name="dials")
    tracker, judge = tracked(12, 3e-5, rng), tracked(60, 0.0, rng)
    given = {"dials": [dials], "tracker": [tracker], "both": [dials, tracker]}
    return {n: close_loop(g, MACHINE, tcp=judge, frame="none") for n, g in given.items()}


@pytest.mark.thorough
def test_both_together_know_the_tool_better_than_either() -> None:
    after = {n: {k: e.after[0] for k, e in (v.tcp or {}).items()} for n, v in verdicts().items()}
    for kind in ("none", "translation"):
        assert after["both"][kind] < 0.8 * min(after["dials"][kind], after["tracker"][kind])
    assert after["both"]["translation"] < 3e-6


@pytest.mark.thorough
def test_a_rail_offset_that_dials_cannot_place_is_told() -> None:
    """To dials the y rail beside its place and the z rail, the other way, are one machine moved."""
    one, both = verdicts()["dials"].effects, verdicts()["both"].effects
    assert {e.name for e in one[0].explanations} == {"axis_offset.y.x", "axis_offset.z.x"}
    assert [e.name for c in both for e in c.explanations] == ["axis_offset.y.x"]
    assert abs(both[0].chosen.values["axis_offset.y.x"] - 6e-4) < 5e-5
