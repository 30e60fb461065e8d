"""``Machine``: what a user keeps. Against the reduction, the independent machine, and itself."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orthoglide.effects import CATALOGUE
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Geometry
from orthoglide.layout import LinearDelta
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile

NOMINAL = Machine.nominal()
DELTA = Geometry(0.27, 0.05, 0.032, (-0.2, 0.1), LinearDelta((0.14,) * 3, tool=(0, 0, -0.04)))
ERRORS = {
    "joint_offset.x": 1e-3, "joint_offset.z": -7e-4, "leg_length.y": 1e-4,
    "axis_tilt.y.z": 2e-3, "rail_bow.x.y": 1e-4, "bar_mismatch.x": 3e-4,
    "mount_tilt.z.a": 2e-3, "encoder_scale.y": 1e-3, "backlash.x": 5e-5,
}  # fmt: skip
CROOKED = NOMINAL.with_parameters(ERRORS)


def commands(n: int, seed: int = 0) -> np.ndarray:
    low, high = Geometry().stroke
    return Geometry().L + np.random.default_rng(seed).uniform(low, high, (n, 3))


@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3), (0,)])
def test_batches(shape: tuple[int, ...]) -> None:
    rho = commands(int(np.prod(shape, dtype=int))).reshape(*shape, 3)
    assert CROOKED.forward(rho).shape == (*shape, 3)
    assert CROOKED.pose(rho).R.shape == (*shape, 3, 3)
    assert CROOKED.jacobian(rho).shape == (*shape, 3, 3)
    each = [CROOKED.forward(one) for one in rho.reshape(-1, 3)]
    if each:
        assert np.allclose(CROOKED.forward(rho).reshape(-1, 3), each, rtol=0, atol=1e-14)


@pytest.mark.parametrize("machine", [NOMINAL, Machine(MachineFile(geometry=DELTA))])
def test_jacobian_by_differences_under_a_load(machine: Machine) -> None:
    """The load's force on a drive depends on the command."""
    names = machine.geometry.leg_names
    soft = machine.with_parameters({f"drive_compliance.{leg}": 1e-5 for leg in names[:2]})
    rho, h = machine.geometry.zero + commands(4) - NOMINAL.geometry.zero, 1e-5
    for axis in range(3):
        step = h * np.eye(3)[axis]
        ends = (soft.forward(rho + side * step, load=100.0) for side in (1, -1))
        slope = np.subtract(*ends) / (2 * h)
        assert np.allclose(soft.jacobian(rho, load=100.0)[..., axis], slope, rtol=0, atol=1e-8)


def test_save_and_load(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    sigmas = {"joint_offset.x": 2e-6, "axis_tilt.y.z": 1e-5}
    NOMINAL.with_parameters(ERRORS, sigmas).save(path)
    back = Machine.load(path)
    assert back.values == ERRORS
    assert {n: back.spec.parameters[n].sigma for n in sigmas} == sigmas
    assert back.geometry == NOMINAL.geometry
    assert np.array_equal(back.forward(commands(5)), CROOKED.forward(commands(5)))


def test_save_overwrites_only_when_told(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    NOMINAL.save(path)
    with pytest.raises(FileError, match="overwritten"):
        CROOKED.save(path)
    CROOKED.save(path, overwrite=True)
    assert Machine.load(path).values == ERRORS


@pytest.mark.parametrize("other", ["axis_tilt.y.y", "axis_tilt.cyclic"])
def test_load_refuses_unknown_parameters(other: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    CROOKED.save(path)
    path.write_text(path.read_text().replace("axis_tilt.y.z", other))
    with pytest.raises(InputError, match=re.escape(other)):
        Machine.load(path)


def test_with_parameters_leaves_the_machine_as_it_was() -> None:
    before = dict(CROOKED.values)
    more = CROOKED.with_parameters({"joint_offset.y": 2e-3, "joint_offset.x": 5e-3})
    assert CROOKED.values == before
    assert more.values == before | {"joint_offset.y": 2e-3, "joint_offset.x": 5e-3}


def test_structured_members_set_what_they_stand_for() -> None:
    machine = NOMINAL.with_parameters({"axis_tilt.cyclic": 1e-3}, {"axis_tilt.cyclic": 1e-4})
    signs = {"x.y": 1, "y.z": 1, "z.x": 1, "y.x": -1, "z.y": -1, "x.z": -1}
    assert machine.values == {f"axis_tilt.{k}": 1e-3 * s for k, s in signs.items()}
    assert all(entry.sigma == 1e-4 for entry in machine.spec.parameters.values())
    assert CATALOGUE.elementary_weights("leg_length.common") == dict.fromkeys(
        ("leg_length.x", "leg_length.y", "leg_length.z"), 1.0
    )
    assert CATALOGUE.elementary_weights("joint_offset.x") == {"joint_offset.x": 1.0}


@pytest.mark.parametrize(
    ("values", "sigmas", "told"),
    [
        ({"joint_offset.x@april": 1e-3}, {}, "campaign april has for itself"),
        ({"joint_offset.x": 1e-3}, {"joint_offset.x": -1e-6}, "0 or more, not -1e-06"),
        ({"joint_offset.x": 1e-3}, {"joint_offset.x": float("nan")}, "0 or more, not nan"),
        ({"joint_offset.x": 1e-3}, {"joint_offset.y": 1e-6}, "joint_offset.y, which is not set"),
        ({"axis_tilt.y.z": 2.5}, {}, "= 2.5 rad is 2500 times its tolerance of 0.001 rad: is it"),
        ({"leg_length.x": 0.3}, {}, "= 300 mm is 6000 times its tolerance of 0.05 mm: is it"),
        ({"leg_length.x": 0.05}, {}, "= 50 mm is 1000 times its tolerance"),
        ({"joint_offset.x": 0.1}, {}, "= 100 mm is 50 times its tolerance of 2 mm: is it meant in"),
        ({"rail_bow.x.z": 0.02}, {}, "= 20 mm is 1000 times its tolerance of 0.02 mm"),
        ({"joint_offset.x": "0.5e-3"}, {}, "joint_offset.x must be a number, not '0.5e-3'"),
    ],
)
def test_with_parameters_says_what_is_wrong(
    values: Any, sigmas: dict[str, float], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        NOMINAL.with_parameters(values, sigmas)


@pytest.mark.parametrize(
    ("seen", "told"),
    [
        ({"approach": [10, 0, 0]}, r"\+1 or -1"),
        ({"approach": 0.5}, r"\+1 or -1"),
        ({"approach": [1, 1]}, r"approach must be numbers of the shape \(2, 3\)"),
        ({"time": [1, 2, 3]}, r"time must be numbers of the shape \(2,\)"),
        ({"load": "heavy"}, "load must be numbers"),
        ({"load": float("nan")}, "load must be finite"),
        ({"warming": None}, "warming must be finite"),
    ],
)
def test_refuses_what_is_no_condition(seen: dict[str, Any], told: str) -> None:
    for ask in (NOMINAL.forward, NOMINAL.jacobian, NOMINAL.bar_tensions, NOMINAL.inverse):
        with pytest.raises(InputError, match=told):
            ask([[0.31] * 3, [0.32] * 3] if ask != NOMINAL.inverse else np.zeros((2, 3)), **seen)


def test_what_several_members_say_of_one_parameter_is_added() -> None:
    both = {"axis_tilt.cyclic": 1e-3, "axis_tilt.xy.symmetric": 1e-3}
    for values in (both, dict(reversed(both.items()))):
        found = NOMINAL.with_parameters(values, dict.fromkeys(values, 3e-4))
        assert found.values["axis_tilt.x.y"] == pytest.approx(2e-3)
        assert found.values["axis_tilt.y.x"] == pytest.approx(0.0)
        assert found.spec.parameters["axis_tilt.x.y"].sigma == pytest.approx(3e-4 * np.sqrt(2))
        again = found.with_parameters({"axis_tilt.x.y": 5e-4})
        assert again.values["axis_tilt.x.y"] == 5e-4


def test_a_machine_of_other_dimensions() -> None:
    found = Machine.of(Geometry(0.25, 0.06, 0.02))
    assert (found.geometry.L, found.tolerance("joint_offset")) == (0.25, 2e-3)
    with pytest.raises(InputError, match=r"must be a MachineFile, .* not a Geometry"):
        Machine(Geometry(0.25, 0.06, 0.02))  # type: ignore[arg-type]
