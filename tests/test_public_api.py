"""Names, commands and options that users rely on, as ``public_api.toml`` lists them."""

from __future__ import annotations

import dataclasses
import importlib
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import pytest

import orthoglide as og
from orthoglide.cli import cli
from tests.test_cli_laws import COMMANDS

TABLE = tomllib.loads((Path(__file__).parent / "public_api.toml").read_text(encoding="utf-8"))
STATUS = {"alias", "removed", "comes"}


def options_of(parameters: Sequence[click.Parameter]) -> list[str]:
    """Return the long options among a command's parameters."""
    options = (p for p in parameters if isinstance(p, click.Option))
    return [name for p in options for name in p.opts if name.startswith("--")]


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
    assert dir(og) == sorted(og.__all__)


@pytest.mark.parametrize("one", [o for o in TABLE["name"] if o["status"] == "alias"], ids=str)
def test_an_alias_is_what_it_stands_for(one: dict[str, Any]) -> None:
    if one["here"]:
        assert getattr(og, one["name"]) is getattr(og, one["of"])


def test_commands_are_those_of_the_table() -> None:
    assert set(COMMANDS) == expected(set(TABLE["commands"]), TABLE["command"], "name")


def test_options_are_those_of_the_table() -> None:
    table = TABLE["commands"] | {c["name"]: c["options"] for c in TABLE["command"]}
    kept = {f"{command} {option}" for command, options in table.items() for option in options}
    found = {f"{n} {option}" for n, c in COMMANDS.items() for option in options_of(c.params)}
    gone = {c["name"] for c in TABLE["command"] if c.get("gone") or c.get("here") is False}
    there = {key for key in expected(kept, _options(), "key") if key.rpartition(" ")[0] not in gone}
    assert found == there


def test_options_of_the_program() -> None:
    assert set(options_of(cli.params)) == set(TABLE["program"]["options"])


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
