"""Choices among equals: no rounding decides them, and near-degenerate subspaces have one basis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import special_ortho_group

import orthoglide as og
from orthoglide.fit.least_squares import normal_equations, weak_directions
from orthoglide.ordering import (
    LOG_ODDS_MARGIN,
    best_of,
    canonical_basis,
    descending,
    largest,
    ranked,
)

SEEDS = st.integers(0, 2**32 - 1)
ROUNDING = 1e-12


def test_the_first_of_equal_values_is_chosen() -> None:
    assert largest([1.0, 2.0, 2.0 + 1e-12, 2.0 - 1e-12]) == 1
    assert largest([1.0, 2.0, 2.1]) == 2
    assert largest([-np.inf, -3.0, np.inf, np.inf]) == 2
    assert largest([-np.inf, -np.inf]) == 0
    assert largest([[0.0, 1.0], [1.0, 1.0]]) == 1
    # Log odds are compared by their difference, whatever their size.
    assert largest([-100.0, -99.999999], LOG_ODDS_MARGIN) == 0
    assert largest([-100.0, -99.99], LOG_ODDS_MARGIN) == 1


def test_an_order_is_that_of_the_values_but_among_equals() -> None:
    assert descending([1.0, 3.0, 2.0]) == [1, 2, 0]
    assert descending([1.0, 3.0, 1.0 + 1e-13, 3.0 + 1e-13]) == [1, 3, 0, 2]
    assert descending([1.0, np.inf, -np.inf, np.inf]) == [1, 3, 0, 2]
    assert descending([]) == []
    assert ranked("bac", lambda letter: float(letter == "c")) == ["c", "b", "a"]
    assert best_of("bac", lambda letter: 1.0) == "b"
    with pytest.raises(ValueError, match="no items"):
        best_of([], float)


def test_a_chain_of_neighbours_is_no_group() -> None:
    """Values that differ by less than the margin each, and by more altogether, stay in order."""
    rising = np.linspace(1.0, 1.01, 20_000)
    order = np.array(descending(rising, 1e-5))
    assert np.all(np.diff(rising[order]) < 1e-5)
    assert rising[order[0]] >= rising.max() - 1e-5
    assert rising[order[-1]] <= rising.min() + 1e-5


@settings(max_examples=50, deadline=None)
@given(seed=SEEDS, scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_rounding_changes_no_order(seed: int, scale: float) -> None:
    draw = np.random.default_rng(seed)
    values = scale * draw.integers(-5, 5, 40) / 4
    noisy = values * (1 + ROUNDING * draw.standard_normal(40))
    assert descending(noisy) == descending(values)
    assert largest(noisy) == largest(values)
    assert [values[k] for k in descending(values)] == sorted(values, reverse=True)


# --- The canonical basis --------------------------------------------------------------------------


def spaces(draw: np.random.Generator, within: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Rows of a space with symmetric directions, as three equal legs have, and of a subspace."""
    legs = np.zeros((3, 12))
    for k in range(3):
        legs[k, [k, k + 3]] = 1.0, draw.choice([1.0, -0.5])
    more = draw.standard_normal((2, 12)) * 10.0 ** draw.integers(-2, 3, 12)
    return np.vstack([legs, more]), legs if within else None


@settings(max_examples=50, deadline=None)
@given(seed=SEEDS, within=st.booleans())
def test_the_canonical_basis_belongs_to_the_space(seed: int, within: bool) -> None:
    """It is the same by whatever rows the space is given, and up to rounding of these."""
    draw = np.random.default_rng(seed)
    rows, part = spaces(draw, within)
    basis = canonical_basis(rows, part)
    assert np.linalg.norm(basis, axis=1) == pytest.approx(np.ones(5))
    # It spans the space.
    assert np.linalg.lstsq(rows.T, basis.T, rcond=None)[1] == pytest.approx(np.zeros(5), abs=1e-20)

    def given_otherwise(space: np.ndarray) -> np.ndarray:
        orthonormal = np.linalg.qr(space.T)[0].T
        turned = special_ortho_group.rvs(len(space), random_state=draw) @ orthonormal
        return turned + 1e-12 * draw.standard_normal(space.shape)

    again = canonical_basis(given_otherwise(rows), None if part is None else given_otherwise(part))
    assert again == pytest.approx(basis, abs=1e-8)


def test_the_canonical_basis_is_sparse() -> None:
    """Equal directions of three legs stand apart, in the order of the legs."""
    legs = np.hstack([np.eye(3), np.eye(3)])
    turned = special_ortho_group.rvs(3, random_state=4) @ legs
    assert canonical_basis(turned) == pytest.approx(legs / np.sqrt(2))


def test_a_subspace_stands_first() -> None:
    rows = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 9.0]])
    found = canonical_basis(rows, rows[:1])
    assert found[0] == pytest.approx(rows[0] / np.sqrt(2))
    assert found[1, 0] == pytest.approx(0.0, abs=1e-12)
    assert canonical_basis(rows)[0] != pytest.approx(rows[0] / np.sqrt(2))


DELTA = Path(__file__).parent / "data" / "delta" / "electrocally.cfg"


def test_weak_directions_are_printed_alike_whatever_rounding_does() -> None:
    """Three towers make near-degenerate singular values, whose vectors rounding turns."""
    imported = og.import_printer(DELTA)
    estimate = og.identify(
        imported.campaigns, imported.machine, ["joint_offset", "leg_length", "axis_offset"]
    )
    problem = estimate.problem
    here = normal_equations(problem, estimate.at, estimate.nuisance)
    said = [str(w) for w in weak_directions(problem, here.jacobian, estimate.covariance)]
    assert len(said) > 3
    draw = np.random.default_rng(1)
    for _ in range(20):
        noise = 1 + 1e-9 * draw.standard_normal(here.jacobian.shape)
        turned = special_ortho_group.rvs(len(here.jacobian), random_state=draw) @ here.jacobian
        for jacobian in (here.jacobian * noise, turned):
            again = weak_directions(problem, jacobian, estimate.covariance)
            assert [str(w) for w in again] == said
