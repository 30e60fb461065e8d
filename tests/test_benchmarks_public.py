"""Benchmarks outlive the package's insides: they call its public interface and the tests' rigs."""

import ast
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks import compare_frozen, independent, public
from benchmarks.attribution_cases import Case
from benchmarks.attribution_run import draw
from benchmarks.independent import Sheet
from tests import rig_campaigns as rc
from tests.rig import Rig

FOLDER = Path(__file__).parents[1] / "benchmarks"
OF_SPEED = {"closure", "identify"}
"""Benchmarks of how fast the insides are, which change with them."""


def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports, wherever it does."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return {name for name in found if name.partition(".")[0] == "orthoglide"}


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda p: p.stem)
def test_a_benchmark_imports_the_package_by_its_public_name_alone(path: Path) -> None:
    if path.stem in OF_SPEED:
        return
    allowed = {"orthoglide", *(public.INSIDE if path.stem == "public" else ())}
    assert imported(path) <= allowed


def test_what_has_no_public_name_is_listed_and_nothing_else() -> None:
    assert imported(FOLDER / "public.py") == {"orthoglide", *public.INSIDE}


@pytest.fixture(scope="module")
def verdict() -> og.Verdict:
    rng = np.random.default_rng(5)
    rig = Rig(errors={"joint_offset.x": 1e-3, "axis_tilt.y.z": 3e-3})
    rows = rc.outlier(rc.simulate(rig, "standard", rng), 3, 0.4).rows
    points = public.tcp_points(rc.tcp_points(rig, 10, rng))
    return og.close_loop([public.campaign(rows)], public.machine(), tcp=points)


def test_a_verdict_reads_as_result_json_does(verdict: og.Verdict) -> None:
    read, written = public.verdict_of(verdict), public.result_json(verdict)
    assert read["verdict"] == written["verdict"]
    for one, other in zip(read["effects"], written["effects"], strict=True):
        assert (one["name"], one["parameters"]) == (other["name"], other["parameters"])
        names = [m["name"] for m in one["set"]]
        assert names == [other["name"], *other["indistinguishable_from"]]
        assert one["probability"] == pytest.approx(other["probability"], rel=1e-4)
    for one, other in zip(read["blunders"], written["blunders"], strict=True):
        assert [row + 2 for row in one["rows"]] == other["rows"]  # lines of a file
        assert all(one[key] == other[key] for key in ("kind", "setups", "message"))
    for state in ("before", "after"):
        for key, value in read[state].items():
            assert value == pytest.approx(written[state][key], rel=1e-6)
    assert read["left"]["background"] == pytest.approx(written["left"]["background"], rel=1e-4)
    tcp, errors = public.tcp_of(verdict), written["tcp"]["translation"]
    assert tcp["after"] == pytest.approx([errors["after_mean_mm"], errors["after_max_mm"]])
    assert tcp["stated"] == pytest.approx(written["tool"]["compensated"]["shape_mm"], rel=1e-4)
    for name, (value, sigma) in public.parameters_of(verdict).items():
        entry, unit = written["parameters"][name], public.unit_of(name)
        assert (value / unit, sigma / unit) == pytest.approx((entry["value"], entry["sigma"]))
    for item, other in zip(public.budget_of(verdict), written["budget"], strict=True):
        assert item["gain_mm"] == pytest.approx(other["gain_mm"], rel=1e-4, abs=1e-9)


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ({"part": "rail", "leg": "z", "direction": "y", "against": "travel"}, "rail.z.y/travel"),
        ({"part": "drive", "leg": "x", "against": "command", "by_leg": "y"}, "drive.x/command.y"),
        ({"part": "dial", "setup": "xy-0.5", "against": "reading"}, "dial.xy-0.5/reading"),
        ({"part": "bar", "leg": "x", "direction": "1", "against": "time"}, "bar.x.1/time"),
        ({"part": "rail", "leg": "a", "direction": "radial", "against": "travel",
          "short_waves": True}, "rail.a.radial/waves"),
    ],
)  # fmt: skip
def test_places_have_the_names_of_the_truth(place: dict, name: str) -> None:
    whole = dict.fromkeys(("leg", "direction", "by_leg", "setup", "short_waves"))
    assert public.place_name({**whole, **place}) == name


def test_a_cause_is_as_large_as_was_asked_and_the_oracle_finds_it() -> None:
    drawn = draw(Case("effect", "backlash", "sweep", 8.0, 0), 3)
    ((cause, size),) = drawn.causes
    added = rc.predict(drawn.rig, drawn.rows) - rc.predict(drawn.bare, drawn.rows)
    assert drawn.visible is not None
    assert drawn.visible.rms(drawn.visible.past(added)) == pytest.approx(8.0, rel=0.01)
    scales = independent.base_scales() | {cause.name: dict(cause.errors)}
    found = independent.oracle(Sheet(drawn.rows), scales)
    true = size * cause.errors[cause.name]
    assert found[cause.name] == pytest.approx(true, abs=0.3 * abs(true))
    told = drawn.points.points()
    error = independent.tcp_error(found, told.command, told.p)
    assert error[0] < 0.01


@pytest.mark.parametrize("name", compare_frozen.PRINTED)
def test_frozen_tables_are_those_of_their_page(name: str) -> None:
    page = (compare_frozen.FROZEN / "README.md").read_text(encoding="utf-8")
    _, *lines = compare_frozen.compared(name, None)
    assert len(lines) > 3
    assert [line for line in lines if line and line not in page] == []
