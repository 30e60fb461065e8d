"""The noise of one reading, from every source there is, down to a few repeats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks import public
from benchmarks.delta_readings import measured
from orthoglide.errors import InputError
from orthoglide.explanation import assumed_noise
from orthoglide.explanation.data_faults import find_data_faults
from orthoglide.fit import Noise, assemble, noise_of, solve
from orthoglide.fit.noise import PUBLISHED_REPEATABILITY, RowNoise
from orthoglide.fit.repeats import common_rounding, dial_steps, repeat_variance
from orthoglide.machine_file import Dial, Instrument
from orthoglide.observations import Readings, protocol
from orthoglide.planning.sheets import instrument_sheet
from tests import rig_campaigns as rc
from tests.rig import Rig
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_checking import delta

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


def test_without_repeats_the_published_figure() -> None:
    noise, _ = by_dial([unrepeated()], Dial(resolution=1e-5))
    assert noise.source == "machine"
    assert noise.typical == pytest.approx(np.sqrt(PUBLISHED_REPEATABILITY**2 + 1e-10 / 12))


def test_repeats_are_told_apart_by_approach() -> None:
    """Backlash between the two sides of a posture is no scatter."""
    whole = campaign()
    lag = whole.approach[np.arange(len(whole)), whole.leg] * 1e-3
    assert repeat_variance([whole.with_readings(whole.reading + lag)])[0] == pytest.approx(
        repeat_variance([whole])[0], rel=1e-6
    )


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


def test_a_sound_machine_read_on_a_coarse_step_is_sound() -> None:
    """5 to 8 innocent readings were set aside, and up to five places found."""
    verdict = studied([on_grid(STEP)], og.Machine.nominal())
    assert verdict.word == "adequate"
    assert not verdict.blunders
    assert not verdict.located
    (note,) = (n for n in verdict.after.warnings if n.kind == "step")
    assert "multiples of 0.05 mm" in note
    assert "declare it as resolution under [dial_mm]" in note


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


def test_repeats_that_scatter_by_more_than_the_machine_file_says_are_told() -> None:
    """What is left was told as a machine with an error that nothing explains, and no more."""
    noise = 7.5e-6
    fit = scattering(noise)
    (note,) = scatter_notes(fit)
    assert "where the machine file says 0.005: correct repeatability under [dial_mm]" in note
    said = float(note.partition("scatter by ")[2].partition(" mm")[0])
    assert said == pytest.approx(noise * 1e3, rel=0.15)
    shown = np.hypot(noise, 1e-5 / np.sqrt(12))  # the repeats' own, in place of what they refute
    assert fit.problem.noise.typical == pytest.approx(shown, rel=0.15)


def test_noise_that_repeats_refute_is_not_assumed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Faults were searched with it too, which took twelve times as long and explained nothing."""
    fit = scattering(2e-5)
    tried = list[og.Estimate]()
    monkeypatch.setattr(assumed_noise, "fit_nested", lambda *given: tried.append(given))
    assert find_data_faults(fit).faults == ()
    assert not tried


def test_one_setup_that_scatters_is_named() -> None:
    (note,) = scatter_notes(scattering(5e-6, loud=2e-5))
    assert "setup 'yz-0.5': repeats scatter by" in note
    assert "look for what is loose on this dial" in note


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_an_instrument_at_the_tool_that_scatters_by_more_than_declared_is_told(
    times: float,
) -> None:
    """A sound machine had something that no effect explains, and its instrument was not doubted."""
    nominal = og.Machine.nominal()
    machine = og.Machine(replace(nominal.spec, instruments={"tcp": Instrument(1e-6, 1e-5)}))
    sheet = instrument_sheet(machine, "tcp")
    read = og.simulate(machine, sheet, noise=times * 1e-5, seed=4)
    notes = scatter_notes(og.identify(read, machine))
    assert len(notes) == (times > 1)
    for note in notes:
        assert "the machine file says 0.01: correct repeatability under [instrument.tcp]" in note
        said = float(note.partition("scatter by ")[2].partition(" mm")[0])
        assert said == pytest.approx(times * 1e-2, rel=0.2)


# -- one instrument noisier than all others -------------------------------------------------------


def one_noisy(ratio: float, seed: int, repeats: int = 1) -> list[rc.Row]:
    """A sound machine's sweep, by default without repeats, one of whose six dials has so many times
    the noise that the machine file gives.
    """
    rows = rc.protocol_rows("sweep", repeats=repeats)
    noise = np.where([row["setup"] == "yx-0.5" for row in rows], ratio, 1.0) * 5e-6
    return rc.simulate(Rig(), rows, np.random.default_rng(seed), noise=noise, background=0.015)


@pytest.mark.parametrize("seed", [9500, 9501])
def test_a_dial_far_noisier_than_the_others_is_no_error_of_the_machine(seed: int) -> None:
    """Rails that bend by approach or travel, or the dial's stand by time, were named for it."""
    found = studied(public.campaign(one_noisy(5.0, seed)), public.machine())
    assert (found.word, list(found.effects), list(found.located)) == ("adequate", [], [])
    (fault,) = found.blunders
    assert (fault.kind, fault.setups) == ("noisy", ("yx-0.5",))
    assert "times as noisy" in fault.message
    problem = found.after.problem
    noisy = np.array([s.name == "yx-0.5" for s in problem.setups])[problem.setup_of_row]
    assert problem.reading_sd[noisy].min() > 2.5 * problem.reading_sd[~noisy].max()
    # The residual of all readings is compared with the noise of all.
    residual, noise = found.after.scores.rms, problem.single_reading_sd.length
    assert 0.5 < residual / noise < 1.5


@pytest.mark.parametrize("seed", [9500, 9501])
def test_a_noisy_dial_is_not_said_to_be_the_noise_of_all(seed: int) -> None:
    """Its repeats counted for the noise of all dials, which was said to be 0.008 mm."""
    fit = og.identify(public.campaign(one_noisy(5.0, seed, repeats=3)), public.machine())
    (note,) = scatter_notes(fit)
    assert "setup 'yx-0.5': repeats scatter by 0.0" in note
    assert fit.problem.noise.typical == pytest.approx(np.hypot(5e-6, 1e-5 / np.sqrt(12)))


def test_the_noise_of_repeats_is_without_that_of_a_noisier_setup() -> None:
    for seed, ratio in ((1, 1.0), (1, 4.0), (2, 4.0)):
        given = campaign(seed=seed)
        noisier = given.reading * np.where(given.setup == 3, ratio, 1.0)
        noise, _ = by_dial([given.with_readings(noisier)], EXACT)
        assert (noise.source, noise.typical) == ("repeats", pytest.approx(SPREAD, rel=0.1))


def test_a_dial_with_the_noise_of_the_others_is_not_named() -> None:
    found = studied(public.campaign(one_noisy(1.0, 9500)), public.machine())
    assert (found.word, list(found.blunders)) == ("adequate", [])


# -- instruments whose noise is known from a few repeats -------------------------------------------


UNTOLD = og.Machine(replace(delta().spec, instruments={}))
"""Of which no instrument's noise is declared."""


def tracked(seed: int, scale: float, **errors: float) -> Readings:
    """A tracker's points, the first three read again, which differ by ``scale`` of its noise."""
    rng = np.random.default_rng(seed)
    once = measured(DeltaRig(errors=errors), rng, machine=delta(), instrument="tool coordinates")
    n, again = len(once), np.arange(9)
    both = once.subset(np.concatenate([np.arange(n), again]))
    reading = both.reading.copy()
    reading[n:] = reading[again] + scale * 1e-5 * np.sqrt(2) * np.array([1, -1, 1] * 3)
    return replace(
        both, reading=reading, order=np.arange(1, n + 10), line=np.arange(2, n + 11),
        repeat=np.where(np.arange(n + 9) < n, 1, 2),
    )  # fmt: skip


def test_a_sound_machine_is_sound_by_noise_that_nine_differences_tell() -> None:
    """Half the noise is one chance in fifty then, and what is left was held against it as if it
    were known: *unexplained*.
    """
    read = tracked(1, 0.55, **{"joint_offset.a": 4e-4})
    problem = assemble([read], UNTOLD, UNTOLD.catalogue.base)
    assert problem.noise_dof == 6.0
    verdict = studied(read, UNTOLD)
    assert verdict.before.scores.chi2 > 1.8 * verdict.before.scores.dof
    assert 0.003 < verdict.before.scores.lack_of_fit_p < 0.5
    assert verdict.word == "adequate"


def test_the_share_of_each_instrument_counts() -> None:
    """Heights, whose noise is declared, beside a tracker of few repeats."""
    rng = np.random.default_rng(2)
    plate = measured(DeltaRig(), rng, machine=delta(), instrument="probe")
    plate = replace(plate, name="plate", sigma=np.full(len(plate), 2e-5))
    tool = tracked(2, 1.0)
    base = UNTOLD.catalogue.base
    alone, both = (
        solve(assemble(list(read), UNTOLD, base)).problem for read in ([tool], [plate, tool])
    )
    assert alone.noise_dof == 6.0
    share = len(tool) / (len(tool) + len(plate))
    assert both.noise_dof == pytest.approx(alone.noise_dof / share**2)
    none = replace(tool, sigma=np.full(len(tool), 1e-5))
    assert assemble([none], UNTOLD, base).noise_dof == np.inf
