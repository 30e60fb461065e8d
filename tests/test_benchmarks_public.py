"""Benchmarks outlive the package's insides: they call its public interface and the tests' rigs.

At the end the truth table in short: effects that nobody declared are found in readings of the rig.
"""

import ast
import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks import compare_frozen, delta_table, independent, public
from benchmarks.attribution_asked import upper_bound
from benchmarks.attribution_cases import SHARES, Case, cases
from benchmarks.attribution_run import draw, run
from benchmarks.independent import Sheet
from benchmarks.runs import Record
from tests import rig_campaigns as rc
from tests.rig import Rig

FOLDER = Path(__file__).parents[1] / "benchmarks"
OF_SPEED = {"closure"}
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


def test_a_verdict_is_read_as_result_json_has_it(verdict: og.Verdict, tmp_path: Path) -> None:
    verdict.report(tmp_path / "out")
    written = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    read = public.verdict_of(verdict)
    for one, other in zip(read["effects"], written["effects"], strict=True):
        assert one["probability"] == other["probability"]
        names = [m["name"] for m in one["set"]]
        assert names == [other["name"], *other["indistinguishable_from"]]
    for one, other in zip(read["blunders"], written["blunders"], strict=True):
        assert [row + 2 for row in one["rows"]] == other["rows"]  # lines of a file
    for key in ("verdict", "before", "after", "left", "budget"):
        assert read[key] == written[key]
    tcp, errors = public.tcp_of(read), written["tcp"]["translation"]
    assert tcp["after"] == [errors["after_mean_mm"], errors["after_max_mm"]]
    for name, (value, sigma) in public.parameters_of(read).items():
        entry, unit = written["parameters"][name], public.unit_of(name)
        assert (value / unit, sigma / unit) == pytest.approx((entry["value"], entry["sigma"]))


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("rail.z.y/travel@12.5w8", "rail.z.y/travel"),
        ("drive.x/command.y", "drive.x/command.y"),
        ("dial.xy-0.5/reading-line", "dial.xy-0.5/reading"),
        ("bar.x.1/time@400s", "bar.x.1/time"),
        ("rail.a.radial/waves", "rail.a.radial/waves"),
    ],
)
def test_places_have_the_names_of_the_truth(name: str, plain: str) -> None:
    assert public.place_name(name) == plain


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


@pytest.mark.parametrize("name", compare_frozen.TABLES)
def test_frozen_tables_are_printed_of_as_many_campaigns_as_their_page_says(name: str) -> None:
    page = (compare_frozen.FROZEN / "README.md").read_text(encoding="utf-8")
    count, *lines = compare_frozen.compared(name, None)
    campaigns = count.removeprefix(f"{name}: ").split(" frozen")[0]
    assert f"## {name}\n\n{campaigns}.\n" in page
    assert sum(line.startswith("| ") for line in lines) > 3
    assert not any("->" in line for line in lines)


# -- the truth table in short ---------------------------------------------------------------------


@cache
def ended(case: Case) -> Record:
    record = run(case, 0)
    assert record["word"] not in ("error", "crash"), record["message"]
    return record


def test_nothing_is_found_where_only_small_errors_are() -> None:
    record = ended(Case("nothing", "", "standard", 0.0, 0))
    assert 0 < record["background"] < 0.6
    assert (record["word"], record["effects"], record["blunders"]) == ("adequate", [], [])


def test_small_table_is_part_of_a_large_one() -> None:
    small, full = ({c.key for c in cases(n)} for n in (60, sum(SHARES.values())))
    assert small < full
    assert len(full) == sum(SHARES.values()) >= 600
    assert sum(key.startswith("nothing") for key in full) >= 200


def test_upper_bound_is_that_of_clopper_and_pearson() -> None:
    assert upper_bound(0, 200) == pytest.approx(1 - 0.05 ** (1 / 200))
    # The bound is where so few hits have a probability of one in twenty.
    p = upper_bound(4, 200)
    tail = sum(math.comb(200, k) * p**k * (1 - p) ** (200 - k) for k in range(5))
    assert tail == pytest.approx(0.05)


def test_no_end_of_a_delta_outside_the_catalogue_goes_uncounted() -> None:
    """A machine that ends adequate, or whose readings are refused, is no success."""
    rail = "rail.a.tangential/travel"

    def ended(word: str, places: list[str], **more: object) -> Record:
        truth = {"rms": 8.0, "places": places}
        return {"kind": "outside", "what": "wavy rail", "instrument": "probe", "word": word,
                "truth": [truth], "located": [], "effects": [], "blunders": 0,
                "loud": False, **more}  # fmt: skip

    records = [
        ended("adequate", [rail]),
        ended("adequate", [], blunders=1),
        ended("adequate", [rail], loud=True),
        ended("located", [rail], located=[{"places": ["drive.a/travel", rail]}]),
        ended("located", [rail], located=[{"places": ["drive.a/travel"]}]),
        ended("explained", []),
        ended("unexplained", []),
        ended("error", [rail], message="InputError: rows were exchanged"),
        ended("error", [], message="NumericsError: no end"),
    ]
    (told,) = delta_table.tables(records)
    shares = {row[0].strip(): row[1] for row in told.rows}
    assert shares["outside the catalogue, three sigma or more: not noticed"] == "11.1 % (1/9)"
    faulty = "taken for noise, with a warning, or for faulty readings"
    assert shares[faulty] == "33.3 % (3/9)"
    assert shares["explained by a wrong name"] == "11.1 % (1/9)"
    assert shares["a wrong place located"] == "11.1 % (1/9)"
    assert shares["rails and carriages: a place located that holds the true one"] == "20.0 % (1/5)"
    assert "refused as faulty: 1, ended in another error: 1" in told.note
