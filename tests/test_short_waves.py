"""Waves of some centimetres on the long rails of a linear delta, by a tracker or a level."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.delta_truth import machine, measured
from orthoglide.effects.places import places
from tests.rig_delta import DeltaRig

PERIOD = 0.055


def wave(travel: float) -> float:
    return float(np.sin(2 * np.pi * travel / PERIOD + 1.0))


@pytest.mark.parametrize(
    ("part", "direction", "size", "instrument", "words"),
    [
        ("rail", "tangential", 1e-4, "tool coordinates",
         "the path of the b carriage leaves its line"),
        ("carriage", "b", 1.5e-3, "probe and level", "the b carriage turns about b"),
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
    rows = measured(rig, np.random.default_rng(3), machine=machine(), instrument=instrument)
    verdict = og.close_loop(rows, machine())
    assert (verdict.word, verdict.effects) == ("located", ())
    ((curve,),) = (found.members for found in verdict.located)
    assert curve.place.name == f"{part}.b.{direction}/waves"
    assert curve.place.words.startswith(words)
    assert curve.place.words.endswith("in short waves along its travel")
    # As large as it is, where it was read; its band says how well.
    low, high = np.percentile(rows.command, [5, 95])
    read = (curve.at > low) & (curve.at < high)
    true = np.array([size * wave(s) for s in curve.at])
    scaled = (curve.value - true - np.mean((curve.value - true)[read])) / curve.sigma
    assert np.sqrt(np.mean(scaled[read] ** 2)) < 1.5
    assert np.corrcoef(curve.value[read], true[read])[0, 1] > 0.5
    verdict.machine.save(tmp_path / "calibrated.toml")
    kept = og.Machine.load(tmp_path / "calibrated.toml")
    commands = rows.command[:: len(rows.command) // 20]
    assert np.abs(kept.forward(commands) - verdict.machine.forward(commands)).max() < 1e-7


def test_a_short_stroke_has_one_of_each() -> None:
    assert not [p for p in places() if p.short]
    both = {p.name for p in places(stroke=(-0.14, 0.4))} - {p.name for p in places()}
    assert len(both) == 3 * (2 + 3)
    assert all(name.endswith("/waves") for name in both)
