"""Noise that repeats share: against the covariance written out, and down to a silent dial."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import SolverError
from orthoglide.fit.noise import Weighing
from orthoglide.fit.notes import tolerance_notes
from orthoglide.fit.repeats import repeat_variance, total_variance
from orthoglide.machine_file import Dial
from orthoglide.simulation import simulate

RNG = np.random.default_rng(3)
STATION = np.array([0, 1, 0, 2, 1, 0, 3])
SIGMA = np.array([1.0, 2.0, 1.5, 1.0, 1.0, 3.0, 0.5]) * 1e-6
COMMON = 2e-6


def weighing(common: float = COMMON) -> Weighing:
    return Weighing(SIGMA, np.full(len(SIGMA), common), STATION)


def covariance(common: float = COMMON) -> np.ndarray:
    return np.diag(SIGMA**2) + common**2 * np.equal.outer(STATION, STATION)


def with_dial(resolution: float, **parameters: float) -> og.Machine:
    """A machine whose dial says nothing of its own noise."""
    nominal = og.Machine.nominal()
    dial, wide = Dial(resolution=resolution, placement=1e-3), {"backlash": 7e-5}
    spec = replace(nominal.spec, dial=dial, tolerance={**nominal.spec.tolerance, **wide})
    return og.Machine(spec).with_parameters(parameters)


def test_whitened_rows_have_the_inverse_covariance() -> None:
    rows = RNG.standard_normal((7, 4)) * 1e-6
    white = weighing().whiten(rows)
    assert white.T @ white == pytest.approx(rows.T @ np.linalg.solve(covariance(), rows))
    assert weighing().metres(white) == pytest.approx(rows, rel=1e-12)
    assert weighing(0.0).whiten(rows[:, 0]) == pytest.approx(rows[:, 0] / SIGMA)


def test_means_and_scatter_share_out_the_square() -> None:
    rows, found = RNG.standard_normal(7) * 1e-6, weighing()
    white, weight = found.whiten(rows), SIGMA**-2
    means = np.bincount(STATION, rows * weight) / np.bincount(STATION, weight)
    between = np.sum(means**2 / (1 / np.bincount(STATION, weight) + COMMON**2))
    within = np.sum(((rows - means[STATION]) / SIGMA) ** 2)
    assert white @ white == pytest.approx(between + within)
    assert np.sum(found.station_components(white) ** 2) == pytest.approx(between)
    assert found.first_rows.tolist() == [0, 1, 3, 6]


@pytest.mark.parametrize("scatter", [0.03, 0.1, 0.25, 0.5, 1.0, 3.0])
def test_the_noise_of_a_reading_from_what_repeats_show(scatter: float) -> None:
    """Many rounded readings at many places: variance within a place against that of all."""
    rng = np.random.default_rng(1)
    true = rng.uniform(0, 1, (4000, 1))
    shown = np.round(true + scatter * rng.standard_normal((4000, 30)))
    within = float(np.mean(np.var(shown, axis=1, ddof=1)))
    whole = float(np.mean((shown - true) ** 2))
    assert total_variance(within, 1.0) == pytest.approx(whole, rel=0.02)
    assert total_variance(within, 0.0) == within


def test_repeats_tell_the_part_that_averaging_reduces() -> None:
    """At a fifth of a step neither all of the rounding is shared nor none."""
    campaign = simulate(with_dial(1e-5), "sweep", noise=2e-6, seed=1)
    problem = og.identify(campaign, with_dial(1e-5)).problem
    noise = problem.noise
    assert noise.source == "repeats"
    assert problem.sigma[0] ** 2 == pytest.approx(repeat_variance([campaign])[0], rel=0.02)
    assert noise.typical == pytest.approx(np.sqrt(2e-6**2 + 1e-10 / 12), rel=0.15)


@pytest.mark.parametrize("noise", [1e-7, 2e-5])
def test_scores_are_of_the_readings_however_quiet_the_dial(noise: float) -> None:
    """Offsets alone: before, the machine is off by 0.2 mm rms; what is left is the dial."""
    machine = with_dial(1e-5)
    truth = with_dial(1e-5, **{"joint_offset.x": 5e-4, "joint_offset.y": -1.2e-3})
    found = og.identify(simulate(truth, "standard", noise=noise, seed=1), machine)
    total = np.sqrt(noise**2 + 1e-10 / 12)
    assert found.nominal.rms > 5e-5
    assert found.scores.rms == pytest.approx(total, rel=0.35)
    assert found.sigma_scale == 1.0
    assert found.scores.lack_of_fit_p > 0.01
    errors = {n: found.values.get(n, 0.0) - truth.values[n] for n in truth.values}
    seen = {n: e / found.sigmas[n] for n, e in errors.items()}
    assert max(map(abs, seen.values())) < 4


def test_a_value_far_beyond_its_tolerance_is_not_pulled_back() -> None:
    machine = og.Machine.nominal()
    truth = machine.with_parameters({"joint_offset.x": 20e-3})
    found = og.identify(simulate(truth, "sweep", noise=5e-6, seed=1), machine)
    assert found.scores.prior_chi2 < 10
    assert found.sigma_scale == 1.0
    assert found.values["joint_offset.x"] == pytest.approx(20e-3, rel=2e-3)
    # Only what is certain is said to be far beyond its tolerance.
    (note,) = tolerance_notes(found)
    assert note.startswith("joint offset of leg x is +20 mm, 10.0 times")
    limit = 3 * machine.tolerance("joint_offset.x")
    for sigma, notes in ((0.49 * (20e-3 - limit), 1), (0.51 * (20e-3 - limit), 0)):
        uncertain = replace(found, covariance=np.eye(len(found.names)) * sigma**2)
        assert len([*tolerance_notes(uncertain)]) == notes


def test_what_the_model_lacks_does_not_widen_tolerances() -> None:
    """Ends that deviate alike bend lengths by metres where nothing holds them."""
    found = og.identify(_bowed(), og.Machine.nominal())
    assert found.sigma_scale > 1
    assert {u.prior_width for u in found.problem.unknowns} == {1.0}


def _bowed() -> og.Campaign:
    campaign = simulate(og.Machine.nominal(), "sweep", noise=5e-6, seed=0)
    along = campaign.command[np.arange(len(campaign)), campaign.leg] - 0.31025
    return campaign.with_readings(campaign.reading + 5e-5 * ((along + 0.02) / 0.08) ** 2)


def test_zeros_so_far_off_that_the_stroke_is_out_of_reach_are_told() -> None:
    """Carriages 19, 14 and 11 mm too far out do not meet where all are driven to their ends."""
    machine = og.Machine.nominal()
    off = {"joint_offset.x": 0.0191, "joint_offset.y": 0.0136, "joint_offset.z": 0.0105}
    off |= {"leg_length.y": 4e-4, "leg_length.z": 2.7e-4}
    campaign = simulate(machine.with_parameters(off), "standard", noise=5e-6, seed=26)
    told = r"reach all of its stroke: .* is \+19 mm, 9.. times its tolerance of 2 mm"
    with pytest.raises(SolverError, match=told):
        og.close_loop(campaign, machine)
