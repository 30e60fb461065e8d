"""Places that readings cannot part: what is proposed parts them, on the independent machine."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from benchmarks.delta_readings import measured as read_by
from benchmarks.delta_truth import machine as delta
from orthoglide.planning import suggest_separating_located_errors
from tests.rig import Rig
from tests.rig_campaigns import s_curve
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_design import RIG, driven, measured

TRUE = "rail.x.z/travel"
OFF = {"joint_offset.x": 8e-4, "leg_length.y": 5e-5}
BENT = Rig(errors=OFF, extra=(s_curve(0, 2, 4e-5),))


@cache
def located(seed: int) -> Any:
    """A sweep of a machine with a rail bent like an S, and what the search left of it."""
    machine = og.Machine.load(RIG / "machine.toml")
    campaign = measured(machine, BENT, "sweep", seed)
    return machine, campaign, studied([campaign], machine)


def proposed(verdict: Any) -> list[Any]:
    return [s for s in verdict.next_measurements if s.aim == "separate"]


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [6, 7])
def test_the_readings_proposed_for_a_class_of_places_leave_the_true_one(
    seed: int, tmp_path: Path
) -> None:
    """Nothing was proposed. At the second seed the true place is not the likeliest at first."""
    machine, campaign, closed = located(seed)
    (found,) = closed.located
    assert TRUE in {c.place.name for c in found.members}
    assert len(found.members) > 1
    (one,) = proposed(closed)
    assert all(f'"{c.place.words}"' in one.reason for c in found.members)
    assert one.gain > 2
    og.write_campaign(one.campaign, tmp_path / "next.csv")
    new = driven(machine, BENT, tmp_path / "next.csv", 1000 + seed)
    assert len(new) <= 12
    after = studied([campaign, new], machine)
    (left,) = after.located
    assert (left.name, left.members[0].probability > 0.9) == (TRUE, True)
    assert after.effects == ()


def class_of(closed: Any, *names: str) -> Any:
    """A class of other places in the place of the one found."""
    (found,) = closed.located
    places = {p.name: p for p in closed.posterior.linearised.free_form_errors}
    return replace(found, members=tuple(SimpleNamespace(name=n, place=places[n]) for n in names))


def test_places_that_no_reading_parts_are_said_to_be_such() -> None:
    _, _, closed = located(6)
    still = "drive.z/approach", "bar.y.1/approach"  # neither does anything here
    (one,) = suggest_separating_located_errors(closed.posterior, class_of(closed, *still))
    assert (one.hopeless, one.rows) == (True, ())
    assert " cannot be separated by dials on the legs: all " in one.reason
    gone = "dial.xz-0.5/time", "dial.xz-0.5/reading"
    (one,) = suggest_separating_located_errors(closed.posterior, class_of(closed, *gone))
    assert (one.hopeless, one.rows) == (True, ())
    assert "cannot be separated by new readings" in one.reason


def test_a_dial_is_told_from_a_rail_by_another_dial() -> None:
    _, _, closed = located(6)
    (one,) = suggest_separating_located_errors(
        closed.posterior, class_of(closed, TRUE, "dial.xz-0.5/reading")
    )
    assert one.aim == "separate"
    assert one.reason.endswith("; take another dial for them than before")


@pytest.mark.thorough
def test_places_of_a_delta_are_parted_by_what_one_may_own() -> None:
    rig = DeltaRig(bends={"a": lambda s: (5e-5 * np.sin(2 * np.pi * s / 0.2), 0.0, 0.0)})
    rng = np.random.default_rng(3)
    points = read_by(rig, rng, machine=delta(), instrument="tool coordinates")
    verdict = og.close_loop([points], delta())
    (found,) = verdict.located
    rail, drive = (c.description for c in found.members)
    told = [s for s in verdict.next_measurements if "errors apart" in s.reason]
    assert len(told) > 1
    assert all(
        f'it separates "{rail}" from "{drive}", by ' in s.reason and s.gain > 3 for s in told
    )
    assert not any(s.hopeless for s in told)
    assert not [s for s in told if "plate" in s.reason]  # it may have any shape
