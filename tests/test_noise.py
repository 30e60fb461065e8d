"""The noise of one reading, from every source there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import InputError
from orthoglide.fit import noise_of
from orthoglide.fit.noise import (
    PUBLISHED_REPEATABILITY,
    common_rounding,
    repeat_variance,
)
from orthoglide.machine_file import Dial
from orthoglide.observations import Campaign, protocol

SPREAD = 3e-5
EXACT = Dial(resolution=0.0)


def campaign(sigma: float = float("nan"), drift: float = 0.0, seed: int = 0) -> Campaign:
    """The sweep's three rounds: readings that scatter about a slow drift."""
    sheet = protocol("sweep")
    rng = np.random.default_rng(seed)
    readings = SPREAD * rng.standard_normal(len(sheet)) + drift * np.arange(len(sheet))
    return replace(sheet, reading=readings, sigma=np.full(len(sheet), sigma))


def unrepeated() -> Campaign:
    whole = campaign()
    return whole.subset(whole.repeat == 1)


def test_declared_for_the_run_replaces_everything() -> None:
    noise = noise_of([campaign(sigma=7e-5)], Dial(repeatability=1e-6), 4e-5)
    assert noise.source == "declared"
    assert noise.typical == 4e-5
    assert np.all(noise.sigma[0] == 4e-5)


@pytest.mark.parametrize("bad", [0.0, -1e-5, float("nan"), float("inf"), 5e-3])
def test_declared_noise_is_some_instruments(bad: float) -> None:
    with pytest.raises(InputError, match=r"deviation in metres, from 1e-09 to 0\.001, not"):
        noise_of([campaign()], EXACT, bad)


def test_declared_by_row() -> None:
    sigma = np.linspace(1e-5, 5e-5, len(campaign()))
    noise = noise_of([replace(campaign(), sigma=sigma)], Dial(resolution=0.0, repeatability=1e-6))
    assert noise.source == "declared"
    assert np.array_equal(noise.sigma[0], sigma)
    assert noise.typical == pytest.approx(np.sqrt(np.mean(sigma**2)))


def caution(estimate: og.Estimate) -> str:
    """What is said of readings that scatter less than was declared."""
    return " ".join(w for w in estimate.warnings if w.kind == "quiet")


def test_noise_declared_far_too_large_is_said() -> None:
    """Faults that it hides would else pass for a sound machine."""
    worn = og.Machine.nominal().with_parameters({"joint_offset.x": 6e-4, "axis_tilt.y.z": 2.5e-3})
    read = og.simulate(worn, "sweep", noise=5e-6, seed=1)
    verdict = og.close_loop(read, noise=1e-3)
    assert verdict.word == "adequate"
    said = caution(verdict.after)
    assert said.startswith("the readings scatter")
    assert "times less than the noise that was declared (1 mm; chi2 " in said
    assert said in verdict.warnings
    by_row = replace(read, sigma=np.full(len(read), 1e-3))
    assert caution(og.identify(by_row)) == caution(og.identify(read, noise=1e-3)) != ""


@pytest.mark.parametrize("count", [8, 60])
def test_noise_declared_too_large_for_points_of_the_tool(count: int) -> None:
    points = og.simulate_tcp(og.Machine.nominal(), count, seed=1)
    spread = np.random.default_rng(2).normal(scale=1e-5, size=points.p.shape)
    points = replace(points, p=points.p + spread)
    assert caution(og.identify(points, noise=5e-4))
    assert caution(og.identify(replace(points, sigma=np.full(count, 5e-4))))
    assert not caution(og.identify(points, noise=1e-5))
    assert not caution(og.identify(points))


@pytest.mark.parametrize("seed", range(5))
def test_noise_declared_about_right_is_not_doubted(seed: int) -> None:
    read = og.simulate(og.Machine.nominal(), "standard", noise=5e-6, seed=seed)
    for noise in (4e-6, 5e-6, 1e-5, None):
        assert not caution(og.identify(read, noise=noise))


def test_rows_without_a_sigma_take_the_machines() -> None:
    half = replace(campaign(), sigma=np.where(np.arange(len(campaign())) % 2, 9e-5, np.nan))
    noise = noise_of([half], Dial(resolution=0.0, repeatability=1e-6))
    assert noise.source == "machine"
    assert set(np.unique(noise.sigma[0])) == {1e-6, 9e-5}


def test_machine_adds_what_the_dial_rounds_away() -> None:
    noise = noise_of([unrepeated()], Dial(resolution=3e-5, repeatability=1e-5))
    assert noise.source == "machine"
    assert noise.typical == pytest.approx(np.sqrt(1e-10 + 9e-10 / 12))


def test_repeats_tell_the_noise() -> None:
    noise = noise_of([campaign()], EXACT)
    assert noise.source == "repeats"
    # 252 readings at 84 stations; both sides of the sweep's way count as one where they agree.
    assert noise.typical == pytest.approx(SPREAD, rel=0.15)


def test_a_slow_drift_is_no_noise() -> None:
    still, drifting = noise_of([campaign()], EXACT), noise_of([campaign(drift=5e-7)], EXACT)
    assert drifting.typical == pytest.approx(still.typical, rel=0.1)
    assert np.std(campaign(drift=5e-7).reading) > 1.02 * np.std(campaign().reading)


def test_repeats_never_say_less_than_the_rounding() -> None:
    silent = campaign().with_readings(np.zeros(len(campaign())))
    noise = noise_of([silent], Dial(resolution=1e-5))
    assert noise.source == "repeats"
    assert noise.typical == pytest.approx(1e-5 / np.sqrt(12))


def test_without_repeats_the_published_figure() -> None:
    noise = noise_of([unrepeated()], Dial(resolution=1e-5))
    assert noise.source == "machine"
    assert noise.typical == pytest.approx(np.sqrt(PUBLISHED_REPEATABILITY**2 + 1e-10 / 12))


def test_too_few_repeats_do_not_count() -> None:
    whole = campaign()
    few = whole.subset((whole.repeat == 1) | ((whole.repeat == 2) & (whole.order < 34)))
    variance, dof = repeat_variance([few])
    assert np.isfinite(variance)
    assert 0 < dof < 6
    assert noise_of([few], EXACT).source == "machine"


def test_repeat_variance_of_nothing_repeated() -> None:
    variance, dof = repeat_variance([unrepeated()])
    assert np.isnan(variance)
    assert dof == 0


def test_repeats_are_told_apart_by_approach() -> None:
    """Backlash between the two sides of a posture is no scatter."""
    whole = campaign()
    lag = whole.approach[np.arange(len(whole)), whole.leg] * 1e-3
    assert repeat_variance([whole.with_readings(whole.reading + lag)])[0] == pytest.approx(
        repeat_variance([whole])[0], rel=1e-6
    )


def test_campaigns_pool_their_repeats() -> None:
    one, other = campaign(seed=1), campaign(seed=2)
    (a, n), (b, m) = repeat_variance([one]), repeat_variance([other])
    both, dof = repeat_variance([one, other])
    assert both == pytest.approx((a + b) / 2)
    assert abs(dof - (n + m)) <= 1


@pytest.mark.parametrize("scatter", [0.0, 0.1, 0.25, 0.5, 1.0])
def test_rounding_that_repeats_have_in_common(scatter: float) -> None:
    """Against rounding many readings of many places: the variance of each place's mean error."""
    step = 1e-5
    rng = np.random.default_rng(1)
    true = np.linspace(0, 1, 200, endpoint=False)[:, None]
    shown = np.round(true + scatter * rng.standard_normal((200, 2000)))
    simulated = step * np.sqrt(np.mean((shown.mean(axis=1) - true[:, 0]) ** 2))
    sigma = step * np.sqrt(scatter**2 + 1 / 12)
    assert common_rounding(sigma, step) == pytest.approx(simulated, abs=0.03 * step)


def test_a_coarse_dial_sets_its_rounding_apart() -> None:
    coarse = Dial(resolution=1e-5, repeatability=1e-6)
    noise = noise_of([campaign()], coarse)
    assert noise.common > 0
    assert noise.sigma[0][0] ** 2 + noise.common**2 == pytest.approx(noise.typical**2)
    assert noise_of([unrepeated()], coarse).common == 0.0
    assert noise_of([campaign()], replace(coarse, repeatability=2e-5)).common == 0.0
    assert common_rounding(1e-5, 0.0) == 0.0
