"""The loop closed on machines that are not this package's model, each with an undeclared effect."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.accuracy import tcp_map
from orthoglide.closing import RunOutcome
from orthoglide.closing.judging import tcp_errors
from orthoglide.effects import CATALOGUE
from orthoglide.explanation.identifying import identify
from tests.studied import studied

RIG = Path(__file__).parent / "data" / "rig"
GOLDEN = Path(__file__).parent / "golden" / "expected"
KEYS = json.loads((RIG / "keys.json").read_text(encoding="utf-8"))

# What the keys say is hidden; `tests/test_golden.py` runs the campaigns themselves.
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


@pytest.mark.parametrize("case", HIDDEN)
def test_golden_results_name_the_hidden_effect(case: str) -> None:
    """In a set of at most three families each, and nothing else."""
    result = json.loads((GOLDEN / f"{case}.json").read_text(encoding="utf-8"))
    assert all(name in KEYS[case]["hidden"] for name in HIDDEN[case])
    assert result["verdict"] in (("explained", "ambiguous") if HIDDEN[case] else ("adequate",))
    sets = [{member["name"] for member in effect["set"]} for effect in result["effects"]]
    assert len(sets) == len(HIDDEN[case])
    for name in HIDDEN[case]:
        (own,) = (one for one in sets if name in one)
        assert len({CATALOGUE.effect_of(member).name for member in own}) <= 3
    assert not result["data_faults"]


@pytest.fixture(scope="module")
def closed(machine: og.Machine) -> RunOutcome:
    return studied(RIG / "rig-2.csv", machine, tcp=RIG / "rig-2.tcp.csv")


def test_the_tcp_is_as_good_as_if_the_effect_had_been_told(
    closed: RunOutcome, machine: og.Machine
) -> None:
    campaign = og.read_campaign(RIG / "rig-2.csv", machine.spec)
    points = og.read_tcp(RIG / "rig-2.tcp.csv", machine.spec)
    told = identify(campaign, machine, ["joint_offset", "leg_length", *HIDDEN["rig-2"]])
    errors = tcp_errors(machine, points, {}, told.problem.values(0, told.x))["translation"]
    assert closed.tcp is not None
    after = closed.tcp["translation"]
    sigma = tcp_map(closed.machine, points.command).sigma
    sigma_of_mean = np.linalg.norm(sigma, axis=1).mean()
    assert after.after_mean <= 1.3 * errors.after_mean + 0.1 * sigma_of_mean
    assert after.after_mean <= after.before_mean + sigma_of_mean
    assert after.inside >= 0.93


def test_the_judges_change_nothing(machine: og.Machine, closed: RunOutcome) -> None:
    """Points held out in one run, and readings in the other."""
    held = studied(RIG / "rig-2.csv", machine, holdout=RIG / "rig-1.csv")
    assert held.hold_out is not None
    assert closed.hold_out is None
    assert held.word == closed.word
    assert [e.name for e in held.effects] == [e.name for e in closed.effects]
    assert held.values == closed.values
    assert held.after.values == closed.after.values
