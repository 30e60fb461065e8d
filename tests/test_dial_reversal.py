"""Dials that read by the way that their plungers came: of one dial, and of all of a make."""

import json

import numpy as np
import pytest

import orthoglide as og
from orthoglide.effects.dials import common_dial_form, dial_free_forms
from orthoglide.explanation.free_form import dial_curve_columns
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate
from orthoglide.report import result_text
from tests import rig_campaigns as rc
from tests.factors import campaign_of
from tests.rig import LEGS, Rig


def rows_of(reversal: dict[str, float], protocol: str = "sweep") -> list[rc.Row]:
    """Offsets, lengths and everything else at a fiftieth, and some dials that lag."""
    rng = np.random.default_rng(11)
    base = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    base |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rig = Rig(errors=base, extra_dial={s: rc.dial_reversal(v) for s, v in reversal.items()})
    return rc.simulate(rig, protocol, rng, background=0.02)


SETUPS = [f"{leg}{axis}-0.5" for leg in LEGS for axis in LEGS if axis != leg]


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
