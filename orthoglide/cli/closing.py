"""``demo``, ``close-loop`` and ``diagnose``: from readings to a cause, and to what it gains."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orthoglide.cli.options import (
    PATH,
    fit_options,
    load_machine,
    noise_metres,
    out_option,
    run_options,
)
from orthoglide.cli.progress import progress
from orthoglide.cli.writing import write_results
from orthoglide.errors import InputError
from orthoglide.progress import Progress, Step

if TYPE_CHECKING:
    from orthoglide.closing import Verdict
    from orthoglide.report import Run

DEMO_FOLDER = "orthoglide-demo"
DEMO_CAMPAIGN, DEMO_HELD_OUT = "experiment2.csv", "experiment3.csv"


@dataclass(frozen=True)
class Asked:
    """What ``close-loop`` was asked for.

    Attributes:
        campaigns: files.
        holdout: a campaign that judges the finished result.
        tcp: points that judge the finished result.
        own: what each campaign has for itself.
        machine: its file.
        noise_mm: standard deviation of one reading.
        seed: of every random draw.
    """

    campaigns: tuple[Path, ...]
    holdout: Path | None = None
    tcp: Path | None = None
    own: tuple[str, ...] = ()
    machine: Path | None = None
    noise_mm: float | None = None
    seed: int = 0

    def run(self, command: str, again: str = "") -> Run:
        """As reports and `result.json` keep it: names of files, no places."""
        from orthoglide.report import Run, read_input
        from orthoglide.report.verdict_run import arguments

        inputs = [read_input(path) for path in self.campaigns]
        if self.holdout is not None:
            inputs.append(read_input(self.holdout, "holdout"))
        if self.tcp is not None:
            inputs.append(read_input(self.tcp, "tcp"))
        told = arguments(
            [path.name for path in self.campaigns],
            own=self.own,
            machine=self.machine.name if self.machine else None,
            noise_mm=self.noise_mm,
            holdout=self.holdout.name if self.holdout else None,
            tcp=self.tcp.name if self.tcp else None,
        )
        return Run(command, told, tuple(inputs), self.seed, again or self.command_line(command))

    def command_line(self, command: str) -> str:
        """How to run it again."""
        words = ["orthoglide", command, *(path.name for path in self.campaigns), "--out", "DIR"]
        options = {
            "--holdout": self.holdout.name if self.holdout else "",
            "--tcp": self.tcp.name if self.tcp else "",
            "--own": ",".join(self.own),
            "--machine": self.machine.name if self.machine else "",
            "--noise": "" if self.noise_mm is None else f"{self.noise_mm:g}",
            "--seed": str(self.seed) if self.seed else "",
        }
        for option, value in options.items():
            words += [option, value] if value else []
        return shlex.join(words)

    def verdict(self, step: Progress) -> Verdict:
        """Read the files and close the loop."""
        from orthoglide.observations import read_campaign, read_tcp

        noise = noise_metres(self.noise_mm)
        if self.seed < 0:
            raise InputError(f"--seed must be 0 or more, not {self.seed}")
        machine = load_machine(self.machine)
        campaigns = [read_campaign(path, machine.spec) for path in self.campaigns]
        held = None if self.holdout is None else read_campaign(self.holdout, machine.spec)
        points = None if self.tcp is None else read_tcp(self.tcp, machine.spec)
        step(Step("identifying", f"from {sum(map(len, campaigns))} readings"))
        from orthoglide.closing import close_loop

        return close_loop(
            campaigns,
            machine,
            own=self.own,
            noise=noise,
            holdout=held,
            tcp=points,
            seed=self.seed,
            progress=step,
        )


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
@click.argument("campaigns", nargs=-1, required=True, type=PATH)
@out_option()
@judge_options
@fit_options
@run_options
def close_loop(
    campaigns: tuple[Path, ...],
    out: Path,
    holdout: Path | None,
    tcp: Path | None,
    own: tuple[str, ...],
    machine_path: Path | None,
    noise_mm: float | None,
    seed: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Find what is left beyond the noise, trace it to a cause, add it, and judge."""
    asked = Asked(campaigns, holdout, tcp, own, machine_path, noise_mm, seed)
    run_close_loop(asked, out, quiet=quiet, as_json=as_json)


@click.command()
@click.argument("campaigns", nargs=-1, required=True, type=PATH)
@out_option(required=False, help="Folder for the results; nothing is written where absent.")
@judge_options
@fit_options
@run_options
def diagnose(
    campaigns: tuple[Path, ...],
    out: Path | None,
    holdout: Path | None,
    tcp: Path | None,
    own: tuple[str, ...],
    machine_path: Path | None,
    noise_mm: float | None,
    seed: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Close the loop and print the verdict and the ranked causes; write nothing without --out."""
    asked = Asked(campaigns, holdout, tcp, own, machine_path, noise_mm, seed)
    run_close_loop(asked, out, command="diagnose", quiet=quiet, as_json=as_json, ranked=True)


@click.command()
@out_option(required=False, help=f"Folder for the results.  [default: {DEMO_FOLDER}]")
@run_options
def demo(out: Path | None, seed: int, quiet: bool, as_json: bool) -> None:
    """Close the loop on the published Orthoglide (2008), from its own readings.

    The machine is identified and diagnosed from Experiment 2; Experiment 3, taken after new
    offsets were set in the controller, is held out and judges what was found.
    """
    from importlib.resources import as_file, files

    data = files("orthoglide") / "data"
    with ExitStack() as stack:
        paths = [stack.enter_context(as_file(data / n)) for n in (DEMO_CAMPAIGN, DEMO_HELD_OUT)]
        asked = Asked((paths[0],), holdout=paths[1], own=("joint_offset",), seed=seed)
        folder = out or _next_free(DEMO_FOLDER)
        run_close_loop(
            asked, folder, command="demo", again=demo_line(seed), quiet=quiet, as_json=as_json
        )


COMMANDS = (demo, close_loop, diagnose)


def run_close_loop(
    asked: Asked,
    out: Path | None,
    *,
    command: str = "close-loop",
    again: str = "",
    quiet: bool = False,
    as_json: bool = False,
    ranked: bool = False,
) -> None:
    """Read, close the loop, write the folder and say what was found.

    Args:
        asked: of the command.
        out: folder for the results; nothing is written where absent.
        command: its name.
        again: a command line that does the same.
        quiet: no progress and no tables.
        as_json: print `result.json` and nothing else.
        ranked: print all causes that were tried.
    """
    from orthoglide.report.folder import check_folder

    if out is not None:
        check_folder(out)
    with progress(quiet or as_json) as step:
        step(Step("reading"))
        run = asked.run(command, again)
        verdict = asked.verdict(step)
        from orthoglide.report import result_text, verdict_files
        from orthoglide.report.verdict_view import View

        view = View(verdict)
        result = ""
        if out is not None:
            files = verdict_files(view, run, step)
            write_results(out, files)
            result = str(files["result.json"])
        elif as_json:
            step(Step("suggesting"))
            result = result_text(view, run)
    if as_json:
        click.echo(result, nl=False)
    elif not quiet:
        from orthoglide.report.verdict_text import verdict_summary

        click.echo(verdict_summary(view, ranked))
        if out is not None:
            click.echo(f"\nReport: {click.format_filename(out / 'report.html')}")


def demo_line(seed: int) -> str:
    """How to run the demo again."""
    return "orthoglide demo --out DIR" + (f" --seed {seed}" if seed else "")


def _next_free(name: str) -> Path:
    """The demo's folder, numbered where earlier ones stand."""
    folder, number = Path(name), 1
    while folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        number += 1
        folder = Path(f"{name}-{number}")
    return folder
