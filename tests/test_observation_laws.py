"""Laws that hold for every kind of reading, whatever its formula is.

Kinds come from the registry; a new one needs an entry in `tests.observation_examples` and nothing
here.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import FileError, InputError
from orthoglide.fit.factors import Factor
from orthoglide.fit.noise import noise_of
from orthoglide.fit.solving import Method
from orthoglide.instruments import (
    OBSERVATIONS,
    InstrumentPose,
    InstrumentPriors,
    Observation,
    Setup,
)
from orthoglide.machine import Machine
from orthoglide.machine_file import Instrument
from orthoglide.observations import Readings, concatenated, read_campaign, write_campaign
from orthoglide.observations.schema import COLUMNS
from orthoglide.prediction import MeasurementModel
from tests.factors import same_readings
from tests.observation_examples import (
    BALL,
    CASES,
    EXAMPLES,
    MACHINES,
    ORTHOGLIDE,
    TRUE,
    Array,
    poses_of,
    sheet_of,
)
from tests.relabelling import legs_renamed, relabelled
from tests.rig_delta import DeltaRig

KINDS = list(OBSERVATIONS)
every = pytest.mark.parametrize(("kind", "layout"), CASES, ids=[f"{k}-{w}" for k, w in CASES])

# Every kind on one layout in the first tier, the layouts in turn, and on both in the thorough one.
LAYOUTS = [[w for k, w in CASES if k == kind] for kind in KINDS]
FIRST = {
    (kind, own[k % len(own) - 1]) for k, (kind, own) in enumerate(zip(KINDS, LAYOUTS, strict=True))
}
ONCE = [
    pytest.param(*case, id="-".join(case), marks=[] if case in FIRST else pytest.mark.thorough)
    for case in CASES
]
once = pytest.mark.parametrize(("kind", "layout"), ONCE)


def test_every_kind_has_an_example() -> None:
    assert set(EXAMPLES) == set(OBSERVATIONS)
    for kind, example in EXAMPLES.items():
        assert {s.kind for s in example.setups} == {kind}


def stands_of(kind: str, readings: Readings) -> tuple[InstrumentPose, ...]:
    """Instruments in the base frame, their ball where the example has it."""
    ball = BALL if OBSERVATIONS[kind].about_ball else np.zeros(3)
    return (InstrumentPose(ball_centre=ball),) * len(readings.setups)


def drawn(kind: str, readings: Readings, size: float = 1e-3) -> Array:
    """Some nuisances of every setup ``(setups, K)``."""
    shape = (len(readings.setups), OBSERVATIONS[kind].nuisance_count)
    return size * np.random.default_rng(3).uniform(0.3, 1.0, shape)


def filled(kind: str, layout: str, machine: Machine | None = None, **more: object) -> Readings:
    """An example sheet with exact readings, or such as ``simulate`` draws."""
    sheet = sheet_of(kind, layout, repeats=int(more.pop("repeats", 1)))
    true = machine or MACHINES[layout].with_parameters(TRUE[layout])
    return og.simulate(true, sheet, **(more or {"exact": True}))


# -- the formula -----------------------------------------------------------------------------------


@every
def test_a_reading_is_what_an_independent_machine_shows(kind: str, layout: str) -> None:
    """A machine with errors of every sort, posed by other equations, read by hand."""
    sheet, machine = sheet_of(kind, layout), MACHINES[layout]
    for errors in ({}, TRUE[layout]):
        shown = MeasurementModel(sheet, lifted(kind, sheet, machine, errors)).predict(
            machine.model, errors
        )
        by_hand = EXAMPLES[kind].by_hand(poses_of(layout, sheet, errors), sheet)
        assert np.abs(shown - by_hand).max() < 1e-11


def lifted(
    kind: str, sheet: Readings, machine: Machine, errors: dict[str, float]
) -> tuple[InstrumentPose, ...]:
    """The example's stands, with how much higher a place beside the tool is in the mean."""
    R = machine.model.outputs(errors, MeasurementModel(sheet).conditions()).R[: len(sheet)]
    lift = np.einsum("nij,nj->ni", R, sheet.beside)[:, 2]
    return tuple(
        replace(stand, mean_lift=float(lift[sheet.setup == k].mean()))
        for k, stand in enumerate(stands_of(kind, sheet))
    )


STENCIL = ((1, 8 / 12), (-1, -8 / 12), (2, -1 / 12), (-2, 1 / 12))
"""Central difference of the fourth order: its own error is h^4 f''''' / 30, below 1e-12 here."""


@every
def test_derivatives_are_those_of_the_reading(kind: str, layout: str) -> None:
    """By all parameters of the machine and of the instruments, and by nuisances.

    Steps are a tenth of a tolerance; a closed pose is good to 1e-15 m, so the difference is good to
    that over the step, 1e-15 / 1e-7.
    """
    machine, sheet = MACHINES[layout], sheet_of(kind, layout)
    observation, nuisances = OBSERVATIONS[kind], drawn(kind, sheet)
    model, place = machine.model, sheet.command[:, :2] * 3
    stands = stands_of(kind, sheet)
    seen = MeasurementModel(sheet, stands, place, nuisances)
    own = [n for s in sheet.setups for n in model.instrument_parameters(observation, s.name)]
    needless = ("screw_error", "thermal", "drive_compliance")
    of_machine = [p for p in machine.catalogue.parameters if not p.startswith(needless)]
    values = TRUE[layout] | {n: 0.3 * machine.tolerance(n) for n in own}
    names = [*of_machine, *own]
    linear = seen.linearise(model, values, names)
    assert np.abs(linear.value - seen.predict(model, values)).max() < 1e-14
    assert np.abs(linear.jacobian).max(axis=0).any()
    for column, name in zip(linear.jacobian.T, names, strict=True):
        step = 0.1 * machine.tolerance(name)
        shown = sum(
            w * seen.predict(model, values | {name: values.get(name, 0.0) + k * step})
            for k, w in STENCIL
        )
        assert np.abs(shown / step - column).max() < 1e-13 / step + 1e-8, name
    for setup in range(len(sheet.setups)):
        for j in range(observation.nuisance_count):
            shown = np.zeros(len(sheet))
            for k, w in STENCIL:
                moved = nuisances.copy()
                moved[setup, j] += k * 1e-4
                shown += w * MeasurementModel(sheet, stands, place, moved).predict(model, values)
            expected = linear.reading_poses.nuisance_jacobian[:, j] * (sheet.setup == setup)
            assert np.abs(shown / 1e-4 - expected).max() < 1e-9


# -- rigid motion ----------------------------------------------------------------------------------


def shifted(layout: str, t: Array) -> dict[str, float]:
    """Parameters of a machine that stands ``t`` beside its place: exactly, on nominal rails."""
    if layout == "orthoglide":
        found = {f"joint_offset.{i}": t[k] for k, i in enumerate("xyz")}
        return found | {
            f"axis_offset.{i}.{j}": t[k] for i in "xyz" for k, j in enumerate("xyz") if i != j
        }
    found = {f"joint_offset.{leg}": t[2] for leg in "abc"}
    for leg, angle in zip("abc", np.deg2rad(DeltaRig().angles), strict=True):
        out = np.array([np.cos(angle), np.sin(angle)])
        found[f"axis_offset.{leg}.radial"] = out @ t[:2]
        found[f"axis_offset.{leg}.tangential"] = out[0] * t[1] - out[1] * t[0]
    return found


def turned_about_z(angle: float, t: Array) -> dict[str, float]:
    """Parameters of a delta turned about z, then shifted: exactly."""
    rig, found = DeltaRig(), shifted("delta", t)
    for leg in "abc":
        found[f"axis_offset.{leg}.radial"] += rig.radius * (np.cos(angle) - 1)
        found[f"axis_offset.{leg}.tangential"] += rig.radius * np.sin(angle)
        found[f"mount_tilt.{leg}.a"] = angle
    return found


SHIFT = np.array([7e-4, -5e-4, 4e-4])


def together(first: dict[str, float], second: dict[str, float]) -> dict[str, float]:
    return {n: first.get(n, 0.0) + second.get(n, 0.0) for n in {*first, *second}}


@every
def test_machine_and_instrument_moved_together_read_the_same(kind: str, layout: str) -> None:
    """A delta also turned about z, by three degrees, and its instrument with it.

    Dials on legs stay where they are: a shift across the leg is their datum, along it their place.
    """
    machine, sheet = MACHINES[layout], sheet_of(kind, layout)
    angle = np.deg2rad(3.0) if layout == "delta" else 0.0
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    lengths = {"leg_length.a": 5e-5, "leg_length.c": -8e-5} if layout == "delta" else {
        "joint_offset.x": 6e-4, "leg_length.y": 5e-5, "leg_length.z": -4e-5
    }  # fmt: skip
    stands, nuisances = stands_of(kind, sheet), drawn(kind, sheet)
    before = MeasurementModel(sheet, stands, nuisance_values=nuisances).predict(
        machine.model, lengths
    )
    own = shifted(layout, SHIFT) if layout == "orthoglide" else turned_about_z(angle, SHIFT)
    values = together(own, lengths)
    if layout == "delta":  # whose offsets and lengths turn with it
        p, moved = machine.forward(sheet.command), machine.with_parameters(own)
        assert np.abs(moved.forward(sheet.command) - (p @ R.T + SHIFT)).max() < 1e-12
    each = [EXAMPLES[kind].carried(s, n, R, SHIFT) for s, n in zip(stands, nuisances, strict=True)]
    carried = np.array([n for _, n in each])
    if OBSERVATIONS[kind].dials == 1:
        for k, setup in enumerate(sheet.setups):
            carried[k] += [-setup.sign * SHIFT[setup.axis], SHIFT[setup.leg]]
    after = MeasurementModel(sheet, [s for s, _ in each], nuisance_values=carried).predict(
        machine.model, values
    )
    assert np.abs(after - before).max() < 1e-11


@every
def test_what_moves_as_a_whole_is_taken_up_by_nuisances(kind: str, layout: str) -> None:
    """A machine that stands elsewhere is no error: what instruments show of it is in the columns
    of their nuisances, to the second order of the motion.
    """
    machine = MACHINES[layout]
    sheet = sheet_of(kind, layout)
    sheet = og.simulate(machine, sheet, exact=True)
    factor = Factor.from_readings(
        sheet, machine, noise_of([sheet], machine.spec)[1][0], InstrumentPriors(1.0, 1.0)
    )
    motions = [(shifted(layout, SHIFT), np.linalg.norm(SHIFT) ** 2 / 0.05)]
    if layout == "delta":
        motions.append((turned_about_z(2e-3, SHIFT), (2e-3) ** 2))
    for motion, second_order in motions:
        at = factor.linearise(machine.model, {}, ())
        shown = factor.predict(machine.model, motion) - at.value
        columns = factor.nuisances(at.reading_poses).columns
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        kept = columns / size @ np.linalg.lstsq(columns / size, shown, rcond=1e-10)[0]
        assert np.abs(shown - kept).max() < max(second_order, 1e-13)


# -- units and signs -------------------------------------------------------------------------------


@every
def test_files_are_in_millimetres_and_milliradians(kind: str, layout: str) -> None:
    readings = filled(kind, layout)
    frame = readings.to_frame()
    column = f"reading_{OBSERVATIONS[kind].unit}"
    assert np.allclose(frame[column] * 1e-3, readings.reading, rtol=0, atol=1e-15)
    assert ("reading_mrad" in frame) == OBSERVATIONS[kind].angular
    names = readings.legs
    for k, leg in enumerate(names.legs):
        told = frame[f"{names.command}_{leg}_mm"]
        assert np.allclose(told * 1e-3, readings.command[:, k], rtol=0, atol=1e-15)
    for k, name in enumerate(("beside_x_mm", "beside_y_mm", "beside_z_mm")):
        told = frame[name] if name in frame else np.zeros(len(frame))
        assert np.allclose(told * 1e-3, readings.beside[:, k], rtol=0, atol=1e-15)


@every
def test_an_instrument_that_counts_the_other_way_shows_the_negative(kind: str, layout: str) -> None:
    machine, sheet = MACHINES[layout], sheet_of(kind, layout)
    if not OBSERVATIONS[kind].axes:
        assert not any(sheet.direction)
        return
    turned = replace(
        sheet,
        setups=tuple(replace(s, sign=-s.sign) for s in sheet.setups),
        sign=-sheet.sign,
    )
    one, other = (MeasurementModel(t, stands_of(kind, t)).predict(machine.model, TRUE[layout])
                  for t in (sheet, turned))  # fmt: skip
    assert np.abs(one).max() > 1e-4
    assert np.array_equal(one, -other)
    both = zip(sheet.direction, turned.direction, strict=True)
    assert all((a[0] == "-") != (b[0] == "-") for a, b in both)


# By hand, at mechanical zero: every leg lies along its axis, so that the tool goes with each
# carriage, and the point at g along leg y goes by 1 - g / L of what the tool goes sideways.
TOLD_BY_HAND = [
    ("leg", {"direction": "x", "leg": "y", "gauge_mm": 155.125}, "joint_offset.x", 0.5),
    ("leg", {"direction": "-x", "leg": "y", "gauge_mm": 155.125}, "joint_offset.x", -0.5),
    ("parallelism", {"direction": "x", "leg": "y", "gauge_mm": 31.025, "gauge2_mm": 217.175},
     "joint_offset.x", -0.6),
    ("parallelism", {"direction": "x", "leg": "y", "gauge_mm": 217.175, "gauge2_mm": 31.025},
     "joint_offset.x", 0.6),
    ("tcp", {"direction": "x"}, "joint_offset.x", 1.0),
    ("tcp", {"direction": "-x"}, "joint_offset.x", -1.0),
    ("tcp", {"direction": "y"}, "joint_offset.x", 0.0),
    ("plate", {}, "joint_offset.z", 1.0),
    ("plate", {}, "joint_offset.x", 0.0),
    # Bar 1 is on the +z side of leg x and pushes that side of the platform toward -x.
    ("incline", {"direction": "y"}, "bar_mismatch.x", -1 / 0.08),
    ("incline", {"direction": "-y"}, "bar_mismatch.x", 1 / 0.08),
    ("incline", {"direction": "x"}, "bar_mismatch.x", 0.0),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "cells", "name", "slope"), TOLD_BY_HAND)
def test_what_a_positive_error_does(
    kind: str, cells: dict[str, object], name: str, slope: float
) -> None:
    frame = {"kind": [kind] * 2, "setup": ["s"] * 2, "rho_x_mm": [310.25, 320.25]}
    frame |= {"rho_y_mm": [310.25] * 2, "rho_z_mm": [310.25] * 2}
    frame |= {column: [cell] * 2 for column, cell in cells.items()}
    frame[f"reading_{OBSERVATIONS[kind].unit}"] = [0.0, 0.0]
    sheet = Readings.from_frame(frame)
    shown = MeasurementModel(sheet).linearise(ORTHOGLIDE.model, {}, [name]).jacobian[0, 0]
    assert shown == pytest.approx(slope, abs=1e-9)


# -- permutation of legs ---------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [k for k in KINDS if not OBSERVATIONS[k].touches])
def test_legs_may_be_renamed(kind: str) -> None:
    sheet, machine = sheet_of(kind), ORTHOGLIDE
    values = dict(TRUE["orthoglide"])
    for again in (legs_renamed(sheet), legs_renamed(legs_renamed(sheet))):
        parameters = {machine.catalogue.parameter(n): v for n, v in values.items()}
        values = {relabelled(n): v for n, v in parameters.items()}
        turns = 1 if same_readings(again, legs_renamed(sheet)) else 2
        stands = [
            replace(s, ball_centre=np.roll(s.ball_centre, turns)) for s in stands_of(kind, sheet)
        ]
        before = MeasurementModel(sheet, stands_of(kind, sheet)).predict(
            machine.model, TRUE["orthoglide"]
        )
        assert (
            np.abs(MeasurementModel(again, stands).predict(machine.model, values) - before).max()
            < 1e-12
        )
    assert same_readings(legs_renamed(legs_renamed(legs_renamed(sheet))), sheet)
    assert not same_readings(legs_renamed(sheet), sheet)


def with_sigma(readings: Readings, sigma: float) -> Readings:
    return replace(readings, sigma=np.full(len(readings), sigma))


# -- what a declaration owes -----------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_an_instrument_is_declared_whole(kind: str) -> None:
    one = OBSERVATIONS[kind]
    assert "" not in (one.instrument_phrase, one.quantity_phrase)
    assert one.unit in ("mm", "mrad")
    shown = one.quantity_phrase.format("AXIS", "LEG")
    assert ("AXIS" in shown, "LEG" in shown) == (bool(one.axes), one.on_leg)
    assert one.repeatability > 0
    priors = InstrumentPriors(dial_placement_sd=1e-4, surface_slope_sd=1e-4)
    known = one.nuisance_sds(mounted(one), np.array([0]), priors)
    assert known.shape == (one.nuisance_count,)
    assert (known > 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_column_that_a_kind_needs_is_missed(kind: str) -> None:
    frame = filled(kind, "orthoglide").to_frame()
    needed = [c.name for c in COLUMNS if c.required and c.applies_to(OBSERVATIONS[kind])]
    for column in (c for c in needed if c in frame and c != "order"):
        with pytest.raises(FileError, match=f"has no column {column}"):
            Readings.from_frame(frame.drop(columns=column))


# -- files and tables ------------------------------------------------------------------------------


def recorded(readings: Readings) -> Readings:
    """Readings with all that a file may say of when and how they were taken."""
    n = np.arange(len(readings))
    sigma = np.where(n % 4 == 0, np.nan, np.round(1e-5 * (1 + n % 3), 9))
    return replace(
        readings, time=20.0 * n, temperature=np.round(20 + 0.1 * n, 1), load=5.0 * (n % 2),
        sigma=sigma,
        posture=tuple(f"place {k}" for k in n),
    )  # fmt: skip


@every
def test_files_and_frames_give_the_readings_back(kind: str, layout: str, tmp_path: Path) -> None:
    machine = MACHINES[layout]
    for name, readings in (
        ("exact", filled(kind, layout)),
        ("drawn", filled(kind, layout, seed=3)),
        ("sigma", with_sigma(filled(kind, layout, seed=4), 2e-5)),
        ("again", filled(kind, layout, seed=5, repeats=2)),
        ("recorded", recorded(filled(kind, layout, seed=6))),
    ):
        given = replace(readings, name=name)
        write_campaign(given, tmp_path / f"{name}.csv", machine.spec)
        back = read_campaign(tmp_path / f"{name}.csv", machine.spec)
        assert same_readings(back, given)
        assert back.legs == given.legs
        again = Readings.from_frame(given.to_frame(), name=name, machine_file=machine.spec)
        assert same_readings(again, given)
        at_once = Readings.from_frame(
            given.to_frame(machine.spec), name=name, machine_file=machine.spec
        )
        assert same_readings(at_once, given)


@every
def test_a_sheet_is_read_back_with_nothing_filled_in(
    kind: str, layout: str, tmp_path: Path
) -> None:
    machine, sheet = MACHINES[layout], sheet_of(kind, layout)
    sheet = sheet.with_readings(np.full(len(sheet), np.nan))
    write_campaign(sheet, tmp_path / f"{kind}.csv", machine.spec)
    back = read_campaign(tmp_path / f"{kind}.csv", machine.spec, require_readings=False)
    assert same_readings(back, sheet)
    with pytest.raises(InputError, match="no readings yet"):
        read_campaign(tmp_path / f"{kind}.csv", machine.spec)


@every
def test_parts_of_a_table_and_tables_put_together_keep_their_readings(
    kind: str, layout: str
) -> None:
    readings = filled(kind, layout, seed=1)
    machine, model = MACHINES[layout], MACHINES[layout].model
    rng = np.random.default_rng(5)
    chosen = np.sort(rng.choice(len(readings), 11, replace=False))
    part = readings.subset(chosen)
    assert same_readings(part.subset(np.arange(11)), part)
    whole = MeasurementModel(readings, stands_of(kind, readings)).predict(model, TRUE[layout])
    some = MeasurementModel(part, stands_of(kind, part)).predict(model, TRUE[layout])
    assert np.array_equal(whole[chosen], some)
    halves = [readings.subset(readings.setup == k) for k in range(len(readings.setups))]
    back = concatenated(halves)
    by_setup = np.argsort(readings.setup, kind="stable")
    assert np.array_equal(back.reading, readings.reading[by_setup])
    assert np.array_equal(back.axis, readings.axis[by_setup])
    shown = MeasurementModel(back, stands_of(kind, back)).predict(model, TRUE[layout])
    assert np.array_equal(shown, whole[by_setup])
    assert machine.geometry.layout.names == back.legs
    with pytest.raises(InputError, match="two setups are called"):
        concatenated([readings, readings])


def mixed(layout: str, errors: dict[str, float], seed: int) -> Readings:
    """Readings of all kinds that a layout has, in one table, dials first."""
    kinds = sorted((k for k, w in CASES if w == layout), key=lambda k: not OBSERVATIONS[k].on_leg)
    several = []
    for kind in kinds:
        sheet = sheet_of(kind, layout)
        named = tuple(replace(s, name=f"{kind} {s.name}") for s in sheet.setups)
        several.append(replace(sheet, setups=named))
    true = MACHINES[layout].with_parameters(errors)
    return og.simulate(true, concatenated(several), seed=seed)


@pytest.mark.parametrize("layout", MACHINES)
def test_rows_of_all_kinds_share_a_file(layout: str, tmp_path: Path) -> None:
    machine, errors = MACHINES[layout], {n: v for n, v in TRUE[layout].items() if "joint_off" in n}
    readings = mixed(layout, errors, 2)
    write_campaign(readings, tmp_path / "mixed.csv", machine.spec)
    back = read_campaign(tmp_path / "mixed.csv", machine.spec)
    assert back.setups == readings.setups
    for name in ("setup", "reading", "command", "axis", "sign", "second"):
        assert np.array_equal(getattr(back, name), getattr(readings, name), equal_nan=True)
    found = og.identify(tmp_path / "mixed.csv", machine, ["joint_offset"])
    for name, value in errors.items():
        assert abs(found.values[name] - value) < 4.5 * found.sigmas[name]


# -- noise -----------------------------------------------------------------------------------------


def noise(readings: Readings, machine: Machine, declared: float | None = None) -> Array:
    return noise_of([readings], machine.spec, declared)[1][0].sigma


@once
def test_noise_comes_from_the_first_that_says_it(kind: str, layout: str) -> None:
    """The run's figure, the rows' sigma, the machine file's, that of repeats, what is usual."""
    observation, machine = OBSERVATIONS[kind], MACHINES[layout]
    # Without a step that rounds: neither the dial's nor one that figures show.
    dial = replace(machine.spec.dial, resolution=0.0)
    bare = replace(machine, spec=replace(machine.spec, dial=dial))
    said = replace(bare, spec=replace(bare.spec, instruments={kind: Instrument(0.0, 7e-5)}))
    once = filled(kind, layout, bare, seed=1)
    again = filled(kind, layout, bare, seed=1, repeats=4, noise=5e-5)
    rows = with_sigma(once, 3e-5)
    assert noise(once, bare) == pytest.approx(observation.repeatability, rel=1e-9)
    assert noise(again, bare) == pytest.approx(5e-5, rel=0.3)
    assert noise(again, said) == pytest.approx(7e-5, rel=1e-9)
    some = replace(again, sigma=np.where(np.arange(len(again)) < 8, 3e-5, np.nan))
    assert noise(some, said)[:8] == pytest.approx(3e-5, rel=1e-9)
    assert noise(some, said)[8:] == pytest.approx(7e-5, rel=1e-9)
    assert noise(rows, said) == pytest.approx(3e-5, rel=1e-9)
    assert noise(rows, said, 9e-5) == pytest.approx(9e-5, rel=1e-9)
    assert noise(once, bare, 9e-5) == pytest.approx(9e-5, rel=1e-9)


@once
def test_simulated_readings_scatter_as_they_are_said_to(kind: str, layout: str) -> None:
    """By the sheet's sigma, else the machine file's figure, else what is usual of the kind."""
    machine, observation = MACHINES[layout], OBSERVATIONS[kind]
    dial = replace(machine.spec.dial, resolution=0.0)
    bare = replace(machine, spec=replace(machine.spec, dial=dial))
    said = replace(bare, spec=replace(bare.spec, instruments={kind: Instrument(None, 7e-5)}))
    sheet = sheet_of(kind, layout, repeats=12)
    told = with_sigma(sheet, 3e-5)
    for given, of, expected in (
        (sheet, bare, observation.repeatability), (sheet, said, 7e-5), (told, said, 3e-5)
    ):  # fmt: skip
        shown = og.simulate(of, given, seed=6).reading.reshape(-1, 12)
        scatter = np.sqrt(np.mean(np.var(shown, axis=1, ddof=1)))
        assert scatter == pytest.approx(expected, rel=0.15)


@once
def test_displays_round_once(kind: str, layout: str) -> None:
    """Readings are multiples of the step, and scatter as one that is rounded does."""
    machine, step = MACHINES[layout], 1e-4
    own = Instrument(step, 3e-5)
    spec = replace(machine.spec, instruments={kind: own})
    said = replace(machine, spec=spec)
    shown = og.simulate(said, sheet_of(kind, layout, repeats=60), seed=6)
    steps = shown.reading / step
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    stations = shown.reading.reshape(-1, 60)
    means = og.simulate(said, sheet_of(kind, layout, repeats=60), seed=6, noise=0.0)
    assert np.abs(stations.mean(axis=1) - means.reading.reshape(-1, 60)[:, 0]).max() < 1.5 * step
    assert noise(shown, said) == pytest.approx(np.hypot(3e-5, step / np.sqrt(12)), rel=0.25)


# -- the fit ---------------------------------------------------------------------------------------


def zeros_of(layout: str, rng: np.random.Generator) -> dict[str, float]:
    """Offsets of the zeros of a machine's drives, metres."""
    legs = MACHINES[layout].geometry.leg_names
    return {f"joint_offset.{leg}": float(5e-4 * rng.standard_normal()) for leg in legs}


@once
def test_all_methods_find_the_same(kind: str, layout: str) -> None:
    """The programme, nested closures, and these closed by Pinocchio.

    Offsets, lengths and an error of the instrument are free, another one of its errors is held at
    what the machine file says.
    """
    machine, sheet = MACHINES[layout], sheet_of(kind, layout, 10)
    own = machine.model.instrument_parameters(OBSERVATIONS[kind], sheet.setups[0].name)
    true = {n: 0.7 * machine.tolerance(n) for n in own}
    worn = machine.with_parameters(zeros_of(layout, np.random.default_rng(1)) | true)
    readings = og.simulate(worn, replace(sheet, time=20.0 * np.arange(len(sheet))), seed=2)
    held = machine.with_only({n: true[n] for n in own[1:]})
    agree(readings, held, ["joint_offset", "leg_length", *own[:1]])


def has_free(kind: str) -> bool:
    """Whether something of its instruments is not known at all."""
    observation = OBSERVATIONS[kind]
    known = observation.nuisance_sds(mounted(observation), np.array([0]), InstrumentPriors())
    return bool(np.isinf(known).any())


def mounted(observation: Observation) -> Setup:
    """Some mounting of a kind."""
    place = {"leg": 0, "axis": 1, "gauge2": 0.1} if observation.on_leg else {}
    return Setup("some", kind=observation.kind, **place)


def agree(readings: Readings, machine: Machine, free: list[str]) -> None:
    methods: tuple[Method, ...] = ("nested", "nlp", "pinocchio")
    one, *others = (og.identify(readings, machine, free, method=method) for method in methods)
    sigma = np.array(list(one.sigmas.values()))
    for other in others:
        assert (np.abs(other.x - one.x) < 1e-9 + 1e-4 * sigma).all()
        assert np.abs(other.residuals - one.residuals).max() < 1e-9


@pytest.mark.parametrize(
    ("kind", "layout"),
    [c for c in ONCE if has_free(c.values[0]) and not OBSERVATIONS[c.values[0]].on_leg],
)
def test_a_setup_of_fewer_readings_than_it_has_numbers_changes_no_other(
    kind: str, layout: str
) -> None:
    """One reading and a datum, or two and a plane, say nothing of the machine, and no more do they
    take anything from the readings of other setups.
    """
    machine, true = MACHINES[layout], zeros_of(layout, np.random.default_rng(9))
    worn = machine.with_parameters(true)
    readings = og.simulate(worn, sheet_of(kind, layout), seed=3)
    first = readings.subset(readings.setup == 0)
    alone = og.identify(first, machine, ["joint_offset"])
    other = readings.subset(readings.setup == len(readings.setups) - 1)
    for count in (1, 2) if OBSERVATIONS[kind].touches else (1,):
        few = other.subset(np.arange(count))
        named = tuple(replace(s, name="few") for s in few.setups)
        both = og.identify(concatenated([first, replace(few, setups=named)]), machine,
                           ["joint_offset"])  # fmt: skip
        sigma = np.array(list(alone.sigmas.values()))
        assert (np.abs(both.x - alone.x) < 1e-3 * sigma).all()
        assert list(both.sigmas.values()) == pytest.approx(sigma, rel=1e-3)
        assert both.scores.dof == pytest.approx(alone.scores.dof, abs=0.05)


@pytest.mark.thorough
@every
def test_intervals_cover_the_truth(kind: str, layout: str) -> None:
    """95 % intervals of zeros that are spread as the tolerance has it, of sixty machines each.

    Offsets of one machine may be one number to the readings, so that machines are counted, three
    values each at most: 60 x 0.95 with a deviation of 1.7 machines, or 5 values of 180 where all
    three go together.
    """
    machine, inside, count = MACHINES[layout], 0, 60
    rng = np.random.default_rng(12)
    sheet = sheet_of(kind, layout)
    tolerance = machine.tolerance(f"joint_offset.{machine.geometry.leg_names[0]}")
    for seed in range(count):
        legs = machine.geometry.leg_names
        true = {f"joint_offset.{leg}": float(tolerance * rng.standard_normal()) for leg in legs}
        readings = og.simulate(machine.with_parameters(true), sheet, seed=seed)
        found = og.identify(readings, machine, ["joint_offset"], method="nested")
        within = [low <= true[n] <= high for n in true for low, high in [found.interval(n)]]
        inside += sum(within)
    assert 0.95 * 3 * count - 3.5 * 5 < inside
