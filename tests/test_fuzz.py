"""Some hundred spoilt inputs; ``benchmarks/fuzz.py`` runs thousands. What it found stands below."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import fuzz, fuzz_verdicts


@pytest.mark.parametrize(
    ("count", "only"), [(5, ""), (20, "import klipper")], ids=["any", "klipper"]
)
def test_spoilt_inputs_end_as_promised(count: int, only: str, tmp_path: Path) -> None:
    """``benchmarks/fuzz.py --count 3000`` runs thousands, also ``--only "import klipper"``."""
    wrong = {}
    for number in range(count):
        folder = tmp_path / str(number)
        folder.mkdir()
        case = fuzz.draw_case(number, light=number > 0, only=only)
        found, _ = fuzz.run_case(case, folder)
        if found:
            wrong[number] = found
    assert not wrong


def test_a_sound_input_is_found_sound(tmp_path: Path) -> None:
    case = fuzz.Case(0, {"rho": fuzz.originals()["rho"].encode()}, ("forward", "--csv", "rho"))
    out = fuzz.Case(0, case.files, (*case.arguments, "--out", "out"))
    assert fuzz.run_case(out, tmp_path) == ("", 0)


def crash(path: Path) -> None:
    raise KeyError("lost")


def hang(path: Path) -> None:
    while True:
        time.process_time()


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (crash, "KeyError: 'lost'"),
        (hang, "takes longer than"),
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


def test_a_verdict_on_sound_readings_is_judged_true() -> None:
    judged = fuzz_verdicts.judged(0)
    assert judged.kind == "as read"
    assert judged.moved < 1e-9
    assert judged.off == 0.0
    assert judged.word == "adequate"
    assert not judged.false


def test_a_moved_reading_is_judged_by_its_distance_from_the_fit() -> None:
    """Readings magnified by less than two sigmas are left as they are, and are no false verdict."""
    judged = fuzz_verdicts.judged(8)
    assert judged.kind == "magnified"
    assert judged.word == "adequate"
    assert not judged.told
    assert 1 < judged.off < 2
    assert not judged.false
