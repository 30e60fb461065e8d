"""Help, examples and completion of the command line; the citation file."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

import orthoglide
from orthoglide.cli import cli
from orthoglide.cli.completion import SHELLS, script_path
from orthoglide.cli.examples import EXAMPLES
from orthoglide.cli.terminal import wrapped

ROOT = Path(__file__).parents[1]


def commands(group: click.Group = cli, before: str = "") -> Iterator[tuple[str, click.Command]]:
    """Every command by its full name."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, f"{before}{name} ")
        else:
            yield before + name, command


def test_every_command_has_examples() -> None:
    assert dict(commands()).keys() == EXAMPLES.keys()


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_stand_in_the_help_and_are_understood(name: str) -> None:
    result = CliRunner().invoke(cli, [*name.split(), "--help"])
    assert result.exit_code == 0
    shown = re.findall(r"^ +orthoglide (.*)$", result.output, re.MULTILINE)
    assert tuple(shown) == EXAMPLES[name]
    command = dict(commands())[name]
    for line in shown:
        words = shlex.split(line)
        assert " ".join(words[: len(name.split())]) == name
        with command.make_context(name, words[len(name.split()) :]) as context:
            assert context.params  # UsageError where an option is wrong or missing


@pytest.mark.parametrize("group", [(), ("import",)])
def test_the_list_of_commands_cuts_no_sentence(group: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, [*group, "--help"])
    listed = result.output.partition("Commands:")[2].partition("Examples:")[0]
    assert "..." not in listed
    said = " ".join(listed.split())
    owner = cli.commands[group[0]] if group else cli
    assert isinstance(owner, click.Group)
    for command in owner.commands.values():
        first = " ".join((command.help or "").split()).partition(". ")[0].rstrip(".")
        assert first in said


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.mark.parametrize("shell", SHELLS)
def test_completion_is_installed_where_the_shell_looks(shell: str, home: Path) -> None:
    result = CliRunner().invoke(cli, ["--install-completion", shell])
    assert result.exit_code == 0, result.output
    path = script_path(shell)
    assert home in path.parents
    assert str(path) in result.output
    assert "_ORTHOGLIDE_COMPLETE" in path.read_text()
    assert CliRunner().invoke(cli, ["--install-completion", shell]).exit_code == 0  # again
    path.write_text("somebody else's")
    refused = CliRunner().invoke(cli, ["--install-completion", shell])
    assert refused.exit_code == 2
    assert path.read_text() == "somebody else's"


def test_the_shell_is_known_or_asked_for(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SHELL", "/usr/bin/fish")
    assert CliRunner().invoke(cli, ["--install-completion"]).exit_code == 0
    assert script_path("fish").exists()
    for shell in ("", "/bin/tcsh"):
        monkeypatch.setenv("SHELL", shell)
        result = CliRunner().invoke(cli, ["--install-completion"])
        assert result.exit_code == 2
        assert "name your shell" in result.output


def test_commands_and_options_are_completed() -> None:
    complete = ShellComplete(cli, {}, "orthoglide", "_ORTHOGLIDE_COMPLETE")
    found = {item.value for item in complete.get_completions([], "comp")}
    assert found == {"compensate", "compare"}
    found = {item.value for item in complete.get_completions(["identify"], "--f")}
    assert {"--free", "--fit-tcp", "--frame"} <= found


def test_the_citation_is_of_this_version() -> None:
    lines = (ROOT / "CITATION.cff").read_text().splitlines()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"version: {orthoglide.__version__}" in lines
    assert f"license: {project['license']}" in lines
    assert f"  - name: {project['authors'][0]['name']}" in lines


def test_long_lines_break_between_words_where_a_terminal_is_narrow() -> None:
    text = "short\n  - a list of words that is long\nx" + 30 * "y"
    assert wrapped(text, 20) == ("short\n  - a list of words\n    that is long\nx" + 30 * "y")
