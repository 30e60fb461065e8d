"""Many readings are gone through in blocks: same answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from benchmarks import public
from orthoglide.explanation import compression, free_form, screening
from orthoglide.explanation.columns import linearise_full_model
from orthoglide.explanation.compression import MergedRows
from orthoglide.geometry import Array
from orthoglide.observations.arrays import equal_rows
from orthoglide.prediction import MeasurementModel, measurement_model
from orthoglide.simulation import simulate
from tests import rig_campaigns
from tests.rig import Rig
from tests.studied import studied

MACHINE = og.Machine.nominal()
BENT = MACHINE.with_parameters({"rail_bow.x.z": 4e-5, "joint_offset.y": 1e-3})


def measured() -> og.Campaign:
    return simulate(BENT, "sweep", noise=5e-6, seed=3)


def by_joints(sheet: og.Readings) -> np.ndarray:
    """Derivatives of readings by motions of the virtual joints, one after the other."""
    moved = MeasurementModel(sheet).joint_response(MACHINE.model, BENT.values)
    return np.hstack([moved(joint, np.ones((len(sheet), 1))) for joint in np.eye(30)])


def test_derivatives_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    sheet, names = measured(), ("joint_offset.x", "backlash.y", "gauge_scale.xy-0.5")
    whole = MeasurementModel(sheet).linearise(MACHINE.model, BENT.values, names)
    joints = by_joints(sheet)
    monkeypatch.setattr(measurement_model, "_ROWS", 7)
    parts = MeasurementModel(sheet).linearise(MACHINE.model, BENT.values, names)
    assert parts.value == pytest.approx(whole.value, abs=1e-15)
    assert parts.jacobian == pytest.approx(whole.jacobian, abs=1e-12)
    assert parts.reading_poses.nuisance_jacobian == pytest.approx(
        whole.reading_poses.nuisance_jacobian, abs=1e-12
    )
    assert by_joints(sheet) == pytest.approx(joints, abs=1e-12)


def test_visits_to_one_place_at_several_times_are_predicted_each() -> None:
    """A dial whose stand creeps shows another reading at every visit, by derivatives too."""
    read = measured()
    timed = replace(read, time=60.0 * np.arange(len(read)))
    name = f"gauge_drift.{read.setups[0].name}"
    at, model = {"joint_offset.x": 1e-3, name: 1e-7}, MeasurementModel(timed)
    linear = model.linearise(MACHINE.model, at, [name])
    assert linear.value == pytest.approx(model.predict(MACHINE.model, at), abs=1e-15)
    nudged = model.predict(MACHINE.model, at | {name: 2e-7}) - linear.value
    assert linear.jacobian[:, 0] * 1e-7 == pytest.approx(nudged, abs=1e-15)
    assert len(np.unique(linear.jacobian[read.setup == 0, 0])) == (read.setup == 0).sum()


@pytest.mark.thorough
def test_few_directions_say_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    one = studied(measured(), MACHINE)
    monkeypatch.setattr(compression, "COMPRESSION_THRESHOLD", 10)
    monkeypatch.setattr(screening, "_MOST_DENSE_NUMBERS", 0)
    other = studied(measured(), MACHINE)
    assert (one.word, [e.name for e in one.effects]) == (
        other.word,
        [e.name for e in other.effects],
    )
    assert other.after.scores.chi2 == pytest.approx(one.after.scores.chi2, rel=0.02)
    for name, value in one.after.values.items():
        half = 0.1 * one.after.sigmas[name]
        assert other.after.values[name] == pytest.approx(value, abs=half + 1e-9), name


def test_evidence_counts_the_scatter_of_visits_to_a_station(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As that of readings that are not compressed: evidences of other noise are compared."""
    once, rounds = measured(), np.repeat(np.arange(5), len(measured()))
    often = once.subset(np.tile(np.arange(len(once)), 5))
    scatter = 5e-6 * np.random.default_rng(0).standard_normal(len(often))
    number = np.arange(len(often))
    often = replace(
        often, reading=often.reading + scatter, repeat=often.repeat + 3 * rounds, order=number,
        line=number + 2, time=np.full(len(often), np.nan),
    )  # fmt: skip
    fit = og.identify(often, MACHINE)
    models = [linearise_full_model(fit)]
    monkeypatch.setattr(compression, "COMPRESSION_THRESHOLD", 10)
    models.append(linearise_full_model(fit))
    remainder = [model.linear.station_remainder.chi2 for model in models]
    explained = [model.linear.residual @ model.linear.residual for model in models]
    one, other = np.add(remainder, explained) + [m.unexplainable_chi2 for m in models]
    assert other == pytest.approx(one, abs=1e-3)


def test_waves_are_compared_at_as_many_travels_as_they_need(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A hundred thousand different travels took as many sines for each period."""
    dense = [(f"{k}", float(t)) for k, t in enumerate(np.linspace(-100, 60, 120))]
    monkeypatch.setitem(rig_campaigns.PROTOCOLS, "dense", (dense, (0.5,)))
    rig = Rig(extra=(rig_campaigns.drive_wave(1, 2e-4, 0.031),))
    rows = rig_campaigns.protocol_rows("dense", repeats=1)
    read = public.campaign(rig_campaigns.simulate(rig, rows, np.random.default_rng(4)))
    estimate, gain = og.identify(read, public.machine()), free_form._wave_gain
    counts, periods = list[int](), dict[int, list[float]]()

    def counted(cycles: Array, u: Array, of_travel: Array) -> Array:
        counts.append(len(u))
        return gain(cycles, u, of_travel)

    monkeypatch.setattr(free_form, "_wave_gain", counted)
    for decimals in (3, 6):
        monkeypatch.setattr(free_form, "_DECIMALS", decimals)
        errors = linearise_full_model(estimate).free_form_errors
        periods[decimals] = [e.period for e in errors if e.name.startswith("drive.y/waves@")]
    assert min(counts) <= 161 < max(counts)
    assert periods[3][:5] == pytest.approx(periods[6][:5], rel=2e-3)
    assert min(abs(period - 0.031) for period in periods[3]) < 3e-4


def test_equal_rows_are_stored_once() -> None:
    """Columns that are equal at a station, and one that is not, as blocks of either length."""
    rng = np.random.default_rng(0)
    index = np.array([0, 1, 0, 2, 1, 0, 2, 1])
    of_groups, constant = rng.standard_normal((3, 2)), rng.standard_normal((3, 1))[index]
    step = (np.arange(8) > 4).astype(float)[:, None]
    whole = np.hstack([of_groups[index], constant, step])
    merged = MergedRows((), index).beside([of_groups, constant]).beside([step])
    assert len(merged.first) == 6  # the step splits each group
    assert np.array_equal(merged.columns(), whole)
    vector = rng.standard_normal(4)
    assert merged @ vector == pytest.approx(whole @ vector)


def test_rows_of_many_readings_take_half_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """They have single precision, and blocks that no later step reads are released."""
    monkeypatch.setattr(compression, "MOST_RANKED_READINGS", 10)
    rng = np.random.default_rng(0)
    one, other = rng.standard_normal((2, 20, 3))
    merged = MergedRows((), np.arange(20)).beside([one, other])
    assert merged.columns() == pytest.approx(np.hstack([one, other]), rel=1e-7)
    assert sum(block.nbytes for block, _ in merged.blocks) == (one.nbytes + other.nbytes) / 2
    reduced = merged.reduced_to(np.array([4]))
    assert np.array_equal(reduced.columns([3, 5]), merged.columns([3, 5]))
    assert [len(block) for block, _ in reduced.blocks] == [0, 20]


@pytest.mark.parametrize("by_station", [False, True])
def test_directions_of_blocks_against_all_at_once(by_station: bool) -> None:
    """Inner products of columns, residual and stations, beside what all columns leave, of rows
    that all differ and of rows that visits to a station share.
    """
    from orthoglide.explanation.compression import compress_readings

    found = og.identify(measured(), MACHINE)
    nuisance, n = found.nuisance, len(found.problem.measured)
    rng = np.random.default_rng(0)
    station = found.problem.station
    index = equal_rows(station if by_station else np.arange(n))
    merged = MergedRows((), index).beside([1e-5 * rng.standard_normal((index.max() + 1, 9))])
    rows, rest = merged.columns(), 1e-5 * rng.standard_normal(n)
    dense, left = nuisance.project(rows), nuisance.project(rest)
    seen, residual, root, (square, count, visits) = compress_readings(nuisance, merged, rest)
    assert seen.T @ seen == pytest.approx(dense.T @ dense)
    assert seen.T @ residual == pytest.approx(dense.T @ left)
    errors = nuisance.project(np.eye(station.max() + 1)[station] * found.problem.sigma[:, None])
    shown = errors.T @ dense
    assert seen.T @ root @ root.T @ seen == pytest.approx(shown.T @ shown)
    assert count == station.max() + 1 - nuisance.unconstrained_count - 9
    assert visits == pytest.approx(n / (station.max() + 1))
    assert 0 < square < float(left @ left)
