"""Laws that hold for every command alike; the citation file."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

import orthoglide
from orthoglide.cli import cli
from tests.test_cli import EXPERIMENT_2, EXPERIMENT_3, NEVER, TOML, planted_machine, run, tree

ROOT = Path(__file__).parents[1]
MACHINE = ("--machine", "planted.toml")

# The smallest arguments with which each command does something in `here`, without --out.
SMALLEST: dict[str, tuple[str, ...]] = {
    "demo": (),
    "close-loop": ("a.csv",),
    "diagnose": ("a.csv",),
    "identify": ("a.csv",),
    "check": ("a.csv", "b.csv"),
    "rerun": ("result/result.json",),
    "protocol": (),
    "simulate": MACHINE,
    "measure": (),
    "design": ("--count", "6"),
    "rehearse": ("--campaigns", "9"),
    "compensate": ("path.csv", *MACHINE, "--force"),
    "export": (*MACHINE, "--force"),
    "compare": ("--effects", "backlash"),
    "forward": ("310", "310", "310"),
    "inverse": ("1", "2", "3"),
    "view": ("--no-open",),
    "import klipper": ("printer.cfg",),
    "import plates": ("plate.csv", "--machine", "delta.toml"),
}
FILE_NEEDED = ("measure", "import klipper", "import plates")  # --out is no choice
SEARCH = ("check", "close-loop", "diagnose")  # for seconds
WRITES = ("demo", *FILE_NEEDED)  # without --out too, or not without


def commands(group: click.Group = cli, before: str = "") -> Iterator[tuple[str, click.Command]]:
    """Every command by its full name."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, f"{before}{name} ")
        else:
            yield before + name, command


COMMANDS = dict(commands())
every_command = pytest.mark.parametrize("name", COMMANDS)


def with_option(option: str) -> list[str]:
    """Return the commands that have an option."""
    return [name for name, command in COMMANDS.items()
            if any(option in p.opts for p in command.params)]  # fmt: skip


def words(name: str, *more: str) -> list[str]:
    """Return a command with its smallest arguments, and more."""
    out = ("--out", "new") if name in FILE_NEEDED and "--out" not in more else ()
    return [*name.split(), *SMALLEST[name], *out, *more]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    (folder / "a.csv").write_text(EXPERIMENT_2)
    (folder / "b.csv").write_text(EXPERIMENT_3)
    (folder / "path.csv").write_text("p_x_mm,p_y_mm,p_z_mm\n1,2,3\n")
    planted_machine(folder)
    delta = '[layout]\nkind = "linear-delta"\nradius_mm = 200\nangles_deg = [210, 330, 90]\n'
    (folder / "delta.toml").write_text(f"{TOML}\n{delta}")
    with chdir(folder):
        made = run("identify", "a.csv", "--out", "result")
        assert made.exit_code == 0
    return folder


@pytest.fixture
def here(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that the smallest arguments name."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_keeps_the_laws() -> None:
    assert COMMANDS.keys() == SMALLEST.keys()


@every_command
def test_help_has_examples_that_are_understood(name: str) -> None:
    result = run(*name.split(), "--help")
    assert result.exit_code == 0
    examples = re.findall(r"^ +orthoglide (.*)$", result.output, re.MULTILINE)
    assert examples
    for line in examples:
        given = shlex.split(line)
        assert " ".join(given[: len(name.split())]) == name
        command = COMMANDS[name]
        with command.make_context(name, given[len(name.split()) :]) as context:
            assert context.params  # UsageError where an option is wrong or missing


@every_command
def test_an_unknown_option_is_refused(name: str, here: Path) -> None:
    for bogus in ("--bogus", "-x"):
        result = run(*words(name, bogus))
        assert (result.exit_code, result.stdout) == (2, "")
        assert "No such option" in result.stderr
        assert bogus in result.stderr


@every_command
def test_a_number_that_is_none_is_refused(name: str, here: Path) -> None:
    before = tree(here)
    numbers = (click.INT, click.FLOAT, click.IntRange, click.FloatRange)
    kinds = tuple(one if isinstance(one, type) else type(one) for one in numbers)
    for parameter in COMMANDS[name].params:
        if isinstance(parameter, click.Option) and isinstance(parameter.type, kinds):
            for bad in ("many", "nan", *(["-1"] if "--seed" in parameter.opts else [])):
                result = run(*words(name, parameter.opts[0], bad))
                assert result.exit_code == 2, (parameter.opts, bad, result.output)
                assert parameter.opts[0].strip("-") in result.stderr or bad == "nan"
    assert tree(here) == before


@every_command
def test_files_that_are_not_there_are_refused(name: str, here: Path) -> None:
    before, given = tree(here), words(name)
    machine = name in with_option("--machine") and "--machine" not in given
    asked = [[*given, "none.toml"]] if machine else []
    for k, word in enumerate(given):
        if suffix := Path(word).suffix:
            asked.append([*given[:k], f"none{suffix}", *given[k + 1 :]])
    for arguments in asked:
        result = run(*arguments)
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        assert re.match(r"orthoglide: none\.\w+: there is no such file", result.stderr)
        assert result.stderr.count("\n") == 1
    assert tree(here) == before


@pytest.mark.parametrize("name", with_option("--machine"))
def test_machine_files_that_are_none_are_refused_by_their_line(name: str, here: Path) -> None:
    (here / "bad.toml").write_text(TOML.replace("L = 310.25", "L 310.25"))
    before, given = tree(here), words(name)
    if "--machine" in given:
        given[given.index("--machine") + 1] = "bad.toml"
    else:
        given += ["--machine", "bad.toml"]
    result = run(*given)
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert result.stderr.startswith("orthoglide: bad.toml, line 5: ")
    assert "mend this line" in result.stderr
    assert result.stderr.count("\n") == 1
    assert tree(here) == before


@pytest.mark.parametrize("name", sorted(set(with_option("--out")) - {"measure", "rehearse"}))
def test_results_are_never_overwritten(name: str, here: Path) -> None:
    (here / "full").mkdir()
    (here / "full" / "thesis.tex").write_text("dear")
    before = tree(here)
    more = ("--csv", "path.csv") if name in ("forward", "inverse") else ()
    given = [w for w in words(name, *more, "--out", "full") if not more or w not in SMALLEST[name]]
    result = run(*(w for w in given if w != "--no-open"))
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.search("name a new or empty folder|exists and is not overwritten", result.stderr)
    assert tree(here) == before


@pytest.mark.thorough(except_for=[n for n in COMMANDS if n not in SEARCH])
@pytest.mark.parametrize("name", [n for n in COMMANDS if n not in (*WRITES, "view", "rehearse")])
def test_nothing_is_written_without_out(name: str, here: Path) -> None:
    before = tree(here)
    result = run(*words(name, *(("--quiet",) if name in with_option("--quiet") else ())))
    assert result.exit_code == 0, result.output
    assert result.stdout.strip()
    if name in with_option("--quiet"):
        assert result.stdout.count("\n") == 1
        assert not [one for one in result.stderr.splitlines() if not one.startswith("warning: ")]
    assert tree(here) == before


@pytest.mark.parametrize("name", [n for n in with_option("--machine") if n.split()[0] != "import"])
def test_a_machine_file_is_given_by_itself_or_with_its_option(name: str) -> None:
    rest = [w for w in words(name)[1:] if w not in MACHINE]
    command = COMMANDS[name]
    for machine in (["m.toml"], ["--machine", "m.toml"], ["--machine=m.toml"]):
        for given in ([*machine, *rest], [*rest, *machine]):
            with command.make_context(name, given) as context:
                assert context.params["machine"].path == Path("m.toml")
    result = run(name, *rest, "m.toml", "--machine", "n.toml")
    assert result.exit_code == 2
    assert "give one machine file" in result.stderr


@pytest.mark.parametrize("group", [(), ("import",)])
def test_the_list_of_commands_cuts_no_sentence(group: tuple[str, ...]) -> None:
    said = " ".join(run(*group, "--help").output.partition("Commands:")[2].split())
    assert "..." not in said
    owner = cli.commands[group[0]] if group else cli
    assert isinstance(owner, click.Group)
    for command in owner.commands.values():
        first = " ".join((command.help or "").split()).partition(". ")[0].rstrip(".")
        assert first in said


def test_help_and_version_are_quick() -> None:
    code = (
        "import sys, orthoglide.cli; heavy = {'numpy', 'matplotlib', 'casadi', 'pinocchio', 'rich',"
        " 'scipy', 'jinja2'} & set(sys.modules); sys.exit(repr(heavy) if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], env=NEVER, check=False).returncode == 0


def test_commands_and_options_are_completed() -> None:
    """As the README says, by the library: the shell asks for each with an environment variable."""
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
