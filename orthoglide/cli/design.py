"""``design``: which readings to take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import exclude
from orthoglide.cli.progress import progress
from orthoglide.cli.terminal import tell, wrapped
from orthoglide.cli.writing import write_sheet, write_texts
from orthoglide.errors import InputError
from orthoglide.progress import Step
from orthoglide.text import text_width

if TYPE_CHECKING:
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings

_COUNT = 24
_OTHERWISE = (
    "design --owns says what its instruments tell, and rehearse --sheet how often it would find "
    "what is wrong"
)


@click.command()
@click.argument("campaigns", nargs=-1, type=opt.PATH, metavar="[SHEET.csv ...]")
@opt.machine()
@click.option("--out", type=opt.PATH, metavar="SHEET.csv",
              help="Measuring sheet to write; for dials with a page to print.")  # fmt: skip
@click.option("--free", type=opt.Names(), default=(), metavar="NAME,...",
              help="Effects or parameters it is for.  [default: zeros and bar lengths; with "
                   "--criterion discriminate all that a design can show]")  # fmt: skip
@click.option("--count", type=int, help="Readings to choose.  [default: 24; all with --owns]")
@click.option("--criterion", type=click.Choice(("d-optimal", "discriminate")),
              default="d-optimal", show_default=True,
              help="To identify what is free as well as can be, or to tell effects apart.",
              )  # fmt: skip
@click.option("--want", type=opt.Names(), default=(), metavar="NAME=SIGMA,...",
              help="Accuracies wanted, in the units of files, TCP=0.01 among them: how often to "
                   "repeat.")  # fmt: skip
@click.option("--owns", type=opt.Names(), default=(), metavar="KIND,...",
              help="Instruments that you have (leg, parallelism, tcp, plate, distance, ballbar, "
                   "incline): what they would tell together, and with --out a sheet; with --count "
                   "as many of the tool's readings as tell most together.")  # fmt: skip
@click.option("--detect", is_flag=True, help="Also tell the smallest effects found and named.")
@opt.noise()
@opt.seed
@opt.quiet
def design(
    campaigns: tuple[Path, ...],
    machine_path: Path | None,
    effects_file: Path | None,
    out: Path | None,
    free: tuple[str, ...],
    count: int | None,
    criterion: str,
    want: tuple[str, ...],
    owns: tuple[str, ...],
    detect: bool,
    noise: float | None,
    seed: int,
    quiet: bool,
) -> None:
    """Choose readings before any is taken, and compare protocols and sheets by what they see."""
    from orthoglide import planning, prospects
    from orthoglide.files import check_new
    from orthoglide.planning.wording import index_rows, pair_rows, repeats_row
    from orthoglide.prospects.wording import detectable_rows

    exclude(
        "owns", "campaigns", "free", "criterion", "want", "detect", "noise",
        because="every instrument has a sheet and a noise of its own, and its smallest effects "
        "are told anyway",
    )  # fmt: skip
    if out is not None:
        check_new(out)
    machine = opt.load_machine(machine_path, effects_file)
    if owns:
        _of_owned(machine, owns, count, out, seed, quiet)
        return
    count, most = _COUNT if count is None else count, len(planning.reading_pool(machine.geometry))
    if count > most:
        raise InputError(f"there are {most} readings to choose from: give --count {most} or less")
    wanted = opt.quantities("--want", want, machine.catalogue)
    with progress(quiet) as step:
        step(Step("computing", "choosing readings"))
        found = planning.design(machine, free or None, count, criterion, noise=noise)  # type: ignore[arg-type]
        step(Step("computing", "comparing"))
        sheets = _sheets(machine, campaigns)
        compared = [
            (name, planning.observability(machine, c, found.names, noise))
            for name, c in sheets.items()
        ]
        sheets["design"] = found.campaign
        lines = [*index_rows([*compared, ("design", found.indices)]), *pair_rows(found)]
        for name, c in sheets.items():
            lines += [f"{name}: {warning}" for warning in planning.aliasing(machine, c)]
        for name, c in sheets.items():
            for what, sigma in wanted.items():
                step(Step("computing", f"how often to repeat {c.name}"))
                answer = planning.repeats_needed(machine, c, found.names, what, sigma, noise)
                lines.append(f"{name}, {repeats_row(answer, machine.catalogue)}")
        for name, c in sheets.items() if detect else ():
            step(Step("computing", f"smallest effects: {name}"))
            smallest = prospects.smallest_effects(machine, c, noise=noise, seed=seed)
            lines += ["", f"{name}:", *detectable_rows(smallest, text_width())]
        lines += [] if out is None else [write_sheet(out, found.campaign, machine)]
    seen = f"{found.indices.rank} of {found.indices.unknowns} unknowns"
    line = f"{len(found.campaign)} readings show {seen}."
    tell(wrapped("\n".join(lines), text_width()), line, quiet, out is not None)


def _of_owned(
    machine: Machine,
    kinds: tuple[str, ...],
    count: int | None,
    out: Path | None,
    seed: int,
    quiet: bool,
) -> None:
    """``--owns``: smallest effects, and a sheet of the tool's readings."""
    from orthoglide.observations import readings_text
    from orthoglide.planning import sheets_of, to_fill_in
    from orthoglide.prospects import TAKEN_BY, smallest_effects
    from orthoglide.prospects.wording import detectable_rows

    with progress(quiet) as step:
        step(Step("computing", "what the instruments would tell"))
        owned = sheets_of(machine, kinds, count)
        tells = smallest_effects(machine, list(owned.values()), seed=seed)
        listed = ", ".join(f"{TAKEN_BY[k]} ({len(s)})" for k, s in owned.items())
        lines = [f"with {listed}:", *detectable_rows(tells, text_width())]
        if out is not None:
            sheets = to_fill_in(owned.values())
            if not sheets:
                raise InputError("dials alone have sheets of their own: orthoglide protocol")
            write_texts({out: readings_text(sheets, machine.spec, places=True)})
            moves = sum(len(sheet.moves) for sheet in sheets)
            between = f"; rows of kind move ({moves}): go there, read nothing" if moves else ""
            lines += ["", f"{click.format_filename(out)}: {sum(map(len, sheets))} readings of the "
                          f"tool, to be filled in{between}"]  # fmt: skip
            placed = machine.spec.kinematics is not None
            if placed:
                lines.append("Send the tool to x_mm, y_mm, z_mm, with its numbers as they are.")
            for one in (sheet.setups[0].observation for sheet in sheets):
                lines.append(f"{one.words}: {(one.fill_place if placed else '') or one.fill}.")
    hidden = len(tells.invisible)
    line = f"{len(tells.by_effect)} effects are seen, {hidden} parameters are not visible."
    tell(wrapped("\n".join(lines), text_width()), line, quiet, out is not None)


def _sheets(machine: Machine, paths: tuple[Path, ...]) -> dict[str, Readings]:
    """The sheets given, or the protocols there are."""
    from orthoglide.observations import protocol

    if paths:
        read = [opt.dial_sheet(p, machine, _OTHERWISE) for p in paths]
        return {c.name: c for c in read}
    return {kind: protocol(kind, machine.geometry) for kind in opt.DIAL_PROTOCOLS}  # type: ignore[arg-type]
