"""Elastic equilibrium: its limits, its energy, its derivatives, and the machine that uses it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orthoglide.effects import CATALOGUE
from orthoglide.errors import ClosureError, InputError, NumericsError
from orthoglide.geometry import Array, Geometry
from orthoglide.machine import Machine
from orthoglide.machine_file import Stiffness
from orthoglide.mechanism import Mechanism
from orthoglide.mechanism.elastic import (
    RELIEF_LIMIT,
    ElasticClosure,
    relief_angles,
    relief_warnings,
)
from orthoglide.mechanism.elastic_functions import STRETCH
from orthoglide.mechanism.functions import LINES, ROTATION, TCP
from orthoglide.mechanism.tree import VIRTUAL_NAMES, nominal_tree
from orthoglide.prediction import Conditions, Model
from orthoglide.prediction.load import force
from tests.rig import Rig, parameter_names

GEOMETRY = Geometry()
BAR, TORSION, LOAD = 5e7, 1e4, 200.0
ALL_STIFFNESS = pytest.mark.parametrize("torsion", [0.0, 1e3, 1e5])


@cache
def mechanism() -> Mechanism:
    return Mechanism(GEOMETRY, compile=False)


@cache
def closure(bar: float | None = BAR, torsion: float | None = TORSION) -> ElasticClosure:
    return ElasticClosure(mechanism().tree, bar=bar, torsion=torsion, compile=False)


def given(n: int, seed: int, *, size: float = 1e-3, load: float = 0.0) -> Array:
    """``(n, 34)``: commands of the stroke, all virtual joints displaced, the same load for all."""
    rng = np.random.default_rng(seed)
    travel = rng.uniform(*GEOMETRY.stroke, (n, 3))
    moves = size * rng.standard_normal((n, 3 * len(VIRTUAL_NAMES)))
    return np.column_stack([travel, moves, np.full(n, load)])


def values(own: ElasticClosure, known: Array, guess: Array | None = None) -> Array:
    return own.outputs(own.close(known, guess), known).values


def relieved(known: Array) -> Array:
    """Outputs of the closure without springs."""
    batch = mechanism().batch
    return batch.outputs(batch.close(known[:, :33]), known[:, :33]).values


def potential(own: ElasticClosure, known: Array, guess: Array | None = None) -> Array:
    """Energy of the springs and of the load ``(n,)``, joules."""
    x = own.close(known, guess)
    height = own.outputs(x, known).values[:, 2]
    return own.deformation(x, known).total + known[:, 33] * height


def slope(function: Callable[[Array], Array], at: Array, column: int, step: float) -> Array:
    """Derivative by one of the given, of fourth order in the step."""

    def aside(times: int) -> Array:
        moved = at.copy()
        moved[:, column] += times * step
        return function(moved)

    return (8 * (aside(1) - aside(-1)) - (aside(2) - aside(-2))) / (12 * step)


# -- what it tends to ------------------------------------------------------------------------


def test_without_torsional_stiffness_and_load_it_is_the_relief_closure() -> None:
    known = given(50, 0)
    assert np.abs(values(closure(BAR, 0.0), known) - relieved(known)).max() < 1e-12
    gaps = [np.abs(values(closure(BAR, k), known) - relieved(known)).max() for k in (1e1, 1e0, 0.1)]
    assert gaps[0] > 1e-8
    np.testing.assert_allclose(gaps[1:], np.array(gaps[:2]) / 10, rtol=1e-2)


def test_with_rigid_bars_it_is_the_relief_closure_whatever_the_legs() -> None:
    known = given(50, 1, load=LOAD)
    assert np.abs(values(closure(None, 1e5), known) - relieved(known)).max() < 1e-12
    # Stiff bars tend to rigid ones, also in the tensions, which rigid bars have as reactions.
    rigid, stiff = closure(None, TORSION), closure(1e12, TORSION)
    assert np.abs(values(stiff, known) - values(rigid, known)).max() < 1e-6
    tensions = [own.deformation(own.close(known), known).tension for own in (rigid, stiff)]
    assert np.abs(tensions[0]).max() > LOAD
    np.testing.assert_allclose(*tensions, rtol=0, atol=1e-4 * np.abs(tensions[0]).max())


@ALL_STIFFNESS
def test_consistent_geometry_unloaded_is_the_rigid_machine(torsion: float) -> None:
    rng = np.random.default_rng(2)
    moves = np.zeros((5, 3, len(VIRTUAL_NAMES)))
    for name in ("travel", "lateral_b", "lateral_c"):
        moves[..., VIRTUAL_NAMES.index(name)] = 2e-3 * rng.standard_normal((5, 3))
    both = 1e-3 * rng.standard_normal((5, 3, 1))
    moves[..., [VIRTUAL_NAMES.index(f"stretch{k}") for k in (1, 2)]] = both
    rho = GEOMETRY.L + rng.uniform(*GEOMETRY.stroke, (5, 3))
    known = np.column_stack([mechanism().given(rho, moves), np.zeros(5)])
    own = closure(BAR, torsion)
    x = own.close(known)
    shown, found = own.outputs(x, known), own.deformation(x, known)
    for k in range(5):
        rigid = mechanism().close(rho[k], moves[k], legs="rigid")
        np.testing.assert_allclose(shown.p[k], rigid.p, rtol=0, atol=1e-12)
        np.testing.assert_allclose(shown.R[k], rigid.R, rtol=0, atol=1e-12)
    assert np.abs(found.relief).max() < 1e-12
    assert found.total.max() < 1e-15


def test_stiff_legs_share_a_twist_with_the_bars_as_springs_in_series() -> None:
    """Leg x twisted by t at mechanical zero turns the platform against leg z's two bars.

    These hold it with k d^2/2, so it turns by t K / (K + k d^2/2) and the leg keeps the rest.
    """
    twist = 1e-4
    known = np.zeros((1, 34))
    known[0, 3 + VIRTUAL_NAMES.index("turn_a")] = twist
    for torsion in (1e3, 1e5, 1e6):
        own = closure(BAR, torsion)
        x = own.close(known)
        turned = twist * torsion / (torsion + BAR * GEOMETRY.d**2 / 2)
        R = own.outputs(x, known).R[0]
        assert R[2, 1] == pytest.approx(turned, rel=1e-3)
        found = own.deformation(x, known)
        assert abs(found.relief[0, 0, 0]) == pytest.approx(twist - turned, rel=1e-3)
        assert abs(found.moment[0, 0]) == pytest.approx(torsion * (twist - turned), rel=1e-3)
        assert found.total[0] == pytest.approx(torsion * (twist - turned) * twist / 2, rel=1e-3)


def test_the_second_relief_joint_follows_the_twist() -> None:
    """In the ratio d / L, so that one spring on the twist is the whole stiffness of a leg."""
    moves = np.zeros((1, 34))
    moves[0, 3 + VIRTUAL_NAMES.index("turn_a")] = 1e-3
    twist, follow = relief_angles(mechanism().tree, closure().close(moves))[0, 0]
    assert abs(twist) > 5e-4
    assert follow / twist == pytest.approx(-GEOMETRY.d / GEOMETRY.L, rel=1e-3)


# -- energy ----------------------------------------------------------------------------------


def test_forces_are_derivatives_of_the_energy() -> None:
    known = given(6, 3, load=LOAD)
    own = closure()
    x = own.close(known)
    forces = own.forces(x, known)
    for column in range(33):
        by_energy = slope(lambda g: potential(own, g, x), known, column, 1e-4)
        error = np.abs(forces[:, column] + by_energy).max()
        assert error < 1e-6 * np.abs(forces[:, column]).max() + 1e-6, column
    # The tensions pull against any further stretch.
    tension = own.deformation(x, known).tension.reshape(6, 6)
    np.testing.assert_allclose(forces[:, list(STRETCH)], tension, rtol=1e-9, atol=1e-6)


def test_compliance_is_that_of_the_energy() -> None:
    """Castigliano: the load's derivative of the energy is the height, the second one its slope."""
    known = given(6, 4, load=LOAD)
    own = closure()
    shown, by_given = own.tangent(own.close(known), known)
    height = slope(lambda g: potential(own, g), known, 33, 20.0)
    np.testing.assert_allclose(height, shown.p[:, 2], rtol=0, atol=1e-12)
    step = 50.0
    up, down = known.copy(), known.copy()
    up[:, 33] += step
    down[:, 33] -= step
    second = (potential(own, up) - 2 * potential(own, known) + potential(own, down)) / step**2
    assert np.all(second < -1e-9)
    np.testing.assert_allclose(by_given[:, 2, 33], second, rtol=1e-5)
    # In a consistent machine the load's work is what the springs hold: U = W u / 2.
    known = given(6, 5, size=0.0, load=LOAD)
    x, free = own.close(known), known.copy()
    free[:, 33] = 0.0
    sunk = values(own, free)[:, 2] - own.outputs(x, known).p[:, 2]
    assert np.all(sunk > 1e-6)
    np.testing.assert_allclose(own.deformation(x, known).total, LOAD * sunk / 2, rtol=2e-3)


@ALL_STIFFNESS
def test_any_other_closed_posture_has_more_energy(torsion: float) -> None:
    own, known, rng = closure(BAR, torsion), given(20, 6, load=LOAD), np.random.default_rng(7)
    x = own.close(known)
    least, stretch = potential(own, known), own.deformation(x, known).stretch.reshape(-1, 6)
    batch = mechanism().batch
    for _ in range(10):
        other = stretch + 1e-6 * rng.standard_normal(stretch.shape)
        moved = known[:, :33].copy()
        moved[:, list(STRETCH)] += other
        closed = batch.close(moved)
        twist = relief_angles(mechanism().tree, closed)[:, :, 0]
        energy = (BAR * np.sum(other**2, axis=1) + torsion * np.sum(twist**2, axis=1)) / 2
        energy += LOAD * batch.outputs(closed, moved).p[:, 2]
        gain = (BAR / 2) * np.sum((other - stretch) ** 2, axis=1)
        # The springs' own part of the gain; curvature of the loops is worth percents of it.
        assert np.all(energy - least > 0.9 * gain)


def test_the_platform_rests_under_bars_and_load() -> None:
    """Legs without torsional stiffness: pulls along the six bars balance the weight."""
    known, own = given(20, 8, load=LOAD), closure(BAR, 0.0)
    x = own.close(known)
    shown, tension = own.outputs(x, known), own.deformation(x, known).tension
    run = shown.lines[..., 0, :] - shown.lines[..., 1, :]
    pull = tension[..., None] * run / np.linalg.norm(run, axis=-1, keepdims=True)
    arm = shown.lines[..., 1, :] - shown.p[:, None, None]
    np.testing.assert_allclose(pull.sum(axis=(1, 2)), np.tile([0, 0, LOAD], (20, 1)), atol=1e-6)
    np.testing.assert_allclose(np.cross(arm, pull).sum(axis=(1, 2)), 0, atol=1e-6)


# -- derivatives -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bar", "torsion", "load"),
    [(BAR, TORSION, LOAD), (BAR, 1e5, 0.0), (5e6, 0.0, 1000.0), (None, 1e4, LOAD)],
)
def test_sensitivities_equal_finite_differences(
    bar: float | None, torsion: float, load: float
) -> None:
    own, known = closure(bar, torsion), given(4, 9, load=load)
    x = own.close(known)
    shown, by_given = own.tangent(x, known)
    assert by_given.shape == (4, 48, 34)
    np.testing.assert_allclose(shown.values, own.outputs(x, known).values, rtol=0, atol=1e-15)
    for column in range(34):
        step = 5.0 if column == 33 else 2e-4
        expected = slope(lambda g: values(own, g, x), known, column, step)
        for part in (TCP, ROTATION, LINES):
            found, wanted = by_given[:, part, column], expected[:, part]
            # Rounding and the closure's tolerance, divided by the step.
            floor = 2e-13 / step
            error = np.abs(found - wanted).max()
            assert error < 1e-6 * np.abs(wanted).max() + floor, column


# -- against the independent machine ---------------------------------------------------------


@pytest.mark.parametrize("bar", [4e6, 5e7])
def test_equals_the_independent_machine_under_load(bar: float) -> None:
    rng = np.random.default_rng(10)
    left_out = ("drive_compliance",)
    errors = {
        name: CATALOGUE.effect_of(name).tolerance_si * float(rng.standard_normal())
        for name in parameter_names()
        if not name.startswith(left_out)
    }
    model = Model(GEOMETRY, 0.02, stiffness=Stiffness(bar=bar), compile=False)
    rho = GEOMETRY.L + rng.uniform(*GEOMETRY.stroke, (30, 3))
    load = rng.uniform(50, 300, 30)
    conditions = Conditions.at(rho, approach=1.0, time=600.0, warming=3.0, load=load)
    out = model.outputs(errors, conditions)
    rig = Rig(errors=errors, screw_pitch=0.02, bar_stiffness=bar)
    pose = rig.pose(rho, np.ones((30, 3)), np.full(30, 600.0), np.full(30, 3.0), load)
    unloaded = model.outputs(errors, replace(conditions, load=np.zeros(30)))
    assert np.abs(out.p - unloaded.p).max() > 1e-6
    # Growth is of the nominal bar here and of the longer one there: 1e-5 of 0.05 mm.
    np.testing.assert_allclose(out.p, pose.p, rtol=0, atol=5e-9)
    np.testing.assert_allclose(out.R, pose.R, rtol=0, atol=1e-9)
    np.testing.assert_allclose(out.lines, pose.lines, rtol=0, atol=5e-9)


def test_compliant_drives_and_bars_together() -> None:
    """The catalogue takes the drive's force from the nominal machine, the other from the loaded."""
    errors = {f"drive_compliance.{leg}": 5e-9 for leg in "xyz"}
    model = Model(GEOMETRY, stiffness=Stiffness(bar=BAR), compile=False)
    rho = GEOMETRY.L + np.random.default_rng(11).uniform(*GEOMETRY.stroke, (30, 3))
    pose = Rig(errors=errors, bar_stiffness=BAR).pose(rho, load=100.0)
    out = model.outputs(errors, Conditions.at(rho, load=100.0))
    np.testing.assert_allclose(out.p, pose.p, rtol=0, atol=1e-9)


@ALL_STIFFNESS
def test_relabelling_the_legs_relabels_the_pose(torsion: float) -> None:
    known, own = given(20, 12), closure(BAR, torsion)
    turned = known.copy()
    turned[:, :3] = np.roll(known[:, :3], 1, axis=1)
    moves = known[:, 3:33].reshape(-1, 3, len(VIRTUAL_NAMES))
    turned[:, 3:33] = np.roll(moves, 1, axis=1).reshape(-1, 30)
    x, y = own.close(known), own.close(turned)
    before, after = own.outputs(x, known), own.outputs(y, turned)
    np.testing.assert_allclose(after.p, np.roll(before.p, 1, axis=1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(after.R, np.roll(before.R, (1, 1), (1, 2)), rtol=0, atol=1e-12)
    energy = [own.deformation(*pair).energy for pair in ((x, known), (y, turned))]
    np.testing.assert_allclose(energy[1], np.roll(energy[0], 1, axis=1), rtol=1e-6, atol=1e-9)


# -- where it must refuse --------------------------------------------------------------------


def test_no_equilibrium_says_which_posture() -> None:
    known = given(5, 13)
    known[3, 33] = 1e6  # on bars of rubber
    with pytest.raises(
        NumericsError, match="no elastic equilibrium; the first is number 3"
    ) as caught:
        closure(1e4, 0.0).close(known)
    assert isinstance(caught.value, ClosureError)
    assert caught.value.index == (3,)
    assert max(caught.value.residuals.values()) > 1e-9


def test_legs_out_of_reach_say_which_posture() -> None:
    known = given(5, 14)
    known[2, 0] = 1.0
    with pytest.raises(ClosureError, match="do not close; the first is number 2") as caught:
        closure().close(known)
    assert caught.value.index == (2,)
    assert any("platform" in loop for loop in caught.value.residuals)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"bar": 0.0}, "bar's stiffness"),
        ({"bar": np.nan}, "bar's stiffness"),
        ({"torsion": -1.0}, "torsional"),
        ({"torsion": np.inf}, "torsional"),
    ],
)
def test_impossible_stiffness_is_refused(arguments: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        ElasticClosure(mechanism().tree, **arguments)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(InputError, match="general tree"):
        ElasticClosure(nominal_tree(GEOMETRY))
    with pytest.raises(InputError, match="34"):
        closure().close(np.zeros((2, 33)))


# -- speed, size and order -------------------------------------------------------------------


@pytest.mark.thorough
def test_compiled_equals_not_compiled() -> None:
    fast = ElasticClosure(mechanism().tree, bar=BAR, torsion=TORSION, compile=True)
    if not fast.compiled:
        pytest.skip("no C compiler here")
    known, own = given(300, 15, load=LOAD), closure()
    x, y = fast.close(known), own.close(known)
    np.testing.assert_allclose(x, y, rtol=0, atol=1e-11)
    assert np.abs(fast.outputs(x, known).values - own.outputs(y, known).values).max() < 1e-12
    tangents = [c.tangent(z, known)[1] for c, z in ((fast, x), (own, y))]
    np.testing.assert_allclose(*tangents, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(fast.forces(x, known), own.forces(y, known), rtol=1e-8, atol=1e-5)


def test_batches_equal_single_postures() -> None:
    known, own = given(300, 16, load=LOAD), closure()
    together = own.close(known)
    for k in (0, 255, 256, 299):
        assert np.abs(own.close(known[k : k + 1]) - together[k]).max() < 1e-12
    assert own.close(known[:0]).shape == (0, 27)
    near = own.close(known, together + 1e-3)
    assert np.abs(near - together).max() < 1e-11


# -- the machine that uses it ----------------------------------------------------------------

ERRORS = {"mount_tilt.x.a": 2e-3, "bar_mismatch.y": 1e-4, "drive_compliance.z": 1e-8}


@cache
def machine(torsion: float | None = TORSION, bar: float | None = BAR) -> Machine:
    spec = replace(Machine.nominal().spec, stiffness=Stiffness(torsion=torsion, bar=bar))
    own = Machine(spec)
    own.__dict__["model"] = Model(GEOMETRY, 0.02, stiffness=spec.stiffness, compile=False)
    return own.with_parameters(ERRORS)


def some_commands(n: int = 6, seed: int = 17) -> Array:
    return GEOMETRY.L + np.random.default_rng(seed).uniform(*GEOMETRY.stroke, (n, 3))


def test_a_machine_takes_its_stiffness_from_its_file(tmp_path: object) -> None:
    path = f"{tmp_path}/machine.toml"
    machine().save(path)
    again, rho = Machine.load(path), some_commands()
    np.testing.assert_allclose(again.forward(rho, load=LOAD), machine().forward(rho, load=LOAD))
    assert np.abs(again.forward(rho) - Machine.nominal().forward(rho)).max() > 1e-6


def test_stiffness_is_used_where_it_matters() -> None:
    rho, legs = some_commands(), machine().model
    assert legs.is_elastic(Conditions.at(rho))
    bars = machine(None, BAR).model
    assert bars.is_elastic(Conditions.at(rho, load=LOAD))
    assert not bars.is_elastic(Conditions.at(rho))
    assert not machine(TORSION, None).model.is_elastic(Conditions.at(rho, load=LOAD))
    # Either way the pose is the same where both could be used.
    strained = Conditions.at(rho, load=1e-9)
    both = [bars.outputs(ERRORS, c).values for c in (strained, Conditions.at(rho))]
    np.testing.assert_allclose(*both, rtol=0, atol=1e-11)


def test_sensitivities_of_the_catalogue_equal_finite_differences() -> None:
    model, conditions = (
        machine().model,
        Conditions.at(some_commands(3), approach=1.0, time=600.0, warming=3.0, load=LOAD),
    )
    outputs, by_name = model.sensitivities(ERRORS, conditions, CATALOGUE.parameters)
    for k, name in enumerate(CATALOGUE.parameters):
        step = CATALOGUE.effect_of(name).tolerance_si / 2
        at = ERRORS.get(name, 0.0)

        def aside(times: int, name: str = name, at: float = at, step: float = step) -> Array:
            return model.outputs({**ERRORS, name: at + times * step}, conditions).values

        wanted = (8 * (aside(1) - aside(-1)) - (aside(2) - aside(-2))) / (12 * step)
        error = np.abs(by_name[..., k] - wanted).max()
        assert error < 1e-6 * np.abs(wanted).max() + 2e-12 / step, name
    np.testing.assert_array_equal(outputs.values, model.outputs(ERRORS, conditions).values)


def test_jacobian_and_inverse_are_those_of_the_loaded_machine() -> None:
    own, rho, step = machine(), some_commands(3), 1e-4
    J = own.jacobian(rho, load=LOAD)
    for k in range(3):
        move = step * np.eye(3)[k]
        wanted = own.forward(rho + move, load=LOAD) - own.forward(rho - move, load=LOAD)
        np.testing.assert_allclose(J[..., k], wanted / (2 * step), rtol=0, atol=1e-6)
    p = own.forward(rho, load=LOAD)
    assert np.abs(own.inverse(p, load=LOAD) - rho).max() < 1e-11
    assert np.abs(own.inverse(p) - rho).max() > 1e-6


def test_the_machine_says_what_it_fights_against() -> None:
    rho = some_commands().reshape(2, 3, 3)
    found = machine().deformation(rho, load=LOAD)
    assert found.energy.shape == (2, 3, 3, 3)
    assert found.drive.shape == found.moment.shape == (2, 3, 3)
    np.testing.assert_array_equal(found.total, found.energy.sum(axis=(2, 3)))
    np.testing.assert_allclose(
        found.total,
        np.sum(found.tension * found.stretch, axis=(2, 3)) / 2
        + np.sum(found.moment * found.relief[..., 0], axis=2) / 2,
    )
    np.testing.assert_allclose(found.moment, TORSION * found.relief[..., 0])
    # Twisted at its mount, leg x is what the machine fights against most.
    assert str(machine().deformation(rho[0, 0])).startswith("the machine fights against itself")
    assert "mJ: leg x's torsion" in str(machine().deformation(rho[0, 0]))
    assert "nothing" in str(Machine.nominal().deformation(rho[0, 0]))
    # With rigid bars and limp legs nothing gives, yet bars and drives carry the load.
    stiff = Machine.nominal().deformation(rho, load=LOAD)
    assert stiff.total.max() == 0.0
    expected = force(Machine.nominal().model.mechanism, Conditions.at(rho, load=LOAD))
    np.testing.assert_allclose(stiff.drive.reshape(-1, 3), expected, rtol=0, atol=1e-9)


def test_poses_report_the_relief_angles() -> None:
    rho = some_commands().reshape(2, 3, 3)
    for own in (machine(), machine(None, None)):
        pose = own.pose(rho)
        assert pose.relief.shape == (2, 3, 3, 2)
        assert 1e-3 < np.abs(pose.relief[..., 0, 0]).max() < 3e-3
        assert pose.warnings == ()
    assert np.abs(Machine.nominal().pose(rho).relief).max() < 1e-12


def test_implausible_twist_is_a_warning_in_words() -> None:
    (said,) = (
        machine(None, None).with_parameters({"mount_tilt.y.a": 0.03}).pose(GEOMETRY.zero).warnings
    )
    assert said.startswith("leg y must twist by 1.7 degrees")
    assert "more than the 1 degree" in said
    many = machine(None, None).with_parameters({f"mount_tilt.{leg}.a": 0.03 for leg in "xyz"})
    assert len(many.deformation(some_commands()).warnings) == 3
    assert len(relief_warnings(np.full((1, 3, 2), np.nan))) == 3
    assert relief_warnings(np.empty((0, 3, 2))) == ()


def test_the_limit_is_four_times_what_tolerances_make_of_it() -> None:
    rng = np.random.default_rng(18)
    model = machine(None, None).model
    worst = []
    for _ in range(100):
        drawn = {
            n: CATALOGUE.effect_of(n).tolerance_si * rng.standard_normal()
            for n in CATALOGUE.parameters
        }
        rho = GEOMETRY.L + rng.uniform(*GEOMETRY.stroke, (1, 3))
        batch, known = model.closing(drawn, Conditions.at(rho, warming=2.0))
        worst.append(np.abs(relief_angles(batch.tree, batch.close(known))).max())
    assert 0.2 < np.sqrt(np.mean(np.square(worst))) / RELIEF_LIMIT < 0.3
