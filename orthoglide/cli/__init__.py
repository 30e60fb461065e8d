"""The command line, built with click: `app` is the group, the other modules are its commands.

Modules import nothing heavy at their top, so that ``orthoglide --help`` is quick: what a command
needs, it imports when it runs.
"""

from __future__ import annotations

import os
import sys
import warnings
from io import TextIOWrapper

from orthoglide.cli.app import cli as cli

# Importing a module adds its commands, in the order in which help lists them.
from orthoglide.cli import calibrating, measuring, machines  # isort: skip  # noqa: F401


def main() -> None:
    """Run the command line of this process."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # an encoding without "−" shows its number
            stream.reconfigure(errors="backslashreplace")
    # Matrices are small: on several cores their parts wait for each other longer than they work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # what libraries tell programmers
        os.environ.setdefault("PYTHONWARNINGS", "ignore")  # in the processes started here too
    cli(prog_name="orthoglide")
