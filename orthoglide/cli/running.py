"""The way of every identification: a request from the command line, its result, its report."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import need
from orthoglide.cli.progress import progress
from orthoglide.cli.terminal import say, tell
from orthoglide.cli.writing import write_results
from orthoglide.errors import InputError
from orthoglide.progress import Step
from orthoglide.text import shown

if TYPE_CHECKING:
    from orthoglide.instruments import Frame
    from orthoglide.progress import Progress
    from orthoglide.result import Command, Request
    from orthoglide.verdict import Verdict


def read_request(
    command: Command,
    campaigns: Sequence[Path],
    *,
    machine_path: Path | None = None,
    own: tuple[str, ...] = (),
    noise: float | None = None,
    seed: int = 0,
    holdout: Path | None = None,
    tcp: Path | None = None,
    fit_tcp: Sequence[Path] = (),
    frame: Frame = "rigid",
    effects_file: Path | None = None,
    free: tuple[str, ...] = (),
    no_priors: bool = False,
    reduced: bool = False,
) -> Request:
    """Read what the options of a command name.

    Raises:
        InputError: where a file or an option cannot be used.
    """
    from orthoglide.fit import readings_of, sorted_out
    from orthoglide.observations import read_tcp
    from orthoglide.result import Request

    need("frame", "fit_tcp")
    if not campaigns and not fit_tcp:
        raise InputError("name at least one campaign, or TCP points with --fit-tcp")
    machine = opt.load_machine(machine_path, effects_file)
    fitted = tuple(read_tcp(path, machine.spec) for path in fit_tcp)
    several, tool = sorted_out((*campaigns, *fitted), machine)
    held = () if holdout is None else readings_of([holdout], machine)
    points = None if tcp is None else read_tcp(tcp, machine.spec)
    return Request(
        command, several, machine, own, noise, seed, held, points, free or Request.free,
        not no_priors, reduced, tool, frame, shown(effects_file.name) if effects_file else "",
    )  # fmt: skip


def performed(
    read: Callable[[], Request], step: Progress, *, draw: bool = True
) -> tuple[Verdict, dict[str, str | bytes]]:
    """The result of a request and, where they are to be drawn, the files of its folder."""
    step(Step("reading"))
    request = read()
    from orthoglide.report import report_files
    from orthoglide.verdict import run

    result = run(request, step)
    return result, report_files(result, step) if draw else {}


def execute(
    command: Command, *, out: Path | None, quiet: bool, as_json: bool, **asked: Any
) -> None:
    """Do what a command's options ask, write the folder, where there is one, and say what was
    found, by ``diagnose`` with all causes that were tried.
    """
    with progress(quiet or as_json) as step:
        read = partial(read_request, command, **asked)
        result, files = performed(read, step, draw=out is not None)
        from orthoglide.report import result_text, summary
        from orthoglide.report.words import meaning

        told = "" if quiet or as_json else summary(result, command == "diagnose", "machine")
        line = f"Verdict {result.word}: {meaning(result)}."
        if as_json and out is None:
            step(Step("suggesting"))
        text = (files.get("result.json") or result_text(result)) if as_json else ""
        if out is not None:
            write_results(out, files)
    if as_json:
        say(text if isinstance(text, bytes) else text.encode(), needed=out is None)
        return
    report = ""
    if out is not None:
        report = f"\n\nReport: {click.format_filename(out / 'report.html')}"
        # Commands are typed where this is read, not in the folder.
        here = click.format_filename(out / "calibrated.toml")
        told = told.replace("--machine calibrated.toml", f"--machine {shlex.quote(here)}")
    tell(f"{told}{report}", line, quiet, out is not None)
