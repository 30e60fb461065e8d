"""Some hundred spoilt inputs; ``benchmarks/fuzz.py`` runs thousands. What it found stands below."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import orthoglide as og
from benchmarks import fuzz, fuzz_verdicts
from orthoglide.fit import assemble, read_tables, solve
from orthoglide.simulation import simulate

CASES = 120
CHUNK = 5


@pytest.mark.parametrize(
    "first",
    [
        0,
        *(pytest.param(k, marks=pytest.mark.thorough) for k in range(CHUNK, CASES, CHUNK)),
    ],
)
def test_spoilt_inputs_end_as_promised(first: int, tmp_path: Path) -> None:
    wrong = {}
    for number in range(first, first + CHUNK):
        folder = tmp_path / str(number)
        folder.mkdir()
        found, _ = fuzz.run_case(fuzz.draw_case(number, light=number % 10 > 0), folder)
        if found:
            wrong[number] = found
    assert not wrong


def test_spoilt_files_of_printers_give_a_sentence_or_a_right_import(tmp_path: Path) -> None:
    """``benchmarks/fuzz.py --count 3000 --only "import klipper"`` runs thousands."""
    wrong = {}
    for number in range(20):
        folder = tmp_path / str(number)
        folder.mkdir()
        found, _ = fuzz.run_case(fuzz.draw_case(number, only="import klipper"), folder)
        if found:
            wrong[number] = found
    assert not wrong


def test_a_sound_input_is_found_sound(tmp_path: Path) -> None:
    case = fuzz.Case(0, {"rho": fuzz.originals()["rho"].encode()}, ("forward", "--csv", "rho"))
    out = fuzz.Case(0, case.files, (*case.arguments, "--out", "out"))
    assert fuzz.run_case(out, tmp_path) == ("", 0)


def crash(path: Path) -> None:
    raise KeyError("lost")


def leave(path: Path) -> None:
    Path("out").mkdir()
    raise SystemExit(2)


def end_oddly(path: Path) -> None:
    raise SystemExit(1)


def hang(path: Path) -> None:
    while True:
        time.process_time()


def say_nothing(path: Path) -> None:
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (crash, "KeyError: 'lost'"),
        (leave, "leaves out behind"),
        (end_oddly, "exit code 1"),
        (hang, "takes longer than"),
        (say_nothing, "says []"),
    ],
)
def test_every_broken_promise_is_seen(
    fault: object, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fuzz, "LIMIT", 0.3 if fault is hang else 10.0)
    content = fuzz.originals()["rho"].encode()
    monkeypatch.setattr("orthoglide.observations.table.read_table", fault)
    case = fuzz.Case(0, {"rho": content}, ("forward", "--csv", "rho", "--out", "out"))
    found, _ = fuzz.run_case(case, tmp_path)
    assert found.startswith(told)
    assert Path.cwd() != tmp_path
    assert "ORTHOGLIDE_TRACEBACK" not in os.environ


@pytest.mark.parametrize(
    ("name", "content"),
    [("r.json", '{"a": NaN}'), ("r.json", '{"a"'), ("f.svg", "<svg>\x1b</svg>"), ("t.csv", '"a')],
)
def test_results_that_cannot_be_read_are_seen(name: str, content: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    assert fuzz.unreadable(tmp_path).startswith(f"{name} cannot be read")
    (tmp_path / name).write_text({"r": "{}", "f": "<svg/>", "t": "a\n"}[name[0]])
    assert fuzz.unreadable(tmp_path) == ""


# --- What it found ------------------------------------------------------------------------------


def spoilt_result(edit: Callable[[dict[str, Any]], object], folder: Path) -> tuple[str, int]:
    """How a result ends that was edited by hand."""
    result = json.loads(fuzz.originals()["result"])
    edit(result)
    content = json.dumps(result).encode()
    return fuzz.run_case(fuzz.Case(0, {"r.json": content}, ("rerun", "r.json")), folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [("npz", 0), ("npz", []), ("npz", ""), ("npz", "AAAA"), ("sha256", 3), ("toml", 1)],
)
def test_a_machine_in_a_result_that_is_none(key: str, value: object, tmp_path: Path) -> None:
    assert spoilt_result(lambda r: r["machine"].update({key: value}), tmp_path) == ("", 2)


@pytest.mark.parametrize("noise", ["0", "-0.0"])
def test_a_zero_has_no_sign(noise: str, tmp_path: Path) -> None:
    """No generator draws with a standard deviation of -0: case 41278."""
    given = f"placement = {noise}".encode()
    machine = fuzz.originals()["machine"].encode().replace(b"placement = 1.0", given)
    assert given in machine
    asked = ("simulate", "--machine", "m", "--out", "out", "--noise", noise)
    assert fuzz.run_case(fuzz.Case(0, {"m": machine}, asked), tmp_path) == ("", 0)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_result_is_none(share: float, tmp_path: Path) -> None:
    whole = fuzz.originals()["result"].encode()
    part = whole[: int(share * len(whole))]
    case = fuzz.Case(0, {"r.json": part}, ("rerun", "r.json"))
    assert fuzz.run_case(case, tmp_path) == ("", 2)


# --- Verdicts on readings that were moved -------------------------------------------------------


@pytest.mark.parametrize(
    "number", [pytest.param(k, marks=pytest.mark.thorough) for k in (1, 2, 3, 5, 6, 7, 35)]
)
def test_moved_readings_are_not_adequate_without_a_word(number: int) -> None:
    found = fuzz_verdicts.judged(number)
    kinds = list(fuzz_verdicts.KINDS)
    assert found.kind == kinds[number % len(kinds)]
    assert found.moved > fuzz_verdicts.FIVE
    assert not found.false


@pytest.mark.thorough
def test_a_reading_too_near_to_be_set_aside_is_spoken_of() -> None:
    """Eight sigmas beside its repeats: one line to be read again, no fault."""
    machine = og.Machine.load(Path(__file__).parent / "data" / "rig" / "machine.toml")
    campaign = simulate(machine, "sweep", noise=5e-6, seed=2)
    assert [w for w in og.identify(campaign, machine).warnings if w.kind == "slip"] == []
    reading = campaign.reading.copy()
    reading[31] += 4.5e-5
    found = og.identify(campaign.with_readings(reading), machine)
    (note,) = [w for w in found.warnings if w.kind == "slip"]
    (line,) = note.lines
    assert line == campaign.line[31]
    assert f"line {line}: up to " in note
    assert note.endswith("read it again")


@pytest.mark.thorough
def test_a_fit_begun_at_a_fit_is_no_worse(tmp_path: Path) -> None:
    """Instruments brought to the machine found: a step from there led to 73 000. Case 42235."""
    for name, content in fuzz.draw_case(42235).files.items():
        (tmp_path / name).write_bytes(content)
    machine = og.Machine.load(tmp_path / "given1")
    points = read_tables([tmp_path / "tool.csv"], machine)
    assert solve(assemble(points, machine, machine.catalogue.base)).scores.chi2 < 30_000
