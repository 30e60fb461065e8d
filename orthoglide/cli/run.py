"""The one place that runs a command and turns errors into exit codes and one sentence."""

from __future__ import annotations

import signal
import sys
from typing import IO, Any, NoReturn

import click

from orthoglide.errors import InputError, OrthoglideError

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

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; what it raises becomes an exit code."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise Refusal(str(error), BAD_INPUT) from error
        except OrthoglideError as error:
            raise Refusal(str(error), NUMERICS_FAILED) from error
        except KeyboardInterrupt as error:
            raise Refusal("interrupted: nothing was written", INTERRUPTED) from error


def stop_cleanly() -> None:
    """A request to end (SIGTERM) is treated as Ctrl-C, so that nothing half done stays behind."""

    def interrupt(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
