"""MuJoCo as an independent witness: of the nominal machine, and of what is exported to it."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

import mujoco

from orthoglide.control import calibrated_mjcf, constant_geometry
from orthoglide.geometry import Geometry
from orthoglide.machine import Machine
from orthoglide.mechanism.mjcf import to_mjcf
from orthoglide.mechanism.tree import RELIEF_NAMES, load
from orthoglide.urdf import closures, to_urdf
from tests.engines import DELTA, NOMINAL, OTHER, commands, forward
from tests.mujoco_machine import Dimensions, MujocoMachine, six_bar_mjcf


def exported(geometry: Geometry = NOMINAL, relief: bool = True) -> str:
    """The nominal machine as the package writes it for MuJoCo."""
    return to_mjcf(load(geometry), relief=relief)


BUILT: dict[str, Callable[[Geometry], str]] = {
    "six-bars": lambda geometry: six_bar_mjcf(Dimensions(geometry.L, geometry.d, geometry.r)),
    "exported": exported,
    "rigid-legs": lambda geometry: exported(geometry, relief=False),
}


@pytest.mark.parametrize("build", BUILT)
@pytest.mark.parametrize("geometry", [NOMINAL, OTHER], ids=["nominal", "other"])
def test_nominal_machine(build: str, geometry: Geometry) -> None:
    witness = MujocoMachine(BUILT[build](geometry), geometry.L)
    rho = commands(100, 1, geometry)
    p = forward(rho, geometry=geometry)
    for command, expected in zip(rho, p, strict=True):
        place, turn = witness.pose(command)
        assert np.abs(place - expected).max() < 1e-12
        assert np.abs(turn - np.eye(3)).max() < 1e-12


@pytest.mark.parametrize("geometry", [NOMINAL, DELTA], ids=["orthoglide", "delta"])
def test_a_calibrated_machine_exported_to_mujoco_is_where_ours_is(geometry: Geometry) -> None:
    """All errors of constant geometry but tilts of paths: unequal bars and turned joints too."""
    spec = replace(Machine.nominal().spec, geometry=geometry)
    rng, plain = np.random.default_rng(5), Machine(spec)
    drawn = {
        str(n): plain.tolerance(n) * float(rng.standard_normal())
        for n in plain.catalogue.parameters if "tilt" not in n or n.startswith("mount")
    }  # fmt: skip
    drawn = constant_geometry(plain.with_parameters(drawn))
    worn = plain.with_parameters({**drawn, "backlash." + geometry.leg_names[0]: 1e-4})
    assert len(drawn) > 20
    text = calibrated_mjcf(worn)
    assert "Left out, for MJCF holds constant geometry only: backlash." in text
    zero = float(geometry.zero[0])
    witness = MujocoMachine(text, zero, geometry.leg_names)
    at_rest = mujoco.MjData(witness.model)
    mujoco.mj_step(witness.model, at_rest, 1000)  # a second under gravity, from joints at zero
    assert np.abs(at_rest.efc_pos).max() < 1e-4
    data = witness.close(np.full(3, zero))
    assert data.efc_J.size == 21 * 24  # each loop closed once: no row repeats another
    for command in zero + rng.uniform(-0.03, 0.04, (10, 3)):
        place, _ = witness.pose(command)
        assert np.abs(place - worn.forward(command)).max() < 1e-10
        assert np.abs(place - plain.forward(command)).max() > 1e-4


@pytest.mark.parametrize("relief", [True, False], ids=["relief", "rigid-legs"])
@pytest.mark.parametrize("geometry", [NOMINAL, DELTA], ids=["orthoglide", "delta"])
def test_the_machine_stands_under_gravity(geometry: Geometry, relief: bool) -> None:
    """And goes where its drives are sent, all loops closed."""
    model = mujoco.MjModel.from_xml_string(exported(geometry, relief))
    data = mujoco.MjData(model)
    assert model.opt.gravity[2] < -9
    drives = [model.joint(f"{leg}_slide").qposadr[0] for leg in geometry.leg_names]
    for travel in (0.0, 0.02):
        data.ctrl[:] = travel
        for _ in range(round(1.0 / model.opt.timestep)):
            mujoco.mj_step(model, data)
            loops = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
            assert len(loops) == 21
            assert np.abs(loops).max() < 1e-4
        np.testing.assert_allclose(data.qpos[drives], travel, atol=1e-4)
        assert np.abs(data.qvel).max() < 1e-4
    assert not any(warning.number for warning in data.warning)


def test_joints_of_the_export_are_called_as_those_of_the_urdf() -> None:
    """So that code written for one holds for the other."""
    model = MujocoMachine(exported(), NOMINAL.L).model
    names = {model.joint(k).name for k in range(model.njnt)}
    robot = ET.fromstring(to_urdf(NOMINAL))
    moving = {str(j.get("name")) for j in robot.iter("joint") if j.get("type") != "fixed"}
    relief = {f"{leg}_{name}" for leg in "xyz" for name in RELIEF_NAMES}
    assert names == moving | relief
    assert {model.equality(k).name for k in range(model.neq)} == {c.name for c in closures(NOMINAL)}
    np.testing.assert_allclose(model.joint("x_slide").range, NOMINAL.stroke)
    masses = [float(m.get("value", "")) for m in robot.iter("mass")]
    assert float(model.body_mass.sum()) == pytest.approx(sum(masses))
