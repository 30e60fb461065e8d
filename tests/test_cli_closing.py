"""``demo``, ``close-loop``, ``diagnose`` and ``rerun`` as somebody at a machine runs them."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import orthoglide as og
from orthoglide.cli.app import progress
from orthoglide.cli.calibrating import differences
from orthoglide.progress import Step
from tests.test_cli import EXPERIMENT_2, EXPERIMENT_3, NEVER, done, run, tree

RIG = Path(__file__).parent / "data" / "rig"
FIGURES = ("residuals", "readings", "workspace")
FILES = {
    "result.json", "calibrated.toml", "calibrated.npz", "residuals.csv", "report.html",
    *(f"figures/{name}.svg" for name in FIGURES),
}  # fmt: skip


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of one's own with the published campaigns, to work in."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiment2.csv").write_text(EXPERIMENT_2)
    (tmp_path / "experiment3.csv").write_text(EXPERIMENT_3)
    return tmp_path


@pytest.fixture
def rig(here: Path) -> Path:
    for name in ("rig-1.csv", "rig-2.csv", "rig-2.tcp.csv", "machine.toml"):
        shutil.copyfile(RIG / name, here / name)
    return here


def flat(text: str) -> str:
    return " ".join(text.split())


# --- demo -----------------------------------------------------------------------------------


def test_demo_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first = run("demo")
    assert first.exit_code == 0
    assert all(re.fullmatch(r" *\d+ s  [a-z].*", line) for line in first.stderr.splitlines())
    two, one = flat(first.stdout).split("2. A machine made up")
    said = r"x rail is bent: its middle stands (0\.1[45]\d*) mm toward −z"
    assert "so that its fault is known: the x rail is bent: its middle stands 0.15 mm" in one
    assert re.search(f"Verdict explained: The {said}", one)
    assert two.startswith("1. The machine of the papers")
    assert "Verdict unexplained: The model does not fit" in two
    so = r"Possible cause: .* Probability 0\.\d+\. .* posture from 0\.138 to (0\.1\d+) mm rms"
    assert float(re.search(so, two)[1]) < 0.11  # type: ignore[index]
    assert "What to do: Measure more" in two
    made = tmp_path / "orthoglide-demo"
    assert set(tree(made / "published")) >= FILES
    assert set(tree(made / "simulated")) >= FILES
    worn = og.Machine.load(made / "made-up.toml")
    assert worn.values["rail_bow.x.z"] == 1.5e-4
    assert len(og.read_campaign(made / "simulated.csv")) == 252
    result = json.loads((made / "published" / "result.json").read_text())
    assert result["command"] == "demo"
    assert [one["file"] for one in result["inputs"]] == ["experiment2.csv", "experiment3.csv"]
    assert 0.05 < result["possible"][0]["probability"] < 0.5


# --- In the middle --------------------------------------------------------------------------


@pytest.mark.thorough(except_for=["9"])
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_killed_in_the_middle(here: Path, sent: signal.Signals) -> None:
    child = subprocess.Popen(
        [sys.executable, "-m", "orthoglide", "close-loop", "experiment2.csv", "--out", "out"],
        env=NEVER,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(1.8)
    child.send_signal(sent)
    _, error = child.communicate(timeout=60)
    if child.returncode == 0 or (here / "out").exists():
        json.loads((here / "out" / "result.json").read_text())  # whole: a folder appears at once
        pytest.skip("the run was over before the signal came")
    if sent == signal.SIGINT:
        assert error.splitlines()[-1].startswith("orthoglide: interrupted: nothing")


def test_a_bar_from_the_first_second(here: Path) -> None:
    """On a terminal something moves before anything is computed."""
    master, slave = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "orthoglide", "identify", "experiment2.csv", "--out", "out"],
        env={**NEVER, "TERM": "xterm", "COLUMNS": "100"},
        stdout=subprocess.DEVNULL,
        stderr=slave,
    )
    os.close(slave)
    shown = b""
    while True:
        ready, _, _ = select.select([master], [], [], 60)
        assert ready
        try:
            part = os.read(master, 4096)
        except OSError:  # the other end was closed
            break
        if not part:
            break
        shown += part
    os.close(master)
    assert child.wait() == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    # Short stages are over before the screen is drawn.
    assert 0 <= text.find("starting") < text.find("writing the report")


def test_progress_is_shown_when_piped(capsys: pytest.CaptureFixture[str]) -> None:
    """Plain lines, at most one a second, none of a run that is over at once."""
    with progress(quiet=False) as show:
        show(Step("identifying"))
        assert capsys.readouterr().err == ""
        time.sleep(1.1)
        show(Step("comparing", "axis_tilt.y.z"))
        show(Step("comparing", "axis_tilt.z.y"))
    assert capsys.readouterr().err == "   1 s  comparing axis_tilt.y.z\n"


# --- rerun ----------------------------------------------------------------------------------


RIG_2 = ("rig-2.csv", "--machine", "machine.toml")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of results, each made once: ``closed`` and ``identified``."""
    folder = tmp_path_factory.mktemp("results")
    for name in ("rig-1.csv", "rig-2.csv", "rig-2.tcp.csv", "machine.toml"):
        shutil.copyfile(RIG / name, folder / name)
    with contextlib.chdir(folder):
        done("close-loop", *RIG_2, "--tcp", "rig-2.tcp.csv", "--holdout", "rig-1.csv",
             "--seed", "5", "--out", "closed", "--quiet")  # fmt: skip
        done("identify", *RIG_2, "--out", "identified", "--quiet")
    return folder


@pytest.fixture
def ran(rig: Path, results: Path) -> Path:
    """A folder with the campaigns of the rig and what a closed loop wrote of them in ``out``."""
    shutil.copytree(results / "closed", rig / "out")
    return rig


@pytest.fixture
def identified(rig: Path, results: Path) -> Path:
    """A folder with the campaigns of the rig and what an identification wrote in ``out``."""
    shutil.copytree(results / "identified", rig / "out")
    return rig


def test_rerun_gives_the_same_numbers_and_files(ran: Path) -> None:
    shown = done("rerun", "out/result.json", "--out", "again")
    assert "The same numbers again" in shown
    assert tree(ran / "out") == tree(ran / "again")
    assert set(tree(ran / "out")) >= FILES | {"figures/workspace.svg"}


def change(path: Path, edit: Any) -> None:
    result = json.loads(path.read_text())
    edit(result)
    path.write_text(json.dumps(result))


def test_rerun_says_what_is_not_reproduced(identified: Path) -> None:
    def edit(result: Any) -> None:
        result["parameters"]["joint_offset.x"]["value"] = 3e-3
        result["verdict"] = "adequate"

    change(identified / "out" / "result.json", edit)
    before = tree(identified)
    result = run("rerun", "out/result.json", "--out", "again")
    assert result.exit_code == 3
    assert "is not reproduced" in result.stderr
    assert "joint_offset.x was 0.003 and is " in result.stderr
    assert "the verdict was 'adequate' and is 'unexplained'" in result.stderr
    assert tree(identified) == before


BROKEN: dict[str, tuple[str, str]] = {
    "not JSON": ("{", "is not JSON"),
    "a list": ("[]", "has no 'schema'"),
    "nothing": ("", "give a file with content"),
    "another file": ('{"a": 1}', "has no 'schema'"),
    "arguments of none": ('{"schema": 1, "arguments": 5}', "has no 'version'"),
    "a number without end": (f'{{"schema": {"1" * 5000}}}', "must be the result.json"),
    "points": ('{"schema": 1, "arguments": {"fit_tcp": "a.csv"}}', "has no 'version'"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_rerun_of_what_is_no_result(kind: str, here: Path) -> None:
    text, words = BROKEN[kind]
    (here / "result.json").write_text(text)
    result = run("rerun", "result.json")
    assert result.exit_code == 2, result.output
    assert words in result.stderr
    assert "Traceback" not in result.output


def test_rerun_of_a_spoilt_result(identified: Path) -> None:
    whole = json.loads((identified / "out" / "result.json").read_text())

    def spoilt(key: str, value: Any) -> str:
        (identified / "result.json").write_text(json.dumps({**whole, key: value}))
        result = run("rerun", "result.json")
        assert result.exit_code == 2, (key, value, result.output)
        return result.stderr

    assert "this version runs" in spoilt("schema", 3)
    assert "this version runs" in spoilt("command", "compare")
    assert "not as it was written" in spoilt("inputs", [{"file": "a.csv"}])
    assert "not as it was written" in spoilt("machine", {"toml": "x"})
    assert "not as it was written" in spoilt("seed", "today")
    assert "not as it was written" in spoilt("arguments", {})
    assert "not as it was written" in spoilt("arguments", {**whole["arguments"], "machine": True})
    assert "not as it was written" in spoilt("arguments", {**whole["arguments"], "noise_mm": -1})
    assert "inputs has no campaign" in spoilt("inputs", [])
    one = whole["inputs"][0]
    for key, value, words in (
        ("file", "..", "expected the name of a file"),
        ("file", "a/b.csv", "expected the name of a file"),
        ("file", "a" * 300, "expected the name of a file"),
        ("rows", [5, *one["rows"][1:]], "expected object"),
        ("rows", [], "has no rows"),
        ("lines", [2, 3], "line numbers that do not match them"),
        ("lines", [10**9 + k for k in range(len(one["rows"]))], "line numbers that do not match"),
        ("lines", ["2"], "expected int"),
        ("role", "judge", "expected campaign or fit_tcp"),
    ):
        assert words in spoilt("inputs", [{**one, key: value}])


def test_values_are_the_same_to_rounding_or_to_a_fifth_of_sigma_of_another_version() -> None:
    def result(value: float, version: str = "1", **more: Any) -> dict[str, Any]:
        of_a = {"value": value, "sigma": 0.1, "unit": "mm"}
        return {"version": version, "verdict": "adequate", "parameters": {"a": of_a}} | more

    new = result(1.0)
    assert list(differences(result(1.0 + 1e-7), new)) == []
    assert list(differences(result(1.01), new)) == ["a was 1.01 and is 1 mm"]
    assert list(differences(result(1.01, "0"), new)) == []
    assert list(differences(result(1.03, "0"), new)) == ["a was 1.03 and is 1 mm"]
    assert list(differences(result(float("nan")), new)) == ["a was – and is 1 mm"]
    assert list(differences(new | {"parameters": {}}, new)) == ["a is new"]
    assert list(differences(new, new | {"parameters": {}})) == ["a is gone"]
    said = ["the verdict was 'located' and is 'adequate'"]
    assert list(differences(result(1.0, verdict="located"), new)) == said
