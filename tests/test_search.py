"""The search for what stands out, against the evidence of every state written out in full."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import sparse
from scipy.stats import norm

from orthoglide.errors import NumericsError
from orthoglide.explanation import base_fit, linear_model
from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.base_fit import fits_without_a_slip
from orthoglide.explanation.credible_sets import merge_families
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.full_likelihood import FullLikelihood, _span
from orthoglide.explanation.linear_model import (
    NEGLIGIBLE_LOG_WEIGHT,
    Group,
    LinearModel,
    drop_unseen_directions,
    identity_group,
    left_singular,
)
from orthoglide.explanation.mixture import Mixture
from orthoglide.explanation.search import Search, State
from orthoglide.fit.noise import Weighing
from orthoglide.geometry import Array

ROWS = 24
SLABS = (0.3, 1.0, 3.0)
SHARES = (0.01, 0.1, 1.0)


def made_up(columns: Array, truth: Array, seed: int) -> LinearModel:
    """Readings of a made-up machine: the first two coefficients are its base; then causes of one
    coefficient; last a family of three, and a free function of six that shows in two ways only.
    """
    rng = np.random.default_rng(seed)
    count, last = columns.shape[1], columns.shape[1] - 9
    groups = [Group(f"g{k}", np.array([k]), np.eye(1), False) for k in range(2, last)]
    groups += [identity_group("family", range(last, last + 3), free_form=False)]
    groups += [identity_group("place", range(last + 3, count), free_form=True)]
    free = np.arange(count) >= last + 3
    fixed = np.where(np.arange(count) < 2, 1.0, np.nan)
    return LinearModel(
        columns, columns @ truth + rng.standard_normal(ROWS), fixed, free, np.zeros(count, bool),
        tuple(groups), np.eye(ROWS), SHARES, SLABS,
    )  # fmt: skip


def drawn(seed: int, causes: int = 6) -> Array:
    rng = np.random.default_rng(seed)
    columns = 20 * rng.standard_normal((ROWS, 2 + causes + 9))
    columns[:, -6:] = rng.standard_normal((ROWS, 2)) @ rng.standard_normal((2, 6))
    return columns


def written_out(search: Search, state: State) -> Array:
    """Log weights of a state by scale ``(scales,)``, from its covariance."""
    linear, found = search.linear, []
    for scale in search.scales:
        cov = np.eye(ROWS) * (1 + scale.noise**2)
        cov += (
            linear.columns * linear.spike(scale.background_scale, scale.free_form_scale)
        ) @ linear.columns.T
        for group, tau in state:
            shown = linear.columns[:, linear.groups[group].coefficients] * tau
            cov += shown @ shown.T
        square = linear.residual @ np.linalg.solve(cov, linear.residual)
        prior = -3.0 * ((scale.background_scale > 1) + (scale.noise > 0))
        found.append(prior - (square + np.linalg.slogdet(cov)[1]) / 2)
    return np.array(found) - sum(search.cost[g] for g, _ in state)


def pooled(logs: Array) -> float:
    return float(logs.max() + np.log(np.exp(logs - logs.max()).sum()))


def test_bayes_factors_of_further_groups_are_averages_over_their_scales() -> None:
    truth = np.zeros(17)
    truth[3] = 2.0
    mixture = Mixture(made_up(drawn(1), truth, 2))
    best = mixture.best
    before = pooled(written_out(mixture, best))
    active = {group for group, _ in best}
    factors = mixture.next_log_bayes_factors()
    for k in (group for group in (0, 4, 5) if group not in active):
        states = [tuple(sorted((*best, (k, tau)))) for tau in SLABS]
        ratios = [pooled(written_out(mixture, s)) + mixture.cost[k] - before for s in states]
        assert factors[k] == pytest.approx(np.log(np.mean(np.exp(ratios))), abs=1e-6)


@pytest.mark.parametrize("state", [(), ((1, 1.0),), ((0, 0.3), (7, 3.0)), ((2, 3.0), (6, 1.0))])
def test_states_with_one_group_more_have_their_evidence(state: State) -> None:
    truth = np.zeros(17)
    truth[[3, 4]] = 2.0, -1.0
    search = Search(made_up(drawn(1), truth, 2))
    table = search.child_log_weights(state)
    out = {g for g, _ in state}
    for group, (t, tau) in product(range(len(search.linear.groups)), enumerate(SLABS)):
        known = np.isfinite(table[:, group, t])
        if group in out:
            assert not known.any()
        else:
            full = written_out(search, (*state, (group, tau)))
            assert table[known, group, t] == pytest.approx(full[known], abs=1e-6)
            # What is lost in rounding beside the best need not be known, but on a sound machine.
            assert np.all(full[~known] < table.max() - NEGLIGIBLE_LOG_WEIGHT)
            assert known.all() or state


def test_scales_without_weight_count_again_where_a_second_group_explains_the_rest() -> None:
    """With one of two large causes all small backgrounds have no weight; with both they have."""
    truth = np.zeros(17)
    truth[[3, 4, 11, 12, 13]] = 4.0, -4.0, 3.0, 3.0, -3.0
    search = Search(made_up(drawn(1), truth, 2))
    assert {1, 2} < {group for group, _ in search.best}
    for state, weights in search.visited.items():
        known = np.isfinite(weights)
        full = written_out(search, state)
        assert weights[known] == pytest.approx(full[known], abs=1e-6)
        assert search.log_weight(state) == pytest.approx(pooled(full), abs=1e-6)


@pytest.mark.parametrize("visits", [1, 2])
def test_directions_without_a_coefficient_count_as_scatter_alone(visits: int) -> None:
    """Where no station was visited twice, only the directions that coefficients move are kept."""
    full = made_up(drawn(1), np.zeros(17), 2)
    stations = np.repeat(np.eye(ROWS // visits), visits, axis=0)
    full = replace(full, stations=stations)
    kept = drop_unseen_directions(full)
    assert len(kept.residual) == (np.linalg.matrix_rank(full.columns) if visits == 1 else ROWS)
    before, after = Search(full), Search(kept)
    assert after.best == before.best
    difference = pooled(after.visited[()]) - pooled(before.visited[()])
    left = float(full.residual @ full.residual - kept.residual @ kept.residual)
    assert difference == pytest.approx((left - kept.station_remainder.chi2) / 2, abs=1e-6)
    assert left == pytest.approx(kept.station_remainder.chi2, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_the_best_of_all_states_of_two_is_found(seed: int) -> None:
    """Three causes that nearly show what two others do: one at a time goes astray there."""
    rng = np.random.default_rng(seed)
    columns, truth = drawn(seed), np.zeros(17)
    columns[:, 4] = columns[:, 2] + columns[:, 3] + rng.standard_normal(ROWS)
    columns[:, 5] = columns[:, 2] - columns[:, 3] + rng.standard_normal(ROWS)
    truth[rng.choice([2, 3, 4, 5], 2, replace=False)] = rng.choice([-1, 1], 2) * (0.4, 0.5)
    search = Search(made_up(columns, truth, seed))
    groups = range(len(search.linear.groups))
    states: list[State] = [()] + [((g, t),) for g, t in product(groups, SLABS)]
    states += [
        ((one, t), (other, u))
        for one, other in combinations(groups, 2)
        for t, u in product(SLABS, repeat=2)
    ]
    best = max(pooled(written_out(search, s)) for s in states)
    assert search.log_weight(search.best) >= best - 1e-6
    assert search.log_weight(search.best) == pytest.approx(pooled(written_out(search, search.best)))


@pytest.mark.parametrize("seed", [1, 4, 5, 8, 12])
def test_causes_that_explain_the_readings_only_together_are_found(seed: int) -> None:
    """Five of forty causes that show in eight ways: none of the five explains much by itself."""
    rng = np.random.default_rng([78, seed])
    ways, count = rng.standard_normal((ROWS, 8)), 2 + 40 + 9
    columns = 10 * ways @ rng.standard_normal((8, count)) / np.sqrt(8)
    columns += 0.3 * rng.standard_normal(columns.shape)
    truth, wrong = np.zeros(count), 2 + rng.choice(40, 5, replace=False)
    truth[wrong] = 5 * rng.choice([-1, 1], 5) * rng.uniform(0.6, 1.4, 5)
    search = Search(made_up(columns, truth, seed))
    state: State = ()
    for k in wrong.tolist():
        state = search.child(state, k - 2)
    assert search.log_weight(search.best) >= search.log_weight(state) - 1e-6


@pytest.mark.parametrize("start", [(), ((3, 1.0),), ((0, 3.0), (2, 1.0))])
def test_what_is_given_stands_out_whatever_the_readings_say(start: State) -> None:
    """Wherever the search begins; it had ended without where nothing at all was likelier."""
    truth = np.zeros(17)
    truth[3] = 2.0
    linear = made_up(drawn(4), truth, 4)
    name = linear.groups[0].name
    named = [(linear.groups[group].name, tau) for group, tau in start]
    mixture = Mixture(linear, [name], named)
    assert 0 in {group for group, _ in mixture.best}
    assert mixture.inclusion[0] == pytest.approx(1.0)
    assert mixture.log_weight(mixture.best) == pytest.approx(
        Mixture(linear, [name]).log_weight(mixture.best)
    )


@pytest.mark.parametrize("start", [((5, 1.0),), ((0, 3.0), (2, 1.0), (4, 0.3))])
def test_where_a_search_begins_does_not_say_where_it_ends(start: State) -> None:
    truth = np.zeros(17)
    truth[[3, 4]] = 2.0, -1.0
    linear = made_up(drawn(1), truth, 2)
    fresh = Search(linear)
    named = [(linear.groups[group].name, tau) for group, tau in start]
    assert Search(linear, start=named).best == fresh.best
    assert Search(linear, start=fresh.active_groups).best == fresh.best


def test_two_that_show_what_two_others_do_are_in_each_others_sets() -> None:
    """The second pair was never met by exchanging one at a time: it had no probability."""
    columns, truth = drawn(5), np.zeros(17)
    apart = 20 * np.random.default_rng(6).standard_normal(ROWS)
    columns[:, 4], columns[:, 5] = columns[:, 2] + apart, columns[:, 3] - apart
    truth[[2, 3]] = 1.0  # as the other two would show at that size, and no one with another
    mixture = Mixture(made_up(columns, truth, 5))
    held = {g for g, _ in mixture.best}
    assert held in ({0, 1}, {2, 3})
    alternatives = Alternatives(mixture)
    for member in held:
        odds = alternatives.probabilities(member)
        assert odds.sum() == pytest.approx(1.0)
        assert odds[-1] < 1e-3
        assert odds[list({0, 1, 2, 3} - held)].sum() > 0.2
    both = mixture.inclusion[:4]
    assert both.sum() == pytest.approx(2.0, abs=0.2)
    assert np.all(both > 0.15)


@pytest.mark.parametrize("size", [1e4, 1e7])
def test_misfits_of_millions_of_sigmas_are_searched(size: float) -> None:
    truth = np.zeros(17)
    truth[[3, 9]] = size, -size
    mixture = Mixture(made_up(drawn(8), truth, 8))
    assert np.all(np.isfinite(mixture.mean))
    assert {1, 6} <= {g for g, _ in mixture.best}


def test_a_cause_that_is_there_in_some_explanations_is_drawn_in_as_many() -> None:
    """One Gaussian of the same mean and spread had it beyond its tolerance twice as often."""
    columns, truth = drawn(9), np.zeros(17)
    columns[:, 4] = columns[:, 2] + 0.02 * np.random.default_rng(9).standard_normal(ROWS)
    truth[2] = 3.0
    mixture = Mixture(made_up(columns, truth, 9))
    weights = np.eye(17)[[0, 2, 4]]
    normal = np.random.default_rng(1).standard_normal((20_000, 3))
    drawn_from = mixture.draws(weights, normal)
    covariance, _ = mixture.averaged_covariances(8)
    sd = np.sqrt(np.diag(covariance)[[0, 2, 4]])
    assert np.abs((drawn_from.mean(axis=0) - mixture.mean[[0, 2, 4]]) / sd).max() < 0.05
    spread = np.cov(drawn_from.T) - covariance[np.ix_([0, 2, 4], [0, 2, 4])]
    assert np.abs(spread / sd / sd[:, None]).max() < 0.1
    beyond = (np.abs(drawn_from) > 1).mean(axis=0)
    assert np.all(beyond[1:] < mixture.inclusion[[0, 2]])
    one = norm(mixture.mean[2], sd[1])
    assert beyond[1] < 0.6 * (one.sf(1) + one.cdf(-1))


def test_larger_noise_that_can_have_no_weight_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    linear = made_up(drawn(1), np.zeros(17), 2)
    few = Mixture(linear)
    monkeypatch.setattr(linear_model, "NEGLIGIBLE_LOG_WEIGHT", np.inf)
    whole = Mixture(linear)
    assert len(few.scales) < len(whole.scales)
    assert few.best == whole.best
    assert few.inclusion == pytest.approx(whole.inclusion, abs=1e-12)
    assert few.mean == pytest.approx(whole.mean, abs=1e-12)


def test_a_slip_that_the_fit_does_not_follow_starts_no_other_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two visits to a changed machine were fitted twelve times, and searched twice."""
    rows = np.arange(2)
    groups = [
        replace(Group(f"!{k}", rows[:1], np.eye(1), False), of_data=True,
                source=SimpleNamespace(fault=Fault("outlier", rows[k : k + 1])))
        for k in rows
    ]  # fmt: skip
    mixture = SimpleNamespace(
        linear=SimpleNamespace(groups=groups), log_posterior_odds_if_sound=lambda: np.eye(2)
    )
    fitted = SimpleNamespace(rows=SimpleNamespace(leverage=np.array([0.1, 0.8])), problem=None)
    left_out = list[int]()

    def excluded(_: object, faults: list[Fault]) -> None:
        left_out.extend(faults[0].rows.tolist())
        raise NumericsError("it is not fitted")

    monkeypatch.setattr(base_fit, "with_faults_accounted_for", excluded)
    assert fits_without_a_slip(cast(Any, fitted), cast(Any, mixture)) == []
    assert left_out == [1]


def test_where_lapack_does_not_converge_the_search_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    several = np.random.default_rng(11).standard_normal((3, 20, 6))
    several[1, :, 5] = several[1, :, 4]
    found = [left_singular(columns) for columns in several]

    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fails)
    for columns, (left, singular) in zip(several, found, strict=True):
        other, same = left_singular(columns)
        assert same == pytest.approx(singular, abs=1e-6)
        shown, again = ((u * s) @ u.T for u, s in ((left, singular), (other, same)))
        assert again == pytest.approx(shown, abs=1e-9)
        wide = left_singular(columns.T)[1]
        assert wide == pytest.approx(singular, abs=1e-6)


@pytest.mark.parametrize("exact", [1.0, 1e4])
def test_a_covariance_is_one_however_exact_the_readings(exact: float) -> None:
    """Against the triangle of rows and prior, whose condition is the root of that of a precision:
    prior less gain loses all digits where readings determine a direction far better than the prior.
    """
    mixture = Mixture(made_up(exact * drawn(6), np.zeros(17), 7))
    at, every, state = np.array([0, 1, 3, 8, 12]), np.arange(17), ((1, 1.0), (6, 3.0))
    for scale in mixture.scales:
        found = mixture._covariances(at)(state, scale)
        assert np.linalg.eigvalsh(found).min() > 0
        spread = mixture.slab_root(state)
        prior = np.linalg.cholesky(np.diag(scale.spike) + spread @ spread.T)
        rows = mixture.linear.columns / np.sqrt(1 + scale.noise**2)
        inverse = np.linalg.inv(np.linalg.qr(np.vstack([np.linalg.inv(prior), rows]))[1])
        whole = inverse @ inverse.T
        assert found == pytest.approx(whole[np.ix_(at, at)], rel=1e-7, abs=1e-9 / exact)
        assert mixture._covariances(every)(state, scale) == pytest.approx(whole, rel=1e-5, abs=1e-9)


def log_likelihood(rest: Array, covariance: Array) -> float:
    square = rest @ np.linalg.solve(covariance, rest)
    return -float(square + np.linalg.slogdet(covariance)[1]) / 2


@pytest.mark.parametrize("causes", [12, 80], ids=["more readings", "more causes"])
def test_other_readings_against_their_covariance_written_out(causes: int) -> None:
    rng, n, own = np.random.default_rng(causes), 30, np.arange(10)
    machine, residual = 3 * rng.standard_normal((n, causes)), 5 * rng.standard_normal(n)
    datums = np.repeat(50 * np.eye(3), 10, axis=0)
    weighing = Weighing(np.full(n, 2.0), np.zeros(n), np.arange(n))
    both = np.hstack([machine, datums])
    wide = FullLikelihood(
        weighing, both, residual, sparse.identity(n, format="csr"), np.arange(n), (1.0, 1.0)
    )
    cov = np.eye(n) + machine @ machine.T + datums @ datums.T
    change = rng.standard_normal((n, 2))
    changed = residual[:, None] + change / 2
    expected = [log_likelihood(one, cov) for one in changed.T]
    assert wide.log_likelihood(change) == pytest.approx(expected)
    silent = log_likelihood(changed[10:, 0], cov[10:, 10:])
    deletion = wide.deletion(own, change[:, 0])
    assert wide.log_likelihood(change)[0] + deletion.gain == pytest.approx(silent)
    foretold = cov[:10, 10:] @ np.linalg.solve(cov[10:, 10:], residual[10:])
    difference = wide.deletion(own, np.zeros(n)).difference
    assert difference == pytest.approx(2 * (residual[:10] - foretold))
    far = np.where(np.arange(n) < 10, 20.0, 1.0) * residual
    noisier = [cov + np.diag((ratio**2 - 1) * (np.arange(n) < 10)) for ratio in (1.5, 4.0)]
    gains = [log_likelihood(far, one) - log_likelihood(far, cov) for one in noisier]
    assert replace(wide, residual=far).noise_gains(own, (1.5, 4.0)) == pytest.approx(gains)
    columns, placed, rest = rng.standard_normal((10, causes)), np.full((10, 1), 50.0), residual[::3]
    moved = np.vstack([columns, machine[10:]])
    other = np.eye(n) + moved @ moved.T
    other[10:, 10:] += datums[10:] @ datums[10:].T
    other[:10, :10] += placed @ placed.T
    labelled = log_likelihood(np.concatenate([rest, residual[10:]]), other)
    prediction = wide.prediction_without(own, np.arange(causes))
    assert prediction.relabelled(columns, placed, rest) == pytest.approx(labelled, abs=1e-6)


@pytest.mark.parametrize("causes", [3, 40], ids=["more rows", "more causes"])
def test_readings_with_equal_rows_are_weighed_by_their_sums(causes: int) -> None:
    """Three visits to each of ten stations, of which five are a setup that may have other labels;
    some readings of a station, and all of them, against the others.
    """
    rng, group = np.random.default_rng(causes), np.tile(np.arange(10), 3)
    columns, residual = 3 * rng.standard_normal((10, causes)), 5 * rng.standard_normal(30)
    weighing = Weighing(np.full(30, 2.0), np.zeros(30), group)
    every = sparse.identity(30, format="csr")
    means = sparse.csr_matrix(np.eye(10)[group] / np.sqrt(3))
    dense = FullLikelihood(weighing, columns[group], residual, every, np.arange(30), (1.0, 1.0))
    sums = FullLikelihood(weighing, np.sqrt(3) * columns, residual, means, group, (1.0, 1.0))
    change = rng.standard_normal((30, 2))
    assert sums.log_likelihood(change) == pytest.approx(dense.log_likelihood(change))
    assert sums.expected_noise(change[:, 0]) == pytest.approx(dense.expected_noise(change[:, 0]))
    setup = np.flatnonzero(group < 5)
    for rows in (setup, np.array([0, 1, 10, 27])):
        one, other = (w.deletion(rows, change[:, 1]) for w in (sums, dense))
        assert one.difference == pytest.approx(other.difference)
        assert one.gain == pytest.approx(other.gain)
    far = np.where(group < 5, 20.0, 1.0) * residual
    one, other = (replace(w, residual=far).noise_gains(setup, (2.0, 9.0)) for w in (sums, dense))
    assert one == pytest.approx(other)
    assert (one > 0).all()
    again, placed, rest = rng.standard_normal((5, causes)), np.ones((15, 1)), residual[::2]
    predictions = [w.prediction_without(setup, np.arange(causes)) for w in (sums, dense)]
    one, other = (p.relabelled(again[group[setup]], placed, rest / 2) for p in predictions)
    assert one == pytest.approx(other)
    # Other labels change the rows and not the scatter of readings with equal rows.
    assert sums.deletion(setup).relabelling_limit < dense.deletion(setup).relabelling_limit + 5


@pytest.mark.parametrize("setups", [[1], [0, 2]], ids=["one setup", "two setups"])
def test_other_labels_against_the_factorisation_of_all_readings(setups: list[int]) -> None:
    """Datums of 2000 standard deviations: sums of squares alone lose six digits of them."""
    rng, setup, machine = np.random.default_rng(7), np.repeat(np.arange(4), 60), 40
    rough = rng.standard_normal((4, 8, machine)) * 100.0 ** -np.arange(8)[:, None]
    parts = [[rng.standard_normal((60, 8)) @ part for part in rough] for _ in range(2)]
    read, labelled = (300 * np.vstack(one) for one in parts)
    datums, residual = 2000 * np.eye(4)[setup], 5 * rng.standard_normal(240)
    columns, n = np.hstack([read, datums]), len(setup)
    blocks = [_span(columns[setup == k]) for k in range(4)]
    basis = sparse.csr_matrix(sparse.block_diag(blocks))
    weighing = Weighing(np.ones(n), np.zeros(n), np.arange(n))
    likelihood = FullLikelihood(
        weighing, basis.T @ columns, residual, basis, np.arange(n), (1.0, 1.0)
    )
    rows, after = np.flatnonzero(np.isin(setup, setups)), columns.copy()
    after[rows, :machine] = labelled[rows]
    expected = []
    for one in (columns, after):
        stacked = np.vstack([np.column_stack([one, residual]), np.eye(44, 45)])
        size = np.abs(np.diag(np.linalg.qr(stacked, mode="r")))
        expected.append(-(size[-1] ** 2) / 2 - np.log(size[:-1]).sum())
    found = likelihood.prediction_without(rows, np.arange(machine)).relabelled(
        labelled[rows], datums[rows], residual[rows]
    )
    assert basis.shape[1] < n / 3
    assert found == pytest.approx(expected[1], abs=1e-6)
    assert likelihood.log_likelihood(np.zeros((n, 1)))[0] == pytest.approx(expected[0], abs=1e-6)


def test_readings_far_finer_than_their_datums_are_still_weighed() -> None:
    """A nanometre of noise beside ten millimetres of datum: rounding exceeds the noise."""
    rng, n = np.random.default_rng(1), 504
    datums = np.repeat(1e7 * np.eye(n // 9), 9, axis=0)
    columns = np.hstack(
        [1e7 * rng.standard_normal((n, 5)) @ rng.standard_normal((5, 2 * n)), datums]
    )
    weighing = Weighing(np.ones(n), np.zeros(n), np.arange(n))
    residual = rng.standard_normal(n)
    wide = FullLikelihood(
        weighing, columns, residual, sparse.identity(n, format="csr"), np.arange(n), (1.0, 1.0)
    )
    assert np.isfinite(wide.log_likelihood(np.zeros((n, 1)))).all()


@dataclass(frozen=True)
class Part:
    """What `merge_families` reads of an explanation."""

    values: dict[str, float]
    probability: float
    families: tuple[str, ...] = ()
    sigmas = dict.fromkeys("wxyz", 1.0)

    @property
    def name(self) -> str:
        return " ".join(self.values)

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(self.values)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"x": 9.0, "y": 0.3, "z": 0.1}, {"x": 0.875, "w": 0.125}),
        ({"x": 9.0, "y": 3.0, "z": 0.1}, {"x": 0.25, "x y": 0.625, "w": 0.125}),
        ({"x": 9.0, "y": 3.0, "z": 4.0}, {"x": 0.25, "x y": 0.125, "x y z": 0.5, "w": 0.125}),
        ({"x": 0.5, "y": 0.3, "z": 0.1}, {"x": 0.25, "x y": 0.125, "x y z": 0.5, "w": 0.125}),
    ],
)
def test_a_family_of_which_one_part_is_not_zero_is_that_part(
    values: dict[str, float], expected: dict[str, float]
) -> None:
    """Whole effect, two legs and one leg: merged in whichever order they come."""
    nested = [({"w": 5.0}, 0.125), *((dict([*values.items()][:k]), p)
              for k, p in ((1, 0.25), (2, 0.125), (3, 0.5)))]  # fmt: skip
    parts = [Part(v, p) for v, p in nested]
    for given in permutations(parts):
        merged = merge_families(cast(Any, given))
        assert {e.name: e.probability for e in merged} == expected
        names = {name for e in merged for name in (e.name, *e.families)}
        assert names == {part.name for part in parts}
