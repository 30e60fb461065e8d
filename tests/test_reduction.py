"""The analytic reduction: its tests are its equations."""

from __future__ import annotations

import runpy
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from orthoglide import reduction
from orthoglide.errors import InputError, NumericsError, UnreachableError
from orthoglide.geometry import Geometry

ROOT = Path(__file__).resolve().parents[1]
MACHINE = Geometry()
L = MACHINE.L
MISPRINTS = runpy.run_path(str(ROOT / "docs" / "tables" / "misprints.py"))

travels = arrays(float, 3, elements=st.floats(-0.100, 0.060))
shifts = arrays(float, 3, elements=st.floats(-0.004, 0.004))
# For differences: the corner (60, 60, 60) of the stroke is 10 mm from a singular posture.
inner = arrays(float, 3, elements=st.floats(-0.100, 0.045))
legs = st.integers(0, 2)
properties = settings(max_examples=25, deadline=None)


def differences(function, x, step=1e-4):
    """Sixth-order central differences, the derivative's index last."""
    columns = []
    for e in np.eye(len(x)) * step:
        stencil = [
            w * (function(x + k * e) - function(x - k * e)) for k, w in ((1, 45), (2, -9), (3, 1))
        ]
        columns.append(sum(stencil) / (60 * step))
    return np.stack(columns, axis=-1)


def sphere_error(p, rho, offsets=0.0, lengths=0.0):
    centres = (np.asarray(rho) + offsets)[..., None] * np.eye(3)
    return np.linalg.norm(np.asarray(p)[..., None, :] - centres, axis=-1) - (L + lengths)


# --- kinematics ---------------------------------------------------------------------------------


@properties
@given(travels, shifts, shifts)
def test_forward_meets_the_spheres_and_inverse_undoes_it(travel, offsets, lengths):
    rho = L + travel
    p = reduction.forward(rho, offsets, lengths)
    np.testing.assert_allclose(sphere_error(p, rho, offsets, lengths), 0, atol=2e-15)
    np.testing.assert_allclose(reduction.inverse(p, offsets, lengths), rho, atol=2e-15)


@properties
@given(arrays(float, 3, elements=st.floats(-0.12, 0.12)), shifts, shifts)
def test_all_eight_configurations_hold_the_same_tcp(p, offsets, lengths):
    signs = list(product((1, -1), repeat=3))
    rho = reduction.inverse(p, offsets, lengths, signs=signs)
    assert rho.shape == (8, 3)
    assert len({tuple(np.round(r, 6)) for r in rho}) == 8
    np.testing.assert_allclose(sphere_error(p, rho, offsets, lengths), 0, atol=2e-15)
    np.testing.assert_array_equal(np.sign(rho + offsets - p), signs)
    assume(np.all(np.abs(rho + offsets) > 1e-3))
    both = [reduction.forward(rho, offsets, lengths, mode=mode) for mode in ("machine", "other")]
    nearest = np.min([np.linalg.norm(q - p, axis=-1) for q in both], axis=0)
    assert nearest.max() < 1e-10


def test_root_at_mechanical_zero():
    np.testing.assert_array_equal(reduction.forward(MACHINE.zero), np.zeros(3))
    plus = reduction.forward(MACHINE.zero, mode="other")
    np.testing.assert_allclose(plus, 2 * L / 3, rtol=1e-15)


@pytest.mark.parametrize("tiny", [1e-6, 1e-9, 1e-12, 1e-15])
def test_no_cancellation_near_zero(tiny):
    # p = offset - length + O(tiny^2): eq. (7), to the last digits however small.
    p = reduction.forward(MACHINE.zero + tiny * np.array([1.0, -2.0, 3.0]))
    given = (MACHINE.zero + tiny * np.array([1.0, -2.0, 3.0])) - MACHINE.zero
    np.testing.assert_allclose(p, given, rtol=30 * tiny + 1e-14)


@properties
@given(inner, shifts, shifts)
def test_jacobians_are_the_derivatives(travel, offsets, lengths):
    rho = L + travel
    p = reduction.forward(rho, offsets, lengths)
    j_rho, j_lengths = reduction.jacobians(p, rho, offsets, lengths)
    np.testing.assert_allclose(
        j_rho, differences(lambda x: reduction.forward(rho, x, lengths), offsets), atol=2e-10
    )
    np.testing.assert_allclose(
        j_lengths, differences(lambda x: reduction.forward(rho, offsets, x), lengths), atol=2e-10
    )
    np.testing.assert_array_equal(reduction.jacobians(p, rho, offsets).rho, j_rho)
    printed = (p - np.diag(rho + offsets)) / (p - rho - offsets)[:, None]
    np.testing.assert_allclose(j_rho @ printed, np.eye(3), atol=1e-12)


def test_jacobians_of_the_special_postures_are_the_printed_ones():
    zero = np.hstack(reduction.jacobians(np.zeros(3), MACHINE.zero))
    np.testing.assert_allclose(zero, np.hstack([np.eye(3), -np.eye(3)]), atol=1e-15)
    for posture, angle in zip(("xmax", "xmin"), reduction.stroke_angles(), strict=True):
        rho = MACHINE.command(posture)
        t, c = np.tan(angle), 1 / np.cos(angle)
        expected = [[1, 0, 0, -1, 0, 0], [t, 1, 0, -t, -c, 0], [t, 0, 1, -t, 0, -c]]
        found = np.hstack(reduction.jacobians(reduction.forward(rho), rho))
        np.testing.assert_allclose(found, expected, atol=1e-14)  # eq. (8)


def test_batches_are_the_single_poses():
    rng = np.random.default_rng(1)
    rho = L + rng.uniform(-0.1, 0.06, (5000, 2, 3))  # more than one block
    offsets, lengths = rng.normal(0, 1e-3, (2, 3)), rng.normal(0, 1e-4, (5000, 1, 3))
    p = reduction.forward(rho, offsets, lengths)
    assert p.shape == rho.shape
    for i, j in ((0, 0), (4095, 1), (4999, 0)):
        np.testing.assert_allclose(
            p[i, j], reduction.forward(rho[i, j], offsets[j], lengths[i, 0]), atol=1e-16
        )
        single = reduction.jacobians(p[i, j], rho[i, j], offsets[j], lengths[i, 0])
        for whole, one in zip(reduction.jacobians(p, rho, offsets, lengths), single, strict=True):
            np.testing.assert_allclose(whole[i, j], one, atol=1e-15)
    np.testing.assert_allclose(reduction.inverse(p, offsets, lengths), rho, atol=2e-15)
    assert reduction.forward(np.empty((0, 3))).shape == (0, 3)


# --- what cannot be reached ---------------------------------------------------------------------


def test_what_is_out_of_reach_is_named_by_its_index():
    p = np.zeros((4, 2, 3))
    p[2, 1, 1] = L + 0.012
    with pytest.raises(UnreachableError, match=r"at index \(2, 1\)") as caught:
        reduction.inverse(p)
    assert caught.value.index == (2, 1)
    rho = np.tile(MACHINE.zero, (3, 2, 1))
    rho[1, 0, 2] = rho[2, 1, 0] = 3 * L
    with pytest.raises(UnreachableError, match="2 of the batch fail") as caught:
        reduction.forward(rho)
    assert caught.value.index == (1, 0)
    with pytest.raises(UnreachableError):
        reduction.forward(MACHINE.zero, 0.0, [0.6, 0.0, 0.0])
    with pytest.raises(UnreachableError):
        reduction.intersect_spheres(np.eye(3), L)


def test_legs_that_just_touch_are_reachable():
    # The largest equal command: the TCP in the plane of the carriages.
    lengths = np.linspace(-0.05, 0.05, 301)[:, None] * np.ones(3)
    rho = np.sqrt(1.5) * (L + lengths)
    np.testing.assert_allclose(reduction.forward(rho, 0.0, lengths), rho / 3, atol=1e-7)
    centres = rho[..., None] * np.eye(3)
    np.testing.assert_allclose(
        reduction.intersect_spheres(centres, L + lengths), rho / 3, atol=1e-7
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda: reduction.forward(np.zeros(2)),
        lambda: reduction.forward([np.nan, L, L]),
        lambda: reduction.forward([0.0, L, L]),
        lambda: reduction.forward(MACHINE.zero, mode="plus"),
        lambda: reduction.inverse([np.nan, 0, 0]),
        lambda: reduction.inverse(np.zeros(3), signs=(1, 0, 1)),
        lambda: reduction.intersect_spheres(np.zeros((3, 3)), np.ones(3)),
        lambda: reduction.intersect_spheres(np.zeros((3, 2)), np.ones(3)),
        lambda: reduction.predict_readings(MACHINE.zero, 0, 0, L / 2).values,
        lambda: (
            reduction.predict_readings(np.tile(MACHINE.zero, (2, 1)), [0, 1, 2], 1, L / 2).values
        ),
        lambda: reduction.solve(reduction.system11(), np.zeros(11)),
        lambda: reduction.system11().select("axis_tilt"),
        lambda: reduction.system11().ordered({"x_y+": 0.0}),
    ],
)
def test_bad_input_is_an_input_error_with_a_message(call):
    with pytest.raises(InputError) as caught:
        call()
    assert len(str(caught.value)) > 20
    assert not isinstance(caught.value, UnreachableError)


def test_singular_postures_have_no_jacobian():
    rho = np.full(3, np.sqrt(1.5) * L)
    p = rho / 3
    with pytest.raises(NumericsError, match="plane of the carriages"):
        reduction.jacobians(p, rho)


# --- readings -----------------------------------------------------------------------------------


@properties
@given(
    st.floats(0.01, 0.15),
    st.floats(-0.15, -0.01),
    shifts,
    shifts,
)
def test_system_11_is_the_small_error_limit_of_the_nonlinear_deviations(
    high, low, offsets, lengths
):
    machine = Geometry(stroke=(low, high))
    system = reduction.system11(machine)
    direction = np.concatenate([offsets, lengths])
    assume(np.linalg.norm(direction) > 1e-4)
    direction = direction / np.linalg.norm(direction)
    deviations = _deviations(system.rows, machine)

    def along(s):
        return deviations(s[0] * direction)

    limit = differences(along, np.zeros(1))[:, 0]
    scale = np.abs(system.matrix).max()
    np.testing.assert_allclose(limit, system.matrix @ direction, atol=3e-11 * max(scale, 1))


def _postures(rows, machine):
    """Commands, legs and axes of the rows' postures, and of Zero."""
    leg = np.array(["xyz".index(row[2]) for row in rows])
    axes = np.array(["xyz".index(row[0]) for row in rows])
    ends = [machine.command(row[2] + {"+": "max", "-": "min"}[row[3]]) for row in rows]
    return np.array(ends), np.tile(machine.zero, (len(rows), 1)), leg, axes


def _deviations(rows, machine):
    ends, zeros, leg, axes = _postures(rows, machine)

    def function(six):
        return np.subtract(
            *(
                reduction.predict_readings(c, leg, axes, L / 2, six[:3], six[3:]).values
                for c in (ends, zeros)
            )
        )

    return function


def test_system_11_is_laid_out_as_printed():
    (a1, b1, c1), (a2, b2, c2) = (
        reduction.coefficients(angle) for angle in reduction.stroke_angles()
    )
    system = reduction.system11()
    np.testing.assert_array_equal(system.matrix[0], [a1, b1, 0, -c1, -b1, 0])
    np.testing.assert_array_equal(system.matrix[7], [0, b2, a2, 0, -b2, -c2])
    np.testing.assert_array_equal(system.matrix[9], [b1, 0, a1, -b1, 0, -c1])
    assert system.rows == tuple(
        f"{row}{sign}"
        for pair in (("x_y", "y_x"), ("y_z", "z_y"), ("x_z", "z_x"))
        for sign in "+-"
        for row in pair
    )
    assert system.columns == reduction.COLUMNS
    singular = np.linalg.svd(system.matrix)[1]
    np.testing.assert_allclose(singular, [1.012, 0.683, 0.683, 0.0166, 0.0164, 0.0164], rtol=4e-3)


def test_covariance_is_that_of_simulated_readings():
    rng = np.random.default_rng(5)
    system, sigma, count = reduction.system8(), 0.01, 20_000
    sign = {"+": 0, "-": 1}
    setups = {row[:3]: rng.normal(0, sigma, (3, count)) for row in system.rows}
    noise = np.array([setups[r[:3]][sign[r[3]]] - setups[r[:3]][2] for r in system.rows])
    estimates = np.linalg.pinv(system.matrix) @ noise
    found, expected = np.cov(estimates), reduction.covariance(system, sigma)
    np.testing.assert_allclose(found, expected, atol=0.04 * expected.max())
    both = np.sqrt(np.diag(reduction.covariance(reduction.system11(), 0.01)))
    np.testing.assert_allclose(both, 0.727, atol=2e-3)


# --- the published numbers ----------------------------------------------------------------------


@pytest.mark.parametrize("which", ["offsets", "lengths", "offsets+lengths"])
def test_table_3(which):
    published = MISPRINTS["published"]()["table3_mm"][which]
    system = reduction.system11().select(MISPRINTS["SETS"][which])
    fit = reduction.solve(system, system.ordered(MISPRINTS["table2"]("2")))
    expected = published.get("joint_offset", []) + published.get("leg_length", [])
    # All six together: the weak directions amplify the rounding of the data sixtyfold.
    np.testing.assert_allclose(fit.values, expected, atol=0.35 if "+" in which else 0.01)
    if "+" not in which:
        assert f"{fit.rms:.2f}" == f"{published['rms']:.2f}"


@pytest.mark.parametrize("experiment", ["2", "3"])
def test_table_2(experiment):
    data = MISPRINTS["table2"](experiment)
    published = MISPRINTS["published"]()["table2_rms_mm"][experiment]
    assert f"{MISPRINTS['rms'](data.values()):.2f}" == f"{published['data']:.2f}"
    if experiment == "3":
        data["x_z-"] = -0.13
    slips = {(e, w): row for e, w, row in MISPRINTS["SLIPS"]}
    for which in MISPRINTS["SETS"]:
        column = MISPRINTS["columns"](experiment, which)
        if (experiment, which) in slips:
            column[slips[experiment, which]] *= -1
        ours = MISPRINTS["fitted"](data, which)
        for row, value in column.items():
            assert ours[row] == pytest.approx(value, abs=0.011), (which, row)
        if "+" not in which:
            residual = MISPRINTS["rms"](data[row] - ours[row] for row in data)
            assert f"{residual:.2f}" == f"{published[which]:.2f}"


@pytest.mark.parametrize("experiment", ["1", "2", "3"])
def test_table_1(experiment):
    data = MISPRINTS["table1"](experiment)
    if experiment == "1":
        data["x_z"] = 1.48
    expected = MISPRINTS["published"]()["table1_expected_residual_mm"][experiment]
    system = reduction.reduced_system().select("offsets")
    fit = reduction.solve(system, system.ordered(data))
    for row, residual in zip(system.rows, fit.residuals, strict=True):
        assert residual == pytest.approx(expected[row.replace("_", "")], abs=0.006)
    assert fit.rms == pytest.approx(expected["rms"], abs=0.006)


# --- the house ----------------------------------------------------------------------------------


def test_misprints_of_the_page_are_fresh():
    page = (ROOT / "docs" / "published-experiments.md").read_text(encoding="utf-8")
    assert MISPRINTS["markdown"]() in page, "stale: python docs/tables/misprints.py --markdown"


def test_every_sign_slip_and_misprint_is_on_the_page():
    assert len(MISPRINTS["MISPRINTS"]) == len({one().where for one in MISPRINTS["MISPRINTS"]})
    for experiment, which, row in MISPRINTS["SLIPS"]:
        printed = MISPRINTS["columns"](experiment, which)[row]
        data = MISPRINTS["table2"](experiment)
        if experiment == "3":
            data["x_z-"] = -0.13
        assert MISPRINTS["fitted"](data, which)[row] == pytest.approx(-printed, abs=0.006)
