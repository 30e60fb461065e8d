"""Bars that give under a load: against statics worked out apart, and against differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orthoglide.effects import CATALOGUE
from orthoglide.errors import ClosureError, InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile, Stiffness
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.prediction import Conditions, Model
from orthoglide.prediction.model import BARS, joint_forces, tensions_tangent
from tests.engines import commands
from tests.rig import Rig, parameter_names
from tests.test_six_bars import WIDE, postures

BAR, LOAD = 5e7, 200.0
ERRORS = {"mount_tilt.x.a": 2e-3, "bar_mismatch.y": 1e-4, "drive_compliance.z": 1e-8}
RHO = commands(6, 17)


@cache
def machine(bar: float | None = BAR, geometry: Geometry | None = None) -> Machine:
    spec = MachineFile(geometry=geometry or Geometry(), stiffness=Stiffness(bar=bar))
    return Machine(replace(spec, screw_pitch=0.02)).with_parameters({} if geometry else ERRORS)


def drawn_errors(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    return {
        name: CATALOGUE.effect_of(name).tolerance_si * float(rng.standard_normal())
        for name in parameter_names()
        if not name.startswith("drive_compliance")
    }


# -- against the independent machine ---------------------------------------------------------


@pytest.mark.parametrize("bar", [4e6, 5e7])
def test_equals_the_independent_machine_under_load(bar: float) -> None:
    errors, rng = drawn_errors(10), np.random.default_rng(10)
    model = Model(Geometry(), 0.02, stiffness=Stiffness(bar=bar), compile=False)
    rho, load = commands(30, 10), rng.uniform(50, 300, 30)
    conditions = Conditions.from_commands(rho, approach=1.0, time=600.0, warming=3.0, load=load)
    out = model.outputs(errors, conditions)
    rig = Rig(errors=errors, screw_pitch=0.02, bar_stiffness=bar)
    pose = rig.pose(rho, np.ones((30, 3)), np.full(30, 600.0), np.full(30, 3.0), load)
    light = Conditions.from_commands(rho, approach=1.0, time=600.0, warming=3.0)
    unloaded = model.outputs(errors, light)
    assert np.abs(out.p - unloaded.p).max() > 1e-6
    # Growth is of the nominal bar here and of the longer one there: 1e-5 of 0.05 mm.
    np.testing.assert_allclose(out.p, pose.p, rtol=0, atol=5e-9)
    np.testing.assert_allclose(out.R, pose.R, rtol=0, atol=1e-9)
    np.testing.assert_allclose(out.lines, pose.lines, rtol=0, atol=5e-9)


@pytest.mark.parametrize("bar", [1e5, 5e6, BAR])
def test_the_platform_rests_and_each_bar_is_longer_by_its_pull(bar: float) -> None:
    """Equilibrium of the deformed machine, from the ends of its bars alone."""
    own, conditions = machine(bar), Conditions.from_commands(RHO, load=LOAD)
    out, pulls = own.model.outputs(ERRORS, conditions), own.bar_tensions(RHO, load=LOAD)
    run = out.lines[..., 0, :] - out.lines[..., 1, :]
    length = np.linalg.norm(run, axis=-1)
    pull = pulls[..., None] * run / length[..., None]
    arm = out.lines[..., 1, :] - out.p[:, None, None]
    np.testing.assert_allclose(pull.sum(axis=(1, 2)), np.tile([0, 0, LOAD], (6, 1)), atol=1e-9)
    np.testing.assert_allclose(np.cross(arm, pull).sum(axis=(1, 2)), 0, atol=1e-9)
    moves = own.model.displacements(ERRORS, conditions).reshape(-1, 3, len(VIRTUAL_NAMES))
    at_rest = own.geometry.L + moves[..., [VIRTUAL_NAMES.index(f"stretch{k}") for k in (1, 2)]]
    assert np.abs(length - at_rest - pulls / bar).max() < 1e-14


# -- derivatives -----------------------------------------------------------------------------


@pytest.mark.parametrize("geometry", [Geometry(), WIDE], ids=["Orthoglide", "wide delta"])
def test_tangent_of_the_tensions_is_a_difference(geometry: Geometry) -> None:
    model = Machine(MachineFile(geometry=geometry)).model
    travel, moves = postures(geometry, 3, 19)
    known, load, h = np.hstack([travel, moves]), np.full(3, LOAD), 1e-5
    shown, by_given = model.engine.tangent(travel, moves)
    own = tensions_tangent(shown, by_given, joint_forces(by_given, load)[:, BARS])

    def pulls(at: Array) -> Array:
        return joint_forces(model.engine.tangent(at[:, :3], at[:, 3:])[1], load)[:, BARS]

    numeric = np.stack([(pulls(known + h * e) - pulls(known - h * e)) / (2 * h)
                        for e in np.eye(33)], axis=-1)  # fmt: skip
    assert own.shape == (3, 6, 33)
    assert np.abs(own - numeric).max() < 1e-6 * np.abs(own).max()


@pytest.mark.parametrize(("bar", "load"), [(BAR, LOAD), (5e6, 1000.0), (1e6, 1000.0)])
def test_sensitivities_of_the_catalogue_equal_finite_differences(bar: float, load: float) -> None:
    model = machine(bar).model
    conditions = Conditions.from_commands(RHO[:3], approach=1.0, time=600.0, warming=3.0, load=load)
    outputs, by_name = model.sensitivities(ERRORS, conditions, CATALOGUE.parameters)
    for k, name in enumerate(CATALOGUE.parameters):
        step = CATALOGUE.effect_of(name).tolerance_si / 2
        at = ERRORS.get(name, 0.0)

        def aside(times: int, name: str = name, at: float = at, step: float = step) -> Array:
            return model.outputs({**ERRORS, name: at + times * step}, conditions).values

        wanted = (8 * (aside(1) - aside(-1)) - (aside(2) - aside(-2))) / (12 * step)
        error = np.abs(by_name[..., k] - wanted).max()
        assert error < 1e-7 * np.abs(wanted).max() + 2e-12 / step, name
    np.testing.assert_allclose(
        outputs.values, model.outputs(ERRORS, conditions).values, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("geometry", [None, WIDE], ids=["Orthoglide", "wide delta"])
def test_jacobian_and_inverse_are_those_of_the_loaded_machine(geometry: Geometry | None) -> None:
    own, step = machine(BAR, geometry), 1e-4
    rho = RHO if geometry is None else postures(WIDE, 6, 18)[0]
    J = own.jacobian(rho, load=LOAD)
    for k in range(3):
        move = step * np.eye(3)[k]
        one, two = (
            own.forward(rho + n * move, load=LOAD) - own.forward(rho - n * move, load=LOAD)
            for n in (1, 2)
        )
        np.testing.assert_allclose(J[..., k], (8 * one - two) / (12 * step), rtol=0, atol=1e-8)
    p = own.forward(rho, load=LOAD)
    assert np.abs(own.inverse(p, load=LOAD) - rho).max() < 1e-11
    assert np.abs(own.inverse(p) - rho).max() > 1e-6


# -- where it must refuse --------------------------------------------------------------------


@pytest.mark.parametrize("load", [1e4, 1e6])
def test_no_equilibrium_says_which_posture(load: float) -> None:
    loads = np.where(np.arange(6) == 3, load, 0.0)
    with pytest.raises(ClosureError) as caught:
        machine(1e4).forward(RHO, load=loads)
    assert caught.value.index == (3,)


@pytest.mark.parametrize("bar", [0.0, -1e7, np.nan, np.inf])
def test_impossible_stiffness_is_refused(bar: float) -> None:
    with pytest.raises(InputError, match="bar's stiffness must be positive"):
        Stiffness(bar=bar)
