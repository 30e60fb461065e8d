"""Every result is closed once more by Pinocchio, and its own method finds the same parameters."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import CrossCheckError
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate
from orthoglide.fit.crosscheck import MAX_POSTURES, verify
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile, Stiffness
from orthoglide.mechanism.engine import Outputs, SixBars
from orthoglide.mechanism.six_bars import TCP
from orthoglide.observations import Campaign, protocol
from orthoglide.report import result_text
from orthoglide.result import Request, encoded
from orthoglide.verdict import run

RIG = Path(__file__).parent / "data" / "rig"


KEYS = {
    "closure_residual_m",
    "tcp_max_difference_mm",
    "sensitivity_max_relative_difference",
    "postures",
}


@cache
def rig(number: int = 2) -> tuple[Campaign, Machine]:
    machine = Machine.load(RIG / "machine.toml")
    return og.read_campaign(RIG / f"rig-{number}.csv", machine.spec), machine


# -- in every result -------------------------------------------------------------------------


def test_a_result_says_how_far_pinocchio_is_from_it() -> None:
    campaign, machine = rig()
    found = run(Request("identify", (campaign,), machine, free=("joint_offset", "axis_tilt")))
    written = json.loads(result_text(found))["verification"]
    assert set(written) == KEYS
    assert set(written["closure_residual_m"]) == {
        *(f"{leg}_parallelogram" for leg in "xyz"), "platform_xy", "platform_xz"
    }  # fmt: skip
    assert 0 < max(written["closure_residual_m"].values()) < 1e-11
    assert written["tcp_max_difference_mm"] < 1e-9
    assert written["sensitivity_max_relative_difference"] < 1e-9
    assert 0 < written["postures"] <= MAX_POSTURES
    assert found.verification is not None
    assert written == encoded(found.verification)


def test_postures_under_load_are_verified_with_their_stretched_bars() -> None:
    soft = Machine(MachineFile(stiffness=Stiffness(bar=2e6)))
    truth = soft.with_parameters({"joint_offset.x": 3e-4})
    sheet = protocol("standard")
    sheet = replace(sheet, load=np.where(np.arange(len(sheet)) % 2, 100.0, 0.0))
    readings = sheet.with_readings(truth.readings(sheet))
    found = identify(readings, soft, priors=False, method="nested", noise=1e-6)
    assert found.values["joint_offset.x"] == pytest.approx(3e-4, abs=1e-9)
    assert found.verification is not None
    assert found.verification.tcp < 1e-13
    # Both loads of a posture are closed.
    assert found.verification.postures > len(np.unique(sheet.command, axis=0))
    assert found.check is None  # the reduction knows no load


# -- its limits ------------------------------------------------------------------------------


@cache
def estimate() -> Estimate:
    campaign, machine = rig()
    return identify(campaign, machine, method="nested")


@pytest.fixture
def engine() -> Iterator[SixBars]:
    """The six bars that the estimate was found with, to be spoilt."""
    six_bars = estimate().problem.machine.model.engine
    assert isinstance(six_bars, SixBars)
    kept = six_bars.constants.copy()
    yield six_bars
    six_bars.constants = kept


@pytest.mark.parametrize("place", [0, 1, 12, 15, 22, 33, 34, 35, 57, 69, 104])
def test_constants_that_are_off_are_seen(engine: SixBars, place: int) -> None:
    """A start, a slide, a root, a point or a length of the six bars that is not the tree's."""
    assert verify(estimate()).tcp < 1e-12
    spoilt = engine.constants.copy()
    spoilt[place] += 5e-8
    engine.constants = spoilt
    with pytest.raises(CrossCheckError, match="six bars and Pinocchio disagree by") as caught:
        verify(estimate())
    assert 1e-9 < caught.value.difference < 1e-6


@pytest.mark.parametrize(("off", "seen"), [(5e-9, True), (3e-10, False)])
def test_a_tcp_that_is_off_is_seen(
    off: float, seen: bool, engine: SixBars, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone, with sensitivities that are right."""
    plain = engine.tangent

    def moved(travel: Any, moves: Any) -> tuple[Outputs, Any]:
        shown, by_given = plain(travel, moves)
        values = shown.values.copy()
        values[3, 1] += off
        return Outputs(values), by_given

    monkeypatch.setattr(engine, "tangent", moved)
    if seen:
        with pytest.raises(CrossCheckError, match=r"disagree by 5e-06 mm of the TCP"):
            verify(estimate())
    else:
        assert verify(estimate()).tcp == pytest.approx(off, rel=1e-3)


@pytest.mark.parametrize(("off", "seen"), [(1e-5, True), (5e-7, False)])
def test_sensitivities_that_are_off_are_seen(
    off: float, seen: bool, engine: SixBars, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = engine.tangent

    def skewed(travel: Any, moves: Any) -> tuple[Outputs, Any]:
        shown, by_given = plain(travel, moves)
        by_given = by_given.copy()
        by_given[:, TCP, 0] *= 1 + off
        return shown, by_given

    monkeypatch.setattr(engine, "tangent", skewed)
    if seen:
        with pytest.raises(CrossCheckError, match="of a sensitivity"):
            verify(estimate())
    else:
        found = verify(estimate()).sensitivity
        assert 1e-8 < found < 1e-6
