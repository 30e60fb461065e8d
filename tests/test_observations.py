"""Campaigns: what is read, what is refused and why, and that nothing is lost on the way."""

from __future__ import annotations

import contextlib
import csv
import importlib.resources
import io
import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

import orthoglide as og
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Geometry
from orthoglide.machine_file import Controller, MachineFile, machine_text, parse_machine_file
from orthoglide.observations import (
    Campaign,
    Moves,
    campaign_text,
    derive_approach,
    protocol,
    read_campaign,
    read_tcp,
    write_campaign,
)
from orthoglide.observations.approach import built_up_lost_motion
from tests import rig_campaigns
from tests.factors import same_readings

KINDS = ("standard", "sweep", "two-gauges")
PUBLISHED = sorted(
    file.name
    for file in importlib.resources.files("orthoglide").joinpath("data").iterdir()
    if file.name.endswith(".csv")
)


def measured(kind: str = "standard", seed: int = 0, moves: bool = False) -> Campaign:
    """A protocol filled in with plausible readings, without its moves or with them."""
    sheet = protocol(kind)  # type: ignore[arg-type]
    if not moves:
        place = np.arange(len(sheet))
        sheet = replace(sheet, moves=Moves(), order=place, line=place + 2)
    noise = np.random.default_rng(seed).normal(size=len(sheet))
    return sheet.with_readings(np.round(5e-3 + 1e-4 * noise, 5))


# --- A small language of faults -------------------------------------------------------------
# A fault turns the rows of a good file (a header and cells) into those of a bad one.

Rows = list[list[str]]
Fault = Callable[[Rows], Rows]


@cache
def good_text() -> str:
    return campaign_text(measured())


def good_rows() -> Rows:
    return list(csv.reader(io.StringIO(good_text())))


def as_text(rows: Rows, delimiter: str = ",") -> str:
    stream = io.StringIO(newline="")
    csv.writer(stream, delimiter=delimiter, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def cell(column: str, value: str, *lines: int) -> Fault:
    """Writes a value on the given lines, or on all."""

    def apply(rows: Rows) -> Rows:
        place = rows[0].index(column)
        for line in lines or range(2, len(rows) + 1):
            rows[line - 1][place] = value
        return rows

    return apply


def changed(change: Callable[[float], float], *columns: str) -> Fault:
    def apply(rows: Rows) -> Rows:
        for place in map(rows[0].index, columns):
            for row in rows[1:]:
                row[place] = f"{change(float(row[place])):.12g}"
        return rows

    return apply


def scaled(factor: float, *columns: str) -> Fault:
    return changed(lambda value: value * factor, *columns)


def shifted(offset: float, *columns: str) -> Fault:
    return changed(lambda value: value + offset, *columns)


def renamed(**names: str) -> Fault:
    return lambda rows: [[names.get(name, name) for name in rows[0]], *rows[1:]]


def without(*columns: str) -> Fault:
    def apply(rows: Rows) -> Rows:
        kept = [k for k, name in enumerate(rows[0]) if name not in columns]
        return [[row[k] for k in kept] for row in rows]

    return apply


def added(column: str, value: str) -> Fault:
    return lambda rows: [[*rows[0], column], *([*row, value] for row in rows[1:])]


def chained(*faults: Fault) -> Fault:
    def apply(rows: Rows) -> Rows:
        for fault in faults:
            rows = fault(rows)
        return rows

    return apply


def still(leg: str) -> Fault:
    """Puts the carriage of a leg to mechanical zero throughout."""
    return cell(f"rho_{leg}_mm", "310.25")


RHO = ("rho_x_mm", "rho_y_mm", "rho_z_mm")
TO_TRAVEL = renamed(**{name: name.replace("rho", "travel") for name in RHO})

MALFORMED: dict[str, tuple[Fault, str, int]] = {
    # units and coordinates
    "commands in metres": (scaled(1e-3, *RHO), "in metres: give millimetres", 2),
    "one command in metres": (
        chained(*(cell(name, "0.31025", 8) for name in RHO)), "in metres: give millimetres", 8),
    "readings in metres": (scaled(1e-3, "reading_mm"), "not metres", 2),
    "readings in micrometres": (scaled(1e3, "reading_mm"), "a dial there can show at most", 14),
    "gauge in metres": (scaled(1e-3, "gauge_mm"), "gauge_mm is in metres", 2),
    "controller's values as rho": (shifted(-310.25, *RHO), "name the columns travel_x_mm", 2),
    "rho as controller's values": (TO_TRAVEL, "name the columns rho_x_mm", 2),
    "outside the stroke": (
        cell("rho_x_mm", "372", 4), "372 mm of axis x is outside its stroke of 210.25 to 370.25",
        4),
    "travel outside the stroke": (
        chained(shifted(-310.25, *RHO), TO_TRAVEL, cell("travel_x_mm", "70", 4)),
        "70 mm of axis x is outside its stroke of −100 to 60", 4),
    "both kinds of command": (added("travel_x_mm", "0"), "has rho_x_mm and travel_x_mm", 1),
    # setups
    "setup mixes legs": (
        chained(cell("leg", "y", 4), cell("direction", "x", 4)),
        "has another leg here than on line 2", 4),
    "setup mixes bars": (
        chained(added("bar", ""), cell("bar", "1", 6)), "another bar here", 6),
    "setup with a single posture": (
        lambda rows: [*rows[:3], *(row for row in rows[3:] if row[0] != "xy-0.5")],
        "has a single posture", 2),
    "direction along the leg": (cell("direction", "x", 2), "the leg's own axis", 2),
    "gauge off the leg": (cell("gauge_mm", "-20"), "off the leg", 2),
    "gauge behind the carriage": (
        cell("gauge_mm", "250"), "off the leg, which runs from −100.0 to 210.2 mm", 6),
    "no such leg": (cell("leg", "w", 3), "not one of x, y, z", 3),
    "no such direction": (cell("direction", "up", 3), "not one of x, y, z, -x", 3),
    "no such bar": (chained(added("bar", ""), cell("bar", "3", 3)), "not 1, 2 or empty", 3),
    "setup without a name": (cell("setup", "", 3), "setup is empty: fill it in", 3),
    # sequence
    "duplicate rows": (
        lambda rows: [*rows, rows[1]], "the reading of line 2 stands here again", 56),
    "repeats not numbered": (cell("repeat", "1"), "count it up in column repeat", 8),
    "order used twice": (cell("order", "2", 6), "order 2 stands for another command on line 4", 6),
    "time runs back": (cell("time_s", "1e4", 4), "time_s decreases from line 4 to here", 5),
    "fractional order": (cell("order", "1.5", 3), "not a whole number from 0", 3),
    "repeat from zero": (cell("repeat", "0", 3), "not a whole number from 1", 3),
    "order half filled in": (cell("order", "", 3), "order is empty", 3),
    "approach of 2": (added("approach_x", "2"), "not +1 or -1", 2),
    "nothing moves": (
        chained(*map(still, "xyz"), cell("rho_x_mm", "310.3", 4)), "no axis moves", 2),
    # numbers
    "NaN": (cell("reading_mm", "NaN", 7), "not a finite number", 7),
    "empty reading": (cell("reading_mm", "", 7), "reading_mm is empty", 7),
    "empty command": (cell("rho_z_mm", "", 7), "rho_z_mm is empty", 7),
    "sheet not filled in": (cell("reading_mm", ""), "no readings yet", 2),
    "unit in the cell": (cell("reading_mm", "3.1 mm", 7), "without its unit", 7),
    "decimal comma in quotes": (cell("reading_mm", "3,1", 7), "write it like 12.34", 7),
    "number out of all range": (cell("reading_mm", "1e400", 7), "out of range", 7),
    "infinite": (cell("rho_x_mm", "inf", 7), "not a finite number", 7),
    "a slip of the pen": (cell("reading_mm", "815", 7), "correct this reading", 7),
    "negative sigma": (added("sigma_mm", "-0.01"), "from 10⁻⁶ to 1", 2),
    "kelvin": (added("temperature_C", "293"), "from −40 to 100", 2),
    "a page in a cell": (cell("reading_mm", "x" * 100_000, 2), "is 'xxx", 2),
    "a page for a name": (cell("setup", "x" * 5_000, 2), "shorten it to 100", 2),
    "a name on two lines": (cell("setup", "a\nb", 2), "write it on one", 3),
    "a hundred thousand digits": (cell("reading_mm", "1" * 100_000, 2), "out of range", 2),
    "a column of a page": (renamed(gauge_mm="gauge_mm" * 900), "has no column", 1),
    # columns and rows
    "missing column": (without("reading_mm"), "has no column reading_mm", 1),
    "misspelt column": (renamed(reading_mm="readings_mm"), "did you mean 'reading_mm'", 1),
    "another table altogether": (
        lambda rows: [["a", "b"], ["1", "2"]], "names no known column: give setup, leg", 1),
    "capitals": (
        lambda rows: [[name.upper() for name in rows[0]], *rows[1:]], "in small letters", 1),
    "column named twice": (added("leg", "x"), "names column 'leg' twice", 1),
    "header only": (lambda rows: rows[:1], "a header but no rows", 1),
    "a field too few": (
        lambda rows: [*rows[:4], rows[4][:-1], *rows[5:]], "has 11 fields where", 5),
    "a field too many": (
        lambda rows: [*rows[:4], [*rows[4], "1"], *rows[5:]], "give every line as many fields", 5),
    "a title above the names": (
        lambda rows: [["April;;"], *rows], "names of the columns stand on line 2", 1),
    "two campaigns in one": (lambda rows: [*rows, *rows], "the header stands here again", 56),
}  # fmt: skip

BROKEN: dict[str, tuple[bytes, str, int | None]] = {
    "empty file": (b"", "is empty", None),
    "a lone byte order mark": (b"\xef\xbb\xbf", "is empty", None),
    "commas": (b",,,\n,,\n", "has only empty fields", None),
    "ten thousand columns": (b"c," * 9_999 + b"c\n1\n", "columns", 2),
    "spreadsheet": (b"PK\x03\x04rest", "export the sheet as CSV", None),
    "UTF-16": ("setup,leg".encode("utf-16"), "save it as UTF-8", None),
    "binary": (b"setup,leg\n\x00\x01", "not text", None),
    "Latin-1": (b"setup,leg\nM\xfcller,x\n", "not UTF-8 text", 2),
    "unclosed quotes": (b'setup,leg\n"xy,x\n', "close the quotes", 2),
}

MOVES: dict[str, tuple[Fault, str, int]] = {
    "no kind": (cell("kind", "jump", 2), "not one of leg, move, parallelism, tcp", 2),
    "moves alone": (cell("kind", "move"), "has moves only", 2),
    "a move too far": (cell("rho_x_mm", "400", 21), "outside its stroke", 21),
    "a move of another's order": (
        cell("order", "20", 21), "order 20 stands for another command on line 21", 22),
}  # fmt: skip

TCP = "rho_x_mm,rho_y_mm,rho_z_mm,p_x_mm,p_y_mm,p_z_mm\n"
POINTS = ["310.25,310.25,310.25,0.1,0.2,0.3", "350.25,307.66,307.66,40.1,,0.3"]
POINTS_REFUSED: dict[str, tuple[str, str, int]] = {
    "a point of nothing": (TCP + "310.25,310.25,310.25,,,", "are empty: remove the row", 2),
    "travel of a point": (TCP + f"{POINTS[0]}\n0,0,0,1,1,1", "name the columns travel_x_mm", 3),
    "points in metres": (
        TCP + "310.25,310.25,310.25,0,0,0\n350.25,307.66,307.66,0.04,0,0",
        "give millimetres, not metres", 2),
    "points without z": (
        TCP.replace(",p_z_mm", "") + "310.25,310.25,310.25,0,0", "no column p_z_mm", 1),
    "a point of a word": (TCP + "310.25,310.25,310.25,0,0,far", "not a number", 2),
    "no points": (TCP, "no rows", 1),
}  # fmt: skip


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def with_moves(tmp_path: Path, *faults: Fault) -> Path:
    rows = chained(*faults)(list(csv.reader(io.StringIO(campaign_text(measured(moves=True))))))
    return write(tmp_path / "standard.csv", as_text(rows))


@pytest.mark.parametrize("kind", [*MALFORMED, *BROKEN, *MOVES, *POINTS_REFUSED])
def test_what_no_file_of_readings_holds_is_refused(kind: str, tmp_path: Path) -> None:
    file, read = tmp_path / "bad.csv", read_campaign
    if kind in MALFORMED:
        fault, phrase, line = MALFORMED[kind]
        write(file, as_text(fault(good_rows())))
    elif kind in MOVES:
        fault, phrase, line = MOVES[kind]
        file = with_moves(tmp_path, fault)
    else:
        content, phrase, line = (BROKEN | POINTS_REFUSED)[kind]
        write(file, content)
        read = read_tcp if kind in POINTS_REFUSED else read_campaign
    with pytest.raises(FileError) as caught:
        read(file)
    assert phrase in caught.value.reason
    assert (caught.value.file, caught.value.line) == (str(file), line)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    assert ":" in caught.value.reason  # what is wrong: what would be right
    assert not caught.value.reason.endswith(".")


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 4), st.integers(0, 11), st.text(max_size=6))
def test_no_cell_brings_more_than_a_file_error(
    tmp_path_factory: pytest.TempPathFactory, row: int, column: int, text: str
) -> None:
    rows = good_rows()
    rows[row][column] = text
    file = write(
        tmp_path_factory.mktemp("fuzz") / "c.csv", as_text(rows).encode("utf-8", "replace")
    )
    with contextlib.suppress(FileError):
        assert len(read_campaign(file)) == len(rows) - 1


def test_the_good_file_that_all_faults_start_from_is_read(tmp_path: Path) -> None:
    campaign = read_campaign(write(tmp_path / "standard.csv", as_text(good_rows())))
    assert same_readings(campaign, measured())
    assert campaign.warnings == ()
    assert len(campaign.sha256) == 64
    assert list(campaign.line) == list(range(2, 56))


# --- What is accepted -----------------------------------------------------------------------


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_data_is_read_without_a_warning(name: str) -> None:
    source = importlib.resources.files("orthoglide").joinpath("data", name)
    with importlib.resources.as_file(source) as path:
        campaign = read_campaign(path)
    differences = "differences" in name
    assert len(campaign) == (12 if differences else 18)
    assert [s.name for s in campaign.setups] == ["xy", "xz", "yx", "yz", "zx", "zy"]
    assert {s.gauge for s in campaign.setups} == {0.155125}
    assert campaign.warnings == ()


@pytest.mark.parametrize(
    ("delimiter", "comma"), [(",", "."), (";", "."), (";", ","), ("\t", ","), ("\t", ".")]
)
def test_delimiters_byte_order_mark_and_blank_lines(
    delimiter: str, comma: str, tmp_path: Path
) -> None:
    rows = good_rows()
    numbers = [rows[0].index(name) for name in (*RHO, "gauge_mm", "time_s", "reading_mm")]
    for row in rows[1:]:
        for place in numbers:
            row[place] = row[place].replace(".", comma)
    rows.insert(3, [""] * len(rows[0]))
    text = as_text(rows, delimiter).replace("\n", "\r\n")
    file = write(tmp_path / "standard.csv", b"\xef\xbb\xbf" + text.encode())
    campaign = read_campaign(file)
    assert same_readings(campaign, measured())
    assert campaign.line[:4].tolist() == [2, 3, 5, 6]


def in_turn(*readings: str) -> Fault:
    """Every dial shows these one after the other."""

    def apply(rows: Rows) -> Rows:
        place, visits = rows[0].index("reading_mm"), dict[str, int]()
        for row in rows[1:]:
            visits[row[0]] = visits.get(row[0], 0) + 1
            row[place] = readings[visits[row[0]] % len(readings)]
        return rows

    return apply


NOTICED: dict[str, tuple[Fault, str, int]] = {
    "unknown columns": (
        chained(added("operator", "me"), added("comment", "-")), "is not known and was ignored", 2),
    "a dial that stands still": (in_turn("3.20"), "check that the dial touches", 1),
    "a dial that trembles": (in_turn("3.20", "3.21"), "check that the dial touches", 1),
    "a dial that moves": (in_turn("3.20", "3.22"), "check that the dial touches", 0),
    "a temperature that is missing": (
        chained(added("temperature_C", "21"), cell("temperature_C", "", 2)),
        "temperature_C is empty in 1 of 54 rows", 1),
    "a clock that shows the time of day": (
        changed(lambda t: t + 36e3, "time_s"), "time_s starts at 36", 1),
    "a clock that runs when the session starts": (
        changed(lambda t: t + 60, "time_s"), "time_s starts", 0),
}  # fmt: skip


@pytest.mark.parametrize("kind", NOTICED)
def test_what_is_odd_and_possible_is_a_warning(kind: str, tmp_path: Path) -> None:
    fault, phrase, times = NOTICED[kind]
    campaign = read_campaign(write(tmp_path / "c.csv", as_text(fault(good_rows()))))
    assert sum(phrase in w for w in campaign.warnings) == len(campaign.warnings) == times


def test_warming_counts_from_the_first_temperature_whatever_the_lowest(tmp_path: Path) -> None:
    rows = chained(added("temperature_C", "21"), *(
        cell("temperature_C", str(value), line) for line, value in ((3, 18.5), (4, 24), (5, 20))
    ))(good_rows())  # fmt: skip
    campaign = read_campaign(write(tmp_path / "c.csv", as_text(rows)))
    assert campaign.temperature_rise[:5].tolist() == [0, -2.5, 3, -1, 0]
    assert campaign.subset(np.arange(1, 4)).temperature_rise.tolist() == [-2.5, 3, -1]


# --- Approach -------------------------------------------------------------------------------


def approach_by_hand(command: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The sentence of FORMAT.md, one axis and one row at a time."""
    result = np.zeros_like(command)
    for axis in range(3):
        last, before = 1.0, None
        for row in sorted(range(len(order)), key=lambda k: order[k]):
            if before is not None and command[row, axis] != command[before, axis]:
                last = 1.0 if command[row, axis] > command[before, axis] else -1.0
            result[row, axis], before = last, row
    return result


@settings(deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=12),
    st.randoms(use_true_random=False),
)
def test_approach_follows_the_sequence(steps: list[tuple[int, int, int]], random) -> None:  # type: ignore[no-untyped-def]
    order = list(range(len(steps)))
    random.shuffle(order)
    command = 0.3 + 0.01 * np.array(steps, dtype=float)
    expected = approach_by_hand(command, np.array(order))
    assert np.array_equal(derive_approach(command, order), expected)


@pytest.mark.parametrize("length", [0.004, 0.03])
def test_what_builds_up_after_a_reversal_is_that_of_the_independent_machine(length: float) -> None:
    rows = rig_campaigns.protocol_rows("sweep")
    rho = np.array([[row[c] for c in rig_campaigns.RHO] for row in rows]) * 1e-3
    near = rig_campaigns.approaches(rows)
    lag = rig_campaigns.hysteresis(1, 2e-5, length)(rho, near, rho[:, 0])[:, 1, 1]
    mixed = np.random.default_rng(3).permutation(len(rows))
    found = built_up_lost_motion(rho[mixed], mixed, [0.1, length])
    np.testing.assert_allclose(-2e-5 * found[1, :, 1], lag[mixed], rtol=0, atol=1e-17)


def test_moves_are_rows_that_are_not_read(tmp_path: Path) -> None:
    campaign = read_campaign(with_moves(tmp_path))
    assert same_readings(campaign, measured(moves=True))
    assert campaign.warnings == ()
    assert len(campaign) == 54
    assert campaign.moves.line.tolist() == [2, 21, 40]
    assert campaign.line[:2].tolist() == [3, 4]
    # Of a move only the command and its place count.
    bare = [cell(name, "", 2, 21, 40) for name in ("setup", "leg", "direction", "gauge_mm")]
    assert same_readings(read_campaign(with_moves(tmp_path, *bare)), campaign)


@pytest.mark.parametrize("half", [0.4, 0.5])  # mm
def test_sheets_of_a_stage_that_hardly_moves_stay_within_its_stroke(
    half: float, tmp_path: Path
) -> None:
    stage = Geometry(0.03, 0.008, 0.003, (-half * 1e-3, half * 1e-3))
    machine = MachineFile(geometry=stage)
    assert parse_machine_file(machine_text(machine)).geometry == stage
    for kind in KINDS:
        sheet = protocol(kind, stage)  # type: ignore[arg-type]
        assert len(sheet.moves)
        assert stage.in_stroke(sheet.moves.command).all()
        path = tmp_path / f"{kind}.csv"
        write_campaign(sheet, path)
        found = read_campaign(path, machine, require_readings=False)
        assert np.array_equal(found.moves.command, sheet.moves.command)
        assert (
            found.moves.overshoot
            == sheet.moves.overshoot
            < 1e-3
            == protocol("sweep").moves.overshoot
        )
        assert not [note for note in found.warnings if note.kind == "command"]


CONTROLLERS = [
    Controller(zero=(0.5, -0.2, 0.0), sign=(1, -1, 1)),
    Controller(zero=(0.1234567, 1e-9, -0.3), sign=(-1, -1, -1)),
]


@pytest.mark.parametrize("controller", CONTROLLERS, ids=["one-axis", "all-axes"])
@pytest.mark.parametrize("kind", KINDS)
def test_sheets_show_what_the_controller_shows(
    kind: str, controller: Controller, tmp_path: Path
) -> None:
    machine = MachineFile(controller=controller)
    campaign = replace(measured(kind, moves=True), name="sheet")
    write_campaign(campaign, tmp_path / "sheet.csv", machine)
    with open(tmp_path / "sheet.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert not [name for name in rows[0] if name.startswith("rho_")]
    first = rows[1]  # behind a move
    for axis, leg in enumerate("xyz"):
        assert float(first[f"travel_{leg}_mm"]) == pytest.approx(controller.zero[axis] * 1e3)
        step = float(first[f"travel_{leg}_mm"]) - float(rows[0][f"travel_{leg}_mm"])
        assert step == pytest.approx(controller.sign[axis])
    again = read_campaign(tmp_path / "sheet.csv", machine)
    assert same_readings(again, campaign)
    assert campaign_text(again, machine) == (tmp_path / "sheet.csv").read_text()
    assert campaign_text(again, MachineFile()) == campaign_text(campaign)


# --- The campaign itself --------------------------------------------------------------------


def test_files_are_not_overwritten_unasked_and_leave_nothing_behind(tmp_path: Path) -> None:
    file = write(tmp_path / "c.csv", "mine")
    with pytest.raises(FileError, match="not overwritten"):
        write_campaign(measured(), file)
    assert file.read_text() == "mine"
    write_campaign(measured(), file, overwrite=True)
    assert len(read_campaign(file)) == 54
    assert os.listdir(tmp_path) == ["c.csv"]
    with pytest.raises(FileError, match="choose another place"):
        write_campaign(measured(), tmp_path / "none" / "c.csv")


def test_arrays_are_the_campaigns_own_and_cannot_be_changed() -> None:
    reading = np.zeros(54)
    campaign = measured().with_readings(reading)
    reading[0] = 1.0
    assert campaign.reading[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        campaign.reading[0] = 1.0


def test_arrays_must_fit_each_other() -> None:
    campaign = measured()
    with pytest.raises(InputError, match="command must have shape"):
        replace(campaign, command=campaign.command[:5])
    with pytest.raises(InputError, match="posture labels"):
        replace(campaign, posture=("zero",))
    with pytest.raises(InputError, match="one of the 1 setups"):
        replace(campaign, setups=campaign.setups[:1])


# --- Data frames ----------------------------------------------------------------------------


def test_a_bad_frame_names_its_row() -> None:
    frame = pd.DataFrame(good_rows()[1:], columns=good_rows()[0])
    frame.loc[3, "reading_mm"] = np.nan
    with pytest.raises(FileError, match="frame, line 5: reading_mm is empty"):
        Campaign.from_frame(frame)
    with pytest.raises(FileError, match="unequal length"):
        Campaign.from_frame({"setup": ["a"], "leg": []})


# --- Protocols ------------------------------------------------------------------------------


def test_the_standard_protocol_is_the_chapters() -> None:
    sheet = protocol("standard")
    geometry = Geometry()
    assert len(sheet) == 6 * 3 * 3
    for name in ("zero", "xmax", "xmin", "ymax", "ymin", "zmax", "zmin"):
        leg = sheet.leg if name == "zero" else np.full(len(sheet), "xyz".index(name[0]))
        rows = (np.array(sheet.posture) == name[-3:].replace("ero", "zero")) & (sheet.leg == leg)
        expected = np.tile(geometry.command(name), (rows.sum(), 1))
        assert rows.sum() == (18 if name == "zero" else 6)
        np.testing.assert_allclose(sheet.command[rows], expected, atol=6e-10)


def test_no_dial_is_set_where_its_leg_moves_past_it() -> None:
    assert len(og.protocol("sweep", og.Geometry(stroke=(-0.15, 0.06))))
    with pytest.raises(InputError, match=r"moves past a dial .* give a shorter stroke"):
        og.protocol("sweep", og.Geometry(stroke=(-0.16, 0.06)))


# --- TCP points -----------------------------------------------------------------------------


def test_tcp_points(tmp_path: Path) -> None:
    read = read_tcp(write(tmp_path / "c.tcp.csv", TCP + "\n".join(POINTS)))
    points = read.points()
    assert points.command[0].tolist() == [0.31025] * 3
    assert points.p[0].tolist() == [1e-4, 2e-4, 3e-4]
    assert np.isnan(points.p).tolist() == [[False] * 3, [False, True, False]]
    assert not points.approach.any()
    assert np.isnan(points.sigma).all()
    assert points.line.tolist() == [2, 3]
    assert (len(read), read.line.tolist(), len(read.sha256)) == (5, [2, 2, 2, 3, 3], 64)
    assert read.kind == ("tcp",) * 5


def test_a_minus_as_this_package_prints_it_is_one(tmp_path: Path) -> None:
    text = campaign_text(og.simulate(og.Machine.nominal(), og.protocol("standard"), seed=1))
    assert ",-" in text
    plain, printed = tmp_path / "plain.csv", tmp_path / "printed.csv"
    plain.write_text(text)
    printed.write_text(text.replace(",-", ",\N{MINUS SIGN}"), encoding="utf-8")
    one, other = (og.read_campaign(path) for path in (plain, printed))
    assert np.array_equal(one.reading, other.reading)
    assert np.array_equal(one.command, other.command)


def test_a_spreadsheets_own_first_line_and_files_of_another_kind(tmp_path: Path) -> None:
    text, machine = campaign_text(protocol("standard")), og.Machine.nominal()
    (tmp_path / "plain.csv").write_text(text)
    plain = read_campaign(tmp_path / "plain.csv", require_readings=False)
    for first in ("sep=;", '"SEP=;"'):
        (tmp_path / "s.csv").write_text(first + "\n" + text.replace(",", ";"))
        read = read_campaign(tmp_path / "s.csv", require_readings=False)
        np.testing.assert_array_equal(read.command, plain.command)
    machine.save(tmp_path / "machine.toml")
    commented = "# of our machine\n" + (tmp_path / "machine.toml").read_text()
    (tmp_path / "commented.toml").write_text(commented)
    (tmp_path / "result.json").write_text('{\n "schema": 2\n}\n')
    for name in ("machine.toml", "commented.toml", "result.json"):
        with pytest.raises(og.FileError, match=f"{name}: must be CSV, not a result or a machine"):
            og.identify(tmp_path / name)
