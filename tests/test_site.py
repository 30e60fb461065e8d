"""What the site of the documents is made with; ``python3 dev.py docs`` builds and checks it."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

import orthoglide as og
from orthoglide.cli import cli

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "docs" / "site"))

import reference  # noqa: E402
from links import faults  # noqa: E402


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


def test_the_reference_has_every_public_name_and_command() -> None:
    pages = reference.pages()
    directives = "\n".join(pages.values())
    assert all(f":: orthoglide.{name}\n" in directives for name in og.__all__)
    assert all(f"\n## {name}\n" in pages["docs/commands"] for name in cli.commands)
