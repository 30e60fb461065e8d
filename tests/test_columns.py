"""The columns of files: every kind of reading goes into one file, one frame, and comes back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import orthoglide as og
from orthoglide.errors import FileError, InputError
from orthoglide.instruments import OBSERVATIONS, Setup
from orthoglide.observations import Readings, read_readings
from orthoglide.observations.protocols import unread_campaign
from orthoglide.observations.schema import COLUMNS

MACHINE = og.Machine.nominal()
PLACES = np.random.default_rng(0).uniform(-0.03, 0.03, (6, 3))
COMMANDS_READ = np.round(MACHINE.inverse(PLACES), 9)
IN_A_FILE = sorted(OBSERVATIONS, key=lambda kind: not OBSERVATIONS[kind].on_leg)


def readings(kind: str) -> Readings:
    """Six readings of a kind, with all that its mountings and rows can state."""
    one, n = OBSERVATIONS[kind], len(COMMANDS_READ)
    stated = set(one.setup_columns)
    setup = Setup(
        f"{kind}-1",
        kind=kind,
        **({"leg": 1, "axis": 2, "sign": -1} if one.on_leg else {}),
        gauge=0.155 if "gauge_mm" in stated else 0.0,
        gauge2=0.2 if "gauge2_mm" in stated else 0.0,
        bar=2 if "bar" in stated else 0,
        beside=(0.01, 0.0, -0.04) if "beside_x_mm" in stated else (0.0, 0.0, 0.0),
        turned=60.0 if "turned_deg" in stated else 0.0,
    )
    sheet = unread_campaign(
        MACHINE.geometry, kind, (setup,), np.zeros(n, int), COMMANDS_READ, posture=list("abcdef"),
        time=100.0 * IN_A_FILE.index(kind) + 10.0 * np.arange(n), load=2.5,
    )  # fmt: skip
    value = np.round(np.random.default_rng(1).uniform(1e-3, 2e-3, n), 8)
    return replace(
        sheet,
        reading=value + 0.1 * (one.paired or one.about_ball),
        sigma=np.full(n, 2e-5),
        temperature=np.full(n, 21.5),
        axis=np.array([1, 0, 2, 1, 0, 2]) * bool(one.axes),
        sign=np.where(np.arange(n) % 2, -1.0, 1.0) if one.axes else np.ones(n),
        second=np.roll(COMMANDS_READ, 1, axis=0) if one.paired else None,
    )


def same(one: Readings, other: Readings) -> bool:
    return replace(one, name="").same_as(replace(other, name=""))


def test_all_kinds_survive_one_file_and_one_frame(tmp_path: Path) -> None:
    given = og.Readings.concatenated([readings(kind) for kind in IN_A_FILE])
    assert set(given.kind) == set(OBSERVATIONS)
    og.write_campaign(given, tmp_path / "a.csv")
    found = og.read_campaign(tmp_path / "a.csv")
    assert same(found, given)
    assert same(og.Readings.from_frame(given.to_frame()), given)
    frames = pd.concat([part.to_frame() for part in read_readings(tmp_path / "a.csv")])
    assert same(og.Readings.from_frame(frames), given)
    assert same(given.subset(given.of_kind("plate")), found.subset(found.of_kind("plate")))


def test_tables_of_one_setup_are_not_put_together() -> None:
    with pytest.raises(InputError, match="two setups are called 'plate-1'"):
        og.Readings.concatenated([readings("plate"), readings("plate")])


@pytest.mark.parametrize("kind", OBSERVATIONS)
def test_a_column_that_a_kind_needs_is_missed(kind: str, tmp_path: Path) -> None:
    frame = readings(kind).to_frame()
    needed = [
        c for c in COLUMNS if c.required and c.applies_to(OBSERVATIONS[kind]) and c.name in frame
    ]
    for column in (c for c in needed if c.name != "order"):
        with pytest.raises(FileError, match=f"has no column {column.name}"):
            og.Readings.from_frame(frame.drop(columns=column.name))


def test_two_dials_at_one_place_are_refused_with_their_line() -> None:
    frame = readings("parallelism").to_frame()
    frame["gauge2_mm"] = frame["gauge_mm"]
    with pytest.raises(FileError, match="line 2: its two dials stand at one place: correct"):
        og.Readings.from_frame(frame)
