"""``protocol`` and ``simulate``: measuring sheets, empty or filled in by a machine file."""

from __future__ import annotations

import os
from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import exclude, need
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_sheet, write_texts
from orthoglide.errors import InputError

_kind_option = click.option(
    "--kind", type=click.Choice(opt.PROTOCOLS), default="standard", show_default=True,
    help="Zero, Max and Min; the stroke in steps, both ways; the same at two places of a leg; two "
         "dials on a leg at a time, whose difference is read at Zero, Max and Min.",
)  # fmt: skip


@click.command()
@click.option("--out", type=opt.PATH, required=True, metavar="SHEET.csv",
              help="File to write; SHEET.html, to print, is written beside it.")  # fmt: skip
@_kind_option
@opt.machine()
def protocol(out: Path, kind: str, machine_path: Path | None, effects_file: Path | None) -> None:
    """Write a measuring sheet: every row but the reading, and the same rows as a page to print."""
    from orthoglide.observations import protocol as make

    need("effects_file", "machine_path")
    machine = opt.load_machine(machine_path, effects_file)
    say(write_sheet(out, make(kind, machine.geometry), machine))  # type: ignore[arg-type]


@click.command()
@opt.machine(required=True, help="Machine file; its [parameters] are errors of the machine.")
@click.option("--error", "errors", type=opt.Names(), default=(), metavar="NAME=NUMBER,...",
              help="More errors of the machine, in the units of files.")  # fmt: skip
@click.option("--out", type=opt.PATH, required=True, metavar="CSV", help="Readings to write.")
@_kind_option
@click.option("--sheet", type=opt.PATH, metavar="SHEET.csv",
              help="Rows to be read in place of a protocol's; of any instruments.")  # fmt: skip
@opt.seed
@opt.noise(least=0.0)
@click.option("--exact", is_flag=True,
              help="No noise, no rounding, dials exactly in place, datums zero.")  # fmt: skip
@click.option("--tcp", type=opt.PATH, metavar="TCP.csv",
              help="Also write 60 exact TCP points, to judge by.")  # fmt: skip
def simulate(
    machine_path: Path,
    effects_file: Path | None,
    errors: tuple[str, ...],
    out: Path,
    kind: str,
    sheet: Path | None,
    seed: int,
    noise: float | None,
    exact: bool,
    tcp: Path | None,
) -> None:
    """Measure a machine that exists as a file only: a campaign of its readings.

    Each dial has its own datum and stands up to some placement error off its place, each instrument
    at the tool has its own datum and frame; readings are noisy and rounded to their resolution.
    """
    import numpy as np

    from orthoglide import simulation
    from orthoglide.files import check_new
    from orthoglide.observations import csv_text, protocol, read_readings, readings_text, tcp_rows

    exclude("sheet", "kind", because="a sheet has rows of its own")
    exclude("exact", "noise", because="exact readings have none")
    if tcp is not None and os.path.realpath(tcp) == os.path.realpath(out):
        raise InputError(f"--out and --tcp are both {str(tcp)!r}: give each a name of its own")
    for path in filter(None, (out, tcp)):
        check_new(path)
    plain = opt.load_machine(machine_path, effects_file)
    given = opt.quantities("--error", errors, plain.catalogue)
    machine = plain.with_parameters(given)
    draw = np.random.default_rng(seed)
    sheets = (
        (protocol(kind, machine.geometry),)  # type: ignore[arg-type]
        if sheet is None
        else read_readings(sheet, machine.spec, require_readings=False)
    )
    plain.catalogue.expand(given, [s.name for one in sheets for s in one.setups])
    filled = [
        simulation.simulate(machine, one, noise=noise, seed=draw, exact=exact) for one in sheets
    ]
    file = None if machine.geometry.dialled else machine.spec
    texts = {out: readings_text(filled, file)}
    if tcp is not None:
        points = simulation.simulate_tcp(machine, seed=draw)
        texts[tcp] = csv_text(
            tcp_rows(points.with_readings(np.round(points.reading, 9)), machine.spec)
        )
    write_texts(texts)
    for name, lacking in simulation.unshown(machine, *filled).items():
        say(f"warning: {name} changes no reading, as {lacking}", err=True)
    for path, text in texts.items():
        say(f"{click.format_filename(path)}: {text.count(chr(10)) - 1} rows")
