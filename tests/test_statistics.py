"""Every test, interval and p-value against made-up draws with a known answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import orthoglide as og
from orthoglide.accuracy import TcpMap, without_translation
from orthoglide.explanation.candidates import BACKGROUND, signatures
from orthoglide.fit import Estimate, with_effects_freed
from orthoglide.fit.least_squares import linearise, normal_equations
from orthoglide.fit.repeats import repeat_variance
from orthoglide.fit.scores import chi2_p_value, deviation_rms
from orthoglide.fit.unknowns import build_unknowns
from orthoglide.machine_file import Dial
from orthoglide.observations import protocol
from orthoglide.planning import smallest_effects
from orthoglide.simulation import simulate

NOISE = 5e-6


def machine(**dial: float | None) -> og.Machine:
    spec = og.Machine.nominal().spec
    return og.Machine(replace(spec, dial=Dial(**{"resolution": 0.0, **dial})))


def fitted(kind="standard", seed: int = 0, noise: float | None = NOISE, **dial) -> Estimate:
    made = machine(**dial)
    return og.identify(simulate(made, kind, noise=NOISE, seed=seed), made, noise=noise)


def covariance(found: Estimate) -> np.ndarray:
    """Of the readings, rounding, datums and placements counted, written out."""
    problem, nuisance = found.problem, found.nuisance
    same = np.equal.outer(problem.station, problem.station)
    known = nuisance.precision > 0
    columns = nuisance.columns[:, known]
    wide = np.where(known, 0.0, 0.1)
    loose = nuisance.columns * wide
    return (
        np.diag(problem.sigma**2)
        + problem.shared_rounding_sd**2 * same
        + (columns / nuisance.precision[known]) @ columns.T
        + loose @ loose.T
    )


# -- noise ----------------------------------------------------------------------------------------


def test_visits_under_another_load_are_no_repeats() -> None:
    sheet = protocol("standard")
    rng = np.random.default_rng(0)
    reading = NOISE * rng.standard_normal(len(sheet))
    loaded = np.where(sheet.repeat == 2, 10.0, 0.0)
    sags = replace(sheet, reading=reading + 1e-4 * (loaded > 0), load=loaded)
    variance, dof = repeat_variance([sags])
    assert variance < 4 * NOISE**2
    assert 0 < dof < repeat_variance([replace(sags, load=0 * loaded)])[1]


def test_degrees_of_freedom_of_successive_differences() -> None:
    """The variance's own scatter over many campaigns is that of a chi-squared on as many."""
    sheet = protocol("sweep")
    rng = np.random.default_rng(1)
    found = [
        repeat_variance([sheet.with_readings(rng.standard_normal(len(sheet)))]) for _ in range(1000)
    ]
    values, dof = np.array([v for v, _ in found]), found[0][1]
    assert values.mean() == pytest.approx(1, rel=0.03)
    # Rather too few than too many: longer runs share more.
    assert 0.75 < dof / (2 / values.var()) < 1.1


def test_signatures_are_weighted_by_the_covariance_of_a_sound_machine() -> None:
    """Noise, datums, placements, the base by its priors and the background, written out."""
    found = fitted(noise=None, resolution=1e-5, repeatability=NOISE)
    model, count = signatures(found), len(found.names)
    problem = with_effects_freed(found.problem, {n.effect for n in model.names})
    jacobian = linearise(problem, problem.zero_padded(found.x)).jacobian
    effects = jacobian[:, [problem.names.index(name) for name in model.names]]
    base = jacobian[:, :count] * problem.tolerance[:count]
    background = effects * BACKGROUND * model.tolerance
    full = covariance(found) + base @ base.T + background @ background.T
    weighted = model.weighted_by_background.columns * model.tolerance
    expected = effects.T @ np.linalg.solve(full, effects) * model.tolerance
    expected *= model.tolerance[:, None]
    assert weighted.T @ weighted == pytest.approx(expected, rel=1e-3, abs=1e-3 * expected.max())


@pytest.mark.parametrize("level", [0.05, 0.2])
def test_what_is_to_be_detected_stands_above_noise_as_often_as_stated(level: float) -> None:
    """The best evidence of the catalogue on other draws of noise than the threshold's own."""
    made, sheet = machine(repeatability=NOISE), protocol("standard")
    told = smallest_effects(made, sheet, level=level)
    seen = signatures(fitted(repeatability=NOISE))
    drawn = np.random.default_rng(7).standard_normal((len(seen.columns), 2000))
    best = seen.weighted_by_background.evidences(drawn).max(axis=0)
    assert np.mean(best > told.threshold) == pytest.approx(level, abs=0.018)


# -- lack of fit ----------------------------------------------------------------------------------


def test_the_tail_of_squares_that_priors_hold_back() -> None:
    shares = np.array([1.0, 1.0, 0.9, 0.4, 0.1, 0.0])
    rng = np.random.default_rng(2)
    for count in (5, 8, 20):
        weights = np.concatenate([1 - shares, np.ones(max(count - len(shares), 0))])
        if count < len(shares):
            continue
        drawn = np.sum(weights * rng.standard_normal((200_000, len(weights))) ** 2, axis=1)
        for p in (0.5, 0.1, 0.01):
            assert chi2_p_value(float(np.quantile(drawn, 1 - p)), count, shares) == pytest.approx(
                p, rel=0.1
            )
        noise = rng.chisquare(10, len(drawn)) / 10
        limit = float(np.quantile(drawn / noise, 0.95))
        assert chi2_p_value(limit, count, shares, 10.0) == pytest.approx(0.05, rel=0.15)
    assert np.isnan(chi2_p_value(1.0, 3, np.ones(3)))


@pytest.mark.parametrize(("size", "seed"), [(0.0, 0), (2e-5, 2)])
def test_lack_of_fit_is_the_smaller_of_two_tests(seed: int, size: float) -> None:
    """Of all readings and of the station means, each from a covariance written out."""
    made = machine()
    bent = made.with_parameters({"rail_bow.x.z": size})
    found = og.identify(simulate(bent, "standard", noise=NOISE, seed=seed), made, noise=NOISE)
    problem = found.problem
    rest = problem.measured - found.at.value
    inverse = np.linalg.inv(covariance(found))
    chi2 = float(rest @ inverse @ rest)
    station = problem.station
    means = (np.bincount(station, rest) / np.bincount(station))[station]
    within = float(np.sum((rest - means) ** 2)) / NOISE**2
    assert found.scores.chi2 == pytest.approx(chi2, rel=1e-3)
    inside = len(rest) - len(np.unique(station))
    p = [
        stats.chi2.sf(chi2, found.scores.dof),
        stats.chi2.sf(chi2 - within, found.scores.dof - inside),
    ]
    assert found.scores.lack_of_fit_p == pytest.approx(1 - (1 - min(p)) ** 2, rel=0.1)


def test_noise_from_repeats_is_held_against_fisher() -> None:
    """Stations that are off by twice the noise, each by its own."""
    plain = fitted(noise=None).problem
    off = 2 * NOISE * np.random.default_rng(1).standard_normal(int(plain.station.max()) + 1)
    spoilt = plain.campaigns[0].with_readings(plain.measured + off[plain.station])
    found = og.identify(spoilt, machine())
    problem, scores = found.problem, found.scores
    assert problem.noise.source == "repeats"
    rest = problem.measured - found.at.value
    inside = len(rest) - len(np.unique(problem.station))
    mean = np.bincount(problem.station, rest) / np.bincount(problem.station)
    between = scores.chi2 - np.sum(((rest - mean[problem.station]) / problem.sigma) ** 2)
    dof = scores.dof - inside
    expected = stats.f.sf(between / dof, dof, problem.noise.dof)
    assert scores.lack_of_fit_p == pytest.approx(expected, rel=0.05)
    assert stats.chi2.sf(between, dof) < 0.7 * expected


def test_the_density_of_readings_over_their_datums() -> None:
    """Against wide normal datums, and with one setup three times as noisy."""
    found, densities, expected = fitted(), list[float](), list[float]()
    problem, nuisance = found.problem, found.nuisance
    for scale in (1.0, 3.0):
        sigma = np.where(problem.setup_of_row == 2, scale, 1.0) * problem.sigma
        noisier = replace(nuisance, weighing=replace(problem.weighing, sigma=sigma))
        densities.append(noisier.log_density(problem.weighted))
        precision = np.where(nuisance.precision > 0, nuisance.precision, 1.0)
        wide = (nuisance.columns / precision) @ nuisance.columns.T
        inverse = noisier.weighing.whiten(np.eye(len(sigma)))
        full = np.linalg.inv(inverse.T @ inverse) + wide
        expected.append(-float(np.linalg.slogdet(full)[1]) / 2)
    assert np.diff(densities) == pytest.approx(np.diff(expected), rel=1e-4)


def test_priors_are_no_question_to_the_readings() -> None:
    found = fitted()
    here = normal_equations(found.problem, found.at, found.nuisance)
    assert found.scores.chi2 == pytest.approx(here.chi2)
    assert found.scores.prior_chi2 == pytest.approx(
        float(np.sum((found.x / found.problem.prior_sd) ** 2))
    )
    assert found.scores.cost == pytest.approx(here.cost)
    assert np.sum(here.hat_eigenvalues) == pytest.approx(np.trace(
        np.linalg.solve(here.information, here.jacobian.T @ here.jacobian)), rel=1e-6)  # fmt: skip


# -- scores and bounds ----------------------------------------------------------------------------


def test_deviations_are_from_the_first_posture_in_order() -> None:
    """The rows of the file may stand in any sequence."""
    made = machine()
    whole = simulate(made, "standard", noise=NOISE, seed=0)
    turned = replace(whole, order=whole.order[::-1].copy(), time=whole.time[::-1].copy())
    problem = og.identify(turned, made).problem
    residual = np.random.default_rng(0).standard_normal(len(whole))
    apart = []
    for setup in range(len(whole.setups)):
        rows = np.flatnonzero(whole.setup == setup)
        mean = {
            k: residual[rows[problem.place_number[rows] == k]].mean()
            for k in set(problem.place_number[rows])
        }
        first = problem.place_number[rows[np.argmin(turned.order[rows])]]
        apart += [v - mean[first] for k, v in mean.items() if k != first]
    assert deviation_rms(problem, residual) == pytest.approx(np.sqrt(np.mean(np.square(apart))))


def test_unknowns_stay_within_fifty_tolerances() -> None:
    made = machine()
    problem = og.identify(simulate(made, "standard", noise=NOISE, seed=0), made).problem
    for unknown in build_unknowns(made, problem.factors, ["joint_offset", "leg_length"]):
        assert unknown.bound == pytest.approx(max(50 * unknown.tolerance, 0.05))


# -- accuracy -------------------------------------------------------------------------------------


def test_a_field_is_taken_after_its_best_translation() -> None:
    field = np.random.default_rng(0).standard_normal((50, 3))
    moved = without_translation(field + np.array([1.0, -2.0, 3.0]))
    assert moved == pytest.approx(without_translation(field))
    assert np.sum(moved**2) <= np.sum((field - field[0]) ** 2)
    assert moved.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def test_the_stated_radius_holds_ninety_five_in_a_hundred() -> None:
    """In a plane's worth of directions and in one: at least that, as coordinates are pooled."""
    rng = np.random.default_rng(0)
    for sigma in ([1.0, 0.0, 0.0], [1.0, 1.0, 1.0]):
        stated = TcpMap(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), np.array([sigma]))
        drawn = np.linalg.norm(rng.standard_normal((100_000, 3)) * sigma, axis=1)
        inside = np.mean(drawn <= stated.uncertainty[0])
        assert inside == pytest.approx(0.95, abs=0.003) if sigma[1] == 0 else inside > 0.95


def test_intervals_of_scaled_sigmas_are_students() -> None:
    found = fitted()
    normal_factor = replace(found, sigma_scale=1.0).coverage_factor
    scaled = replace(found, sigma_scale=1.5).coverage_factor
    assert normal_factor == pytest.approx(stats.norm.ppf(0.975))
    assert scaled == pytest.approx(stats.t.ppf(0.975, found.scores.dof))
