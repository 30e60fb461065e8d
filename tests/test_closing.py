"""The loop closed on machines that are not this package's model, each with an undeclared effect."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.accuracy import tcp_map
from orthoglide.closing.judging import tcp_errors
from orthoglide.effects import CATALOGUE
from orthoglide.explanation.identifying import identify
from orthoglide.observations import Campaign
from orthoglide.verdict import Verdict, close_loop
from tests.rig import Rig
from tests.rig_campaigns import protocol_rows, simulate
from tests.studied import studied

RIG = Path(__file__).parent / "data" / "rig"
KEYS = json.loads((RIG / "keys.json").read_text(encoding="utf-8"))

# What the keys say is hidden, and the families that may stand in for it: at most three.
HIDDEN: dict[str, tuple[str, ...]] = {
    "rig-1": (),
    "rig-2": ("axis_tilt.y.z",),
    "rig-3": ("backlash.x",),
    "rig-4": ("axis_offset.z.x",),
    "rig-5": ("encoder_scale.y",),
    "rig-6": ("bar_mismatch.z",),
    "rig-7": ("rail_bow.x.z",),
    "rig-8": ("axis_tilt.x.y", "backlash.z"),
}


class Verdicts(dict[str, Verdict]):
    """Verdicts of the rig's campaigns by name, each computed when it is asked for."""

    def __init__(self, machine: og.Machine) -> None:
        self.machine = machine

    def __missing__(self, case: str) -> Verdict:
        campaign = og.read_campaign(RIG / f"{case}.csv", self.machine.spec)
        points = og.read_tcp(RIG / f"{case}.tcp.csv", self.machine.spec)
        self[case] = close_loop(campaign, self.machine, tcp=points)
        return self[case]


@pytest.fixture(scope="module")
def verdicts(machine: og.Machine) -> dict[str, Verdict]:
    return Verdicts(machine)


FIRST_TIER = ["rig-1", "rig-2"]


@pytest.mark.thorough(except_for=FIRST_TIER)
@pytest.mark.parametrize("case", list(HIDDEN))
def test_the_hidden_effect_is_named(case: str, verdicts: dict[str, Verdict]) -> None:
    verdict, hidden = verdicts[case], HIDDEN[case]
    assert all(name in KEYS[case]["hidden"] for name in hidden)
    assert len(verdict.effects) == len(hidden)
    assert verdict.word in (("adequate",) if not hidden else ("explained", "ambiguous"))
    for name in hidden:
        classes = [{e.name, *e.indistinguishable_from} for e in verdict.effects]
        own = [c for c in classes if name in c]
        assert own, f"{name} is in none of {classes}"
        assert len({CATALOGUE.effect_of(n).name for n in own[0]}) <= 3
    assert not verdict.blunders


@pytest.mark.thorough(except_for=FIRST_TIER)
@pytest.mark.parametrize("case", list(HIDDEN))
def test_the_tcp_is_as_good_as_if_the_effect_had_been_told(
    case: str, verdicts: dict[str, Verdict], machine: og.Machine
) -> None:
    verdict = verdicts[case]
    campaign = og.read_campaign(RIG / f"{case}.csv", machine.spec)
    points = og.read_tcp(RIG / f"{case}.tcp.csv", machine.spec)
    told = identify(campaign, machine, ["joint_offset", "leg_length", *HIDDEN[case]])
    errors = tcp_errors(machine, points, {}, told.problem.values(0, told.x))["translation"]
    assert verdict.tcp is not None
    after = verdict.tcp["translation"]
    sigma = tcp_map(verdict.machine, points.command).sigma
    sigma_of_mean = np.linalg.norm(sigma, axis=1).mean()
    assert after.after[0] <= 1.3 * errors.after[0] + 0.1 * sigma_of_mean
    assert after.after[0] <= after.before[0] + sigma_of_mean
    assert after.inside >= 0.93


def test_the_judges_change_nothing(machine: og.Machine, verdicts: dict[str, Verdict]) -> None:
    """Points held out in one run, and readings in the other."""
    campaign = og.read_campaign(RIG / "rig-1.csv", machine.spec)
    held = close_loop(campaign, machine, holdout=og.read_campaign(RIG / "rig-2.csv", machine.spec))
    judged = verdicts["rig-1"]
    assert held.hold_out is not None
    assert judged.hold_out is None
    assert held.word == judged.word
    assert [e.name for e in held.effects] == [e.name for e in judged.effects]
    assert held.values == judged.values
    assert held.after.values == judged.after.values


def test_what_the_readings_cannot_show_is_called_invisible(verdicts: dict[str, Verdict]) -> None:
    assert any(n.startswith("mount_tilt") for n in verdicts["rig-2"].invisible)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_dials_scale_is_that_of_the_machine_found(seed: int, machine: og.Machine) -> None:
    """What a dial magnifies depends on all that is wrong besides: it was said twice as large."""
    errors = {"joint_offset.x": 1e-3, "joint_offset.y": -1.2e-3, "joint_offset.z": 0.8e-3}
    true = {"gauge_scale.xz-0.65": 0.06, "axis_offset.y.z": 1.5e-3}
    rig = Rig(errors=errors | true | {"gauge_direction.zx-0.65": 0.09})
    rows = simulate(rig, protocol_rows("two-gauges"), np.random.default_rng(seed))
    closed = studied(Campaign.from_frame({k: [r[k] for r in rows] for k in rows[0]}), machine)
    assert {"axis_offset.y.z", "gauge_scale.xz-0.65", "gauge_direction.zx-0.65"} <= {
        name for cause in closed.effects for name in (cause.name, *cause.indistinguishable_from)
    }
    (told,) = (c.chosen for c in closed.effects if c.name == "gauge_scale.xz-0.65")
    off = told.values[told.name] - true[told.name]
    assert abs(off) < 3 * told.sigmas[told.name] < 0.04
    assert closed.posterior is not None
    assert closed.posterior.linearised.linearisation_error < 0.1
