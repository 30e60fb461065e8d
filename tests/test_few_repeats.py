"""Instruments of the tool whose noise is known from a few repeats only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from benchmarks.delta_readings import measured
from orthoglide.fit import assemble, solve
from orthoglide.observations import Readings
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_checking import delta

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
