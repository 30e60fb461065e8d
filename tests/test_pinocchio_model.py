"""A machine as Pinocchio's objects: closed, consistent, and ready for Pinocchio's algorithms."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import orthoglide as og
from orthoglide.mechanism.tree import load

ERRORS = {"bar_mismatch.x": 2e-4, "axis_tilt.y.z": 1e-3, "joint_offset.z": 1e-3}
DELTA = og.Geometry(0.36, 0.05, 0.03, (-0.2, 0.2), og.LinearDelta((0.174,) * 3))
MACHINES = {
    "nominal": og.Machine.nominal(),
    "errors": og.Machine.nominal().with_parameters(ERRORS),
    "delta": og.Machine.of(DELTA).with_parameters({"bar_mismatch.b": 1e-4}),
}


@pytest.fixture(scope="module", params=MACHINES)
def own(request: pytest.FixtureRequest) -> tuple[og.Machine, og.PinocchioModel]:
    machine = MACHINES[request.param]
    return machine, og.pinocchio_model(machine)


def jacobian(found: og.PinocchioModel, data: pin.Data) -> np.ndarray:
    pin.computeJointJacobians(found.model, data, found.q)
    for model, own_data in zip(found.constraint_models, found.constraint_datas, strict=True):
        model.calc(found.model, data, own_data)
    return pin.getConstraintsJacobian(
        found.model, data, found.constraint_models, found.constraint_datas
    )


def test_the_constraint_jacobian_gives_the_velocity_of_the_tool(own: tuple) -> None:
    machine, found = own
    data = found.model.createData()
    rows = jacobian(found, data)
    free = np.setdiff1d(np.arange(found.model.nv), found.drives)
    rates = np.zeros((found.model.nv, 3))
    rates[found.drives] = np.eye(3)
    rates[free] = -np.linalg.solve(rows[:, free], rows[:, found.drives])
    tool = pin.getFrameJacobian(found.model, data, found.tool, pin.LOCAL_WORLD_ALIGNED)[:3]
    # A tilted axis moves the carriage along its path; frozen errors keep it on its slide.
    slope = 2e-3 if "axis_tilt.y.z" in machine.values else 1e-9
    assert np.abs(tool @ rates - machine.jacobian(machine.geometry.zero)).max() < slope


def test_constrained_dynamics_keeps_the_loops_closed(own: tuple) -> None:
    _, found = own
    data = found.model.createData()
    rows = jacobian(found, data)
    still, torque = np.zeros(found.model.nv), np.zeros(found.model.nv)
    torque[found.drives] = 5.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        pin.initConstraintDynamics(found.model, data, found.rigid_models, found.rigid_datas)
        moved = pin.constraintDynamics(
            found.model, data, found.q, still, torque, found.rigid_models, found.rigid_datas
        ).copy()
    mass = pin.crba(found.model, data, found.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    bias = pin.nonLinearEffects(found.model, data, found.q, still)
    system = np.block([[mass, rows.T], [rows, np.zeros((21, 21))]])
    expected = np.linalg.solve(system, np.concatenate([torque - bias, np.zeros(21)]))[:24]
    assert np.abs(moved[found.drives]).min() > 0.1
    assert np.abs(rows @ moved).max() < 1e-6 * np.abs(moved).max()
    assert np.abs(moved - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("geometry", [og.Geometry(), DELTA], ids=["orthoglide", "delta"])
def test_pictures_of_the_links_stand_where_the_urdf_has_them(geometry: og.Geometry) -> None:
    found, tree = og.pinocchio_model(geometry), load(geometry)
    nominal = pin.buildGeomFromUrdfString(tree.model, tree.urdf, pin.GeometryType.VISUAL)
    places = []
    for model, q, visual in (
        (found.model, found.q, found.visual_model),
        (tree.model, pin.neutral(tree.model), nominal),
    ):
        data, shown = model.createData(), visual.createData()
        pin.updateGeometryPlacements(model, data, visual, shown, q)
        places.append({o.name: m for o, m in zip(visual.geometryObjects, shown.oMg, strict=True)})
    assert places[0].keys() == places[1].keys()
    for name, place in places[0].items():
        assert np.abs(place.homogeneous - places[1][name].homogeneous).max() < 1e-12


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_page_runs_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[1] / "docs" / "own-pinocchio.md").read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL))
    exec(compile(code, "own-pinocchio.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert printed[:2] == ["24 joints, 5 loops", "(21, 24) rank 21"]
    assert printed[2].endswith("m/s²")
    assert re.fullmatch(r"\d steps, largest residual \de-1[5-8]", printed[3])
    assert printed[4] == "18 joints; yourdfpy and Pinocchio agree: True"
    assert printed[5] == "12 joints; the same foot as Pinocchio: True and a Jacobian (3, 12)"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("pinocchio_closure", "mobility 3, 6 redundant"),
        pytest.param("close_the_loop", "verdict: ambiguous", marks=pytest.mark.thorough),
    ],
)
def test_an_example_runs_in_forty_five_lines(
    name: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(__file__).parents[1] / "examples" / f"{name}.py"
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 45
    exec(compile(text, str(path), "exec"), {"__file__": str(path), "__name__": "__main__"})
    assert expected in capsys.readouterr().out
