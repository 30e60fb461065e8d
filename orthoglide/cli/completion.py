"""``--install-completion``: the shell completes commands, options and files."""

from __future__ import annotations

import os
from pathlib import Path

import click

from orthoglide.cli.terminal import say
from orthoglide.errors import FileError, InputError

_PROGRAM, _VARIABLE = "orthoglide", "_ORTHOGLIDE_COMPLETE"
SHELLS = ("bash", "zsh", "fish")


def _install(context: click.Context, _: click.Parameter, shell: str | None) -> None:
    if shell is None or context.resilient_parsing:
        return
    shell = shell or Path(os.environ.get("SHELL", "")).name
    if shell not in SHELLS:
        context.fail(f"name your shell, one of {', '.join(SHELLS)}: --install-completion bash")
    try:
        path = install(context.command, shell)
    except InputError as error:
        context.fail(str(error))
    hint = " after `fpath+=~/.zfunc; autoload -Uz compinit; compinit` in ~/.zshrc"
    say(f"{click.format_filename(path)}: completes in a new {shell}{hint * (shell == 'zsh')}")
    context.exit()


completion_option = click.option(
    "--install-completion", is_flag=False, flag_value="", metavar="[SHELL]", expose_value=False,
    is_eager=True, callback=_install,
    help="Have bash, zsh or fish complete commands, options and files, and exit.",
)  # fmt: skip


def install(command: click.Command, shell: str) -> Path:
    """Write the completion script of one of `SHELLS` where that shell looks for it.

    Raises:
        FileError: where a file of somebody else's stands there, or none can be written.
    """
    from click.shell_completion import get_completion_class

    from orthoglide.files import write_whole, writing
    from orthoglide.text import shown

    kind = get_completion_class(shell)
    if kind is None:
        raise InputError(f"there is no completion for {shell}")
    script = kind(command, {}, _PROGRAM, _VARIABLE).source()
    path = script_path(shell)
    if path.exists() and _VARIABLE not in path.read_text(encoding="utf-8", errors="replace"):
        raise FileError("is not of this program and stays: remove it first", file=shown(path))
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, script, overwrite=True)
    return path


def script_path(shell: str) -> Path:
    """Where a shell looks for the completion scripts of its user."""
    home, environment = Path.home(), os.environ
    data = Path(environment.get("XDG_DATA_HOME") or home / ".local" / "share")
    config = Path(environment.get("XDG_CONFIG_HOME") or home / ".config")
    return {
        "bash": data / "bash-completion" / "completions" / _PROGRAM,
        "zsh": home / ".zfunc" / f"_{_PROGRAM}",
        "fish": config / "fish" / "completions" / f"{_PROGRAM}.fish",
    }[shell]
