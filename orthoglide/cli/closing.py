"""``demo``, ``close-loop`` and ``diagnose``: from readings to a cause, and to what it gains."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from orthoglide.cli.options import PATH, fit_options, out_option, run_options
from orthoglide.cli.running import execute, read_request

DEMO_FOLDER = "orthoglide-demo"
DEMO_CAMPAIGN, DEMO_HELD_OUT = "experiment2.csv", "experiment3.csv"


def judge_options(command: Any) -> Any:
    """``--holdout`` and ``--tcp``."""
    options = (
        click.option("--holdout", type=PATH, metavar="FILE",
                     help="Campaign that only judges the finished result."),
        click.option("--tcp", type=PATH, metavar="FILE",
                     help="Measured TCP points that only judge the finished result."),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


@click.command("close-loop")
@click.argument("campaigns", nargs=-1, type=PATH)
@out_option()
@judge_options
@fit_options
@run_options
def close_loop(
    campaigns: tuple[Path, ...], out: Path, quiet: bool, as_json: bool, **options: Any
) -> None:
    """Find what is left beyond the noise, trace it to a cause, add it, and judge."""
    execute(
        lambda: read_request("close-loop", campaigns, **options), out, quiet=quiet, as_json=as_json
    )


@click.command()
@click.argument("campaigns", nargs=-1, type=PATH)
@out_option(required=False, help="Folder for the results; nothing is written where absent.")
@judge_options
@fit_options
@run_options
def diagnose(
    campaigns: tuple[Path, ...], out: Path | None, quiet: bool, as_json: bool, **options: Any
) -> None:
    """Close the loop and print the verdict and the ranked causes; write nothing without --out."""
    execute(
        lambda: read_request("diagnose", campaigns, **options),
        out, quiet=quiet, as_json=as_json, ranked=True,
    )  # fmt: skip


@click.command()
@out_option(required=False, help=f"Folder for the results.  [default: {DEMO_FOLDER}]")
@run_options
def demo(out: Path | None, seed: int, quiet: bool, as_json: bool) -> None:
    """Close the loop on the published Orthoglide (2008), from its own readings.

    The machine is identified and diagnosed from Experiment 2; Experiment 3, taken after new
    offsets were set in the controller, is held out and judges what was found.
    """
    from importlib.resources import as_file, files

    from orthoglide.effects import CATALOGUE

    data = files("orthoglide") / "data"
    with ExitStack() as stack:
        first, held = (
            stack.enter_context(as_file(data / n)) for n in (DEMO_CAMPAIGN, DEMO_HELD_OUT)
        )
        options: dict[str, Any] = {"holdout": held, "own": CATALOGUE.zeros, "seed": seed}
        execute(
            lambda: read_request("demo", (first,), **options),
            out or _next_free(DEMO_FOLDER), quiet=quiet, as_json=as_json,
        )  # fmt: skip


COMMANDS = (demo, close_loop, diagnose)


def _next_free(name: str) -> Path:
    """The demo's folder, numbered where earlier ones stand."""
    folder, number = Path(name), 1
    while folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        number += 1
        folder = Path(f"{name}-{number}")
    return folder
