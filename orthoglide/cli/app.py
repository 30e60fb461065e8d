"""The group of commands: errors become exit codes, long work shows its progress."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import click

from orthoglide import __version__
from orthoglide.errors import InputError, OrthoglideError
from orthoglide.files import system_reason, write_files
from orthoglide.progress import Progress, Step
from orthoglide.text import MACHINE_OPTION, abbreviated

BAD_INPUT, NUMERICS_FAILED, INTERRUPTED = 2, 3, 130  # 130: 128 + SIGINT, as shells have it
_MAX_MESSAGE = 1000  # characters of an error: file, line and remedy fit, a pasted file does not
_MAX_HELP_SENTENCE = 200  # characters: no first sentence of a command's help is cut in the list
_RESUMABLE = ("measure", "rehearse")  # commands that keep in --out what was done
_PROGRESS_INTERVAL = 1.0  # seconds between two lines of progress where the error stream is a file


class Refusal(click.ClickException):
    """Ends a command with one sentence on the error stream, and an exit code."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(abbreviated(" ".join(message.split()), _MAX_MESSAGE))
        self.exit_code = exit_code  # type: ignore[misc]

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the sentence."""
        click.echo(f"orthoglide: {self.message}", err=True)


class Command(click.Command):
    """A command that takes its machine file by itself as well as with ``--machine``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the command line; a word in .toml that is no option's value is the machine file."""
        options = [p for p in self.params if isinstance(p, click.Option)]
        if not any("--machine" in option.opts for option in options):
            return super().parse_args(ctx, args)
        with_value = {name for p in options if not p.is_flag for name in p.opts}
        machines, words = list[str](), list[str]()
        for previous, word in zip(["", *args], args, strict=False):
            if word.endswith(".toml") and not word.startswith("-") and previous not in with_value:
                machines += ["--machine", word]
            else:
                words.append(word)
        words = [*machines, *words]  # in front of a "--", behind which no option is read
        if sum(word.partition("=")[0] == "--machine" for word in words) > 1:
            raise InputError(f"give one machine file to {ctx.info_name}, not several")
        try:
            return super().parse_args(ctx, list(words))
        except click.MissingParameter:
            if extra := self.make_parser(ctx).parse_args(list(words))[1]:
                raise InputError(
                    f"expected a machine file, whose name ends in .toml, found {extra[0]!r}: give "
                    f"one by itself or with --machine"
                ) from None
            raise

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an error becomes an exit code and one sentence."""
        with _refusals(ctx):
            return super().invoke(ctx)


class Group(click.Group):
    """A group that lists its commands in the order of the work."""

    command_class = Command

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order in which they were added."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write every command with the whole first sentence of its help."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.get_short_help_str(_MAX_HELP_SENTENCE))
                                for name, command in self.commands.items()])  # fmt: skip

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; an error in its options becomes an exit code and one sentence."""
        with _refusals(ctx):
            return super().invoke(ctx)


@contextmanager
def _refusals(ctx: click.Context) -> Iterator[None]:
    """Turn errors within the block into refusals.

    ``ORTHOGLIDE_TRACEBACK=1`` shows where an unexpected error was raised.
    """
    try:
        yield
    except OrthoglideError as error:
        machine_options = getattr(ctx.params.get("machine"), "words", "") or MACHINE_OPTION
        code = BAD_INPUT if isinstance(error, InputError) else NUMERICS_FAILED
        raise Refusal(str(error).replace(MACHINE_OPTION, machine_options), code) from error
    except (click.ClickException, click.exceptions.Exit, click.Abort):
        raise
    except KeyboardInterrupt:
        message = "interrupted: nothing is left half written"
        if ctx.info_name in _RESUMABLE and ctx.params["out"] is not None:
            message += "; the same command goes on from what --out holds"
        raise Refusal(message, INTERRUPTED) from None
    except Exception as error:
        broken_pipe = isinstance(error, OSError) and error.errno == errno.EPIPE
        if broken_pipe or os.environ.get("ORTHOGLIDE_TRACEBACK"):
            raise  # click ends quietly where the reader of a pipe has left
        kind, text, code = type(error).__name__, abbreviated(str(error), 200), NUMERICS_FAILED
        if isinstance(error, OSError):
            message, code = f"the output cannot be written ({system_reason(error)})", BAD_INPUT
            message += ": choose another place"
        elif isinstance(error, ArithmeticError | MemoryError) or kind == "LinAlgError":
            message = f"the numerics failed ({kind}: {text}): look for readings far from all others"
        else:
            message = (
                f"failed unexpectedly ({kind}: {text}), which is a fault of the program: "
                "ORTHOGLIDE_TRACEBACK=1 shows where"
            )
        raise Refusal(message, code) from error


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="orthoglide")
def cli() -> None:
    """Find what is wrong with an Orthoglide from dial readings, and calibrate it.

    Try `demo` first. At a machine print a sheet with `protocol`, or let `measure` ask for the
    readings; then `close-loop` writes the report, and `check` compares after a repair.

    A machine file (machine.toml) is given by itself or with --machine. --out names a new file or
    folder; without it, the answer is only printed. --quiet prints the answer in one line.

    Exit codes: 0 done, 2 bad input or usage, 3 the numerics failed or a rerun differs,
    130 interrupted.
    """


@contextmanager
def progress(quiet: bool) -> Iterator[Progress]:
    """Show steps on the error stream: a bar on a terminal, a line every second in a file."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress as Bar, TextColumn, TimeElapsedColumn

    console, began = Console(stderr=True), time.monotonic()
    last = began

    def line(step: Step) -> None:
        nonlocal last
        if not quiet and (now := time.monotonic()) - last >= _PROGRESS_INTERVAL:
            last = now
            click.echo(f"{now - began:4.0f} s  {step}", err=True)

    if quiet or not console.is_terminal:
        yield line
        return
    columns = (BarColumn(24), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=100)

        def show(step: Step) -> None:
            completed = max(step.percent, bar.tasks[0].completed)
            bar.update(task, description=str(step), completed=completed)

        yield show


def warn(sentences: Iterator[str] | tuple[object, ...]) -> None:
    """Print warnings on the error stream, a line each."""
    for sentence in sentences:
        click.echo(f"warning: {sentence}", err=True)


def deliver(
    text: str, files: Mapping[Any, str | bytes] | None = None, folder: Path | None = None
) -> None:
    """Write new files, all or none, into a new folder if one is given; and print an answer."""
    if folder is None:
        write_files(files or {})
    else:
        from orthoglide.report import write_folder

        write_folder(folder, files or {})
    click.echo(text)
