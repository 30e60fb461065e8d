"""The one place that runs a command and turns errors into exit codes and one sentence."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any, NoReturn

import click

from orthoglide.cli.terminal import say
from orthoglide.errors import InputError, OrthoglideError
from orthoglide.text import brief

_STOP = "orthoglide.stop"
_KEPT = "orthoglide.kept"
_LONGEST = 1000  # characters of a sentence
_ASKS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]

BAD_INPUT, NUMERICS_FAILED, INTERRUPTED = 2, 3, 130


class Refusal(click.ClickException):
    """Ends a command with one sentence on the error stream.

    Args:
        message: the sentence.
        exit_code: of the process.
    """

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(brief(" ".join(message.split()), _LONGEST))
        self.exit_code = exit_code  # type: ignore[misc]

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the sentence."""
        say(f"orthoglide: {self.message}", err=True)


_SENTENCE = 200  # letters: none is cut


class Listed(click.Group):
    """A group whose commands are listed in the order added, with what they do in full."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the work, not of the alphabet."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Every command with the whole of its first sentence."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, one.get_short_help_str(_SENTENCE)) for name, one in self.commands.items()]
            )


class Commands(Listed):
    """A group whose commands may raise the package's errors."""

    def make_context(self, *arguments: Any, **options: Any) -> click.Context:
        """Read the command line; an interrupt ends it like a command."""
        try:
            return super().make_context(*arguments, **options)
        except KeyboardInterrupt as error:
            raise _interrupted() from error

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; what it raises becomes an exit code."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise _interrupted() from error
        except OrthoglideError as error:
            if _asked_to_stop():  # a solver that was interrupted says that it failed
                raise _interrupted() from error
            bad = isinstance(error, InputError)
            raise Refusal(str(error), BAD_INPUT if bad else NUMERICS_FAILED) from error
        except Refusal:
            raise
        except Exception as error:
            if _asked_to_stop():  # a compiled import that was interrupted says that it failed
                raise _interrupted() from error
            if isinstance(error, click.ClickException | click.exceptions.Exit | click.Abort):
                raise
            if os.environ.get("ORTHOGLIDE_TRACEBACK"):
                raise
            raise Refusal(_unexpected(error), NUMERICS_FAILED) from error


def keep_on_interrupt(what: str) -> None:
    """Say what stays of the command that runs now, if it is interrupted."""
    click.get_current_context().meta[_KEPT] = what


def _interrupted() -> Refusal:
    context = click.get_current_context(silent=True)
    kept = context.meta.get(_KEPT) if context is not None else None
    return Refusal(f"interrupted: {kept or 'nothing was written'}", INTERRUPTED)


def _unexpected(error: Exception) -> str:
    """The sentence for an error that nobody raised on purpose."""
    kind, text = type(error).__name__, brief(str(error), 200)
    if isinstance(error, ArithmeticError | MemoryError) or kind == "LinAlgError":
        return f"the numerics failed ({kind}: {text}): look for readings far from all others"
    return (
        f"failed unexpectedly ({kind}: {text}), which is a fault of the program: "
        "ORTHOGLIDE_TRACEBACK=1 shows where"
    )


def stop_cleanly() -> None:
    """Ctrl-C and a request to end (SIGTERM, SIGHUP) leave nothing half done behind."""
    shown = sys.unraisablehook

    def show(what: sys.UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):  # the context remembers that one
            shown(what)

    sys.unraisablehook = show
    for which in _ASKS:
        if signal.getsignal(which) is not signal.SIG_IGN:  # nohup
            signal.signal(which, _interrupt)


def _interrupt(*_: Any) -> NoReturn:
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[_STOP] = True
    raise KeyboardInterrupt


@contextmanager
def committing() -> Iterator[None]:
    """Within, files appear; who asks to stop before is heard, and who asks later finds it done."""
    ours = [which for which in _ASKS if signal.getsignal(which) is _interrupt]
    for which in ours:
        signal.signal(which, _too_late)
    try:
        stop_if_asked()
        yield
    except BaseException:
        for which in ours:
            signal.signal(which, _interrupt)
        raise
    for which in ours:
        signal.signal(which, _end_done)


def _too_late(*_: Any) -> None:
    """Heard, and of no consequence: a name is being given, which takes no time."""


def _end_done(*_: Any) -> NoReturn:
    raise SystemExit(0)


def stop_if_asked() -> None:
    """Last call before anything is written: compiled solvers may have swallowed a Ctrl-C."""
    if _asked_to_stop():
        raise KeyboardInterrupt


def _asked_to_stop() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and _STOP in context.meta
