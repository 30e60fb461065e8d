"""Two campaigns of one machine: what changed between them, from what to what."""

from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.closing import close_loop
from orthoglide.errors import InputError
from orthoglide.observations import Campaign
from tests import rig_campaigns as rc
from tests.rig import Rig

RIG = Path(__file__).parent / "data" / "rig"
BASE = {"joint_offset.x": 1.2e-3, "joint_offset.y": -0.8e-3, "joint_offset.z": 0.6e-3}
BASE |= {"leg_length.x": 4e-5, "leg_length.z": -6e-5}


@pytest.fixture(scope="module")
def machine() -> og.Machine:
    return og.Machine.load(RIG / "machine.toml")


def campaign(
    machine: og.Machine, name: str, seed: int, protocol: str = "standard", **errors: float
) -> Campaign:
    """The same machine every time, but for ``errors``; other dials, another day."""
    rig = Rig().with_errors(BASE | errors).with_background(np.random.default_rng(99), 0.02)
    rows = rc.simulate(rig, protocol, np.random.default_rng(seed))
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    return Campaign.from_frame(columns, name=name, machine_file=machine.spec)


def tilted(machine: og.Machine, *tilts: float) -> list[Campaign]:
    """Campaigns ``c0``, ``c1`` ... of a machine whose y rail leans toward z by these, rad."""
    return [
        campaign(machine, f"c{k}", k + 1, **{"axis_tilt.y.z": tilt}) for k, tilt in enumerate(tilts)
    ]


# -- what campaigns have for themselves ------------------------------------------------------------


def test_an_effect_that_each_campaign_has_for_itself(machine):
    verdict = close_loop(tilted(machine, 1.5e-3, 0.3e-3), machine, own=["axis_tilt"])
    assert [e.name for e in verdict.effects] == ["axis_tilt.y.z"]
    values = verdict.fit.values
    assert values["axis_tilt.y.z@c0"] == pytest.approx(1.5e-3, abs=0.15e-3)
    assert values["axis_tilt.y.z@c1"] == pytest.approx(0.3e-3, abs=0.15e-3)
    assert verdict.machine.values["axis_tilt.y.z"] == values["axis_tilt.y.z@c1"]


def test_own_takes_known_effects_and_campaigns(machine):
    both = tilted(machine, 0.0, 0.0)
    with pytest.raises(InputError, match="no effect"):
        close_loop(both, machine, own=["axis_tlit"])
    with pytest.raises(InputError, match="no campaign 'monday'"):
        close_loop(both, machine, own=["axis_tilt@monday"])
