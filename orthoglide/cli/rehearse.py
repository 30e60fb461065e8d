"""``rehearse``: how often a sheet would find what is wrong, before anything is measured."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import exclude
from orthoglide.cli.progress import progress
from orthoglide.cli.run import keep_on_interrupt
from orthoglide.cli.terminal import tell
from orthoglide.errors import InputError


@click.command()
@opt.machine()
@click.option("--sheet", type=opt.PATH, metavar="SHEET.csv",
              help="Measuring sheet; the protocol sweep where absent, or a probe on a plate where "
                   "no dial stands on a leg.")  # fmt: skip
@click.option("--owns", type=opt.Names(), default=(), metavar="KIND,...",
              help="In place of a sheet, readings you can take: leg (dials), parallelism, tcp, "
                   "plate, distance, ballbar, incline.")  # fmt: skip
@click.option("--campaigns", type=int, default=90, show_default=True, help="How many to simulate.")
@opt.seed
@click.option("--jobs", type=int, metavar="N",
              help="Processes side by side.  [default: one for every processor]")  # fmt: skip
@click.option("--dask", metavar="ADDRESS",
              help="Scheduler of a Dask cluster that does the work instead.")  # fmt: skip
@click.option("--out", type=opt.PATH, metavar="DIR",
              help="Folder for finished campaigns and the table; a run that was stopped goes on "
                   "from there.")  # fmt: skip
@opt.quiet
def rehearse(
    machine_path: Path | None,
    effects_file: Path | None,
    sheet: Path | None,
    owns: tuple[str, ...],
    campaigns: int,
    seed: int,
    jobs: int | None,
    dask: str | None,
    out: Path | None,
    quiet: bool,
) -> None:
    """Simulate campaigns on machines like yours, and count what your sheet would find.

    Machines are drawn by the dimensions and tolerances of the machine file: with nothing wrong but
    zeros and lengths, with one effect at 3 to 10 tolerances, with something that no catalogue
    knows, and with everything off by a share f of its tolerance.
    """
    from orthoglide.rehearsal import rehearse as run

    exclude("dask", "jobs", because="the cluster has its own workers")
    machine = opt.load_machine(machine_path, effects_file)
    if out is not None:
        name = click.format_filename(out)
        keep_on_interrupt(f"{name} keeps what was finished, and the same command goes on")
    with progress(quiet) as step, _workers(dask):
        found = run(
            machine, sheet, campaigns, owns=owns, seed=seed, out=out, progress=step,
            jobs=-1 if jobs is None and dask is None else jobs,
        )  # fmt: skip
    tell(str(found), found.line, quiet, out is not None)


@contextmanager
def _workers(address: str | None) -> Iterator[None]:
    """Have joblib send its work to a Dask cluster, if there is one."""
    if address is None:
        yield
        return
    try:
        from dask.distributed import Client
    except ImportError:
        raise InputError("--dask needs Dask: pip install orthoglide[dask]") from None
    from joblib import parallel_config

    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {address}: {error}") from None
    with client, parallel_config(backend="dask"):
        yield
