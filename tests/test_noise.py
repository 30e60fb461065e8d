"""The noise of one reading, from every source there is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import InputError
from orthoglide.fit import Noise, noise_of
from orthoglide.fit.noise import PUBLISHED_REPEATABILITY, RowNoise
from orthoglide.fit.repeats import common_rounding, dial_steps, repeat_variance
from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine_file import Dial, Instrument
from orthoglide.observations import Readings, protocol
from orthoglide.planning.sheets import tool_sheet
from orthoglide.report import report_files, summary
from orthoglide.result import Fit
from tests.studied import studied
from tests.test_report import words

SPREAD = 3e-5
EXACT = Dial(resolution=0.0)


def by_dial(
    tables: list[Readings],
    dial: Dial,
    declared: float | None = None,
    steps: list[np.ndarray] | None = None,
) -> tuple[Noise, tuple[RowNoise, ...]]:
    """Noise of readings of a machine with this dial."""
    spec = replace(og.Machine.nominal().spec, dial=dial)
    return noise_of(tables, spec, declared, steps)


def campaign(sigma: float = float("nan"), drift: float = 0.0, seed: int = 0) -> Readings:
    """The sweep's three rounds: readings that scatter about a slow drift."""
    sheet = protocol("sweep")
    rng = np.random.default_rng(seed)
    readings = SPREAD * rng.standard_normal(len(sheet)) + drift * np.arange(len(sheet))
    return replace(sheet, reading=readings, sigma=np.full(len(sheet), sigma))


def unrepeated() -> Readings:
    whole = campaign()
    return whole.subset(whole.repeat == 1)


@pytest.mark.parametrize("bad", [0.0, -1e-5, float("nan"), float("inf"), 5e-3])
def test_declared_noise_is_some_instruments(bad: float) -> None:
    with pytest.raises(InputError, match=r"deviation in metres, from 1e-09 to 0\.001, not"):
        by_dial([campaign()], EXACT, bad)


def caution(estimate: og.Estimate | Fit) -> str:
    """What is said of readings that scatter less than was declared."""
    return " ".join(w for w in estimate.warnings if w.kind == "quiet")


@pytest.mark.thorough
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


@pytest.mark.thorough
@pytest.mark.parametrize("count", [8, pytest.param(60, marks=pytest.mark.thorough)])
def test_noise_declared_too_large_for_points_of_the_tool(count: int) -> None:
    points = og.simulate_tcp(og.Machine.nominal(), count, seed=1)
    spread = np.random.default_rng(2).normal(scale=1e-5, size=len(points))
    points = points.with_readings(points.reading + spread)
    assert caution(og.identify(points, noise=5e-4))
    assert caution(og.identify(replace(points, sigma=np.full(len(points), 5e-4))))
    assert not caution(og.identify(points, noise=1e-5))
    assert not caution(og.identify(points))


@pytest.mark.thorough(except_for=["0"])
@pytest.mark.parametrize("seed", range(5))
def test_noise_declared_about_right_is_not_doubted(seed: int) -> None:
    read = og.simulate(og.Machine.nominal(), "standard", noise=5e-6, seed=seed)
    for noise in (4e-6, 1e-5):
        assert not caution(og.identify(read, noise=noise))


def test_machine_adds_what_the_dial_rounds_away() -> None:
    noise, _ = by_dial([unrepeated()], Dial(resolution=3e-5, repeatability=1e-5))
    assert noise.source == "machine"
    assert noise.typical == pytest.approx(np.sqrt(1e-10 + 9e-10 / 12))


def test_a_slow_drift_is_no_noise() -> None:
    (still, _), (drifting, _) = (by_dial([campaign(drift=d)], EXACT) for d in (0.0, 5e-7))
    assert drifting.typical == pytest.approx(still.typical, rel=0.1)
    assert np.std(campaign(drift=5e-7).reading) > 1.02 * np.std(campaign().reading)


def test_repeats_never_say_less_than_the_rounding() -> None:
    silent = campaign().with_readings(np.zeros(len(campaign())))
    noise, _ = by_dial([silent], Dial(resolution=1e-5))
    assert noise.source == "repeats"
    assert noise.typical == pytest.approx(1e-5 / np.sqrt(12))


def test_without_repeats_the_published_figure() -> None:
    noise, _ = by_dial([unrepeated()], Dial(resolution=1e-5))
    assert noise.source == "machine"
    assert noise.typical == pytest.approx(np.sqrt(PUBLISHED_REPEATABILITY**2 + 1e-10 / 12))


def test_too_few_repeats_do_not_count() -> None:
    whole = campaign()
    few = whole.subset((whole.repeat == 1) | ((whole.repeat == 2) & (whole.order < 34)))
    variance, dof = repeat_variance([few])
    assert np.isfinite(variance)
    assert 0 < dof < 6
    assert by_dial([few], EXACT)[0].source == "machine"


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
    noise, (rows,) = by_dial([campaign()], coarse)
    assert (rows.common > 0).all()
    assert rows.sigma[0] ** 2 + rows.common[0] ** 2 == pytest.approx(noise.typical**2)
    loud = replace(coarse, repeatability=2e-5)
    for given, dial in ((unrepeated(), coarse), (campaign(), loud)):
        assert not by_dial([given], dial)[1][0].common.any()
    assert common_rounding(1e-5, 0.0) == 0.0


# -- the step that a dial's readings show ---------------------------------------------------------

STEP = 5e-5
DATA = Path(og.__file__).parent / "data"
RIG = Path(__file__).parent / "data" / "rig"


def on_grid(step: float, setups: int = 6) -> Readings:
    """A sound machine whose zeros are off, its first setups read on a step without the rest."""
    worn = og.Machine.nominal().with_parameters({"joint_offset.x": 3e-3, "joint_offset.y": -2e-3})
    exact = og.simulate(worn, "sweep", noise=5e-6, seed=3)
    coarse = np.round(exact.reading / step) * step
    return exact.with_readings(np.where(exact.setup < setups, coarse, exact.reading))


def steps(read: Readings) -> list[float]:
    """Step of each setup's dial, as its readings tell."""
    found = dial_steps(read, 1e-5)
    return [float(found[read.setup == k].max()) for k in range(len(read.setups))]


def test_a_coarse_step_is_seen_in_the_readings() -> None:
    assert steps(on_grid(STEP)) == [STEP] * 6
    assert steps(on_grid(STEP, setups=1)) == [STEP, *[1e-5] * 5]
    moved = on_grid(STEP)
    assert steps(moved.with_readings(moved.reading + 3e-5)) == [STEP] * 6, "off the datum"
    assert steps(on_grid(25.4e-6)) == [25.4e-6] * 6, "a thousandth of an inch"


def test_a_step_is_never_made_up() -> None:
    """Few different readings are on a coarser grid by chance; what is finer is no dial's."""
    for path in (*DATA.glob("experiment*.csv"), *RIG.glob("rig-?.csv")):
        (read,) = og.read_readings(path, og.Machine.nominal().spec)
        assert set(steps(read)) == {1e-5}, path.name
    still = on_grid(1e-5)
    metres = np.where(still.setup == 0, still.reading * 1e-3, still.reading + 1e-5 * still.order)
    assert set(steps(still.with_readings(metres))) == {1e-5}
    sheet, rng = protocol("standard"), np.random.default_rng(0)
    once = sheet.subset(sheet.repeat == 1)
    drawn = 1e-5 * rng.integers(0, 20, (500, len(once)))
    assert sum(set(steps(once.with_readings(d))) != {1e-5} for d in drawn) <= 1


def test_the_noise_of_a_coarse_dial_has_its_rounding() -> None:
    known = Dial(repeatability=5e-6)
    noise, (rows,) = by_dial([on_grid(STEP)], known)
    declared, (as_told,) = by_dial([on_grid(STEP)], replace(known, resolution=STEP))
    assert noise.typical == declared.typical
    assert np.array_equal(rows.sigma, as_told.sigma)
    assert noise.resolution == STEP
    one = on_grid(STEP, setups=1)
    mixed, (by_rows,) = by_dial([one], known)
    fine, (by_fine,) = by_dial([one], known, steps=[np.full(len(one), 1e-5)])
    assert mixed.typical == fine.typical
    assert np.array_equal(by_rows.sigma[one.setup > 0], by_fine.sigma[one.setup > 0])
    station = np.hypot(by_rows.sigma, by_rows.common)[one.setup == 0]
    assert np.sqrt(25e-12 + STEP**2 / 12) == pytest.approx(station.min())
    for read in (on_grid(STEP), one):
        assert by_dial([read], Dial())[0].source == "repeats"


@pytest.mark.thorough(except_for=["None-6"])
@pytest.mark.parametrize("setups", [6, 1])
@pytest.mark.parametrize("repeatability", [None, 5e-6])
def test_a_sound_machine_read_on_a_coarse_step_is_sound(
    setups: int, repeatability: float | None
) -> None:
    """5 to 8 innocent readings were set aside, and up to five places found."""
    nominal = og.Machine.nominal()
    dial = replace(nominal.spec.dial, repeatability=repeatability)
    verdict = og.close_loop([on_grid(STEP, setups)], og.Machine(replace(nominal.spec, dial=dial)))
    assert verdict.word == "adequate"
    assert not verdict.blunders
    assert not verdict.located
    (note,) = (n for n in verdict.warnings if n.kind == "step")
    assert "multiples of 0.05 mm" in note
    said = "declare it as resolution under [dial_mm]" if setups == 6 else "setup 'xy-0.5'"
    assert said in note


def test_too_quiet_readings_are_held_against_all_of_their_noise() -> None:
    """It had been told ten times too small: what repeats have in common was left out."""
    dial = Dial(resolution=STEP, repeatability=5e-6)
    machine = og.Machine(replace(og.Machine.nominal().spec, dial=dial))
    sheet = protocol("sweep")
    fit = og.identify(sheet.with_readings(machine.readings(sheet)), machine)
    (note,) = (n for n in fit.warnings if n.kind == "quiet")
    assert "0.015 mm, as the machine file has it" in note


# -- repeats that scatter by more than was declared -----------------------------------------------


def scattering(
    size: float, loud: float = 0.0, told: float | None = 5e-6, **given: float
) -> og.Estimate:
    """A sound machine, read with some noise, the fourth setup with more, and what is said."""
    nominal = og.Machine.nominal()
    machine = og.Machine(replace(nominal.spec, dial=Dial(repeatability=told)))
    read = og.simulate(nominal, "sweep", noise=size, seed=4)
    extra = loud * np.random.default_rng(1).standard_normal(len(read)) * (read.setup == 3)
    shown = np.round((read.reading + extra) / 1e-5) * 1e-5
    return og.identify(read.with_readings(shown), machine, **given)


def scatter_notes(fit: og.Estimate) -> list[str]:
    return [note for note in fit.warnings if note.kind == "scatter"]


@pytest.mark.thorough(except_for=["7.5e-06"])
@pytest.mark.parametrize("noise", [7.5e-6, 1e-5, 1.5e-5])
def test_repeats_that_scatter_by_more_than_the_machine_file_says_are_told(noise: float) -> None:
    """What is left was told as a machine with an error that nothing explains, and no more."""
    fit = scattering(noise)
    (note,) = scatter_notes(fit)
    assert "where the machine file says 0.005: correct repeatability under [dial_mm]" in note
    said = float(note.partition("scatter by ")[2].partition(" mm")[0])
    assert said == pytest.approx(noise * 1e3, rel=0.15)
    shown = np.hypot(noise, 1e-5 / np.sqrt(12))  # the repeats' own, in place of what they refute
    assert fit.problem.noise.typical == pytest.approx(shown, rel=0.15)


def test_one_setup_that_scatters_is_named() -> None:
    (note,) = scatter_notes(scattering(5e-6, loud=2e-5))
    assert "setup 'yz-0.5': repeats scatter by" in note
    assert "look for what is loose on this dial" in note


@pytest.mark.thorough
def test_nothing_is_said_of_repeats_as_declared_or_that_declare_themselves() -> None:
    for noise in (1e-6, 3e-6, 5e-6):
        assert not scatter_notes(scattering(noise))
    assert not scatter_notes(scattering(1e-6, told=1e-6)), "rounding alone"
    assert not scatter_notes(scattering(1.5e-5, told=None))
    (note,) = scatter_notes(scattering(1.5e-5, noise=5e-6))
    assert "where 0.005 was declared: correct what was declared" in note


@pytest.mark.thorough
@pytest.mark.parametrize("size", [1.2e-5, 3e-5])
def test_noise_declared_too_small_is_said_and_the_machine_is_not_blamed(size: float) -> None:
    """Six times the declared noise was told as dials and bars that change with time."""
    fit = scattering(size)
    verdict = og.close_loop(fit.problem.campaigns, fit.problem.machine)
    assert (verdict.word, verdict.blunders) == ("adequate", ())
    assert verdict.noise.single_reading.length == pytest.approx(size, rel=0.25)
    assert (verdict.noise.source, verdict.noise.by_instrument["leg"].source) == ("repeats",) * 2
    assert summary(verdict).count("scatter by") == 1
    assert words(report_files(verdict)["report.html"]).count("scatter by") == 1


@pytest.mark.thorough
@pytest.mark.parametrize("told", [5e-7, 1e-7])
def test_a_datasheets_figure_locates_no_place_in_repeats_that_scatter(told: float) -> None:
    """Neighbouring digits of a loud dial passed for edges of its steps; bars grew with time."""
    fit = scattering(5e-6, told=told)
    closed = studied(fit.problem.campaigns, fit.problem.machine)
    assert not closed.located
    (note,) = scatter_notes(closed.after)
    assert "where the machine file says 0.000" in note


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_an_instrument_at_the_tool_that_scatters_by_more_than_declared_is_told(
    times: float,
) -> None:
    """A sound machine had something that no effect explains, and its instrument was not doubted."""
    nominal = og.Machine.nominal()
    machine = og.Machine(replace(nominal.spec, instruments={"tcp": Instrument(1e-6, 1e-5)}))
    sheet = tool_sheet(machine, OBSERVATIONS["tcp"])
    read = og.simulate(machine, sheet, noise=times * 1e-5, seed=4)
    notes = scatter_notes(og.identify(read, machine))
    assert len(notes) == (times > 1)
    for note in notes:
        assert "the machine file says 0.01: correct repeatability under [instrument.tcp]" in note
        said = float(note.partition("scatter by ")[2].partition(" mm")[0])
        assert said == pytest.approx(times * 1e-2, rel=0.2)


@pytest.mark.thorough
def test_the_source_of_the_noise_is_told_of_each_instrument(tmp_path: Path) -> None:
    """Repeats of a tracker were said to be the machine file, and its noise mixed with a probe's."""
    machine = og.Machine.nominal()
    tracker, probe = og.tool_sheets(machine, ["tcp", "plate"])
    read = [og.simulate(machine, tracker, noise=3e-5, seed=1), og.simulate(machine, probe, seed=1)]
    found = og.close_loop([*read], machine)
    found.report(tmp_path / "out")
    kept = json.loads((tmp_path / "out" / "result.json").read_text())
    assert kept["noise_source"] == "repeats"
    assert kept["noise_of"]["tcp"]["source"] == "repeats"
    assert kept["noise_of"]["tcp"]["mm"] == pytest.approx(0.03, rel=0.4)
    plate = {"mm": 0.02, "source": "machine", "sigma_si": 2e-5, "unit": "mm"}
    assert kept["noise_of"]["plate"] == plate
    assert "from the scatter of the repeats" in (tmp_path / "out" / "report.html").read_text()
    own = replace(machine.spec, instruments={"tcp": og.Instrument(repeatability=3e-5)})
    told = og.identify(read[0], replace(machine, spec=own)).problem
    assert told.noise_by_instrument == {"tcp": (pytest.approx(3e-5), "machine")}
    assert told.noise_source == "machine"
    declared = og.identify(replace(read[0], sigma=np.full(len(tracker), 2e-5)), machine).problem
    assert declared.noise_by_instrument == {"tcp": (pytest.approx(2e-5), "declared")}
    dials = og.identify(og.simulate(machine, "standard"), machine).problem
    assert list(dials.noise_by_instrument) == ["leg"]
    assert dials.noise_source == dials.noise.source


@pytest.mark.thorough
def test_a_dial_in_inches_among_others_is_asked_about() -> None:
    """It moves little, so that its fit tells nothing: 0.0005 inches are 0.0127 mm, off the step."""
    worn = og.Machine.nominal().with_parameters({"joint_offset.x": 1e-3, "axis_tilt.x.y": 1e-3})
    campaign = og.simulate(worn, og.protocol("sweep"), noise=5e-6, seed=8)
    rows = campaign.setup == 0
    inches = np.where(rows, np.round(campaign.reading / 25.4 / 5e-7) * 5e-7, campaign.reading)
    told = [
        str(n) for n in og.identify(campaign.with_readings(inches)).warnings if n.kind == "step"
    ]
    assert len(told) == 1
    assert f"setup {campaign.setups[0].name!r}" in told[0]
    assert "look whether this dial shows inches" in told[0]
    assert not [n for n in og.identify(campaign).warnings if n.kind == "step"]


def test_readings_that_were_never_rounded_share_no_rounding() -> None:
    """Declared of averages, or of a finer instrument than the machine file's dial."""
    sheet = protocol("sweep")
    exact = og.Machine.nominal().with_parameters({"joint_offset.x": 5e-4}).readings(sheet)
    given = sheet.with_readings(exact + np.random.default_rng(0).normal(0, 2e-6, len(sheet)))
    found = og.identify(given, og.Machine.nominal(), noise=2e-6, method="nested")
    assert not found.problem.shared_rounding_sd.any()
    assert np.allclose(found.problem.sigma, 2e-6)
