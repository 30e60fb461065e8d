"""Run the command line in the process of the tests, whatever library it is built with."""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
import tomllib
import warnings
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

ROOT = Path(__file__).parents[1]
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Run(NamedTuple):
    """Exit code of a command, its standard output and its error stream."""

    code: int
    output: str
    errors: str

    @property
    def text(self) -> str:
        """Everything that was printed, spaces and line ends as single spaces."""
        return " ".join((self.output + " " + self.errors).split())


def run(*arguments: object, stdin: str = "") -> Run:
    """Call the console script of ``pyproject.toml`` with arguments, as a shell would.

    What the call changes of the process (signals, environment, hooks) is restored.
    """
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module, _, function = scripts["scripts"]["orthoglide"].partition(":")
    main = getattr(importlib.import_module(module), function)
    output, errors, code = io.StringIO(), io.StringIO(), 0
    handlers = {which: signal.getsignal(which) for which in _SIGNALS}
    with ExitStack() as stack:
        stack.enter_context(patch.object(sys, "argv", ["orthoglide", *map(str, arguments)]))
        stack.enter_context(patch.object(sys, "stdin", io.StringIO(stdin)))
        stack.enter_context(patch.object(sys, "unraisablehook", sys.unraisablehook))
        stack.enter_context(patch.object(os, "_exit", sys.exit))  # which ends an interrupted run
        stack.enter_context(patch.dict(os.environ))
        stack.enter_context(warnings.catch_warnings())
        stack.enter_context(redirect_stdout(output))
        stack.enter_context(redirect_stderr(errors))
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            for which, handler in handlers.items():
                signal.signal(which, handler)
    return Run(code, output.getvalue(), errors.getvalue())


def done(*arguments: object, stdin: str = "") -> Run:
    """Call it as `run` does, and expect exit code 0."""
    finished = run(*arguments, stdin=stdin)
    assert finished.code == 0, f"{' '.join(map(str, arguments))}\n{finished.text}"
    return finished
