"""What the site of the documents is made with; ``python3 dev.py docs`` builds and checks it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "docs" / "site"))

from build import navigation, stage  # noqa: E402
from links import faults  # noqa: E402


def test_every_page_is_in_the_navigation(tmp_path: Path) -> None:
    stage(tmp_path)
    tree = navigation((ROOT / "README.md").read_text(encoding="utf-8"))
    pages = {p.relative_to(tmp_path).with_suffix("").as_posix() for p in tmp_path.rglob("*.md")}
    assert len(pages) > 10
    assert pages - {"index"} == {line for line in tree.splitlines() if line in pages}


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ('<a href="b.html#here">b</a> <a href="https://example.org">out</a>', ""),
        ('<a href="c.html">c</a>', "c.html, which is not there"),
        ('<a href="b.html#there">b</a>', "no such place"),
        ('<a href="#there">b</a>', "no such place"),
        ('<img src="no.png">', "no.png, which is not there"),
        ('<script src="https://example.org/a.js"></script>', "loads https://example.org/a.js"),
        ('<link rel="stylesheet" href="//example.org/a.css">', "loads //example.org/a.css"),
    ],
)
def test_faults_of_pages_are_seen(tmp_path: Path, body: str, wrong: str) -> None:
    (tmp_path / "a.html").write_text(body, encoding="utf-8")
    (tmp_path / "b.html").write_text('<h1 id="here">b</h1>', encoding="utf-8")
    found = faults(tmp_path)
    assert len(found) == bool(wrong)
    assert all(wrong in one for one in found)


@pytest.mark.parametrize("style", ["@import 'https://a.org/b';", "a{src:url(//a.org/b.woff)}"])
def test_styles_that_load_are_seen(tmp_path: Path, style: str) -> None:
    (tmp_path / "a.css").write_text(style, encoding="utf-8")
    assert faults(tmp_path) == ["a.css loads something from elsewhere"]
