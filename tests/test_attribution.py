"""The truth table in short: effects that nobody declared are found in readings of the rig."""

import math
from functools import cache

import pytest

from benchmarks import delta_table
from benchmarks.attribution_asked import is_shape_of, upper_bound
from benchmarks.attribution_cases import PROTOCOLS, SHARES, Case, cases
from benchmarks.attribution_run import Record, accepted, draw, run
from benchmarks.attribution_table import tables

SEED = 0


@cache
def ended(case: Case) -> Record:
    record = run(case, SEED)
    assert record["word"] not in ("error", "crash"), record["message"]
    return record


@pytest.mark.thorough(except_for=["standard"])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_nothing_is_found_where_only_small_errors_are(protocol: str) -> None:
    record = ended(Case("nothing", "", protocol, 0.0, 0))
    assert 0 < record["background"] < 0.6
    assert (record["word"], record["effects"], record["blunders"]) == ("adequate", [], [])


def test_cases_are_drawn_from_seed_and_key_alone() -> None:
    case = Case("effect", "backlash", "standard", 8.0, 0)
    one, again, other = draw(case, 1), draw(case, 1), draw(case, 2)
    assert one.rows == again.rows
    assert one.rows != other.rows
    assert one.rig.errors == again.rig.errors


@pytest.mark.parametrize(
    ("place", "parameters", "same"),
    [
        ("bar.y/time", ["thermal_drift.y"], True),
        ("bar.y/time", ["thermal_drift.x"], False),
        ("drive.y/time", ["thermal_drift.y"], False),
        ("drive.y/travel", ["thermal_drift.y"], False),
        ("drive.y/travel", ["screw_error.y.sin", "screw_error.y.cos"], True),
        ("drive.y/approach", ["backlash.y"], True),
        ("rail.y.x/travel", ["axis_offset.y.x"], True),
        ("rail.y.x/travel", ["axis_offset.y.z"], False),
        ("rail.y.x/travel", ["gauge_drift.xy-0.5"], False),
        ("dial.xy-0.5/time", ["gauge_drift.xy-0.5"], False),
        ("dial.xy-0.5/reading", ["gauge_scale.xy-0.5"], True),
        ("dial.xy-0.5/reading", ["gauge_scale.xz-0.5"], False),
        ("dial.xy-0.5/reading", ["gauge_direction.xy-0.5"], False),
    ],
)
def test_known_shapes_of_a_place(place: str, parameters: list[str], same: bool) -> None:
    assert is_shape_of(place, parameters) == same


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


def test_name_is_accepted_only_for_the_same_cause() -> None:
    truth = {"name": "axis_tilt.y.z", "family": "axis_tilt", "same_family": ["axis_tilt.x.z"]}
    whole = ["axis_tilt.y.z", "axis_tilt.x.z"]
    assert accepted(truth, "axis_tilt.y.z", ["axis_tilt.y.z"])
    assert accepted(truth, "axis_tilt.x.z", ["axis_tilt.x.z"])
    assert accepted(truth, "axis_tilt", whole)
    assert not accepted(truth, "axis_tilt.y.x", ["axis_tilt.y.x"])
    assert not accepted(truth, "rail_tilt.y.z", ["rail_tilt.y.z"])


def test_tables_count_what_the_records_say() -> None:
    record = ended(Case("nothing", "", "standard", 0.0, 0))
    alarm = {**record, "word": "unexplained"}
    found = {row[0]: row[2] for row in tables([record, record, alarm])[0].rows}
    assert found["false alarms"] == "33.3 % (1/3)"


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
    told, ends = delta_table.tables(records)
    shares = {row[0].strip(): row[1] for row in told.rows}
    assert shares["outside the catalogue, three sigma or more: not noticed"] == "11.1 % (1/9)"
    assert shares["taken for noise, with a warning"] == "11.1 % (1/9)"
    assert shares["taken for faulty readings"] == "22.2 % (2/9)"
    assert shares["explained by a wrong name"] == "11.1 % (1/9)"
    assert shares["a wrong place located"] == "11.1 % (1/9)"
    assert shares["rails and carriages: a place located that holds the true one"] == "20.0 % (1/5)"
    assert ends.rows[1] == ["outside: wavy rail", "1", "1", "1", "1", "1", "", "2", "", "1", "1"]
    assert "refused as faulty: 1, ended in another error: 1" in told.note
