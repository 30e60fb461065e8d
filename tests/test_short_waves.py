"""Waves of some centimetres on the long rails of a linear delta, by a tracker or a level; and the
places of machines of other sizes.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.delta_truth import machine, measured
from benchmarks.public import campaign, tcp_points
from orthoglide.effects.free_form import free_forms
from orthoglide.effects.kernels import Kernel
from orthoglide.effects.plates import residual_plate_shapes
from orthoglide.geometry import Geometry
from orthoglide.machine_file import MachineFile, machine_text, parse_machine_file
from tests import rig_campaigns
from tests.rig import Rig
from tests.rig_delta import DeltaRig
from tests.studied import studied

PERIOD = 0.055


def wave(travel: float) -> float:
    return float(np.sin(2 * np.pi * travel / PERIOD + 1.0))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("part", "direction", "size", "instrument", "words"),
    [
        ("rail", "tangential", 1e-4, "tool coordinates",
         "the path of the b carriage leaves its line"),
        pytest.param("carriage", "b", 1.5e-3, "probe and level", "the b carriage turns about b",
                     marks=pytest.mark.thorough),
    ],
)  # fmt: skip
def test_located_as_such_and_kept(
    tmp_path: Path, part: str, direction: str, size: float, instrument: str, words: str
) -> None:
    rig = DeltaRig()
    if part == "rail":
        rig = replace(rig, bends={"b": lambda s: (0.0, size * wave(s), 0.0)})
    else:
        rig = replace(rig, turns={"b": lambda s: size * wave(s)})
    squares = []
    for draw in range(3, 8):  # a wave has three numbers: one draw says little of its band
        rows = measured(rig, np.random.default_rng(draw), machine=machine(), instrument=instrument)
        verdict = studied(rows, machine())
        assert (verdict.word, verdict.effects) == ("located", ())
        ((curve,),) = (found.members for found in verdict.located)
        assert curve.name.startswith(f"{part}.b.{direction}/waves@")
        assert curve.place.period == pytest.approx(PERIOD, rel=0.03)
        assert curve.description.startswith(words)
        assert re.search(r"in waves of 5\d(\.\d)? mm along its travel$", curve.description)
        # As large as it is, where it was read; its band says how well.
        low, high = np.percentile(rows.command, [5, 95])
        read = (curve.at > low) & (curve.at < high)
        true = np.array([size * wave(s) for s in curve.at])
        scaled = (curve.value - true - np.mean((curve.value - true)[read])) / curve.sigma
        squares.append(np.mean(scaled[read] ** 2))
        assert np.corrcoef(curve.value[read], true[read])[0, 1] > 0.9
    assert np.sqrt(np.mean(squares)) < 1.5
    verdict.machine.save(tmp_path / "calibrated.toml")
    kept = og.Machine.load(tmp_path / "calibrated.toml")
    commands = rows.command[:: len(rows.command) // 20]
    assert np.abs(kept.forward(commands) - verdict.machine.forward(commands)).max() < 1e-7


@pytest.mark.parametrize("half", [0.004, 0.08, 0.27])
def test_short_waves_are_shorter_than_the_others_on_every_stroke(half: float) -> None:
    by_name = {p.name: p for p in free_forms(stroke=(-half, half))}
    short = [p for p in by_name.values() if p.short_waves]
    assert sorted(p.part for p in short) == 9 * ["carriage"] + 3 * ["drive"] + 6 * ["rail"]
    for place in short:
        other = by_name[place.name.replace("/waves", "/travel")]
        assert isinstance(place.kernel, Kernel)
        assert isinstance(other.kernel, Kernel)
        assert place.kernel.length <= other.kernel.length / 2


@pytest.mark.parametrize(
    ("sheet", "period"),
    [
        ("sweep", 0.025),
        # At even stations of 10 mm these readings of its own dials are those of a wave of 60 mm.
        pytest.param("fine-sweep", 0.012, marks=pytest.mark.thorough),
    ],
)
def test_waves_of_the_rail_of_an_orthoglide(tmp_path: Path, sheet: str, period: float) -> None:
    """Waves of one period belong to their rail, not to a dial, and are known between stations."""
    rows = rig_campaigns.protocol_rows(sheet)
    rig = Rig(extra=(rig_campaigns.wavy_rail(0, 2, 3e-4, period),))
    rng = np.random.default_rng(8)
    readings = campaign(rig_campaigns.simulate(rig, rows, rng))
    points = tcp_points(rig_campaigns.tcp_points(rig, 40, rng))
    found = studied([readings], og.Machine.nominal(), tcp=points)
    assert (found.word, found.effects) == ("located", ())
    ((curve,),) = (located.members for located in found.located)
    assert curve.name.startswith("rail.x.z/waves@")
    assert curve.place.period == pytest.approx(period, rel=0.01)
    assert curve.description.endswith(f"in waves of {period * 1e3:.0f} mm along its travel")
    assert found.after.scores.cv_rms < 0.5 * found.before.scores.cv_rms
    assert found.tcp is not None
    assert found.tcp["translation"].after_mean < 0.2 * found.tcp["translation"].before_mean
    assert found.tcp["translation"].inside > 0.9
    found.machine.save(tmp_path / "calibrated.toml")
    kept = og.Machine.load(tmp_path / "calibrated.toml")
    commands = points.points().command
    assert np.abs(kept.forward(commands) - found.machine.forward(commands)).max() < 1e-7


# -- machines of other sizes -----------------------------------------------------------------------


def test_parts_of_a_workshop_s_machines_are_made_to_the_same_tolerances() -> None:
    assert [Geometry(L=length).scale for length in (0.15, 0.31025, 0.345, 0.6)] == [1.0] * 4
    assert Geometry(L=1.8).scale == pytest.approx(3.0)
    stage = Geometry(0.03, 0.008, 0.003, (-0.01, 0.006))
    assert stage.scale == pytest.approx(0.2)
    usual = {place.name: place.prior_sd for place in free_forms()}
    for place in free_forms(stroke=stage.stroke, scale=stage.scale):
        assert place.prior_sd == pytest.approx(
            usual[place.name] * (1.0 if place.is_rotation else 0.2)
        )
    at = np.random.default_rng(0).uniform(-0.7, 0.7, (5, 2))
    for (_, fine), (_, size) in zip(
        residual_plate_shapes(at, stage.scale), residual_plate_shapes(at), strict=True
    ):
        assert fine == pytest.approx(0.2 * size)
    # The curve of a rail is of the same tolerance where it was found and where it is kept.
    name = next(place.effect.name for place in free_forms() if place.part == "rail")
    text = machine_text(MachineFile(geometry=stage))
    kept = parse_machine_file(
        f'{text}\n[parameters]\n"{name}.x.1" = {{value = 0.001, sigma = 0.0, unit = "mm"}}\n'
    ).catalogue
    assert kept[name].tolerance == pytest.approx(0.2 * 0.05)
