"""The one place that runs a command and turns errors into exit codes and one sentence."""

from __future__ import annotations

import signal
import sys
from typing import IO, Any, NoReturn

import click

from orthoglide.errors import InputError, OrthoglideError

_STOP = "orthoglide.stop"
_INTERRUPTED = "interrupted: nothing was written"

BAD_INPUT, NUMERICS_FAILED, INTERRUPTED = 2, 3, 130


class Refusal(click.ClickException):
    """Ends a command with one sentence on the error stream.

    Args:
        message: the sentence.
        exit_code: of the process.
    """

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(" ".join(message.split()))
        self.exit_code = exit_code  # type: ignore[misc]

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the sentence."""
        click.echo(f"orthoglide: {self.message}", file=file or sys.stderr)


class Commands(click.Group):
    """A group whose commands may raise the package's errors; listed in the order added."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the work, not of the alphabet."""
        return list(self.commands)

    def make_context(self, *arguments: Any, **options: Any) -> click.Context:
        """Read the command line; an interrupt ends it like a command."""
        try:
            return super().make_context(*arguments, **options)
        except KeyboardInterrupt as error:
            raise Refusal(_INTERRUPTED, INTERRUPTED) from error

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; what it raises becomes an exit code."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise Refusal(_INTERRUPTED, INTERRUPTED) from error
        except OrthoglideError as error:
            if _asked_to_stop():  # a solver that was interrupted says that it failed
                raise Refusal(_INTERRUPTED, INTERRUPTED) from error
            bad = isinstance(error, InputError)
            raise Refusal(str(error), BAD_INPUT if bad else NUMERICS_FAILED) from error
        except Exception as error:
            if _asked_to_stop():  # a compiled import that was interrupted says that it failed
                raise Refusal(_INTERRUPTED, INTERRUPTED) from error
            raise


def stop_cleanly() -> None:
    """Ctrl-C and a request to end (SIGTERM) leave nothing half done behind."""

    def interrupt(*_: Any) -> NoReturn:
        context = click.get_current_context(silent=True)
        if context is not None:
            context.meta[_STOP] = True
        raise KeyboardInterrupt

    shown = sys.unraisablehook

    def show(what: sys.UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):  # the context remembers that one
            shown(what)

    sys.unraisablehook = show
    for which in (signal.SIGINT, signal.SIGTERM):
        signal.signal(which, interrupt)


def stop_if_asked() -> None:
    """Last call before anything is written: compiled solvers may have swallowed a Ctrl-C."""
    if _asked_to_stop():
        raise KeyboardInterrupt


def _asked_to_stop() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and _STOP in context.meta
