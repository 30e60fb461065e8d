"""Two campaigns of one machine: what changed between them, from what to what."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import InputError
from orthoglide.explanation.change import Change
from orthoglide.explanation.data_faults import find_data_faults
from orthoglide.explanation.identifying import identify
from orthoglide.observations import Campaign
from orthoglide.verdict import close_loop
from tests import rig_campaigns as rc
from tests.rig import Rig

BASE = {"joint_offset.x": 1.2e-3, "joint_offset.y": -0.8e-3, "joint_offset.z": 0.6e-3}
BASE |= {"leg_length.x": 4e-5, "leg_length.z": -6e-5}


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


@pytest.mark.thorough
def test_an_effect_that_each_campaign_has_for_itself(machine):
    verdict = close_loop(tilted(machine, 1.5e-3, 0.3e-3), machine, own=["axis_tilt"])
    assert [e.name for e in verdict.effects] == ["axis_tilt.y.z"]
    values = verdict.effects[0].chosen.values
    assert values["axis_tilt.y.z@c0"] == pytest.approx(1.5e-3, abs=0.15e-3)
    assert values["axis_tilt.y.z@c1"] == pytest.approx(0.3e-3, abs=0.15e-3)
    mean = verdict.after.values["axis_tilt.y.z@c1"]
    assert verdict.machine.values["axis_tilt.y.z"] == pytest.approx(mean, rel=1e-9)


def test_own_takes_known_effects_and_campaigns(machine):
    both = tilted(machine, 0.0, 0.0)
    with pytest.raises(InputError, match="no effect"):
        close_loop(both, machine, own=["axis_tlit"])
    with pytest.raises(InputError, match="no campaign 'monday'"):
        close_loop(both, machine, own=["axis_tilt@monday"])


# -- what changed ----------------------------------------------------------------------------------


@pytest.mark.thorough
def test_what_has_no_name_is_no_change_beyond_any_that_is_expected(machine):
    """A rail that was bent between two visits, into no shape of the catalogue: a bar had grown by
    38 mm, and a joint had turned by 28 degrees.
    """
    sound = campaign(machine, "old", 1, "sweep", **{"axis_tilt.z.x": 3e-3})
    rig = Rig().with_errors(BASE | {"axis_tilt.z.x": 3e-3})
    rig = replace(
        rig.with_background(np.random.default_rng(99), 0.02), extra=(rc.s_curve(0, 1, 1.2e-4),)
    )
    rows = rc.simulate(rig, "sweep", np.random.default_rng(2))
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    now = Campaign.from_frame(columns, name="new", machine_file=machine.spec)
    verdict = close_loop([sound, now], machine)
    assert verdict.word in ("located", "unexplained")
    assert verdict.changed == ()


def changes_of(*campaigns: Campaign, machine: og.Machine) -> tuple[Change, ...]:
    findings = find_data_faults(identify(campaigns, machine, method="nested"))
    assert findings.data_faults == ()
    return findings.changes


@pytest.mark.thorough
def test_a_tilt_that_was_put_right(machine, tmp_path):
    verdict = close_loop(tilted(machine, 1.5e-3, 0.3e-3), machine)
    (change,) = verdict.changed
    assert set(change.members) == {"axis_tilt.y.z", "rail_tilt.y.z"}
    assert change.files == ("c0", "c1")
    assert change.before == pytest.approx(1.5e-3, abs=3 * change.sigma)
    assert change.after == pytest.approx(0.3e-3, abs=3 * change.sigma)
    assert change.sigma < 1.5e-4
    assert verdict.blunders == ()
    # The machine as it is now: a tilt is left, whichever of the two, and nothing of the dials.
    (effect,) = verdict.effects
    assert {effect.name, *effect.indistinguishable_from} == set(change.members)
    now = [verdict.machine.values.get(name, 0.0) for name in change.members]
    assert sum(now) == pytest.approx(0.3e-3, abs=1.5e-4)
    # Drawn as large as it is told, not with what it was before added.
    for one, drawn in zip(effect.explanations, verdict.picture.options, strict=True):
        told_size = re.search(r"by ([\d.]+) mrad", one.words)
        assert told_size
        assert drawn.marks[0].label.startswith(f"{told_size[1]} mrad")
    test = " ".join(suspect.confirm for a in verdict.actions for suspect in a.options)
    assert re.search(r"move 100 mm outward: expect [\d.]+ mm toward z", test)
    verdict.report(str(tmp_path / "run"))
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    (told,), (cause,) = result["changed"], result["effects"]
    assert cause["value"] == pytest.approx(change.after, abs=change.sigma)
    said = f"changed from {change.before * 1e3:.3f} to {change.after * 1e3:.3f} mrad (± "
    assert said in told["words"]
    assert told["parameter"] == change.parameter
    assert (told["unit"], told["between"]) == ("rad", ["c0", "c1"])
    assert told["from"] == pytest.approx(change.before, rel=1e-4)
    assert told["to"] == pytest.approx(change.after, rel=1e-4)
    assert told["sigma"] == pytest.approx(change.sigma, rel=1e-4)


@pytest.mark.thorough(except_for=["standard-errors1"])
@pytest.mark.parametrize("errors", [{}, {"axis_tilt.x.y": 3e-3}, {"backlash.z": 1e-4}])
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
def test_nothing_changed(protocol, errors, machine):
    both = [campaign(machine, f"c{k}", k, "standard" if k else protocol, **errors) for k in (0, 1)]
    assert changes_of(*both, machine=machine) == ()


@pytest.mark.thorough
def test_two_changes_between_three_files(machine):
    both = tilted(machine, 1.5e-3, 0.3e-3)
    last = {"axis_tilt.y.z": 0.3e-3, "leg_length.x": 2e-4}
    found = changes_of(*both, campaign(machine, "c2", 3, **last), machine=machine)
    about = {change.between: change.members for change in found}
    assert "axis_tilt.y.z" in about["c0", "c1"]
    assert "leg_length.x" in about["c1", "c2"]
    assert len(found) == 2


@pytest.mark.thorough
def test_a_fault_of_one_file_is_no_change(machine):
    rng = np.random.default_rng(3)
    rows = [rc.simulate(Rig().with_errors(BASE), "standard", rng) for _ in range(2)]
    rows[1] = rc.swapped_sign(rows[1], "yz-0.5").rows
    both = [
        Campaign.from_frame(
            {key: [row[key] for row in table] for key in table[0]},
            name=f"c{k}",
            machine_file=machine.spec,
        )
        for k, table in enumerate(rows)
    ]
    findings = find_data_faults(identify(both, machine, method="nested"))
    assert [b.kind for b in findings.data_faults] == ["sign"]
    assert findings.changes == ()
