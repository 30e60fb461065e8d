"""The closed mechanism: against the reduction, against itself, and where it must refuse."""

import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from orthoglide import reduction
from orthoglide.errors import ClosureError, InputError, UnreachableError
from orthoglide.geometry import Array, Geometry
from orthoglide.machine import Machine
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.batch import BatchClosure
from orthoglide.mechanism.functions import LINES, OUTPUTS, ROTATION, TCP
from orthoglide.mechanism.loops import Loops
from orthoglide.mechanism.seed import Mode
from orthoglide.mechanism.tree import RELIEF_NAMES, VIRTUAL_NAMES, Tree, general_tree, nominal_tree
from orthoglide.urdf import Closure
from tests.rig import _solve, rotation

NOMINAL = Geometry()
OTHER = Geometry(L=0.5, d=0.11, r=0.047, stroke=(-0.12, 0.08))
CORNERS = np.array(list(product(NOMINAL.stroke, repeat=3))) + NOMINAL.L
TREES = pytest.mark.parametrize("build", [nominal_tree, general_tree], ids=["nominal", "general"])


@cache
def mechanism(geometry: Geometry = NOMINAL) -> Mechanism:
    return Mechanism(geometry, compile=False)


def commands(n: int, seed: int = 0, geometry: Geometry = NOMINAL) -> Array:
    """Random commands of the stroke ``(n, 3)``."""
    return geometry.L + np.random.default_rng(seed).uniform(*geometry.stroke, (n, 3))


def displacements(n: int, seed: int = 0, size: float = 3e-3) -> Array:
    """All virtual joints displaced ``(n, 3, 10)``, metres and radians."""
    return size * np.random.default_rng(seed).standard_normal((n, 3, len(VIRTUAL_NAMES)))


def only(**values: float | tuple[float, float, float]) -> Array:
    """Displacements ``(3, 10)`` of the named virtual joints, alike or one value a leg."""
    moves = np.zeros((3, len(VIRTUAL_NAMES)))
    for name, value in values.items():
        moves[:, VIRTUAL_NAMES.index(name)] = value
    return moves


def six_bars(rho: Array, moves: Array, geometry: Geometry = NOMINAL) -> tuple[Array, Array]:
    """TCP and rotation of a rigid platform on six bars, displaced as the virtual joints say."""
    n, half = len(rho), geometry.d / 2
    travel, lateral_b, lateral_c, turn_a, turn_b, turn_c, *bars = np.moveaxis(moves, -1, 0)
    stretch1, stretch2, width1, width2 = bars
    A, b = np.empty((n, 3, 2, 3)), np.empty((n, 3, 2, 3))
    for leg in range(3):
        axes = np.roll(np.eye(3), -leg, axis=0)  # rows a, b, c
        along = np.stack(
            [geometry.L + geometry.r + rho[:, leg] - geometry.L + travel[:, leg],
             lateral_b[:, leg], lateral_c[:, leg]], axis=-1,
        )  # fmt: skip
        turn = np.eye(3)
        for axis, angle in zip(axes, (turn_a, turn_b, turn_c), strict=True):
            turn = turn @ rotation(angle[:, leg, None] * axis)
        link = turn @ axes[2] * half
        A[:, leg] = np.stack([along @ axes + link, along @ axes - link], axis=1)
        b[:, leg, 0] = geometry.r * axes[0] + (half + width1[:, leg, None]) * axes[2]
        b[:, leg, 1] = geometry.r * axes[0] - (half + width2[:, leg, None]) * axes[2]
    length = geometry.L + np.stack([stretch1, stretch2], axis=-1)
    return _solve(A.reshape(n, 6, 3), b.reshape(n, 6, 3), length.reshape(n, 6), rho - geometry.L)


# -- against the reduction -------------------------------------------------------------------


@pytest.mark.parametrize("geometry", [NOMINAL, OTHER], ids=["nominal", "other"])
def test_closed_tcp_equals_the_quadratic(geometry: Geometry) -> None:
    rho = commands(1000, geometry=geometry)
    expected = reduction.forward(rho, geometry=geometry)
    own = mechanism(geometry)
    assert np.abs(own.forward(rho) - expected).max() < 1e-12
    single = np.array([own.close(r).p for r in rho])
    assert np.abs(single - expected).max() < 1e-12
    general = own.forward(rho, np.zeros((3, 10)))
    assert np.abs(general - expected).max() < 1e-12


def test_inverse_equals_eq_3() -> None:
    p = reduction.forward(commands(1000, 1))
    expected = reduction.inverse(p)
    assert np.abs(mechanism().inverse(p) - expected).max() < 1e-12
    general = mechanism().inverse(p[:100], np.zeros((3, 10)))
    assert np.abs(general - expected[:100]).max() < 1e-12


def test_inverse_undoes_forward_with_everything_displaced() -> None:
    rho, moves = commands(100, 2), displacements(100, 2)
    p = mechanism().forward(rho, moves)
    assert np.abs(p - reduction.forward(rho)).max() > 1e-3
    assert np.abs(mechanism().inverse(p, moves) - rho).max() < 1e-12


def test_other_assembly_mode_equals_the_other_root() -> None:
    rho = commands(1000, 3)
    expected = reduction.forward(rho, mode="other")
    assert np.abs(mechanism().forward(rho, mode="other") - expected).max() < 1e-12
    for r, p in zip(rho[:40], expected[:40], strict=True):
        posture = mechanism().close(r, mode="other")
        assert np.abs(posture.p - p).max() < 1e-12
        assert np.abs(posture.R - np.eye(3)).max() < 1e-12


def test_other_assembly_mode_with_errors_is_another_pose_of_the_same_bars() -> None:
    rho, moves = commands(20, 4), displacements(20, 4, 1e-3)
    other = mechanism().forward(rho, moves, mode="other")
    assert np.abs(other - reduction.forward(rho, mode="other")).max() < 0.05
    for r, m, p in zip(rho, moves, other, strict=True):
        posture = mechanism().close(r, m, mode="other")
        assert np.abs(posture.p - p).max() < 1e-11


def test_platform_does_not_turn_while_nothing_is_displaced() -> None:
    rho = commands(200, 5)
    batch = mechanism().nominal_batch
    given = mechanism().given(rho)[:, :3]
    R = batch.outputs(batch.close(given), given).R
    assert np.abs(R - np.eye(3)).max() < 1e-12


def test_velocity_jacobian_equals_eq_5() -> None:
    rho = np.concatenate([commands(100, 6), CORNERS])
    p = reduction.forward(rho)
    for r, expected in zip(rho, reduction.jacobians(p, rho).rho, strict=True):
        own = mechanism().velocity_jacobian(mechanism().close(r))
        assert np.abs(own - expected).max() < 1e-9
    batch = mechanism().nominal_batch
    given = mechanism().given(rho)[:, :3]
    _, by_given = batch.tangent(batch.close(given), given)
    assert np.abs(by_given[:, TCP] - reduction.jacobians(p, rho).rho).max() < 1e-9


# -- the constraint Jacobian -----------------------------------------------------------------


@TREES
def test_constraint_jacobian_equals_central_differences(build: Callable[[Geometry], Tree]) -> None:
    tree = build(NOMINAL)
    loops, h = Loops(tree), 1e-6
    rng = np.random.default_rng(7)
    for _ in range(10):
        q = 0.4 * rng.standard_normal(tree.model.nq)
        q[tree.drive] *= 0.1
        assert np.abs(loops.update(q)).max() > 0.05  # far from closed
        numeric = np.column_stack(
            [(loops.update(q + h * e) - loops.update(q - h * e)) / (2 * h) for e in np.eye(len(q))]
        )
        assert np.abs(loops.jacobian(q) - numeric).max() < 1e-7


@TREES
def test_newton_matrix_is_the_jacobian_where_the_loops_are_closed(
    build: Callable[[Geometry], Tree],
) -> None:
    tree = build(NOMINAL)
    loops = Loops(tree)
    batch = BatchClosure(tree, compile=False)
    for r in commands(10, 8):
        given = np.concatenate([r - NOMINAL.L, np.zeros(len(tree.virtual))])
        q = np.zeros(tree.model.nq)
        q[tree.drive] = given[:3]
        q[tree.free] = batch.close(given[None])[0]
        exact = loops.jacobian(q)
        assert np.abs(loops.update(q)).max() < 1e-11
        assert np.abs(loops.newton_matrix() - exact).max() < 1e-9


def test_symbolic_residual_vanishes_where_pinocchios_does() -> None:
    own, rho, moves = mechanism(), commands(50, 9), displacements(50, 9)
    given = own.given(rho, moves)
    for x, g in zip(own.batch.close(given), given, strict=True):
        q = np.zeros(own.tree.model.nq)
        q[own.tree.free], q[own.tree.drive], q[own.tree.virtual] = x, g[:3], g[3:]
        assert np.abs(own.loops.update(q)).max() < 1e-12


@pytest.mark.parametrize("displaced", [0.0, 3e-3], ids=["nominal", "displaced"])
def test_tangent_of_the_batch_equals_central_differences(displaced: float) -> None:
    own, n, h = mechanism(), 4, 2e-5
    given = own.given(commands(n, 10), displacements(n, 10, displaced))
    x = own.batch.close(given)
    outputs, by_given = own.batch.tangent(x, given)
    assert np.abs(outputs.values - own.batch.outputs(x, given).values).max() < 1e-15
    assert by_given.shape == (n, OUTPUTS, 33)

    def at(change: Array) -> Array:
        moved = given + change
        return own.batch.outputs(own.batch.close(moved, x), moved).values

    numeric = np.stack([(at(h * e) - at(-h * e)) / (2 * h) for e in np.eye(33)], axis=-1)
    assert np.abs(numeric - by_given).max() < 1e-6
    # Four points: what is left of the difference goes with h^4.
    wide = np.stack([(at(2 * h * e) - at(-2 * h * e)) / (4 * h) for e in np.eye(33)], axis=-1)
    assert np.abs((4 * numeric - wide) / 3 - by_given).max() < 1e-9


def test_outputs_hold_a_rotation_and_bars_of_their_lengths() -> None:
    own, rho, moves = mechanism(), commands(50, 11), displacements(50, 11)
    given = own.given(rho, moves)
    out = own.batch.outputs(own.batch.close(given), given)
    assert np.abs(out.R @ np.swapaxes(out.R, -1, -2) - np.eye(3)).max() < 1e-13
    assert np.array_equal(out.R.reshape(-1, 9), out.values[:, ROTATION])
    assert np.array_equal(out.lines.reshape(-1, 36), out.values[:, LINES])
    stretch = moves[..., [VIRTUAL_NAMES.index("stretch1"), VIRTUAL_NAMES.index("stretch2")]]
    length = np.linalg.norm(out.lines[..., 1, :] - out.lines[..., 0, :], axis=-1)
    assert np.abs(length - NOMINAL.L - stretch).max() < 1e-12
    carriage = np.linalg.norm(out.lines[:, :, 0, 0] - out.lines[:, :, 1, 0], axis=-1)
    assert np.abs(carriage - NOMINAL.d).max() < 1e-13


# -- mobility, rigid and relieved legs -------------------------------------------------------


def test_mobility_is_three_everywhere_in_the_stroke() -> None:
    for rho in np.concatenate([NOMINAL.zero[None], CORNERS, commands(100, 12)]):
        found = mechanism().mobility(rho)
        assert (found.joints, found.rows, found.rank) == (18, 21, 15)
        assert (found.mobility, found.redundant) == (3, 6)
        assert [found.by_loop[f"{leg}_parallelogram"] for leg in "xyz"] == [2, 2, 2]
        assert [found.by_loop["platform_xy"], found.by_loop["platform_xz"]] == [6, 6]
    assert "mobility 3, 6 times overconstrained" in str(found)


def test_closure_is_well_conditioned_everywhere_in_the_stroke() -> None:
    for rho in np.concatenate([CORNERS, commands(50, 13)]):
        posture = mechanism().close(rho)
        closure = mechanism().loops.jacobian(posture.q)[:, mechanism().tree.free]
        assert np.linalg.cond(closure) < 100
        most, _, least = np.linalg.svd(mechanism().velocity_jacobian(posture), compute_uv=False)
        assert least > 0.1  # else a leg is stretched across its drive, a serial singularity
        assert 1 / most > 0.1  # else the three legs lie in one plane, a parallel singularity
    isotropic = mechanism().velocity_jacobian(mechanism().close(NOMINAL.zero))
    assert np.linalg.cond(isotropic) == pytest.approx(1.0, abs=1e-12)


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


def test_relieved_legs_are_six_bars() -> None:
    rho, moves = commands(200, 15), displacements(200, 15)
    p, R = six_bars(rho, moves)
    given = mechanism().given(rho, moves)
    out = mechanism().batch.outputs(mechanism().batch.close(given), given)
    assert np.abs(out.p - p).max() < 1e-12
    assert np.abs(out.R - R).max() < 1e-11
    assert np.abs(R - np.eye(3)).max() > 1e-2  # the errors do turn the platform


def test_rigid_and_relieved_free_joints_are_the_documented_ones() -> None:
    tree = general_tree(NOMINAL)
    assert len(tree.free) == 21
    assert len(tree.relief) == 3 * len(RELIEF_NAMES)
    places = np.concatenate([tree.drive, tree.free, tree.virtual])
    assert sorted(places) == list(range(tree.model.nq))
    assert len(nominal_tree(NOMINAL).relief) == len(nominal_tree(NOMINAL).virtual) == 0


# -- cold and warm starts --------------------------------------------------------------------


def test_sixty_cold_starts_with_every_virtual_joint_displaced() -> None:
    rho, moves = commands(60, 16), displacements(60, 16, 5e-3)
    p, R = six_bars(rho, moves)
    postures = [mechanism().close(r, m) for r, m in zip(rho, moves, strict=True)]
    assert max(posture.iterations for posture in postures) <= 8
    for posture, point, turn in zip(postures, p, R, strict=True):
        assert max(posture.residual.values()) < 1e-11
        assert np.abs(posture.p - point).max() < 1e-12
        assert np.abs(posture.R - turn).max() < 1e-11


def test_a_warm_start_gives_the_same_pose_in_fewer_steps() -> None:
    rho, moves = commands(30, 17), displacements(30, 17)
    for r, m in zip(rho, moves, strict=True):
        near = mechanism().close(r + 2e-3, m)
        cold, warm = mechanism().close(r, m), mechanism().close(r, m, guess=near)
        assert np.abs(cold.p - warm.p).max() < 1e-13
        assert warm.iterations <= cold.iterations
    assert mechanism().close(r, m, guess=cold).iterations == 1


def test_a_warm_start_does_not_change_its_guess() -> None:
    guess = mechanism().close(NOMINAL.zero)
    before = guess.q.copy()
    mechanism().close(NOMINAL.L + np.array([0.01, 0.02, 0.03]), guess=guess)
    assert np.array_equal(guess.q, before)


def test_order_and_size_of_a_batch_do_not_matter() -> None:
    rho, moves = commands(600, 18), displacements(600, 18)
    together = mechanism().forward(rho, moves)
    turned = mechanism().forward(rho[::-1], moves[::-1])[::-1]
    assert np.abs(together - turned).max() < 1e-14
    one = mechanism().forward(rho[300], moves[300])
    assert one.shape == (3,)
    assert np.abs(one - together[300]).max() < 1e-14
    shaped = mechanism().forward(rho.reshape(20, 30, 3), moves.reshape(20, 30, 3, 10))
    assert np.array_equal(shaped.reshape(-1, 3), together)
    assert mechanism().forward(np.empty((0, 3))).shape == (0, 3)


@cache
def compiled_mechanism() -> Mechanism:
    found = Mechanism(NOMINAL, compile=True)
    if not found.batch.compiled:
        pytest.skip("no C compiler here")
    return found


def test_compiled_equals_not_compiled() -> None:
    fast, slow = compiled_mechanism(), mechanism()
    rho, moves = commands(301, 19), displacements(301, 19)
    for own, other, given in (
        (fast.batch, slow.batch, slow.given(rho, moves)),
        (fast.nominal_batch, slow.nominal_batch, slow.given(rho)[:, :3]),
    ):
        x = own.close(given)
        assert np.abs(x - other.close(given)).max() < 1e-12
        outputs, by_given = own.tangent(x, given)
        expected, by_given_expected = other.tangent(x, given)
        assert np.abs(own.outputs(x, given).values - expected.values).max() < 1e-14
        assert np.abs(outputs.values - expected.values).max() < 1e-14
        assert np.abs(by_given - by_given_expected).max() < 1e-11


@pytest.mark.parametrize(("mode", "count"), [("machine", 30), ("other", 5)])
def test_one_compiled_posture_equals_pinocchios(mode: Mode, count: int) -> None:
    fast, slow = compiled_mechanism(), mechanism()
    for rho, moves in zip(commands(count, 26), displacements(count, 26), strict=True):
        own, other = fast.close(rho, moves, mode=mode), slow.close(rho, moves, mode=mode)
        assert np.abs(own.p - other.p).max() < 1e-12
        assert np.abs(own.R - other.R).max() < 1e-12
        assert np.abs(own.q - other.q).max() < 1e-11
        assert own.residual.keys() == other.residual.keys()
        assert max(own.residual.values()) < 1e-13
        again = fast.close(rho + 1e-3, moves, mode=mode, guess=own)
        assert again.iterations <= own.iterations


def test_one_compiled_posture_that_does_not_close_is_told_as_before() -> None:
    fast, slow = compiled_mechanism(), mechanism()
    told = []
    for one in (fast, slow):
        with pytest.raises(ClosureError) as caught:
            one.close(commands(1, 26)[0] + [1.0, 0.0, 0.0])
        told.append((str(caught.value), caught.value.residuals))
    assert told[0] == told[1]


def test_compiled_postures_do_not_see_their_neighbours() -> None:
    """Several postures are solved at once: each gets what it gets alone, wherever it stands."""
    batch = compiled_mechanism().batch
    given = mechanism().given(commands(37, 23), displacements(37, 23))
    together = batch.close(given)
    alone = np.concatenate([batch.close(given[k : k + 1]) for k in range(len(given))])
    assert np.array_equal(together, alone)
    assert np.array_equal(together[::-1], batch.close(given[::-1]))


def test_compiled_postures_that_do_not_close_are_named_as_before() -> None:
    given = mechanism().given(commands(40, 24), displacements(40, 24))
    given[[13, 29], 0] += 1.0  # a carriage a metre away
    told = []
    for batch in (compiled_mechanism().batch, mechanism().batch):
        with pytest.raises(ClosureError) as caught:
            batch.close(given)
        told.append((str(caught.value), caught.value.index))
    assert told[0] == told[1]
    assert told[0][1] == (13,)


def test_turns_of_any_size_close_compiled() -> None:
    """Starts many turns away end where those nearby do, whole turns apart."""
    batch = compiled_mechanism().batch
    given = mechanism().given(commands(16, 25), displacements(16, 25))
    x = batch.close(given)
    turns = 2 * np.pi * np.random.default_rng(25).integers(-50, 50, x.shape)
    assert np.abs(batch._functions["close"](x + turns, given)[0] - x - turns).max() < 1e-12
    assert np.abs(batch.close(given, x + turns) - x).max() < 1e-12  # from perfect legs


@pytest.mark.parametrize("shape", [(2, 32), (2, 34), (33,)])
def test_compiled_closure_refuses_other_shapes(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="33"):
        compiled_mechanism().batch.close(np.zeros(shape))


def test_without_a_compiler_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORTHOGLIDE_COMPILE", "0")
    slow = Mechanism(NOMINAL, compile=True)
    assert not slow.nominal_batch.compiled
    rho = commands(10, 20)
    assert np.array_equal(slow.forward(rho), mechanism().forward(rho))


# -- where the loops are cut, and in which units ---------------------------------------------


def tie(first: str, second: str) -> Closure:
    return Closure(f"platform_{first}{second}", "frame", f"{first}_tcp", f"{second}_tcp")


TIES = {
    "xy-yz": (tie("x", "y"), tie("y", "z")),
    "yz-zx": (tie("y", "z"), tie("z", "x")),
    "zx-yx": (tie("z", "x"), tie("y", "x")),
}


@pytest.mark.parametrize("ties", TIES.values(), ids=TIES)
def test_pose_does_not_depend_on_which_platforms_are_tied(ties: tuple[Closure, ...]) -> None:
    same_pose_with((*mechanism().tree.loops[:3], *ties), 21)


def test_pose_does_not_depend_on_which_end_of_a_parallelogram_comes_first() -> None:
    loops = mechanism().tree.loops
    same_pose_with(tuple(replace(k, frame_1=k.frame_2, frame_2=k.frame_1) for k in loops), 22)


def same_pose_with(loops: tuple[Closure, ...], seed: int) -> None:
    variant = BatchClosure(replace(mechanism().tree, loops=loops), compile=False)
    given = mechanism().given(commands(100, seed), displacements(100, seed))
    own = mechanism().batch.outputs(mechanism().batch.close(given), given)
    other = variant.outputs(variant.close(given), given)
    assert np.abs(own.values - other.values).max() < 1e-12


@pytest.mark.parametrize("scale", [1e-3, 1e3], ids=["mm", "km"])
@pytest.mark.parametrize("relieved", [True, False], ids=["relieved", "rigid"])
def test_pose_does_not_depend_on_the_rows_units(scale: float, relieved: bool) -> None:
    tree = mechanism().tree
    loops = Loops(tree)
    weight = np.ones(21)
    weight[[*range(9), 9, 10, 11, 15, 16, 17]] = scale  # lengths against angles
    moving = tree.free if relieved else tree.passive
    rho = commands(20, 23)
    moves = displacements(20, 23) if relieved else np.tile(CONSISTENT["path"], (20, 1, 1))
    for r, m in zip(rho, moves, strict=True):
        q = np.zeros(tree.model.nq)
        q[tree.drive], q[tree.virtual] = r - NOMINAL.L, m.ravel()
        for _ in range(12):
            residual = weight * loops.update(q)
            matrix = weight[:, None] * loops.newton_matrix()[:, moving]
            q[moving] -= np.linalg.lstsq(matrix, residual, rcond=1e-12)[0]
        own = mechanism().close(r, m, legs="relieved" if relieved else "rigid")
        assert np.abs(own.q - q).max() < 1e-12


# -- refusals --------------------------------------------------------------------------------


def test_a_command_out_of_reach_is_an_error_and_no_pose() -> None:
    for far in ([0.7, 0.7, 0.7], [1.2, 0.31, 0.31], [1.5, 1.5, 1.5]):
        for legs in ("relieved", "rigid"):
            with pytest.raises(ClosureError, match="do not close") as caught:
                mechanism().close(far, legs=legs)
            assert max(caught.value.residuals.values()) > 1e-3
        with pytest.raises(ClosureError):
            mechanism().forward(far)
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
        for close in (lambda c: mechanism().close(c).p, mechanism().forward):
            try:
                p = close(r)
            except ClosureError:
                refused += 1
                continue
            closed += 1
            assert np.abs(p - reduction.forward(r)).max() < 1e-7
    return closed, refused


def test_carriages_beyond_the_origin_close_on_the_right_pose_or_not_at_all() -> None:
    assert right_or_refused(np.random.default_rng(5).uniform(-0.4, 0.4, (200, 3)))[0] > 20


@pytest.mark.parametrize("command", [[0, 0, 0], [0.06, -0.1, 0.0]])
def test_where_the_assembly_modes_meet_is_no_pose(command: list[float]) -> None:
    """Travel in place of commands: all carriages at the origin, or one of them."""
    for ask in (mechanism().forward, compiled_mechanism().forward, Machine.nominal().jacobian):
        with pytest.raises(ClosureError, match=r"at mechanical zero every command is 0\.31025 m"):
            ask(command)


def test_points_beyond_the_carriages_are_said_to_be_there() -> None:
    with pytest.raises(
        UnreachableError, match=r"^point 2: .* 157\.331 mm beyond their plane"
    ) as on:
        mechanism().inverse([[0.0, 0.0, 0.0], [0.2, 0.2, 0.2]])
    assert on.value.index == (1,)
    assert on.value.excess == pytest.approx(0.157331, abs=1e-6)


def test_whatever_the_legs_reach_near_the_stroke_closes() -> None:
    low, high = NOMINAL.stroke
    rho = NOMINAL.L + np.random.default_rng(25).uniform(1.3 * low, 1.3 * high, (300, 3))
    assert np.abs(mechanism().forward(rho) - reduction.forward(rho)).max() < 1e-12
    assert max(np.abs(mechanism().close(r).p - reduction.forward(r)).max() for r in rho) < 1e-12


def test_a_batch_names_the_posture_that_fails() -> None:
    rho = commands(6, 26)
    rho[4] = 0.7
    for moves in (None, np.zeros((3, 10))):
        with pytest.raises(ClosureError, match="1 of 6 postures") as caught:
            mechanism().forward(rho, moves)
        assert caught.value.index == (4,)
        assert set(caught.value.residuals) == {loop.name for loop in mechanism().tree.loops}
        assert max(caught.value.residuals.values()) > 1e-3


def test_a_shaped_batch_names_the_place_of_the_posture_that_fails() -> None:
    rho = commands(6, 26)
    rho[4] = 0.7
    with pytest.raises(ClosureError) as caught:
        mechanism().forward(rho.reshape(2, 3, 3))
    assert caught.value.index == (1, 1)
    with pytest.raises(ClosureError) as caught:
        mechanism().forward(rho[4])
    assert caught.value.index == ()


def test_inverse_names_the_leg_that_is_too_short() -> None:
    p = np.zeros((2, 3, 3))
    p[1, 2] = [0.0, 0.3, 0.2]
    with pytest.raises(UnreachableError, match=r"leg x is 50\.305 mm too short") as caught:
        mechanism().inverse(p)
    assert caught.value.leg == "x"
    assert caught.value.excess == pytest.approx(np.hypot(0.3, 0.2) - NOMINAL.L)
    assert caught.value.index == (1, 2)


def test_bad_arguments_are_refused() -> None:
    own = mechanism()
    with pytest.raises(InputError, match="finite"):
        own.close([0.3, 0.3, np.nan])
    with pytest.raises(InputError, match="one command"):
        own.close(np.full((2, 3), 0.3))
    with pytest.raises(InputError, match="displacements"):
        own.close(NOMINAL.zero, np.zeros((3, 9)))
    for wrong in (np.nan, [0.3, 0.3], [0.3, np.inf, 0.3]):
        with pytest.raises(InputError, match=r"shape \(\.\.\., 3\)"):
            own.forward(wrong)
    with pytest.raises(InputError, match="finite"):
        own.inverse([0.0, np.inf, 0.0])


# -- pickling --------------------------------------------------------------------------------


@pytest.mark.parametrize("compile", [None, False], ids=["compile", "plain"])
def test_pickling_gives_the_same_mechanism(compile: bool | None) -> None:
    own = Mechanism(OTHER, compile=compile)
    rho, moves = commands(5, 27, OTHER), displacements(5, 27)
    expected = own.forward(rho, moves)
    posture = own.close(rho[0], moves[0])
    again, same = pickle.loads(pickle.dumps((own, posture)))
    assert again.geometry == OTHER
    assert again._compile is compile
    assert np.abs(again.forward(rho, moves) - expected).max() < 1e-13
    assert np.array_equal(same.q, posture.q)
    assert np.abs(again.close(rho[0], moves[0], guess=same).p - posture.p).max() < 1e-14


def test_a_batch_that_does_not_close_says_where_in_words() -> None:
    with pytest.raises(ClosureError, match=r"largest misfit of \S+ mm or mrad at \w+") as caught:
        mechanism().forward([[0.31025] * 3, [0.7] * 3])
    assert "{" not in str(caught.value)
    residuals = caught.value.residuals
    assert set(residuals) == {loop.name for loop in mechanism().tree.loops}
    told = re.search(r"misfit of (\S+) mm or mrad at (\w+)", str(caught.value))
    assert told is not None
    assert residuals[told[2]] == max(residuals.values()) > 0.05
    assert float(told[1]) == pytest.approx(residuals[told[2]] * 1e3, rel=0.02)


def test_points_are_counted_from_one_for_people() -> None:
    with pytest.raises(UnreachableError, match=r"^point 2: leg y is") as caught:
        mechanism().inverse([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    assert caught.value.index == (1,)
    with pytest.raises(UnreachableError, match=r"^leg y is"):
        mechanism().inverse([0.5, 0.0, 0.0])
