"""Identification: mechanism against reduction, programme against nested closure, planted machines.

Readings come from the independent machine of ``rig.py`` where they are noisy, and from the
reduction where they must be exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from orthoglide import reduction
from orthoglide.errors import CrossCheckError, InputError, SolverError, UnidentifiableError
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate, Problem, crosscheck as crosscheck_module, solve
from orthoglide.fit.least_squares import Nuisances, linearise, normal_equations, nuisances
from orthoglide.fit.nlp import Nlp, NlpResult
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.machine_file import Dial, MachineFile
from orthoglide.observations import Campaign, Setup, protocol, read_campaign
from orthoglide.simulation import simulate as simulated
from tests.factors import problem_of
from tests.relabelling import legs_renamed, relabelled
from tests.rig import Rig
from tests.rig_campaigns import Row, protocol_rows, simulate

NANOMETRE = 1e-9
NOISE = 2e-5
SIX = tuple(f"{family}.{leg}" for family in ("joint_offset", "leg_length") for leg in LEGS)
PLANTED = {
    "joint_offset.x": -5e-4, "joint_offset.y": 6e-4, "joint_offset.z": -1.7e-3,
    "leg_length.x": 5e-5, "leg_length.y": -8e-5, "leg_length.z": 3e-5,
}  # fmt: skip
MACHINE = Machine(MachineFile(dial=Dial(repeatability=NOISE)))


EXACT = MachineFile(dial=Dial(resolution=0.0, repeatability=NOISE, placement=0))


@pytest.fixture(scope="module", autouse=True)
def _engine_built_once_for_all_tests() -> None:
    MACHINE.model.engine  # noqa: B018


def as_campaign(rows: Sequence[Row], name: str = "rig") -> Campaign:
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    return Campaign.from_frame(columns, name=name)


@cache
def measured(
    kind: str, seed: int = 0, errors: tuple[tuple[str, float], ...] = (), name: str = "rig"
) -> Campaign:
    """A noisy campaign of the independent machine; ``thin`` takes every third posture round."""
    rig = Rig(errors={**PLANTED, **dict(errors)})
    rows = protocol_rows(kind.partition(" ")[0])
    if kind == "standard once":
        rows = [row for row in rows if row["repeat"] == 1]
    if kind == "standard ends":
        rows = [row for row in rows if row["repeat"] == 1 and row["posture"] != "zero"]
    return as_campaign(simulate(rig, rows, np.random.default_rng(seed), noise=NOISE), name)


@cache
def published(number: int = 2) -> Campaign:
    return read_campaign(str(files("orthoglide") / "data" / f"experiment{number}.csv"))


@cache
def fit_of_published(priors: bool = True) -> Estimate:
    return identify(published(), priors=priors)


@cache
def fit_of_few() -> Estimate:
    return identify(measured("standard once"), MACHINE, method="nested")


def predicted(
    machine: Machine, values: Mapping[str, float], sheet: Campaign, noise: float = 0.0
) -> Campaign:
    """What a machine of this package shows, with a datum a setup."""
    rng = np.random.default_rng(5)
    shown = machine.model.readings(values, sheet)
    datum = rng.uniform(-1e-3, 1e-3, len(sheet.setups))[sheet.setup]
    return sheet.with_readings(shown + datum + noise * rng.standard_normal(len(sheet)))


def agree(one: Estimate, other: Estimate, within: float = NANOMETRE) -> None:
    assert one.names == other.names
    assert float(np.max(np.abs(one.x - other.x))) < within


# -- the mechanism's programme against the reduction's own fit -----------------------------------

FREE_SETS = [
    ("joint_offset",),
    ("leg_length",),
    ("joint_offset", "leg_length"),
    ("joint_offset.x",),
    ("leg_length.z",),
    ("joint_offset", "leg_length.y"),
    ("joint_offset.y", "joint_offset.z", "leg_length.x", "leg_length.z"),
    ("joint_offset", "leg_length.common"),
]


@pytest.mark.thorough(
    except_for=[
        "joint_offset-True",
        "joint_offset.y joint_offset.z leg_length.x leg_length.z-False",
        "joint_offset leg_length.common-False",
    ]
)
@pytest.mark.parametrize("priors", [True, False])
@pytest.mark.parametrize("free", FREE_SETS, ids=" ".join)
def test_programme_is_the_reductions_fit_on_every_free_set(
    free: tuple[str, ...], priors: bool
) -> None:
    campaign = measured("standard once")
    found = identify(campaign, MACHINE, free, priors=priors, method="nlp")
    agree(found, identify(campaign, MACHINE, free, priors=priors, method="reduction"))
    assert found.method == "nlp"
    assert found.check is not None
    assert found.check.reduction < NANOMETRE
    assert found.check.second_order
    assert found.optimality < 1e-4


@pytest.mark.parametrize(
    ("kind", "count"),
    [("standard ends", 12), ("sweep", 252)],
)
def test_programme_is_the_reductions_fit_on_campaigns_of_all_sizes(kind: str, count: int) -> None:
    campaign = measured(kind)
    assert len(campaign) == count
    found = identify(campaign, MACHINE, method="nlp")
    agree(found, identify(campaign, MACHINE, method="reduction"))
    for name, truth in PLANTED.items():
        assert abs(found.values[name] - truth) < 5 * found.sigmas[name]


@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([0.3, 1.0, 3.0]))
def test_programme_is_the_reductions_fit_of_any_machine(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    sizes = np.repeat([2e-3, 5e-5], 3) * scale
    errors = dict(zip(SIX, (sizes * rng.standard_normal(6)).tolist(), strict=True))
    campaign = as_campaign(simulate(Rig(errors=errors), "standard", rng, noise=NOISE))
    agree(identify(campaign, MACHINE, method="nlp"), identify(campaign, MACHINE, method="nested"))


def test_a_long_first_step_does_not_end_in_a_far_minimum() -> None:
    """Readings so good that a whole Newton step along a weak direction leaves the machine."""
    rng = np.random.default_rng(13 % 5)
    sizes = np.repeat([2e-3, 5e-5], 3)
    errors = dict(zip(SIX, (sizes * rng.standard_normal(6)).tolist(), strict=True))
    rng = np.random.default_rng([0, ord("a"), 2, 13])
    campaign = as_campaign(simulate(Rig(errors=errors), "standard", rng, noise=2e-6))
    fine = Machine(MachineFile(dial=Dial(repeatability=2e-6)))
    for method in ("reduction", "nlp", "nested"):
        found = identify(campaign, fine, priors=False, method=method)  # type: ignore[arg-type]
        assert found.on_bound == ()
        assert found.scores.rms < 1e-5


@pytest.mark.parametrize(("number", "priors"), [(2, True), (3, False)])
def test_published_experiments(number: int, priors: bool) -> None:
    found = identify(published(number), priors=priors, method="nlp")
    agree(found, identify(published(number), priors=priors, method="nested"))


# -- planted machines ----------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["nlp", "nested", "reduction"])
def test_a_planted_machine_is_recovered(method: Any) -> None:
    machine = Machine(EXACT)
    campaign = predicted(machine, PLANTED, protocol("sweep"))
    found = identify(campaign, machine, priors=False, method=method)
    for name, truth in PLANTED.items():
        # Rounding of the readings, 1e-17 m, is worth a little along the weak directions.
        assert found.values[name] == pytest.approx(truth, abs=1e-12)
    assert found.scores.rms < 1e-14
    assert found.sigma_scale == 1.0
    assert found.machine.values == pytest.approx(PLANTED, abs=1e-12)


def test_planted_effects_are_recovered() -> None:
    machine = Machine(EXACT)
    planted = {
        "joint_offset.x": 1e-3, "axis_tilt.y.z": 2e-3, "backlash.x": 4e-5,
        "bar_mismatch.z": 2e-4, "gauge_drift.yx-0.5": 3e-8, "rail_bow.z.x": 5e-5,
    }  # fmt: skip
    campaign = predicted(machine, planted, protocol("sweep"))
    found = identify(campaign, machine, tuple(planted), priors=False)
    for name, truth in planted.items():
        assert found.values[name] == pytest.approx(truth, abs=1e-9 * abs(truth) + 1e-13)
    assert not any(name.startswith("gauge") for name in found.machine.values)


@pytest.mark.thorough
def test_what_the_machine_file_knows_is_held_or_started_from() -> None:
    """Held parameters count in full; a start at the answer ends there."""
    known = MACHINE.with_parameters({n: v for n, v in PLANTED.items() if "offset" in n})
    held = identify(measured("sweep"), known, ["leg_length"], method="nlp")
    assert held.check is not None
    assert held.check.reduction < NANOMETRE
    assert set(held.values) == set(SIX[3:])
    assert held.scores.rms < 1.5 * NOISE
    started = identify(measured("sweep"), MACHINE.with_parameters(PLANTED))
    # The slopes of the placements are taken near the start: worth a hundredth of a sigma.
    agree(started, identify(measured("sweep"), MACHINE), within=1e-7)
    assert np.allclose(started.problem.start, list(PLANTED.values()))


# -- two ways of closing the loops ---------------------------------------------------------------

EFFECTS = [
    ("joint_offset", "leg_length", "axis_tilt"),
    ("joint_offset", "leg_length", "backlash", "gauge_drift"),
    ("joint_offset", "leg_length", "bar_mismatch"),
    ("joint_offset", "axis_tilt.cyclic", "axis_offset.xy.antisymmetric"),
    ("joint_offset", "leg_length", "mount_tilt.b.common", "rail_bow", "encoder_scale.common"),
    ("joint_offset", "gauge_scale", "gauge_direction", "parallelogram_width"),
]


@pytest.mark.thorough(
    except_for=["leg_length bar_mismatch", "gauge_scale gauge_direction parallelogram_width"]
)
@pytest.mark.parametrize("free", EFFECTS, ids=lambda f: " ".join(f[1:]))
def test_programme_and_nested_closure_agree(free: tuple[str, ...]) -> None:
    errors = (("axis_tilt.y.z", 1e-3), ("backlash.x", 3e-5), ("bar_mismatch.z", 1e-4))
    campaign = measured("standard", 1, errors)
    found = identify(campaign, MACHINE, free, method="nlp")
    agree(found, identify(campaign, MACHINE, free, method="nested"))
    assert found.check is None
    with pytest.raises(InputError, match="reduction"):
        identify(campaign, MACHINE, free, method="reduction")


@pytest.mark.thorough(except_for=["joint_offset axis_tilt.cyclic"])
@pytest.mark.parametrize(
    "free",
    [("joint_offset",), ("joint_offset", "axis_tilt.cyclic"), ("joint_offset", "backlash.y")],
    ids=" ".join,
)
def test_they_agree_without_priors(free: tuple[str, ...]) -> None:
    campaign = measured("sweep", 2, (("axis_tilt.y.z", 1e-3),))
    agree(
        identify(campaign, MACHINE, free, priors=False, method="nlp"),
        identify(campaign, MACHINE, free, priors=False, method="nested"),
    )


@pytest.mark.parametrize("limit", ["NLP_POSTURES", "NLP_UNKNOWNS"])
def test_many_postures_or_unknowns_are_nested(limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from orthoglide.fit import solving

    assert identify(measured("standard once"), MACHINE).method == "nlp"
    monkeypatch.setattr(solving, limit, 3)
    assert identify(measured("standard once"), MACHINE).method == "nested"


def test_a_programme_is_built_once_for_many_readings() -> None:
    problem, nuisance, scale = programme_parts(measured("standard"))
    programme = Nlp(problem, nuisance, scale)
    for seed in (1, 2):
        other = problem.with_leg_readings(measured("standard", seed).reading)
        found = programme.solve(other.measured, np.zeros(6))
        assert found.closure < 1e-12
        nested = solve(replace(other), method="nested")
        # The frozen columns belong to the first readings: what differs is a placement's slope.
        assert np.max(np.abs(found.x - nested.x)) < 1e-3 * np.max(np.abs(nested.x))


def programme_parts(campaign: Campaign) -> tuple[Problem, Nuisances, np.ndarray]:
    problem = posed(campaign)
    first = linearise(problem, problem.start)
    nuisance = nuisances(problem, first.reading_poses)
    here = normal_equations(problem, first, nuisance)
    return problem, nuisance, 1 / np.sqrt(np.diag(here.information))


def posed(*campaigns: Campaign, free: Sequence[str] = SIX, **options: Any) -> Problem:
    return problem_of(MACHINE, campaigns, free, **options)


# -- several campaigns ---------------------------------------------------------------------------


def two_campaigns() -> list[Campaign]:
    """The same machine; between the campaigns drive x lost its reference."""
    return [
        measured("standard", 3, name="before"),
        measured("standard", 4, (("joint_offset.x", 4e-4),), name="after"),
    ]


def test_shared_and_own_parameters() -> None:
    found = identify(two_campaigns(), MACHINE, own=["joint_offset.x"], method="nlp")
    assert {"joint_offset.x@before", "joint_offset.x@after", "joint_offset.y"} <= set(found.names)
    moved = found.values["joint_offset.x@after"] - found.values["joint_offset.x@before"]
    assert moved == pytest.approx(9e-4, abs=1e-4)
    assert found.machine.values["joint_offset.x"] == found.values["joint_offset.x@after"]
    assert found.machine_of(0).values["joint_offset.x"] == found.values["joint_offset.x@before"]
    assert found.check is not None
    assert found.check.reduction < NANOMETRE
    nested = identify(two_campaigns(), MACHINE, own=["joint_offset.x"], method="nested")
    agree(found, nested)


@pytest.mark.thorough
def test_sharing_what_has_changed_shows_as_lack_of_fit() -> None:
    shared = identify(two_campaigns(), MACHINE)
    own = identify(two_campaigns(), MACHINE, own=["joint_offset"])
    assert shared.sigma_scale > 2
    assert own.sigma_scale == 1.0
    assert own.scores.chi2 < shared.scores.chi2 / 4


@pytest.mark.thorough
def test_everything_own_is_each_campaign_alone() -> None:
    both = two_campaigns()
    joint = identify(both, MACHINE, own=["joint_offset", "leg_length"])
    for campaign in both:
        alone = identify(campaign, MACHINE)
        assert len(alone.values) == 6
        for name, value in alone.values.items():
            assert joint.values[f"{name}@{campaign.name}"] == pytest.approx(value, abs=NANOMETRE)


@pytest.mark.thorough
def test_a_campaign_twice_is_twice_the_knowledge() -> None:
    one = measured("sweep")
    twice = identify([one, replace(one, name="again")], MACHINE, ["joint_offset"], priors=False)
    once = identify(one, MACHINE, ["joint_offset"], priors=False)
    agree(twice, once, within=1e-8)
    assert len(once.names) == 3
    for name in once.names:
        assert twice.sigmas[name] == pytest.approx(once.sigmas[name] / np.sqrt(2), rel=1e-3)


@pytest.mark.parametrize(
    ("campaigns", "options", "message"),
    [
        ([], {}, "no campaign"),
        (["a", "a"], {}, "have the same name"),
        (["a"], {"own": ["axis_tilt"]}, "not free"),
        (["a"], {"free": []}, "nothing is free"),
        (["a"], {"free": ["axis_twist"]}, "axis_twist"),
        (["a"], {"free": ["joint_offset.q"]}, "joint_offset.q"),
        (["a"], {"free": ["gauge_drift.nowhere"]}, "gauge_drift.nowhere"),
        (["a"], {"bounds": {"joint_offset": -1.0}}, "positive"),
        (["a"], {"noise": 0.0}, "noise"),
    ],
)
def test_refuses_what_makes_no_sense(
    campaigns: list[str], options: dict[str, Any], message: str
) -> None:
    several = [measured("standard once", name=name) for name in campaigns]
    with pytest.raises(InputError, match=message):
        identify(several, MACHINE, **options)


# -- symmetries ----------------------------------------------------------------------------------


@pytest.mark.parametrize("free", [SIX, (*SIX, "axis_tilt"), ("joint_offset", "bar_mismatch")])
def test_relabelling_a_campaign_relabels_the_result(free: tuple[str, ...]) -> None:
    campaign = measured("standard", 6, (("axis_tilt.x.y", 1e-3),))
    plain = identify(campaign, MACHINE, free, method="nested")
    turned = identify(legs_renamed(campaign), MACHINE, free, method="nested")
    for name, value in plain.values.items():
        assert turned.values[relabelled(name)] == pytest.approx(value, abs=NANOMETRE)
        assert turned.sigmas[relabelled(name)] == pytest.approx(plain.sigmas[name], rel=1e-6)
    assert turned.scores.chi2 == pytest.approx(plain.scores.chi2, rel=1e-9)


@settings(max_examples=5, deadline=None)
@given(flips=st.lists(st.booleans(), min_size=6, max_size=6))
def test_a_dial_that_counts_backwards_says_the_same(flips: list[bool]) -> None:
    campaign = measured("standard once")
    signs = np.where(flips, -1, 1)
    setups = tuple(replace(s, sign=int(k)) for s, k in zip(campaign.setups, signs, strict=True))
    turned = replace(campaign, setups=setups, reading=campaign.reading * signs[campaign.setup])
    agree(identify(turned, MACHINE, method="nested"), fit_of_few(), 1e-12)


@settings(max_examples=5, deadline=None)
@given(datum=st.lists(st.floats(-0.01, 0.01), min_size=6, max_size=6), seed=st.integers(0, 99))
def test_neither_datum_nor_order_of_rows_matters(datum: list[float], seed: int) -> None:
    campaign = measured("standard once")
    moved = campaign.with_readings(campaign.reading + np.array(datum)[campaign.setup])
    shuffled = moved.subset(np.random.default_rng(seed).permutation(len(moved)))
    agree(identify(shuffled, MACHINE, method="nested"), fit_of_few(), 1e-11)


# -- what the readings cannot determine ----------------------------------------------------------


def test_common_axis_offset_cannot_be_seen() -> None:
    """Only differences toward one axis are: three directions, each of a joint offset and the two
    axis offsets along it, which are named once.
    """
    with pytest.raises(UnidentifiableError, match="do not determine") as caught:
        identify(measured("sweep"), MACHINE, ["joint_offset", "axis_offset"], priors=False)
    text, directions = str(caught.value), caught.value.directions
    assert "let the tolerances act as priors" in text
    groups = {frozenset(direction) for direction in directions}
    assert (len(directions), len(groups)) == (3, 3)
    assert all(len(group) == 3 and any(direction.values())
               for group, direction in zip(groups, directions, strict=True))  # fmt: skip
    assert all(text.count(name) == 1 for group in groups for name in group)
    identify(measured("sweep"), MACHINE, ["joint_offset", "axis_offset"])  # priors make it whole


def test_backlash_is_not_seen_from_one_side() -> None:
    sheet = replace(measured("standard"), approach=np.ones((54, 3)))
    with pytest.raises(UnidentifiableError, match=r"backlash\.x"):
        identify(sheet, MACHINE, ["joint_offset", "backlash"], priors=False)


def test_fewer_readings_than_unknowns() -> None:
    few = measured("standard once")
    few = few.subset((few.leg == 0) & (few.setup == 0))
    with pytest.raises(UnidentifiableError):
        identify(few, MACHINE, priors=False)
    found = identify(few, MACHINE)  # the priors answer for the rest, and that is said
    assert any(not np.isfinite(weak.sigma) for weak in found.weak)
    assert "nothing is seen" in " ".join(str(weak) for weak in found.weak)


def test_weak_directions_in_words() -> None:
    found = fit_of_published(priors=False)
    assert len(found.weak) == 3
    for weak in found.weak:
        (offset, one), (length, other) = weak.parameters.items()
        assert offset.startswith("joint_offset")
        assert length == offset.replace("joint_offset", "leg_length")
        assert one == pytest.approx(other, rel=0.1)
        assert f"{offset} {other:+.2f} {length}: sigma" in str(weak)
        # The sigma along the direction, by hand from the covariance.
        places = [found.names.index(name) for name in weak.parameters]
        along = np.zeros(len(found.names))
        along[places] = list(weak.parameters.values())
        by_hand = np.sqrt(along @ found.covariance @ along) * 1e3
        assert weak.sigma <= by_hand * (1 + 1e-9)
        assert weak.sigma_with_priors == pytest.approx(by_hand, rel=0.02)
        assert weak.unit == "mm"
    for weak in fit_of_published().weak:
        assert weak.sigma_with_priors < weak.sigma / 10
        assert "with the tolerances as priors" in str(weak)
    assert identify(published(), free=["joint_offset"]).weak == ()


# -- bounds, noise and scaling -------------------------------------------------------------------


@pytest.mark.thorough(
    except_for=["nlp-joint_offset.z", "nested-joint_offset", "reduction-joint_offset.z"]
)
@pytest.mark.parametrize("key", ["joint_offset", "joint_offset.z"])
@pytest.mark.parametrize("method", ["nlp", "nested", "reduction"])
def test_bounds_hold_and_are_reported(method: Any, key: str) -> None:
    campaign = measured("standard once")
    found = identify(campaign, MACHINE, ["joint_offset"], bounds={key: 1e-3}, method=method)
    assert found.values["joint_offset.z"] == pytest.approx(-1e-3, rel=1e-7)
    assert found.on_bound == ("joint_offset.z",)
    assert "(on its bound)" in str(found)
    assert any("ended on its bound" in warning for warning in found.warnings)
    # The others are where they would be were this one known to be there.
    there = MACHINE.with_parameters({"joint_offset.z": -1e-3})
    rest = identify(campaign, there, ["joint_offset.x", "joint_offset.y"])
    for name, value in rest.values.items():
        assert found.values[name] == pytest.approx(value, abs=1e-6)  # slopes taken elsewhere


@pytest.mark.parametrize("method", ["nlp", "nested"])
def test_bounds_hold_beside_effects(method: Any) -> None:
    campaign = measured("standard", 1, (("axis_tilt.y.z", 1e-3),))
    free, bounds = ("joint_offset", "axis_tilt"), {"axis_tilt": 3e-4, "joint_offset": 2e-3}
    found = identify(campaign, MACHINE, free, bounds=bounds, method=method)
    assert "axis_tilt.y.z" in found.on_bound
    assert np.all(np.abs(found.x) <= found.problem.bound * (1 + 1e-7))
    agree(found, identify(campaign, MACHINE, free, bounds=bounds, method="nlp"))


def test_sigmas_are_scaled_where_lack_of_fit_remains() -> None:
    found = fit_of_published()
    expected = np.sqrt(found.scores.chi2 / found.scores.dof)
    assert found.scores.lack_of_fit_p < 0.01
    assert found.sigma_scale == pytest.approx(expected)
    assert found.sigma_scale > 3
    assert any("times as noisy" in warning for warning in found.warnings)
    assert found.coverage_factor > 2.1
    louder = identify(published(), noise=found.sigma_scale * found.problem.noise.typical)
    assert louder.sigma_scale == 1.0
    for name, sigma in found.sigmas.items():  # the tolerances are no wider for it
        assert sigma == pytest.approx(louder.sigmas[name], rel=1e-2)
        assert sigma <= found.problem.machine.tolerance(name) * (1 + 1e-9)
    assert louder.coverage_factor == pytest.approx(1.96, abs=1e-3)


def test_intervals_are_sigmas_times_the_factor() -> None:
    found = identify(measured("standard"), MACHINE)
    assert len(found.values) == 6
    for name, value in found.values.items():
        low, high = found.interval(name)
        assert (low + high) / 2 == pytest.approx(value)
        assert (high - low) / 2 == pytest.approx(found.coverage_factor * found.sigmas[name])


def test_declared_noise_scales_sigmas_and_leaves_values() -> None:
    campaign = measured("sweep")
    exact = Machine(replace(MACHINE.spec, dial=replace(MACHINE.spec.dial, placement=0.0)))
    options = {"free": ["joint_offset"], "priors": False, "method": "nested"}
    step = np.sqrt(1e-5**2 / 12)  # of the dial, which adds to both
    one, two = (
        identify(campaign, exact, noise=np.sqrt((k * 3e-5) ** 2 - step**2), **options)
        for k in (1, 2)
    )
    agree(one, two)
    assert one.sigma_scale == two.sigma_scale == 1.0
    for name in one.names:
        assert two.sigmas[name] == pytest.approx(2 * one.sigmas[name], rel=1e-6)


def test_declared_noise_is_before_rounding_as_simulated() -> None:
    """A sound machine whose readings scatter as declared leaves what noise leaves."""
    left = []
    for seed in range(6):
        campaign = simulated(MACHINE, "sweep", noise=5e-6, seed=300 + seed)
        by_rows = replace(campaign, sigma=np.full(len(campaign), 5e-6))
        rows, told = (by_rows, None) if seed % 2 else (campaign, 5e-6)
        found = identify(rows, MACHINE, noise=told, method="nested")
        assert found.problem.noise.typical == pytest.approx(np.hypot(5e-6, 1e-5 / np.sqrt(12)))
        left.append(found.scores.chi2 / found.scores.dof)
    assert np.mean(left) == pytest.approx(1.0, abs=0.08)  # two deviations of six sweeps


def test_covariance_is_the_scatter_of_repeated_campaigns() -> None:
    """Two hundred campaigns of one machine against the sigmas of one."""
    sheet, machine = protocol("standard"), Machine(EXACT)
    truth = machine.model.readings(PLANTED, sheet)
    problem = problem_of(machine, [sheet.with_readings(truth)], SIX[:3], priors=False)
    held = replace(problem, held=({n: PLANTED[n] for n in SIX[3:]},))
    one = solve(held, method="nested")
    step = pss_step(one)
    draws = NOISE * np.random.default_rng(0).standard_normal((2000, len(truth)))
    scatter = np.cov(step @ draws.T)
    assert np.allclose(scatter, one.covariance, rtol=0.15, atol=0.1 * one.covariance.max())


def pss_step(one: Estimate) -> np.ndarray:
    """How the fitted values follow the readings, differenced through the solver itself."""
    problem, columns = one.problem, []
    for k in range(len(problem.measured)):
        moved = problem.measured + 1e-6 * np.eye(len(problem.measured))[k]
        found = crosscheck_module.reduction_fit(problem.with_leg_readings(moved), one.nuisance)
        columns.append((found.values[:-1] - one.x) / 1e-6)
    return np.array(columns).T


def test_what_is_written_as_zero_is_none_of_the_reductions_business() -> None:
    """A parameter of 0 in a machine file is no error that the reduction could not represent."""
    plain = fit_of_published()
    written = identify(published(), Machine.nominal().with_parameters({"rail_bow.x.z": 0.0}))
    assert plain.check is not None
    assert written.check is not None
    assert written.values == pytest.approx(plain.values)


# -- the papers' ordinary least squares ----------------------------------------------------------


@pytest.mark.parametrize(("number", "family"), [(2, "joint_offset"), (3, "leg_length")])
def test_deviations_are_system_11_to_second_order(family: str, number: int) -> None:
    campaign = published(number)
    system = reduction.system11().select(
        {"joint_offset": "offsets", "leg_length": "lengths"}[family]
    )
    setups = [campaign.setups[k] for k in campaign.setup]
    row = {
        f"{s.direction}_{LEGS[s.leg]}{'+' if posture == 'max' else '-'}": reading
        for s, posture, reading in zip(setups, campaign.posture, campaign.reading, strict=True)
        if posture != "zero"
    }
    linear = reduction.solve(system, system.ordered(row))
    found = identify(campaign, free=[family], priors=False, weighting="deviations")
    # Second order: errors times errors, and errors times what is left, over the legs' length.
    size = float(np.max(np.abs(linear.values)))
    second = size * (size + float(np.max(np.abs(linear.residuals)))) / 0.31025
    assert np.max(np.abs(found.x - linear.values)) < 2 * second
    assert np.max(np.abs(found.x - linear.values)) > 1e-4 * second
    assert found.check is not None
    # Without second order nothing but the anchor's ten-thousandth is left.
    assert np.allclose(found.check.linear_values, linear.values, rtol=0, atol=1e-4 * 1.7e-3)
    assert found.scores.deviation_rms == pytest.approx(linear.rms, rel=0.01)


def test_deviations_average_the_repeats() -> None:
    """Repeats of a posture count as one deviation, as in the papers."""
    once = published()
    rows = np.concatenate([np.arange(len(once)), np.flatnonzero(once.setup == 0)])
    again = np.where(np.arange(len(rows)) < len(once), once.repeat[rows], 2)
    more = replace(once.subset(rows), repeat=again)
    agree(
        identify(more, free=["joint_offset"], priors=False, weighting="deviations"),
        identify(once, free=["joint_offset"], priors=False, weighting="deviations"),
        1e-12,
    )


# -- distrust ------------------------------------------------------------------------------------


def spoil(monkeypatch: pytest.MonkeyPatch, change: Any) -> None:
    """Let the solver report success with something else than it found."""
    honest = Nlp.solve

    def lying(self: Nlp, *arguments: Any, **options: Any) -> NlpResult:
        result = honest(self, *arguments, **options)
        return replace(result, x=change(result.x))

    monkeypatch.setattr(Nlp, "solve", lying)


@pytest.mark.thorough(
    except_for=["zero-joint_offset", "a little off-joint_offset axis_tilt", "far off-joint_offset"]
)
@pytest.mark.parametrize("free", [("joint_offset",), ("joint_offset", "axis_tilt")], ids=" ".join)
@pytest.mark.parametrize("name", ["zero", "a little off", "far off"])
def test_a_wrong_answer_called_success_is_caught(
    name: str, free: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = {"zero": lambda x: 0 * x, "a little off": lambda x: x + 1e-6, "far off": lambda x: -x}
    spoil(monkeypatch, changes[name])
    with pytest.raises(SolverError) as caught:
        identify(measured("standard once"), MACHINE, free, method="nlp")
    assert caught.value.evidence


def test_a_solver_that_says_it_failed_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from orthoglide.fit import nlp

    monkeypatch.setitem(nlp._OPTIONS, "ipopt.max_iter", 1)
    with pytest.raises(SolverError, match="did not converge") as caught:
        identify(measured("standard once"), MACHINE, method="nlp")
    assert caught.value.evidence["status"] == "Maximum_Iterations_Exceeded"


def test_a_reduction_that_disagrees_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = crosscheck_module.reduction_fit

    def other(*arguments: Any, **options: Any) -> reduction.ReadingFit:
        fit = honest(*arguments, **options)
        return replace(fit, values=fit.values + 2e-9)

    monkeypatch.setattr(crosscheck_module, "reduction_fit", other)
    with pytest.raises(CrossCheckError, match="disagree") as caught:
        identify(measured("standard once"), MACHINE, method="nlp")
    assert caught.value.difference == pytest.approx(2e-9, rel=0.1)


def test_optimality_is_the_gradient_that_is_left() -> None:
    """At the fit a step along any unknown costs; a little off it, optimality would say so."""
    found = identify(measured("standard once"), MACHINE, method="nlp")
    assert found.optimality < 1e-6
    here = normal_equations(found.problem, found.at, found.nuisance)
    scale = 1 / np.sqrt(np.diag(here.information))
    for k, name in enumerate(found.names):
        for side in (-1, 1):
            x = found.x.copy()
            x[k] += side * scale[k]
            cost = normal_equations(found.problem, linearise(found.problem, x), found.nuisance).cost
            assert cost == pytest.approx(here.cost + 1, abs=0.05), name


# -- scores --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("free", "priors"), [(("joint_offset",), False), (SIX, True)], ids=["offsets", "six"]
)
def test_cv_is_leaving_every_station_out(free: tuple[str, ...], priors: bool) -> None:
    """Against solving the linear problem anew without each station."""
    found = identify(measured("standard"), MACHINE, free, priors=priors)
    problem, nuisance, at = found.problem, found.nuisance, found.at
    prior = np.diag(np.concatenate([1 / problem.prior_sd, np.sqrt(nuisance.precision)]))
    columns = np.hstack([at.jacobian, nuisance.columns]) * nuisance.weighing.weight[:, None]
    target = (problem.measured - at.value + at.jacobian @ at.x) * nuisance.weighing.weight
    station, errors = problem.place_number, []
    for k in range(station.max() + 1):
        out = station == k
        matrix = np.vstack([columns[~out], prior])
        right = np.concatenate([target[~out], np.zeros(len(prior))])
        solution = np.linalg.lstsq(matrix, right, rcond=1e-13)[0]
        errors.extend((target[out] - columns[out] @ solution) / nuisance.weighing.weight[out])
    assert found.scores.cv_rms == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-6)
    assert found.scores.cv_rms > found.scores.rms


def test_scores_by_hand() -> None:
    found = identify(published(), free=["joint_offset"], priors=False)
    residual, scores = found.residuals, found.scores
    assert scores.rms == pytest.approx(np.sqrt(np.mean(residual**2)))
    assert scores.max == pytest.approx(np.abs(residual).max())
    assert scores.dof == 18 - 6 - 3
    by_setup = residual.reshape(6, 3)  # zero, max, min of every setup
    deviations = by_setup[:, 1:] - by_setup[:, :1]
    assert scores.deviation_rms == pytest.approx(np.sqrt(np.mean(deviations**2)))
    # With tolerances as priors the twelve deviations determine offset minus length of each leg.
    assert fit_of_published().scores.dof == pytest.approx(18 - 6 - 3, abs=0.01)
    assert found.nominal.rms > scores.rms
    assert np.allclose(found.predicted + residual, found.problem.measured)


def test_a_lone_reading_has_no_cross_validation() -> None:
    """With two postures in every setup, leaving one out leaves the other to its datum."""
    found = identify(measured("standard ends"), MACHINE, ["joint_offset"])
    assert np.isfinite(found.scores.cv_rms)
    sheet = measured("standard once")
    first = sheet.subset(np.unique(sheet.setup, return_index=True)[1])
    problem = problem_of(MACHINE, [first], MACHINE.catalogue.base)
    assert np.isnan(solve(problem).scores.cv_rms)


# -- what a user gets ----------------------------------------------------------------------------


def test_estimate_in_numbers_and_words() -> None:
    found = identify(measured("standard"), MACHINE)
    assert np.allclose(np.diag(found.correlation), 1)
    assert np.all(np.abs(found.correlation) <= 1 + 1e-12)
    shown = found.to_frame().loc["joint_offset.x"]
    assert shown["value"] == pytest.approx(found.values["joint_offset.x"] * 1e3)
    assert shown["unit"] == "mm"
    text = str(found)
    assert all(name in text for name in found.names)
    assert "chi2" in text
    before = found.problem.measured - found.predicted_before
    assert np.sqrt(np.mean(before**2)) > 3 * found.scores.rms
    spec = found.machine.spec
    assert spec.parameters["joint_offset.x"].sigma == pytest.approx(found.sigmas["joint_offset.x"])


def test_structured_members_calibrate_what_they_stand_for() -> None:
    campaign = measured("standard", 8, (("axis_tilt.x.y", 1e-3),))
    found = identify(campaign, MACHINE, ["joint_offset", "axis_tilt.xy.antisymmetric"])
    value = found.values["axis_tilt.xy.antisymmetric"]
    assert found.machine.values["axis_tilt.x.y"] == value
    assert found.machine.values["axis_tilt.y.x"] == -value


def test_far_from_tolerance_is_said() -> None:
    far = (("joint_offset.x", 2e-2),)
    found = identify(measured("standard once", 9, far), MACHINE, ["joint_offset"], priors=False)
    assert found.values["joint_offset.x"] == pytest.approx(2e-2, abs=5e-4)
    assert any("times its tolerance" in warning for warning in found.warnings)


@pytest.mark.thorough
def test_two_bars_and_odd_places() -> None:
    """Dials on single bars, at random commands: nothing of the papers' protocol is built in."""
    machine = Machine(EXACT)
    setups = tuple(
        Setup(f"{LEGS[leg]}{LEGS[axis]}{bar}", leg, axis, 1, 0.1 + 0.03 * leg, bar)
        for leg in range(3)
        for axis in range(3)
        for bar in (1, 2)
        if axis != leg
    )
    n = 10 * len(setups)
    rng = np.random.default_rng(11)
    blank = np.full(n, np.nan)
    sheet = Campaign(
        "odd", setups, np.arange(n) % len(setups),
        command=0.31025 + rng.uniform(-0.1, 0.06, (n, 3)), reading=blank, approach=np.ones((n, 3)),
    )  # fmt: skip
    planted = PLANTED | {"bar_mismatch.y": 1e-4}
    campaign = predicted(machine, planted, sheet)
    found = identify(campaign, machine, [*SIX, "bar_mismatch"], priors=False)
    for name, value in found.values.items():
        assert value == pytest.approx(planted.get(name, 0.0), abs=1e-11)
