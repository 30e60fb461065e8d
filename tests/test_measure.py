"""``orthoglide measure``: the conversation, the file it leaves, and what it comes to."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orthoglide as og
from orthoglide.cli import cli
from orthoglide.errors import FileError, InputError
from orthoglide.measuring import Record, Session
from orthoglide.measuring.session import SETTLED_CRITERION, SessionEnd, opening_sheet, parse_answer
from tests.rig import Rig
from tests.rig_campaigns import read_csv
from tests.rig_operator import Operator

ROOT = Path(__file__).parents[1]
MACHINE = ROOT / "tests" / "data" / "rig" / "machine.toml"
TILTED = {"axis_tilt.y.z": 4e-3, "joint_offset.x": 0.6e-3, "joint_offset.z": -0.4e-3}


# --- What is typed ----------------------------------------------------------------------------


def test_numbers_and_words_are_understood_exactly() -> None:
    numbers = {
        "4.12": "4.12", "4,12\n": "4.12", " -0.305 mm": "-0.305", "−1": "-1", "340um": "0.340",
        "340 µm": "0.340", "+.5": "0.5", "12.50": "12.50",
    }  # fmt: skip
    words = {"skip": "skip", "BACK": "undo", "u": "undo", "q": "quit", "?": "help"}
    for typed, meant in numbers.items():
        assert parse_answer(typed) == Decimal(meant), typed
    for typed, meant in words.items():
        assert parse_answer(typed) == meant, typed
    for typed in ("", "4.1.2", "1,234.5", "four", "4 in", "nan", "1e3", "5000"):
        with pytest.raises(InputError):
            parse_answer(typed)


# --- The conversation -------------------------------------------------------------------------


def conversation(
    path: Path,
    machine: og.Machine,
    answer: Callable[[str, Operator], str],
    max_readings: int | None = None,
) -> tuple[Operator, list[str], Callable[[], SessionEnd | None]]:
    """A session with an operator; ``answer`` may change what it says."""
    operator = Operator(Rig(errors=TILTED), np.random.default_rng(5))
    said: list[str] = []

    def tell(text: str) -> None:
        said.extend(text.split("\n"))
        for line in text.split("\n"):
            operator.hear(line)

    seconds = iter(range(0, 10**6, 10))
    session = Session(machine, Record(path, machine.spec), lambda q: answer(q, operator), tell,
                      clock=lambda: float(next(seconds)),
                      max_readings=max_readings)  # fmt: skip
    return operator, said, session.run


def answering(operator: Operator, question: str) -> str:
    return f"{operator.hear(question):.2f}"


def scripted(*words: str) -> Callable[[str, Operator], str]:
    """Readings, but for some words in between: a number at ``=``."""
    left = list(words)

    def answer(question: str, operator: Operator) -> str:
        word = left.pop(0) if left else "quit"
        return answering(operator, question) if word == "=" else word

    return answer


def test_every_reading_is_in_the_file_before_the_next_question(
    machine: og.Machine, tmp_path: Path
) -> None:
    seen: list[int] = []
    path = tmp_path / "c.csv"

    def answer(question: str, operator: Operator) -> str:
        seen.append(sum(row["kind"] == "leg" for row in read_csv(path)))
        return answering(operator, question) if len(seen) < 6 else "q"

    _, _, run = conversation(path, machine, answer)
    assert run() is None
    assert seen == [0, 1, 2, 3, 4, 5]
    rows = read_csv(path)
    assert [row["kind"] for row in rows] == ["move"] + ["leg"] * 5
    assert [row["order"] for row in rows] == list(range(6))
    assert og.read_campaign(path, machine.spec).approach[0].tolist() == [1, 1, 1]


def test_skip_undo_and_nonsense(machine: og.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    words = ("undo", "?", "=", "=", "five", "=", "skip", "=", "undo", "=", "999", "=",
             "=", "=")  # fmt: skip
    _, said, run = conversation(path, machine, scripted(*words))
    assert run() is None
    text = "\n".join(said)
    assert "there is no reading to take back" in text
    assert "must be a number such as 12.34, not 'five'" in text
    assert SETTLED_CRITERION in text
    assert "999 mm cannot be: the dial would have moved" in text
    rows = read_csv(path)
    assert [row["posture"] for row in rows] == [
        "move", "+34.2", "+34.2", "+60", "skipped", "again", "+34.2", "+34.2", "+0", "+0",
    ]  # fmt: skip
    # Led back, it comes to the place from the same side as before.
    campaign = og.read_campaign(path, machine.spec)
    plan = opening_sheet(machine)
    np.testing.assert_array_equal(campaign.approach, plan.approach[[0, 1, 2, 4, 5, 6, 7]])
    np.testing.assert_array_equal(campaign.approach[:, 0], [1, 1, 1, -1, -1, -1, -1])


def test_a_file_of_something_else_is_refused(machine: og.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    path.write_text("a,b\n1,2\n")
    _, _, run = conversation(path, machine, scripted())
    with pytest.raises(FileError, match="was not begun by this command"):
        run()
    assert path.read_text() == "a,b\n1,2\n"
    path.unlink()
    _, _, run = conversation(path, machine, scripted("=", "=", "="))
    assert run() is None
    path.write_text(path.read_text().replace("xy-", "zx-"))
    _, _, run = conversation(path, machine, scripted("="))
    with pytest.raises(FileError, match="was not measured with this machine file and sheet"):
        run()


def test_what_a_reading_contradicts_can_be_undone(machine: og.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    words = ("99", "=", "=", "undo", "undo", "=", "=", "=")
    _, said, run = conversation(path, machine, scripted(*words))
    assert run() is None
    (objection,) = [line for line in said if "mm cannot be" in line]
    assert "mm from the 99 mm of line 3, which no leg does" in objection
    assert "if line 3 is wrong, type undo 2 times" in objection
    assert [row["kind"] for row in read_csv(path)].count("leg") == 3


Lines = Callable[[list[str]], list[str]]

EDITED: dict[str, tuple[Lines, str]] = {
    "no number": (lambda lines: [*lines[:4], lines[4] + "abc", *lines[5:]],
                  r"line 5: reading_mm is '.*abc', not a number"),
    "no time": (lambda lines: [*lines[:4], lines[4].replace(",,30,", ",,zero,"), *lines[5:]],
                "line 5: time_s is 'zero', not a number"),
    "emptied": (lambda lines: [*lines[:4], lines[4].rpartition(",")[0] + ",", *lines[5:]],
                "line 5: reading_mm is empty: fill it in, or make its kind move"),
    "removed": (lambda lines: [*lines[:4], *lines[5:]],
                "line 5: has order 4, not 3: put back what was removed, of kind move"),
    "out of reach": (lambda lines: [*lines[:4], lines[4].rpartition(",")[0] + ",450", *lines[5:]],
                     "line 5: reading_mm is 450, and the readings of setup"),
}  # fmt: skip


@pytest.mark.parametrize("kind", EDITED)
def test_what_was_edited_is_checked_before_the_next_question(
    kind: str, machine: og.Machine, tmp_path: Path
) -> None:
    path, (edit, words) = tmp_path / "c.csv", EDITED[kind]
    assert conversation(path, machine, scripted(*"====="))[2]() is None
    whole = path.read_text().splitlines()
    text = "\n".join([*edit(whole), ""])
    path.write_text(text)
    _, said, run = conversation(path, machine, scripted("="))
    with pytest.raises(FileError, match=words):
        run()
    assert path.read_text() == text
    assert said == []


def test_a_row_made_a_move_is_skipped(machine: og.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    assert conversation(path, machine, scripted(*"====="))[2]() is None
    lines = path.read_text().splitlines()
    lines[4] = lines[4].replace("leg,", "move,", 1).rpartition(",")[0] + ","
    path.write_text("\n".join([*lines, ""]))
    assert conversation(path, machine, scripted("="))[2]() is None
    assert [row["kind"] for row in read_csv(path)] == ["move", "leg", "leg", "move", "leg", "leg",
                                                       "move", "leg"]  # fmt: skip


def test_a_spreadsheets_file_and_a_torn_one_go_on(machine: og.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    assert conversation(path, machine, scripted(*"==="))[2]() is None
    text = path.read_text()
    saved = re.sub(r"(?<=;)(-?\d+)\.(?=\d+[;\n])", r"\1,", text.replace(",", ";"))
    path.write_bytes(b"\xef\xbb\xbf" + saved.replace("\n", "\r\n").encode())
    assert conversation(path, machine, scripted("="))[2]() is None
    assert path.read_text().startswith(text)
    assert [row["kind"] for row in read_csv(path)] == ["move"] + ["leg"] * 3 + ["move", "leg"]
    path.write_text(text[:15])
    assert conversation(path, machine, scripted(*"==="))[2]() is None
    assert path.read_text().splitlines()[:5] == text.splitlines()[:5]


def test_a_sheet_of_nothing_is_followed_by_another(machine: og.Machine, tmp_path: Path) -> None:
    path, count = tmp_path / "c.csv", len(opening_sheet(machine))
    words = (*["skip"] * count, "=")
    _, said, run = conversation(path, machine, scripted(*words))
    assert run() is None
    assert any(f"no dial was read at two places without moving it): {count}" in s for s in said)
    assert [row["kind"] for row in read_csv(path)].count("leg") == 1


def test_no_more_readings_than_asked_for(machine: og.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    _, _, run = conversation(path, machine, scripted("=", "="), max_readings=2)
    with pytest.raises(FileError, match=r"no verdict is possible .*: give a larger --most"):
        run()
    assert [row["kind"] for row in read_csv(path)].count("leg") == 2


# --- In a process of its own --------------------------------------------------------------------


def lines_of(process: subprocess.Popen[str]) -> Iterator[str]:
    assert process.stdout is not None
    for line in process.stdout:
        yield line.rstrip("\n")


def start(path: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "orthoglide", "measure", "--machine", str(MACHINE)]
    return subprocess.Popen(
        [*command, "--out", str(path), *words], text=True, bufsize=1, encoding="utf-8",
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1",
             "PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip


def serve(process: subprocess.Popen[str], operator: Operator, most: int = 10**6) -> list[str]:
    """Answer questions down a pipe until the end, or until so many were answered."""
    said, count = [], 0
    for line in lines_of(process):
        said.append(line)
        reading = operator.hear(line)
        if reading is not None:
            if count == most:
                break
            count += 1
            assert process.stdin is not None
            process.stdin.write(f"{reading:.2f}\n")
    return said


@pytest.mark.thorough
def test_a_campaign_that_was_killed_goes_on_and_names_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "april.csv"
    operator = Operator(Rig(errors=TILTED), np.random.default_rng(11))
    process = start(path)
    serve(process, operator, 20)
    process.kill()
    process.communicate()
    kept = [row for row in read_csv(path) if row["kind"] == "leg"]
    assert len(kept) == 20  # nothing is lost

    process = start(path)
    serve(process, operator, 3)
    process.send_signal(signal.SIGINT)
    process.wait(timeout=60)  # its input stays open: an end of it is no interruption
    _, errors = process.communicate()
    assert process.returncode == 130
    assert errors.splitlines()[-1].startswith("orthoglide: interrupted: nothing is left half")

    process = start(path)
    said = serve(process, operator)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    text = "\n".join(said)
    assert "23 readings: going on" in text
    assert "Settled after" in text
    rows = [row for row in read_csv(path) if row["kind"] == "leg"]
    assert rows[:20] == kept
    assert len(rows) <= 126  # half of a sweep sheet
    verdict = og.close_loop(path, og.Machine.load(MACHINE))
    named = {name for e in verdict.effects for name in (e.name, *e.indistinguishable_from)}
    assert "axis_tilt.y.z" in named
    assert not [
        c for c in verdict.effects if c.name.partition(".")[0] not in ("axis_tilt", "rail_tilt")
    ]
    assert verdict.values["joint_offset.x"] == pytest.approx(0.6e-3, abs=0.1e-3)

    process = start(path)  # settled already: it asks for nothing more
    said, _ = process.communicate("", timeout=120)
    assert process.returncode == 0
    assert "shows:" not in said


def test_the_end_of_the_input_is_a_stop(tmp_path: Path) -> None:
    command = ["measure", "--machine", str(MACHINE), "--out", str(tmp_path / "c.csv")]
    result = CliRunner().invoke(cli, command, input="0\n")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "Stopped with 1 reading in" in result.stdout
    assert result.stdout.count("shows:") == 2
