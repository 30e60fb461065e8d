"""What every instrument owes, run over all of them: gradient, nuisances, places, and no other name.

A new file under `orthoglide/instruments` is taken up by itself.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orthoglide.instruments import INSTRUMENTS, Instrument, Mounting, Pose

PACKAGE = Path(__file__).parents[1] / "orthoglide"
COUNT = 12

# Where files of the command line, parts of a drawing or groups of effects have the same word.
OTHER_MEANINGS = {
    "effects/effect.py", "effects/page.py", "effects/plates.py", "pictures.py", "report/page.py",
    "report/result_json.py", "report/tables.py", "request/reading.py", "request/request.py",
    "scene/marks.py", "scene/parts.py", "klipper/calibration.py",
}  # fmt: skip

every = pytest.mark.parametrize("one", INSTRUMENTS.values(), ids=lambda one: one.kind)


def drawn(one: Instrument, seed: int = 3) -> tuple[Pose, Mounting]:
    """Poses and mountings at random."""
    rng = np.random.default_rng(seed)
    p, apart = rng.normal(scale=0.1, size=(2, COUNT, 3))
    R = Rotation.from_rotvec(rng.normal(scale=1e-3, size=(COUNT, 3))).as_matrix()
    axis = np.array([one.axes[k % len(one.axes)] if one.axes else 0 for k in range(COUNT)])
    ball = np.tile(rng.normal(scale=0.1, size=3), (COUNT, 1))
    turn = np.tile(Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), (COUNT, 1, 1))
    return Pose(p, R, apart), Mounting(axis, rng.choice([-1.0, 1.0], COUNT), ball, turn)


@every
def test_the_gradient_is_the_derivative_of_the_value(one: Instrument) -> None:
    pose, mounting = drawn(one)
    found, step = one.gradient(pose, mounting), 1e-6
    assert found
    for what in ("p", "R", "apart"):
        start = getattr(pose, what)
        slope = found.get(what, np.zeros_like(start)).reshape(COUNT, -1)  # type: ignore[call-overload]
        for k in range(slope.shape[1]):
            sides = []
            for way in (step, -step):
                moved = start.reshape(COUNT, -1).copy()
                moved[:, k] += way
                there = Pose(**{"p": pose.p, "R": pose.R, "apart": pose.apart,
                                what: moved.reshape(start.shape)})  # fmt: skip
                sides.append(one.value(there, mounting))
            np.testing.assert_allclose((sides[0] - sides[1]) / (2 * step), slope[:, k], atol=1e-8)


@every
def test_what_an_instrument_shows_out_of_its_place_its_nuisances_say(one: Instrument) -> None:
    pose, mounting = drawn(one)
    value = one.value(pose, mounting)
    columns = np.column_stack([column for column, _ in one.nuisances(pose.p, value, mounting)])
    assert len(columns) == COUNT
    small, left = 1e-5, []
    for sd in (small, small / 2):
        shown = one.displaced(pose.p, mounting, np.random.default_rng(5), sd)
        if shown is None:
            return
        rest = shown - value
        assert np.abs(rest).max() > sd / 10
        rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=1e-9)[0]
        left.append(np.abs(rest).max())
    assert left[0] < 20 * small**2 / 0.01  # what is left is of the second order
    assert left[1] < left[0] / 3


LINEAR = {
    # what a setup shows besides the machine, of places, readings and axes, by hand
    "plate": lambda p, value, axis: 3e-4 + 2e-3 * p[:, 0] - 1e-3 * p[:, 1],
    "distance": lambda p, value, axis: 0.004 * value - 1e-4,
    "incline": lambda p, value, axis: np.array([2e-4, -3e-4, 0.0])[axis],
}


@every
def test_nuisances_span_what_a_setup_shows_besides_the_machine(one: Instrument) -> None:
    """Where an instrument says itself what it shows out of its place, the test above holds it."""
    pose, mounting = drawn(one)
    mounting = replace(mounting, sign=np.ones(COUNT))
    moved = one.displaced(pose.p, mounting, np.random.default_rng(5), 1e-5)
    assert (moved is None) is (one.kind in LINEAR)
    if moved is not None:
        return
    value = one.value(pose, mounting)
    shown = LINEAR[one.kind](pose.p, value, mounting.axis)
    columns = np.column_stack([column for column, _ in one.nuisances(pose.p, value, mounting)])
    rest = shown - columns @ np.linalg.lstsq(columns, shown, rcond=1e-9)[0]
    assert np.abs(rest).max() < 1e-12
    assert np.linalg.matrix_rank(columns, tol=1e-9) < COUNT  # and not just anything


@every
def test_counting_the_other_way_turns_the_sign(one: Instrument) -> None:
    pose, mounting = drawn(one)
    other = replace(mounting, sign=-mounting.sign)
    factor = -1.0 if one.axes else 1.0
    np.testing.assert_array_equal(one.value(pose, other), factor * one.value(pose, mounting))


@every
def test_a_sheet_stays_within_its_circle(one: Instrument) -> None:
    t = np.arange(12) * np.pi / 6
    points, others = one.places(np.stack([np.cos(t), np.sin(t), 0 * t], axis=1))
    assert (others is not None) is one.paired
    for places in (points, *([] if others is None else [others])):
        assert np.linalg.norm(places, axis=1).max() == pytest.approx(1.0)


@every
def test_an_instrument_is_declared_whole(one: Instrument) -> None:
    assert "" not in (one.words, one.reads)
    assert one.unit in ("mm", "mrad")
    assert ("{}" in one.reads) is bool(one.axes)
    assert 0 < 10 * one.repeatability < one.slip_alone <= one.slip


def test_nobody_else_knows_an_instrument_by_name() -> None:
    found = {
        str(path.relative_to(PACKAGE))
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.parent != PACKAGE / "instruments"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in INSTRUMENTS
    }
    assert not found - OTHER_MEANINGS
    assert not OTHER_MEANINGS - found
