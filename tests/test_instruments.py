"""What every kind of reading owes, run over all of them: its formula on numbers against its
compiled derivatives, nuisances, places, and no other name.

A new file under `orthoglide/instruments` is taken up by itself.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import orthoglide as og
from orthoglide.effects import CATALOGUE, Effect
from orthoglide.instruments import (
    OBSERVATIONS,
    POSE_SIZE,
    TOOL_OBSERVATIONS,
    InstrumentPriors,
    Observation,
    ReadingVariables,
    Setup,
)
from orthoglide.instruments.observation import InstrumentPose, MountingContext
from orthoglide.observations import Readings
from orthoglide.prediction.measurement_model import Formula, Formulas

PACKAGE = Path(__file__).parents[1] / "orthoglide"
COUNT = 12

every = pytest.mark.parametrize("one", OBSERVATIONS.values(), ids=lambda one: one.kind)
at_tool = pytest.mark.parametrize("one", TOOL_OBSERVATIONS.values(), ids=lambda one: one.kind)


def setup_of(one: Observation) -> Setup:
    if one.on_leg:
        return Setup("s", 0, 1, -1, 0.155, 1, kind=one.kind, gauge2=0.11)
    return Setup(
        "s", kind=one.kind, beside=(0.01, -0.02, -0.03) if one.setup_columns else (0.0,) * 3
    )


def drawn(
    one: Observation,
    stand: InstrumentPose | None = None,
    *,
    sign: float = 0.0,
    nuisance: float = 0.0,
) -> Rows:
    """Poses and mountings at random, nuisances of a size; signs too where none is given."""
    rng, effects = np.random.default_rng(3), Formulas(CATALOGUE).effects(one)
    p, apart = rng.normal(scale=0.1, size=(2, COUNT, 3))
    turn = Rotation.from_rotvec(rng.normal(scale=1e-3, size=(COUNT, 3))).as_matrix()
    pose = np.hstack([p, turn.reshape(COUNT, 9)])
    if one.on_leg:  # ends of bars along x
        ends = np.array([[0.0, 0.02, 0.0], [0.31, 0.02, 0.0], [0.0, -0.02, 0.0], [0.31, -0.02, 0]])
        pose = ends.ravel() + rng.normal(scale=1e-2, size=(COUNT, POSE_SIZE))
    axis = [one.axes[k % len(one.axes)] if one.axes else 0 for k in range(COUNT)]
    signs = rng.choice([-1.0, 1.0], COUNT) if not sign else np.full(COUNT, sign)
    table = Readings(
        "drawn", (setup_of(one),), setup=np.zeros(COUNT, dtype=int), command=np.zeros((COUNT, 3)),
        reading=np.full(COUNT, np.nan), time=np.arange(COUNT) * 60.0, axis=axis, sign=signs,
    )  # fmt: skip
    stand = stand or InstrumentPose(
        Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), 0.1 * np.ones(3)
    )
    site = MountingContext(og.Geometry(), (stand,), rng.uniform(-0.7, 0.7, (COUNT, 2)), effects)
    mounting = one.mounting_values(table, np.arange(COUNT), site)
    other = np.hstack([p + apart, pose[:, 3:]])
    values = rng.normal(scale=1e-4, size=(COUNT, sum(len(e.parameters(("s",))) for e in effects)))
    brought = rng.normal(scale=nuisance, size=(COUNT, one.nuisance_count))
    return Rows(one, effects, table, [pose, other, mounting, brought, values])


class Rows:
    """Rows of one kind, whose formula is worked out in plain numbers."""

    def __init__(
        self,
        one: Observation,
        effects: tuple[Effect, ...],
        table: Readings,
        given: list[np.ndarray],
    ) -> None:
        self.one, self.effects, self.table, self.given = one, effects, table, given

    def value(self, **other: np.ndarray) -> np.ndarray:
        """Readings ``(COUNT,)``, some of what they follow replaced."""
        given = dict(zip(PARTS, self.given, strict=True)) | other
        rows = zip(*(given[part] for part in PARTS), strict=True)
        return np.array(
            [float(self.one.formula(ReadingVariables(*row), self.effects)) for row in rows]
        )

    @property
    def tangent(self) -> list[np.ndarray]:
        """The compiled formula: readings, and their derivatives by all but the mounting."""
        given = list(self.given)
        given[4] = given[4] if given[4].shape[1] else np.zeros((COUNT, 1))
        return list(Formula(self.one, self.effects, given[2].shape[1]).tangent(*given))

    @property
    def columns(self) -> np.ndarray:
        """Derivatives by the nuisances, those of the last ones of a setup."""
        return self.tangent[3]


PARTS = ("pose", "other", "mounting", "nuisance", "values")


def turned(small: float) -> tuple[InstrumentPose, InstrumentPose]:
    """An instrument in its place, and about a distance off it, turned as well."""
    place = Rotation.from_rotvec([0.3, -0.5, 0.2])
    moved = place.inv() * Rotation.from_rotvec(np.array([1.0, -0.7, 0.4]) * small)
    ball = 0.1 * np.ones(3)
    return (
        InstrumentPose(place.as_matrix(), ball),
        InstrumentPose(moved.inv().as_matrix(), ball + np.array([-0.5, 0.8, 1.0]) * small),
    )


@pytest.mark.parametrize("kind", ["tcp", "ballbar"])
def test_what_an_instrument_shows_out_of_its_place_its_nuisances_say(kind: str) -> None:
    one, small, left = OBSERVATIONS[kind], 1e-5, []
    for size in (small, small / 2):
        rows, moved = (drawn(one, stand) for stand in turned(size))
        columns = rows.columns
        rest = moved.value() - rows.value()
        assert np.abs(rest).max() > size / 10
        left.append(np.abs(rest - columns @ np.linalg.lstsq(columns, rest, rcond=1e-9)[0]).max())
    assert left[0] < 20 * small**2 / 0.01  # what is left is of the second order
    assert left[1] < left[0] / 3


LINEAR = {
    # what a setup shows besides the machine, of places, readings and axes, by hand
    "plate": lambda p, value, axis: 3e-4 + 2e-3 * p[:, 0] - 1e-3 * p[:, 1],
    "distance": lambda p, value, axis: 0.004 * value - 1e-4,
    "incline": lambda p, value, axis: np.array([2e-4, -3e-4, 0.0])[axis],
}


@pytest.mark.parametrize("kind", LINEAR)
def test_nuisances_span_what_a_setup_shows_besides_the_machine(kind: str) -> None:
    rows = drawn(OBSERVATIONS[kind], sign=1.0)
    pose, beside = rows.given[0], np.array(rows.table.setups[0].beside)
    p = pose[:, :3] + pose[:, 3:].reshape(COUNT, 3, 3) @ beside
    shown, columns = LINEAR[kind](p, rows.value(), rows.table.axis), rows.columns
    rest = shown - columns @ np.linalg.lstsq(columns, shown, rcond=1e-9)[0]
    assert np.abs(rest).max() < 1e-12
    assert np.linalg.matrix_rank(columns, tol=1e-9) < COUNT  # and not just anything


def test_kinds_whose_nuisances_are_held_by_hand_are_all_at_the_tool() -> None:
    assert {*LINEAR, "tcp", "ballbar"} == set(TOOL_OBSERVATIONS)


@every
def test_what_is_known_of_nuisances_is_said_of_each(one: Observation) -> None:
    place = {"leg": 0, "axis": 1, "gauge2": 0.1} if one.on_leg else {}
    setup = Setup("some", kind=one.kind, **place)
    known = one.nuisance_sds(
        setup, np.array([0]), InstrumentPriors(dial_placement_sd=1e-4, surface_slope_sd=1e-4)
    )
    assert known.shape == (one.nuisance_count,)
    assert (known > 0).all()


@at_tool
def test_a_sheet_stays_within_its_circle(one: Observation) -> None:
    t = np.arange(12) * np.pi / 6
    points, others = one.sheet_points(np.stack([np.cos(t), np.sin(t), 0 * t], axis=1))
    assert (others is not None) is one.paired
    for places in (points, *([] if others is None else [others])):
        assert np.linalg.norm(places, axis=1).max() == pytest.approx(1.0)


@every
def test_an_instrument_is_declared_whole(one: Observation) -> None:
    assert "" not in (one.instrument_phrase, one.quantity_phrase)
    assert one.unit in ("mm", "mrad")
    shown = one.quantity_phrase.format("AXIS", "LEG")
    assert ("AXIS" in shown, "LEG" in shown) == (bool(one.axes), one.on_leg)
    assert one.repeatability > 0
