"""``identify``: from readings to a folder of results."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orthoglide.cli.options import (
    PATH,
    Names,
    fit_options,
    load_machine,
    noise_metres,
    out_option,
    run_options,
)
from orthoglide.cli.progress import progress
from orthoglide.cli.writing import write_results
from orthoglide.progress import Step

if TYPE_CHECKING:
    from orthoglide.fit import Estimate
    from orthoglide.fit.factors import Frame
    from orthoglide.report import Run


@dataclass(frozen=True)
class Asked:
    """What ``identify`` was asked for.

    Attributes:
        free: families or parameters; the base families where empty.
        priors: whether tolerances act as priors.
        own: what each campaign has for itself.
        machine: its file.
        reduced: whether the analytic reduction identifies.
        noise_mm: standard deviation of one reading.
        seed: accepted for all commands; nothing here is drawn.
    """

    free: tuple[str, ...] = ()
    priors: bool = True
    own: tuple[str, ...] = ()
    machine: Path | None = None
    reduced: bool = False
    noise_mm: float | None = None
    seed: int = 0
    fit_tcp: Path | None = None
    frame: Frame = "rigid"

    def arguments(self, campaigns: Sequence[Path]) -> dict[str, Any]:
        """As `result.json` keeps them: names of files, no places."""
        from orthoglide.effects import BASE_FAMILIES

        return {
            "campaigns": [path.name for path in campaigns],
            "free": list(self.free or BASE_FAMILIES),
            "priors": self.priors,
            "own": list(self.own),
            "machine": self.machine.name if self.machine else None,
            "reduced": self.reduced,
            "noise_mm": self.noise_mm,
            **({"fit_tcp": self.fit_tcp.name, "frame": self.frame} if self.fit_tcp else {}),
        }

    def command_line(self, campaigns: Sequence[Path]) -> str:
        """How to run it again."""
        words = ["orthoglide", "identify", *(path.name for path in campaigns), "--out", "DIR"]
        options = {
            "--free": ",".join(self.free),
            "--own": ",".join(self.own),
            "--machine": self.machine.name if self.machine else "",
            "--noise": "" if self.noise_mm is None else f"{self.noise_mm:g}",
        }
        for option, value in options.items():
            words += [option, value] if value else []
        flags = {"--no-priors": not self.priors, "--reduced": self.reduced}
        return shlex.join([*words, *(flag for flag, given in flags.items() if given)])


@click.command()
@click.argument("campaigns", nargs=-1, type=click.Path(path_type=Path))
@out_option()
@click.option(
    "--free",
    type=Names(),
    default=(),
    metavar="NAME,...",
    help="Families or parameters to identify.  [default: joint_offset,leg_length]",
)
@click.option("--no-priors", is_flag=True, help="Do not use the tolerances as priors.")
@fit_options
@click.option("--reduced", is_flag=True, help="Identify with the analytic reduction.")
@click.option("--fit-tcp", type=PATH, metavar="FILE", help="TCP points that are readings as well.")
@click.option(
    "--frame",
    type=click.Choice(("rigid", "translation", "none")),
    default="rigid",
    show_default=True,
    help="How the instrument of --fit-tcp may stand to the machine.",
)
@run_options
def identify(
    campaigns: tuple[Path, ...],
    out: Path,
    free: tuple[str, ...],
    no_priors: bool,
    own: tuple[str, ...],
    machine_path: Path | None,
    noise_mm: float | None,
    reduced: bool,
    fit_tcp: Path | None,
    frame: Frame,
    seed: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Identify joint offsets and leg lengths (or more) from campaigns of dial readings."""
    if not campaigns and fit_tcp is None:
        raise click.UsageError("name at least one campaign, or TCP points with --fit-tcp")
    asked = Asked(free, not no_priors, own, machine_path, reduced, noise_mm, seed, fit_tcp, frame)
    run_identify(campaigns, out, asked, quiet=quiet, as_json=as_json)


COMMANDS = (identify,)


def run_identify(
    paths: Sequence[Path],
    out: Path,
    asked: Asked,
    *,
    command: str = "identify",
    again: str = "",
    quiet: bool = False,
    as_json: bool = False,
) -> None:
    """Read, identify, write the folder and say what was found."""
    from orthoglide.report.folder import check_folder

    check_folder(out)
    with progress(quiet or as_json) as step:
        step(Step("reading"))
        run = _run_of(paths, asked, command, again or asked.command_line(paths))
        estimate = _identified(paths, asked, step)
        step(Step("writing"))
        from orthoglide.report import identification_files

        files = identification_files(estimate, run)
        write_results(out, files)
    if as_json:
        click.echo(files["result.json"], nl=False)
    elif not quiet:
        from orthoglide.report.text import summary

        click.echo(summary(estimate))
        click.echo(f"\nReport: {click.format_filename(out / 'report.html')}")


def _run_of(paths: Sequence[Path], asked: Asked, command: str, again: str) -> Run:
    from orthoglide.report import Run, read_input

    return Run(
        command=command,
        arguments=asked.arguments(paths),
        seed=asked.seed,
        inputs=tuple(read_input(path) for path in paths),
        again=again,
    )


def _identified(paths: Sequence[Path], asked: Asked, step: Any) -> Estimate:
    from orthoglide.effects import BASE_FAMILIES
    from orthoglide.observations import read_campaign

    noise = noise_metres(asked.noise_mm)
    machine = load_machine(asked.machine)
    campaigns = [read_campaign(path, machine.spec) for path in paths]
    step(Step("identifying", f"from {sum(map(len, campaigns))} readings"))
    from orthoglide.fit import identify
    from orthoglide.observations import read_tcp

    points = [] if asked.fit_tcp is None else [read_tcp(asked.fit_tcp, machine.spec)]
    return identify(
        [*campaigns, *points],
        machine,
        asked.free or BASE_FAMILIES,
        own=asked.own,
        priors=asked.priors,
        noise=noise,
        method="reduction" if asked.reduced else "auto",
        frame=asked.frame,
    )
