"""The tutorials run as they stand, and print what they say."""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def blocks(name: str) -> list[tuple[str, str, str]]:
    """Language, file name and text of the fenced blocks of a page."""
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    return re.findall(r"^```(\w+) ?(\S*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def alike(told: str, printed: str) -> bool:
    """The same words, and the same numbers but for two units of the last digit told."""
    if _NUMBER.sub("#", told) != _NUMBER.sub("#", printed):
        return False
    pairs = zip(_NUMBER.findall(told), _NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= 2.01 * 10 ** -len(a.partition(".")[2]) for a, b in pairs)


def missing(told: str, printed: str) -> str:
    """The first line told that is not printed; lines follow each other but where dots stand."""
    lines = [" ".join(line.split()) for line in printed.splitlines() if line.strip()]
    at, free = 0, False
    for line in (" ".join(line.split()) for line in told.splitlines() if line.strip()):
        if line == "...":
            free = True
            continue
        places = range(at, len(lines)) if free else range(at, min(at + 1, len(lines)))
        found = [k for k in places if alike(line, lines[k])]
        if not found:
            return line
        at, free = found[0] + 1, False
    return "" if free or at == len(lines) else f"(the end, before {lines[at]!r})"


def typed(told: str) -> tuple[str, str]:
    """What a user types into a conversation, and the conversation without it."""
    answers = re.findall(r"shows: (.+)$", told, re.MULTILINE)
    return "".join(f"{one}\n" for one in answers), re.sub(r"(shows:) .+$", r"\1", told, flags=re.M)


def commands(block: str, folder: Path) -> None:
    for part in block.replace(" \\\n", " ").removeprefix("$ ").split("\n$ "):
        line, _, told = part.partition("\n")
        program, *words = line.split()
        assert program == "orthoglide"
        answers, told = typed(told)
        done = subprocess.run(
            [sys.executable, "-m", "orthoglide", *words],
            cwd=folder, input=answers, capture_output=True, text=True, encoding="utf-8",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert not missing(told, done.stdout), f"{line}\n{done.stdout}"


@pytest.mark.thorough
def test_the_tutorial_at_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PYTHONIOENCODING", "utf-8")
    monkeypatch.setenv("COLUMNS", "100")
    ran = 0
    for language, name, text in blocks("tutorial-machine.md"):
        if language == "toml":
            (tmp_path / name).write_text(text, encoding="utf-8")
        else:
            assert language == "console"
            commands(text, tmp_path)
            ran += 1
    assert ran == 7
    assert (tmp_path / "april" / "report.html").is_file()
    told = (tmp_path / "controller" / "controller.txt").read_text(encoding="utf-8")
    assert told.count("moved the wrong way") == 3


@pytest.mark.thorough
def test_the_tutorial_in_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    found = blocks("tutorial-python.md")
    assert [language for language, _, _ in found] == ["python", "text"] * 7
    for (_, _, code), (_, _, told) in zip(found[::2], found[1::2], strict=True):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(code, "tutorial-python.md", "exec"), names)
        assert not missing(told, printed.getvalue()), printed.getvalue()
    assert (tmp_path / "april" / "report.html").is_file()


@pytest.mark.parametrize(
    ("told", "printed", "fits"),
    [
        ("a 1.20 b", "a 1.21 b", True), ("a 1.20 b", "a 1.25 b", False),
        ("a 1.20 b", "c 1.20 b", False), ("12 of 13", "14 of 13", True), ("12", "12\nmore", False),
        ("first\n...\nlast", "first\nmiddle\nlast", True), ("...\nlast", "last\nmore", False),
        ("last\n...", "last\nmore", True), ("first\nlast", "first\nmiddle\nlast", False),
    ],
)  # fmt: skip
def test_what_is_told_is_held_against_what_is_printed(told: str, printed: str, fits: bool) -> None:
    assert (not missing(told, printed)) == fits
