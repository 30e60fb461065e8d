"""The documents hold: generated pages are fresh, examples run, links lead somewhere."""

import re
import runpy
from pathlib import Path
from typing import get_args

import click
import pytest

import orthoglide as og
from orthoglide.cli import cli
from orthoglide.effects import CATALOGUE
from orthoglide.effects.catalogue import catalogue_of
from orthoglide.geometry import Geometry
from orthoglide.machine_file import parse_machine_file
from orthoglide.result import Word
from tests.page_laws import too_long

ROOT = Path(__file__).parents[1]
EFFECTS = runpy.run_path(str(ROOT / "docs" / "tables" / "effects.py"))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str, language: str) -> list[str]:
    """Fenced blocks of a page."""
    return re.findall(rf"^```{language}\n(.*?)^```$", read(name), re.MULTILINE | re.DOTALL)


def test_the_page_of_effects_is_fresh() -> None:
    remedy = "stale: python docs/tables/effects.py > docs/effects.md"
    assert read("docs/effects.md") == EFFECTS["markdown"](), remedy


def test_the_page_of_effects_has_every_family_and_parameter() -> None:
    page = EFFECTS["markdown"]()
    elsewhere = catalogue_of(og.LinearDelta.names)
    assert {family.group for family in elsewhere.values()} <= set(EFFECTS["GROUPS"])
    assert page.count(", not on an Orthoglide.") == len(elsewhere) - len(CATALOGUE) > 0
    for name, family in {**elsewhere, **CATALOGUE}.items():
        assert f"\n### {name}\n" in page
        assert all(f"`{parameter}`" in page for parameter in family.parameters())


def test_the_readme_begins_with_ten_lines_of_python() -> None:
    (block,) = blocks("README.md", "python")
    assert len(block.splitlines()) <= 10


@pytest.mark.parametrize("block", blocks("README.md", "python"), ids=lambda b: b.split()[-1])
def test_the_readme_runs(
    block: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {})
    assert capsys.readouterr().out
    assert list(tmp_path.iterdir())


def test_the_readme_has_every_command() -> None:
    """Every command is in the table of the README, and every one there says what it does."""
    table = read("README.md").partition("## On the command line")[2].partition("\n## ")[0]
    named = set(re.findall(r"`(?:orthoglide )?([a-z-]+)`", table))
    assert set(cli.commands) <= named


def test_the_readme_has_every_exit_code() -> None:
    listed = read("README.md").partition("Exit codes: ")[2].partition("\n\n")[0]
    shown = cli.get_help(click.Context(cli)).partition("Exit codes: ")[2].partition("\n\n")[0]
    codes = r"\b\d+(?=\s+[a-z])"
    assert re.findall(codes, listed) == re.findall(codes, shown) == ["0", "2", "3", "130"]


def test_the_campaign_of_the_page_of_files_reads(tmp_path: Path) -> None:
    (text,) = blocks("docs/files.md", "csv")
    (tmp_path / "campaign.csv").write_text(text, encoding="utf-8")
    campaign = og.read_campaign(tmp_path / "campaign.csv")
    assert [campaign.posture[0], len(campaign)] == ["zero", 3]


def test_the_machine_file_of_the_page_of_files_reads() -> None:
    (text,) = blocks("docs/files.md", "toml")
    machine = parse_machine_file(text)
    assert machine.geometry == Geometry()
    assert machine.screw_pitch == 0.02
    assert set(machine.parameters) == {"joint_offset.x"}
    assert machine.surface_slope == 1e-4


@pytest.mark.parametrize(
    ("part", "script"), [("machine file", "machine_file.py"), ("columns", "columns.py")]
)
def test_the_tables_of_the_page_of_files_are_those_of_the_schema(part: str, script: str) -> None:
    printed = runpy.run_path(str(ROOT / "docs" / "tables" / script))["markdown"]()
    _, _, rest = read("docs/files.md").partition(f"<!-- {part}: begin -->")
    remedy = f"stale: python docs/tables/{script}"
    assert rest.partition(f"<!-- {part}: end -->")[0].strip() == printed.strip(), remedy


@pytest.mark.parametrize("word", get_args(Word))
def test_every_verdict_is_explained(word: str) -> None:
    assert f"| **{word}** |" in read("docs/closing-the-loop.md")
    assert f"`{word}`" in read("docs/files.md")


@pytest.mark.parametrize("word", get_args(Word))
def test_the_gallery_has_every_verdict_with_its_drawing(word: str) -> None:
    page = read("docs/gallery.md")
    section = page.partition(f"\n## {word.capitalize()}\n")[2].partition("\n## ")[0]
    (found,) = re.findall(r"^\*\*(.+)\*\*$", section, re.MULTILINE)
    assert not too_long(found)
    assert f"(images/gallery-{word}.svg)" in page
    assert "<desc>" in read(f"docs/images/gallery-{word}.svg")


@pytest.mark.thorough
def test_the_gallery_is_what_its_script_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = runpy.run_path(str(ROOT / "docs" / "images" / "gallery.py"))["page"]
    monkeypatch.setitem(page.__globals__, "HERE", tmp_path)
    written, printed = (re.sub(r"\d+", "#", text) for text in (read("docs/gallery.md"), page()))
    assert written == printed, "stale: python docs/images/gallery.py"
    assert len(list(tmp_path.glob("*.svg"))) == 7


def test_the_glossary_is_short() -> None:
    assert 0 < read("docs/glossary.md").count("\n| **") <= 15


def test_the_mobility_is_what_the_mechanism_says() -> None:
    mobility = og.Mechanism().mobility(Geometry().zero)
    assert f"> {mobility}\n" in read("docs/mechanism.md")


def test_the_map_of_the_folders_is_whole() -> None:
    folders = {path.parent.name for path in (ROOT / "orthoglide").glob("*/__init__.py")}
    table = read("CONTRIBUTING.md").partition("## Map of the folders")[2].partition("\n## ")[0]
    assert folders - set(re.findall(r"`(\w+)`", table)) == set()


def links(page: Path) -> list[str]:
    return re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as code forges make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    missing = set()
    for link in links(page):
        if not link.startswith("https://"):
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            if target.exists():
                assert not anchor or anchor in anchors(target), f"{page.name}: {link}"
            else:
                missing.add(target.name)
    assert not missing, f"{page.name} leads nowhere"


def test_every_page_is_one_step_from_the_readme() -> None:
    linked = {(ROOT / link).resolve() for link in links(ROOT / "README.md")}
    assert {page for page in PAGES if page.name != "README.md"} <= linked
