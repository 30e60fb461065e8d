"""Names, cells and files that nobody would write on purpose: text is data, and a run ends well."""

from __future__ import annotations

import contextlib
import csv
import html
import io
import json
import os
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

import orthoglide as og
from orthoglide.control import export_files
from orthoglide.effects import CATALOGUE
from orthoglide.errors import FileError
from orthoglide.figures.axes import Panel
from orthoglide.machine_file import MachineFile, machine_text, parse_machine_file
from orthoglide.machine_file.posterior import parse_posterior
from orthoglide.observations import campaign_text, read_campaign
from orthoglide.parameters import Parameter
from tests.test_cli import EXPERIMENT_2, rows, run

TOML = machine_text(MachineFile())
SETUPS = ("xy", "xz", "yx", "yz", "zx", "zy")


def renamed(names: tuple[str, ...]) -> str:
    """The published campaign with other names of its setups, in their order."""

    def edit(table: list[list[str]]) -> None:
        for row in table[1:]:
            row[0] = names[SETUPS.index(row[0])]

    return rows(edit)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in, on a terminal that is wide enough for the longest name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


def refused(*arguments: str | Path) -> str:
    """The sentence with which a command refuses; nothing else happened."""
    before = sorted(os.listdir())
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("orthoglide: ")
    assert result.stderr.count("\n") == 1
    assert len(result.stderr) < 1100
    assert sorted(os.listdir()) == before
    return result.stderr


# --- Names that look like something else --------------------------------------------------------

STRANGE = (
    ("[/b]", "$$", "a@b", "common", "=1+1", "<b>&"),
    ('"', "$\\frac{$", "@x", "xy.common", "</svg><script>", "+cmd|' /C calc'!A0"),
    ("[red]", "'x'", "{}%s", "-2+3", "a,b", ":smile:"),
)
FREE = ("--free", "joint_offset,leg_length,gauge_scale")


def found(here: Path, name: str, names: tuple[str, ...]) -> tuple[dict[str, Any], str]:
    """``result.json`` of an identification, and what the terminal showed."""
    (here / "c.csv").write_text(renamed(names))
    shown = run("identify", "c.csv", "--out", name, *FREE)
    assert shown.exit_code == 0, shown.output
    return json.loads((here / name / "result.json").read_text()), shown.stdout


def figures(fit: dict[str, Any]) -> dict[str, Any]:
    """Figures of a fit, those by parameter in their order and without its name."""
    return {k: list(v.values()) if isinstance(v, dict) else v for k, v in fit.items()}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """Result and page of setups with plain names."""
    here = tmp_path_factory.mktemp("plain")
    with contextlib.chdir(here):
        return found(here, "out", SETUPS)[0], (here / "out" / "report.html").read_text()


@pytest.mark.thorough(except_for=["[/b]"])
@pytest.mark.parametrize("names", STRANGE, ids=lambda names: names[0])
def test_names_of_setups_change_no_number(
    names: tuple[str, ...], here: Path, plain: tuple[dict[str, Any], str]
) -> None:
    plain_result, plain_page = plain
    result, shown = found(here, "out", names)
    meant = {f"gauge_scale.{old}": Parameter("gauge_scale", setup=new)
             for old, new in zip(SETUPS, names, strict=True)}  # fmt: skip
    expected = plain_result["parameters"].items()
    assert result["parameters"] == {meant.get(name, name): value for name, value in expected}
    for name in meant.values():
        assert CATALOGUE.parameter(name, names) == CATALOGUE.parameter(name) == name
    assert result["verdict"] == plain_result["verdict"]
    for key in ("before", "after"):
        assert figures(result[key]) == figures(plain_result[key])
    page = (here / "out" / "report.html").read_text()
    tags = re.compile(r"<\w+")
    assert sorted(tags.findall(page)) == sorted(tags.findall(plain_page))
    figure = ET.fromstring((here / "out" / "figures" / "readings.svg").read_text())
    for name in names:
        assert name in html.unescape(page)
        assert "".join(name.split()) in "".join(shown.split())  # names may be wrapped
        assert name in "".join(figure.itertext())


@pytest.mark.thorough
def test_formulas_are_text_in_every_table(here: Path) -> None:
    names = ("=1+1", "@x", "+cmd|'!A0", "-2+3", "'=1", "plain")
    (here / "c.csv").write_text(renamed(names))
    campaign = read_campaign("c.csv")
    assert [s.name for s in campaign.setups[:4]] == list(names[:4])
    assert campaign.setups[4].name == "=1"  # as a spreadsheet shows it
    text = campaign_text(campaign)
    (here / "again.csv").write_text(text)
    assert [s.name for s in read_campaign("again.csv").setups] == [s.name for s in campaign.setups]
    assert run("identify", "c.csv", "--out", "out", "--quiet").exit_code == 0
    for content in (text, (here / "out" / "residuals.csv").read_text()):
        cells = [cell for row in csv.reader(io.StringIO(content)) for cell in row]
        assert "'=1+1" in cells
        assert not [c for c in cells if c[:1] in ("=", "@") or c.startswith(("+cmd", "-2+3"))]


def test_figures_on_one_page_do_not_clip_each_other() -> None:
    """Rows of a second figure vanished behind the rectangle of the first, which had its name."""
    names = set()
    for height in (100.0, 200.0):
        axes = Panel((0.0, 0.0, 200.0, height)).add_axes((0.0, 1.0), (0.0, 1.0))
        names |= set(re.findall(r'clipPath id="([^"]+)"', axes.svg()))
    assert len(names) == 2


@pytest.mark.parametrize("name", ["a--b", "---", "----->", "]]>", "<b>&", "a-"])
def test_a_machine_of_any_name_is_exported_as_xml(name: str) -> None:
    spec = parse_machine_file(TOML.replace('"Orthoglide, nominal"', json.dumps(name)))
    assert spec.name == name
    robot = export_files(og.Machine(spec))["orthoglide.urdf"]
    assert ET.fromstring(robot).tag == "robot"


@pytest.mark.parametrize("character", ["\x1b", "\ufffe", "\x7f", "\u202e", "\x85", "\u2028"])
def test_what_cannot_be_shown_is_refused(character: str, here: Path) -> None:
    code = f"U+{ord(character):04X}"
    spoilt = renamed((f"a{character}b", *SETUPS[1:]))
    (here / "c.csv").write_text(spoilt, encoding="utf-8", newline="")
    message = refused("identify", "c.csv", "--out", "out")
    assert f"c.csv, line 2: holds the character {code}" in message
    toml = TOML.replace('"Orthoglide, nominal"', json.dumps(f"a{character}b"))
    (here / "c.csv").write_text(EXPERIMENT_2)
    (here / "m.toml").write_text(toml, encoding="utf-8")
    assert "m.toml" in refused("identify", "c.csv", "--out", "out", "--machine", "m.toml")


# --- Files that are hardly any ------------------------------------------------------------------


def test_a_damaged_covariance_is_told() -> None:
    for content in (b"", b"PK\x03\x04" + bytes(80), b"\x93NUMPY\x01\x00" + bytes(90), bytes(300)):
        with pytest.raises(FileError, match="damaged"):
            parse_posterior(content, "0" * 64, "m.npz")


# --- Files that are no files --------------------------------------------------------------------


def test_a_pipe_is_refused_and_not_waited_for(here: Path) -> None:
    os.mkfifo("pipe")
    (here / "c.csv").write_text(EXPERIMENT_2)
    for arguments in (("identify", "pipe"), ("identify", "c.csv", "--machine", "pipe")):
        assert "is a pipe or a device" in refused(*arguments, "--out", "out")
    assert "is a pipe or a device" in refused("rerun", "pipe")


def test_what_never_ends_is_not_read_to_its_end(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orthoglide.files.FILE_LIMIT", 2**20)
    assert "is a pipe or a device" in refused("identify", "/dev/zero", "--out", "out")
    (here / "large.csv").write_bytes(b"x" * (2**20 + 1))
    for command in (("forward", "310", "310", "310", "--machine"), ("import", "klipper")):
        out = ("--out", "out") if command[0] == "import" else ()
        assert "is larger than 1 MB" in refused(*command, "large.csv", *out)
    assert "is larger than 1 MB" in refused("identify", "large.csv", "--out", "out")
