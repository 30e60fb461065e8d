"""Readings of the tool that their repeats contradict: refused, and nothing that is sound is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from orthoglide.diagnosis.tool_faults import check_repeats
from orthoglide.machine import Machine
from orthoglide.machine_file import Instrument
from orthoglide.observations import ToolCampaign
from tests.test_tool_readings import sheet_of

MACHINE = Machine.nominal()
OFF = {"joint_offset.x": 0.7e-3, "joint_offset.y": -1.1e-3, "leg_length.z": 0.04e-3}


def read(kind: str, seed: int = 3, noise: float | None = None) -> ToolCampaign:
    sheet = sheet_of(MACHINE, kind)
    assert isinstance(sheet, ToolCampaign)
    return og.simulate(MACHINE.with_parameters(OFF), sheet, noise=noise, seed=seed)


def moved(kind: str, size: float) -> tuple[ToolCampaign, int]:
    """What stands elsewhere from half of the readings on, and the first line of these."""
    found = read(kind)
    late = np.arange(len(found)) >= len(found) // 2
    if kind == "ballbar":
        p = MACHINE.forward(found.command)
        shown = (p - p.mean(axis=0)) @ [1.0, 0.5, -0.7] / 0.15
    else:
        shown = np.array([1.0, 0.5, -0.7])[found.axis]
    first = int(found.line[late].min())
    return replace(found, reading=found.reading + late * shown * size), first


@pytest.mark.parametrize(("kind", "size"), [("tcp", 3e-4), ("tcp", 2e-3), ("ballbar", 1e-3)])
def test_an_instrument_that_was_moved_is_told(kind: str, size: float) -> None:
    """Two millimetres were *adequate*: the noise of the repeats was 0.7 mm, and so was the rest."""
    campaign, first = moved(kind, size)
    with pytest.raises(og.InputError, match="had been moved") as told:
        og.close_loop([campaign], MACHINE)
    words = str(told.value)
    low, high = (int(w.strip(",")) for w in words.split("lines ")[1].split()[:3:2])
    assert low <= first <= high
    assert high - low < len(campaign) / 4
    assert 0.3 * size < float(words.split("up to ")[1].split()[0]) / 1e3 < 1.2 * size


def test_what_moved_and_is_given_as_another_setup_is_nothing_wrong() -> None:
    """As the sentence says."""
    campaign, first = moved("tcp", 3e-4)
    late = campaign.line >= first
    setups = (*campaign.setups, replace(campaign.setups[0], name="again"))
    apart = replace(campaign, setups=setups, setup=np.where(late, 1, campaign.setup))
    verdict = og.close_loop([apart], MACHINE)
    assert verdict.word == "adequate"
    assert verdict.values["joint_offset.x"] == pytest.approx(0.7e-3, abs=5e-5)


def test_a_visit_that_disagrees_with_the_other_is_told() -> None:
    """Less than what is refused without a repeat."""
    campaign = read("tcp")
    stations = np.column_stack([campaign.stations, campaign.axis])
    _, which, count = np.unique(stations, axis=0, return_inverse=True, return_counts=True)
    row = int(np.flatnonzero(count[which.reshape(-1)] > 1)[0])
    reading = campaign.reading.copy()
    reading[row] += 1.5e-4
    with pytest.raises(og.InputError, match=f"line {campaign.line[row]}, .*off the others"):
        og.close_loop([replace(campaign, reading=reading)], MACHINE)


def test_noise_that_no_instrument_has_is_declared_or_refused() -> None:
    """Half a millimetre of a tracker is adequate to nothing."""
    campaign = read("tcp", noise=5e-4)
    with pytest.raises(og.InputError, match=r"give repeatability .*\[instrument\.tcp\]"):
        og.close_loop([campaign], MACHINE)
    instruments = {"tcp": Instrument(repeatability=5e-4)}
    poor = Machine(replace(MACHINE.spec, instruments=instruments))
    assert og.close_loop([campaign], poor).word == "adequate"


@pytest.mark.parametrize("kind", ["plate", "tcp", "ballbar", "distance", "incline"])
@pytest.mark.parametrize("times", [1.0, 3.0])
def test_sound_readings_are_not_refused(kind: str, times: float) -> None:
    usual = {"plate": 2e-5, "tcp": 1e-5, "ballbar": 5e-6, "distance": 5e-5, "incline": 2e-5}
    for seed in range(20):
        check_repeats(og.identify([read(kind, seed, times * usual[kind])], MACHINE))


def test_a_plate_that_counts_as_rough_is_said_to() -> None:
    """No place of this sheet is read twice: what moved is taken for roughness of the plate."""
    campaign = read("plate")
    late = np.arange(len(campaign)) >= len(campaign) // 2
    off = replace(campaign, reading=campaign.reading + late * 3e-4)
    verdict = og.close_loop([off], MACHINE)
    (note,) = (w for w in verdict.after.warnings if w.kind == "loud")
    assert "or the plate's roughness, have a reading count as good to 0.085 mm" in note
    assert "4.2 times worse than is usual" in note
    assert not [w for w in og.identify([campaign], MACHINE).warnings if w.kind == "loud"]
