"""Small inputs after public reports on which an earlier version was wrong: see data/field."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import orthoglide as og
from orthoglide.machine_file import Controller

FIELD = Path(__file__).parent / "data" / "field"


def closed(folder: str, file: str) -> og.Verdict:
    """The readings that a printer's file holds, closed."""
    found = og.import_printer(FIELD / folder / file)
    return og.close_loop(found.campaigns, og.Machine(found.machine))


@pytest.mark.parametrize("file", ["real.cfg", "crumb-0.8mm.cfg"])
def test_seven_touches_far_beyond_their_noise_are_unexplained(file: str) -> None:
    verdict = closed("seven-touches-false-adequate", file)
    assert verdict.before.scores.lack_of_fit_p < 1e-6
    assert verdict.word == "unexplained"
    assert "read it again" in verdict.actions[0].words


def test_a_mistyped_distance_is_a_slip() -> None:
    verdict = closed("distance-mistyped", "printer.cfg")
    (slip,) = verdict.blunders
    assert (slip.kind, slip.setups) == ("outlier", ("rim",))
    assert "63.9 mm is -1.1" in slip.message


def test_drives_of_three_per_cent_are_told_of_the_drives() -> None:
    folder = FIELD / "drives-3-percent-called-dome"
    machine = og.Machine.load(folder / "machine.toml")
    verdict = og.close_loop(og.read_readings(folder / "plate.csv", machine.spec), machine)
    (cause, *_) = verdict.effects
    assert cause.name == "encoder_scale.common"
    assert cause.chosen.value == pytest.approx(0.033, abs=0.002)
    assert "measure 100 mm of the carriage's travel" in cause.chosen.look_at


def test_travel_that_is_counted_down_is_told() -> None:
    folder = FIELD / "travel-counted-down"
    machine = og.Machine.load(folder / "machine.toml")
    readings = og.read_readings(folder / "plate.csv", machine.spec)
    with pytest.raises(
        og.InputError, match=r"fit a plane to 0\.00\d mm: set sign = \[-1, -1, -1\]"
    ):
        og.close_loop(readings, machine)
    right = og.Machine(replace(machine.spec, controller=Controller(sign=(-1, -1, -1))))
    again = og.read_readings(folder / "plate.csv", right.spec)
    assert og.close_loop(again, right).word == "adequate"
