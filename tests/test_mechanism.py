"""The mechanism as Pinocchio closes it: against the reduction, itself, and where it refuses."""

import pickle
import re
from itertools import product

import numpy as np
import pytest

from orthoglide import reduction
from orthoglide.effects import CATALOGUE
from orthoglide.errors import ClosureError, InputError, UnreachableError
from orthoglide.geometry import Array, Geometry
from orthoglide.machine import Machine
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from tests.engines import (
    NOMINAL,
    OTHER,
    commands,
    displacements,
    forward,
    given,
    mechanism,
    six_bars,
)

CORNERS = np.array(list(product(NOMINAL.stroke, repeat=3))) + NOMINAL.L
MACHINE = Machine.nominal()


def only(**values: float | tuple[float, float, float]) -> Array:
    """Displacements ``(3, 10)`` of the named virtual joints, alike or one value a leg."""
    moves = np.zeros((3, len(VIRTUAL_NAMES)))
    for name, value in values.items():
        moves[:, VIRTUAL_NAMES.index(name)] = value
    return moves


# -- against the reduction -------------------------------------------------------------------


@pytest.mark.parametrize("geometry", [NOMINAL, OTHER], ids=["nominal", "other"])
def test_closed_tcp_equals_the_quadratic(geometry: Geometry) -> None:
    rho = commands(1000, geometry=geometry)
    expected = reduction.forward(rho, geometry=geometry)
    assert np.abs(forward(rho, geometry=geometry) - expected).max() < 1e-12
    single = np.array([mechanism(geometry).close(r).p for r in rho[:300]])
    assert np.abs(single - expected[:300]).max() < 1e-12


def test_inverse_undoes_forward_with_everything_displaced() -> None:
    rng = np.random.default_rng(2)
    machine = MACHINE.with_parameters(
        {name: 3 * MACHINE.tolerance(name) * rng.standard_normal()
         for name in CATALOGUE.parameters if "screw_error" not in name}
    )  # fmt: skip
    rho = commands(100, 2)
    seen = {"approach": rng.choice([-1.0, 0.0, 1.0], (100, 3)), "time": 600.0, "warming": 3.0}
    seen |= {"load": 50.0}
    p = machine.forward(rho, **seen)
    assert np.abs(p - reduction.forward(rho)).max() > 1e-3
    assert np.abs(machine.inverse(p, **seen) - rho).max() < 1e-12


def test_other_assembly_mode_equals_the_other_root() -> None:
    rho = commands(100, 3)
    for r, p in zip(rho, reduction.forward(rho, mode="other"), strict=True):
        posture = mechanism().close(r, mode="other")
        assert np.abs(posture.p - p).max() < 1e-12
        assert np.abs(posture.R - np.eye(3)).max() < 1e-12


def test_a_guess_in_the_other_assembly_mode_is_no_posture() -> None:
    for rho in commands(5, 28):
        other = mechanism().close(rho, mode="other")
        with pytest.raises(ClosureError, match="in the other assembly mode, not in the machine"):
            mechanism().close(rho, guess=other)


def test_velocity_jacobian_equals_eq_5() -> None:
    rho = np.concatenate([commands(100, 6), CORNERS])
    expected = reduction.jacobians(reduction.forward(rho), rho).rho
    for r, wanted in zip(rho, expected, strict=True):
        own = mechanism().velocity_jacobian(mechanism().close(r))
        assert np.abs(own - wanted).max() < 1e-9
    _, by_given = six_bars().tangent(*given(rho))
    assert np.abs(by_given[:, :3, :3] - expected).max() < 1e-9
    assert np.abs(MACHINE.jacobian(rho) - expected).max() < 1e-9


# -- mobility, rigid and relieved legs -------------------------------------------------------


def test_mobility_is_three_everywhere_in_the_stroke() -> None:
    for rho in np.concatenate([NOMINAL.zero[None], CORNERS, commands(100, 12)]):
        found = mechanism().mobility(rho)
        assert (found.joints, found.rows, found.rank) == (18, 21, 15)
        assert (found.mobility, found.redundant) == (3, 6)
        assert [found.by_loop[f"{leg}_parallelogram"] for leg in "xyz"] == [2, 2, 2]
        assert [found.by_loop["platform_xy"], found.by_loop["platform_xz"]] == [6, 6]
    assert "mobility 3, 6 redundant rows" in str(found)


CONSISTENT = {
    "nominal": only(),
    "travel": only(travel=(1e-3, -2e-3, 3e-3)),
    "path": only(lateral_b=(1e-3, -2e-3, 3e-3), lateral_c=(-3e-3, 1e-3, 2e-3)),
    "bars": only(stretch1=(1e-3, -2e-3, 3e-3), stretch2=(1e-3, -2e-3, 3e-3)),
    "hinge": only(turn_c=(1e-2, -2e-2, 3e-2)),
}


@pytest.mark.parametrize("moves", CONSISTENT.values(), ids=CONSISTENT)
def test_relieved_equals_rigid_where_the_parts_fit(moves: Array) -> None:
    for rho in np.concatenate([CORNERS, commands(20, 14)]):
        relieved, rigid = (mechanism().close(rho, moves, legs=k) for k in ("relieved", "rigid"))
        assert np.abs(relieved.p - rigid.p).max() < 1e-14
        assert np.abs(relieved.R - rigid.R).max() < 1e-14
        assert np.abs(relieved.q[mechanism().tree.relief]).max() < 1e-13


INCONSISTENT = {
    "bar_mismatch": only(stretch1=(5e-5, 0, 0), stretch2=(-5e-5, 0, 0)),
    "mount_tilt.a": only(turn_a=(0, 2e-3, 0)),
    "mount_tilt.b": only(turn_b=(0, 0, 2e-3)),
    "parallelogram_width": only(width1=(5e-5, 0, 0), width2=(5e-5, 0, 0)),
}


@pytest.mark.parametrize("moves", INCONSISTENT.values(), ids=INCONSISTENT)
def test_rigid_legs_refuse_parts_that_do_not_fit(moves: Array) -> None:
    rho = NOMINAL.L + np.array([0.03, -0.06, 0.02])
    with pytest.raises(ClosureError, match="rigid PRPaR legs cannot take up") as caught:
        mechanism().close(rho, moves, legs="rigid")
    residuals = caught.value.residuals
    assert list(residuals) == [loop.name for loop in mechanism().tree.loops]
    assert 1e-9 < max(residuals.values()) < 1e-2
    relieved = mechanism().close(rho, moves)
    assert max(relieved.residual.values()) < 1e-11
    assert np.abs(relieved.q[mechanism().tree.relief]).max() > 1e-6


# -- refusals --------------------------------------------------------------------------------


def test_a_command_out_of_reach_is_an_error_and_no_pose() -> None:
    for far in ([0.7, 0.7, 0.7], [1.2, 0.31, 0.31], [1.5, 1.5, 1.5]):
        for legs in ("relieved", "rigid"):
            with pytest.raises(ClosureError, match="do not close") as caught:
                mechanism().close(far, legs=legs)
            assert max(caught.value.residuals.values()) > 1e-3
        for close in (MACHINE.forward, MACHINE.close, MACHINE.jacobian):
            with pytest.raises(ClosureError, match="do not close"):
                close(far)
        with pytest.raises(ClosureError):
            mechanism().close(far, mode="other")


def test_far_commands_close_on_the_right_pose_or_not_at_all() -> None:
    closed, refused = right_or_refused(np.random.default_rng(24).uniform(0.02, 1.0, (300, 3)))
    assert closed > 50
    assert refused > 50


def right_or_refused(rho: Array) -> tuple[int, int]:
    """How often commands ``(n, 3)`` close, always on the right pose, and how often they do not."""
    closed = refused = 0
    for r in rho:
        for close in (lambda c: mechanism().close(c).p, MACHINE.forward):
            try:
                p = close(r)
            except ClosureError:
                refused += 1
                continue
            closed += 1
            assert np.abs(p - reduction.forward(r)).max() < 1e-7
    return closed, refused


@pytest.mark.parametrize("command", [[0, 0, 0], [0.06, -0.1, 0.0]])
def test_where_the_assembly_modes_meet_is_no_pose(command: list[float]) -> None:
    """Travel in place of commands: all carriages at the origin, or one of them."""
    for ask in (MACHINE.forward, MACHINE.jacobian):
        with pytest.raises(ClosureError, match=r"at mechanical zero every command is 0\.31025 m"):
            ask(command)
    with pytest.raises(ClosureError):
        mechanism().close(command)


def test_points_beyond_the_carriages_are_said_to_be_there() -> None:
    with pytest.raises(
        UnreachableError, match=r"^point 2: .* 157\.331 mm beyond their plane"
    ) as on:
        MACHINE.inverse([[0.0, 0.0, 0.0], [0.2, 0.2, 0.2]])
    assert on.value.index == (1,)
    assert on.value.excess == pytest.approx(0.157331, abs=1e-6)


def test_a_batch_names_the_posture_that_fails() -> None:
    """In words by its number and its worst loop; in numbers by its place in the batch."""
    rho = commands(6, 26)
    rho[4] = 0.7
    said = r"^posture 5 of 6: the loops do not close.* misfit is (\S+) mm or mrad at (\w+)"
    for machine in (MACHINE, MACHINE.by_pinocchio()):
        with pytest.raises(ClosureError, match=said) as caught:
            machine.forward(rho)
        residuals = caught.value.residuals
        assert caught.value.index == (4,)
        assert set(residuals) == {loop.name for loop in mechanism().tree.loops}
        told = re.search(said, str(caught.value))
        assert told is not None
        assert residuals[told[2]] == max(residuals.values()) > 0.05
        assert float(told[1]) == pytest.approx(residuals[told[2]] * 1e3, rel=0.02)
    with pytest.raises(ClosureError) as caught:
        MACHINE.forward(rho.reshape(2, 3, 3))
    assert caught.value.index == (1, 1)
    with pytest.raises(ClosureError, match=r"^the loops do not close") as caught:
        MACHINE.forward(rho[4])
    assert caught.value.index == ()


def test_inverse_names_the_leg_that_is_too_short() -> None:
    p = np.zeros((2, 3, 3))
    p[1, 2] = [0.0, 0.3, 0.2]
    with pytest.raises(UnreachableError, match=r"leg x is 50\.305 mm too short") as caught:
        MACHINE.inverse(p)
    assert caught.value.leg == "x"
    assert caught.value.excess == pytest.approx(np.hypot(0.3, 0.2) - NOMINAL.L)
    assert caught.value.index == (1, 2)
    with pytest.raises(UnreachableError, match=r"^point 2: leg y is") as caught:
        MACHINE.inverse([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    assert caught.value.index == (1,)
    with pytest.raises(UnreachableError, match=r"^leg y is"):
        MACHINE.inverse([0.5, 0.0, 0.0])


def test_bad_arguments_are_refused() -> None:
    own = mechanism()
    with pytest.raises(InputError, match="finite"):
        own.close([0.3, 0.3, np.nan])
    with pytest.raises(InputError, match="one command"):
        own.close(np.full((2, 3), 0.3))
    for wrong in (np.zeros((3, 9)), np.full((3, 10), np.nan)):
        with pytest.raises(InputError, match="displacements"):
            own.close(NOMINAL.zero, wrong)
    for wrong in (np.nan, [0.3, 0.3], [0.3, np.inf, 0.3]):
        with pytest.raises(InputError, match=r"shape \(\.\.\., 3\)"):
            MACHINE.forward(wrong)
    with pytest.raises(InputError, match="finite"):
        MACHINE.inverse([0.0, np.inf, 0.0])


# -- pickling --------------------------------------------------------------------------------


def test_pickling_gives_the_same_mechanism() -> None:
    own = Mechanism(OTHER)
    rho, moves = commands(5, 27, OTHER), displacements(5, 27)
    postures = [own.close(r, m) for r, m in zip(rho, moves, strict=True)]
    again, same = pickle.loads(pickle.dumps((own, postures)))
    assert again.geometry == OTHER
    for r, m, posture, other in zip(rho, moves, postures, same, strict=True):
        assert np.array_equal(other.q, posture.q)
        assert np.array_equal(again.close(r, m).q, posture.q)
        assert np.abs(again.close(r, m, guess=other).p - posture.p).max() < 1e-14
