"""What the site of the documents is made with; ``python3 dev.py docs`` builds and checks it."""

from __future__ import annotations

import inspect
import posixpath
import re
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.cli import cli
from orthoglide.effects import CATALOGUE

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "docs" / "site"))

import reference  # noqa: E402
import signatures  # noqa: E402
from build import stage  # noqa: E402
from links import faults  # noqa: E402


def test_every_page_is_in_the_navigation(tmp_path: Path) -> None:
    stage(tmp_path)
    pages = {p.relative_to(tmp_path).with_suffix("").as_posix() for p in tmp_path.rglob("*.md")}
    named = set()
    for page in pages:
        trees = (tmp_path / f"{page}.md").read_text(encoding="utf-8").partition("```{toctree}")[2]
        named |= {posixpath.join(posixpath.dirname(page), line) for line in trees.splitlines()}
    assert len(pages) > 10
    assert pages - {"index"} == pages & named


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


# --- The reference ------------------------------------------------------------------------------


def public() -> Iterator[tuple[str, Any]]:
    """Names and objects: what the package exports, and what its classes have."""
    for name in og.__all__:
        yield name, getattr(og, name)
        if inspect.isclass(getattr(og, name)):
            for member, value in inspect.getmembers_static(getattr(og, name)):
                inner = next((getattr(value, n) for n in ("fget", "func", "__func__")
                              if hasattr(value, n)), value)  # fmt: skip
                ours = inspect.isfunction(inner) and inner.__module__.startswith("orthoglide")
                if ours and not member.startswith("_"):
                    yield f"{name}.{member}", inner


def told(documented: Any, section: str) -> set[str]:
    """Names in one section of a docstring."""
    text = (inspect.getdoc(documented) or "").partition(f"\n{section}:\n")[2]
    own = text.split("\n\n")[0]
    return set(re.findall(r"^    (\w+):", own, re.MULTILINE))


def test_every_public_name_is_documented() -> None:
    bare = [name for name, one in public() if not (one.__doc__ or "").strip()]
    assert not bare
    assert len(list(public())) > 150


@pytest.mark.parametrize("name", [n for n in og.__all__ if inspect.isfunction(getattr(og, n))])
def test_every_argument_of_a_public_function_is_documented(name: str) -> None:
    function = getattr(og, name)
    assert set(inspect.signature(function).parameters) == told(function, "Args")


@pytest.mark.parametrize("name", [n for n in og.__all__ if is_dataclass(getattr(og, n))])
def test_every_field_of_a_public_class_is_documented(name: str) -> None:
    own = {f.name for f in fields(getattr(og, name)) if not f.name.startswith("_")}
    assert own <= set().union(*(told(c, "Attributes") for c in getattr(og, name).__mro__))


def test_methods_of_several_arguments_say_what_each_is() -> None:
    unsaid = {}
    for name, method in ((n, one) for n, one in public() if "." in n):
        given = [p for p in inspect.signature(method).parameters if p not in ("self", "cls")]
        if len(given) > 1:
            said = inspect.getdoc(method) or ""
            missing = [p for p in given if not re.search(rf"\b{p}\b", said)]
            if missing and not re.search(r"rguments (are )?as for", " ".join(said.split())):
                unsaid[name] = missing
    assert not unsaid


def test_docstrings_refer_to_what_the_reference_has() -> None:
    known = dict(public())
    nowhere = []
    for name, one in known.items():
        for target in re.findall(r":(?:func|meth):`~?([\w.]+)`", inspect.getdoc(one) or ""):
            own = f"{name.partition('.')[0]}.{target}"  # a member of the same class
            if target.removeprefix("orthoglide.") not in known and own not in known:
                nowhere.append(f"{name}: {target}")
    assert not nowhere


def test_the_reference_describes_nothing_twice() -> None:
    text = "".join(reference.pages().values())
    described = re.findall(r"^\.\. auto\w+:: (\S+)$", text, re.MULTILINE)
    assert "orthoglide.frames.Framed" in described
    assert len(described) == len(set(described))


def test_the_reference_has_every_public_name_and_command() -> None:
    pages = reference.pages()
    directives = "\n".join(pages.values())
    assert all(f":: orthoglide.{name}\n" in directives for name in og.__all__)
    assert all(f"\n## {name}\n" in pages["docs/commands"] for name in cli.commands)


# --- The pictures of effects --------------------------------------------------------------------


@pytest.fixture(scope="module")
def sheet() -> signatures.Sheet:
    return signatures.Sheet()


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if not e.plate])
def test_every_effect_has_a_mark_and_shows_in_the_sheet_of_its_picture(
    name: str, sheet: signatures.Sheet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    monkeypatch.setattr(signatures, "panels", lambda _, *drawn: seen.append(drawn) or "")
    words, stem = signatures.draw(CATALOGUE[name], sheet, tmp_path)
    ((change, left),) = seen
    assert np.abs(change).max() > 1e-7
    assert (np.linalg.norm(left) < 1e-2 * np.linalg.norm(change)) == (name in CATALOGUE.base)
    drawn = (tmp_path / f"{stem}-machine.svg").read_text(encoding="utf-8")
    assert words in drawn
    assert 'stroke="var(--m-mark)"' in drawn


def test_the_page_of_the_site_shows_every_effect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "effects.md"
    (tmp_path / "images").mkdir()
    page.write_text((ROOT / "docs" / "effects.md").read_text("utf-8"), encoding="utf-8")
    monkeypatch.setattr(signatures, "panels", lambda *_: "<svg/>")
    signatures.illustrate(page)
    shown = re.findall(r"\]\((images/\S+)\)", page.read_text(encoding="utf-8"))
    assert len(shown) == 2 * sum(not effect.plate for effect in CATALOGUE.values())
    assert all((tmp_path / picture).is_file() for picture in shown)
