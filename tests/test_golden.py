"""The golden results: what a user gets for about twenty campaigns, within stated tolerances.

``python -m tests.golden --write`` writes them anew and prints what differs (``golden/README.md``).
"""

from pathlib import Path

import pytest

import orthoglide as og
from orthoglide.report import report_files
from orthoglide.report.sentences import headline
from tests.golden.compare import beyond, differences
from tests.golden.results import HERE, Case, cases, result_of
from tests.page_laws import broken, too_long

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


def test_names_of_a_set_may_follow_probabilities_that_are_close() -> None:
    golden = next(case for case in CASES if case.name == "rig-4").golden
    first, second = golden["effects"][0]["set"]
    one, other = first | {"probability": 0.6}, second | {"probability": 0.4}
    apart = golden | {"effects": [{"set": [one, other]}]}
    (order,) = changed(apart, effects=[{"set": [other, one]}])
    assert order.startswith("cause axis_offset.z.x, first: axis_offset.z.x -> axis_offset.y.x")
