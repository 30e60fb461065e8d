"""``Machine``: what a user keeps, against the reduction; and its velocity transmission factors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide import reduction
from orthoglide.errors import InputError
from orthoglide.geometry import Geometry
from orthoglide.machine import Machine
from orthoglide.mechanism.tree import PASSIVE_NAMES

NOMINAL = Machine.nominal()


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


# -- velocity transmission factors, and eq. (1) of the 2008 chapter --------------------------------


MACHINE = og.Machine.nominal()


def test_factors_are_one_at_mechanical_zero_and_those_of_eq_5_elsewhere() -> None:
    assert np.abs(og.transmission_factors(None, [0, 0, 0]) - 1).max() < 1e-12
    p = np.random.default_rng(0).uniform(-0.05, 0.03, (20, 3))
    jacobian = reduction.jacobians(p, reduction.inverse(p)).rho
    expected = np.linalg.svd(jacobian, compute_uv=False)
    assert np.abs(og.transmission_factors(MACHINE, p) - expected).max() < 1e-9


def test_the_cube_of_the_chapter_does_not_fit_its_stroke() -> None:
    """2008, 2.1: 139 mm fit, with factors from 0.65 to 1.67; 200 mm need far more travel."""
    fits = og.transmission_over_cube(MACHINE, 0.139, np.full(3, -0.0095))
    assert fits.within_stroke
    assert (round(fits.smallest, 2), round(fits.largest, 2)) == (0.65, 1.67)
    wide = og.transmission_over_cube(MACHINE, 0.199, np.full(3, -0.0275))
    assert not wide.within_stroke
    assert wide.travel[0] < -0.18
    assert wide.travel[1] > 0.07
    assert wide.smallest > 0.49
    assert wide.largest < 2.05
    assert not og.transmission_over_cube(MACHINE, 0.141, np.full(3, -0.0095)).within_stroke


def test_the_factors_of_a_delta_are_those_of_its_jacobian() -> None:
    geometry = og.Geometry(0.36, 0.05, 0.03, (-0.2, 0.2), og.LinearDelta((0.174,) * 3))
    found = og.transmission_over_cube(geometry, 0.1, (0, 0, 0.05), count=3)
    corner = og.transmission_factors(geometry, [0.05, 0.05, 0.1])
    assert found.smallest <= corner.min()
    assert found.largest >= corner.max()


def test_the_chapters_cube_is_right_for_the_mechanism_and_needs_more_travel() -> None:
    """Corners at -L / sqrt(6) and L / sqrt(18): there the factors along the diagonal are 1/2, 2."""
    L = MACHINE.geometry.L
    low, high = -L / np.sqrt(6), L / np.sqrt(18)
    for count in (2, 9):
        found = og.transmission_over_cube(MACHINE, high - low, np.full(3, (low + high) / 2), count)
        assert found.smallest == pytest.approx(0.5, abs=1e-9)
        assert found.largest == pytest.approx(2.0, abs=1e-9)
        # A drive goes furthest on its own axis, where it moves as far as the tool does.
        assert found.travel == pytest.approx((-L - low, high), abs=1e-12)


@pytest.mark.parametrize("side", [0.0, -0.1, np.nan])
def test_a_cube_without_a_side_is_refused(side: float) -> None:
    with pytest.raises(og.InputError, match="positive side"):
        og.transmission_over_cube(MACHINE, side)


def test_passive_joints_are_the_angles_of_equation_1() -> None:
    """The chapter prints ``p_x = rho_x + cos theta cos beta L + r``; the bar points from the
    carriage back to the TCP, so the sign is the other, and r is part of rho.
    """
    mechanism, p = og.Mechanism(), np.array([0.01, -0.03, 0.02])
    rho, L = reduction.inverse(p), og.Geometry().L
    passive = mechanism.close(rho).q[mechanism.tree.passive].reshape(3, len(PASSIVE_NAMES))
    theta, beta = (passive[:, PASSIVE_NAMES.index(name)] for name in ("theta", "bar1"))
    for k in range(3):  # by the leg's own axes, which are base axes in cyclic order
        a, b, c = np.roll(p, -k)
        chain = rho[k] - L * np.cos(theta[k]) * np.cos(beta[k])
        assert chain == pytest.approx(a, abs=1e-12)
        assert -L * np.sin(theta[k]) * np.cos(beta[k]) == pytest.approx(b, abs=1e-12)
        assert L * np.sin(beta[k]) == pytest.approx(c, abs=1e-12)
