"""The golden results: what a user gets for about twenty campaigns, within stated tolerances.

``python -m tests.golden --write`` writes them anew and prints what differs (``golden/README.md``).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.accuracy import tcp_map
from orthoglide.closing import RunOutcome
from orthoglide.closing.validation import tcp_errors
from orthoglide.effects import CATALOGUE
from orthoglide.explanation.identifying import identify
from orthoglide.report import report_files
from orthoglide.report.sentences import headline
from tests.golden.compare import beyond, differences
from tests.golden.results import HERE, Case, cases, result_of
from tests.page_laws import broken, too_long
from tests.studied import studied

CASES = cases()


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=c.name, marks=[pytest.mark.thorough] if c.thorough else []) for c in CASES],
)
def test_a_campaign_gives_its_golden_result(case: Case, tmp_path: Path) -> None:
    wrong = beyond(differences(case.golden, result_of(case, tmp_path), case.tolerance))
    if wrong:
        lines = "\n  ".join(map(str, wrong))
        pytest.fail(f"{case.name}: {len(wrong)} beyond tolerance\n  {lines}", pytrace=False)
    # The result that is read from its file writes the same report.
    written = tmp_path / "result"
    verdict = og.Verdict.load(written, case.own_effects)
    again = report_files(verdict)
    for name, content in again.items():
        data = content.encode() if isinstance(content, str) else content
        assert data == (written / name).read_bytes(), name
    assert not [*broken(str(again["report.html"]), dials=bool(verdict.request.campaigns))]
    assert not too_long(headline(verdict))


def test_every_golden_file_has_its_case() -> None:
    assert {case.file for case in CASES} == set((HERE / "expected").iterdir())


def changed(golden: dict, **parts: object) -> list[str]:
    """What is beyond tolerance where parts of a golden change."""
    return [str(one) for one in beyond(differences(golden, golden | parts, CASES[0].tolerance))]


def test_the_comparison_sees_what_matters() -> None:
    golden = next(case for case in CASES if case.name == "rig-4").golden
    assert changed(golden) == []
    assert changed(golden, verdict="explained") == ["verdict: ambiguous -> explained"]
    first, second = golden["effects"][0]["set"]
    assert changed(golden, effects=[{"set": [second, first]}]) == []  # probabilities .51 and .48
    (gone,) = changed(golden, effects=[{"set": [first]}])
    assert gone.startswith("cause axis_offset.z.x: axis_offset.y.x: a member -> none")
    (size,) = changed(golden, effects=[{"set": [first | {"value": 0.415}, second]}])
    assert "axis_offset.z.x, value: 0.411891 -> 0.415" in size
    (absent,) = changed(golden, effects=[])
    assert absent == "cause: axis_offset.z.x -> absent"
    (tool,) = changed(golden, tool=golden["tool"] | {"now": 0.35})
    assert tool.startswith("tool, now: 0.302066 -> 0.35")
    (fault,) = changed(golden, data_faults=[{"kind": "outlier", "rows": [3]}])
    assert fault == "fault of the data: absent -> outlier in rows [3]"
    moved = [[*row[:6], row[6] + 0.2, *row[7:]] for row in golden["tcp_mm"]]
    (point,) = changed(golden, tcp_mm=moved)
    assert point.startswith("TCP error at [")
    values = {"joint_offset.x": {"value": -0.45, "sigma": 0.4}}
    assert len(changed(golden, parameters=golden["parameters"] | values)) == 1


# -- what the rig's keys hide ----------------------------------------------------------------------


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
