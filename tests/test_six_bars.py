"""Six bars against Pinocchio's closure: every layout, many machines, any batch, any size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orthoglide.errors import ClosureError, InputError, OrthoglideError
from orthoglide.geometry import Array, Geometry
from orthoglide.layout import LinearDelta
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.mechanism.compiled import compiler
from orthoglide.mechanism.engine import PinocchioEngine, SixBars
from orthoglide.mechanism.perfect_legs import commands as commands_of
from orthoglide.mechanism.six_bars import LINES, OUTPUT_SIZE, ROTATION
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from tests.engines import (
    NOMINAL,
    OTHER,
    commands,
    displacements,
    edited,
    forward,
    given,
    mechanism,
    six_bars,
)
from tests.test_layout import UNEVEN, freely

WIDE = Geometry(0.36, 0.05, 0.033, (-0.2, 0.4), LinearDelta((0.174,) * 3, tool=(0, 0, -0.04)))
"""A delta on which elimination without pivoting loses digits toward the rim of its plate."""
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
MACHINES = {
    "Orthoglide": NOMINAL,
    "another Orthoglide": OTHER,
    "wide delta": WIDE,
    "uneven delta": UNEVEN,
    "free legs of an Orthoglide": freely(NOMINAL, turn=TURN),
    "free legs of a delta": freely(UNEVEN, turn=TURN),
}
EVERY = pytest.mark.parametrize("geometry", MACHINES.values(), ids=MACHINES)
RIM = 0.15


def postures(geometry: Geometry, n: int, seed: int, size: float = 1e-3) -> tuple[Array, Array]:
    """Travel ``(n, 3)`` within the stroke, of deltas out to the rim, and displacements ``(n, 30)``.

    Every second posture of a delta stands at the rim itself.
    """
    moves = displacements(n, seed, size)
    if not geometry.layout.hanging:
        return given(commands(n, seed, geometry), moves, geometry)
    draws = np.random.default_rng(seed)
    radius = RIM * np.where(np.arange(n) % 2, 1.0, np.sqrt(draws.random(n)))
    angle, height = draws.uniform(0, 2 * np.pi, n), draws.uniform(0, 0.15, n)
    p = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    if geometry.layout.kind == "legs":
        p = p @ TURN.T
    return given(commands_of(mechanism(geometry).spheres, p), moves, geometry)


def judge(geometry: Geometry) -> PinocchioEngine:
    return PinocchioEngine(mechanism(geometry))


# -- against Pinocchio -----------------------------------------------------------------------


@EVERY
@pytest.mark.parametrize("size", [0.0, 1e-3, 3e-3])
def test_six_bars_are_the_closure_of_pinocchio(geometry: Geometry, size: float) -> None:
    asked = postures(geometry, 25, 1, size)
    shown, by_given = six_bars(geometry).tangent(*asked)
    expected, expected_by_given = judge(geometry).tangent(*asked)
    assert np.abs(shown.values - expected.values).max() < 1e-13
    assert np.abs(by_given - expected_by_given).max() < 1e-11
    assert (np.abs(shown.R - np.eye(3)).max() > 1e-3) == (size > 0)


@pytest.mark.parametrize("geometry", [NOMINAL, WIDE], ids=["Orthoglide", "wide delta"])
@pytest.mark.parametrize("size", [0.0, 3e-3])
def test_sensitivities_are_central_differences(geometry: Geometry, size: float) -> None:
    known, h = np.hstack(postures(geometry, 4, 2, size)), 5e-5
    engine = six_bars(geometry)
    _, by_given = engine.tangent(known[:, :3], known[:, 3:])
    assert by_given.shape == (4, OUTPUT_SIZE, 33)

    def values(change: Array) -> Array:
        moved = known + change
        return engine.outputs(moved[:, :3], moved[:, 3:]).values

    numeric = np.stack(
        [(8 * (values(e) - values(-e)) - (values(2 * e) - values(-2 * e))) / (12 * h)
         for e in h * np.eye(33)], axis=-1,
    )  # fmt: skip
    assert np.abs(numeric - by_given).max() < 1e-9 * np.abs(by_given).max()


@EVERY
def test_outputs_hold_a_rotation_and_bars_of_their_lengths(geometry: Geometry) -> None:
    travel, moves = postures(geometry, 50, 3, 3e-3)
    out = six_bars(geometry).outputs(travel, moves)
    assert np.abs(out.R @ np.swapaxes(out.R, -1, -2) - np.eye(3)).max() < 1e-14
    assert np.array_equal(out.R.reshape(-1, 9), out.values[:, ROTATION])
    assert np.array_equal(out.lines.reshape(-1, 36), out.values[:, LINES])
    by_name = dict(zip(VIRTUAL_NAMES, np.moveaxis(moves.reshape(-1, 3, 10), 2, 0), strict=True))
    length = np.linalg.norm(out.lines[..., 1, :] - out.lines[..., 0, :], axis=-1)
    stretch = np.stack([by_name["stretch1"], by_name["stretch2"]], axis=-1)
    assert np.abs(length - geometry.L - stretch).max() < 3e-15
    links = np.linalg.norm(out.lines[:, :, 0] - out.lines[:, :, 1], axis=-1)
    assert np.abs(links[..., 0] - geometry.d).max() < 1e-15
    wide = geometry.d + by_name["width1"] + by_name["width2"]
    assert np.abs(links[..., 1] - wide).max() < 1e-15


# -- many machines, and machines of any size -------------------------------------------------


@pytest.mark.parametrize("stroke", [1e-3, 1.0], ids="{:g} m".format)
@pytest.mark.parametrize("like", [NOMINAL, WIDE], ids=["Orthoglide", "wide delta"])
def test_machines_of_any_size_close_alike(like: Geometry, stroke: float) -> None:
    """A machine so many times as large, its errors too, stands so many times as far."""
    times = stroke / (like.stroke[1] - like.stroke[0])
    layout = like.layout
    if isinstance(layout, LinearDelta):
        layout = replace(
            layout,
            radius=tuple(times * r for r in layout.radius),
            tool=tuple(times * t for t in layout.tool),
        )
    sizes = (times * like.L, times * like.d, times * like.r)
    geometry = Geometry(*sizes, (times * like.stroke[0], times * like.stroke[1]), layout)
    travel, moves = postures(like, 15, 7, 1e-3)
    turns = np.tile([0, 0, 0, 1, 1, 1, 0, 0, 0, 0], 3)
    scaled = travel * times, moves * np.where(turns, 1.0, times)
    found, by_given = six_bars(geometry).tangent(*scaled)
    expected, expected_by_given = judge(geometry).tangent(*scaled)
    # Pinocchio's residual, which may be 1e-11 m at the end, is at rounding after its last step.
    assert np.abs(found.values - expected.values).max() < 1e-13 * max(1.0, times)
    scale = np.abs(expected_by_given).max()
    assert np.abs(by_given - expected_by_given).max() < 1e-11 * max(1.0, scale)
    assert np.abs(found.p / times - six_bars(like).outputs(travel, moves).p).max() < 1e-12
    machine = Machine(MachineFile(geometry=geometry))
    p = machine.forward(geometry.zero + scaled[0])
    assert np.abs(machine.inverse(p) - geometry.zero - scaled[0]).max() < 1e-12 * max(1.0, times)


# -- batches and compiled code ---------------------------------------------------------------


def test_order_and_size_of_a_batch_do_not_matter() -> None:
    travel, moves = postures(NOMINAL, 600, 8, 3e-3)
    engine = six_bars()
    together, slopes = engine.tangent(travel, moves)
    turned, turned_slopes = engine.tangent(travel[::-1], moves[::-1])
    assert np.array_equal(together.values, turned.values[::-1])
    assert np.array_equal(slopes, turned_slopes[::-1])
    for k in (0, 255, 256, 599):
        one, slope = engine.tangent(travel[k : k + 1], moves[k : k + 1])
        assert np.array_equal(one.values[0], together.values[k])
        assert np.array_equal(slope[0], slopes[k])
    assert forward(np.empty((0, 3))).shape == (0, 3)
    assert engine.tangent(travel[:0], moves[:0])[1].shape == (0, OUTPUT_SIZE, 33)


@cache
def compiled() -> SixBars:
    if compiler() is None:
        pytest.skip("no C compiler here")
    found = SixBars(mechanism(), compile=True)
    assert found.compiled
    return found


@pytest.mark.parametrize("geometry", [NOMINAL, WIDE], ids=["Orthoglide", "wide delta"])
def test_compiled_code_gives_the_same_bits(geometry: Geometry) -> None:
    """One library serves every machine."""
    compiled()
    fast, slow = SixBars(mechanism(geometry)), six_bars(geometry)
    assert fast.compiled
    assert not slow.compiled
    travel, moves = postures(geometry, 301, 11, 3e-3)
    shown, by_given = fast.tangent(travel, moves)
    expected, expected_by_given = slow.tangent(travel, moves)
    assert np.array_equal(shown.values, expected.values)
    assert np.array_equal(by_given, expected_by_given)


def test_without_a_compiler_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORTHOGLIDE_COMPILE", "0")
    plain = SixBars(mechanism(), compile=True)
    assert not plain.compiled
    asked = postures(NOMINAL, 10, 12)
    assert np.array_equal(plain.outputs(*asked).values, six_bars().outputs(*asked).values)


def test_compiled_postures_that_do_not_close_are_named_as_interpreted() -> None:
    travel, moves = postures(NOMINAL, 40, 13)
    travel[[13, 29], 0] += 1.0  # a carriage a metre away
    told = []
    for engine in (compiled(), six_bars(), judge(NOMINAL)):
        with pytest.raises(ClosureError, match=r"^posture 14 of 40: the loops do not") as caught:
            engine.outputs(travel, moves)
        told.append((str(caught.value), caught.value.index, caught.value.residuals))
    assert told[0] == told[1] == told[2]
    assert told[0][1] == (13,)


# -- where it must refuse --------------------------------------------------------------------

SPOILT: dict[str, Callable[[Array, Array], None]] = {
    "travel of no number": lambda travel, moves: travel.__setitem__((2, 1), np.nan),
    "endless travel": lambda travel, moves: travel.__setitem__((2, 0), np.inf),
    "a turn of no number": lambda travel, moves: moves.__setitem__((2, 4), np.nan),
    "an endless bar": lambda travel, moves: moves.__setitem__((2, 6), np.inf),
    "a bar of 1e200 m": lambda travel, moves: moves.__setitem__((2, 7), 1e200),
    "travel of 1e200 m": lambda travel, moves: travel.__setitem__((2, 2), 1e200),
    "out of reach": lambda travel, moves: travel.__setitem__((2, 2), 0.6),
    "a bar of no length": lambda travel, moves: moves.__setitem__((2, slice(6, 8)), -NOMINAL.L),
}


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
def test_nothing_comes_back_that_is_not_closed(spoil: Callable[[Array, Array], None]) -> None:
    travel, moves = postures(NOMINAL, 5, 14)
    spoil(travel, moves)
    for ask in (six_bars().outputs, six_bars().tangent, judge(NOMINAL).outputs):
        with pytest.raises(OrthoglideError):
            ask(travel, moves)


@pytest.mark.parametrize("shapes", [((2, 3), (2, 29)), ((2, 2), (2, 30)), ((2, 3), (1, 30))])
def test_misshaped_arrays_are_refused(shapes: tuple[tuple[int, ...], ...]) -> None:
    for ask in (six_bars().outputs, six_bars().tangent):
        with pytest.raises(InputError, match=r"\(n, 3\) .* \(n, 30\)"):
            ask(*map(np.zeros, shapes))


@pytest.mark.parametrize(
    ("joint", "origin"),
    [
        ("y_bar1", "0.001 0 0.04"),
        ("y_bar2", "0 0.002 -0.04"),
        ("y_platform", "0.001 0 -0.04"),
        ("y_knuckle_tip_fixed", "0 0.001 -0.08"),
    ],
)
def test_pivots_that_do_not_meet_are_no_ball_joints(
    joint: str, origin: str, tmp_path: Path
) -> None:
    """Pinocchio closes such a machine; as six bars it would be another."""
    folder = edited(tmp_path, joint, origin)
    with pytest.raises(InputError, match=r"^leg y: the .* of a bar changes by \S+ mm as the leg's"):
        Machine.from_urdf(folder)
