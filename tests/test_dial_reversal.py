"""Dials that read by the way that their plungers came: of one dial, and of all of a make."""

import json

import numpy as np
import pytest

import orthoglide as og
from orthoglide.effects.free_form import common_dial_form, dial_free_forms
from orthoglide.explanation.free_form import dial_curve_columns
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate
from orthoglide.report import result_text
from tests import rig_campaigns as rc
from tests.rig import LEGS, Rig


def rows_of(reversal: dict[str, float], protocol: str = "sweep") -> list[rc.Row]:
    """Offsets, lengths and everything else at a fiftieth, and some dials that lag."""
    rng = np.random.default_rng(11)
    base = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    base |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rig = Rig(errors=base, extra_dial={s: rc.dial_reversal(v) for s, v in reversal.items()})
    return rc.simulate(rig, protocol, rng, background=0.02)


def campaign_of(rows: list[rc.Row]) -> og.Campaign:
    return og.Campaign.from_frame({key: [row[key] for row in rows] for key in rows[0]}, name="c")


SETUPS = [f"{leg}{axis}-0.5" for leg in LEGS for axis in LEGS if axis != leg]


@pytest.mark.thorough
@pytest.mark.parametrize(("setup", "size"), [("yz-0.5", 0.03), ("zx-0.5", -0.02)])
def test_one_dial_that_lags_is_told_with_its_size(setup: str, size: float) -> None:
    """It had been the rail, or the leg's end on the platform, with ten times the size."""
    verdict = og.close_loop(campaign_of(rows_of({setup: size * 1e-3})))
    assert verdict.word == "located"
    (found,) = verdict.located
    first = found.members[0]
    assert first.name == f"dial.{setup}/approach"
    assert first.value == pytest.approx(-size * 1e-3, abs=4e-6)  # less on the way up
    assert f"the dial of {setup} reads more or less by the way that its plunger came" in str(
        verdict
    ).replace("\n", " ").lower().replace("  ", " ")
    assert (
        verdict.machine.values.keys()
        == og.close_loop(campaign_of(rows_of({}))).machine.values.keys()
    )


@pytest.mark.thorough
@pytest.mark.parametrize("size", [0.01, 0.03])
def test_dials_of_one_make_lag_together(size: float) -> None:
    verdict = og.close_loop(campaign_of(rows_of(dict.fromkeys(SETUPS, size * 1e-3))))
    assert verdict.word == "located"
    (found,) = verdict.located
    first = found.members[0]
    assert first.name == "dial/approach"
    assert first.value == pytest.approx(-size * 1e-3, abs=2e-6)
    told = json.loads(result_text(verdict))["located"][0]
    assert (told["part"], told["against"], told["leg"], told["setup"]) == (
        "dial", "approach", None, None,
    )  # fmt: skip
    assert told["size_mm"] == pytest.approx(size, abs=2e-3)
    assert "all dials read more or less by the way that their plungers came" in told["words"]
    (action,) = [a for a in verdict.actions if a.options and "plungers" in a.options[0].words]
    assert "gauge block" in action.options[0].confirm
    assert "lost motion" not in action.words


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [2, 5, 6])
def test_moves_too_small_to_go_by_their_sign(seed: int) -> None:
    """Twelve dials, some postures between which one of them moves by a micrometre: the way it came
    changed with each fit, and *unexplained* it was.
    """
    rng = np.random.default_rng([seed, 9])
    rows = rc.protocol_rows("two-gauges")
    setups = {str(row["setup"]) for row in rows}
    base = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    base |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rig = Rig(errors=base, extra_dial=dict.fromkeys(setups, rc.dial_reversal(3e-5)))
    rows = rc.simulate(rig, rows, rng, background=0.02, noise=4e-6)
    verdict = og.close_loop(campaign_of(rows))
    assert verdict.word == "located"
    (found,) = verdict.located
    assert found.members[0].name == "dial/approach"
    assert found.members[0].value == pytest.approx(-3e-5, abs=2e-6)


def test_which_way_a_plunger_came() -> None:
    """As the predicted reading moved; not known where moves came between that nobody wrote down."""
    rows = rows_of({})
    for k, row in enumerate(rows):
        row["order"] = k
    estimate: Estimate = identify(campaign_of(rows), og.Machine.nominal())
    value = estimate.at.value
    parts, places = dial_curve_columns(estimate.problem, value, estimate.residuals)
    columns = np.hstack(parts)
    at = [p.name for p in places].index("dial.yz-0.5/approach")
    own = np.array([row["setup"] == "yz-0.5" for row in rows])
    start = sum(p.kernel.count for p in places[:at])
    shown = columns[:, start] / places[at].prior_sd
    assert not shown[~own].any()
    expected = np.sign(np.diff(value[own])) / 2
    moved = np.abs(np.diff(value[own])) > 2e-6
    assert moved.sum() > 20
    assert shown[own][1:][moved] == pytest.approx(expected[moved])
    together = columns[:, -1] / places[-1].prior_sd
    assert places[-1].name == common_dial_form((0.0, 1.0)).name == "dial/approach"
    assert together[own] == pytest.approx(shown[own])


def test_a_dial_whose_plunger_came_one_way_shows_no_reversal() -> None:
    names = [p.name for p in dial_free_forms("s", 0, None, (0.0, 1e-3), False)]
    assert names == ["dial.s/reading"]
    assert [p.name for p in dial_free_forms("s", 0, None, (0.0, 1e-3), True)][
        -1
    ] == "dial.s/approach"
