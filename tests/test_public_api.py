"""Names, commands and options that users rely on, as ``public_api.toml`` lists them.

Commands and options are read from what ``--help`` prints, so that the command line may be built
with another library. Only the layout of the lists "Commands" and "Options" is relied upon: each
entry starts at the list's smallest indent, an empty line or a frame ends it.
"""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import orthoglide as og
from tests.command_line import done

TABLE = tomllib.loads((Path(__file__).parent / "public_api.toml").read_text(encoding="utf-8"))
STATUS = {"alias", "removed", "comes"}
FRAMES = dict.fromkeys(map(ord, "│┃|╭╮╰╯─━*"), " ")


@cache
def help_of(command: tuple[str, ...]) -> str:
    """Return what a command prints for ``--help``."""
    return done(*command, "--help").output


def section(text: str, title: str) -> list[str]:
    """Return the entries of a list that a help text has, each as its first line."""
    lines = [line.translate(FRAMES).rstrip() for line in text.splitlines()]
    start = next((k for k, line in enumerate(lines) if line.strip(" :") == title), len(lines))
    body = list(itertools.takewhile(bool, lines[start + 1 :]))
    least = min(map(indent, body), default=0)
    return [line.strip() for line in body if indent(line) == least]


def indent(line: str) -> int:
    """Return the number of spaces before a line's first letter."""
    return len(line) - len(line.lstrip())


def commands_in(text: str) -> list[str]:
    """Return the commands that a help text lists; none where it is of a command itself."""
    return [line.split()[0] for line in section(text, "Commands")]


def options_in(text: str) -> set[str]:
    """Return the long options that a help text lists, ``--help`` aside."""
    found: set[str] = set()
    for line in section(text, "Options"):
        found |= set(re.findall(r"(?<![\w-])--[a-z][\w-]*", re.split(r"  +", line)[0]))
    return found - {"--help"}


def commands(group: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield every command by its words."""
    for name in commands_in(help_of(group)):
        inner = (*group, name)
        if commands_in(help_of(inner)):
            yield from commands(inner)
        else:
            yield inner


def expected(kept: set[str], changes: list[dict[str, Any]], key: str) -> set[str]:
    """Return what must be there now: kept, aliases, not yet removed, already come."""
    names = [one[key] for one in changes]
    assert len(set(names)) == len(names)
    assert not kept & set(names), "what is kept has no other status"
    there = {
        "alias": lambda one: True,
        "removed": lambda one: not one["gone"],
        "comes": lambda one: one["here"],
    }
    return kept | {one[key] for one in changes if there[one["status"]](one)}


def _options() -> list[dict[str, Any]]:
    return [one | {"key": f"{one['command']} {one['option']}"} for one in TABLE["option"]]


def test_names_are_those_of_the_table() -> None:
    kept = set(TABLE["names"]["kept"])
    assert set(og.__all__) == expected(kept, TABLE["name"], "name")


@pytest.mark.parametrize("name", sorted(og.__all__))
def test_a_name_is_there(name: str) -> None:
    assert getattr(og, name) is not None
    assert name in dir(og)


@pytest.mark.parametrize("one", [o for o in TABLE["name"] if o["status"] == "alias"], ids=str)
def test_an_alias_is_what_it_stands_for(one: dict[str, Any]) -> None:
    if one["here"]:
        assert getattr(og, one["name"]) is getattr(og, one["of"])


def test_commands_are_those_of_the_table() -> None:
    found = {" ".join(command) for command in commands()}
    assert found == expected(set(TABLE["commands"]), TABLE["command"], "name")


def test_options_are_those_of_the_table() -> None:
    table = TABLE["commands"] | {c["name"]: c["options"] for c in TABLE["command"]}
    kept = {f"{command} {option}" for command, options in table.items() for option in options}
    found = {
        f"{' '.join(command)} {option}"
        for command in commands()
        for option in options_in(help_of(command))
    }
    gone = {c["name"] for c in TABLE["command"] if c.get("gone") or c.get("here") is False}
    there = {key for key in expected(kept, _options(), "key") if key.rpartition(" ")[0] not in gone}
    assert found == there


def test_options_of_the_program() -> None:
    assert options_in(help_of(())) == set(TABLE["program"]["options"])


@pytest.mark.parametrize("name", TABLE["members"])
def test_members_of_a_class_are_there(name: str) -> None:
    kind = getattr(og, name)
    fields = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    missing = set(TABLE["members"][name]) - fields - set(dir(kind))
    assert not missing


@pytest.mark.parametrize("module", TABLE["modules"])
def test_names_that_effects_files_import(module: str) -> None:
    found = importlib.import_module(module)
    assert not [name for name in TABLE["modules"][module] if not hasattr(found, name)]


def test_every_change_says_where_it_was_decided() -> None:
    for one in (*TABLE["name"], *TABLE["command"], *TABLE["option"]):
        assert one["status"] in STATUS
        assert isinstance(one["issue"], int)
        assert one["why"].endswith(".")
        assert isinstance(one["gone" if one["status"] == "removed" else "here"], bool)


def test_help_in_another_layout_is_read_too() -> None:
    """The frames that another library draws around its lists."""
    text = """
 Usage: orthoglide import [OPTIONS] COMMAND [ARGS]...

 What a firmware stored.

╭─ Options ──────────────────────────────────────────────────╮
│ *  --out            DIR    Folder. [required]              │
│    --seed   -s      INTEGER  Seed; a second line with      │
│                            --other in it.                  │
│    --help   -h             Show this message and exit.     │
╰────────────────────────────────────────────────────────────╯
╭─ Commands ─────────────────────────────────────────────────╮
│ klipper   Read a printer.cfg: its numbers,                 │
│           heights.                                         │
│ plates    Read lists of points.                            │
╰────────────────────────────────────────────────────────────╯
"""
    assert commands_in(text) == ["klipper", "plates"]
    assert options_in(text) == {"--out", "--seed"}
