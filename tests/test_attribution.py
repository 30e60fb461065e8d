"""The truth table in short: effects that nobody declared are found in readings of the rig."""

import math
from functools import cache

import pytest

from benchmarks import delta_table
from benchmarks.attribution_asked import upper_bound
from benchmarks.attribution_cases import SHARES, Case, cases
from benchmarks.attribution_run import Record, draw, run

SEED = 0


@cache
def ended(case: Case) -> Record:
    record = run(case, SEED)
    assert record["word"] not in ("error", "crash"), record["message"]
    return record


def test_nothing_is_found_where_only_small_errors_are() -> None:
    record = ended(Case("nothing", "", "standard", 0.0, 0))
    assert 0 < record["background"] < 0.6
    assert (record["word"], record["effects"], record["blunders"]) == ("adequate", [], [])


def test_cases_are_drawn_from_seed_and_key_alone() -> None:
    case = Case("effect", "backlash", "standard", 8.0, 0)
    one, again, other = draw(case, 1), draw(case, 1), draw(case, 2)
    assert one.rows == again.rows
    assert one.rows != other.rows
    assert one.rig.errors == again.rig.errors


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
