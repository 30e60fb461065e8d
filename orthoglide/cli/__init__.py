"""The command line; every group of commands is a module beside this one.

Modules import nothing heavy at their top, so that ``orthoglide --help`` is quick: what a command
needs, it imports when it runs.
"""

from __future__ import annotations

import os
import sys
import warnings

import click

from orthoglide import __version__
from orthoglide.cli import (
    check,
    closing,
    compare,
    compensate,
    design,
    importing,
    kinematics,
    measure,
    rehearse,
    rerun,
    sheets,
    view,
)
from orthoglide.cli.completion import completion_option
from orthoglide.cli.examples import with_examples
from orthoglide.cli.run import Commands, stop_cleanly
from orthoglide.cli.terminal import speak_plainly


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="orthoglide")
@completion_option
def cli() -> None:
    """Find what is wrong with an Orthoglide from dial readings, and calibrate it.

    Try `demo` first. At a machine print a sheet with `protocol`, or let `measure` ask for the
    readings; then `close-loop` writes the report, and `check` compares after a repair.

    Exit codes: 0 done, 2 bad input or usage, 3 the numerics failed, 130 interrupted. Nothing is
    written unless the run succeeds, but for what `measure` was told and `rehearse` has finished.
    """


for _command in (
    closing.demo, closing.close_loop, closing.diagnose, closing.identify, check.check,
    rerun.rerun, sheets.protocol, sheets.simulate, measure.measure, design.design,
    rehearse.rehearse, compensate.compensate, compensate.export,
    compare.compare, kinematics.forward, kinematics.inverse, view.view, importing.import_,
):  # fmt: skip
    cli.add_command(_command)
with_examples(cli)


def main() -> None:
    """Run the command line of this process."""
    stop_cleanly()
    speak_plainly()
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # what libraries tell programmers
        os.environ.setdefault("PYTHONWARNINGS", "ignore")  # in the processes started here too
    cli(prog_name="orthoglide")
