"""The report of a closed loop: true to the verdict, self-contained, the same bytes, readable."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import orthoglide as og
from orthoglide.closing import Closed, filled
from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import cause_short, cause_words
from orthoglide.errors import FileError
from orthoglide.numerals import ByUnit
from orthoglide.observations import Campaign, protocol
from orthoglide.report import report_files, summary
from orthoglide.report.sections import before_and_after
from orthoglide.report.words import dealt_with, evidence, headline
from orthoglide.result import HoldOut
from orthoglide.verdict import Verdict, close_loop
from tests.page_laws import broken, too_long
from tests.studied import studied
from tests.test_report import RIG, browsed, check_page, check_timeless, opened, words

CASES = ("explained", "partial", "unexplained", "faulty")


@cache
def rig_machine() -> og.Machine:
    return og.Machine.load(RIG / "machine.toml")


def swept(extra: float | np.ndarray = 0.0, seed: int = 0) -> Campaign:
    """A sweep of a machine with offsets alone, and something besides in the readings."""
    sheet, machine = protocol("sweep"), rig_machine()
    real = machine.with_parameters({"joint_offset.x": 4e-4, "joint_offset.z": -7e-4})
    noise = np.random.default_rng(seed).normal(scale=5e-6, size=len(sheet))
    return replace(sheet.with_readings(real.readings(sheet) + noise + extra), name="sweep")


def travel(sheet: Campaign) -> np.ndarray:
    return sheet.command[np.arange(len(sheet)), sheet.leg] - rig_machine().geometry.L


def odd() -> np.ndarray:
    """Another error at every station: nothing smooth does that."""
    sheet = protocol("sweep")
    stations = np.column_stack([sheet.setup, sheet.command, sheet.approach])
    _, station = np.unique(stations, axis=0, return_inverse=True)
    return np.random.default_rng(3).normal(scale=4e-5, size=station.max() + 1)[station.reshape(-1)]


def faulty() -> Campaign:
    campaign = og.read_campaign(RIG / "rig-3.csv", rig_machine().spec)
    reading = campaign.reading.copy()
    reading[39] += 8e-4
    return campaign.with_readings(reading)


@cache
def verdict_of(which: str) -> Verdict:
    return filled(closed_of(which), Verdict)


@cache
def closed_of(which: str) -> Closed:
    machine = rig_machine()
    if which == "partial":
        tilted = machine.with_parameters({"axis_tilt.y.z": 5e-3})
        sheet = protocol("sweep")
        more = tilted.readings(sheet) - machine.readings(sheet)
        return studied(swept(odd() + more), machine, holdout=swept(seed=1))
    if which == "explained":
        points = og.read_tcp(RIG / "rig-2.tcp.csv", machine.spec)
        return studied(og.read_campaign(RIG / "rig-2.csv", machine.spec), machine, tcp=points)
    return studied(swept(odd()) if which == "unexplained" else faulty(), machine)


@cache
def files_of(which: str) -> dict[str, str]:
    return report_files(verdict_of(which))


def cause(name: str, values: dict[str, float]) -> str:
    return cause_words(CATALOGUE, name, values)


def short(name: str) -> str:
    return cause_short(CATALOGUE, name)


# --- The page -------------------------------------------------------------------------------


@pytest.mark.parametrize("which", CASES)
def test_the_page_keeps_its_laws(which: str) -> None:
    """It is well formed, self-contained and timeless, and reads plainly from the top."""
    page, verdict = files_of(which)["report.html"], verdict_of(which)
    assert verdict.word == ("explained" if which == "faulty" else which)
    assert bool(verdict.blunders) == ('id="faults"' in page) == (which == "faulty")
    check_page(page)
    check_timeless(files_of(which))
    assert not re.search(r"[a-z]\.\.(?!\.)", words(page))
    assert not [*broken(page, dials=True)]
    assert not too_long(headline(verdict_of(which)))
    order = ['class="word', 'class="sentence"', 'class="tiles tool"', 'class="drawn"', "What to do"]
    assert [page.index(part) for part in order] == sorted(page.index(part) for part in order)


def test_the_laws_of_the_page_see_what_breaks_them() -> None:
    code, zeros = "<p>by axis_tilt.y.z</p>", "<table><tr><td>x</td><td>0.0000</td></tr></table>"
    tile = '<div class="tile"><dd>0.26 mm</dd><dd>± 0.003 in a workpiece</dd></div>'
    for markup in (code, zeros, tile, "<p>a place rail.x.z/travel</p>"):
        assert len([*broken(markup, dials=True)]) == 1
        assert not [*broken(f"<details><summary>more</summary>{markup}</details>", dials=True)]
    assert (
        len(
            [
                *broken(
                    f"<p>{'what there is to say, and ' * 3} the dials on legs show it all</p>",
                    dials=False,
                )
            ]
        )
        == 1
    )
    assert too_long("short. " + "word " * 31 + "end.")


@pytest.mark.thorough(except_for=["faulty"])
@pytest.mark.parametrize("which", CASES)
def test_the_same_bytes_again(which: str) -> None:
    verdict = verdict_of(which)
    assert report_files(verdict) == files_of(which)
    assert list(files_of(which))[-1] == "result.json"


@pytest.mark.parametrize("which", CASES)
def test_the_key_numbers_are_on_the_page(which: str) -> None:
    verdict, text = verdict_of(which), words(files_of(which)["report.html"].replace("&amp;", "&"))
    assert evidence(verdict) in text
    assert f"{verdict.word} " in text
    page = files_of(which)["report.html"]
    change = re.search(r'<dl class="tiles change">(.*?)</dl>', page, re.DOTALL)
    assert change
    shown = re.findall(r'<div class="tile"><dt>(.*?)</dt><dd>(.*?)</dd></div>', change[1])
    assert [words(f"<p>{what}</p>") for what, _ in shown] == [
        t.what for t in before_and_after(verdict)
    ]
    for (_, figures), tile in zip(shown, before_and_after(verdict), strict=True):
        sides = [side for side in (tile.before, "→" if tile.before else "") if side]
        told = " ".join([*sides, tile.after, tile.unit])
        assert words(f"<p>{figures}</p>").split() == told.split()
    for effect in verdict.effects:
        assert effect.chosen.words[1:] in text
        for rival in effect.indistinguishable_from:
            assert rival in text
        assert CATALOGUE.effect_of(effect.name).look_at[1:] in text
    for value in (verdict.map.error.mean(), verdict.map.uncertainty.max()):
        assert any(f"{value * 1e3:.{places}f}" in text for places in (2, 3, 4))
    for blunder in verdict.blunders:
        assert blunder.message in text
    assert "orthoglide rerun result.json" in text
    assert "cannot detect the following" in text or not verdict.invisible


@pytest.mark.thorough(except_for=["explained-390", "faulty-1280"])
@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("which", CASES)
def test_nothing_overflows_in_a_browser(which: str, width: int, tmp_path: Path) -> None:
    seen: SimpleNamespace = opened(files_of(which)["report.html"], width, tmp_path)
    assert seen.inner == width
    assert seen.page <= width
    assert (seen.out, seen.cut, seen.flat) == ([], [], 0)
    assert seen.height > 3000


PAPER = """<script>addEventListener("load", () => setTimeout(() => {
  const end = s => document.querySelector(s).getBoundingClientRect().bottom;
  const found = {drawing: end(".drawn"), tool: end(".tiles.tool")};
  document.querySelectorAll("details").forEach(e => { e.open = true; });
  found.headless = document.querySelectorAll("thead").length
    - [...document.querySelectorAll("thead")].filter(e => e.offsetHeight > 10).length;
  found.cut = [...document.querySelectorAll(".scroll")].filter(
    e => e.scrollWidth > e.clientWidth + 1).map(e => e.innerText.slice(0, 60));
  document.title = JSON.stringify(found);
}, 100));</script></body>"""


@pytest.mark.thorough(except_for=["explained"])
@pytest.mark.parametrize("which", CASES)
def test_on_paper_the_first_sheet_has_drawing_and_tiles_and_tables_have_heads(
    which: str, tmp_path: Path
) -> None:
    """The drawing took the first sheet for itself, and tables were laid out as on a phone."""
    page = files_of(which)["report.html"].replace("@media print", "@media all")
    page = page.replace("@media screen", "@media not all")
    (tmp_path / "page.html").write_text(page.replace("</body>", PAPER))
    (tmp_path / "frame.html").write_text(
        '<body style="margin:0"><iframe src="page.html" style="border:0" width="680" height="1000">'
        "</iframe><script>addEventListener('load', () => setTimeout(() => { document.title = "
        "document.querySelector('iframe').contentDocument.title }, 300))</script></body>"
    )
    ends = browsed(tmp_path / "frame.html", "1400,1200", 3000)
    assert 200 < ends["drawing"] < ends["tool"] < 265 / 25.4 * 96  # A4 between its margins
    assert (ends["headless"], ends["cut"]) == (0, [])


# --- What is said ---------------------------------------------------------------------------


def test_the_sentence_names_cause_and_rival_and_what_it_gains() -> None:
    text = headline(verdict_of("explained"))
    assert text.startswith("The path of the y carriage is out of square toward z by 2.4 mrad")
    said = "Or the y rail leans toward z by 2.4 mrad (0.24 mm over 100 mm) and its carriage with"
    assert said in text
    assert "0.043 to 0.003 mm rms. Single readings are left with 0.00" in text
    assert "no more than the noise of the dial (0.0058 mm)" in text
    assert "No single cause explains the difference" in headline(verdict_of("unexplained"))
    partial = headline(verdict_of("partial"))
    assert "Something else is wrong as well" in partial
    assert "Or the y rail leans" in partial
    faults = headline(verdict_of("faulty"))
    assert faults.startswith("Drive x has 0.056 mm of lost motion.")
    assert faults.endswith("1 fault in the data had to be dealt with first.")
    left_out = len(verdict_of("faulty").readings) // 4
    (known,) = verdict_of("faulty").blunders
    many = replace(known, kind="label", rows_in_request=tuple((0, k) for k in range(left_out)))
    told = dealt_with(replace(verdict_of("faulty"), blunders=(many,)))
    assert re.search(rf"{left_out} of \d+ readings do not count", told)


def test_the_list_counts_the_readings_of_the_sheet() -> None:
    files = files_of("explained")
    result = json.loads(files["result.json"])
    assert len([s for s in result["next_measurements"] if s["readings"]]) == 2
    taken = [row for row in csv.DictReader(io.StringIO(files["next_measurements.csv"]))
             if row["kind"] != "move"]  # fmt: skip
    assert f"a report proposes {len(taken)} readings" in result["actions"][-1]["words"]


def test_numbers_are_withheld_where_the_verdict_says_not_to_act() -> None:
    page = files_of("partial")["report.html"]
    section = words(page[page.index('id="controller"') : page.index('id="judged"')])
    assert not re.search(r"<li class=\"(zeros|mend|compensate)\"", page)
    assert '<li class="confirm">' in page
    assert "No numbers are given to enter" in section
    assert "every command of that drive" not in section
    assert "every command of that drive" in words(files_of("explained")["report.html"])


def test_a_machine_with_nothing_wrong() -> None:
    verdict = close_loop(swept(), rig_machine())
    assert verdict.word == "adequate"
    assert "othing else is wrong that these readings could show" in headline(verdict)
    page = report_files(verdict)["report.html"]
    assert not {"apart", "left", "faults"} & set(re.findall(r'section id="(\w+)"', page))


def test_blocks_are_said_by_their_size() -> None:
    both = {"screw_error.x.sin": 3e-5, "screw_error.x.cos": -4e-5}
    assert "drive x runs 0.05 mm ahead and behind" in cause("screw_error.x", both)
    many = {"backlash.x": 1e-5, "backlash.y": -4e-5}
    assert cause("backlash", many) == "the drives have lost motion, from 0.01 mm to 0.04 mm"
    assert short("axis_tilt.cyclic").endswith("out of square, in a threefold pattern")


# --- result.json and its neighbours ---------------------------------------------------------

KEYS = {
    "schema", "version", "command", "arguments", "seed", "inputs", "noise_mm", "noise_source",
    "sigma_scale", "verdict", "before", "after", "holdout", "tcp", "effects", "parameters",
    "candidates", "blunders", "weak_directions", "cross_check", "next_measurements",
}  # fmt: skip


@pytest.mark.parametrize("which", CASES)
def test_result_has_the_keys_of_the_contract(which: str) -> None:
    verdict, result = verdict_of(which), json.loads(files_of(which)["result.json"])
    assert set(result) >= KEYS
    assert result["verdict"] == verdict.word
    assert result["before"]["chi2"] == pytest.approx(verdict.before.scores.chi2)
    assert result["after"]["cv_rms_mm"] == pytest.approx(verdict.after.scores.cv_rms * 1e3)
    assert [e["name"] for e in result["effects"]] == [e.name for e in verdict.effects]
    for told, effect in zip(result["effects"], verdict.effects, strict=True):
        assert told["parameters"] == list(effect.parameters)
        assert told["indistinguishable_from"] == list(effect.indistinguishable_from)
        assert 0 < told["probability"] <= 1
    for name, entry in result["parameters"].items():
        si = CATALOGUE[name.split(".")[0]].unit.si
        chosen = {n: s for e in verdict.effects for n, s in e.chosen.sigmas.items()}
        sigma = chosen.get(name) or verdict.after.sigmas[name]
        assert entry["sigma"] * si == pytest.approx(sigma, rel=1e-9)
    tried = {c["name"] for c in result["candidates"]}
    assert len(tried) == len(result["candidates"])
    assert {e.name for e in verdict.effects} <= tried
    for one in result["candidates"]:
        assert {"p_value", "evidence", "cv_rms_mm", "plausible", "probability"} <= set(one)
    for suggestion in result["next_measurements"]:
        assert suggestion["reason"]
        assert all("reading_mm" not in row for row in suggestion["readings"])


def test_judges_are_reported() -> None:
    held = json.loads(files_of("partial")["result.json"])
    verdict = verdict_of("partial")
    assert verdict.hold_out is not None
    assert held["holdout"]["after_rms_mm"] == pytest.approx(verdict.hold_out.after.length * 1e3)
    assert held["tcp"] is None
    assert [i.get("role", "campaign") for i in held["inputs"]] == ["campaign", "holdout"]
    judged = json.loads(files_of("explained")["result.json"])
    errors = verdict_of("explained").tcp
    assert errors is not None
    assert judged["holdout"] is None
    assert set(judged["tcp"]) == {"none", "translation", "rigid"}
    told = judged["tcp"]["translation"]
    assert told["after_mean_mm"] == pytest.approx(errors["translation"].after[0] * 1e3)
    assert told["nominal_max_mm"] == pytest.approx(errors["translation"].nominal[1] * 1e3)


@pytest.mark.thorough
@pytest.mark.parametrize("worse", [False, True])
def test_what_speaks_against_acting_is_told_everywhere(worse: bool) -> None:
    """A mere part, and readings held out that the cause predicts worse."""
    less, more = ByUnit(2e-5, np.nan), ByUnit(3e-5, np.nan)
    scores = HoldOut(less, more) if worse else HoldOut(more, less)
    verdict = filled(replace(closed_of("partial"), hold_out=scores), Verdict)
    files = report_files(verdict)
    warnings = json.loads(files["result.json"])["warnings"]
    said = " ".join(summary(verdict).split())
    for text, wanted in (
        ("only part of what is wrong", True),
        ("The readings held out are predicted worse", worse),
    ):
        assert any(text in w for w in warnings) == wanted
        assert (text in said) == wanted
        assert files["report.html"].count(text) == wanted


def test_faults_carry_the_lines_of_the_file() -> None:
    result = json.loads(files_of("faulty")["result.json"])
    (fault,) = result["blunders"]
    assert fault["kind"] == "outlier"
    assert fault["rows"] == [41]
    assert fault["files"] == {"rig-3.csv": [41]}
    assert fault["rms_without_mm"] < fault["rms_with_mm"]
    assert len(result["inputs"][0]["rows"]) == 252
    table = list(csv.DictReader(io.StringIO(files_of("faulty")["residuals.csv"])))
    aside = [row for row in table if row["set_aside"]]
    assert len(table) == 252
    assert [(row["line"], row["set_aside"]) for row in aside] == [("41", "outlier")]
    assert aside[0]["predicted_after_mm"] == ""


@pytest.mark.parametrize("which", CASES)
def test_residuals_add_up(which: str) -> None:
    verdict = verdict_of(which)
    table = list(csv.DictReader(io.StringIO(files_of(which)["residuals.csv"])))
    kept = [row for row in table if not row["set_aside"]]
    for side, rms in (
        ("nominal", verdict.nominal.rms),
        ("before", verdict.before.scores.rms),
        ("after", verdict.after.scores.rms),
    ):
        residual = np.array([float(row[f"residual_{side}_mm"]) for row in kept])
        assert np.sqrt(np.mean(residual**2)) == pytest.approx(rms * 1e3, rel=1e-3)
        row = kept[0]
        value = float(row["reading_mm"]) - float(row[f"predicted_{side}_mm"])
        assert value == pytest.approx(residual[0], abs=2e-6)


@pytest.mark.parametrize("which", ["explained", "partial"])
def test_the_calibrated_machine_is_averaged_over_the_class(which: str, tmp_path: Path) -> None:
    text, verdict = files_of(which)["calibrated.toml"], verdict_of(which)
    provenance = tomllib.loads(text)["provenance"]
    rivals = [r.name for r in verdict.effects[0].rivals]
    assert provenance["verdict"] == verdict.word
    assert set(rivals) == set(provenance.get("averaged_over", ()))
    assert not text.startswith("# Averages")
    (tmp_path / "calibrated.toml").write_text(text)
    machine = og.Machine.load(tmp_path / "calibrated.toml")
    for name, value in verdict.values.items():
        assert machine.values[name] == pytest.approx(value, abs=1e-15)
    entries = machine.spec.parameters
    assert all(entries[n].sigma > 0 for n, v in verdict.values.items() if v)
    families = {n.split(".")[0] for n, v in machine.values.items() if v}
    assert {n.split(".")[0] for n in rivals} <= families


@pytest.mark.parametrize("which", CASES)
def test_the_sheet_of_what_to_measure_next_can_be_measured(which: str, tmp_path: Path) -> None:
    text = files_of(which).get("next_measurements.csv", "")
    link = re.search(r'href="data:text/csv;charset=utf-8;base64,([^"]*)"',
                     files_of(which)["report.html"])  # fmt: skip
    assert bool(text) == bool(link)
    if not link:
        assert not any(s.rows for s in verdict_of(which).next_measurements)
        return
    assert base64.b64decode(link[1]).decode() == text
    (tmp_path / "next.csv").write_text(text)
    campaign = og.read_campaign(tmp_path / "next.csv", require_readings=False)
    assert len(campaign) + len(campaign.moves) == text.count("\n") - 1
    assert all("moves by only" in w for w in campaign.warnings)
    assert np.isnan(campaign.reading).all()


def test_a_verdict_writes_its_report(tmp_path: Path) -> None:
    verdict = verdict_of("partial")
    verdict.report(str(tmp_path / "out"))
    for name, content in files_of("partial").items():
        expected = content.encode() if isinstance(content, str) else content
        assert (tmp_path / "out" / name).read_bytes() == expected
    with pytest.raises(FileError, match="is not empty"):
        verdict.report(str(tmp_path / "out"))
    verdict_of("faulty").report(tmp_path / "out", overwrite=True)
    kept = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*.*")}
    assert kept == set(files_of("faulty"))
    (tmp_path / "out" / "thesis.tex").write_text("dear")
    with pytest.raises(FileError, match=r"thesis\.tex, which is no part of a report"):
        verdict.report(tmp_path / "out", overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


def test_a_verdict_shows_itself() -> None:
    verdict = verdict_of("explained")
    assert len(repr(verdict)) < 100
    assert "explained" in repr(verdict)
    assert "axis_tilt.y.z" in repr(verdict)
    assert headline(verdict)[:60] in " ".join(str(verdict).split())
    assert "axis_tilt.y.z" in verdict._repr_html_()
    frame = verdict.to_frame()
    assert frame.loc["axis_tilt.y.z", "value"] == pytest.approx(2.4e-3, abs=2e-4)
    assert frame.loc["joint_offset.x", "unit"] == "mm"
    assert list(frame.index) == [*verdict.before.names, "axis_tilt.y.z"]


# --- The workspace --------------------------------------------------------------------------


def test_the_workspace_is_told_before_and_after() -> None:
    space = verdict_of("explained").workspace
    assert np.all(space.sure > 0)
    assert np.all(space.sure_before > space.sure)
    assert space.before.mean() < space.nominal.mean()
    assert np.all(space.before > 0)
    families = verdict_of("explained").uncertain_effects
    assert 0.3 < sum(share for _, share in families) <= 1
    assert [s for _, s in families] == sorted((s for _, s in families), reverse=True)
