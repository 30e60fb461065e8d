"""Identification: mechanism against reduction, programme against nested closure, planted machines.

Readings come from the independent machine of ``rig.py`` where they are noisy, and from the
reduction where they must be exact.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import pytest

from orthoglide import reduction
from orthoglide.errors import CrossCheckError, InputError, SolverError, UnidentifiableError
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate, crosscheck as crosscheck_module, nlp, solve
from orthoglide.fit.crosscheck import by_reduction
from orthoglide.fit.gauss_newton import solve_nested
from orthoglide.fit.least_squares import Linearised, linearise, normal_equations
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.machine_file import Dial, MachineFile
from orthoglide.observations import Campaign, read_campaign
from orthoglide.simulation import simulate as simulated
from tests.factors import campaign_of, problem_of
from tests.relabelling import legs_renamed, relabelled
from tests.rig import Rig
from tests.rig_campaigns import protocol_rows, simulate

NANOMETRE = 1e-9
NOISE = 2e-5
SIX = tuple(f"{family}.{leg}" for family in ("joint_offset", "leg_length") for leg in LEGS)
PLANTED = {
    "joint_offset.x": -5e-4, "joint_offset.y": 6e-4, "joint_offset.z": -1.7e-3,
    "leg_length.x": 5e-5, "leg_length.y": -8e-5, "leg_length.z": 3e-5,
}  # fmt: skip
MACHINE = Machine(MachineFile(dial=Dial(repeatability=NOISE)))


@pytest.fixture(scope="module", autouse=True)
def _engine_built_once_for_all_tests() -> None:
    MACHINE.model.engine  # noqa: B018


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
    return campaign_of(simulate(rig, rows, np.random.default_rng(seed), noise=NOISE), name=name)


@cache
def published(number: int = 2) -> Campaign:
    return read_campaign(str(files("orthoglide") / "data" / f"experiment{number}.csv"))


@cache
def fit_of_published(priors: bool = True) -> Estimate:
    return identify(published(), priors=priors)


def agree(one: Estimate, other: Estimate, within: float = NANOMETRE) -> None:
    assert one.names == other.names
    assert float(np.max(np.abs(one.x - other.x))) < within


# -- the mechanism's programme against the reduction ------------------------------------------

FREE_SETS = [
    (("joint_offset",), True),
    (("joint_offset.y", "joint_offset.z", "leg_length.x", "leg_length.z"), False),
    (("joint_offset", "leg_length.common"), False),
]


@pytest.mark.parametrize(("free", "priors"), FREE_SETS)
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


@pytest.mark.parametrize("number", [2, 3])
def test_weak_directions_converge_from_anywhere(number: int) -> None:
    """On the published readings, whose residual is large, without priors."""
    found = identify(published(number), priors=False, method="nested")
    reduced = by_reduction(found.problem)
    for start in (np.zeros(6), np.repeat([3e-3, 0.0], 3), np.full(6, -2e-3)):
        solution, _ = solve_nested(reduced, found.nuisance, linearise(reduced, start))
        np.testing.assert_allclose(solution.x, found.x, rtol=0, atol=1e-12)


def test_a_long_first_step_does_not_end_in_a_far_minimum() -> None:
    """Readings so good that a whole Newton step along a weak direction leaves the machine."""
    rng = np.random.default_rng(13 % 5)
    sizes = np.repeat([2e-3, 5e-5], 3)
    errors = dict(zip(SIX, (sizes * rng.standard_normal(6)).tolist(), strict=True))
    rng = np.random.default_rng([0, ord("a"), 2, 13])
    campaign = campaign_of(simulate(Rig(errors=errors), "standard", rng, noise=2e-6))
    fine = Machine(MachineFile(dial=Dial(repeatability=2e-6)))
    for method in ("reduction", "nlp", "nested"):
        found = identify(campaign, fine, priors=False, method=method)  # type: ignore[arg-type]
        assert found.on_bound == ()
        assert found.scores.rms < 1e-5


# -- two ways of closing the loops ---------------------------------------------------------------


@pytest.mark.parametrize("limit", ["NLP_POSTURES", "NLP_UNKNOWNS"])
def test_many_postures_or_unknowns_are_nested(limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from orthoglide.fit import solving

    assert identify(measured("standard once"), MACHINE).method == "nlp"
    monkeypatch.setattr(solving, limit, 3)
    assert identify(measured("standard once"), MACHINE).method == "nested"


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


@pytest.mark.parametrize(
    ("method", "key"),
    [("nlp", "joint_offset.z"), ("nested", "joint_offset"), ("reduction", "joint_offset.z")],
)
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
    # Without second order nothing but the anchor's ten-thousandth is left.
    generalised = by_reduction(found.problem, linear=True)
    solution, _ = solve_nested(generalised, found.nuisance, linearise(generalised, found.x))
    assert np.allclose(solution.x, linear.values, rtol=0, atol=1e-4 * 1.7e-3)
    assert found.scores.deviation_rms == pytest.approx(linear.rms, rel=0.01)


# -- distrust ------------------------------------------------------------------------------------


def spoil(monkeypatch: pytest.MonkeyPatch, change: Any) -> None:
    """Let the solver report success with something else than it found."""
    honest = nlp.solve_programme

    def lying(*arguments: Any) -> tuple[np.ndarray, int]:
        x, iterations = honest(*arguments)
        return change(x), iterations

    monkeypatch.setattr(nlp, "solve_programme", lying)


@pytest.mark.parametrize(
    "change",
    [lambda x: 0 * x, lambda x: x + 1e-6, lambda x: -x],
    ids=["zero", "a little off", "far off"],
)
def test_a_wrong_answer_called_success_is_caught(
    change: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil(monkeypatch, change)
    with pytest.raises(SolverError) as caught:
        identify(measured("standard once"), MACHINE, ["joint_offset", "axis_tilt"], method="nlp")
    assert caught.value.evidence


def test_a_solver_that_says_it_failed_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(nlp._OPTIONS, "ipopt.max_iter", 1)
    with pytest.raises(SolverError, match="did not converge") as caught:
        identify(measured("standard once"), MACHINE, method="nlp")
    assert caught.value.evidence["status"] == "Maximum_Iterations_Exceeded"


def test_a_reduction_that_disagrees_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = crosscheck_module.solve_nested

    def other(*arguments: Any) -> tuple[Linearised, int]:
        linear, steps = honest(*arguments)
        return replace(linear, x=linear.x + 2e-9), steps

    monkeypatch.setattr(crosscheck_module, "solve_nested", other)
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
