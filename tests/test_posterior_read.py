"""Reading a posterior: sets, names and covariances of made-up probabilities with known answers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orthoglide.effects import CATALOGUE
from orthoglide.explanation.credible_sets import _CredibleSetReader
from orthoglide.explanation.linear_model import Group
from orthoglide.explanation.mixture import Mixture
from orthoglide.parameters import Parameter

NONE = np.zeros(0, dtype=np.intp)


def claimed(odds: list[float], free: list[bool]) -> Any:
    """What is claimed of groups with these probabilities, the last that of nothing."""
    groups = tuple(
        Group(name, NONE, np.zeros((0, 1)), f, source=None if f else SimpleNamespace(name=name))
        for f, name in ((f, Parameter(f"g{k}")) for k, f in enumerate(free))
    )
    mixture = SimpleNamespace(linear=SimpleNamespace(groups=groups))

    class Reader(_CredibleSetReader):
        def _cause(self, member, odds, ranges):
            return "cause", [k for k, _ in odds]

        def _located(self, member, odds, ranges, probability):
            return "located", [k for k, _ in odds], probability

    alternatives = SimpleNamespace(probabilities=lambda _: np.array(odds))
    return Reader(SimpleNamespace(mixture=mixture, alternatives=alternatives)).credible_set(0, ())


@pytest.mark.parametrize(
    ("odds", "chosen"),
    [
        ([0.96, 0.03, 0.01, 0.0], [0]),
        ([0.90, 0.08, 0.02, 0.0], [0, 1]),
        ([0.02, 0.50, 0.46, 0.02], [1, 2]),  # 0.95 of the 0.98 that anything is there
        ([0.40, 0.30, 0.25, 0.05], [0, 1, 2]),
    ],
)
def test_a_set_is_the_smallest_that_holds_the_truth_in_95_of_100(
    odds: list[float], chosen: list[int]
) -> None:
    assert claimed(odds, [False] * 3) == ("cause", chosen)


@pytest.mark.parametrize(("count", "claims"), [(21, True), (22, False)])
def test_one_of_more_than_twenty_is_no_claim(count: int, claims: bool) -> None:
    found = claimed([*[0.95 / count] * count, 0.05], [False] * count)  # 0.95 of these are a set
    assert found == (("cause", list(range(20))) if claims else None)


@pytest.mark.parametrize(("nothing", "claims"), [(0.05, True), (0.099, True), (0.101, False)])
def test_a_claim_is_nine_in_ten_sure(nothing: float, claims: bool) -> None:
    found = claimed([1 - nothing, 0.0, nothing], [False] * 2)
    assert found == (("cause", [0]) if claims else None)


@pytest.mark.parametrize(
    ("odds", "free", "kind"),
    [
        ([0.93, 0.07, 0.0], [False, True], "cause"),
        ([0.80, 0.20, 0.0], [False, True], "cause"),
        ([0.40, 0.35, 0.25, 0.0], [False, True, True], "located"),  # places, together
        ([0.51, 0.49, 0.0], [True, False], "located"),
        ([0.96, 0.04, 0.0], [True, False], "located"),
    ],
)
def test_a_name_is_given_where_a_place_is_unlikely(
    odds: list[float], free: list[bool], kind: str
) -> None:
    assert claimed(odds, free)[0] == kind


def test_the_parts_of_a_pair_are_one_cause() -> None:
    names = ("axis_tilt.y.z", "screw_error.x.sin", "screw_error.x.cos", "plate_trefoil.bed.cos",
             "plate_trefoil.other.sin")  # fmt: skip
    shared = (Parameter("screw_error", "x"), Parameter("plate_trefoil", setup="bed"))
    names = (*map(CATALOGUE.parameter, names), *shared)
    groups = [SimpleNamespace(name=name, source=SimpleNamespace(name=name), free_form=False,
                              of_data=False) for name in names]  # fmt: skip
    mixture = SimpleNamespace(linear=SimpleNamespace(groups=groups))
    reader = _CredibleSetReader(SimpleNamespace(mixture=mixture))
    pooled = reader._pool_pairs(np.array([0.3, 0.1, 0.2, 0.15, 0.05, 0.1, 0.1]))
    assert pooled == pytest.approx([0.3, 0.0, 0.0, 0.0, 0.05, 0.4, 0.25])


def test_the_covariance_has_what_explanations_differ_by() -> None:
    """Variance of a mixture: the mean variance, and the variance of the means."""
    rng = np.random.default_rng(0)
    weights, means = np.array([0.5, 0.3, 0.2]), rng.standard_normal((3, 2))
    roots = rng.standard_normal((3, 2, 2))
    covariances = roots @ roots.transpose(0, 2, 1)
    states = [(), ((0, 1.0),), ((1, 1.0),)]
    one = Mixture.__new__(Mixture)
    groups = tuple(Group(f"g{k}", np.array([k]), np.eye(1), False) for k in range(2))
    one.linear = SimpleNamespace(groups=groups, fixed_sd=np.zeros(2))
    one.best = ()
    one.scales = [SimpleNamespace(spike=np.array([0.25, 4.0]), noise=0.0)]
    vars(one)["weights"] = {s: np.array([w]) for s, w in zip(states, weights, strict=True)}

    one._mean = lambda state, scale: means[states.index(state)]
    one._covariances = lambda at: lambda state, _: covariances[states.index(state)][np.ix_(at, at)]
    covariance, prior = one.averaged_covariances(2)
    middle = weights @ means
    apart = means - middle
    assert one.mean == pytest.approx(middle)
    assert covariance == pytest.approx(
        np.einsum("k,kij->ij", weights, covariances) + (weights * apart.T) @ apart
    )
    assert prior == pytest.approx(np.diag([0.25 + 0.3, 4.0 + 0.2]))
