"""A result as values: what is written is read back, and a report needs nothing else."""

import json
import math
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import given, strategies as st

import orthoglide as og
from orthoglide.figures.draw import MAX_DRAWN, _rows_to_draw
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit
from orthoglide.report import result_text
from orthoglide.result import decoded, encoded
from orthoglide.result.codec import Key, Metres, MetresField

RIG = Path(__file__).parent / "data" / "rig"


@dataclass(frozen=True)
class Part:
    """A value within another."""

    name: str
    length: Metres

    def derived(self) -> dict[str, Any]:
        """For readers of the file."""
        return {"twice_mm": Key(si=1e-3).number(2 * self.length)}


@dataclass(frozen=True)
class Whole:
    """A value with a field of every type that results have."""

    flag: bool
    count: int
    share: float
    length: Metres
    short: Annotated[float, Key("brief", "_mm", 1e-3, digits=3)]
    turn: Annotated[float, Key("turn", "_mrad", 1e-3, omit_if_nan=True)]
    endless: Annotated[float, Key(null=math.inf)]
    both: ByUnit
    parts: tuple[Part, ...]
    pair: tuple[float, str]
    flat: Annotated[Part, Key(inline=True)]
    perhaps: Part | None
    note: Note
    by_name: Mapping[str, float]
    kind: Literal["one", "other"]
    field: MetresField
    numbers: np.ndarray[Any, np.dtype[np.int64]]
    unwritten: Annotated[int, Key(in_file=False)] = 7


def whole(x: float, *, turn: float = math.nan, perhaps: bool = False) -> Whole:
    """A value that depends on one number."""
    part = Part("a", x)
    return Whole(
        True, 3, x, x, x, turn, math.inf, ByUnit(x, turn), (part, Part("b", 2 * x)), (x, "mm"),
        part, part if perhaps else None, Note("look", "side", (2, 3)), {"x": x, "y": math.nan},
        "one", np.array([[x, 0.0]]), np.array([4, 5]),
    )  # fmt: skip


@given(st.floats(-1e3, 1e3, allow_subnormal=False), st.booleans())
def test_what_was_written_is_read_back_and_written_the_same(x: float, known: bool) -> None:
    first = decoded(Whole, encoded(whole(x, turn=x if known else math.nan, perhaps=known)), {})
    text = json.dumps(encoded(first), allow_nan=False)
    again = decoded(Whole, json.loads(text), {})
    assert json.dumps(encoded(again), allow_nan=False) == text
    assert again.length == pytest.approx(x, rel=1e-9, abs=1e-300)
    assert again.short == pytest.approx(x, rel=1e-2, abs=1e-300)
    assert (again.perhaps is not None) == known == math.isfinite(again.turn)
    assert again.endless == math.inf
    assert math.isnan(again.by_name["y"])
    assert (again.note, again.note.kind, again.note.lines) == ("look", "side", (2, 3))
    assert again.unwritten == 7
    assert again.numbers.dtype == np.int64


def test_keys_have_their_units_and_only_what_is_known_of_inclinations() -> None:
    data = encoded(whole(0.5))
    assert data["length_mm"] == data["brief_mm"] == data["both_mm"] == 500.0
    assert data["twice_mm"] == 1000.0  # of the part that is flat
    assert data["parts"][1] == {"name": "b", "length_mm": 1000.0, "twice_mm": 2000.0}
    assert data["field_mm"] == [[500.0, 0.0]]
    assert not {"turn_mrad", "both_mrad", "unwritten", "flat"} & data.keys()
    known = encoded(whole(0.5, turn=0.002))
    assert known["turn_mrad"] == known["both_mrad"] == 2.0


@pytest.mark.parametrize(
    ("key", "value"),
    [("flag", 1), ("count", "3"), ("parts", [{"name": "b"}]), ("pair", [1.0]), ("name", None)],
)
def test_what_was_edited_is_refused(key: str, value: Any) -> None:
    data = encoded(whole(0.5)) | {key: value}
    with pytest.raises((KeyError, TypeError, ValueError)):
        decoded(Whole, data, {})


@pytest.fixture(scope="module")
def verdict() -> og.Verdict:
    return og.close_loop(
        RIG / "rig-2.csv",
        RIG / "machine.toml",
        tcp=RIG / "rig-2.tcp.csv",
        holdout=RIG / "rig-1.csv",
    )


@pytest.fixture(scope="module")
def folder(verdict: og.Verdict, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("result") / "out"
    verdict.report(out)
    return out


def test_a_loaded_result_says_the_same(verdict: og.Verdict, folder: Path) -> None:
    for given_path in (folder / "result.json", str(folder)):
        again = og.Result.load(given_path)
        assert type(again) is og.Result
        assert encoded(again) == encoded(verdict)
    assert [e.name for e in again.effects] == [e.name for e in verdict.effects]
    assert again.machine.values == pytest.approx(verdict.machine.values, rel=1e-9, abs=1e-12)
    assert repr(again.hold_out) == repr(verdict.hold_out)
    assert repr(again.tcp) == repr(verdict.tcp)
    same = again.to_frame()
    assert same.equals(verdict.to_frame())


def test_a_row_of_readings_is_a_line_of_the_file(verdict: og.Verdict) -> None:
    text = result_text(verdict)
    found = json.loads(text)
    assert found == json.loads(json.dumps(verdict.as_dict(found["summary"])))
    lines = {line.strip().rstrip(",") for line in text.splitlines()}
    rows = found["inputs"][0]["rows"]
    assert len(rows) == 54
    assert {json.dumps(row, ensure_ascii=False) for row in rows} <= lines


@pytest.mark.parametrize("count", [1, 400, 401, 30_000])
def test_of_many_readings_the_extremes_are_drawn(count: int) -> None:
    rng = np.random.default_rng(count)
    x, left = rng.uniform(-100, 60, count), rng.normal(size=count)
    drawn = _rows_to_draw(x, left)
    assert len(drawn) == len(set(drawn)) == (count if count <= MAX_DRAWN else len(drawn))
    assert len(drawn) <= MAX_DRAWN
    assert {left.argmax(), left.argmin()} <= set(drawn)
    assert np.all(np.diff(drawn) > 0)
    assert len(_rows_to_draw(np.zeros(count), left)) <= MAX_DRAWN


def test_a_report_is_written_without_the_search(folder: Path, tmp_path: Path) -> None:
    program = (
        "import sys, orthoglide as og; og.Verdict.load(sys.argv[1]).report(sys.argv[2]); "
        "print(*[m for m in sys.modules if m.startswith('orthoglide.')])"
    )
    out = tmp_path / "again"
    command = [sys.executable, "-c", program, str(folder), str(out)]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "orthoglide.report" in loaded
    assert not {f"orthoglide.{m}" for m in ("closing", "explanation")} & set(loaded)
    for path in folder.rglob("*"):
        if path.is_file():
            assert (out / path.relative_to(folder)).read_bytes() == path.read_bytes(), path.name


def edited(folder: Path, out: Path, **keys: Any) -> Path:
    """A result whose keys are others; one that is ``None`` is gone."""
    found = json.loads((folder / "result.json").read_text("utf-8")) | keys
    gone = {key for key, value in keys.items() if value is None}
    out.write_text(json.dumps({k: v for k, v in found.items() if k not in gone}), "utf-8")
    return out


@pytest.mark.parametrize(
    "keys",
    [
        {"effects": [{}]},
        {"verdict": "fine"},
        {"cautions": "beware"},
        {"rms_of_all_mm": "0.1"},
        {"calibrated_before": 1},
        {"sigma_scale": 1, "workspace": {"at_mm": [[10**400]]}},
        {"arguments": {"campaigns": [], "own": [], "machine": None, "noise_mm": 10**400}},
        {"readings": {}},
        {"calibrated_machine": {"toml": 3}},
        {"actions": "none"},
    ],
    ids=lambda keys: next(iter(keys)),
)
def test_an_edited_result_is_refused_by_its_name(
    folder: Path, tmp_path: Path, keys: Mapping[str, Any]
) -> None:
    path = edited(folder, tmp_path / "edited.json", **keys)
    with pytest.raises(og.FileError, match=r"edited\.json.*take the original"):
        og.Result.load(path)


def test_effects_of_its_own_are_asked_for(folder: Path, tmp_path: Path) -> None:
    machine = json.loads((folder / "result.json").read_text("utf-8"))["calibrated_machine"]
    machine["toml"] = machine["toml"].replace("joint_offset.x", "sag.x")
    path = edited(folder, tmp_path / "own.json", calibrated_machine=machine)
    words = r"own\.json: had effects of its own: .*Verdict\.load\(path, effects=\[\.\.\.\]\)"
    with pytest.raises(og.FileError, match=words):
        og.Verdict.load(path)


def test_rows_that_were_edited_are_blamed_on_the_result(folder: Path, tmp_path: Path) -> None:
    inputs = json.loads((folder / "result.json").read_text("utf-8"))["inputs"]
    inputs[0]["rows"][0]["reading_mm"] = "abc"
    path = edited(folder, tmp_path / "edited.json", inputs=inputs)
    with pytest.raises(og.FileError, match=r"edited\.json: .*rig-2\.csv, line 2"):
        og.Result.load(path)


@pytest.mark.parametrize("key", ["left", "picture", "calibrated_machine"])
def test_a_result_that_lacks_a_key_says_how_to_go_on(
    folder: Path, tmp_path: Path, key: str
) -> None:
    path = edited(folder, tmp_path / "old.json", **{key: None})
    with pytest.raises(og.FileError, match=rf"lacks {key}:.*rerun .*old\.json --out DIR"):
        og.Result.load(path)
