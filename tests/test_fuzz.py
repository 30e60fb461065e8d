"""Some hundred spoilt inputs; ``benchmarks/fuzz.py`` runs thousands. What it found stands below."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from benchmarks import fuzz


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


@pytest.mark.parametrize("noise", ["0", "-0.0"])
def test_a_zero_has_no_sign(noise: str, tmp_path: Path) -> None:
    """No generator draws with a standard deviation of -0: case 41278."""
    given = f"placement = {noise}".encode()
    machine = fuzz.originals()["machine"].encode().replace(b"placement = 1.0", given)
    assert given in machine
    asked = ("simulate", "--machine", "m", "--out", "out", "--noise", noise)
    assert fuzz.run_case(fuzz.Case(0, {"m": machine}, asked), tmp_path) == ("", 0)
