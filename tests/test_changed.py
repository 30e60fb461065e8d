"""What changed, all at once: the search over sets, and machines on which several things changed."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

import orthoglide as og
from orthoglide.checking import check
from orthoglide.fit.change_search import WIDTHS, Hypotheses
from orthoglide.geometry import Array
from tests.studied import studied
from tests.test_second_visit import ERRORS, SHEET, TILT, measured

COUNT, ROWS = 7, 30


def hypotheses(columns: Array, residual: Array) -> Hypotheses:
    return Hypotheses(
        columns.T @ columns,
        columns.T @ residual,
        np.full(columns.shape[1], 3.0),
        float(residual @ residual),
        float(len(residual)),
    )


def weight(columns: Array, residual: Array, places: list[int], widths: Array) -> float:
    """Log odds of a set against none by its definition: noise of one, or as much as is left."""
    spread = np.eye(ROWS) + (columns[:, places] * widths**2) @ columns[:, places].T

    def of(chi2: float) -> float:
        share = chi2 / ROWS
        return -ROWS / 2 * (share if share < 1 else 1 + float(np.log(share)))

    fit = of(float(residual @ np.linalg.solve(spread, residual))) - of(float(residual @ residual))
    prior = np.log(1 / widths / np.sum(1 / np.array(WIDTHS))).sum() - 3.0 * len(places)
    return fit - float(np.linalg.slogdet(spread)[1]) / 2 + float(prior)


@pytest.mark.thorough(except_for=["0", "1", "2", "3"])
@pytest.mark.parametrize("seed", range(12))
def test_no_set_weighs_more_than_the_one_found(seed: int) -> None:
    """Against every set of up to three with every choice of widths."""
    rng = np.random.default_rng(seed)
    # Columns that resemble each other: the best single one is often none of the true ones.
    shared = rng.standard_normal((ROWS, 3))
    columns = 2 * (shared @ rng.standard_normal((3, COUNT)) + rng.standard_normal((ROWS, COUNT)))
    true = rng.choice(COUNT, 2, replace=False)
    residual = columns[:, true] @ rng.uniform(1, 3, 2) + rng.standard_normal(ROWS)
    found = hypotheses(columns, residual).found()
    assert found is not None
    every = (
        weight(columns, residual, list(places), np.array(widths))
        for count in range(4)
        for places in combinations(range(COUNT), count)
        for widths in product(WIDTHS, repeat=count)
    )
    most = max(every)
    assert found.weight >= most - 1e-6
    assert len(found.places) > 3 or found.weight == pytest.approx(most, abs=1e-6)


def test_what_reads_the_same_is_told_with_its_own_size() -> None:
    rng = np.random.default_rng(1)
    columns = 5 * rng.standard_normal((ROWS, 4))
    columns[:, 2] = -2 * columns[:, 1]
    residual = 1.5 * columns[:, 1] - 2 * columns[:, 3] + rng.standard_normal(ROWS)
    found = hypotheses(columns, residual).found()
    assert found is not None
    each = {frozenset(sizes): sizes for sizes in found.instead}
    assert set(each) == {frozenset({1, 2}), frozenset({3})}
    assert each[frozenset({1, 2})][1] == pytest.approx(1.5, abs=0.2)
    assert each[frozenset({1, 2})][2] == pytest.approx(-0.75, abs=0.1)


def test_nothing_is_found_in_noise() -> None:
    rng = np.random.default_rng(5)
    none = [
        hypotheses(5 * rng.standard_normal((ROWS, 20)), rng.standard_normal(ROWS)).found() is None
        for _ in range(200)
    ]
    assert sum(none) >= 198


NOW = {"joint_offset.x": 0.0, "joint_offset.y": 0.0, TILT: 4e-4, "backlash.x": 0.0}
"""Two zeros entered, a rail set straight, a nut replaced: in one visit."""


@pytest.fixture(scope="module")
def visits() -> tuple[og.Campaign, og.Campaign]:
    before = {**ERRORS, TILT: 2.4e-3, "backlash.x": 6e-5}
    return measured(before, 1, "monday"), measured({**before, **NOW}, 2, "tuesday")


TRUE = {
    "joint_offset.x": -8e-4, "joint_offset.y": 5e-4, TILT: -2e-3, "backlash.x": -6e-5,
}  # fmt: skip


@pytest.mark.thorough
def test_four_changes_since_a_calibration(visits: tuple[og.Campaign, og.Campaign]) -> None:
    """A bar was told to be 0.7 mm longer where a zero had been entered."""
    monday, tuesday = visits
    again = studied(tuesday, og.close_loop(monday, SHEET).machine)
    assert again.word == "adequate"
    told = {str(c.parameter).replace("rail_tilt", "axis_tilt"): c for c in again.changed}
    assert set(told) == set(TRUE)
    for name, change in told.items():
        assert abs(change.after - change.before - TRUE[name]) < 3 * change.sigma
        assert change.sigma < abs(TRUE[name]) / 3
    assert "leg_length.x" not in {str(c.parameter) for c in again.changed}
    # Each is one thing to do, with what it may be instead: a page shows five of these and no more.
    to_do = [a.options for a in again.actions if a.words.startswith("Confirm what was put right")]
    assert [len(options) for options in to_do] == [len(c.members) for c in again.changed]


@pytest.mark.thorough
def test_four_changes_between_two_campaigns(visits: tuple[og.Campaign, og.Campaign]) -> None:
    """Bars of the third leg were told to have changed, and the rail was not."""
    found = check(*([v] for v in visits), SHEET)
    changed = {str(d.parameter).replace("rail_tilt", "axis_tilt"): d for d in found.differences
               if d.changed}  # fmt: skip
    assert set(changed) == set(TRUE)
    for name, d in changed.items():
        assert abs(d.after - d.before - TRUE[name]) < 3 * d.sigma
        assert d.sigma < abs(TRUE[name]) / 3
    assert found.sentences[-1].startswith("nothing else changed beyond its uncertainty: ")
