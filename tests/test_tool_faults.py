"""Readings of the tool that their repeats contradict: refused, and nothing that is sound is."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import orthoglide as og
from benchmarks import delta_truth
from benchmarks.delta_readings import measured
from orthoglide.explanation.base_fit import fit_nested
from orthoglide.explanation.data_faults import _merge_faults, without_faults
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.full_posterior import posterior_at_base_fit
from orthoglide.machine import Machine
from orthoglide.machine_file import Instrument
from orthoglide.observations import Readings
from orthoglide.planning.sheets import instrument_sheet
from tests.rig_delta import DeltaRig
from tests.studied import studied

MACHINE = Machine.nominal()
OFF = {"joint_offset.x": 0.7e-3, "joint_offset.y": -1.1e-3, "leg_length.z": 0.04e-3}


def read(kind: str, seed: int = 3, noise: float | None = None, passes: int = 1) -> Readings:
    sheet = instrument_sheet(MACHINE, kind)
    rows = np.tile(np.arange(len(sheet)), passes)
    order = np.arange(len(rows))
    sheet = replace(sheet.subset(rows), order=order + 1, line=order + 2)
    return og.simulate(MACHINE.with_parameters(OFF), sheet, noise=noise, seed=seed)


def moved(size: float) -> tuple[Readings, int]:
    """A tracker that stands elsewhere from half of the readings on, and the first line of these."""
    found = read("tcp")
    late = np.arange(len(found)) >= len(found) // 2
    shown = np.array([1.0, 0.5, -0.7])[found.axis]
    first = int(found.line[late].min())
    return replace(found, reading=found.reading + late * shown * size), first


@pytest.mark.parametrize("size", [5e-5, 2e-3])
def test_an_instrument_that_was_moved_is_told(size: float) -> None:
    """Two millimetres were *adequate*: the noise of the repeats was 0.7 mm, and so was the rest.

    What was read from there on stands in a frame of its own, and the machine is told all the same.
    Five hundredths were a drift and a bar that grew: so far apart the repeats counted as noise.
    """
    campaign, first = moved(size)
    verdict = studied([campaign], MACHINE)
    (fault,) = verdict.blunders
    assert fault.kind == "moved"
    assert not fault.excluded
    assert "had been moved" in fault.message
    lines = fault.rows
    assert abs(min(lines) - first) < len(campaign) / 20
    assert 0.2 * size < float(fault.message.split("read about ")[1].split()[0]) / 1e3 < 2 * size
    assert verdict.word == "adequate"
    assert verdict.values["joint_offset.x"] == pytest.approx(0.7e-3, abs=5e-5)


@pytest.mark.parametrize("kind", ["ballbar", "plate", "incline"])
def test_an_instrument_that_drifts_is_one_fault(kind: str) -> None:
    """It was moved half way, and again before and after; the rest was noise, or a bar."""
    size, found = 3e-4, read(kind, passes=2)
    progress = np.arange(len(found)) / (len(found) - 1)
    verdict = studied([replace(found, reading=found.reading + size * progress)], MACHINE)
    (fault,) = verdict.blunders
    assert (fault.kind, fault.excluded, len(fault.rows_in_request)) == (
        "drifted",
        False,
        len(found),
    )
    told = float(fault.message.split("evenly by about ")[1].split()[0]) * 1e-3
    assert told == pytest.approx(size * np.sqrt(2 if kind == "incline" else 1), rel=0.1)
    assert verdict.word == "adequate"
    sound, scores = studied([found], MACHINE).after.scores, verdict.after.scores
    rms = scores.rms if kind != "incline" else scores.turn_rms
    assert rms == pytest.approx(sound.rms if kind != "incline" else sound.turn_rms, rel=0.2)


@pytest.mark.parametrize("seed", [0, 2])
def test_a_plate_that_was_moved_did_not_drift(seed: int) -> None:
    """Until the noise is known a drift fits as well: it was reported beside the move."""
    found = read("plate", seed=seed, passes=2)
    late = np.arange(len(found)) >= 0.6 * len(found)
    verdict = studied([replace(found, reading=found.reading + 2e-4 * late)], MACHINE)
    assert [fault.kind for fault in verdict.blunders] == ["moved"]


def apart(campaign: Readings, late: np.ndarray) -> Readings:
    """Readings of which the late ones are another setup."""
    setups = (*campaign.setups, replace(campaign.setups[0], name="again"))
    return replace(campaign, setups=setups, setup=np.where(late, 1, campaign.setup))


def test_what_moved_and_is_given_as_another_setup_is_nothing_wrong() -> None:
    """As the sentence says."""
    campaign, first = moved(3e-4)
    verdict = studied([apart(campaign, campaign.line >= first)], MACHINE)
    assert verdict.word == "adequate"
    assert verdict.values["joint_offset.x"] == pytest.approx(0.7e-3, abs=5e-5)


def test_a_tracker_in_any_frame_that_moved_is_fitted_as_another_setup() -> None:
    """Its later frame was searched from the base's axes, and loops of a machine did not close."""
    found = read("tcp")
    frame = Rotation.from_rotvec([1.2, -0.7, 0.5]).as_matrix()
    found = replace(found, reading=(found.reading.reshape(-1, 3) @ frame.T).ravel())
    late = np.arange(len(found)) >= len(found) // 2
    problem = og.identify([found], MACHINE).problem
    fit = fit_nested(without_faults(problem, [Fault("moved", np.flatnonzero(late))]))
    expected = og.identify([apart(found, late)], MACHINE).scores.chi2
    assert fit.scores.chi2 == pytest.approx(expected, abs=0.01)


def test_a_tracker_in_another_frame_from_a_reading_on_is_refused() -> None:
    """With the expected noise the fit reached offsets of 100 mm, to be corrected on the machine."""
    found = read("tcp")
    late = np.arange(len(found)) >= len(found) // 2
    turned = found.reading.reshape(-1, 3) @ Rotation.from_rotvec([0, 0, 1.5]).as_matrix().T
    found = replace(found, reading=np.where(late, turned.ravel(), found.reading))
    with pytest.raises(og.InputError, match=r"scatter by .* mm, which is no noise"):
        studied([found], MACHINE)


def test_a_fault_beside_a_large_cause_is_searched_for() -> None:
    """Faults were screened with no cause active: a hinge that was turned hid where a level moved,
    and the level drifted.
    """
    rng, rig = np.random.default_rng(0), DeltaRig(errors={"mount_tilt.c.b": -0.03})
    found = measured(rig, rng, machine=delta_truth.machine(), instrument="probe and level")
    found = found.subset(np.flatnonzero(found.angular))
    late = np.arange(len(found)) >= 10
    found = replace(found, reading=found.reading - 8e-5 * late * np.array([0.6, 1.0])[found.axis])
    posterior = posterior_at_base_fit(og.identify([found], delta_truth.machine()))
    (fault,) = (n for n, _ in posterior.mixture.active_groups if n.startswith("!"))
    assert fault in ("!moved.10-25:16", "!moved.11-25:15")


def test_what_moved_twice_leaves_no_setup_without_readings() -> None:
    """Whichever is found first: a setup without readings ended the run in a traceback."""
    problem = og.identify([read("tcp")], MACHINE).problem
    late, later = (Fault("moved", np.arange(first, len(problem.measured))) for first in (6, 30))
    for order in ([late, later], [later, late]):
        (factor,) = without_faults(problem, order).factors
        assert np.bincount(factor.setup).min() > 0
        assert len(factor.readings.setups) == 3


def test_a_drift_found_with_a_move_is_searched_for_again() -> None:
    """Both were corrected at once, and the drift of two setups ended the run in a traceback."""
    problem = og.identify([read("tcp")], MACHINE).problem
    rows = np.arange(len(problem.measured))
    late, drift = Fault("moved", rows[30:]), Fault("drifted", rows, sizes=(1e-5,) * len(rows))
    for new in ([late, drift], [drift, late]):
        assert [fault.kind for fault in _merge_faults(problem, [], new)] == ["moved"]


def test_a_visit_that_disagrees_with_the_other_is_told() -> None:
    """Less than what is refused without a repeat."""
    campaign = read("tcp")
    stations = np.column_stack([campaign.stations, campaign.axis])
    _, which, count = np.unique(stations, axis=0, return_inverse=True, return_counts=True)
    row = int(np.flatnonzero(count[which.reshape(-1)] > 1)[0])
    reading = campaign.reading.copy()
    reading[row] += 1.5e-4
    (fault,) = studied([replace(campaign, reading=reading)], MACHINE).blunders
    assert (fault.kind, fault.rows_in_request) == ("outlier", ((0, row),))
    said = rf"line {campaign.line[row]}, .* off the other readings of this place"
    assert re.search(said, fault.message)


def test_a_row_that_stands_twice_is_told() -> None:
    campaign = read("tcp")
    twice = campaign.subset(np.append(np.arange(len(campaign)), 4))
    with pytest.raises(og.InputError, match="the reading of line 6 stands here again"):
        og.identify(twice, MACHINE)


def test_two_visits_that_were_exchanged_are_told() -> None:
    """Two of a size are noise to each other: 0.3 mm apart were *adequate*."""
    campaign = read("plate", passes=2)
    reading = campaign.reading.copy()
    one, other = np.argsort(reading)[[0, -1]]
    apart = reading[other] - reading[one]
    assert apart > 2e-4
    reading[[one, other]] = reading[[other, one]]
    found = studied([replace(campaign, reading=reading)], MACHINE).blunders
    assert {row for fault in found for _, row in fault.rows_in_request} == {one, other}


@pytest.mark.parametrize(("kind", "step"), [("ballbar", 1e-4), ("incline", 1e-4), ("plate", 5e-5)])
def test_a_coarse_step_is_seen_and_is_noise(kind: str, step: float) -> None:
    """Repeats that agree to the step were noise of a micrometre, and a flip of one a slip."""
    for seed in range(2):
        found = read(kind, seed, passes=2)
        coarse = replace(found, reading=np.round(found.reading / step) * step)
        estimate = og.identify([coarse], MACHINE)
        assert not any(w.kind == "slip" for w in estimate.warnings)
        assert estimate.sigma_scale < 1.5
        noise = np.hypot(estimate.problem.sigma, estimate.problem.shared_rounding_sd)
        assert np.sqrt(np.mean(noise**2)) > 0.28 * step


def test_copied_repeats_say_nothing_of_the_noise() -> None:
    """They had made it a tenth of what is usual, without a word."""
    campaign = read("plate", passes=2)
    half = campaign.reading[: len(campaign) // 2]
    found = og.identify([replace(campaign, reading=np.tile(half, 2))], MACHINE)
    assert found.problem.sigma == pytest.approx(2e-5)
    assert any(w.kind == "copies" for w in found.warnings)


@pytest.mark.parametrize("kind", ["tcp", "incline"])
def test_readings_of_one_place_in_opposite_directions_are_no_repeats(kind: str) -> None:
    """They were refused: visits to one place scattered by twice what was read."""
    sheet = read(kind)
    twice = sheet.subset(np.repeat(np.arange(len(sheet)), 2))
    sign = np.where(np.arange(len(twice)) % 2, -twice.sign, twice.sign)
    both = replace(twice, sign=sign, order=np.arange(len(twice)))
    verdict = studied([og.simulate(MACHINE.with_parameters(OFF), both, seed=4)], MACHINE)
    assert (verdict.word, verdict.blunders) == ("adequate", ())
    if kind == "tcp":  # a level sees no zeros
        assert verdict.values["joint_offset.y"] == pytest.approx(OFF["joint_offset.y"], abs=1e-4)


def test_noise_that_no_instrument_has_is_declared_or_refused() -> None:
    """Half a millimetre of a tracker is adequate to nothing."""
    campaign = read("tcp", noise=5e-4)
    with pytest.raises(og.InputError, match=r"give repeatability .*\[instrument\.tcp\]"):
        studied([campaign], MACHINE)
    instruments = {"tcp": Instrument(repeatability=5e-4)}
    poor = Machine(replace(MACHINE.spec, instruments=instruments))
    assert studied([campaign], poor).word == "adequate"


def test_a_plate_that_moved_half_way_stands_twice() -> None:
    """No place of this sheet is read twice: it was *unexplained*, and counted as rough."""
    campaign = read("plate")
    late = np.arange(len(campaign)) >= len(campaign) // 2
    verdict = studied([replace(campaign, reading=campaign.reading + late * 3e-4)], MACHINE)
    (fault,) = verdict.blunders
    assert (fault.kind, verdict.word) == ("moved", "adequate")
    assert [row for _, row in fault.rows_in_request] == np.flatnonzero(late).tolist()
    assert not [w for w in verdict.after.warnings if w.kind == "loud"]


def test_a_plate_that_counts_as_rough_is_said_to() -> None:
    """What its touches jump by from place to place is more than any plate is rough."""
    campaign = read("plate")
    rough = np.random.default_rng(1).choice([-1.5e-4, 1.5e-4], len(campaign))
    verdict = studied([replace(campaign, reading=campaign.reading + rough)], MACHINE)
    (note,) = (w for w in verdict.after.warnings if w.kind == "loud")
    assert verdict.word in ("unexplained", "adequate")
    assert "or the plate's roughness, have a reading count as good to 0.06 mm" in note
    assert "3 times worse than is usual" in note
    assert not [w for w in og.identify([campaign], MACHINE).warnings if w.kind == "loud"]
