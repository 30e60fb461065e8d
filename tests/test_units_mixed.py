"""Dials, tracker and level in one campaign: what is told of each is in its own unit and share."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orthoglide.closing import Verdict, close_loop
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, ToolCampaign
from orthoglide.report.wording import headline, where_left
from tests import rig_campaigns as rc
from tests.rig import Rig

MACHINE = Machine.nominal()
ERRORS = {"joint_offset.x": 8e-4, "joint_offset.y": -5e-4}


@cache
def dials() -> Campaign:
    rows = rc.simulate(Rig(errors=ERRORS), rc.protocol_rows("standard"), np.random.default_rng(5))
    return Campaign.from_frame({k: [row[k] for row in rows] for k in rows[0]}, name="dials")


def tool(
    kinds: tuple[str, ...], noise: float = 2e-6, odd: float = 0.0, errors: dict[str, float] = ERRORS
) -> ToolCampaign:
    """Places read by a tracker along all axes, or by a level about two; some are odd."""
    rng = np.random.default_rng(11)
    rho = MACHINE.inverse(rng.uniform(-0.05, 0.05, (14, 3)))
    truth = MACHINE.with_parameters(errors)
    pose, rows = truth.pose(rho), []
    turn = 0.5 * (pose.R[:, [2, 0, 1], [1, 2, 0]] - pose.R[:, [1, 2, 0], [2, 0, 1]])
    for kind in kinds:
        seen = turn if kind == "incline" else pose.p
        for k, j in np.ndindex(14, 2 if kind == "incline" else 3):
            value = seen[k, j] + noise * rng.standard_normal() + odd * rng.choice([-1, 1])
            rows.append((kind, kind, "xyz"[j], *rho[k] * 1e3, value * 1e3, kind == "incline"))
    names = ("kind", "setup", "direction", "rho_x_mm", "rho_y_mm", "rho_z_mm")
    frame = {name: [row[k] for row in rows] for k, name in enumerate(names)}
    frame["reading_mm"] = ["" if row[7] else row[6] for row in rows]
    if "incline" in kinds:
        frame["reading_mrad"] = [row[6] if row[7] else "" for row in rows]
    return ToolCampaign.from_frame(frame, name="tool")


@cache
def odd_tool() -> Verdict:
    """The dials find nothing odd, the tracker's places are off without pattern."""
    return close_loop([dials(), tool(("tcp",), odd=4e-4)], MACHINE)


def test_what_is_left_is_shared_by_all_that_was_read() -> None:
    verdict = odd_tool()
    assert not verdict.stands
    everything = (*verdict.rest, *verdict.rest_of_tool)
    assert sum(one.share for one in everything) == pytest.approx(1.0)
    squares = verdict.after.problem.weighing.whiten(verdict.after.residuals) ** 2
    on_dials = float(squares[: len(dials())].sum() / squares.sum())
    assert sum(one.share for one in verdict.rest) == pytest.approx(on_dials)
    assert on_dials < 0.1


def test_what_is_left_at_the_tool_is_told_and_followed_there() -> None:
    verdict = odd_tool()
    most = verdict.rest_of_tool[0]
    said = f"({100 * most.share:.0f} %) shows in {most.reads} (tcp)"
    assert said in headline(verdict)
    assert "shows on leg" not in headline(verdict)
    follow = verdict.next_measurements[0]
    assert follow.aim == "trace"
    assert f"shows most in {most.reads}" in follow.reason
    assert not any("shows on leg" in option.words for option in verdict.picture.options)
    assert verdict.pattern[0] == f"{most.share:.0%} of it is in {most.reads} (tcp)"


def test_a_single_dial_is_not_all_dials() -> None:
    one = replace(odd_tool())
    vars(one).update(rest=(replace(odd_tool().rest[0], share=1.0),), rest_of_tool=())
    assert "(100 %) shows on leg" in where_left(one)
    assert "though" not in where_left(one)
